"""Live server: visible samples, settings, their effect, and access."""

from __future__ import annotations

import itertools
import json
import math
import os
import random
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from asyncio.trsock import TransportSocket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from multiprocessing import Pipe, active_children
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from live_client import LiveClient
from maglev_mj import AXES
from maglev_mj.errors import MissingPackageError, ParameterError
from maglev_mj.interop.foxglove import LiveServer, LiveServerError, service
from maglev_mj.interop.foxglove.service import forward, refusal
from maglev_mj.interop.foxglove.settings import Answer, Requests, State, checked, values_of
from maglev_mj.plants.hand import SpringHand
from maglev_mj.process import NICE, SideAnswers, SideProcess
from maglev_mj.recording import ArrayFile, tee
from maglev_mj.recording.ring import Ring, RowReader
from maglev_mj.scenes import Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.rooms import INERTIA, MASS, Box, Corner, Joystick, Table
from maglev_mj.session import Pacer, Session, Snapshot, UnstableLoop, unstable_loop
from maglev_mj.session.access import check_origin
from maglev_mj.spec import RANGE
from maglev_mj.theory import largest_modulus, largest_stable_stiffness
from tests.virtual_screen import waited

MUCH = 1 << 26  # bytes, beyond what sockets keep
SETTABLE = "wall", "pulse", "friction", "weightless", "stiffness", "damping", "breakaway", "walls"
APP = "https://app.foxglove.dev"


def state(scene: Scene, delay: float | None = None, inertia: Sequence[float] | None = None) -> State:
    return State(scene, scene.delay if delay is None else delay, inertia, "running")


# what may be set


def test_parameters_are_named_as_the_options_are() -> None:
    scene = Joystick(stiffness=4321.125)
    values = values_of(state(scene))
    assert list(values) == ["scene", "state", "period", "delay", *SETTABLE]
    assert values["scene"] == "joystick" and values["stiffness"] == 4321.125 and values["walls"] == "none"
    given = {name: values[name] for name in SETTABLE}
    assert checked(state(scene), given) == scene  # what is told may be said again
    walls = values_of(state(Joystick(walls=[("z", 1, 0.001)])))["walls"]
    assert walls == [["z", 1, 0.001]]
    assert values_of(State()) == {} and checked(State(), {"wall": True}) == "no scene runs here"


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"period": 0.001}, "period is the device's, or the person's at the machine; a program cannot set it"),
        ({"delay": 0.0}, "delay is the device's, or the person's at the machine; a program cannot set it"),
        ({"stifness": 5.0, "scene": 1}, f"parameters must be of {', '.join(SETTABLE)}, not scene, stifness"),
        ({"stiffness": 0.5}, "stiffness must be a finite number at least 1 and at most 1e+06, not 0.5"),
        ({"stiffness": "none"}, "stiffness must be a finite number at least 1 and at most 1e+06, not 'none'"),
        ({"stiffness": True}, "stiffness must be a finite number at least 1 and at most 1e+06, not True"),
        ({"damping": 10**400}, f"damping must be a finite number at least 0 and at most 10000, not {10**400}"),
        ({"wall": 1}, "wall must be True or False, not 1"),
        ({"walls": b"z"}, "a wall must be an axis, a normal and an edge, not 122"),
        ({"walls": [["z", 1, 0.002], ["z", -1, 0.001]]}, "walls must leave room between them, not 0.002 to 0.001 on z"),
    ],
)
def test_what_cannot_be_set_is_refused_in_a_line(given: dict[str, Any], reason: str) -> None:
    assert checked(state(Joystick()), given) == reason


def test_what_is_not_named_stays() -> None:
    present = Joystick(friction=True, breakaway=1.5)
    wanted = checked(state(present), {"damping": 70, "pulse": False, "walls": [["rx", -1.0, 0.05]]})
    assert wanted == Joystick(friction=True, breakaway=1.5, damping=70.0, pulse=False, walls=(("rx", -1, 0.05),))
    assert isinstance(wanted, Joystick) and checked(state(wanted), {"walls": "none"}) == wanted.replace(walls=None)


@pytest.mark.parametrize("scene", [Box()])
@pytest.mark.parametrize(("axis", "normal"), [("z", 1), ("x", -1), ("ry", 1)])
def test_an_unstable_wall_is_refused_with_the_figures_of_its_loop(scene: Scene, axis: str, normal: int) -> None:
    given = {"walls": [[axis, normal, -normal * 0.001]], "stiffness": 40000.0, "damping": 70.0}
    figures = checked(state(scene), given)
    assert isinstance(figures, UnstableLoop) and figures.axis == axis and figures.acting == "walls"
    index = AXES.index(axis)
    assert figures.stiffness >= 40000.0 * INERTIA[index] / MASS and figures.damping >= 70.0 * INERTIA[index] / MASS
    loop: Any = {"period": scene.period, "delay": scene.delay, "mass": float(INERTIA[index])}
    modulus = largest_modulus(figures.stiffness, figures.damping, **loop)
    assert figures.modulus == pytest.approx(float(modulus), rel=1e-9) and modulus > 1.0
    assert figures.largest_stable == pytest.approx(float(largest_stable_stiffness(figures.damping, **loop)), rel=1e-9)


