"""Feed damaged frames to a device and a host.

Those that take a device somewhere new are kept and damaged further.

    python scripts/studies/fuzz_wire.py [--device 100000] [--host 20000] [--runs N] [--seed 0]

A device's input is a handful of frames, given to a new device one after the other, and an emergency stop after them. It
is kept if it takes a step from line to line in wire.py or firmware.py that none before did. The host is `RemotePlant`
on a twin, whose answers are damaged on their way. All of it is done without a key, and as often with one: there, half
of what is damaged is tagged anew, as by a peer that has the key and has gone mad.

The exit status is 1 if anything raised but what the interfaces name, if a current flowed outside ACTIVE or beyond a
limit, if a device was deaf to an emergency stop, or if a codec with a key took what was made without it.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import random
import struct
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from types import FrameType
from typing import Any, TypeAlias

from maglev_mj.bridge import wire
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import Profile
from maglev_mj.bridge.twin import firmware as firmware_module
from maglev_mj.bridge.twin.firmware import Firmware, Reading
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import Codec, Control, Estop, EstopAck, Fault, Hello, Operation, State
from maglev_mj.errors import MaglevError
from maglev_mj.frames import ZERO, Command

Frames: TypeAlias = list[bytes]

SIX = (1.1, 1.1, 1.1, 0.0, -0.5, 0.5)
SESSION, PERIOD, LIMIT = 0x0A0B0C0D, 5_000_000, 10.00000001
CALIBRATION = bytes(range(16))
KEY = bytes(range(32))
WATCHED = {wire.__file__, firmware_module.__file__}
STRANGE = [
    *(struct.pack("<d", one) for one in (math.nan, math.inf, -math.inf, 10.1, -1e308, 0.0, 1.5, 5e-324)),
    *(struct.pack("<I", one) for one in (0, 1, 2, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, SESSION)),
    *(bytes([one]) for one in range(10)),
]
MOST_FRAMES, MOST_BYTES = 12, 400
TRACED = 2000
"""Inputs traced line by line; after that one in twenty."""

SESSION_CYCLES, DAMAGED = 40, 0.75
WEIGHT = [0.0, 0.0, 7.0, 0.0, 0.0, 0.0]


class Amplifiers:
    """Amplifiers that check state, and currents against those that it allows."""

    firmware: Firmware
    on = False

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Take currents [A]."""
        assert self.firmware.state == State.ACTIVE, "driven while not active"
        assert all(abs(one) <= LIMIT for one in (*held, *(pulsed or ()))), "driven beyond the limit"
        assert 0.0 <= width <= 1.0, "driven for no width"
        self.on = True

    def cut(self) -> None:
        """Take none."""
        self.on = False

    def toggle(self, now: int) -> None:
        """Take the enable line."""
        assert self.firmware.state == State.ACTIVE, "enabled while not active"


class Coverage:
    """Count steps from line to line in watched files."""

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


