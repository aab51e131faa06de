"""Web page without a browser: access control, drawing, requests, release."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
import viser
from viser._messages import ShareUrlDisconnect, ShareUrlRequest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from maglev_mj.cli import main
from maglev_mj.cli.peripherals import PageOptions
from maglev_mj.device import Device
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.parameters import Turn, param
from maglev_mj.plants.hand import SpringHand
from maglev_mj.plants.shapes import Shape
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import EMERGENCY_STOP, REWIND_ACTIONS, Session, Snapshot
from maglev_mj.session.access import ListenError, check_origin, listen
from maglev_mj.session.actions import SCENE_PREFIX, actions
from maglev_mj.session.pacing import FrameClock, Pacer
from maglev_mj.session.replay import ACTIONS
from maglev_mj.views.page import panel
from maglev_mj.views.page.live import contact, knob
from maglev_mj.views.page.page import Endpoint, Page, PageServer
from maglev_mj.views.page.panel import Choice, Control, Slider, control, drawn, ticks
from maglev_mj.views.page.stage import Grab, solid
from maglev_mj.views.readings import Chart, Charts, Curve
from maglev_mj.views.viewer_process import SILENCE, Glide, RemoteSession
from maglev_mj.views.window.keys import _KEYS
from tests.interop.test_teleoperation import BALL, follow
from tests.processes import PATIENCE, started
from tests.views.test_watching import ViewerHere

TOKEN = "a-token-of-some-length"
VERSION = [Subprotocol(f"viser-v{viser.__version__}")]


@contextmanager
def served(host: str = "127.0.0.1", token: str | None = None, origins: Sequence[str] = ()) -> Iterator[PageServer]:
    """Yield the server of a page."""
    with listen(0, host) as listener:
        port = listener.getsockname()[1]
        server = PageServer(Endpoint(host, port, token, origins), listener)
        assert server.get_port() == port  # no other is taken
        try:
            yield server
        finally:
            server.stop()


class Answer(NamedTuple):
    """Answer of a server."""

    status: int
    headers: dict[str, str]
    text: str


def ask(server: PageServer, path: str = "/", **headers: str) -> Answer:
    """Return the answer to a browser's request.

    Host is right unless given.
    """
    with closing(http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=10.0)) as line:
        line.request("GET", path, headers={"Host": f"127.0.0.1:{server.get_port()}", **headers})
        got = line.getresponse()
        return Answer(got.status, dict(got.getheaders()), got.read().decode("utf-8"))


def upgrade(server: PageServer, origin: str | None = "", **headers: str) -> int:
    """Return the status of a WebSocket handshake.

    101 if accepted.
    """
    own = f"http://127.0.0.1:{server.get_port()}"
    try:
        with connect(
            f"ws://127.0.0.1:{server.get_port()}",
            origin=None if origin is None else Origin(origin or own),
            subprotocols=VERSION,
            additional_headers=headers,
        ):
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def test_other_origins_and_hosts_are_rejected() -> None:
    with served() as server:
        page = ask(server)
        assert page.status == 200 and "<html" in page.text
        assert upgrade(server) == 101
        port = server.get_port()
        others = "http://evil.example", "null", "http://127.0.0.1:1", "http://127.0.0.1.evil.example"
        for origin in (*others, f"http://127x0x0x1:{port}", None):
            assert upgrade(server, origin) == 403
        for host in (f"evil.example:{port}", f"127.0.0.1.evil.example:{port}", f"127.0.0.2:{port}", ""):
            assert ask(server, Host=host).status == 403
        assert ask(server, Origin="http://evil.example").status == 403
        for host in (f"localhost:{port}", "localhost:9999", f"[::1]:{port}"):  # of a tunnel by ssh, too
            assert ask(server, Host=host).status == 200
        # another site cannot frame it and have a person click there
        assert page.headers["Content-Security-Policy"].startswith("frame-ancestors 'self' http://127.0.0.1:*")
        assert "Set-Cookie" not in page.headers


def test_two_hosts_in_one_request_are_refused() -> None:
    with served() as server, socket.create_connection(("127.0.0.1", server.get_port())) as line:
        own = f"127.0.0.1:{server.get_port()}"
        line.sendall(f"GET / HTTP/1.1\r\nHost: {own}\r\nHost: evil.example\r\n\r\n".encode())
        assert line.recv(100).startswith(b"HTTP/1.1 403")


def test_a_token_becomes_a_cookie_hidden_from_scripts_and_other_sites() -> None:
    with served(token=TOKEN) as server:
        for path in ("/", "/?token=", f"/?token={TOKEN[:-1]}", "/?token=%C3%A9", f"/?other={TOKEN}"):
            refused = ask(server, path)
            assert refused.status == 403 and TOKEN not in refused.text and "Set-Cookie" not in refused.headers
        assert upgrade(server) == 403
        page = ask(server, f"/?token={TOKEN}")
        cookie = page.headers["Set-Cookie"]
        assert page.status == 200 and page.headers["Referrer-Policy"] == "no-referrer"
        assert {"HttpOnly", "SameSite=Strict"} <= set(cookie.split("; ")[1:])
        kept = cookie.split(";")[0]
        assert kept == f"maglev_mj_{server.get_port()}={TOKEN}"  # browsers do not keep cookies apart by the port
        assert ask(server, Cookie=kept).status == 200 and upgrade(server, Cookie=f"a=b; {kept}") == 101
        assert upgrade(server, Cookie=kept.replace(TOKEN, "wrong")) == 403
        assert upgrade(server, "http://evil.example", Cookie=kept) == 403
        with pytest.raises(InvalidStatus, match="403"):  # a token in the address of a WebSocket is no cookie
            connect(f"ws://127.0.0.1:{server.get_port()}/?token={TOKEN}", origin=Origin(server_url(server)))


def test_a_server_without_access_control_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    # As another version of viser might: the process that serves the page ends.
    monkeypatch.setattr(viser.ViserServer, "__init__", lambda self, **options: None)
    with listen(0) as listener, pytest.raises(MaglevError, match="access control would be missing"):
        PageServer(Endpoint("127.0.0.1", listener.getsockname()[1]), listener)


def test_an_allowed_origin_still_needs_the_token() -> None:
    with served(origins=["http://192.168.0.5:8080", "null"]) as server:
        statuses = [upgrade(server, origin) for origin in ("http://192.168.0.5:8080", "null", "", "http://192.168.0.6")]
        assert statuses == [101, 101, 101, 403]
    with served(token=TOKEN, origins=["null"]) as server:
        assert upgrade(server, "null") == 403


def test_an_invalid_origin_is_rejected() -> None:
    for origin in ("", "*", "http://", "http://a/", "ftp://a", "a.example", "http://a b", "http://a,http://b"):
        with pytest.raises(ParameterError, match="origin must be a URL"):
            check_origin(origin)


def server_url(server: PageServer) -> str:
    return f"http://127.0.0.1:{server.get_port()}"


def test_on_all_addresses_ip_hosts_are_accepted_and_names_rejected() -> None:
    with served("0.0.0.0", TOKEN) as server:
        assert ask(server, f"/?token={TOKEN}").status == 200
        assert ask(server, f"/?token={TOKEN}", Host="192.168.1.7:80").status == 200
        assert ask(server, f"/?token={TOKEN}", Host="evil.example").status == 403


def test_share_urls_are_disabled(monkeypatch: pytest.MonkeyPatch) -> None:
    # Neither through the message nor through the method: both are touched here.
    opened: list[object] = []

    class Tunnel:
        def __init__(self, *args: object) -> None:
            opened.append(args)

        on_connect = on_disconnect = lambda self, told: told

        def get_status(self) -> str:
            return "failed"

        def close(self) -> None: ...

    monkeypatch.setattr("viser._viser.ViserTunnel", Tunnel)
    with served() as server:
        assert server.request_share_url() is None and opened == []
        assert ShareUrlRequest not in server._websock_server._incoming_handlers
        assert ShareUrlDisconnect in server._websock_server._incoming_handlers  # the names are still those
        asked: list[object] = []
        monkeypatch.setattr(server, "request_share_url", lambda: asked.append(1))
        with connect(
            f"ws://127.0.0.1:{server.get_port()}", origin=Origin(server_url(server)), subprotocols=VERSION
        ) as line:
            line.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
            line.send(msgspec.msgpack.encode({"type": "ShareUrlDisconnect"}))
            line.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage", **CAMERA}))
            waited(lambda: server.get_clients())  # messages are handled in order
        assert asked == [] and opened == []


def test_a_port_in_use_and_a_foreign_host_are_reported(capsys: pytest.CaptureFixture[str]) -> None:
    with listen(0) as taken:
        port = taken.getsockname()[1]
        assert main(["view", "--web", "--no-open", "--port", str(port)]) == 1
        assert f"cannot listen on port {port} of 127.0.0.1: Address already in use" in capsys.readouterr().err
    with pytest.raises(ListenError, match=r"cannot listen on port 0 of 192\.0\.2\.1: Cannot assign"):
        listen(0, "192.0.2.1")
    assert main(["view", "--web", "--no-open", "--host", "192.0.2.1", "--token", TOKEN, "--port", "0"]) == 1
    assert "192.0.2.1" in capsys.readouterr().err


def test_a_token_is_generated_by_default(capsys: pytest.CaptureFixture[str]) -> None:
    """One that is typed is in the list of processes."""
    tokens = []
    for _ in range(2):
        front: Any = PageOptions(web=True, port=0, no_open=True, token="").open()
        door, listener, _ = front.args
        listener.close()
        tokens.append(door.token)
        assert f"web page: http://127.0.0.1:{door.port}/?token={door.token}\n" in capsys.readouterr().out
    assert tokens[0] != tokens[1] and min(map(len, tokens)) >= 32


@pytest.mark.parametrize("kind", ["box", "cylinder", "ellipsoid"])
def test_a_shape_is_closed_faces_outward_and_has_its_volume(kind: str) -> None:
    half, turn = np.array([0.01, 0.015, 0.02]), [np.cos(0.3), 0.0, np.sin(0.3), 0.0]
    made = solid(Shape(True, kind, half, np.array([0.1, 0.2, 0.3]), turn, (1.0, 1.0, 1.0, 1.0)))
    closed = made.copy()
    closed.merge_vertices(merge_norm=True)
    assert closed.is_watertight and closed.volume > 0.0
    facing = np.einsum("ij,ij->i", made.face_normals, made.vertex_normals[made.faces].mean(axis=1))
    assert facing.min() > {"box": 0.999, "cylinder": 0.97, "ellipsoid": 0.9}[kind]  # no edge is rounded
    whole = {"box": 8.0, "cylinder": 2.0 * np.pi, "ellipsoid": 4.0 / 3.0 * np.pi}[kind] * half.prod()
    assert made.volume == pytest.approx(whole, rel=0.01)
    assert made.centroid == pytest.approx([0.1, 0.2, 0.3])


def test_a_chart_contains_its_points_and_escapes_markup() -> None:
    line = Curve((1.0, 0.0, 0.0), [0.0, 1.0], [0.0, 2.0], dot=True)
    made = drawn(Chart([("a<b", None)], [line], (0.0, 1.0), (0.0, 2.0)))
    assert "a&lt;b" in made and 'points="44.0,126.0 308.0,20.0"' in made and "#ff0000" in made
    assert made.index("<circle") > made.index("</svg>")  # whole: the inner element clips
    assert "<circle" not in drawn(Chart([("a", None)], [line], (0.0, 0.9), (0.0, 2.0)))
    assert ticks(0.0, 20.0) == [0.0, 5.0, 10.0, 15.0, 20.0] and ticks(-3.7, 4.1) == [-2.0, 0.0, 2.0, 4.0]
    for span in np.geomspace(1e-6, 1e6, 200):
        assert 3 <= len(ticks(-span, span)) <= 10


class Recorder:
    """Source that only records the requests."""

    def __init__(self, snapshot: Snapshot) -> None:
        self.hand, self.simulated, self.asked = SpringHand(), 0.0, []  # type: ignore[var-annotated]
        self.shown = snapshot

    def tick(self, elapsed: float) -> int:
        return 0

    def act(self, action: str) -> None:
        self.asked.append(action)

    def change(self, parameters: Any) -> None:
        self.asked.append(parameters)

    def snapshot(self) -> Snapshot:
        return self.shown

    def close(self) -> None: ...


@contextmanager
def page_of(**parts: Any) -> Iterator[tuple[Page, Recorder]]:
    """Yield the page of a joystick's snapshot."""
    source = Recorder(Snapshot(scene=Joystick(), **parts))
    with served() as server:
        yield Page(server, source), source