def test_a_request_is_checked_at_the_delay_and_with_the_flotor_that_are_measured() -> None:
    for delay, stable in ((0.0, True), (0.0015, True), (0.003, False)):
        found = checked(state(Box(), delay), {"stiffness": 9000.0})
        assert isinstance(found, Box if stable else UnstableLoop)
        assert found.delay == (Box().delay if stable else delay)
    assert checked(state(Box(), 0.2), {}) == "delay must be a finite number at least 0 and at most 0.1, not 0.2"
    for mass, stable in ((0.7, True), (0.35, False)):
        found = checked(state(Drop(), inertia=[mass] * 3 + [1e-3] * 3), {"stiffness": 6000.0})
        assert isinstance(found, Drop if stable else UnstableLoop)


@pytest.mark.parametrize("count", [30, pytest.param(100, marks=pytest.mark.study)])
def test_what_is_accepted_is_stable_and_what_is_legal_never_raises(count: int) -> None:
    draw, kinds = random.Random(3), []
    for _ in range(count):
        cls = draw.choice((Joystick, Table, Box, Corner))
        present: Scene = cls(period=draw.choice((5e-3, 1e-3)), delay=draw.uniform(0.0, 5e-3))
        given: dict[str, Any] = {name: draw.random() < 0.5 for name in ("wall", "friction", "pulse", "weightless")}
        given |= {"stiffness": 10 ** draw.uniform(0, 6), "damping": 10 ** draw.uniform(-2, 4)}
        if draw.random() < 0.5:
            reaches = zip(AXES, RANGE, strict=True)
            given["walls"] = [[axis, 1, draw.uniform(-reach, reach)] for axis, reach in reaches if draw.random() < 0.5]
        found = checked(state(present), given)
        kinds.append(type(found) is cls)
        assert unstable_loop(found) is None if isinstance(found, Scene) else isinstance(found, UnstableLoop | str)
    assert 0.1 * count < sum(kinds) < 0.9 * count


def test_one_request_at_a_time_and_the_newest_waits() -> None:
    requests = Requests()
    assert not requests.arrived.poll()
    answers = [requests.put({"number": number}) for number in range(2)]
    assert answers[0].result(0).reason == "replaced by a newer request before it was in force"
    assert requests.arrived.poll()
    assert requests.next() == {"number": 1} and requests.next() is None
    assert not requests.arrived.poll()
    answers += [requests.put({"number": number}) for number in (2, 3)]
    assert answers[2].done() and not answers[3].done() and requests.next() is None
    requests.settle(Answer(since=7))
    assert answers[1].result(0) == (7, "", None) and not answers[3].done()
    assert not requests.arrived.poll()  # the server asks for the next after every answer
    assert requests.next() == {"number": 3}


# who is let in


def request(*lines: str, host: str | None = "127.0.0.1:8765", upgrade: str | None = "websocket") -> str:
    fields = [f"Host: {host}"] * (host is not None) + [f"Upgrade: {upgrade}"] * (upgrade is not None)
    return "\r\n".join(["GET / HTTP/1.1", *fields, *lines])


@pytest.mark.parametrize(
    "asked",
    [
        request(),
        *(request(host=host) for host in ("localhost:8765", "LOCALHOST", "[::1]:9", "127.0.0.1")),
        *(
            request(f"Origin: {origin}")
            for origin in (APP, "http://localhost:8080", "https://127.0.0.1", "http://[::1]")
        ),
        request("Sec-WebSocket-Key: x", "X-Other:  a b  ", upgrade="WebSocket"),
    ],
)
def test_programs_of_this_machine_and_the_app_are_let_in(asked: str) -> None:
    assert refusal(asked) == ""


EVIL = (
    "http://evil.example",
    "https://app.foxglove.dev.evil.example",
    "https://evil.example/https://app.foxglove.dev",
    "http://app.foxglove.dev",
    "https://app.foxglove.dev:444",
    "https://other.foxglove.dev",
    "http://localhost.evil.example",
    "http://127.0.0.1.evil.example",
    "http://localhost@evil.example",
    "http://localhost:8080x",
    "file://",
    "null",
    "",
)


@pytest.mark.parametrize(
    ("asked", "wrong"),
    [
        *((request(f"Origin: {origin}"), "Origin must be") for origin in EVIL),
        (request(f"Origin: {APP}", "Origin: http://evil.example"), "Origin must be"),
        (request("oRIGIN : http://evil.example"), "no header field"),
        (request(f"Origin: {APP}", " http://evil.example"), "no header field"),
        (request("X: y\nOrigin: http://evil.example"), "no header field"),
        (request("X: y\rOrigin: http://evil.example"), "no header field"),
        *(
            (request(host=host), "Host must be")
            for host in ("evil.example:8765", "127.0.0.1.evil.example", "", "10.0.0.1")
        ),
        (request(host=None), "Host must be"),
        (request("Host: evil.example"), "Host must be"),
        (request(upgrade=None), "only WebSockets"),
        (request(upgrade="h2c"), "only WebSockets"),
        (request("Upgrade: h2c"), "only WebSockets"),
        (request().replace("GET", "POST"), "only WebSockets"),
    ],
)
def test_everything_else_is_refused(asked: str, wrong: str) -> None:
    assert refusal(asked).startswith(wrong)


NAMED = ("http://192.168.0.5:8080", "file://", "null")


def test_a_named_origin_is_let_in_and_no_other() -> None:
    for named in NAMED:
        access = replace(service._ACCESS, allowed=[named])
        for origin in (named, APP):
            assert refusal(request(f"Origin: {origin}"), access) == ""
        for origin in {*EVIL, *NAMED, f"{named}.evil.example", f"{named}/"} - {named}:
            assert refusal(request(f"Origin: {origin}"), access).startswith("Origin must be this machine or ")
        assert refusal(request(f"Origin: {named}", host="192.168.0.5:8765"), access).startswith("Host must be")
        assert check_origin(named) == named
    every = replace(service._ACCESS, allowed=["http://a.example"])
    assert refusal(request("Origin: http://axexample"), every)  # a point is a point


