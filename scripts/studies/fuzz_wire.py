"""Feeds a device damaged frames, keeps those that take it somewhere new, and damages them further.

    python scripts/studies/fuzz_wire.py [--seconds 10 | --runs N] [--seed 0]

An input is a handful of frames, given to a new device one after the other. It is kept if it takes a step from line to
line in wire.py or firmware.py that none before did. The exit status is 1 if anything raised, if a device was not sane
afterwards, or if a codec with a key took what was made without it.
"""

from __future__ import annotations

import argparse
import math
import random
import struct
import sys
import time
import traceback
import zlib
from collections.abc import Sequence
from types import FrameType
from typing import Any, TypeAlias

from maglev_mj.bridge import firmware as firmware_module
from maglev_mj.bridge import wire as wire_module
from maglev_mj.bridge.firmware import Firmware, Profile, Reading
from maglev_mj.bridge.wire import Codec, Command, Control, ControlAck, Hello, HelloAck, Operation, State, StateReport

Frames: TypeAlias = list[bytes]

SIX = (1.1, 1.1, 1.1, 0.0, -0.5, 0.5)
SESSION, PERIOD = 0x0A0B0C0D, 5_000_000
CALIBRATION = bytes(range(16))
KEY = bytes(range(32))
WATCHED = {wire_module.__file__, firmware_module.__file__}
STRANGE = [
    *(struct.pack("<d", one) for one in (math.nan, math.inf, -math.inf, 10.1, -1e308, 0.0, 1.5, 5e-324)),
    *(struct.pack("<I", one) for one in (0, 1, 2, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, SESSION)),
    *(bytes([one]) for one in range(9)),
]
MOST_FRAMES, MOST_BYTES = 12, 400


