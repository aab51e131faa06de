"""Firmware in C: equal to Python's, flying, hardened, small enough.

It fits a Cortex-M4.
"""

from __future__ import annotations

import ctypes
import math
import random
import re
import subprocess
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.links import cobs_decode, cobs_encode
from maglev_mj.bridge.safety import Limits, Profile
from maglev_mj.bridge.twin.firmware import Firmware, Reading
from maglev_mj.bridge.wire import (
    VERSION,
    Codec,
    CommandFrame,
    ControlAck,
    ControlRequest,
    Estop,
    Fault,
    Hello,
    Operation,
    State,
    WallMessage,
)
from tests.bridge.firmware_core import FOLDER, LARGEST, SANITIZED, STRICT, CoreFirmware, library
from tests.bridge.test_wire import sealed
from tests.conftest import COMPILER

PERIOD = 5_000_000
KEY = bytes(range(32))
CALIBRATION = bytes(range(16))
PROFILE = Profile(period=PERIOD, delay=1_500_000, calibration=CALIBRATION, limits=Limits(hover_limit=1.5))
WALLED = replace(PROFILE, wall_period=1_000_000, wall_delay=200_000, wall_maps=Calibration.nominal().wall_maps)
ZERO = (0.0,) * 6
HOVER = (1.1, 1.1, 1.1, 0.0, 0.0, 0.0)
ODD = (math.nan, math.inf, -math.inf, 10.1, -10.1, 1e308, 5e-324)
BY_DEVICE = Fault(sum(Fault)) & ~(Fault.BOUNDARY | Fault.CLOCK | Fault.NOT_FOLLOWING)

pytestmark = [pytest.mark.needs("own compiler"), pytest.mark.xdist_group("firmware in C")]  # compiled once


class Amplifiers:
    """Amplifiers that record their commands and currents.

    Attributes:
        told: Calls with their arguments, in order.
        currents: Flowing currents [A], six.
    """

    def __init__(self) -> None:
        self.told: list[Any] = []
        self.currents: Sequence[float] = ZERO

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        self.told.append((now, held, pulsed, width))
        self.currents = held

    def add(self, now: int, currents: Sequence[float]) -> None:
        self.told.append(("add", now, tuple(currents)))

    def cut(self) -> None:
        self.told.append("cut")
        self.currents = ZERO

    def toggle(self, now: int) -> None:
        self.told.append(now)


class Side:
    """One of two devices that are told the same."""

    def __init__(self, made: Any, profile: Profile, key: bytes | None) -> None:
        self.amplifiers, self.codec = Amplifiers(), Codec(key)
        draw = random.Random(1)
        self.device = made(profile, self.amplifiers, self.codec, lambda: draw.randrange(1, 2**32))

    def outcome(self, answer: bytes | None) -> tuple[Any, ...]:
        device = self.device
        told, self.amplifiers.told = self.amplifiers.told, []
        return (
            *(answer and answer.hex(), told, device.state, device.faults),
            *(device.session, device.peer, device.counts, self.codec.dropped, device.answered),
        )