@pytest.mark.parametrize(
    "origin", ["", "*", "http://", "http://a/", "http://a/b", "ftp://a", "a.example", "http://a b", "http://a,http://b"]
)
def test_an_origin_that_is_none_is_refused(origin: str) -> None:
    with pytest.raises(ParameterError, match="origin must be as http"):
        LiveServer(0, [origin])


def test_the_server_behind_is_where_no_browser_can_open_it(monkeypatch: pytest.MonkeyPatch) -> None:
    hosts = {service.hidden_address() for _ in range(20)}
    assert len(hosts) == 20 and all(re.fullmatch(r"127\.\d+\.\d+\.\d+", host) and not port for host, port in hosts)
    real, taken = socket.create_server, set[int]()

    def create(address: tuple[str, int]) -> socket.socket:
        if address[0] != "127.0.0.1" or address[1] in taken:  # as on macOS
            raise OSError("Can't assign requested address")
        return real(address)

    monkeypatch.setattr("maglev_mj.interop.foxglove.service.socket.create_server", create)
    while len(taken) < 3:
        host, port = service.hidden_address()
        assert host == "127.0.0.1" and port in service._BLOCKED and port not in taken
        taken.add(port)
    taken.update(service._BLOCKED)
    with pytest.raises(OSError, match=r"ports 1719, .* 10080 of 127\.0\.0\.1 are taken"):
        service.hidden_address()


@contextmanager
def guarded() -> Iterator[tuple[int, socket.socket]]:
    """Yield the port of a guard, and the listener behind."""
    with socket.create_server(("127.0.0.1", 0)) as public, socket.create_server(("127.0.0.1", 0)) as behind:
        behind.settimeout(5.0)
        threading.Thread(target=forward, args=(public, behind.getsockname()), daemon=True).start()
        yield public.getsockname()[1], behind


def asks(port: int, data: bytes) -> socket.socket:
    line = socket.create_connection(("127.0.0.1", port), timeout=5.0)
    line.sendall(data)
    return line


def test_nothing_reaches_the_server_but_what_is_let_in(monkeypatch: pytest.MonkeyPatch) -> None:
    # Refused, too long, cut off and never finished requests are ended by the guard itself.
    monkeypatch.setattr(service, "PATIENCE", 0.3)
    good = (request() + "\r\n\r\n").encode()
    with guarded() as (port, behind), ExitStack() as open_ones:
        behind.setblocking(False)
        evil = (request("Origin: http://evil.example") + "\r\n\r\n").encode()
        refused, long = b"HTTP/1.1 403 Forbidden\r\n", (request("X: " + "y" * 9000) + "\r\n\r\n").encode()
        for data, answer in ((evil, refused), (b"\r\n\r\n", refused), (long, b""), (good[:-1], b"")):
            line = open_ones.enter_context(asks(port, data))
            said = b""
            while True:
                try:
                    more = line.recv(4096)
                except ConnectionResetError:
                    break
                if not more:
                    break
                said += more
            assert said.startswith(answer) and bool(said) == bool(answer)
            with pytest.raises(BlockingIOError):
                behind.accept()
        behind.settimeout(5.0)
        line = open_ones.enter_context(asks(port, good + b"first"))
        server = open_ones.enter_context(behind.accept()[0])
        server.settimeout(5.0)
        data = b""
        while not data.endswith(b"first"):
            data += server.recv(4096)
        assert data == good + b"first"
        server.sendall(b"back")
        assert line.recv(16) == b"back"
        server.close()
        assert line.recv(16) == b""  # either end closes both


def test_small_messages_are_passed_on_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # None waits until the one before it is acknowledged, for which the other end takes its time.
    calls: list[tuple[object, ...]] = []
    monkeypatch.setattr(TransportSocket, "setsockopt", lambda _, *option: calls.append(option))
    good = (request() + "\r\n\r\n").encode()
    with guarded() as (port, behind), asks(port, good) as line, behind.accept()[0] as server:
        server.settimeout(5.0)
        assert server.recv(4096) == good
        for one, other in ((server, line), (line, server), (server, line)):
            one.sendall(b"small")
            assert other.recv(16) == b"small"
    if service._QUICKACK is not None:
        waited(lambda: calls.count((socket.IPPROTO_TCP, service._QUICKACK, 1)) == 3, 5.0)
    assert calls.count((socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)) == 2


def test_one_that_stalls_takes_nothing_from_others() -> None:
    # It does not read: what is for it waits at the server, while another is served.
    with guarded() as (port, behind), ExitStack() as open_ones:
        good = (request() + "\r\n\r\n").encode()
        ends = []
        for _ in range(2):
            line = open_ones.enter_context(asks(port, good))
            ends.append((line, open_ones.enter_context(behind.accept()[0])))
        for _ in range(50):  # half of a request each
            open_ones.enter_context(asks(port, good[:20]))
        (_, stalls), (line, served) = ends
        stalls.setblocking(False)
        sent, moved = 0, time.monotonic()
        while sent < MUCH and time.monotonic() < moved + 0.5:
            try:
                sent += stalls.send(bytes(1 << 16))
                moved = time.monotonic()
            except BlockingIOError:
                time.sleep(0.01)
        assert sent < MUCH  # the guard does not keep it all
        for _ in range(200):
            served.sendall(b"pose")
            assert line.recv(16) == b"pose"