class Damage:
    """Damages frames, and seals them again.

    Args:
        seed: Of what is drawn.
        key: With which frames are sealed.
    """

    def __init__(self, seed: int, key: bytes | None) -> None:
        self.draw, self.key = random.Random(seed), key
        self.codec = Codec(key)

    def sealed(self, data: bytearray) -> bytes:
        """Return data with a CRC, and perhaps a tag.

        The CRC is right; the tag, with a key, is right or wrong.
        """
        if self.key is not None and len(data) >= 24 and self.draw.random() < 0.5:
            data[-20:-4] = tag(data[:-20])
        data[-4:] = struct.pack("<I", zlib.crc32(memoryview(data)[:-4]))
        return bytes(data)

    def frame(self, data: bytes, other: bytes, again: float = 0.8) -> bytes:
        """Return a damaged frame, or one with a piece of another; sealed again with a probability."""
        draw, new = self.draw, bytearray(data)
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
        if len(new) >= 8 and draw.random() < again:
            return self.sealed(new)[:MOST_BYTES]
        return bytes(new[:MOST_BYTES])

    def repeated(self, data: bytes) -> bytes:
        """Return a repeated frame with a newer number, and perhaps not quite the same."""
        draw, new = self.draw, bytearray(data)
        if len(new) >= 32:
            new[8:12] = struct.pack("<I", draw.randrange(1, 100))
            new[20:24] = struct.pack("<I", draw.randrange(1, 20))
            if draw.random() < 0.5:
                new[24] = draw.randrange(8)
            return self.sealed(new)
        return bytes(new)

    def input(self, corpus: list[Frames]) -> Frames:
        """Return frames of the corpus, damaged."""
        draw = self.draw
        frames = list(draw.choice(corpus))
        for _ in range(1 << draw.randrange(4)):
            place = draw.randrange(len(frames))
            kind = draw.randrange(10)
            if kind == 0 and len(frames) < MOST_FRAMES:
                other = draw.choice(corpus)
                at = draw.randrange(len(other))
                frames[place:place] = other[at : at + draw.randrange(1, 4)]
            elif kind == 1 and len(frames) > 1:
                del frames[place]
            elif kind == 2:
                frames.insert(place + 1, self.repeated(frames[place]))
            else:
                frames[place] = self.frame(frames[place], draw.choice(draw.choice(corpus)))
        return frames[:MOST_FRAMES]


def tag(data: bytes | bytearray) -> bytes:
    """Return the tag of a message, by the page."""
    return hashlib.blake2s(data, digest_size=16, key=KEY).digest()


def seeds(codec: Codec) -> list[Frames]:
    """Return correct sessions, and one frame of each type."""

    def frame(number: int, body: Any) -> bytes:
        session = 0 if isinstance(body, (Hello, Estop)) else SESSION
        return codec.encode(session, number, number * PERIOD, body)

    hello, stop = frame(0, Hello(5, CALIBRATION)), frame(9, Estop(77))
    arm = frame(1, Control(1, Operation.ARM, 0, SIX))
    commands = [frame(number, wire.Command(number - 1, 0, SIX, SIX, 0.001)) for number in (2, 3)]
    flight = [hello, arm, *commands]
    ends = [frame(9, Control(2, operation, 0, SIX)) for operation in (*Operation, 3, 99)]
    reset = frame(10, Control(3, Operation.RESET, 0, SIX))
    others: list[Any] = [
        wire.HelloAck(5, 0, 0, 3, 0, 1, CALIBRATION, PERIOD, 0, 0, 0, 0, 0, 0, 0, 20, 10.0, 3.0, 1.4, 10.0, 0.012, 1.0),
        wire.ControlAck(1, 1, 0, 0, 0),
        wire.StateReport(SIX, SIX, SIX, 0, 7, 0, 0, 0, 0, 1),
        EstopAck(77, 2, 128, 0, SIX),
    ]
    sessions = [[hello], [stop], flight, [*flight, stop, reset, arm], [hello, *(frame(1, one) for one in others)]]
    return [*sessions, *([*flight, end] for end in ends)]


