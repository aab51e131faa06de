"""The pose stream: what hosts hear, what they may set and when it acts, who is let in, and the page that says so."""

from __future__ import annotations

import hashlib
import json
import math
import os
import random
import re
import runpy
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from copy import copy
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES
from maglev_mj.errors import ParameterError
from maglev_mj.hand import SpringHand
from maglev_mj.laws import Hold
from maglev_mj.net.udp import LinkError, UdpServer
from maglev_mj.process import SideProcess
from maglev_mj.scenes import Scene, find_scene
from maglev_mj.scenes.box import Box
from maglev_mj.scenes.corner import Corner
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.joystick import Joystick
from maglev_mj.scenes.parts import INERTIA, MASS
from maglev_mj.scenes.table import Table
from maglev_mj.session import Pacer, Session, Snapshot, refusal
from maglev_mj.spec import RANGE
from maglev_mj.stream import PoseStream, StreamClient, StreamError
from maglev_mj.stream.datagrams import MOST_ANSWERED, MOST_ASKED, Datagrams, Guard
from maglev_mj.stream.hosts import MOST_SUBSCRIBERS, SUBSCRIBED, Hosts, checked
from maglev_mj.stream.messages import description, pose_message
from maglev_mj.stream.stream import LONGEST_CHECK
from maglev_mj.theory import is_stable, largest_modulus, largest_stable_stiffness

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "stream.md").read_text(encoding="utf-8")
KEY = bytes(range(32))
ANY = "udp://127.0.0.1:0"
HERE = ("127.0.0.1", 9)
SETTABLE = ("wall", "pulse", "friction", "weightless", "stiffness", "damping", "breakaway", "walls")
FRAME = 1.0 / 60.0


def snapshot(scene: Scene | None = None, **changes: Any) -> Snapshot:
    """Return a snapshot of a scene at rest; the joystick by default."""
    scene = scene or Joystick()
    told: dict[str, Any] = {
        "scene": scene,
        "delay": scene.delay,
        "tick": 5,
        "time": 0.025,
        "faces": scene.controller().faces,
    }
    return Snapshot(**told | changes)


class Here(Hosts):
    """Hosts whose sets are checked here, at once."""

    def __init__(self, *shown: Snapshot, **options: Any) -> None:
        super().__init__(**options)
        self._scene: Scene | None = None
        self.last = snapshot()
        for one in shown:
            self.show(one)

    def show(self, one: Snapshot, answer: int | str | None = None) -> Any:
        self.last = one
        return super().show(one, answer)

    def answers(self, data: bytes, address: Any) -> Any:
        said = super().answers(data, address)
        while (task := self.to_check()) is not None:
            verdict = checked(*task)
            self._scene = verdict if isinstance(verdict, Scene) else self._scene
            said = said + self.settle(verdict)
        return said

    def take(self) -> Scene | None:
        """Return what was handed over, once."""
        scene, self._scene = self._scene, None
        return scene


def asking(stream: Hosts, address: Any = HERE, **message: Any) -> list[tuple[dict[str, Any], Any]]:
    """Return what is said to a message, and to whom."""
    return stream.answers(json.dumps(message).encode(), address)


def answer(stream: Hosts, **message: Any) -> dict[str, Any]:
    """Return the one thing that is said."""
    ((said, address),) = asking(stream, **message)
    assert address == HERE
    return said


def asked(stream: Here, **settings: Any) -> tuple[dict[str, Any], Scene | None]:
    """Return what is said to a set, and the scene that a loop takes and answers from sample 7 on."""
    said = asking(stream, type="set", settings=settings)
    scene = stream.take()
    if scene is not None:
        assert not said
        said = stream.show(stream.last, 7)
    ((message, _),) = said
    return message, scene


class SideThread:
    """A thread in place of a process."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.line, far = Pipe()
        self.ended, self._ready, self._mine = False, True, [far]
        own = [self._own(one) for one in arguments]
        self._thread = threading.Thread(target=self._run, args=(function, far, own), daemon=True)
        self._thread.start()

    ready, send, received = SideProcess.ready, SideProcess.send, SideProcess.received

    def close(self, patience: float = 10.0) -> None:
        self.ended = True
        self.line.close()
        self._thread.join(patience)

    @staticmethod
    def _run(function: Any, far: Any, arguments: list[Any]) -> None:
        function(far, *arguments)
        far.close()

    @staticmethod
    def _own(one: Any) -> Any:
        """Return a socket of the thread's own, as a process gets one."""
        if isinstance(one, UdpServer):
            one = copy(one)
            one._socket = one._socket.dup()
            one._socket.setblocking(False)
        return one


@pytest.fixture(autouse=True)
def threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let threads do what processes of their own do, except in tests of those."""
    if "processes" not in request.fixturenames:
        monkeypatch.setattr("maglev_mj.stream.stream.SideProcess", SideThread)
        monkeypatch.setattr("maglev_mj.stream.stream._NICE", 0)


@pytest.fixture
def processes() -> None:
    """Leave processes as they are."""


@contextmanager
def streaming(*shown: Snapshot, **options: Any) -> Iterator[PoseStream]:
    """Yield a stream that was shown some snapshots, without a scene."""
    with closing(PoseStream(ANY, **options)) as stream:
        for one in shown:
            stream.show(one)
        yield stream


def url(stream: PoseStream) -> str:
    return f"udp://127.0.0.1:{stream.address[1]}"


@contextmanager
def plain(stream: PoseStream) -> Iterator[socket.socket]:
    """Yield a host that knows nothing of this package."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.connect(stream.address)
        host.settimeout(5.0)
        yield host


def heard(host: socket.socket, *types: str) -> dict[str, Any]:
    """Return the next datagram of a type."""
    while (said := json.loads(host.recv(MOST_ANSWERED)))["type"] not in types:
        pass
    result: dict[str, Any] = said
    return result


class Running:
    """A session that goes on by one tick at a time, in a thread, at about its own rate."""

    def __init__(self, session: Session, period: float) -> None:
        self.session, self.scenes, self._period = session, list[Scene](), period
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._go_on)

    def __enter__(self) -> Running:
        self.session.tick(0.0)  # tells of the start
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()
        self.session.close()

    def _go_on(self) -> None:
        while not self._stopped.wait(self._period):
            if self.session.tick(self._period):
                self.scenes.append(self.session.snapshot().scene)  # that answered this sample


def running(stream: PoseStream, *, period: float = 0.005, **options: Any) -> Running:
    scene = Joystick(period=period, delay=min(0.0015, period))
    pacer = Pacer(budget=60.0, patience=3600.0)
    return Running(Session(scene, pacer=pacer, publishers=[stream], **options), period)


# what hosts hear