def shown(page: Page, source: Recorder, **parts: Any) -> Any:
    """Return a page's stage after it has shown a changed snapshot."""
    source.shown = replace(source.shown, **parts)
    page._stage.show(source.shown)
    return page._stage


def test_the_page_draws_the_robot() -> None:
    scene = follow(BALL)()
    poses = scene.beside_poses([(scene.follower.start,)])
    with page_of(beside=poses) as (page, source):
        stage = page._stage
        assert stage._beside == []  # of the joystick
        stage.show(Snapshot(scene=scene, beside=poses))
        assert [node.visible for node in stage._beside] == [True] * len(poses)
        assert np.allclose([node.position for node in stage._beside], poses[:, :3], atol=1e-5)
        stage.show(source.shown)
        assert stage._beside == []


def test_only_a_received_snapshot_is_a_sign_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    with page_of(pose=np.zeros(6)) as (page, source):
        monkeypatch.setattr(page._server, "get_clients", lambda: [1])
        for received, beats in ((False, 0), (True, 1), (False, 1), (True, 2)):
            if received:  # equal, as of a paused scene
                source.shown = replace(source.shown, pose=np.zeros(6))
            page._show()
            assert page._beats == beats
            assert not beats or json.loads(page._live.value)["beat"] == beats


def strip_of(stiffness: float, seconds: float = 1.5, pull: float = 0.012, **parts: Any) -> tuple[Any, list[Chart]]:
    """Return the page's strip of a joystick pulled into a wall, and the charts of the same strip in the window."""
    session = Session(Joystick(stiffness=stiffness), pacer=Pacer(budget=60.0, patience=3600.0))
    session.hand.target = [pull, 0.0, 0.0, 0.0, 0.0, 0.0]
    session.tick(seconds)
    snapshot = replace(session.snapshot(), **parts)
    return json.loads(json.dumps(contact(snapshot, Charts(100)))), Charts(100).strip(snapshot)