def execute(frames: Frames, key: bytes | None, seen: Counter[str]) -> int:
    """Feed frames to a new device; return those accepted.

    Raises:
        AssertionError: If the device is not sane, is deaf to an emergency stop, or took a frame without its tag.
    """
    codec, amplifiers, stranger = Codec(key), Amplifiers(), Codec(bytes(16) if key else KEY)
    profile = Profile(period=PERIOD, delay=1_500_000, calibration=CALIBRATION, lockstep=len(frames) % 2 == 1)
    device = Firmware(profile, amplifiers, codec, lambda: SESSION)
    amplifiers.firmware = device
    now = 0
    for number, data in enumerate(frames):
        now, before, dropped = number * PERIOD, device.state, sum(codec.dropped.values())
        # what its last bytes say: it comes from somebody else, after a long while, or after a bad sample
        kind = zlib.crc32(data[-4:]) % 16 if number else 0
        device.receive(data, now + (2_000_000_000 if kind == 1 else 0), "other" if kind == 2 else "host")
        if sum(codec.dropped.values()) == dropped:
            seen[f"{before.name} {data[3]}"] += 1
            assert key is None or data[-20:-4] == tag(data[:-20]), "a frame without its tag was taken"
        sane(device, amplifiers)
        if device.state not in (before, State.FAULT):
            asked = {State.FAULT: {Operation.RESET}, State.ACTIVE: {Operation.DISARM, Operation.BYE}}
            assert data[3] == 3 and data[24] in asked.get(before, {Operation.ARM}), "a state that nobody asked for"
        assert stranger.decode(data) is None, "a frame with another key, or none, was taken"
        spots = (0.001 * (1 + (kind == 3)),) * 6
        currents = SIX if amplifiers.on else ZERO
        reading = Reading(spots, 7 if kind != 4 else 5, currents, currents, ((0.005, currents),), number * (kind != 5))
        device.sample(number, now, reading)
        sane(device, amplifiers)
    taken = len(frames) - sum(codec.dropped.values())
    answer = device.receive(Codec(key).encode(0, 0, now, Estop(78)), now, "stranger")
    frame = None if answer is None else Codec(key).decode(answer)
    assert frame is not None and isinstance(frame.body, EstopAck), "deaf to an emergency stop"
    assert frame.body.request == 78 and device.state == State.FAULT and device.faults & Fault.ESTOP, "not stopped"
    sane(device, amplifiers)
    return taken


def sane(device: Firmware, amplifiers: Amplifiers) -> None:
    """See that state, faults, session and currents go together."""
    assert (device.state == State.FAULT) == bool(device.faults), "a fault state without a fault"
    assert device.state != State.ACTIVE or device.session, "active without a session"
    assert device.state == State.ACTIVE or not amplifiers.on, "a current outside ACTIVE"


def fuzz_device(damage: Damage, enough: Callable[[int, int], bool]) -> bool:
    """Fuzz a device; return True if nothing raised, and print the outcome."""
    coverage, seen, begun = Coverage(), Counter[str](), time.monotonic()
    first = seeds(damage.codec)
    corpus = list(first)
    genuine = {data for frames in first for data in frames}
    executions = accepted = raised = given = damaged = 0
    while not enough(executions, damaged):
        frames = first[executions] if executions < len(first) else damage.input(corpus)
        traced = executions < TRACED or executions % 20 == 0
        try:
            with coverage if traced else nullcontext():
                accepted += execute(frames, damage.key, seen)
        except Exception:
            raised += 1
            complain(frames)
        executions, given = executions + 1, given + len(frames)
        damaged += sum(data not in genuine for data in frames)
        if traced and coverage.new and executions > len(first):
            corpus.append(frames)
    print(f"device, {named(damage.key)}: frames {given}  damaged {damaged}  executions {executions}  ", end="")
    print(f"edges {len(coverage.edges)}  corpus {len(corpus)}  accepted {accepted}  raised {raised}  ", end="")
    print(f"seconds {time.monotonic() - begun:.0f}")
    for state in State:
        kinds = (f"{number}: {seen[f'{state.name} {number}']}" for number in range(1, 9))
        print(f"  taken while {state.name}, by type: {', '.join(kinds)}")
    return not raised