def test_one_connection_too_many_is_closed_until_another_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service, "MOST", 2)
    good = (request() + "\r\n\r\n").encode()
    with guarded() as (port, behind), ExitStack() as open_ones:
        first, _ = (open_ones.enter_context(asks(port, good[:20])) for _ in range(2))
        with asks(port, b"") as third:
            assert third.recv(16) == b""
        first.close()
        deadline = time.monotonic() + 60.0
        behind.settimeout(0.1)
        while time.monotonic() < deadline:  # it takes the guard a while to see that
            with suppress(OSError):
                open_ones.enter_context(asks(port, good))
                open_ones.enter_context(behind.accept()[0])
                return
    pytest.fail("nobody is let in again")


# its parts, without processes


class Unstarted:
    """In place of a process."""

    made = 0

    def __init__(self, *_: object) -> None:
        Unstarted.made += 1
        self.line, self.far = Pipe()
        self.far.send("")
        self.ready, self.ended, self.sent = False, False, list[Any]()

    def send(self, message: object) -> None:
        self.sent.append(message)

    def received(self) -> Iterator[Any]:
        while not self.ended and self.line.poll():
            yield self.line.recv()

    def close(self, patience: float = 0.0) -> None:
        self.ended = True
        self.line.close()


class Unchecking(Unstarted):
    """In place of the process that checks."""

    _question, _busy, _until, _unknown = None, True, math.inf, ""
    ask: Any = SideAnswers.ask
    answer: Any = SideAnswers.answer


def test_what_rows_and_requests_wait_for_outlasts_a_process_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything else falls out, the oldest first."""
    monkeypatch.setattr("maglev_mj.interop.foxglove.server.SideProcess", Unstarted)
    with closing(LiveServer(0)) as server:
        scene, process = Drop(), server._process
        assert isinstance(process, Unstarted)
        server.event("timing", "before")
        server.begin(scene.plant("exact"), scene.controller())
        server._note(7)
        server.show(Snapshot(scene=scene, delay=0.0015))
        for number in range(300):
            server.event("timing", str(number))
        assert not process.sent
        process.ready = True
        server.show(Snapshot(scene=scene, delay=0.0015))
    (_, begin, *_), (_, show, _, answer), *rest = process.sent
    assert (begin, show, answer) == ("begin", "show", Answer(7))
    assert [text for _, _, _, text, _ in rest] == [str(number) for number in range(46, 300)]


@contextmanager
def in_service(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, Any]]:
    """Yield a server's service, and the loop's end."""
    from maglev_mj.interop.foxglove import service

    monkeypatch.setattr(service, "SideAnswers", Unchecking)
    monkeypatch.setattr(service, "forward", lambda *_: None)
    near, far = Pipe()
    with near, far, closing(Ring()) as ring, socket.create_server(("127.0.0.1", 0)) as public:
        one = service._Service(far, RowReader(ring.path), public)
        yield one, near
        one._server.stop()


def test_a_process_that_cannot_check_is_started_anew_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    # Where there is none to be had, the server goes on, and says why it refuses.
    with in_service(monkeypatch) as (one, _):
        made = Unstarted.made
        for _ in range(20):
            one._checker.ended = True
            one._turn()
        assert Unstarted.made == made + 1
        answer = one._requests.put({"wall": True})
        one._turn()
        one._turn()
        assert not answer.done()  # it waits for the next

        def fails(*_: object) -> None:
            raise BlockingIOError(11, "Resource temporarily unavailable")

        monkeypatch.setattr("maglev_mj.interop.foxglove.service.SideAnswers", fails)
        one._next_checker = 0.0
        one._turn()
        assert answer.result(0).reason.endswith("does not start: [Errno 11] Resource temporarily unavailable")
        one._turn()
        monkeypatch.setattr("maglev_mj.interop.foxglove.service.SideAnswers", Unchecking)
        one._next_checker = 0.0
        one._requests.put({"wall": False})
        one._turn()
        one._turn()
        assert [given for _, given in one._checker.sent] == [{"wall": False}]


def test_a_request_wakes_the_server_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # It waits for no row; nor does a request that cannot be checked yet keep it awake.
    woken: list[Any] = []
    monkeypatch.setattr("maglev_mj.interop.foxglove.service.wait", lambda lines, _: woken.append(wait(lines, 0.0)))
    with in_service(monkeypatch) as (one, _):
        one._turn()
        woken.clear()
        for _ in range(2):
            one._requests.put({"wall": True})
            one._turn()
        assert woken == [[one._requests.arrived], []]
        one._conclude("no")
        one._turn()
        one._conclude("no")
        one._checker.ended, one._next_checker = True, math.inf
        one._requests.put({"wall": True})
        one._turn()
        assert woken[2:] == [[], []]


def test_a_server_ends_with_its_line_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    # Not with a scene that it cannot read, whatever that raises; nor where there is nobody to hand a scene to.
    with in_service(monkeypatch) as (one, near):
        near.send((0, "show", Nowhere(FileNotFoundError), None))
        one._turn()
        assert not one._over and "FileNotFoundError" in one._state.state
        near.close()
        one._conclude(Joystick())
        one.run()
        assert one._over and one._checker.ended


def test_each_file_is_closed_where_another_cannot_be() -> None:
    class Full(ArrayFile):
        def close(self) -> Path | None:
            raise OSError("full")

    class Kept(ArrayFile):
        closed = False

        def close(self) -> Path | None:
            self.closed = True
            return Path("kept")

    kept = Kept()
    for files in ((Full(), kept), (kept, Full())):
        kept.closed = False
        both = tee(*files)
        assert both is not None
        with pytest.raises(OSError, match="full"):
            both.close()
        assert kept.closed
    both = tee(ArrayFile(), kept)
    assert both is not None and both.close() == Path("kept")


# the server in its own process


class Running:
    """Session in a thread that records each sample's scene."""

    def __init__(self, session: Session, period: float) -> None:
        self.session, self.scenes, self._period = session, list[Scene](), period
        self.asked: deque[Callable[[], object]] = deque()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._go_on)

    def __enter__(self) -> Running:
        self.session.tick(0.0)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()

    def act(self, action: str) -> None:
        self.asked.append(lambda: self.session.act(action))

    def _go_on(self) -> None:
        while not self._stopped.wait(self._period):
            while self.asked:
                self.asked.popleft()()
            if self.session.tick(self._period):
                self.scenes.append(self.session.snapshot().scene)  # that answered this sample