def test_poses_arrive_with_the_values_of_the_session() -> None:
    stream = PoseStream(ANY)
    hand = SpringHand(target=[0.016, 0.0, -0.01, 0.0, 0.1, 0.0])
    session = Session(Joystick(friction=True), hand=hand, pacer=Pacer(budget=60.0), publishers=[stream])
    with closing(session), plain(stream) as host:
        host.send(b'{"type":"subscribe"}')
        heard(host, "subscribed")
        seen, tick = {}, 0
        for _ in range(60):
            time.sleep(FRAME)
            tick += session.tick(FRAME)
            seen[tick] = session.snapshot()
        told = [heard(host, "pose") for _ in range(30)]
    assert len({pose["tick"] for pose in told}) == 30
    for pose in told:
        view = seen[pose["tick"]]
        assert list(pose["pose"]) == list(AXES)
        assert list(pose["pose"].values()) == view.pose.tolist()
        assert list(pose["force"].values()) == view.force.tolist()
        assert list(pose["hand"].values()) == view.hand.tolist()
        assert view.anchors is not None
        assert [math.nan if one is None else one for one in pose["stuck"].values()] == pytest.approx(
            view.anchors.tolist(), abs=0.0, nan_ok=True
        )
        assert (pose["time"], pose["state"], pose["missed"]) == (view.time, "running", 0)
    assert any(None in pose["stuck"].values() for pose in told)
    assert np.ptp([pose["pose"]["x"] for pose in told]) > 1e-4


def test_what_is_no_number_is_null() -> None:
    strange = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-310)
    with streaming() as stream, plain(stream) as host:
        host.send(b'{"type":"subscribe"}')
        heard(host, "subscribed")
        stream.show(snapshot(pose=strange, anchors=np.array(strange), reason="x" * 5000))
        data = host.recv(65536)
    assert len(data) < 1400 and b"NaN" not in data and b"Infinity" not in data
    pose = json.loads(data)
    assert list(pose["pose"].values()) == [None, None, None, 0.0, -0.0, 1e-310] == list(pose["stuck"].values())
    assert len(pose["reason"]) == 300 and pose["stuck"] is not None


def test_the_description_says_what_is_rendered() -> None:
    walls = [(axis, normal, -normal * 0.00333333333333333) for axis in AXES for normal in (1, -1)]
    scene = Joystick(walls=walls, stiffness=4321.123456789)
    said = answer(Here(snapshot(scene, tick=123456789)), type="get", id=2**53 - 1)
    assert len(json.dumps(said)) + 33 <= MOST_ANSWERED
    assert sorted(map(tuple, said["faces"])) == sorted(walls)
    assert Joystick.from_json(json.loads(json.dumps(said["settings"]))) == scene
    assert tuple(said["settable"]) == SETTABLE and set(SETTABLE) == set(scene.as_json()) - {"period", "delay"}


def test_nothing_can_be_had_before_anything_runs() -> None:
    for kind in ("get", "set"):
        assert answer(Here(), type=kind, id=1, settings={})["reason"] == "nothing runs here yet"
    with streaming() as stream:
        with StreamClient(url(stream), patience=0.2) as client, pytest.raises(StreamError, match="nothing runs"):
            client.describe()


# what hosts set


@pytest.mark.parametrize("period", [0.005, 0.001])
def test_accepted_names_the_first_sample_answered_under_the_settings(period: float) -> None:
    draw, names = random.Random(1), []
    stream = PoseStream(ANY)
    with running(stream, period=period) as one, plain(stream) as host:
        for number in range(50):
            time.sleep(draw.uniform(0.0, 0.02))
            edge, stiffness = draw.uniform(-4e-3, -1e-3), draw.uniform(2000.0, 6000.0)
            wish = {"walls": [["z", 1, edge]], "stiffness": stiffness}
            host.send(json.dumps({"type": "set", "id": number, "settings": wish}).encode())
            said = heard(host, "accepted", "refused")
            assert (said["type"], said["id"]) == ("accepted", number)
            assert one.session.snapshot().faces == ((2, 1, edge),)
            names.append((said["tick"], stiffness))
    for tick, stiffness in names:
        assert one.scenes[tick].as_json()["stiffness"] == stiffness != one.scenes[tick - 1].as_json()["stiffness"]


def test_a_wall_that_is_in_force_acts() -> None:
    stream = PoseStream(ANY)
    hand = SpringHand()
    with running(stream, hand=hand) as one, StreamClient(url(stream)) as client:
        assert client.set(walls=[["x", -1, 0.0005]], stiffness=5000, damping=60).reason == ""
        hand.target = [0.008, 0.0, 0.0, 0.0, 0.0, 0.0]
        deadline = time.monotonic() + 10.0
        for pose in client.poses():
            x = pose["pose"]["x"]
            if pose["tick"] > 350 or time.monotonic() > deadline:
                break
        assert one.session.snapshot().faces == ((0, -1, 0.0005),)
    # at rest: the wall and the scene's own spring against the hand's of 200 N/m
    assert x == pytest.approx((200.0 * 0.008 + 5000.0 * 0.0005) / (5000.0 + 300.0 + 200.0), abs=1e-6)
    assert pose["force"]["x"] == pytest.approx(-5000.0 * (x - 0.0005) - 300.0 * x, abs=2e-3)
    assert pose["hand"]["x"] == pytest.approx(200.0 * (0.008 - x), abs=2e-3)


@pytest.mark.parametrize("scene", [Box(), Joystick()])
@pytest.mark.parametrize(("axis", "normal"), [("z", 1), ("x", -1), ("ry", 1)])
def test_an_unstable_wall_is_refused_with_the_figures_of_its_loop(scene: Scene, axis: str, normal: int) -> None:
    one = snapshot(scene)
    wish = {"walls": [[axis, normal, -normal * 0.001]], "stiffness": 40000.0, "damping": 70.0}
    stream = Here(one)
    said = answer(stream, type="set", id=3, settings=wish)
    assert stream.take() is None
    assert (said["type"], said["id"]) == ("refused", 3)
    figures = said["figures"]
    index = AXES.index(axis)
    share = INERTIA[index] / MASS
    stiffness = damping = 0.0
    for law in scene.laws():
        if isinstance(law, Hold) and axis in law.axes:
            place = list(law.axes).index(axis)
            stiffness, damping = np.asarray(law.stiffness)[place], np.asarray(law.damping)[place]
    assert figures["axis"] == axis and figures["acting"] == "walls"
    assert figures["stiffness"] == pytest.approx(stiffness + 40000.0 * share, rel=1e-12)
    assert figures["damping"] == pytest.approx(damping + 70.0 * share, rel=1e-12)
    loop: Any = {"period": scene.period, "delay": scene.delay, "mass": float(INERTIA[index])}
    modulus = largest_modulus(figures["stiffness"], figures["damping"], **loop)
    assert figures["modulus"] == pytest.approx(float(modulus), rel=1e-9) and modulus > 1.0
    largest = float(largest_stable_stiffness(figures["damping"], **loop))
    assert figures["largest_stable"] == pytest.approx(largest, rel=1e-9)
    assert is_stable(largest_modulus(0.999 * largest, figures["damping"], **loop))
    assert (figures["period"], figures["delay"]) == (scene.period, scene.delay)
    assert f"{figures['modulus']:.4f}" in said["reason"] and f"{largest:.4g}" in said["reason"]


def test_an_unstable_wall_changes_nothing_in_a_session() -> None:
    stream = PoseStream(ANY)
    with running(stream) as one, StreamClient(url(stream)) as client:
        before = client.describe()
        for wish in ({"stiffness": 60000.0}, {"walls": [["z", 1, 0.0]], "stiffness": 30000.0, "damping": 10.0}):
            said = client.set(**wish)
            assert said.figures is not None and said.figures["modulus"] > 1.0
            assert said.since is None
        end = time.monotonic() + 5.0
        while (after := client.describe())["tick"] <= before["tick"]:
            assert time.monotonic() < end
        assert [after[name] for name in ("settings", "settings_since", "faces")] == [
            before[name] for name in ("settings", "settings_since", "faces")
        ]
        assert one.session.snapshot().scene == Joystick.from_json(before["settings"])