class DamagedLine:
    """A line to a twin that damages three answers in four.

    The host's frames are checked.

    Attributes:
        damaged: How many frames reached the host that are none of the last twenty of the twin.
    """

    def __init__(self, twin: Twin, damage: Damage) -> None:
        self._link, self._damage, self._codec = VirtualLink(twin), damage, Codec(damage.key)
        self.damaged = 0
        self._recent: list[bytes] = [damage.codec.encode(SESSION, 0, 0, EstopAck(77, 2, 128, 0, SIX))]

    def send(self, data: bytes) -> None:
        """Send one frame."""
        frame = self._codec.decode(data)
        assert frame is not None, "the host sent what is no frame"
        if isinstance(frame.body, wire.Command):
            assert all(abs(one) <= LIMIT for one in (*frame.body.held, *frame.body.pulsed)), "beyond the limit"
        self._link.send(data)

    def receive(self, timeout: float) -> bytes | None:
        """Return a frame."""
        draw = self._damage.draw
        if draw.random() < DAMAGED:
            new = self._damage.frame(draw.choice(self._recent), draw.choice(self._recent), again=0.3)
            self.damaged += new not in self._recent
            return new
        data = self._link.receive(timeout)
        if data is not None:
            self._recent = [*self._recent[-20:], data]
        return data

    def now(self) -> int:
        """Return the instant [ns]."""
        return self._link.now()

    def rest(self, seconds: float) -> None:
        """Advance time without a host."""
        end = self.now() + round(seconds * 1e9)
        while self.now() < end:
            self._link.receive((end - self.now()) * 1e-9)

    def close(self) -> None:
        """Do nothing."""


def fly(twin: Twin, line: DamagedLine, damage: Damage, folder: Path) -> None:
    """Fly for some cycles; stop at the end.

    Raises:
        MaglevError: If the host gives up, as it should.
    """
    with RemotePlant(line, key=damage.key, patience=0.2, folder=folder) as plant:
        if plant.state == State.FAULT:
            plant.reset()
        plant.arm()
        for _ in range(SESSION_CYCLES):
            plant.read()
            plant.write(Command(WEIGHT))
        if damage.draw.random() < 0.5:
            with suppress(MaglevError):
                plant.estop()
            assert twin.firmware.state == State.FAULT, "not stopped"


def fuzz_host(damage: Damage, count: int) -> bool:
    """Fuzz a host; return True without unexpected errors, and print the outcome."""
    ends, raised, begun = Counter[str](), 0, time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        twin = Twin(TwinParameters(seed=1), key=damage.key)
        line = DamagedLine(twin, damage)
        while line.damaged < count:
            try:
                fly(twin, line, damage, Path(folder))
                ends["landed"] += 1
            except MaglevError as error:
                ends[type(error).__name__] += 1
            except Exception:
                raised += 1
                traceback.print_exc(limit=-4)
            for path in Path(folder).iterdir():
                path.unlink()
            line.rest(0.1)  # longer than the watchdog waits
            if twin.firmware.state == State.ACTIVE or twin.plant.currents.any():
                raised += 1
                print("  currents go on without a host", file=sys.stderr)
    print(f"host, {named(damage.key)}: damaged {line.damaged}  ends {dict(ends)}  raised {raised}  ", end="")
    print(f"seconds {time.monotonic() - begun:.0f}")
    return not raised


def named(key: bytes | None) -> str:
    """Return the sealing of frames."""
    return "without a key" if key is None else "with a key"


def complain(frames: Iterable[bytes]) -> None:
    """Print an error and the frames that led to it."""
    traceback.print_exc(limit=-3)
    print("  given:", *(data.hex() or "-" for data in frames), file=sys.stderr)


def main() -> int:
    """Fuzz, print the outcome, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--device", type=int, default=100_000, help="damaged frames for the device, each way of sealing"
    )
    parser.add_argument("--host", type=int, default=20_000, help="and for the host")
    parser.add_argument("--runs", type=int, help="how many inputs for the device instead, and none for the host")
    parser.add_argument("--seed", type=int, default=0, help="of the damage")
    options = parser.parse_args()
    good = True
    for key in (None, KEY):
        damage = Damage(options.seed, key)
        if options.runs is not None:
            good &= fuzz_device(damage, lambda executions, damaged: executions >= options.runs)
            continue
        good &= fuzz_device(damage, lambda executions, damaged: damaged >= options.device)
        good &= fuzz_host(Damage(options.seed, key), options.host)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