@contextmanager
def running(live: LiveServer, *, period: float = 0.005, **options: Any) -> Iterator[Running]:
    """Yield a running joystick that leaves the server open."""
    scene = Joystick(period=period, delay=min(0.0015, period))
    pacer = Pacer(budget=60.0, patience=3600.0)

    class Kept:
        take, show = live.take, live.show

        def close(self) -> None: ...

    session = Session(scene, pacer=pacer, publishers=[Kept()], file=options.pop("file", live), **options)
    with closing(session), Running(session, period) as one:
        known = values_of(state(scene))
        with LiveClient(url(live), set()) as client:
            waited(lambda: client.parameters() == known, 30.0)  # those of the test before are gone
        yield one


@pytest.fixture(scope="module")
def live() -> Iterator[LiveServer]:
    with closing(LiveServer(0)) as server:
        yield server


def url(live: LiveServer) -> str:
    return f"ws://127.0.0.1:{live.port}"


machine = pytest.mark.machine


@machine
def test_every_sample_is_seen_as_it_was_recorded(live: LiveServer) -> None:
    # To a file and to programs at once, through a change of parameters; frames sixty times a second.
    kept = ArrayFile()
    hand = SpringHand(target=[0.016, 0.0, -0.01, 0.0, 0.1, 0.0])
    heard: list[Any] = []
    with LiveClient(url(live)) as client:
        with running(live, period=0.001, hand=hand, file=tee(kept, live)):
            heard += client.messages(0.5)
            assert client.set(friction=True)["reason"] == ""
            heard += client.messages(0.5)
        heard += client.messages(0.5)
    samples = [(one.fields.stretch, one.fields) for one in heard if one.topic == "/maglev/sample"]
    first = samples[0][0]
    for place, stretch in enumerate(kept.recording.stretches):
        seen = [sample for number, sample in samples if number == first + place]
        assert [sample.tick for sample in seen] == stretch.tick.tolist()
        for name, values in (("position", stretch.position), ("hand", stretch.hand)):
            found = [[getattr(getattr(sample, name), axis) for axis in AXES] for sample in seen]
            assert np.array_equal(found, values)
    frames = sum(one.topic == "/tf" for one in heard)
    children = {one.child_frame_id for message in heard if message.topic == "/tf" for one in message.fields.transforms}
    assert children == {"flotor", "hand", "stick position"}
    elapsed = [one.time - one.time[0] for one in kept.recording.stretches]
    assert frames == sum(len(np.unique(np.floor(one * 60.0 + 1e-6))) for one in elapsed) > 10
    assert np.ptp(stretch.position[:, 0]) > 1e-4


@machine
def test_a_call_is_answered_with_the_first_sample_under_it(live: LiveServer) -> None:
    draw, names = random.Random(1), []
    with running(live, period=0.001) as one, LiveClient(url(live), set()) as client:
        for _ in range(25):
            time.sleep(draw.uniform(0.0, 0.02))
            edge, stiffness = draw.uniform(-4e-3, -1e-3), draw.uniform(2000.0, 6000.0)
            said = client.set(walls=[["z", 1, edge]], stiffness=stiffness)
            assert (said["reason"], said["figures"]) == ("", None)
            assert client.parameters()["walls"] == [["z", 1, edge]]
            names.append((said["since"], stiffness))
    for tick, stiffness in names:
        assert one.scenes[tick].as_json()["stiffness"] == stiffness != one.scenes[tick - 1].as_json()["stiffness"]


@machine
def test_what_is_refused_changes_nothing_and_is_said_to_all(live: LiveServer) -> None:
    hand = SpringHand(target=[0.008, 0.0, 0.0, 0.0, 0.0, 0.0])  # holds it at 3.2 mm
    with (
        running(live, hand=hand) as one,
        LiveClient(url(live), {"/log"}) as client,
        LiveClient(url(live), set()) as other,
    ):
        while one.session.snapshot().pose[0] < 3e-3:
            time.sleep(0.01)
        before = client.parameters()
        wishes: list[tuple[dict[str, Any], str]] = [
            ({"stiffness": 60000.0}, r"walls on x: 6\.03e\+04 N/m .* root modulus 1\.6403, which must be below 1.*"),
            ({"walls": [["x", -1, 0.001]]}, r"settings must change the force on x, .*, by at most 2 N, not -1\d\.\d N"),
            ({"pitch": "x" * 5000}, r"parameters must be of .*, not pitch"),
            ({"stiffness": "x" * 5000}, r"stiffness must be .*, not 'x*"),
        ]
        for request, pattern in wishes:
            said = client.set(**request)
            assert said["since"] is None and re.fullmatch(pattern, said["reason"]) and len(said["reason"]) <= 300
            status = other.heard(lambda said: said["op"] == "status")
            assert status["message"] == said["reason"]
            logged = [message.fields.message for message in client.messages(0.3)]
            assert logged[-1] == f"refused: {said['reason']}"
        assert client.set(stiffness=60000.0)["figures"]["modulus"] == pytest.approx(1.6403, abs=1e-4)
        for data in (b"[1]", b"{", b"NaN", b"[" * 10**5):
            other._line.send(struct.pack("<BIII", 2, other._services["/maglev/set"], 0, 4) + b"json" + data)
            failed = other.heard(lambda said: said["op"] == "serviceCallFailure")
            assert failed["message"] == "ValueError: a request must be a JSON object of names and values"
        assert client.parameters() == before and one.session.snapshot().scene == one.scenes[0]


