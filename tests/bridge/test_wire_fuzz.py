"""Damaged frames into a device and a host: neither raises what its interface does not name, nor drives what it may not.

Hypothesis draws the damage, and shrinks what fails. With a key,
half of what is damaged is tagged anew, as by a peer that has the key and has gone mad.
"""

from __future__ import annotations

import hashlib
import math
import random
import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from maglev_mj.bridge import wire
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import Profile
from maglev_mj.bridge.twin.firmware import Firmware, Reading
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import Codec, ControlRequest, Estop, EstopAck, Fault, Hello, Operation, State
from maglev_mj.errors import MaglevError
from maglev_mj.frames import ZERO, Command

Frames: TypeAlias = list[bytes]

SIX = (1.1, 1.1, 1.1, 0.0, -0.5, 0.5)
SESSION, PERIOD, LIMIT = 0x0A0B0C0D, 5_000_000, 10.00000001
CALIBRATION, KEY = bytes(range(16)), bytes(range(32))
STRANGE = [
    *(struct.pack("<d", one) for one in (math.nan, math.inf, -math.inf, 10.1, -1e308, 0.0, 1.5, 5e-324)),
    *(struct.pack("<I", one) for one in (0, 1, 2, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, SESSION)),
    *(bytes([one]) for one in range(10)),
]
MOST_FRAMES, MOST_BYTES, CYCLES, DAMAGED = 12, 400, 40, 0.75
KEYS = pytest.mark.parametrize("key", [None, KEY], ids=["plain", "keyed"])
QUIET: dict[str, Any] = {"deadline": None, "database": None, "derandomize": True, "print_blob": True}


def tag(data: bytes | bytearray) -> bytes:
    """Return the tag of a message, by the page."""
    return hashlib.blake2s(data, digest_size=16, key=KEY).digest()


def sealed(draw: random.Random, data: bytearray, key: bytes | None) -> bytes:
    """Return data with a right CRC; with a key, with a tag that is right or wrong."""
    if key is not None and len(data) >= 24 and draw.random() < 0.5:
        data[-20:-4] = tag(data[:-20])
    data[-4:] = struct.pack("<I", zlib.crc32(memoryview(data)[:-4]))
    return bytes(data)