def test_the_strip_says_whether_the_knob_swings_in_a_wall() -> None:
    still, charts = strip_of(6000.0)
    assert (still["state"], still["bad"], still["normal"]) == ("still", False, -1.0)
    for shown, chart in zip(still["charts"], charts, strict=True):  # what the window draws
        assert [words for words, _ in shown["title"]] == [words for words, _ in chart.title]
        assert shown["up"] == pytest.approx(chart.up)
        for line, own in zip(shown["lines"], chart.lines, strict=True):
            points = np.column_stack([np.ravel(own.x), np.ravel(own.y)])
            np.testing.assert_allclose(line["points"], points[np.isfinite(points[:, 1])], atol=6e-5)
    buzz, _ = strip_of(13000.0)
    run = np.array(buzz["charts"][0]["lines"][-1]["points"])
    swing = np.ptp(run[run[:, 0] > -0.1, 1])
    assert (
        buzz["bad"]
        and buzz["state"].startswith("swings ")
        and float(buzz["state"].split()[1]) == pytest.approx(swing, rel=0.1)
    )
    assert strip_of(6000.0, pull=0.001)[0]["state"] == "outside"
    assert strip_of(13000.0, state="stopped")[0]["charts"]  # what happened before
    assert strip_of(6000.0, idle="inactive: nothing is rendered")[0] == {"state": "inactive: nothing is rendered"}