@machine
def test_parameters_are_set_as_the_app_does(live: LiveServer) -> None:
    # The answer, at once, has the values in force; subscribers hear of others when they are in force.
    with running(live), LiveClient(url(live), set()) as client, LiveClient(url(live), set()) as other:
        other.send({"op": "subscribeParameterUpdates", "parameterNames": ["stiffness", "state"]})

        def heard(**wanted: Any) -> bool:
            def so(said: dict[str, Any]) -> bool:
                values = {one["name"]: one["value"] for one in said.get("parameters", ())}
                return said["op"] == "parameterValues" and values | wanted == values

            return bool(other.heard(so))

        for value, then in ((3000.0, 3000.0), (60000.0, 3000.0), (4000, 4000.0)):
            before = client.parameters()["stiffness"]
            client.send({"op": "setParameters", "parameters": [{"name": "stiffness", "value": value}], "id": "set"})
            said = client.heard(lambda said: said["op"] == "parameterValues" and said["id"] == "set")
            assert before in [one["value"] for one in said["parameters"]]
            if value == then:
                assert heard(stiffness=then)
            else:
                assert "must be below 1" in client.heard(lambda said: said["op"] == "status")["message"]
            assert client.parameters()["stiffness"] == then


@machine
def test_a_program_that_comes_late_to_a_pause_sees_the_scene_and_sets_it(live: LiveServer) -> None:
    with running(live) as one:
        while not one.scenes:
            time.sleep(0.01)
        one.act("pause")
        with LiveClient(url(live)) as client:
            heard = list(client.messages(1.0))
            assert {one.fields["name"] for one in heard if one.topic == "/maglev/stretch"} == {"scene joystick"}
            scenes = [message.fields for message in heard if message.topic == "/maglev/shapes"]
            assert {"stator", "flotor", "walls"} <= {entity.id for scene in scenes for entity in scene.entities}
            assert client.set(walls=[["y", 1, -0.001]])["reason"] == ""
            assert client.parameters()["walls"] == [["y", 1, -0.001]] and client.parameters()["state"] == "paused"
            one.act("friction")  # by a key
            waited(lambda: client.parameters()["friction"], 30.0)
            one.act("emergency stop")
            logged = (message.fields.message for message in client.messages(5.0) if message.topic == "/log")
            assert next(line for line in logged if "stop" in line) == "fault: emergency stop"
            waited(lambda: client.parameters()["state"] == "stopped: emergency stop", 30.0)


@machine
def test_one_that_floods_takes_nothing_from_others() -> None:
    # Sets by the thousand, of every kind; another program hears every sample, and its own set is answered.
    live, over = LiveServer(0), threading.Event()  # what is left of a flood is not for another test

    def flood() -> None:
        while not over.is_set():
            # the server may cut one off who hears none of its answers: it comes back
            with suppress(ConnectionClosed, OSError), LiveClient(url(live), set()) as client:
                for number in iter(lambda: 0 if over.is_set() else random.randrange(1, 6000), 0):
                    for value in (number, 60000 + number, "x" * number):
                        client.send({"op": "setParameters", "parameters": [{"name": "stiffness", "value": value}]})
                    client.send({"op": "getParameters", "parameterNames": [], "id": "flood"})
                client.drop()  # without waiting for what is left to be taken

    with closing(live), running(live, period=0.002) as one, LiveClient(url(live), {"/maglev/sample"}) as client:
        flooding = threading.Thread(target=flood)
        flooding.start()
        try:
            heard, end = list(client.messages(2.0)), time.monotonic() + 60.0
            while len(heard) <= 100 and time.monotonic() < end:  # a busy machine takes fewer samples
                heard += client.messages(0.5)
        finally:
            over.set()
            flooding.join()
        heard += client.messages(0.5)
        waited(lambda: not client.set(damping=70.0)["reason"], 30.0)  # what had come of the flood is newer
        assert one.session.snapshot().state == "running"
    ticks = [(message.fields.stretch, message.fields.tick) for message in heard]
    assert len(ticks) > 100
    for (stretch, tick), after in itertools.pairwise(ticks):
        assert after in ((stretch, tick + 1), (stretch + 1, 0))


@machine
def test_pages_of_other_sites_are_refused_and_the_app_is_served(live: LiveServer) -> None:
    known = [Subprotocol("foxglove.sdk.v1")]
    with pytest.raises(InvalidStatus, match="403"), connect(url(live), origin=Origin(EVIL[0]), subprotocols=known):
        pass
    with connect(url(live), origin=Origin(APP), subprotocols=known) as line:
        assert json.loads(line.recv(5.0))["op"] == "serverInfo"