def damaged(draw: random.Random, data: bytes, other: bytes, key: bytes | None, again: float = 0.8) -> bytes:
    """Return a damaged frame, or one with a piece of another; sealed again with a probability."""
    new = bytearray(data)
    kind, place = draw.randrange(6), draw.randrange(len(data) + 1)
    if kind == 0 and new:
        bit = draw.randrange(8 * len(new))
        new[bit // 8] ^= 1 << bit % 8
    elif kind == 1:
        new = new[:place] + bytearray(other[draw.randrange(len(other) + 1) :])
    elif kind == 2:
        new = new[:place] if draw.random() < 0.5 else new + bytes(draw.choice((1, 4, 16)))
    elif kind == 3:
        value = draw.choice(STRANGE)
        new[place : place + len(value)] = value
    elif kind == 4 and len(new) > 12:  # the sequence number, which decides whether the rest is examined
        new[8:12] = struct.pack("<I", draw.choice((1, 2, 3, 50, 2**31 - 1, 2**31, 2**32 - 1)))
    elif len(new) > 24:  # a field of a few bytes near the front
        new[20 + draw.randrange(min(12, len(new) - 20))] = draw.randrange(256)
    resealed = len(new) >= 8 and draw.random() < again
    return (sealed(draw, new, key) if resealed else bytes(new))[:MOST_BYTES]


def repeated(draw: random.Random, data: bytes, key: bytes | None) -> bytes:
    """Return a repeated frame with a newer number, and perhaps another operation."""
    new = bytearray(data)
    if len(new) < 32:
        return data
    new[8:12] = struct.pack("<I", draw.randrange(1, 100))
    new[20:24] = struct.pack("<I", draw.randrange(1, 20))
    if draw.random() < 0.5:
        new[24] = draw.randrange(8)
    return sealed(draw, new, key)


def sessions(key: bytes | None) -> list[Frames]:
    """Return correct sessions, and one frame of each type."""
    codec = Codec(key)

    def frame(number: int, body: Any) -> bytes:
        session = 0 if isinstance(body, (Hello, Estop)) else SESSION
        return codec.encode(session, number, number * PERIOD, body)

    hello, stop = frame(0, Hello(5, CALIBRATION)), frame(9, Estop(77))
    arm = frame(1, ControlRequest(1, Operation.ARM, 0, SIX))
    walls = (wire.WallMessage(2, 1, 0.0, 6e3, 80.0, 0.0), wire.WallMessage(0, -1, 3e-3, 1e3, 0.0, 200.0))
    flight = [hello, arm, *(frame(number, wire.CommandFrame(number - 1, 0, SIX, SIX, 0.001)) for number in (2, 3))]
    ends = [frame(9, ControlRequest(2, operation, 0, SIX)) for operation in (*Operation, 3, 99)]
    reset = frame(10, ControlRequest(3, Operation.RESET, 0, SIX))
    others: list[Any] = [
        wire.blank(wire.HelloAck)._replace(nonce=5, calibration=CALIBRATION),
        wire.ControlAck(1, 1, 0, 0, 0),
        wire.blank(wire.StateReport),
        wire.blank(EstopAck),
    ]
    whole = [[hello], [stop], flight, [*flight, stop, reset, arm], [hello, *(frame(1, one) for one in others)]]
    walled = [*flight, frame(4, wire.CommandFrame(3, 0, SIX, SIX, 0.0, walls))]
    return [*whole, *([*flight, end] for end in ends), walled]


SESSIONS = {key: sessions(key) for key in (None, KEY)}


def input_of(draw: random.Random, key: bytes | None) -> Frames:
    """Return a correct session, some of its frames damaged, repeated, left out, or mixed with another's."""
    corpus = SESSIONS[key]
    frames = list(draw.choice(corpus))
    for _ in range(draw.randrange(5)):
        place, kind, other = draw.randrange(len(frames)), draw.randrange(10), draw.choice(corpus)
        if kind == 0:
            first = draw.randrange(len(other))
            frames[place:place] = other[first : first + draw.randrange(1, 4)]
        elif kind == 1 and len(frames) > 1:
            del frames[place]
        elif kind == 2:
            frames.insert(place + 1, repeated(draw, frames[place], key))
        else:
            frames[place] = damaged(draw, frames[place], draw.choice(other), key)
    return frames[:MOST_FRAMES]


class Amplifiers:
    """Amplifiers that check state and currents."""

    firmware: Firmware
    on = False

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        assert self.firmware.state == State.ACTIVE, "driven while not active"
        assert all(abs(one) <= LIMIT for one in (*held, *(pulsed or ()))), "driven beyond the limit"
        assert 0.0 <= width <= 1.0, "driven for no width"
        self.on = True

    def add(self, now: int, currents: Any) -> None: ...

    def cut(self) -> None:
        self.on = False

    def toggle(self, now: int) -> None:
        assert self.firmware.state == State.ACTIVE, "enabled while not active"


def check(device: Firmware, amplifiers: Amplifiers) -> None:
    """Check that state, faults, session and currents go together."""
    assert (device.state == State.FAULT) == bool(device.faults), "a fault state without a fault"
    assert device.state != State.ACTIVE or device.session, "active without a session"
    assert device.state == State.ACTIVE or not amplifiers.on, "a current outside ACTIVE"


def feed(frames: Frames, key: bytes | None, seen: Counter[str]) -> int:
    """Give frames to a new device, a sample after each, and an emergency stop at the end; return those accepted."""
    codec, amplifiers, stranger = Codec(key), Amplifiers(), Codec(bytes(16) if key else KEY)
    profile = Profile(period=PERIOD, delay=1_500_000, calibration=CALIBRATION, lockstep=len(frames) % 2 == 1)
    device = amplifiers.firmware = Firmware(profile, amplifiers, codec, lambda: SESSION)
    now = 0
    for number, data in enumerate(frames):
        now, before, dropped = number * PERIOD, device.state, sum(codec.dropped.values())
        # by its last bytes, a frame comes from another peer, after a long time, or before a bad sample
        kind = zlib.crc32(data[-4:]) % 16 if number else 0
        device.receive(data, now + (2_000_000_000 if kind == 1 else 0), "other" if kind == 2 else "host")
        if sum(codec.dropped.values()) == dropped:
            seen[f"{before.name} {data[3]}"] += 1
            assert key is None or data[-20:-4] == tag(data[:-20]), "a frame without its tag was taken"
        check(device, amplifiers)
        if device.state not in (before, State.FAULT):
            asked = {State.FAULT: {Operation.RESET}, State.ACTIVE: {Operation.DISARM, Operation.BYE}}
            assert data[3] == 3 and data[24] in asked.get(before, {Operation.ARM}), "a state that no one asked for"
        assert stranger.decode(data) is None, "a frame with another key, or none, was taken"
        spots, currents = (0.001 * (1 + (kind == 3)),) * 6, SIX if amplifiers.on else ZERO
        valid, conversions = 7 if kind != 4 else 5, number * (kind != 5)
        device.sample(number, now, Reading(spots, valid, currents, currents, ((0.005, currents),), conversions))
        check(device, amplifiers)
    answer = device.receive(Codec(key).encode(0, 0, now, Estop(78)), now, "stranger")
    frame = None if answer is None else Codec(key).decode(answer)
    assert frame is not None and isinstance(frame.body, EstopAck), "deaf to an emergency stop"
    assert frame.body.request == 78 and device.state == State.FAULT and device.faults & Fault.ESTOP, "not stopped"
    check(device, amplifiers)
    return len(frames) - sum(codec.dropped.values())


REACHED = {f"INACTIVE {kind}" for kind in (1, 3, 6, 7)} | {f"ACTIVE {kind}" for kind in (3, 6, 7)} | {"FAULT 3"}
"""States of a device and types of frames, as their numbers, that an input must have met."""


@KEYS
@pytest.mark.parametrize("count", [100, pytest.param(10_000, marks=pytest.mark.study)])
def test_damaged_frames_leave_a_device_sane_and_obedient_to_an_emergency_stop(count: int, key: bytes | None) -> None:
    seen = Counter[str]()
    for frames in SESSIONS[key]:
        feed(frames, key, seen)
    whole = seen.total()

    @settings(max_examples=count, **QUIET)
    @given(st.randoms(use_true_random=False))
    def fuzz(draw: random.Random) -> None:
        feed(input_of(draw, key), key, seen)

    fuzz()
    assert REACHED <= set(seen) and seen.total() - whole > count


class DamagedLine:
    """Line to a twin that damages three answers in four, and checks the host's frames."""

    def __init__(self, twin: Twin, draw: random.Random, key: bytes | None) -> None:
        self._link, self._draw, self._key, self._codec = VirtualLink(twin), draw, key, Codec(key)
        self._recent: Frames = [self._codec.encode(SESSION, 0, 0, wire.blank(EstopAck)._replace(request=77))]

    def send(self, data: bytes) -> None:
        frame = self._codec.decode(data)
        assert frame is not None, "the host sent what is no frame"
        if isinstance(frame.body, wire.CommandFrame):
            assert all(abs(one) <= LIMIT for one in (*frame.body.held, *frame.body.pulsed)), "beyond the limit"
        self._link.send(data)

    def receive(self, timeout: float) -> bytes | None:
        draw = self._draw
        if draw.random() < DAMAGED:
            return damaged(draw, draw.choice(self._recent), draw.choice(self._recent), self._key, again=0.3)
        data = self._link.receive(timeout)
        if data is not None:
            self._recent = [*self._recent[-20:], data]
        return data

    def now(self) -> int:
        return self._link.now()

    def close(self) -> None:
        pass

    def rest(self, seconds: float) -> None:
        """Advance time without a host."""
        end = self.now() + round(seconds * 1e9)
        while self.now() < end:
            self._link.receive((end - self.now()) * 1e-9)


@KEYS
@pytest.mark.parametrize("count", [4, pytest.param(200, marks=pytest.mark.study)])
def test_damaged_answers_end_a_flight_by_an_error_that_is_named(count: int, key: bytes | None, tmp_path: Path) -> None:
    @settings(max_examples=count, suppress_health_check=[HealthCheck.too_slow], **QUIET)
    @given(st.integers(0, 2**32))
    def fuzz(seed: int) -> None:
        draw, twin = random.Random(seed), Twin(TwinParameters(seed=1), key=key)
        line = DamagedLine(twin, draw, key)
        with suppress(MaglevError), RemotePlant(line, key=key, patience=0.2, folder=tmp_path) as plant:
            plant.arm()
            for _ in range(CYCLES):
                plant.read()
                plant.write(Command([0.0, 0.0, 7.0, 0.0, 0.0, 0.0]))
            if draw.random() < 0.5:
                with suppress(MaglevError):
                    plant.estop()
                assert twin.firmware.state == State.FAULT, "not stopped"
        line.rest(0.1)  # longer than the watchdog waits
        assert twin.firmware.state != State.ACTIVE and not twin.plant.currents.any(), "currents go on without a host"

    fuzz()