def test_the_words_at_the_hands_spring() -> None:
    shown = Snapshot(scene=Joystick(), hand=np.array([3.0, 0.0, 4.0, 0.0, 0.0, 0.0]), hand_limit=7.0)
    assert knob(shown) == {"place": pytest.approx(Joystick().hardware.knob.centre.tolist()), "words": "5.0 N"}
    assert knob(replace(shown, hand=1.4 * shown.hand))["words"] == "7.0 N, limit of the hand"


def test_rewound_alone_offers_to_resume() -> None:
    with page_of(rewound=0.0, actions=(*REWIND_ACTIONS, "pause")) as (page, source):
        for rewound, offered in ((0.0, set()), (2.0, set(REWIND_ACTIONS[1:])), (0.0, set())):
            page._panel.show(replace(source.shown, rewound=rewound))
            groups = [each for each in page._panel._buttons._children.values() if hasattr(each, "options")]
            assert {name for each in groups for name in each.options} == offered | {"pause"}


def test_coils_are_coloured_by_their_currents() -> None:
    currents = np.array([0.0, 5.0, -5.0, 10.0, -40.0, np.nan])
    with page_of(currents=currents) as (page, _):
        colours = [page._stage._coils[coil].color for coil in range(6)]
    assert colours[0] == colours[5] and colours[1] == colours[2] and colours[3] == colours[4] == (255, 13, 13)
    assert len(set(colours)) == 3 and colours[0][0] < colours[1][0] and colours[0][1] < colours[1][1]