@machine
@pytest.mark.needs("linux")
def test_the_server_behind_the_guard_is_nowhere_that_a_page_could_find(live: LiveServer) -> None:
    process = Path(f"/proc/{live._process._process.pid}/fd")
    sockets = {os.readlink(one)[8:-1] for one in process.iterdir() if "socket:" in os.readlink(one)}
    rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    places = [row[1].split(":") for row in rows if row[3] == "0A" and row[9] in sockets]
    hosts = {int(port, 16): socket.inet_ntoa(bytes.fromhex(host)[::-1]) for host, port in places}
    assert len(hosts) == 2 and hosts.pop(live.port) == "127.0.0.1"
    (hidden,) = hosts.values()
    assert hidden.startswith("127.") and hidden != "127.0.0.1"
    assert os.getpriority(os.PRIO_PROCESS, live._process._process.pid or 0) == min(os.nice(0) + NICE, 19)


@machine
def test_a_port_is_had_once_and_again_at_once() -> None:
    # It closes with programs there, one of which waits for an answer.
    with closing(LiveServer(0)) as first:
        with pytest.raises(
            LiveServerError, match=rf"cannot listen at port {first.port} of 127\.0\.0\.1: Address already"
        ):
            LiveServer(first.port)
        first.show(Snapshot(scene=Joystick(), delay=0.0015))  # of a loop that never answers
        with LiveClient(url(first)) as client, LiveClient(url(first)) as other:

            def wait() -> None:
                with pytest.raises(ConnectionClosed):
                    other.set(wall=False)

            waits = threading.Thread(target=wait)
            waits.start()
            while first.take() is None:
                time.sleep(0.01)
            first.close()
            assert first._process._process.exitcode == 0  # by itself
            with pytest.raises(ConnectionClosed):
                client.parameters()
            waits.join()
            with closing(LiveServer(first.port)) as second:
                assert second.port == first.port
        first.close()
    for port in (-1, 65536, True, 8765.0):
        with pytest.raises(ParameterError, match="port must be a whole number of 0 to 65535"):
            LiveServer(port)  # type: ignore[arg-type]


@machine
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_a_scene_goes_on_where_the_process_of_its_server_does_not(end: signal.Signals) -> None:
    with closing(LiveServer(0)) as server, running(server) as one:
        process = server._process._process
        assert process.pid is not None
        os.kill(process.pid, end)
        done = len(one.scenes)
        for _ in range(300):
            one.asked.append(lambda: one.session._recorder.failed("x" * 2000))
        while len(one.scenes) < done + 50:
            time.sleep(0.01)
        assert one.session.snapshot().state == "running"
        os.kill(process.pid, signal.SIGKILL)


ODD = """
import os, time
from maglev_mj.control import Hold
from maglev_mj.parameters import param
from maglev_mj.scenes import Scene

class Odd(Scene):
    stiffness: float = param("stiffness", "N/m", default=1000.0, live=True)
    ends: bool = param("ends the process", default=False, live=True)
    sleeps: bool = param("takes its time", default=False, live=True)
    def laws(self):
        if self.ends:
            os._exit(3)
        if self.sleeps:
            time.sleep(60.0)
        return [Hold(axes=("x", "y", "z"), stiffness=self.stiffness, damping=20.0)]
"""