def test_half_of_what_a_refusal_names_is_accepted() -> None:
    stream = Here(snapshot(Drop()))
    figures = answer(stream, type="set", settings={"stiffness": 60000.0})["figures"]
    for share, expected in ((0.5, "accepted"), (0.999, "accepted"), (1.001, "refused")):
        assert asked(stream, stiffness=share * figures["largest_stable"])[0]["type"] == expected


def test_the_same_wall_is_stable_at_one_rate_and_refused_at_another() -> None:
    wish: Any = {"walls": [["z", 1, 0.0]], "stiffness": 20000.0, "damping": 150.0}
    for period, delay, expected in ((0.001, 0.001, "accepted"), (0.005, 0.0015, "refused"), (0.001, 0.01, "refused")):
        scene = Box(period=period, delay=delay)
        assert (refusal(scene.replace(**wish)) is None) == (expected == "accepted")
        said, taken = asked(Here(snapshot(scene)), **wish)
        assert said["type"] == expected and (taken is not None) == (expected == "accepted")


def test_settings_that_are_not_named_stay() -> None:
    stream = Here(snapshot(Joystick(friction=True, breakaway=1.5)))
    said, taken = asked(stream, damping=70, pulse=False, walls=[["rx", -1, 0.05]])
    assert (said["type"], said["tick"]) == ("accepted", 7)
    assert taken == Joystick(friction=True, breakaway=1.5, damping=70.0, pulse=False, walls=(("rx", -1, 0.05),))
    assert stream.take() is None


@pytest.mark.parametrize(
    ("wish", "reason"),
    [
        ({"period": 0.001}, "period is the device's, or the person's at the machine; a host cannot set it"),
        ({"delay": 0.0, "wall": True}, "delay is the device's, or the person's at the machine; a host cannot set it"),
        ({"stifness": 5.0, "a": 1}, f"settings must be of {', '.join(SETTABLE)}, not a, stifness"),
        ({"stiffness": 0.5}, "stiffness must be a finite number at least 1 and at most 1e+06, not 0.5"),
        ({"stiffness": "6e3"}, "stiffness must be a finite number at least 1 and at most 1e+06, not '6e3'"),
        ({"stiffness": True}, "stiffness must be a finite number at least 1 and at most 1e+06, not True"),
        ({"breakaway": None}, "breakaway must be a finite number at least 0.01 and at most 50, not None"),
        ({"damping": 10**400}, "damping must be a finite number at least 0 and at most 10000, not inf"),
        ({"wall": 1}, "wall must be True or False, not 1"),
        ({"walls": 5}, "walls must be a list of an axis, a normal and an edge each, not 5"),
        ({"walls": {}}, "walls must be a list of an axis, a normal and an edge each, not {}"),
        ({"walls": [["z", 1]]}, "a wall must be an axis, a normal and an edge, not ['z', 1]"),
        (
            {"walls": [["z", 1, "0"]]},
            "a wall's edge on z must be a finite number at least -0.0045 and at most 0.0045, not '0'",
        ),
        (
            {"walls": [["z", 1, 1.0]]},
            "a wall's edge on z must be a finite number at least -0.0045 and at most 0.0045, not 1.0",
        ),
        (
            {"walls": [["rx", -1, -0.2]]},
            "a wall's edge on rx must be a finite number at least -0.10472 and at most 0.10472, not -0.2",
        ),
        ({"walls": [[["z"], 1, 0]]}, "a wall's axis must be one of x, y, z, rx, ry, rz, not ['z']"),
        ({"walls": [["z", 0, 0]]}, "a wall's normal must be 1 or -1, not 0"),
        ({"walls": [["z", 1, 0.002], ["z", -1, 0.001]]}, "walls must leave room between them, not 0.002 to 0.001 on z"),
        ([], "settings must be an object of names and values, not []"),
        (None, "settings must be an object of names and values, not None"),
    ],
)
def test_what_cannot_be_set_is_refused_with_the_reason(wish: Any, reason: str) -> None:
    stream = Here(snapshot())
    said = answer(stream, type="set", id=9, settings=wish)
    assert said == {"type": "refused", "id": 9, "session": said["session"], "reason": reason, "figures": None}
    assert stream.take() is None


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ({}, "type must be one of get, subscribe, unsubscribe, set, not None"),
        ({"type": ["set"]}, "type must be one of get, subscribe, unsubscribe, set, not ['set']"),
        ({"type": "set", "id": -1}, "id must be an integer of 0 to 9007199254740991, not -1"),
        ({"type": "get", "id": 2**53}, f"id must be an integer of 0 to 9007199254740991, not {2**53}"),
        ({"type": "get", "id": True}, "id must be an integer of 0 to 9007199254740991, not True"),
        ({"type": "get", "id": {}}, "id must be an integer of 0 to 9007199254740991, not {}"),
    ],
)
def test_what_is_no_request_is_an_error(message: Any, reason: str) -> None:
    stream = Here(snapshot())
    said = answer(stream, **message)
    assert (said["type"], said["reason"]) == ("error", reason)
    long = answer(stream, type="x" * 1300)
    assert len(json.dumps(long)) < 500


def test_one_set_at_a_time_is_on_its_way_and_the_newest_waits() -> None:
    other, third = ("127.0.0.1", 10), ("127.0.0.1", 11)
    stream = Hosts()
    stream.show(snapshot())
    assert not asking(stream, type="set", id=1, settings={"stiffness": 3000.0})
    task = stream.to_check()
    assert task is not None and task[1] == {"stiffness": 3000.0}
    assert not asking(stream, other, type="set", id=1, settings={"damping": 50.0})
    assert stream.to_check() is None  # the first is being checked
    ((said, to),) = asking(stream, third, type="set", id=1, settings={"damping": 60.0})
    assert (said["type"], said["id"], to, said["figures"]) == ("refused", 1, other, None)
    assert said["reason"] == "replaced by a newer set before it was in force"
    verdict = checked(*task)
    assert verdict == Joystick(stiffness=3000.0) and not stream.settle(verdict)
    assert stream.to_check() is None  # the loop has not answered
    assert not stream.show(snapshot())
    ((said, to),) = stream.show(snapshot(Joystick(stiffness=3000.0)), 6)
    assert (said["type"], said["tick"], to) == ("accepted", 6, HERE)
    task = stream.to_check()
    assert task is not None and checked(*task) == Joystick(stiffness=3000.0, damping=60.0)


def test_a_set_that_is_sent_again_is_not_done_again() -> None:
    stream = Here(snapshot())
    wish = {"type": "set", "id": 5, "settings": {"stiffness": 3000.0}}
    for _ in range(3):
        assert not asking(stream, **wish)
    wanted = stream.take()
    assert wanted is not None
    ((done, _),) = stream.show(snapshot(wanted, since=6, tick=7), 6)
    assert done == {"type": "accepted", "id": 5, "session": done["session"], "tick": 6}
    assert answer(stream, **wish) == done and stream.take() is None
    assert not asking(stream, **{**wish, "settings": {"stiffness": 3500.0}})  # the same id, another wish
    taken = stream.take()
    assert taken is not None and taken.as_json()["stiffness"] == 3500.0
    stream.show(snapshot(taken), 8)
    refused = {"type": "set", "id": 9, "settings": {"stiffness": 60000.0}}
    assert answer(stream, **refused) == answer(stream, **refused)
    assert answer(stream, **wish) == done  # though others came between