def test_each_live_parameter_of_a_scene_has_a_control() -> None:
    asked: list[Any] = []
    with served() as server:
        for name in (*BUILT_IN, "scripts/examples/detents.py"):
            scene = find_scene(name)()
            for one in filter(lambda one: one.live, scene.parameters()):
                made = control(server.gui, one, scene, lambda kind, given: asked.append(given))
                assert (made is None) == (one.kind is object)
                if made is None:
                    continue
                value = getattr(scene, one.name)
                made.show(value)
                assert made.value(made.handle.value) == pytest.approx(value)  # what is shown is what is in force
                if isinstance(made, Slider):  # what is asked for is what is typed, for the scene to refuse
                    for typed in (made.handle.min, made.handle.max, 1e9, -1.0, 0.5):
                        assert made.to_input(made.value(typed)) == pytest.approx(typed)
    assert asked == []  # nothing is changed by showing it


class Typed(Scene):
    """Parameters of every kind."""

    name = "typed"
    mode: str = param("way", default="soft", choices=("soft", "hard"), live=True)
    count: int = param("steps", default=3, at_least=1, at_most=8, live=True)
    share: float = param("above none", default=0.5, above=0.0, below=1.0, live=True)
    low: float = param("either side", "m", default=0.0, at_least=-0.004, at_most=0.004, live=True)
    weight: float = param("wide", "N", default=1.0, live=Turn(among=(1.0, 2.0)))

    def laws(self) -> Any:
        """Return none."""
        return []


def test_controls_match_the_parameters_declarations() -> None:
    scene = Typed()
    with served() as server:
        made = {one.name: control(server.gui, one, scene, lambda kind, given: None) for one in scene.parameters()}
        assert isinstance(made["mode"], Choice) and made["mode"].handle.options == ("soft", "hard")
        for name in ("count", "low"):
            slider = made[name]
            assert isinstance(slider, Slider)
            for end in (slider.handle.min, slider.handle.max):
                scene.replace(**{name: slider.value(end)})
        low = made["low"]
        assert low is not None and (low.handle.min, low.handle.max) == (-0.004, 0.004)
        assert made["period"] is not None and made["period"].handle.value == "200 Hz"
        made["period"].show(1.0 / 300.0)
        assert made["period"].handle.value == "300 Hz" and made["period"].value("300 Hz") == 1.0 / 300.0
        assert "at most 8" in str(made["count"] and made["count"].handle.hint)
        joystick = Joystick()
        stiffness = control(server.gui, joystick.parameter("stiffness"), joystick, lambda kind, given: None)
        assert isinstance(stiffness, Slider) and stiffness.handle.max == 20_000.0
        stiffness.show(30_000.0)  # by a key
        assert stiffness.handle.max >= 30_000.0 and stiffness.handle.value == 30_000.0
        stiffness.show(50.0)  # by a program
        assert stiffness.handle.min == stiffness.handle.value == 50.0
        assert type(control(server.gui, joystick.parameter("wall"), joystick, lambda *_: None)) is Control