@machine
def test_a_check_that_dies_or_does_not_end_is_given_up(
    live: LiveServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The process that checks is replaced; the next request is checked as any other.
    from maglev_mj.interop.foxglove import service

    (tmp_path / "odd.py").write_text(ODD)
    scene = find_scene(str(tmp_path / "odd.py"))()
    near, far = Pipe()
    with closing(Ring()) as ring, socket.create_server(("127.0.0.1", 0)) as public:
        arguments = far, RowReader(ring.path), public, NAMED
        serving = threading.Thread(target=service.serve, args=arguments)
        serving.start()
        assert near.recv() == ""
        near.send((0, "show", state(scene), None))
        address = f"ws://127.0.0.1:{public.getsockname()[1]}"
        for origin in NAMED:
            connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")], origin=Origin(origin)).close()
        with pytest.raises(InvalidStatus):
            connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")], origin=Origin("http://192.168.0.6:8080"))
        with LiveClient(address) as client:
            for request, said in (
                ({"stiffness": 1e5}, "must be below 1"),
                ({"ends": True}, "it is not known whether .* stable: the process that computes it has ended"),
                ({"stiffness": 1e5}, "must be below 1"),
                ({"sleeps": True}, r"it is not known whether .* stable: it takes over 0\.5 s"),
                ({"stiffness": 1e5}, "must be below 1"),
            ):
                # a process that takes the place of another has to load first
                monkeypatch.setattr("maglev_mj.process.LONGEST_ANSWER", 0.5 if "sleeps" in request else 60.0)
                assert re.search(said, client.set(**request)["reason"])
            assert not near.poll()
            answers: list[dict[str, Any]] = []
            waits = threading.Thread(target=lambda: answers.append(client.set(stiffness=500.0)))
            waits.start()
            assert near.poll(30.0)
            wanted = near.recv()  # the loop has it, and what checked it dies: that is no answer
            for process in active_children():
                if process.pid != live._process._process.pid:
                    process.kill()
            near.send((0, "stick", None))
            time.sleep(0.5)
            near.send((0, "show", state(wanted), Answer(7)))
            waits.join()
            assert answers[0]["since"] == 7
            near.send((0, "show", Nowhere(), None))
            waited(lambda: not client.parameters(), 30.0)
            assert "the scene is not known here: RuntimeError: no" in client.set(wall=True)["reason"]
            near.close()
            serving.join(10.0)
    assert not serving.is_alive()


def _fails(error: type[Exception]) -> None:
    raise error("no")


class Nowhere:
    """Cannot be made anew in another process."""

    def __init__(self, error: type[Exception] = RuntimeError) -> None:
        self._error = error

    def __reduce__(self) -> Any:
        return _fails, (self._error,)


def complains(line: Any, *_: object) -> None:
    line.send("OSError: no such address")


def test_why_the_process_does_not_start_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.interop.foxglove.server._serve", complains)
    with pytest.raises(LiveServerError, match="of the live server does not start: OSError: no such address"):
        LiveServer(0)


@machine
def test_a_server_in_a_script_without_a_guard_is_one_line(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from maglev_mj.interop.foxglove import LiveServer\nfrom maglev_mj.errors import MaglevError\n"
        "try:\n    LiveServer(0)\nexcept MaglevError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout.splitlines()[-1].endswith('a script that opens one needs `if __name__ == "__main__":`')


@machine
def test_no_process_is_left_where_the_program_is_killed() -> None:
    code = """if __name__ == "__main__":
    import time
    from maglev_mj.interop.foxglove import LiveServer
    print(LiveServer(0)._process._process.pid, flush=True)
    time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        own = int(program.stdout.readline())
        program.kill()
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            try:
                if "Z" in Path(f"/proc/{own}/stat").read_text().split()[2]:
                    return
            except FileNotFoundError:
                return
            time.sleep(0.05)
    pytest.fail("it goes on")


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


def test_no_memory_to_share_is_an_error_of_the_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("maglev_mj.recording.ring._MEMORY", tmp_path)
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(LiveServerError, match="no memory to share with the live server: No space left on device"):
        LiveServer(0)
    assert not list(tmp_path.iterdir())


def test_a_server_whose_process_cannot_start_leaves_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.recording.ring._MEMORY", tmp_path)
    monkeypatch.setattr("maglev_mj.interop.foxglove.server.SideProcess", lambda *_: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        LiveServer(0)
    assert not list(tmp_path.iterdir())


def test_its_process_removes_the_memory_of_a_program_that_was_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    # On Windows, where nobody could before.
    from maglev_mj.interop.foxglove import server, service

    ring, unlink = Ring(), Path.unlink

    def in_use(path: Path, missing_ok: bool = False) -> None:
        monkeypatch.setattr(Path, "unlink", unlink)
        raise PermissionError(13, "it is used by another process")

    monkeypatch.setattr(Path, "unlink", in_use)
    monkeypatch.setattr(service, "serve", lambda *_: None)
    monkeypatch.setattr(server, "be_nice", lambda: None)
    monkeypatch.setattr(os, "_exit", sys.exit)
    near, far = Pipe()
    with near, far, pytest.raises(SystemExit):
        server._serve(far, ring.path, None, ())
    assert not ring.path.exists()
    ring.close()


def test_without_its_package_it_says_which(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.errors.find_spec", lambda name: None)
    with pytest.raises(
        MissingPackageError, match=r"a live server needs foxglove-sdk: .* -m pip install 'foxglove-sdk>="
    ):
        LiveServer(0)


@machine
def test_the_example_watches_and_sets(live: LiveServer) -> None:
    command = [sys.executable, str(Path(__file__).parent.parent / "scripts" / "examples" / "live_client.py")]
    with running(live):
        done = subprocess.run(
            [*command, url(live), "--seconds", "0.5", "--set", "stiffness=3000", "--set", "stiffness=6e4"],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
    assert (done.returncode, done.stderr) == (0, "")
    parameters, accepted, refused, *poses = done.stdout.splitlines()
    assert json.loads(parameters)["stiffness"] == 6000.0
    assert '"reason": ""' in accepted and "must be below 1" in refused
    assert len(poses) >= 3 and all(re.fullmatch(r"tick \d+: x \S+ y \S+ z \S+ mm", line) for line in poses)
    done = subprocess.run([*command, "ws://127.0.0.1:9"], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1


# the page


def rows(heading: str) -> list[list[str]]:
    """Return the first table after a heading, without its head."""
    page = (Path(__file__).parent.parent / "docs" / "reference" / "live.md").read_text(encoding="utf-8")
    lines = itertools.dropwhile(lambda line: not line.startswith("|"), page[page.index(heading) :].splitlines())
    table = itertools.takewhile(lambda line: line.startswith("|"), lines)
    return [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in table][2:]


def test_the_tables_of_the_page_are_what_is_said() -> None:
    assert [row[0] for row in rows("| field |")] == list(Answer._fields)
    assert [row[0] for row in rows("| figure |")] == list(UnstableLoop._fields)
    parameters = {name: bounds for name, _, bounds, _ in rows("## Parameters")}
    assert sorted(parameters) == sorted(SETTABLE)
    found = {name: re.fullmatch(r"([\d.]+) to ([\d.]+)", bounds) for name, bounds in parameters.items()}
    numbers = {name: (float(match[1]), float(match[2])) for name, match in found.items() if match}
    assert set(numbers) == {"breakaway", "stiffness", "damping"}
    for name, (least, most) in numbers.items():
        for value in (least, most):
            assert getattr(Joystick.from_json({name: value}), name) == value
        for value in (math.nextafter(least, -1.0), math.nextafter(most, 1e9)):
            with pytest.raises(ParameterError):
                Joystick.from_json({name: value})
