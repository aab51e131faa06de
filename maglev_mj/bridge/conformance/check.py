"""Registry, results and common steps of the conformance checks."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, NamedTuple

from maglev_mj.bridge import wire
from maglev_mj.bridge.conformance.tester import Tester, Unexpected, fail, is_off, same, shown
from maglev_mj.bridge.connection import draw
from maglev_mj.bridge.wire import WRAP, Fault, Operation, State
from maglev_mj.errors import PlantError
from maglev_mj.frames import ZERO

QUIET = 0.06
"""Silence that counts as no answer [s]."""

HALF = 0x7FFFFFFF
NAN = (math.nan,) * 6
_TRIES = 10  # repetitions of a check if this host was late


class CheckResult(NamedTuple):
    """Result of one check.

    Attributes:
        name: Name of the check.
        expected: Behaviour required by the protocol.
        seen: Observed behaviour, or the reason for skipping the check.
        passed: True if it passed; None if it was skipped.
    """

    name: str
    expected: str
    seen: str
    passed: bool | None


class Check(NamedTuple):
    """Check and its requirements.

    Attributes:
        expected: Behaviour required by the protocol.
        run: Function that returns the observed behaviour, or raises `Unexpected`.
        flight: True if the check flies.
        real_time: True if it needs real time.
        peers: Number of host addresses it needs.
        keyed: True if it needs a key.
        lockstep: True if it needs lockstep.
    """

    expected: str
    run: Callable[[Tester], str]
    flight: bool = False
    real_time: bool = False
    peers: int = 1
    keyed: bool = False
    lockstep: bool = False

    def result(self, name: str, tester: Tester, flight: bool) -> CheckResult:
        """Run the check; repeat it if this host was late."""
        reasons = {
            "flights disabled": self.flight and not flight,
            "needs real time (the device is in lockstep)": self.real_time and tester.welcome.lockstep,
            "needs a second host address (a serial link has one)": self.peers > len(tester.links),
            "needs a key": self.keyed and not tester.keyed,
            "needs a device in lockstep": self.lockstep and not tester.welcome.lockstep,
        }
        if reason := next((reason for reason, holds in reasons.items() if holds), ""):
            return CheckResult(name, self.expected, reason, None)
        for _ in range(_TRIES):
            tester.late = False
            try:
                tester.bring(State.INACTIVE)
                with tester.flying() if self.flight else nullcontext():
                    return CheckResult(name, self.expected, self.run(tester), True)
            except (Unexpected, PlantError) as error:
                note = "; this host read STATEs late" if tester.late else ""
                result = CheckResult(name, self.expected, f"{error}{note}", False)
            tester.leave()
            if not tester.late:
                break
        return result


CHECKS: dict[str, Check] = {}
"""Checks in the order of execution."""


def check(expected: str, name: str = "", **needs: Any) -> Callable[[Callable[[Tester], str]], object]:
    """Register a check, by default under its function's name; `needs` are other fields of `Check`."""

    def add(run: Any) -> object:
        CHECKS[name or run.__name__.strip("_").replace("_", "-")] = Check(expected, run, **needs)
        return run

    return add


@contextmanager
def case(name: str) -> Iterator[None]:
    """Prefix the message of a failure with the case."""
    try:
        yield
    except (Unexpected, PlantError) as error:
        raise Unexpected(f"{name}: {error}") from None


def stopped(t: Tester, peer: int = 0, faults: int = Fault.ESTOP) -> str:
    """Request emergency stops until no current is measured; return the time taken as text."""
    body, start, first = wire.Estop(draw()), t.now(), None
    while True:
        frame = t.exchange(body, peer=peer) or fail("no answer to ESTOP")
        ack, first = frame.body, first or frame
        same("state, faults in ESTOP_ACK", (ack.state, ack.faults), (State.FAULT, faults))
        if not 0 <= frame.time - ack.sampled <= 2 * t.welcome.period:
            fail(f"sampled at {ack.sampled} ns, reported at {frame.time} ns")
        if t.welcome.lockstep or (ack.sampled > first.time and is_off(ack.currents)):
            return f"{(t.now() - start) / 1e6:.1f} ms until no current was measured"
        if t.now() - start > 1_000_000_000:
            fail(f"{shown(ack.currents)} A measured 1 s after ESTOP")
        t.wait(0.005)


def ignored(
    t: Tester,
    flaw: str,
    change: Callable[[bytes], bytes] = bytes,
    *,
    back: int | None = None,
    answers: int = 0,
    wait: int = 0,
    session: int | None = None,
    peer: int = 0,
) -> str:
    """Check that an active device ignores flawed frames.

    Sends a CMD with NaN, and TRIP and ESTOP if the flaw applies to them.

    Args:
        t: Testing host.
        flaw: Description of the flaw.
        change: Function that adds the flaw to a frame.
        back: Offset of the sequence number below the last; None for the next number.
        answers: Age of the answered sample, in samples.
        wait: Time between that sample and the answer [ns].
        session: Session number; None for the current one.
        peer: Index of the sending address.
    """
    t.bring(State.ACTIVE)
    bodies: list[Any] = [wire.Command(0, 0, NAN, NAN, 0.0)]
    if back is None and not answers:
        bodies.append(wire.Control((t.request + 1) & WRAP, Operation.TRIP, 0, ZERO))
    if change is not bytes:
        bodies.append(wire.Estop(draw()))
    for body in bodies:
        # before the valid answer: in lockstep any later frame is old
        t.answering = False
        t.states(1)
        t.others.clear()
        t.sequence = (t.sequence + (back is None)) & WRAP
        last = t.last.sequence
        t.wait(wait * 1e-9)
        if isinstance(body, wire.Command):
            body = body._replace(answers=(last - answers) & WRAP)
        frame = t.encode(body, session=session, sequence=(t.sequence - (back or 0)) & WRAP)
        t.links[peer].send(change(frame))
        t.answering = True
        t.command(t.last.sequence, ZERO)
        with case(f"{type(body).__name__} {flaw} is accepted"):
            t.expect(State.ACTIVE)
            same("answers", t.others, [])
    return "ignored"


def with_crc(data: bytes) -> bytes:
    """Return data with its CRC recomputed."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def flipped(data: bytes, index: int) -> bytes:
    """Return data with a bit of one byte flipped."""
    return data[:index] + bytes([data[index] ^ 1]) + data[index:][1:]


def close(frame: Any, expected: Sequence[float]) -> None:
    """Check that the measured currents are close to the expected ones [A]."""
    if any(abs(actual - current) > 0.1 + 0.1 * abs(current) for actual, current in zip(frame.body.currents, expected)):
        fail(f"{shown(frame.body.currents)} A measured instead of {shown(expected)} A")


def zero(t: Tester) -> str:
    """Check that the currents are zero from the second sample on."""
    for frame in t.states(4)[1:]:
        if not is_off(frame.body.currents):
            fail(f"{shown(frame.body.currents)} A after the cut instead of 0 A")
    return "currents zero"