def test_a_read_only_page_has_neither_hand_nor_sliders() -> None:
    snapshot = Snapshot(scene=Joystick(), actions=(*Session().actions, EMERGENCY_STOP))
    with served() as server:
        page = Page(server, Recorder(snapshot), drag=False, settings=False)
        assert page._grab is None and page._panel._controls == [] and not page._stage.knob._impl.drag_cb
    with page_of() as (page, _):
        assert page._grab is not None and len(page._panel._controls) > 5 and page._stage.knob._impl.drag_cb


def test_every_action_has_a_key_and_a_button_of_its_own() -> None:
    """Else the first free key of a scene's switches is bound to it, another one in each scene."""
    session = Session("joystick")
    own = {name for name in session.actions if name not in actions(Joystick) and not name.startswith(SCENE_PREFIX)}
    own |= {*ACTIONS, "next", "back"}
    bound, shown = {key.action for key in _KEYS}, {name for row in panel._ROWS.values() for name in row}
    assert own - bound == {"resume from here"}, "give each action a line in _KEYS of window/keys.py"
    others = {"next scene": "a list", "rewind": "a slider", EMERGENCY_STOP: "beside the banner"}
    assert own - shown == {*others}, "give each action a button in _ROWS of page/panel.py"
    page = (Path(__file__).parents[2] / "docs/reference/viewer.md").read_text(encoding="utf-8")
    table = page.partition("## Keys")[2].partition("## Readings")[0]
    named = {*re.findall(r"[^\s,|]+", table)}
    assert {key.name.split()[0] for key in _KEYS} - named == {"Esc"}, "name each key in docs/reference/viewer.md"


def test_the_page_of_a_recording_has_a_time_slider_and_a_button_per_action() -> None:
    source = Recorder(Snapshot(scene=Joystick(), duration=4.0, time=1.0, actions=ACTIONS))
    with served() as server:
        page = Page(server, source, drag=False, settings=False)
        made = page._panel._time
        assert made is not None and (made.name, made.handle.value, made.value(made.handle.max)) == ("time", 1.0, 4.0)
        groups = [each for each in page._panel._buttons._children.values() if hasattr(each, "options")]
        assert sorted(name for each in groups for name in each.options) == sorted(ACTIONS)


@pytest.mark.parametrize("watch", [True, False])
def test_a_read_only_viewer_accepts_only_an_emergency_stop(watch: bool) -> None:
    # Whatever its process sends.
    viewer, stopped = ViewerHere(Joystick(), watch=watch), list[int]()
    viewer.on_emergency = lambda: stopped.append(1)
    viewer.window.hand.target = [1e-3] * 6
    viewer.window.tick(0.0)
    viewer.window.act(EMERGENCY_STOP)
    viewer.window.change({"stiffness": 3000.0})
    viewer.window.act("wall")
    request = viewer.take()
    assert stopped == [1]
    assert (request is None) == watch and (viewer.hand.target is None) == watch


def test_a_target_is_interpolated_and_released_on_timeout() -> None:
    now, hand = [10.0], SpringHand()
    glide = Glide(lambda: now[0])

    def moved(seconds: float = 0.0) -> Any:
        now[0] += seconds
        glide.move(hand)
        return hand.target

    hand.target = [9.0] * 6
    assert moved() == [9.0] * 6  # nobody here holds it
    glide.aim([0.0] * 6)
    assert moved() == [0.0] * 6
    now[0] += 0.05
    glide.aim([1.0] * 6)
    shares = [moved(), *(moved(0.0125) for _ in range(5))]
    assert [share[0] for share in shares] == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0, 1.0])
    now[0] += 0.2
    glide.aim([2.0] * 6)  # after a pause it takes no longer
    assert moved(0.025) == pytest.approx([1.5] * 6)
    assert moved(SILENCE) is None
    hand.target = [9.0] * 6
    assert moved() == [9.0] * 6
    for target in ([0.0] * 6, None, [0.0] * 6, [float("nan")] * 6, [0.0] * 6, [0.0] * 5 + [1e308]):
        glide.aim(target)
        assert (moved() is not None) == (target == [0.0] * 6)