def test_what_the_loop_refuses_is_told() -> None:
    stream = Here(snapshot())
    asking(stream, type="set", id=5, settings={"stiffness": 3000})
    assert stream.take() is not None
    ((said, to),) = stream.show(snapshot(), "settings must not")
    assert (said["type"], said["id"], said["reason"], to) == ("refused", 5, "settings must not", HERE)
    assert said["figures"] is None


def test_settings_that_would_push_the_flotor_are_refused_in_a_session() -> None:
    stream = PoseStream(ANY)
    hand = SpringHand(target=[0.008, 0.0, 0.0, 0.0, 0.0, 0.0])  # holds it at 3.2 mm
    with running(stream, hand=hand) as one, StreamClient(url(stream)) as client:
        while one.session.snapshot().pose[0] < 3e-3:
            time.sleep(0.01)
        before = client.describe()
        said = client.set(walls=[["x", -1, 0.001]])
        assert said.since is None and said.figures is None
        assert re.fullmatch(
            r"settings must change the force on x, where the flotor is, by at most 2 N, not -1\d\.\d N", said.reason
        )
        assert client.describe()["settings_since"] == before["settings_since"]
        assert client.set(walls=[["x", -1, 0.004]]).reason == ""
        assert one.session.snapshot().state == "running"


def test_a_set_is_checked_at_the_delay_that_is_measured() -> None:
    wish = {"stiffness": 9000.0}
    for delay, expected in ((0.0, "accepted"), (0.0015, "accepted"), (0.003, "refused"), (0.2, "refused")):
        stream = Here(snapshot(Box(), delay=delay))
        said, taken = asked(stream, **wish)
        assert said["type"] == expected
        assert answer(stream, type="get")["delay"] == delay
        if expected == "accepted":
            assert taken is not None and taken.delay == Box().delay
        if delay == 0.003:
            assert said["figures"]["delay"] == delay
        if delay == 0.2:
            assert said["reason"] == "delay must be a finite number at least 0 and at most 0.1, not 0.2"


def test_a_set_is_checked_with_the_flotor_of_the_device() -> None:
    """A calibration knows its mass: a light flotor is unstable where the usual one is not."""
    for mass, expected in ((0.7, "accepted"), (0.35, "refused")):
        body = [mass] * 3 + [1e-3] * 3
        assert asked(Here(snapshot(Drop(), inertia=body)), stiffness=6000.0)[0]["type"] == expected


def test_a_paused_session_takes_settings_too() -> None:
    stream = PoseStream(ANY)
    one = running(stream)
    one.session.act("pause")
    with one, StreamClient(url(stream)) as client:
        said = client.set(walls=[["y", 1, -0.001]])
        assert (said.reason, said.since) == ("", 0)
        assert client.describe()["faces"] == [["y", 1, -0.001]]
        assert next(client.poses())["state"] == "paused"


def test_settings_that_are_accepted_are_stable_and_legal_ones_never_raise() -> None:
    draw, kinds, stream = random.Random(3), [], Here()
    for _ in range(150):
        cls = draw.choice((Joystick, Table, Box, Corner))
        present: Scene = cls(period=draw.choice((5e-3, 1e-3)), delay=draw.uniform(0.0, 5e-3))
        stream.show(snapshot(present))
        wish: dict[str, Any] = {name: draw.random() < 0.5 for name in ("wall", "friction", "pulse", "weightless")}
        wish |= {"stiffness": 10 ** draw.uniform(0, 6), "damping": 10 ** draw.uniform(-2, 4)}
        if draw.random() < 0.5:
            reaches = zip(AXES, RANGE, strict=True)
            wish["walls"] = [[axis, 1, draw.uniform(-reach, reach)] for axis, reach in reaches if draw.random() < 0.5]
        said, wanted = asked(stream, **wish)
        kinds.append(said["type"])
        if said["type"] == "accepted":
            assert wanted is not None and refusal(wanted) is None
        else:
            assert said["figures"] is None or said["figures"]["modulus"] >= 1.0 - 1e-9
    assert min(kinds.count(kind) for kind in ("accepted", "refused")) > 10


# processes of its own

ODD = """
import os, time
from pathlib import Path
from maglev_mj.laws import Hold
from maglev_mj.parameters import param
from maglev_mj.scenes import Scene, find_scene

class Odd(Scene):
    stiffness: float = param("stiffness", "N/m", default=1000.0, live=True)
    ends: bool = param("ends the process", default=False, live=True)
    def laws(self):
        with Path(__file__).with_name("processes").open("a") as file:
            file.write(f"{os.getpid()}\\n")
        if self.ends:
            os._exit(3)
        return [Hold(stiffness=self.stiffness, damping=20.0)]
"""


@pytest.fixture
def odd_scene(tmp_path: Path) -> Scene:
    """Return a scene that notes which processes make its laws."""
    (tmp_path / "odd.py").write_text(ODD)
    return find_scene(str(tmp_path / "odd.py"))()


@pytest.mark.usefixtures("processes")
def test_sets_are_checked_in_another_process_and_refused_where_that_dies(odd_scene: Scene, tmp_path: Path) -> None:
    noted = tmp_path / "processes"
    patience = 0.9 * LONGEST_CHECK  # it is said before the check's time is over
    with closing(PoseStream(ANY)) as stream, StreamClient(url(stream), patience=patience) as client:
        stream.show(snapshot(odd_scene))
        noted.unlink()
        for wish, said in (
            ({"stiffness": 1e5}, "must be below 1"),
            (
                {"ends": True},
                "it is not known whether the settings would be stable: the process that checks them has ended",
            ),
            ({"stiffness": 1e5}, "must be below 1"),
        ):
            assert said in client.set(**wish).reason
        assert stream.take() is None
        checkers = set(noted.read_text().split())
        assert len(checkers) == 2 and str(os.getpid()) not in checkers
        client.describe()


@pytest.mark.usefixtures("processes")
def test_a_scene_goes_on_where_the_process_of_its_stream_dies() -> None:
    stream = PoseStream(ANY)
    with running(stream) as one, StreamClient(url(stream), patience=5.0) as client:
        assert client.set(stiffness=4000.0).reason == ""
        stream._process._process.kill()
        stream._process._process.join()
        done = len(one.scenes)
        while len(one.scenes) < done + 50:
            time.sleep(0.01)
        assert one.session.snapshot().state == "running"
    assert stream.take() is None


@pytest.mark.parametrize("calls", [("send",), ("received", "send")])
def test_what_is_sent_to_a_process_that_has_ended_is_lost(calls: Sequence[str]) -> None:
    process = SideProcess(repr)
    process._process.join()
    for call in calls:
        assert call != "received" or list(process.received()) == []
        process.send(1)
        assert process.ended and not process.ready and list(process.received()) == []
    process.close()
    process.close()


