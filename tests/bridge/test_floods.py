"""A flood of frames delays no sample and no emergency stop, in Python and in C, in virtual time."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from ctypes import c_size_t, c_uint8, c_uint32, c_uint64, c_void_p
from itertools import pairwise
from typing import Any, NamedTuple

import pytest

from maglev_mj.bridge import Twin, TwinParameters, wire
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.twin.firmware import Reading
from maglev_mj.bridge.twin.twin import TwinServer
from maglev_mj.bridge.wire import Codec, Operation
from tests.bridge.firmware_core import FIRMWARES, CoreFirmware, library
from tests.bridge.test_wire import KEY

PERIOD = 5_000_000
CALIBRATION = Calibration.nominal()
HOVER = tuple(CALIBRATION.hover.tolist())
STOP = tuple(CALIBRATION.controlled_stop(0.0065, 3.0))
ZERO = (0.0,) * 6

firmwares = pytest.mark.parametrize("firmware", FIRMWARES)

INSTRUCTION = 1e3 / 168  # [ns]
READ, ANSWER = round(100 * INSTRUCTION), round(29_000 * INSTRUCTION)  # of a HELLO with a key: see maglev_firmware.c
FLOOD = 4096


class Line:
    """Device's end of a line, in virtual time: reading a frame and answering one take the time of their instructions.

    Attributes:
        now: Time [ns].
        sent: Times and types of answers.
    """

    address = ("nowhere", 0)

    def __init__(self, frames: Sequence[tuple[int, bytes, str]]) -> None:
        self.now, self.sent, self._frames = 0, list[tuple[int, int]](), sorted(frames, key=lambda frame: frame[0])

    @property
    def due(self) -> int:
        return self._frames[0][0] if self._frames else 1 << 62

    def receive(self, timeout: float) -> tuple[bytes, Any] | None:
        self.now += READ
        if self.due > self.now:
            self.now = max(self.now, min(self.due, self.now + round(timeout * 1e9)))
        return self._frames.pop(0)[1:] if self.due <= self.now else None

    def send(self, data: bytes, address: Any) -> None:
        self.now += ANSWER
        self.sent.append((self.now, data[3]))

    def sleep(self, seconds: float) -> None:
        self.now += max(round(seconds * 1e9), READ)

    def close(self) -> None:
        pass


class Served(NamedTuple):
    """What a device did: times of sample steps and of changes of the enable line [ns]; answers."""

    samples: list[int]
    toggles: list[int]
    answers: list[tuple[int, int]]


def served_python(line: Line, seconds: float, monkeypatch: pytest.MonkeyPatch) -> Served:
    twin = Twin(TwinParameters(plant="exact"), key=KEY, draw=lambda: 7)
    samples, toggles = list[int](), list[int]()

    def noting(times: list[int], call: Callable[..., Any]) -> Callable[..., Any]:
        def noted(*arguments: Any) -> Any:
            times.append(line.now)
            return call(*arguments)

        return noted

    monkeypatch.setattr(twin, "sample", noting(samples, twin.sample))
    monkeypatch.setattr(twin.board, "toggle", noting(toggles, twin.board.toggle))
    monkeypatch.setattr("time.monotonic_ns", lambda: line.now)
    monkeypatch.setattr("time.sleep", line.sleep)
    server = TwinServer(twin, line)
    server._send = lambda frame: None  # type: ignore[method-assign]  # STATEs take their time after the sample
    server.run(seconds)
    return Served(samples, toggles, line.sent)


class _Waiting(ctypes.Structure):
    _fields_ = [("peer", c_uint64), ("length", c_size_t), ("data", c_uint8 * 385)]


_NEXT = ctypes.CFUNCTYPE(c_size_t, c_void_p, ctypes.POINTER(c_uint8 * 385), ctypes.POINTER(c_uint64))
_SEND = ctypes.CFUNCTYPE(None, c_void_p, c_uint64, ctypes.POINTER(c_uint8 * 384), c_size_t)
_CLOCK = ctypes.CFUNCTYPE(c_uint64, c_void_p)


class _Queue(ctypes.Structure):
    _fields_ = [
        ("context", c_void_p),
        ("next", _NEXT),
        ("send", _SEND),
        ("clock", _CLOCK),
        ("frames", ctypes.POINTER(_Waiting)),
        *[(name, c_uint32) for name in ("size", "first", "count", "number")],
        ("spent", c_uint64),
    ]


class Amplifiers:
    """Amplifiers that record the changes of the enable line."""

    def __init__(self, line: Line) -> None:
        self._line, self.toggles, self.currents = line, list[int](), ZERO

    def drive(self, now: int, held: Any, pulsed: Any, width: float) -> None:
        self.currents = held

    def cut(self) -> None:
        self.currents = ZERO

    def toggle(self, now: int) -> None:
        self.toggles.append(self._line.now)


def served_c(line: Line, seconds: float, monkeypatch: pytest.MonkeyPatch) -> Served:
    """Run the loop of a board with `maglev_serve`."""
    amplifiers: Any = Amplifiers(line)
    device = CoreFirmware(TwinParameters().profile, amplifiers, Codec(KEY), lambda: 7)
    core, samples, peers = library(), list[int](), ["host", "anyone"]

    def read(_: Any, data: Any, peer: Any) -> int:
        if (arrived := line.receive(0.0)) is None:
            return 0
        ctypes.memmove(data, arrived[0], len(arrived[0]))
        peer[0] = peers.index(arrived[1])
        return len(arrived[0])

    def clock(_: Any) -> int:
        device._now = line.now
        return line.now

    def send(_: Any, peer: int, data: Any, length: int) -> None:
        line.send(bytes(data[0][:length]), peers[peer])

    frames = (_Waiting * (FLOOD + 1))()
    queue = _Queue(None, _NEXT(read), _SEND(send), _CLOCK(clock), frames, len(frames))
    memory, place = device._memory, ctypes.byref(queue)
    for tick in range(round(seconds * 1e9) // PERIOD):
        while line.now < tick * PERIOD:
            core.maglev_serve(memory, place)
            rest = tick * PERIOD if core.maglev_rests(memory, place) else min(tick * PERIOD, line.due)
            line.now = max(line.now, rest)
        core.maglev_serve(memory, place)
        device._passed_on(b"")
        samples.append(line.now)
        spots = [1e-6 * (tick % 2 + k) for k in range(6)]
        currents = amplifiers.currents
        device.sample(tick, tick * PERIOD, Reading(spots, 7, currents, currents, ((5e-3, currents),), tick + 1))
    return Served(samples, amplifiers.toggles, line.sent)


SERVED: dict[str, Callable[[Line, float, pytest.MonkeyPatch], Served]] = {"python": served_python, "c": served_c}


def flood(at: int, *, estop: bool) -> Line:
    """Return the line of a host that arms its device, and of somebody who sends HELLOs at a time [ns]."""
    codec = Codec(KEY)
    frames = [
        (1_000_000, codec.encode(0, 0, 0, wire.Hello(1, CALIBRATION.digest)), "host"),
        (6_000_000, codec.encode(7, 0, 0, wire.ControlRequest(1, Operation.ARM, 0, HOVER, STOP)), "host"),
    ]
    hello = codec.encode(0, 0, 0, wire.Hello(2, CALIBRATION.digest))
    frames += [(at, hello, "anyone")] * FLOOD
    if estop:
        frames.append((at, codec.encode(0, 0, 0, wire.Estop(1)), "anyone"))
    return Line(frames)


@firmwares
@pytest.mark.parametrize("phase", [0.1, 0.9])
def test_an_estop_behind_a_flood_is_answered_within_a_period(
    phase: float, firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = round((3 + phase) * PERIOD)
    served = SERVED[firmware](flood(at, estop=True), 0.06, monkeypatch)
    (answered,) = [time for time, kind in served.answers if kind == 8]
    assert answered - at <= PERIOD
    late = [time - tick * PERIOD for tick, time in enumerate(served.samples)]
    # one that begins just before a sample may take its half period from that
    bound = 10 * READ if phase < 0.5 else PERIOD // 2 + ANSWER
    assert len(late) >= 12 and max(late[1:]) <= bound and max(late[5:]) <= 10 * READ
    waiting = [time for time, kind in served.answers if kind == 2 and time > at]
    assert 12 * 7 < len(waiting) < 12 * 16  # of 4096, in half of each period


@firmwares
def test_the_enable_line_lives_through_a_flood(firmware: str, monkeypatch: pytest.MonkeyPatch) -> None:
    served = SERVED[firmware](flood(round(3.1 * PERIOD), estop=False), 0.05, monkeypatch)
    steps = [later - sooner for sooner, later in pairwise(served.toggles)]
    assert len(served.toggles) >= 9 and max(steps) <= 1.01 * PERIOD


@pytest.mark.needs("compiler")
def test_a_full_queue_drops_what_is_no_estop(monkeypatch: pytest.MonkeyPatch) -> None:
    line = flood(round(3.1 * PERIOD), estop=True)
    monkeypatch.setattr("tests.bridge.test_floods.FLOOD", 9)
    served = served_c(line, 0.03, monkeypatch)
    assert [kind for time, kind in served.answers if time > 3 * PERIOD].count(8) == 1