def test_a_held_target_is_resent() -> None:
    near, far = Pipe()
    page = RemoteSession(far, Snapshot(scene=Joystick()))
    page.hand.target = [1e-3] * 6
    now = [10.0]
    page._due = FrameClock(SILENCE / 5.0, lambda: now[0])
    while now[0] < 10.0 + SILENCE:
        page.tick(0.0)
        now[0] += 0.01
    said = [near.recv() for _ in iter(near.poll, False)]
    assert 3 <= len(said) <= 8 and set(map(str, said)) == {str(("hand", [1e-3] * 6))}


CAMERA: dict[str, Any] = {
    **{"wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 0.0, 0.0], "fov": 1.0, "near": 0.01, "far": 10.0},
    **{"image_height": 100, "image_width": 100, "look_at": [0.0, 0.0, 0.0], "up_direction": [0.0, 0.0, 1.0]},
}
FROZEN = """
import json, sys, msgspec
from websockets.sync.client import connect
port, version, camera = sys.argv[1:]
line = connect(f"ws://127.0.0.1:{port}", origin=f"http://127.0.0.1:{port}", subprotocols=[f"viser-v{version}"])
line.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage", **json.loads(camera)}))
drag = {"phase": "start", "name": "/flotor/knob", "instance_index": None, "start_position": [0.0, 0.0, 0.08],
    "start_screen_pos": [0.5, 0.5], "end_position": [0.001, 0.0, 0.08], "end_screen_pos": [0.5, 0.5],
    "button": "left", "modifier": None, "owner": ""}
line.send(msgspec.msgpack.encode({"type": "SceneNodeDragMessage", **drag}))
print("holds", flush=True)
for message in line:
    pass
"""


@pytest.mark.machine
def test_the_first_browser_has_the_hand_until_it_stops_responding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A person who holds still says nothing; a browser that answers is there. On a busy machine it answers late.
    silence = 4.0 * SILENCE
    monkeypatch.setattr("maglev_mj.views.page.stage.SILENCE", silence)
    source = Recorder(Snapshot(scene=Joystick()))
    with served() as server, contextlib.ExitStack() as last:
        page = Page(server, source, drag=True, settings=True)
        words = [sys.executable, "-c", FROZEN, str(server.get_port()), viser.__version__, json.dumps(CAMERA)]
        children = []
        for place in range(2):
            child = last.enter_context(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
            last.callback(child.kill)
            assert child.stdout is not None and child.stdout.readline() == "holds\n"
            children.append(child)
            until(page, lambda: source.hand.target is not None and len(server.get_clients()) == place + 1)  # noqa: B023
        holder = page._grab._holder if page._grab is not None else None
        assert holder == min(server.get_clients())  # the second did not get it
        assert source.hand.target[0] == pytest.approx(0.001)  # type: ignore[index]
        end = time.monotonic() + 1.5 * silence
        while time.monotonic() < end:
            page._apply()
            assert source.hand.target is not None  # held still, and held
            time.sleep(0.02)
        os.kill(children[0].pid, signal.SIGSTOP)
        until(page, lambda: source.hand.target is None)
        assert holder in server.get_clients()  # it was not noticed by its connection
        os.kill(children[0].pid, signal.SIGCONT)
        until(page, lambda: source.hand.target is not None)
        children[0].kill()
        until(page, lambda: source.hand.target is None)


def grab_of(aimed: list[Any], server: Any = None, device: str = "ubc") -> Grab:
    """Return a grab of a knob by browsers that answer late."""
    knob = SimpleNamespace(on_drag=lambda button, modifier: lambda callback: callback)
    grab = Grab(server, knob, aimed.append, Joystick(device=device))
    if server is None:
        grab._ping = lambda client: asyncio.sleep(10.0)  # type: ignore[method-assign]
    return grab


def drag(phase: str, client: int = 1, end: Any = (0.0, 0.0, 0.08), modifier: str | None = None) -> Any:
    """Return a browser's event, of a drag from the knob's place."""
    place = np.array([0.0, 0.0, 0.08])
    return SimpleNamespace(
        phase=phase, client_id=client, modifier=modifier, start_position=place, end_position=np.array(end)
    )


def test_only_the_holder_moves_the_knob_and_a_disconnected_one_releases_it() -> None:
    aimed: list[Any] = []

    async def drags() -> None:
        grab = grab_of(aimed)
        await grab._dragged(drag("start"))
        said = len(aimed)
        for phase in ("start", "move", "end"):
            await grab._dragged(drag(phase, 2))
        for keys in ("+x", ""):
            await grab.push(SimpleNamespace(client_id=2, target=SimpleNamespace(value=keys)))
        assert len(aimed) == said and aimed[-1] is not None
        await grab._dragged(drag("end"))
        assert aimed[-1] is None
        # the end of a drag is lost where it comes after its connection
        grab = grab_of(aimed, SimpleNamespace(_websock_server=SimpleNamespace(_live_connections={})))
        await grab._dragged(drag("start"))
        await asyncio.sleep(0.05)
        assert aimed[-1] is None
        await grab._dragged(drag("start", 2))
        assert aimed[-1] is not None  # the next one has it

    asyncio.run(drags())


@pytest.mark.parametrize("device", ["ubc", "stage"])
def test_a_drag_with_shift_tilts_about_the_centre(device: str) -> None:
    aimed: list[Any] = []
    moved = np.array([1e-3, -2e-3, 0.0])

    async def drags(modifier: str | None) -> None:
        grab = grab_of(aimed, device=device)
        grab.pose = np.array([1e-3, 0.0, 2e-3, 0.01, 0.0, 0.0])
        for phase, way in (("start", 0.0), ("move", 1.0), ("end", 1.0)):
            await grab._dragged(drag(phase, 1, [0.0, 0.0, 0.08] + way * moved, modifier))

    asyncio.run(drags("shift"))
    assert aimed[-1] is None and aimed[1] == pytest.approx([1e-3, 0.0, 2e-3, 0.01, 0.0, 0.0])
    # the knob's displacement is the rotation times its place on the handle: r x g = moved, across the handle
    turn, grip = np.array(aimed[2][3:]) - [0.01, 0.0, 0.0], Device.load(device).knob.centre
    assert aimed[2][:3] == pytest.approx([1e-3, 0.0, 2e-3]) and turn @ grip == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(np.cross(turn, grip), moved, atol=1e-12)
    asyncio.run(drags(None))
    assert aimed[-2] == pytest.approx([2e-3, -2e-3, 2e-3, 0.01, 0.0, 0.0])


@pytest.mark.parametrize(("device", "reach"), [("ubc", 0.0135), ("stage", 0.006)])
def test_an_arrow_key_moves_the_target_by_three_ranges_of_the_device(device: str, reach: float) -> None:
    aimed: list[Any] = []

    async def push() -> None:
        await grab_of(aimed, device=device).push(SimpleNamespace(client_id=1, target=SimpleNamespace(value="+x-z")))

    asyncio.run(push())
    assert aimed[-1] == pytest.approx([reach, 0.0, -reach, 0.0, 0.0, 0.0])


def waited(done: Callable[[], Any]) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < end
        time.sleep(0.01)


def until(page: Page, done: Any) -> None:
    """Run the page's requests until a condition holds."""

    def applied() -> Any:
        page._apply()
        return done()

    waited(applied)


@pytest.mark.machine
def test_ctrl_c_ends_a_page_with_its_report() -> None:
    """Which is how it ends, and no failure."""
    with started("view", "--web", "--no-open", "--port", "0") as program:
        url = program.wait_for(r"web page: (http://127\.0\.0\.1:\d+)\S*\s")

        def answered() -> bool:
            with contextlib.suppress(OSError):
                return requested(url) == 200
            return False

        waited(answered)
        ended = program.end()
    assert (ended.status, ended.errors) == (0, "") and re.search(r"control ticks, \d+ skipped", ended.output)


def requested(url: str) -> int:
    """Return the status of a page."""
    line = http.client.HTTPConnection(url.removeprefix("http://"), timeout=PATIENCE)
    with closing(line):
        line.request("GET", "/")
        return line.getresponse().status