class Exchange:
    """Random frames and samples for both devices.

    One thing at a time goes wrong.

    Attributes:
        faults: All faults latched so far.
        frames: Number of answers to each frame type.
        stops: Number of steps in controlled stops.
    """

    WRONGS = "nothing frames currents silence spots frozen stopped measured hot disabled walls nothing".split()

    def __init__(self, profile: Profile, key: bytes | None, seed: int) -> None:
        self.sides = [Side(made, profile, key) for made in (Firmware, CoreFirmware)]
        self.draw, self.host = random.Random(seed), Codec(key)
        self.now = self.sequence = self.request = self.conversions = 0
        self.tick = 2**32 - 500  # numbers go round
        self.wrong = "nothing"
        self.spots = [1e-3] * 6
        self.faults, self.frames, self.stops, self.forces = Fault(0), Counter[int](), 0, 0
        self.walls = 3 if profile.wall_period else 0

    def run(self, steps: int, each: int = 120) -> None:
        """Run frames and samples; compare after each. What goes wrong changes after as many steps as `each`."""
        for number in range(steps):
            if number % each == 0:
                self.wrong = self.WRONGS[number // each % len(self.WRONGS)]
                self.now += self.draw.choice([0, 3_000_000_000])  # coils cool, and a session may be taken over
            (self.sample if self.draw.random() < 0.5 else self.frame)()
            if self.draw.random() < 0.5:
                self.wall()

    def bad(self, wrong: str, share: float) -> bool:
        """Return True if an error is due now."""
        return self.wrong == wrong and self.draw.random() < share

    def compare(self, outcomes: Sequence[tuple[Any, ...]]) -> None:
        python, c = outcomes
        assert c == python
        self.faults |= self.sides[0].device.faults
        self.stops += self.sides[0].device.stopping
        assert self.sides[1].device.stopping == self.sides[0].device.stopping
        if python[0]:
            self.frames[int(python[0][6:8], 16)] += 1

    def frame(self) -> None:
        peer = "other" if self.bad("frames", 0.1) else "host"
        body, device = self.body(), self.sides[0].device
        session = self.draw.randrange(2**32) if self.bad("frames", 0.05) else device.session
        data = bytearray(self.host.encode(session, self.sequence % 2**32, self.draw.randrange(2**64), body))
        if self.bad("frames", 0.1):
            data[self.draw.randrange(self.draw.choice([4, len(data)]))] ^= 1 << self.draw.randrange(8)
        if self.bad("frames", 0.05):
            del data[self.draw.randrange(self.draw.choice([4, len(data)])) :]
        self.now += self.draw.randrange(PERIOD // 2) if self.bad("frames", 0.5) else 0
        self.compare([side.outcome(side.device.receive(bytes(data), self.now, peer)) for side in self.sides])

    def body(self) -> Any:
        draw, kind = self.draw, self.draw.random()
        if kind < 0.03:
            return Hello(draw.choice([1, 1, 2]), bytes(16) if self.bad("frames", 0.3) else CALIBRATION)
        if self.bad("frames", 0.05):
            return draw.choice([Estop(draw.randrange(2**64)), ControlAck(1, 1, 0, 0, 0)])
        if kind < 0.3 or self.wrong == "silence":
            usual = {State.INACTIVE: Operation.ARM, State.FAULT: Operation.RESET}.get(self.sides[0].device.state, 0)
            others = [*Operation, *[Operation.TRIP] * 3, 0, 3, 255]
            operation = draw.choice(others) if self.bad("frames", 0.4) else usual
            self.request += draw.choice([1, 1, 1, 1, 0, -1, 5])
            faults = draw.choice([0, 32, 1040, 1040, 2**31])
            return ControlRequest(self.request % 2**32, operation, faults, self.currents(), self.stop())
        self.sequence += draw.choice([1] * 8 + [0, -1, 3])
        answers = self.tick - (draw.choice([1, 3, 4, 5, -1]) if self.bad("frames", 0.2) else 0)
        width = draw.choice([-1e-9, 1.1, *ODD]) if self.bad("currents", 0.03) else draw.choice([0.0, 0.001])
        walls = tuple(self.one_wall(index) for index in range(draw.randrange(self.walls + 1)))
        return CommandFrame(answers % 2**32, 0, self.currents(), self.currents(), width, walls)

    def one_wall(self, index: int) -> WallMessage:
        draw, axis, side = self.draw, (2, 0, 4)[index], (1, -1, 0)[index]
        lever = 1.0 if axis < 3 else 0.03
        share = draw.choice([0.05, 1.0]) * lever**2
        wall = WallMessage(axis, side, draw.uniform(-1e-4, 1e-4) / lever, 1e5 * share, 400.0 * share, 0.0)
        if self.bad("walls", 0.1):
            name, odd = draw.choice(["edge", "stiffness", "damping", "cutoff"]), draw.choice([-1.0, 1.1e5, *ODD])
            changes: list[dict[str, Any]] = [{name: odd}, {"axis": 6}, {"side": 2}]
            wall = wall._replace(**draw.choice(changes))
        return wall

    def wall(self) -> None:
        """Sample the walls between two samples of the host."""
        assert self.sides[1].device.walled == self.sides[0].device.walled
        draw, self.now = self.draw, self.now + 1_000_000
        size = draw.choice([1.0, 4e-4, 1e-5]) if self.wrong == "walls" else 1e-4
        spots = [draw.uniform(-size, size) for _ in range(6)] if self.walls else ZERO
        valid = 3 if self.bad("walls", 0.01) else 7
        for side in self.sides:
            side.device.wall(self.now, Reading(spots, valid, ZERO, ZERO))
        told = [call for call in self.sides[0].amplifiers.told if isinstance(call, tuple) and call[0] == "add"]
        self.forces += any(any(currents) for _, _, currents in told)
        self.compare([side.outcome(None) for side in self.sides])

    def currents(self) -> tuple[float, ...]:
        currents = [one * self.draw.uniform(0.5, 1.5) for one in HOVER]
        if self.bad("currents", 0.03):
            currents[self.draw.randrange(6)] = self.draw.choice(ODD)
        return tuple(currents)

    def stop(self) -> tuple[float, ...]:
        draw = self.draw
        stop = [*(draw.uniform(-2.0, 2.0) for _ in range(6)), draw.choice([0.0, 0.03, 0.5, 1.0]), draw.uniform(0, 2.2)]
        if self.bad("currents", 0.1):
            stop[draw.randrange(8)] = draw.choice(ODD)
        return tuple(stop)

    def sample(self) -> None:
        draw = self.draw
        steps = draw.choice([2, 3, 20]) if self.bad("silence", 0.1) else 1
        self.tick, self.now = (self.tick + steps) % 2**32, self.now + steps * PERIOD
        self.conversions += not self.bad("stopped", 0.1)
        if not self.bad("frozen", 0.98):
            self.spots = [draw.uniform(-2e-3, 2e-3) * (0.05 if self.walls else 1.0) for _ in self.spots]
        spots, valid = list(self.spots), 7
        if self.bad("spots", 0.2):
            spots[draw.randrange(6)] = draw.choice([0.0121, 0.0119, 0.009, 0.006, math.nan, math.inf, 1e308])
            valid = draw.choice([7, 7, 7, 3, 255, 0])
        flowing = self.sides[0].amplifiers.currents
        measured, heating = list(flowing), flowing
        if self.bad("measured", 0.8):
            measured[draw.randrange(6)] = draw.choice([9.0, 2.0, 0.26, 0.24, math.nan])
        if self.bad("hot", 0.2):
            heating = draw.choice([(8.0,) * 6, (*ZERO[:5], math.inf), measured])
        intervals = ((draw.choice([0.001, 0.002]), flowing), (draw.choice([0.0, 0.004, 1.0]), heating))
        enabled = not self.bad("disabled", 0.4)
        reading = Reading(spots, valid, measured, flowing, intervals, self.conversions, enabled)
        told = self.tick, self.now, reading
        self.compare([side.outcome(side.device.sample(*told)) for side in self.sides])


DEVICES: dict[str, dict[str, Any]] = {
    "lockstep": {"real time": False, "lockstep": True},
    "key": {"no key": None, "key": KEY},
    "profile": {"no walls": PROFILE, "walls": WALLED},
}


def every(test: Any) -> Any:
    """Run a test for each kind of device."""
    for name, kinds in DEVICES.items():
        test = pytest.mark.parametrize(name, [*kinds.values()], ids=[*kinds])(test)
    return test


@every
def test_it_does_in_a_short_exchange_what_the_firmware_in_python_does(
    profile: Profile, key: bytes | None, lockstep: bool
) -> None:
    """A tenth of the steps below, so that a broken core is noticed wherever there is a compiler."""
    exchange = Exchange(replace(profile, lockstep=lockstep), key, 7)
    exchange.run(1000, each=70)
    assert {2, 4, 5} <= set(exchange.frames) and len(exchange.faults) > 5 and exchange.stops
    assert exchange.forces or not profile.wall_period


@pytest.mark.needs("compiler")
@pytest.mark.parametrize("seeds", [2, pytest.param(4, marks=pytest.mark.study)])
@every
def test_it_does_what_the_firmware_in_python_does(
    profile: Profile, key: bytes | None, lockstep: bool, seeds: int
) -> None:
    faults, frames, counts = Fault(0), Counter[int](), Counter[str]()
    for seed in range(seeds):
        exchange = Exchange(replace(profile, lockstep=lockstep), key and key[: 32 - 5 * seed], seed)
        exchange.run(5000)
        assert exchange.stops > 50 and (exchange.forces > 100 or not profile.wall_period)
        faults |= exchange.faults
        frames += exchange.frames
        counts += exchange.sides[1].device.counts + exchange.sides[1].codec.dropped
    assert {2, 4, 5, 8} == set(frames)
    if profile.wall_period:
        assert Fault.WALL_ENERGY | Fault.INVALID_COMMAND | Fault.SENSOR_FROZEN in faults
        return
    assert faults == BY_DEVICE & ~Fault.WALL_ENERGY | Fault.BOUNDARY | Fault.CLOCK
    assert {"direction", "session", "old", "inactive", "busy", "crc", "magic", "short"} <= set(counts)


@pytest.mark.parametrize(
    ("change", "limits"),
    [
        ({"period": 0}, {}),
        ({"lockstep": 2}, {}),
        ({}, {"watchdog": 1e-10}),
        ({}, {"enable": 1e-10}),
        ({}, {"spot_speed": 0.0}),
        # which each alone may be
        ({}, {"watchdog": 1.000000001}),
        ({}, {"watchdog": 0.049999999}),
        ({"delay": 50_000_001}, {}),
        ({}, {"enable": 0.100000001}),
        ({}, {"stale": 0.024999999}),
        ({}, {"stale": 0.100000001}),
        ({}, {"hover_limit": 3.0 + 1e-12}),
        ({}, {"continuous_current": 10.0 + 1e-12}),
        ({"period": 2**63}, {"watchdog": 1.0}),
    ],
)
def test_it_does_not_start_as_no_device(change: dict[str, Any], limits: dict[str, float]) -> None:
    profile = replace(PROFILE, period=25_000_000, delay=50_000_000, limits=Limits(watchdog=0.1, enable=0.1, stale=0.1))
    CoreFirmware(profile, Amplifiers(), Codec(), lambda: 1)  # at the bounds
    if "watchdog" in limits:
        limits = {"enable": 0.025, "stale": 0.025, **limits}
    for owner, values in ((profile, change), (profile.limits, limits)):
        for name, value in values.items():
            object.__setattr__(owner, name, value)  # which they themselves would refuse
    with pytest.raises(ValueError):
        CoreFirmware(profile, Amplifiers(), Codec(), lambda: 1)


def test_a_board_that_tells_no_heating_has_its_coils_heated_by_what_is_measured() -> None:
    side = Side(CoreFirmware, PROFILE, None)
    side.device.heats = False
    currents = (6.0, 0.0, 0.0, 0.0, 0.0, -10.0)
    for tick in range(1, 1000):
        side.device.sample(tick, tick * PERIOD, Reading(ZERO, 7, currents, currents, ((1.0, ZERO),), tick))
        if side.device.faults & Fault.COIL_OVERTEMP:
            break
    expected = -10.0 * math.log(1.0 - 0.3**2)
    assert tick * PERIOD * 1e-9 == pytest.approx(expected, abs=2.1 * PERIOD * 1e-9)


def test_a_current_beyond_f32_is_clamped() -> None:
    side = Side(CoreFirmware, PROFILE, None)
    side.device.receive(Codec().encode(0, 0, 0, Hello(1, CALIBRATION)), 0, "host")
    frame: Any = side.codec.decode(side.device.sample(1, PERIOD, Reading(ZERO, 7, (1e300, -1e300, *ZERO[2:]), ZERO)))
    assert frame.body.currents[:2] == (largest := (2.0 - 2.0**-23) * 2.0**127, -largest)


@pytest.mark.parametrize("length", [15, 33])
def test_it_does_not_start_with_a_key_of_another_length(length: int) -> None:
    codec = Codec(KEY)
    codec._key = bytes(length)  # which the codec itself would refuse
    with pytest.raises(ValueError):
        CoreFirmware(PROFILE, Amplifiers(), codec, lambda: 1)


def test_no_session_has_the_number_0() -> None:
    device = CoreFirmware(PROFILE, Amplifiers(), Codec(), lambda: 0)
    assert device.receive(Codec().encode(0, 0, 0, Hello(1, CALIBRATION)), 0, "host") is not None
    assert device.session == 1


def test_a_frame_that_is_too_long_for_a_board_is_none() -> None:
    side = Side(CoreFirmware, PROFILE, None)
    for length, reason in ((LARGEST, "version"), (LARGEST + 1, "length")):
        data = bytearray(length)
        data[:4] = b"MJ" + bytes((VERSION + 1, 1))
        answer = side.device.receive(sealed(bytes(data)), 0, "host")
        assert (answer is not None) == (reason == "version") and side.codec.dropped[reason] == 1


@pytest.mark.parametrize("length", [1, 8, 253, 254, 255, 508, 509, LARGEST])
def test_cobs_is_that_of_the_serial_line(length: int) -> None:
    core, draw = library(), random.Random(length)
    line = ctypes.create_string_buffer(1024)
    for zeros in (0.0, 0.01, 0.3, 1.0):
        data = bytes(0 if draw.random() < zeros else draw.randrange(1, 256) for _ in range(length))
        out = ctypes.create_string_buffer(length + 5)
        size = core.maglev_stuff(data, ctypes.c_size_t(length), out)
        sent = out.raw[:size]
        assert sent == b"\0" + cobs_encode(data) + b"\0"
        noise = bytes(draw.randrange(1, 256) for _ in range(draw.randrange(900)))
        lengths = [core.maglev_unstuff(line, ctypes.c_uint8(byte)) for byte in noise + sent]
        assert lengths[-1] == length and line.raw[:length] == data


def test_bytes_of_a_line_that_are_no_frame_are_skipped() -> None:
    core, draw = library(), random.Random(3)
    line = ctypes.create_string_buffer(1024)
    for _ in range(500):
        piece = bytes(draw.choice([1, 2, 3, 255, draw.randrange(1, 256)]) for _ in range(draw.choice([3, 8, 800])))
        lengths = [core.maglev_unstuff(line, ctypes.c_uint8(byte)) for byte in piece + b"\0"]
        decoded = cobs_decode(piece) or b""
        decoded = decoded if len(decoded) <= LARGEST else b""
        assert not any(lengths[:-1]) and line.raw[: lengths[-1]] == decoded


@pytest.mark.needs("sanitizers")
@pytest.mark.parametrize("count", [5000, pytest.param(50_000, marks=pytest.mark.study)])
def test_mutated_frames_do_no_harm(count: int, tmp_path: Path) -> None:
    program, sources = tmp_path / "fuzz", [str(FOLDER / name) for name in ("fuzz_firmware.c", "maglev_firmware.c")]
    command = [str(COMPILER), *STRICT, *SANITIZED, *sources, "-o", str(program)]
    subprocess.run(command, capture_output=True, check=True, timeout=120)
    done = subprocess.run([program, str(count)], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    counts = dict(re.findall(r"(\w+) (\d+)", done.stdout.splitlines()[1]))
    assert len(counts) == 12 and all(map(int, counts.values()))  # each reason was met
    frames, flights, driven, stopped, pushed = map(int, re.findall(r"\d+", done.stdout.splitlines()[0]))
    assert frames == 2 * count and flights > count // 100 and driven > count // 10 and stopped > count * 3 // 500
    assert pushed > count // 100
    assert min(map(int, re.findall(r"\d+", done.stdout.splitlines()[2]))) > count // 100  # of inputs as libFuzzer's


@pytest.mark.needs("cross")
def test_it_compiles_for_a_cortex_m4_and_asks_for_no_library() -> None:
    make = subprocess.run(["make", "firmware"], cwd=FOLDER.parent.parent, capture_output=True, text=True, check=False)
    assert make.returncode == 0, make.stderr
    code, data, bss = map(int, re.findall(r"^\s*(\d+)\s+(\d+)\s+(\d+)", make.stdout, re.MULTILINE)[0])
    assert code < 12288 and data == bss == 0