class Amplifiers:
    """See that nothing drives them but an active device with currents that it allows."""

    firmware: Firmware

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Take currents [A]."""
        assert self.firmware.state == State.ACTIVE, "driven while not active"
        assert all(abs(one) <= 10.00000001 for one in (*held, *(pulsed or ()))), "driven beyond the limit"
        assert 0.0 <= width <= 1.0, "driven for no width"

    def cut(self) -> None:
        """Take none."""


class Coverage:
    """Counts steps from line to line in the watched files, while it is on."""

    def __init__(self) -> None:
        self.edges: set[tuple[str, int, int]] = set()
        self.new = 0

    def __enter__(self) -> Coverage:
        self.new = 0
        sys.settrace(self._call)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _call(self, frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_code.co_filename
        if name not in WATCHED:
            return None
        last = -frame.f_code.co_firstlineno
        edges = self.edges

        def line(frame: FrameType, event: str, argument: Any) -> Any:
            nonlocal last
            edge = (name, last, frame.f_lineno if event == "line" else -1)
            last = frame.f_lineno
            if edge not in edges:
                edges.add(edge)
                self.new += 1
            return line

        return line


def seeds() -> list[Frames]:
    """Return sessions as they should be, with and without lockstep in mind, and one frame of each type."""
    codec = Codec()

    def frame(number: int, body: Any) -> bytes:
        return codec.encode(0 if isinstance(body, Hello) else SESSION, number, number * PERIOD, body)

    hello = frame(0, Hello(5, CALIBRATION))
    arm = frame(1, Control(1, Operation.ARM, 0, SIX))
    flight = [hello, arm, *(frame(number, Command(number - 1, 0, SIX, SIX, 0.001)) for number in (2, 3))]
    ends = [frame(9, Control(2, operation, 0, SIX)) for operation in (*Operation, 99)]
    others: list[Any] = [
        HelloAck(5, 0, 0, 1, 0, 1, CALIBRATION, PERIOD, 0, 0, 10.0, 3.0, 10.0, 0.012, 1.0),
        ControlAck(1, 1, 0, 0, 0),
        StateReport(SIX, SIX, SIX, 0, 7, 0, 0, 0, 0),
    ]
    return [[hello], flight, *([*flight, end] for end in ends), [hello, *(frame(1, one) for one in others)]]


def execute(frames: Frames) -> int:
    """Give a new device these frames; return how many its codec took.

    Raises:
        AssertionError: If the device is not sane, or a codec with a key took a frame.
    """
    codec, amplifiers, keyed = Codec(), Amplifiers(), Codec(KEY)
    profile = Profile(period=PERIOD, delay=1_500_000, calibration=CALIBRATION, lockstep=len(frames) % 2 == 1)
    device = Firmware(profile, amplifiers, codec, lambda: SESSION)
    amplifiers.firmware = device
    for number, data in enumerate(frames):
        now, before = number * PERIOD, device.state
        # a frame that begins with an odd byte comes from somebody else, after a long while, or after a bad sample
        kind = zlib.crc32(data[-4:]) % 16 if number else 0
        device.receive(data, now + (2_000_000_000 if kind == 1 else 0), "other" if kind == 2 else "host")
        assert (device.state == State.FAULT) == bool(device.faults), "a fault state without a fault"
        assert device.state != State.ACTIVE or device.session, "active without a session"
        if device.state not in (before, State.FAULT):
            asked = {State.FAULT: {Operation.RESET}, State.ACTIVE: {Operation.DISARM, Operation.BYE}}
            assert data[3] == 3 and data[24] in asked.get(before, {Operation.ARM}), "a state that nobody asked for"
        assert keyed.decode(data) is None, "a frame without a key was taken"
        spots = (0.001 * (1 + (kind == 3)),) * 6
        device.sample(number, now, Reading(spots, 7 if kind != 4 else 5, SIX, SIX, ((0.005, SIX),)))
    return len(frames) - sum(codec.dropped.values())


def mutated(corpus: list[Frames], draw: random.Random) -> Frames:
    """Return frames of the corpus, damaged."""
    frames = list(draw.choice(corpus))
    for _ in range(1 << draw.randrange(3)):
        place = draw.randrange(len(frames))
        kind = draw.randrange(10)
        if kind == 0 and len(frames) < MOST_FRAMES:
            other = draw.choice(corpus)
            at = draw.randrange(len(other))
            frames[place:place] = other[at : at + draw.randrange(1, 4)]
        elif kind == 1 and len(frames) > 1:
            del frames[place]
        elif kind == 2:
            frames.insert(place + 1, _repeated(frames[place], draw))
        else:
            frames[place] = _damaged(frames[place], draw.choice(draw.choice(corpus)), draw)
    return frames[:MOST_FRAMES]


def _repeated(data: bytes, draw: random.Random) -> bytes:
    """Return a frame as it is sent again: with a newer sequence number; and perhaps not quite the same."""
    new = bytearray(data)
    if len(new) >= 32:
        new[8:12] = struct.pack("<I", draw.randrange(1, 100))
        if draw.random() < 0.5:
            new[24] = draw.randrange(8)
        new[-4:] = struct.pack("<I", zlib.crc32(memoryview(new)[:-4]))
    return bytes(new)


def _damaged(data: bytes, other: bytes, draw: random.Random) -> bytes:
    new = bytearray(data)
    kind, place = draw.randrange(6), draw.randrange(len(data) + 1)
    if kind == 0 and new:
        bit = draw.randrange(8 * len(new))
        new[bit // 8] ^= 1 << bit % 8
    elif kind == 1:
        new = new[:place] + bytearray(other[draw.randrange(len(other) + 1) :])
    elif kind == 2:
        new = new[:place] if draw.random() < 0.5 else new + draw.randbytes(draw.choice((1, 4, 16)))
    elif kind == 3:
        value = draw.choice(STRANGE)
        new[place : place + len(value)] = value
    elif kind == 4 and len(new) > 12:  # the sequence number, which decides whether anybody looks further
        new[8:12] = struct.pack("<I", draw.choice((1, 2, 3, 50, 2**31 - 1, 2**31, 2**32 - 1)))
    elif len(new) > 24:  # a field of a few bytes near the front
        new[20 + draw.randrange(min(12, len(new) - 20))] = draw.randrange(256)
    if len(new) >= 8 and draw.random() < 0.8:
        new[-4:] = struct.pack("<I", zlib.crc32(memoryview(new)[:-4]))
    return bytes(new[:MOST_BYTES])


def main() -> int:
    """Fuzz, print what came of it, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=10.0, help="how long, unless --runs is given")
    parser.add_argument("--runs", type=int, help="how many executions")
    parser.add_argument("--seed", type=int, default=0, help="of the damage")
    arguments = parser.parse_args()
    draw, coverage = random.Random(arguments.seed), Coverage()
    corpus = seeds()
    end = time.monotonic() + arguments.seconds
    executions = accepted = raised = 0
    while executions < arguments.runs if arguments.runs is not None else time.monotonic() < end:
        frames = corpus[executions] if executions < len(seeds()) else mutated(corpus, draw)
        try:
            with coverage:
                accepted += execute(frames)
        except Exception:
            raised += 1
            traceback.print_exc(limit=-3)
            print("  given:", *(data.hex() or "-" for data in frames), file=sys.stderr)
        executions += 1
        if coverage.new and executions > len(seeds()):
            corpus.append(frames)
    print(f"executions {executions}  edges {len(coverage.edges)}  corpus {len(corpus)}  ", end="")
    print(f"accepted {accepted}  raised {raised}")
    return 1 if raised else 0


if __name__ == "__main__":
    sys.exit(main())