@pytest.mark.usefixtures("processes")
def test_a_stream_in_a_script_without_a_guard_is_one_line(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from maglev_mj.stream import PoseStream\nfrom maglev_mj.errors import MaglevError\n"
        f"try:\n    PoseStream({ANY!r})\nexcept MaglevError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout.splitlines()[-1].endswith('a script that opens one needs `if __name__ == "__main__":`')


@pytest.mark.usefixtures("processes")
def test_no_process_is_left_where_the_program_is_killed() -> None:
    code = f"""if __name__ == "__main__":
    import time
    from maglev_mj.stream import PoseStream
    stream = PoseStream({ANY!r})
    print(stream._process._process.pid, flush=True)
    time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        own = int(program.stdout.readline())
        program.kill()
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline:
            try:
                os.kill(own, 0)
                if "Z" in Path(f"/proc/{own}/stat").read_text().split()[2]:
                    return
            except (ProcessLookupError, FileNotFoundError):
                return
            time.sleep(0.05)
    pytest.fail("it goes on")


def test_a_check_that_does_not_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(one: Snapshot, given: Any) -> Any:
        if given == {"stiffness": 4000.0}:
            time.sleep(0.7)
        return checked(one, given)

    monkeypatch.setattr("maglev_mj.stream.stream.LONGEST_CHECK", 0.3)
    monkeypatch.setattr("maglev_mj.stream.stream.checked", endless)
    with running(stream := PoseStream(ANY)), StreamClient(url(stream), patience=5.0) as client:
        said = client.set(stiffness=4000.0).reason
        assert said == "it is not known whether the settings would be stable: their check takes over 0.3 s"
        assert client.set(stiffness=3000.0).reason == ""


def test_a_set_that_cannot_be_checked_is_refused() -> None:
    class Odd(Joystick):
        """Its laws fail under some settings."""

        def own_laws(self) -> Any:
            return {False: super().own_laws()}[self.friction]

    said = answer(Here(snapshot(Odd())), type="set", settings={"friction": True})
    assert said["reason"] == "the settings cannot be checked: KeyError: True"


def test_a_scene_that_the_stream_does_not_find_is_said() -> None:
    class Nowhere(Joystick):
        """Is in no module."""

    with streaming(snapshot(Nowhere())) as stream, StreamClient(url(stream), patience=0.5) as client:
        with pytest.raises(StreamError, match=r"the scene is not known here: .*Nowhere"):
            client.describe()


# subscribers


def test_two_hosts_hear_the_same_and_each_sees_what_the_other_sets() -> None:
    stream = PoseStream(ANY)
    with running(stream), StreamClient(url(stream)) as one, StreamClient(url(stream)) as other:
        said = one.set(stiffness=4000.0)
        heard_by = []
        for client in (one, other):
            poses = client.poses()
            heard_by.append({pose["tick"]: pose for pose in (next(poses) for _ in range(20))})
            assert all(pose["settings_since"] == said.since for pose in heard_by[-1].values())
        more = {pose["tick"]: pose for pose, _ in zip(one.poses(), range(40))}
        shared = set(more) & set(heard_by[1])
        assert shared and all(more[tick] == heard_by[1][tick] for tick in shared)
        assert other.set(stiffness=3000.0).reason == ""
        assert one.describe()["settings"]["stiffness"] == 3000.0


def test_a_host_that_vanishes_is_forgotten() -> None:
    now, stays, gone = [0.0], ("127.0.0.1", 10), ("127.0.0.1", 11)
    stream = Hosts(clock=lambda: now[0])

    def told(tick: int) -> list[Any]:
        said = stream.show(snapshot(tick=tick))
        assert all(message["tick"] == tick for message, _ in said)
        return [address for _, address in said]

    for address in (stays, gone):
        asking(stream, address, type="subscribe")
    assert told(1) == [stays, gone]
    now[0] = 0.9 * SUBSCRIBED
    asking(stream, stays, type="subscribe")
    now[0] = 1.1 * SUBSCRIBED
    assert told(2) == [stays] == [address for _, address in stream.end()]
    asking(stream, stays, type="unsubscribe")
    assert told(3) == []


def test_what_cannot_be_sent_is_counted_and_the_others_hear(monkeypatch: pytest.MonkeyPatch) -> None:
    real = Hosts.answers
    forged = [("127.0.0.1", 0), ("255.255.255.255", 9)]  # nothing can be sent there

    def answers(hosts: Hosts, data: bytes, address: Any) -> Any:
        for one in forged:
            real(hosts, b'{"type":"subscribe"}', one)
        return real(hosts, data, address)

    monkeypatch.setattr(Hosts, "answers", answers)
    with streaming() as stream, plain(stream) as host:
        host.send(b'{"type":"subscribe"}')
        heard(host, "subscribed")
        for tick in range(3):
            stream.show(snapshot(tick=tick))
            assert heard(host, "pose")["tick"] == tick
        host.send(b'{"type":"get"}')
        assert heard(host, "description")["dropped"] == {"unsent": 6}


def test_there_is_room_for_so_many_subscribers() -> None:
    now = [0.0]
    stream = Hosts(clock=lambda: now[0])
    places = [(f"127.0.1.{place}", 9) for place in range(MOST_SUBSCRIBERS + 1)]
    kinds = [asking(stream, place, type="subscribe")[0][0]["type"] for place in places]
    assert kinds == ["subscribed"] * MOST_SUBSCRIBERS + ["refused"]
    assert "16 subscribers already" in asking(stream, places[-1], type="subscribe")[0][0]["reason"]
    assert asking(stream, places[0], type="subscribe")[0][0]["type"] == "subscribed"
    now[0] = SUBSCRIBED + 0.1
    assert asking(stream, places[-1], type="subscribe")[0][0]["type"] == "subscribed"


def test_a_client_that_is_not_let_in_says_so() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as fake:
        fake.bind(("127.0.0.1", 0))
        fake.settimeout(5.0)
        with StreamClient(f"udp://127.0.0.1:{fake.getsockname()[1]}") as client:

            def serve() -> None:
                for message in (description(snapshot(), 8, None), {"type": "refused", "session": 8, "figures": None}):
                    data, address = fake.recvfrom(2048)
                    told = {**message, "id": json.loads(data)["id"], "reason": "there are 16 subscribers already"}
                    fake.sendto(json.dumps(told).encode(), address)

            server = threading.Thread(target=serve)
            server.start()
            with pytest.raises(StreamError, match="16 subscribers already"):
                next(client.poses())
            server.join()


def test_a_closed_stream_says_so() -> None:
    stream = PoseStream(ANY)
    with running(stream) as one, StreamClient(url(stream)) as client:
        poses = client.poses()
        next(poses)
        threading.Timer(0.1, one._stopped.set).start()
        one._thread.join()
        one.session.close()
        assert len(list(poses)) < 100
    stream.close()


def test_a_client_says_in_one_line_that_nobody_answers() -> None:
    with closing(PoseStream(ANY)) as stream:
        where = url(stream)
    with StreamClient(where, patience=0.3) as client:
        for call in (client.describe, lambda: client.set(wall=True), lambda: next(client.poses())):
            with pytest.raises(StreamError, match=f"nobody answers at {where}") as error:
                call()
            assert "\n" not in str(error.value)
    with streaming(snapshot()) as stream, StreamClient(url(stream), patience=0.3) as client:
        with pytest.raises(StreamError, match="no pose from"):
            next(client.poses())


@pytest.mark.parametrize("make", [PoseStream, StreamClient])
@pytest.mark.parametrize(
    ("where", "key", "complaint"),
    [
        ("udp://0.0.0.0:5680", None, "a key be given"),
        ("udp://192.0.2.1:5680", None, "a key be given"),
        ("udp://127.0.0.1:5680", b"short", "16 to 32 bytes"),
        ("serial:///dev/null", None, "udp://HOST:PORT, not"),
        ("127.0.0.1", None, "address must be udp"),
    ],
)
def test_where_a_stream_may_be(make: Any, where: str, key: bytes | None, complaint: str) -> None:
    with pytest.raises(ParameterError, match=complaint):
        make(where, key=key)


def test_with_a_key_a_stream_may_be_anywhere_and_an_address_is_had_once() -> None:
    with closing(PoseStream("udp://0.0.0.0:0", key=KEY)) as stream:
        assert stream.address[0] == "0.0.0.0"
        with pytest.raises(LinkError, match="cannot listen at udp://"):
            PoseStream(f"udp://0.0.0.0:{stream.address[1]}", key=KEY)


# keys


def tagged(message: dict[str, Any], key: bytes = KEY) -> bytes:
    """Return a datagram as the page says."""
    data = json.dumps(message).encode()
    return data + b"\n" + hashlib.blake2s(data, digest_size=16, key=key).hexdigest().encode()


def untagged(data: bytes) -> dict[str, Any]:
    """Return what a datagram says, its tag checked as the page says."""
    text, tag = data[:-33], data[-32:]
    assert data[-33:-32] == b"\n" and tag.decode() == hashlib.blake2s(text, digest_size=16, key=KEY).hexdigest()
    result: dict[str, Any] = json.loads(text)
    return result


def test_with_a_key_each_request_is_taken_once_wherever_it_comes_from() -> None:
    stream, thief = Here(snapshot(), key=KEY), ("127.0.0.1", 10)
    session = answer_to(stream, tagged({"type": "get", "id": 77}))["session"]
    seal = {"session": session, "host": 4711}
    wish = {"type": "set", "settings": {"stiffness": 3000}}

    def taken(data: bytes, sender: Any = HERE) -> bool:
        assert stream.answers(data, sender) == []
        scene = stream.take()
        if scene is not None:
            stream.show(snapshot(scene), 7)
        return scene is not None

    first = tagged({**wish, **seal, "sequence": 1})
    assert taken(first)
    assert not taken(first) and not taken(first, thief) and stream.dropped == {"replay": 2}
    assert taken(tagged({**wish, **seal, "sequence": 5}))
    assert not taken(tagged({**wish, **seal, "sequence": 4})) and stream.dropped["replay"] == 3
    for wrong in ({"session": session + 1}, {"host": None}, {"sequence": "9"}, {"sequence": True}, {"host": 0.5}):
        assert not taken(tagged({**wish, **seal, "sequence": 9, **wrong}))
    assert stream.dropped["session"] == 5
    assert taken(tagged({**wish, **seal, "sequence": 9, "host": 1}))
    for data in (json.dumps(wish).encode(), first[:-1] + b"x", first[:-33], tagged(wish, KEY[::-1]), b"", b"\n"):
        assert not taken(data)
    assert stream.dropped["tag"] == 6
    assert not taken(tagged({**wish, **seal, "sequence": 10, "pad": "x" * 1400}))
    assert stream.dropped == {"replay": 3, "session": 5, "tag": 6, "size": 1}


def answer_to(stream: Hosts, data: bytes) -> dict[str, Any]:
    ((said, _),) = stream.answers(data, HERE)
    return said


def test_with_a_key_what_is_said_is_tagged() -> None:
    with streaming(snapshot(), key=KEY) as stream, plain(stream) as host:
        host.send(tagged({"type": "get", "id": 77}))
        assert untagged(host.recv(2048))["id"] == 77


def test_every_flipped_bit_of_a_keyed_datagram_is_noticed() -> None:
    codec = Datagrams(KEY, MOST_ASKED)
    data = codec.encode({"type": "subscribe", "id": 1})
    assert codec.decode(data) == {"type": "subscribe", "id": 1}
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        assert codec.decode(bytes(changed)) is None, bit
    assert codec.dropped == {"tag": 8 * len(data)}


def test_a_session_ends_before_a_host_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.stream.datagrams._MOST_HOSTS", 3)
    guard = Guard()
    first = {"session": guard.session, "host": 0, "sequence": 1}
    assert [guard.objection({**first, "host": host}) for host in (0, 1, 2)] == [""] * 3
    assert guard.objection({**first, "sequence": 2}) == ""
    assert guard.objection({**first, "host": 3}) == "session"
    assert guard.session != first["session"]
    assert guard.objection({**first, "sequence": 3}) == guard.objection(first) == "session"
    assert guard.objection({**first, "session": guard.session}) == ""


def test_a_client_with_the_key_is_served_and_one_without_is_not() -> None:
    stream = PoseStream(ANY, key=KEY)
    with running(stream):
        with StreamClient(url(stream), key=KEY) as client:
            assert client.set(stiffness=3000.0).reason == ""
            figures = client.set(stiffness=50000.0).figures
            assert figures is not None and figures["modulus"] > 1.0
            poses = client.poses()
            ticks = [next(poses)["tick"] for _ in range(10)]
            assert ticks == sorted(ticks) and not client.dropped
        for key in (None, bytes(32)):
            with StreamClient(url(stream), key=key, patience=0.3) as client, pytest.raises(StreamError):
                client.describe()
        with StreamClient(url(stream), key=KEY) as client:
            assert client.describe()["dropped"]["tag"] >= 4


def test_a_client_skips_poses_that_are_old_or_of_another_session() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as fake:
        fake.bind(("127.0.0.1", 0))
        fake.settimeout(5.0)
        with StreamClient(f"udp://127.0.0.1:{fake.getsockname()[1]}", key=KEY) as client:

            def serve() -> None:
                told = description(snapshot(), 8, None)
                for message in (told, {"type": "subscribed", "session": 8}):
                    data, address = fake.recvfrom(2048)
                    fake.sendto(tagged({**message, "id": untagged(data)["id"]}), address)
                for session, tick in ((8, 5), (8, 4), (9, 6), (8, 6), (8, 5), (8, 7)):
                    fake.sendto(tagged(pose_message(snapshot(tick=tick), session)), address)

            server = threading.Thread(target=serve)
            server.start()
            poses = client.poses()
            assert [next(poses)["tick"] for _ in range(3)] == [5, 6, 7]
            server.join()
            assert client.dropped == {"old": 2, "session": 1}


@pytest.mark.parametrize(
    "alien",
    [
        {},
        {"type": 3},
        {"type": "description", "session": 8, "settings": {}},
        {"type": "pose", "session": 8},
        {**pose_message(snapshot(), 8), "pose": {"x": 0.0}},
        {**pose_message(snapshot(), 8), "force": dict.fromkeys(AXES, "strong")},
        {**pose_message(snapshot(), 8), "tick": None},
    ],
)
def test_what_no_stream_says_is_dropped(alien: dict[str, Any]) -> None:
    """Anybody may answer at an address: what cannot be taken apart is counted, and what can is yielded."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as fake:
        fake.bind(("127.0.0.1", 0))
        fake.settimeout(5.0)
        with StreamClient(f"udp://127.0.0.1:{fake.getsockname()[1]}") as client:

            def serve() -> None:
                for message in (
                    description(snapshot(), 8, None),
                    description(snapshot(), 8, None),
                    {"type": "subscribed"},
                ):
                    data, address = fake.recvfrom(2048)
                    fake.sendto(json.dumps(alien).encode(), address)
                    fake.sendto(json.dumps({**message, "id": json.loads(data)["id"]}).encode(), address)
                fake.sendto(json.dumps(alien).encode(), address)
                fake.sendto(json.dumps(pose_message(snapshot(tick=7), 8)).encode(), address)

            server = threading.Thread(target=serve)
            server.start()
            seen = next(client.snapshots())
            server.join()
            assert seen.tick == 7 and seen.scene.name == "joystick"
            assert client.dropped["json"] >= 2


def test_a_scene_that_is_not_known_here_is_shown_by_its_timing() -> None:
    """It may be a user's own file at the other end, which is never run here."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as fake:
        fake.bind(("127.0.0.1", 0))
        fake.settimeout(5.0)
        with StreamClient(f"udp://127.0.0.1:{fake.getsockname()[1]}") as client:

            def serve() -> None:
                data, address = fake.recvfrom(2048)
                told = {**description(snapshot(), 8, json.loads(data)["id"]), "scene": "pinball.py:Pinball"}
                fake.sendto(json.dumps(told).encode(), address)
                data, address = fake.recvfrom(2048)
                ready = {"type": "subscribed", "id": json.loads(data)["id"], "session": 8}
                for message in (ready, pose_message(snapshot(tick=7), 8)):
                    fake.sendto(json.dumps(message).encode(), address)

            server = threading.Thread(target=serve)
            server.start()
            seen = next(client.snapshots())
            server.join()
            assert (seen.tick, seen.scene.name, seen.scene.period) == (7, "", Joystick().period)


def test_settings_that_are_none_are_one_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as fake:
        fake.bind(("127.0.0.1", 0))
        fake.settimeout(5.0)
        with StreamClient(f"udp://127.0.0.1:{fake.getsockname()[1]}") as client:

            def serve() -> None:
                data, address = fake.recvfrom(2048)
                told = {**description(snapshot(), 8, json.loads(data)["id"]), "settings": {"stiffness": -1.0}}
                fake.sendto(json.dumps(told).encode(), address)

            server = threading.Thread(target=serve)
            server.start()
            with pytest.raises(StreamError, match="shows what is not known here: stiffness must be"):
                next(client.snapshots())
            server.join()


# what is no request


def test_what_a_stream_says_itself_is_never_answered() -> None:
    own = {kind for row in ("### pose", "### description") for kind in [row.split()[1]]}
    own |= {"subscribed", "unsubscribed", "accepted", "refused", "error", "end"}
    stream = Here(snapshot())
    for number, kind in enumerate(sorted(own), 1):
        assert asking(stream, type=kind, id=1, settings={}) == []
        assert stream.dropped["own"] == number
    # nor does the answer to any request get one
    for kind in ("get", "x", "set", "subscribe", "unsubscribe"):
        for said, _ in asking(stream, type=kind):
            assert asking(stream, **said) == []


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "json"),
        (b"[1]", "json"),
        (b'"set"', "json"),
        (b"{", "json"),
        (b"\xff\xfe", "json"),
        ('{"type":"get"}'.encode("utf-16"), "json"),
        (b'{"type":"set","settings":{"stiffness":NaN}}', "json"),
        (b'{"type":"set","settings":{"stiffness":-Infinity}}', "json"),
        (b"[" * 1400, "json"),
        (b'{"a":' * 230, "json"),
        (b" " * 1401, "size"),
    ],
)
def test_what_does_not_parse_is_counted_and_not_answered(data: bytes, reason: str) -> None:
    stream = Here(snapshot())
    assert stream.answers(data, HERE) == []
    assert stream.dropped == {reason: 1}


SEEDS: Sequence[bytes] = (
    b'{"type":"get","id":1}',
    b'{"type":"subscribe"}',
    b'{"type":"set","id":7,"settings":{"walls":[["z",1,0.0],["z",-1,0.003]],"stiffness":5e3,"period":1}}',
    b'{"type":"set","settings":{"wall":true,"pulse":false,"breakaway":1,"delay":0}}',
    b'{"type":"unsubscribe","id":9007199254740991}',
)


def odd(draw: random.Random, depth: int = 0) -> Any:
    """Return any value that JSON has."""
    kind = draw.randrange(7 if depth > 3 else 9)
    if kind < 3:
        return draw.choice((None, True, False, 0, 1, -1, 2**53, 10**300, 10**400, 1e-320, 0.005, 5000.0, -0.0))
    if kind < 7:
        return draw.choice(("set", "get", "z", "walls", "", "\ud800", "é" * 30, "\x00", "udp://", AXES[3]))
    if kind == 7:
        return [odd(draw, depth + 1) for _ in range(draw.randrange(4))]
    names = ("type", "id", "settings", "period", "walls", "stiffness", "session", "host", "sequence", "x")
    return {draw.choice(names): odd(draw, depth + 1) for _ in range(draw.randrange(4))}


def fuzzed(draw: random.Random) -> bytes:
    """Return a datagram that asks for nothing that may be had."""
    kind = draw.randrange(4)
    if kind == 0:
        return draw.randbytes(draw.randrange(100))
    if kind == 1:
        data = bytearray(draw.choice(SEEDS))
        for _ in range(draw.randrange(1, 4)):
            data[draw.randrange(len(data))] = draw.randrange(256)
        return bytes(data)
    wish = odd(draw)
    if kind == 3:
        values = (True, False, 0.5, 3000, 70.0, 2)
        wish = {name: draw.choice((*values, odd(draw))) for name in draw.sample(SETTABLE, draw.randrange(8))}
        twice = [["z", 1, 0.0]] * 2  # whatever else is in it, this is refused
        wish["walls"] = [*(odd(draw) for _ in range(draw.randrange(2))), *twice]
    elif isinstance(wish, dict):
        wish["period"] = 0.001  # and this
    message = {"type": draw.choice(("set", "set", "get", "x", odd(draw))), "settings": wish}
    if draw.random() < 0.7:
        message["id"] = odd(draw)
    return json.dumps(message).encode()[: draw.choice((2000, 2000, 2000, 30))]


@pytest.mark.parametrize("key", [None, KEY], ids=["keyless", "keyed"])
def test_fuzzed_datagrams_raise_nothing_and_change_nothing(key: bytes | None) -> None:
    draw, said = random.Random(5), 0
    types: dict[str, int] = {}
    stream = Here(snapshot(), key=key)
    for number in range(20_000):
        data = fuzzed(draw)
        if key is not None and number % 2:
            data = data + b"\n" + hashlib.blake2s(data, digest_size=16, key=KEY).hexdigest().encode()
        for message, address in stream.answers(data, HERE):
            assert address == HERE
            assert len(json.dumps(message, allow_nan=False)) <= MOST_ANSWERED
            types[message["type"]] = types.get(message["type"], 0) + 1
            said += 1
    assert stream.take() is None
    assert said + sum(stream.dropped.values()) == 20_000
    assert types["error"] > 300 and types["description"] > 20
    assert {"json"} <= set(stream.dropped)
    if key is None:
        assert types["refused"] > 1000
    else:
        assert stream.dropped["tag"] >= 9_900 and stream.dropped["session"] > 500 and "refused" not in types


def test_a_stream_that_heard_nonsense_still_answers() -> None:
    draw = random.Random(6)
    with streaming(snapshot()) as stream, plain(stream) as host:
        for _ in range(300):
            host.send(fuzzed(draw))
        host.settimeout(0.3)
        for _ in range(20):  # what a full buffer does not take is lost
            host.send(b'{"type":"subscribe","id":123456}')
            try:
                while heard(host, "subscribed")["id"] != 123456:
                    pass
                return
            except TimeoutError:
                continue
    pytest.fail("it does not answer any more")


# the page


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def rows(heading: str) -> list[list[str]]:
    """Return the first table after a heading, without its head."""
    found = []
    for line in PAGE[PAGE.index(heading) :].splitlines():
        if line.startswith("|"):
            found.append([cell.strip() for cell in line.strip("|").split("|")])
        elif found:
            break
    return found[2:]


def named(cell: str) -> str:
    return cell.strip("`")


EXAMPLES = {message["type"]: message for message in map(json.loads, blocks("json"))}


def test_the_page_has_every_datagram_once() -> None:
    assert len(blocks("json")) == len(EXAMPLES) == 12
    asked = {"subscribe", "unsubscribe", "get", "set"}
    assert {named(row[0]) for row in rows("## What a host asks for")} == asked < set(EXAMPLES)


def live() -> dict[str, dict[str, Any]]:
    """Return one of each thing that a stream says, to the requests of the page where it has them."""
    anchors = np.array([math.nan, 0.0, 0.0, 0.0, math.nan, 0.0])
    said: dict[str, dict[str, Any]] = {}
    stream = Here(snapshot(Corner()))
    for wish in ({"type": "pause"}, {"type": "set", "id": 7, "settings": {"stiffness": 60000.0}}):
        ((reply, _),) = asking(stream, **wish)
        said[reply["type"]] = reply
    for kind in ("get", "unsubscribe", "subscribe", "set"):
        for reply, _ in asking(stream, **EXAMPLES[kind]):
            said[reply["type"]] = reply
    one = snapshot(stream.take(), since=204, tick=394, anchors=anchors)
    for reply, _ in stream.show(one, 204) + stream.end():
        said[reply["type"]] = reply
    return {kind: json.loads(json.dumps(message)) for kind, message in said.items()}


def test_the_examples_of_the_page_are_what_is_said() -> None:
    said = live()
    assert set(said) | {"subscribe", "unsubscribe", "get", "set"} == set(EXAMPLES)
    for kind, message in said.items():
        example = EXAMPLES[kind]
        assert list(example) == list(message), kind
        for name, value in example.items():
            assert isinstance(value, type(message[name])) or name == "stuck", (kind, name)
            if isinstance(value, dict):
                assert list(value) == list(message[name]), (kind, name)
    for kind, names in {
        "description": ("scene", "says", "version", "settings", "settable", "faces", "axes", "units"),
        "refused": ("reason",),
        "error": ("reason",),
        "subscribed": ("seconds",),
    }.items():
        for name in names:
            assert EXAMPLES[kind][name] == said[kind][name], (kind, name)
    for name, value in EXAMPLES["refused"]["figures"].items():
        assert said["refused"]["figures"][name] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-5))


def test_the_tables_of_the_page_name_every_field() -> None:
    common = {"type", "id", "session"}
    for kind in ("pose", "description", "refused"):
        assert {named(row[0]) for row in rows(f"### {kind}\n")} == set(EXAMPLES[kind]) - common
    assert {named(row[0]) for row in rows("### accepted\n")} == set(EXAMPLES["accepted"]) - common
    figures = rows("| figure | unit |")
    assert [named(row[0]) for row in figures] == list(EXAMPLES["refused"]["figures"])
    assert sorted(named(row[0]) for row in rows("### Settings\n")) == sorted(SETTABLE)


def test_the_bounds_of_the_page_are_the_bounds() -> None:
    found: dict[str, Any] = {}
    for name, _, bounds, *_ in rows("### Settings\n"):
        if (match := re.fullmatch(r"([\d.]+) to ([\d.]+)", bounds)) is not None:
            found[named(name)] = float(match[1]), float(match[2])
    assert set(found) == {"breakaway", "stiffness", "damping"}
    for name, (least, most) in found.items():
        for value in (least, most):
            assert getattr(Joystick.from_json({name: value}), name) == value
        for value in (math.nextafter(least, -1.0), math.nextafter(most, 1e9)):
            with pytest.raises(ParameterError):
                Joystick.from_json({name: value})


def test_figures_in_the_text_of_the_page() -> None:
    tag = hashlib.blake2s(b'{"type":"subscribe"}', digest_size=16, key=KEY).hexdigest()
    assert f"`{tag}`" in PAGE and f"`{KEY.hex()}`" in PAGE
    assert Datagrams(KEY, MOST_ASKED).encode({"type": "subscribe"}) == b'{"type":"subscribe"}\n' + tag.encode()
    for text in (f"at most {MOST_ASKED} bytes", f"at most\n{MOST_ANSWERED} (", f"for {MOST_SUBSCRIBERS} subscribers"):
        assert text in PAGE
    assert f"for the next {SUBSCRIBED:g} s" in PAGE and f"After {SUBSCRIBED:g} s without a renewal" in PAGE


def test_the_example_host_shows_a_refusal_and_what_may_be_had() -> None:
    command = [sys.executable, str(ROOT / "scripts" / "examples" / "stream_host.py")]
    done = subprocess.run(
        [*command, "--alone", "--seconds", "1.8"], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    # the block of the page, but for what differs from run to run
    (shown,) = re.findall(r"\n```\n(set .*?)```", PAGE, re.DOTALL)
    for line in shown.splitlines():
        if line.startswith(("set ", "  refused: walls")):
            assert line in done.stdout
    assert "where the flotor is, by at most 2 N, not -1" in shown and shown.count("set ") == 3
    assert "modulus        1.64035" in done.stdout and "largest_stable 10151" in done.stdout
    assert re.search(r"in force from tick \d+ on\n", done.stdout)
    assert done.stdout.count("┼") + done.stdout.count("●") >= 12


@pytest.mark.parametrize(
    ("options", "status", "complaint"),
    [
        (["udp://192.0.2.1:9"], 2, "a key be given"),
        (["nonsense"], 2, "address must be udp"),
        (["--alone", "--seconds", "0"], 2, "seconds must be"),
        (["--alone", "--scene", "sauna"], 2, "scene must be one of"),
        (["--stiffness", "much"], 2, "must be a number"),
    ],
)
def test_what_the_example_host_cannot_do_is_one_line(
    options: list[str],
    status: int,
    complaint: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["stream_host.py", *options])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / "scripts" / "examples" / "stream_host.py"), run_name="__main__")
    said, complained = capsys.readouterr()
    assert ended.value.code == status and complaint in complained
    assert len(complained.splitlines()) == 1 and said == ""
