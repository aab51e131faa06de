"""Conformance of a device: the rules of docs/protocol.md that its wire shows, first without flying, then flying.

Without flying, no check sends more than half the currents that carry the flotor.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from maglev_mj.bridge import wire
from maglev_mj.bridge.calibration import Calibration
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.tester import WRAP, Tester, Unexpected, draw, fail, is_off, same, shown
from maglev_mj.bridge.wire import VERSION, Fault, Flag, HelloStatus, Operation, Result, State, fault_names
from maglev_mj.errors import PlantError
from maglev_mj.frames import ZERO
from maglev_mj.net.udp import Link

__all__ = ["CheckResult", "checks", "conform"]

_TRIES = 3  # of a check in which this host was late
_QUIET = 0.06  # without an answer, after which there is none [s]
_JUNK = 500
_HALF, _NEVER = 0x7FFFFFFF, 0xFFFFFFFF
_NAN = (math.nan,) * 6


class CheckResult(NamedTuple):
    """Outcome of one check.

    Attributes:
        name: Of the check.
        expected: Behaviour that the protocol asks for.
        seen: Behaviour of the device, or the reason for skipping the check.
        passed: None where it was skipped.
    """

    name: str
    expected: str
    seen: str
    passed: bool | None


class _Check(NamedTuple):
    expected: str
    run: Callable[[Tester], object]
    flight: bool = False
    real_time: bool = False
    peers: int = 1
    keyed: bool = False

    def result(self, name: str, tester: Tester, flight: bool) -> CheckResult:
        """Run the check, again where this host was late."""
        reasons = {
            "flights were not asked for": self.flight and not flight,
            "needs real time, and this device is in lockstep": self.real_time and tester.welcome.lockstep,
            "needs a second address; a serial line has one peer": self.peers > len(tester.links),
            "needs a key": self.keyed and not tester.keyed,
        }
        if reason := next((reason for reason, holds in reasons.items() if holds), ""):
            return CheckResult(name, self.expected, reason, None)
        for _ in range(_TRIES):
            tester.late = False
            try:
                tester.bring(State.INACTIVE)
                return CheckResult(name, self.expected, str(self.run(tester) or "as expected"), True)
            except HandshakeError:
                raise
            except (Unexpected, PlantError) as error:
                result = CheckResult(name, self.expected, str(error), False)
            if not tester.late:
                break
        return result


_CHECKS: dict[str, _Check] = {}


def _check(expected: str, name: str = "", **needs: Any) -> Callable[[Callable[[Tester], object]], object]:
    def add(run: Any) -> object:
        _CHECKS[name or run.__name__.strip("_").replace("_", "-")] = _Check(expected, run, **needs)
        return run

    return add


def checks() -> dict[str, str]:
    """Return the behaviour that each check expects, by name."""
    return {name: one.expected for name, one in _CHECKS.items()}


def conform(
    links: Sequence[Link],
    calibration: Calibration | None = None,
    key: bytes | None = None,
    *,
    flight: bool = True,
    only: Iterable[str] | None = None,
    tell: Callable[[CheckResult], object] = lambda result: None,
) -> list[CheckResult]:
    """Test a device, and leave it INACTIVE without a session.

    Args:
        links: To the device, from one or two addresses; left open.
        calibration: Of the device; nominal by default.
        key: With which frames are sealed.
        flight: Whether to fly it as well; the flotor is then dropped onto its stops several times.
        only: Names of checks to run; all by default.
        tell: Called with each result.

    Raises:
        HandshakeError: If no device answers, or it will not have this host.
        PlantError: If it has a fault latched.
        LinkError: If a line is gone.
    """
    tester = Tester(links, calibration or Calibration.nominal(), key)
    tester.join()
    if tester.welcome.state == State.FAULT:
        tester.ask(Operation.BYE)
        raise PlantError(f"the device has latched {fault_names(tester.welcome.faults)}: see to it, then reset")
    results: list[CheckResult] = []
    try:
        for name in _CHECKS if only is None else only:
            results.append(_CHECKS[name].result(name, tester, flight))
            tell(results[-1])
    finally:
        tester.release()
    return results


# sessions


@_check("HELLO_ACK has this version and calibration, and plausible numbers")
def _welcome(t: Tester) -> object:
    one, period = t.welcome, t.welcome.period
    good = {
        "version": one.version == VERSION,
        "calibration": one.calibration == t.calibration.digest,
        "lockstep": one.lockstep <= 1,
        "period": 10_000 <= period <= 100_000_000,
        "delay": one.delay <= 100_000_000,
        "watchdog": 4 * period <= one.watchdog <= 1_000_000_000,
        "enable": 2 * period <= one.enable <= one.watchdog,
        "currents": 0.0 < one.hover_limit <= one.continuous_current <= one.current_limit <= 100.0,
        "hover_limit": max(abs(t.calibration.hover)) <= one.hover_limit,
        "thermal_time": 0.0 < one.thermal_time < math.inf,
        "spots": 0.0 < one.spot_limit < 1.0 and 0.0 < one.spot_speed < 100.0,
    }
    same(f"plausible numbers in {one}:", [name for name, is_good in good.items() if is_good], [*good])
    return f"device {one.device}, {1e9 / period:g} Hz, delay {one.delay / 1e6:g} ms, up to {one.current_limit:g} A"


@_check("the same nonce gets the same session and changes nothing")
def _hello_again(t: Tester) -> object:
    t.bring(State.ACTIVE)
    used, again = t.sequence, t.greet(t.nonce)
    same("status, session, state", (again.body.status, again.session, again.body.state), (0, t.session, State.ACTIVE))
    return _ignored(t, "of an old sequence number", sequence=used)


@_check("any other HELLO gets BUSY, and the session goes on")
def _busy(t: Tester) -> object:
    t.bring(State.ACTIVE)
    for peer, nonce in [(0, draw()), *([(1, draw()), (1, t.nonce)] if len(t.links) > 1 else [])]:
        same("status", t.greet(nonce, peer=peer).body.status, HelloStatus.BUSY)
    return t.expect(State.ACTIVE) and "BUSY"


@_check("HELLO with another calibration gets CALIBRATION, and no session")
def _calibration(t: Tester) -> object:
    t.ask(Operation.BYE)
    for place in (0, 7, 15):
        one = t.greet(draw(), _flipped(t.calibration.digest, place)).body
        same("status", one.status, HelloStatus.CALIBRATION)
        same("calibration", [*one.calibration], [*t.calibration.digest])
    return t.join()


@_check("HELLO of another version gets VERSION, whatever its length, unless its CRC is wrong")
def _version(t: Tester) -> object:
    hello = t.encode(wire.Hello(draw(), t.calibration.digest))
    for version in (VERSION - 1, VERSION + 1, 255):
        for data in (hello, hello[:8] + bytes(4), hello + bytes(40)):
            t.links[0].send(_sealed(data[:2] + bytes([version]) + data[3:]))
            answer = t.wait(_QUIET, wire.HelloAck) or fail(f"no answer to version {version} in {len(data)} bytes")
            same("nonce, status, version", (answer.body[:2], answer.body.version), ((0, HelloStatus.VERSION), VERSION))
    t.links[0].send(hello[:2] + bytes([255]) + hello[3:])
    return t.wait(_QUIET, wire.HelloAck) and fail("an answer in spite of the CRC")


@_check("session numbers are drawn: none twice, not counted up")
def _drawn(t: Tester) -> object:
    drawn = []
    for _ in range(6):
        t.ask(Operation.BYE)
        t.join()
        drawn.append(t.session)
    steps = {one - other for one, other in zip(drawn, drawn[1:])}
    return shown(drawn) if len(steps) == 5 and max(map(abs, steps)) >= 1 << 16 else fail(shown(drawn))


@_check("another host gets the session after 1 s without a frame, not before", real_time=True)
def _takeover(t: Tester) -> object:
    t.answering, begun, old = False, t.now(), t.session
    t.wait(0.7)
    same("status after 0.7 s", t.greet(draw()).body.status, HelloStatus.BUSY)
    t.wait(1.1 - (t.now() - begun) * 1e-9)
    same("status after 1.1 s", t.greet(draw()).body.status, HelloStatus.WELCOME)
    trip = wire.Control(t.request + 1, Operation.TRIP, 0, ZERO)
    if t.exchange(trip, _QUIET, session=old) is not None:
        fail("the old session is still obeyed")
    return t.join()


@_check("BYE ends the session: no STATE, no answer; a latched fault stays")
def _bye(t: Tester) -> object:
    t.bring(State.FAULT)
    old = t.last.sequence
    t.ask(Operation.BYE)
    body = wire.Control(t.request, Operation.BYE, 0, ZERO)
    if t.exchange(body, max(_QUIET, 4e-9 * t.welcome.period)) is not None or (t.last.sequence - old) & WRAP > 1:
        fail("the session still answers")
    t.join()
    return same("state, faults", (t.welcome.state, t.welcome.faults), (State.FAULT, Fault.HOST))


# requests


@_check("a request is done once: repeated it is acknowledged again, an older one is dropped")
def _requests(t: Tester) -> object:
    t.bring(State.FAULT)
    t.ask(Operation.RESET)
    _stopped(t)
    again = t.exchange(wire.Control(t.request, Operation.TRIP, Fault.CLOCK, ZERO)) or fail("no answer to a repetition")
    same("answer to a repetition", again.body[1:], (Operation.RESET, Result.DONE, State.FAULT, Fault.ESTOP))
    for behind in (1, 1000, _HALF):
        body = wire.Control((t.request - behind) & WRAP, Operation.RESET, 0, ZERO)
        if t.exchange(body, _QUIET) is not None:
            fail(f"an answer to a request {behind} older")
    return t.expect(State.FAULT, Fault.ESTOP) and "acknowledged again, older ones dropped"


@_check("request numbers begin anywhere and go round 2^32, whatever the header's sequence number")
def _request_numbers(t: Tester) -> object:
    t.ask(Operation.BYE)
    t.join()
    t.request = WRAP - 3
    for sequence in (0, 5, 0, WRAP, 0, _HALF, 1):
        t.ask(Operation.DISARM, sequence=sequence)
    for _ in range(3):
        t.request = (t.request + _HALF - 1) & WRAP
        t.ask(Operation.DISARM)


@_check("operations lead where the table says, unknown ones are REFUSED")
def _operations(t: Tester) -> object:
    done, refused = Result.DONE, Result.REFUSED
    for state in State:
        off = State.FAULT if state == State.FAULT else State.INACTIVE
        table = {
            Operation.ARM: (done, State.ACTIVE) if state == State.INACTIVE else (refused, state),
            Operation.RESET: (refused, state) if state == State.ACTIVE else (done, State.INACTIVE),
            Operation.TRIP: (done, State.FAULT),
            Operation.DISARM: (done, off),
            **dict.fromkeys((0, 3, 7, 255), (refused, state)),
            Operation.BYE: (done, off),
        }
        for operation, wanted in table.items():
            t.bring(state)
            answer = t.ask(operation)
            same(f"operation {operation} in {state.name}: result, state", (answer.result, answer.state), wanted)
        t.join()
    return f"{3 * len(table)} of {3 * len(table)}"


@_check("ARM is refused with a hover current that is not finite or above hover_limit")
def _arm(t: Tester) -> object:
    above = 1.01 * t.welcome.hover_limit
    for coil in range(6):
        for current in (above, -above, math.nan, math.inf, -math.inf):
            answer = t.ask(Operation.ARM, hover=[*t.half[:coil], current, *t.half[coil + 1 :]])
            same(f"{current:g} A: result, state", (answer.result, answer.state), (Result.REFUSED, State.INACTIVE))
    return t.expect(State.INACTIVE) and f"30 of 30, at {above:.3g} A"


@_check("TRIP latches the bits of the table, HOST where there is none of them, and adds later ones")
def _trip(t: Tester) -> object:
    unknown = 1 << 31
    for faults in (*Fault, 0, unknown, unknown | Fault.BOUNDARY):
        t.bring(State.INACTIVE if faults else State.ACTIVE)
        wanted = faults & ~unknown or Fault.HOST
        same("faults", t.ask(Operation.TRIP, faults=faults).faults, wanted)
        same("faults with CLOCK", t.ask(Operation.TRIP, faults=Fault.CLOCK).faults, wanted | Fault.CLOCK)
    return t.expect(State.FAULT, Fault.BOUNDARY | Fault.CLOCK) and f"{len(Fault)} bits, 0, an unknown one"


@_check("HELLO_ACK says what is latched, what came first and when; RESET clears it")
def _first_fault(t: Tester) -> object:
    t.ask(Operation.TRIP, faults=Fault.BOUNDARY)
    at = t.asked_at
    t.states(2)
    t.ask(Operation.TRIP, faults=Fault.CLOCK)
    one = t.greet(t.nonce).body
    same("faults, first", (one.faults, one.first), (Fault.BOUNDARY | Fault.CLOCK, Fault.BOUNDARY))
    if abs(one.fault_time - at) > t.welcome.period:
        fail(f"fault_time {one.fault_time} ns, where TRIP was done at {at} ns")
    t.ask(Operation.RESET)
    one = t.greet(t.nonce).body
    return same("state, faults, first, time", (one.state, one.faults, one.first, one.fault_time), (0, 0, 0, 0))


# samples


@_check("STATEs come by `period`, by time stamps and by arrival; diodes are valid, nothing flows, no flag is set")
def _period(t: Tester) -> object:
    period, count = t.welcome.period, max(100, 500_000_000 // t.welcome.period)
    begun, found = t.states(1)[0] and t.arrived, t.states(count)
    took = (t.arrived - begun) / count
    if not t.welcome.lockstep and abs(took / period - 1.0) > 0.05:
        fail(f"{took / 1e6:.3f} ms by arrival instead of {period / 1e6:g} ms")
    for one in (frame.body for frame in found):
        on = max(map(abs, one.spots)) <= t.welcome.spot_limit
        same(
            "valid, flags, spots on their diodes, currents off",
            (one.valid, one.flags, on, is_off(one.currents)),
            (7, 0, 1, 1),
        )
    return f"{period / 1e6:g} ms stamped, {took / 1e6:.3f} ms by arrival"


@_check("`answered` and `age` are of the command in force; there is none after ARM")
def _answered(t: Tester) -> object:
    t.answering = False
    t.states(0 if t.welcome.lockstep else 1)
    t.ask(Operation.ARM)
    for frame in t.states(0 if t.welcome.lockstep else 1):
        same("answered, age before any command", (frame.body.answered, frame.body.age), (_NEVER, _NEVER))
    t.bring(State.ACTIVE)
    for frame in t.states(5):
        same("answered", frame.body.answered, (frame.sequence - 1) & WRAP)
        if frame.body.age * 1000 > t.welcome.period:
            fail(f"age {frame.body.age} us")
    return "the sample before, less than a period old"


@_check("ENABLED is said while ACTIVE, and for at most `enable` + 1 period after it")
def _enabled(t: Tester) -> object:
    one = t.welcome
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE)
        same("ENABLED", {frame.body.flags & Flag.ENABLED for frame in t.states(20)}, {Flag.ENABLED})
        t.ask(leave)
        later = t.states(one.enable // one.period + 5)
        took = max((frame.time - t.asked_at for frame in later if frame.body.flags & Flag.ENABLED), default=0)
        if took > one.enable + one.period:
            fail(f"ENABLED {took / 1e6:.3g} ms after {leave.name}")
    return f"for {took / 1e6:.3g} ms after it; `enable` is {one.enable / 1e6:g} ms"


@_check("measured currents are those commanded, and zero after DISARM and TRIP")
def _currents(t: Tester) -> object:
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE, lambda frame: t.half)
        _close(t.states(1)[0], t.half)
        t.ask(leave)
        _zero(t)
    return f"{shown(t.half)} A, then zero"


@_check("a command under way when the currents are cut never flows", real_time=True)
def _forgotten(t: Tester) -> object:
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE)
        t.answering = False
        t.command(t.states(1)[0].sequence, t.half)
        t.ask(leave)
        _zero(t)


@_check("a pulse replaces the command for its width", real_time=True)
def _pulse(t: Tester) -> object:
    one = t.welcome
    if 2 * one.delay > one.period:
        return "not looked at: the delay is more than half a period"
    t.bring(State.ACTIVE)
    t.answering = False
    t.command(t.states(1)[0].sequence, ZERO, t.half, one.period * 1e-9)
    during, after = t.states(2)
    _close(during, t.half)
    return _close(after, ZERO)


@_check("temperatures rise as the measured currents say")
def _temperatures(t: Tester) -> object:
    t.bring(State.ACTIVE, lambda frame: t.half)
    one, (first, *rest) = t.welcome, t.states(60)
    share, rises = -math.expm1(-one.period * 1e-9 / one.thermal_time), list(first.body.temperatures)
    for frame in rest:
        squares = [(current / one.continuous_current) ** 2 for current in frame.body.currents]
        rises = [rise + share * (square - rise) for rise, square in zip(rises, squares)]
    for cold, rise, said in zip(first.body.temperatures, rises, rest[-1].body.temperatures):
        if abs(said - rise) > 0.2 * abs(rise - cold) + 1e-6:
            fail(f"{said:.3g} instead of {rise:.3g}, from {cold:.3g}")
    return f"from {first.body.temperatures[0]:.3g} to {said:.3g}"


# commands


@_check("CMDs do nothing while INACTIVE or FAULT, whatever is in them")
def _not_active(t: Tester) -> object:
    for state, faults in ((State.INACTIVE, 0), (State.FAULT, Fault.HOST)):
        t.bring(state)
        for held in (t.half, _NAN, (100.0,) * 6):
            t.command(t.last.sequence, held)
            t.expect(state, faults)
            _zero(t)


def _bad_commands(name: str, fault: Fault, expected: str, values: Callable[[Tester], Iterable[float]]) -> None:
    """Add a check of commands with a value in each of the currents in turn, or as width."""

    def run(t: Tester) -> str:
        places = [12] if name == "width" else range(12)
        for place, value in ((place, value) for place in places for value in values(t)):
            t.bring(State.ACTIVE, lambda frame: t.half)
            numbers = [*t.half, *t.half, 0.0]
            numbers[place] = value
            t.command(t.last.sequence, numbers[:6], numbers[6:12], numbers[12])
            try:
                t.expect(State.FAULT, fault, 1)
                _zero(t)
                same("result of ARM", t.ask(Operation.ARM).result, Result.REFUSED)
                t.expect(State.FAULT, fault, 2)
            except Unexpected as error:
                fail(f"{value:g} in place {place} of held, pulsed, width: {error}")
        return f"{fault.name}, {len(places)} places"

    _check(f"a CMD {expected} ends in {fault.name}: currents zero, until RESET", name)(run)


_UNREAL = (math.nan, math.inf, -math.inf)
_bad_commands("not-finite", Fault.INVALID_COMMAND, "that is not finite", lambda t: _UNREAL)
_bad_commands("width", Fault.INVALID_COMMAND, "of a width outside 0 to 1 s", lambda t: (*_UNREAL, -1e-6, 1.001))
_bad_commands(
    "over-current",
    Fault.COIL_OVERCURRENT,
    "beyond current_limit, held or pulsed,",
    lambda t: (1.001 * t.welcome.current_limit, -1.001 * t.welcome.current_limit),
)


@_check("sequence numbers go round 2^32")
def _sequence_numbers(t: Tester) -> object:
    t.bring(State.ACTIVE)
    for t.sequence in (_HALF - 1, 2 * _HALF - 2, WRAP - 3):
        t.expect(State.ACTIVE)
    if (behind := (t.states(8)[-1].sequence - t.last.body.answered) & WRAP) > 2:
        fail(f"the last command obeyed is {behind} samples old, at number {t.sequence}")
    return _ignored(t, "from before the wrap", sequence=WRAP - 2)


@_check("a CMD far ahead deafens to CMDs alone: CTRL and ESTOP are heard, and it ends in WATCHDOG")
def _far_ahead(t: Tester) -> object:
    for end in ("ESTOP", "DISARM") if t.welcome.lockstep else ("ESTOP", "DISARM", "WATCHDOG"):
        t.bring(State.ACTIVE)
        far, t.answering = (t.sequence + _HALF) & WRAP, not t.welcome.lockstep
        t.links[0].send(t.encode(wire.Command(t.last.sequence, 0, ZERO, ZERO, 0.0), sequence=far))
        if end == "ESTOP":
            _stopped(t)
        elif end == "DISARM":
            same("state after DISARM", t.ask(Operation.DISARM).state, State.INACTIVE)
        else:
            t.states(t.welcome.watchdog // t.welcome.period + 2)
            t.expect(State.FAULT, Fault.WATCHDOG)
        t.sequence = far


@_check("a CMD that is late by less than `watchdog` is obeyed", real_time=True)
def _late_command(t: Tester) -> object:
    t.bring(State.ACTIVE)
    behind = t.welcome.watchdog // t.welcome.period - 2
    t.states(behind)
    t.answering = False
    t.command(late := t.last.sequence - behind, ZERO)
    return same("answered", t.states(1)[0].body.answered, late & WRAP) or f"{behind} samples late"


# frames that are ignored


def _ignored(t: Tester, said: str, change: Callable[[bytes], bytes] = bytes, peer: int = 0, **header: int) -> str:
    """See that an active device ignores a CMD that is not finite; TRIP and ESTOP as well, where they have the flaw."""
    t.bring(State.ACTIVE)
    answers = header.pop("answers", 0)
    bodies: list[Any] = [wire.Command((t.last.sequence - answers) & WRAP, 0, _NAN, _NAN, 0.0)]
    if not answers and "sequence" not in header:
        bodies.append(wire.Control((t.request + 1) & WRAP, Operation.TRIP, 0, ZERO))
        bodies += [] if peer or "session" in header else [wire.Estop(draw())]
    for body in bodies:
        t.sequence = (t.sequence + 1) & WRAP
        t.links[peer].send(change(t.encode(body, **{"sequence": t.sequence, **header})))
        try:
            t.expect(State.ACTIVE)
        except Unexpected as error:
            fail(f"{type(body).__name__} {said} is taken: {error}")
    return "ignored"


def _sealed(data: bytes) -> bytes:
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def _flipped(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 1]) + data[place:][1:]


_CHANGES: dict[str, tuple[str, Callable[[bytes], bytes], bool]] = {
    "magic": ("of another magic", lambda data: _sealed(b"NJ" + data[2:]), False),
    "crc": ("whose CRC is wrong", lambda data: _flipped(data, len(data) - 1), False),
    "frame-version": ("of another version", lambda data: _sealed(data[:2] + b"\x01" + data[3:]), False),
    "type": ("of an unknown type", lambda data: _sealed(data[:3] + b"\x09" + data[4:]), False),
    "too-short": ("shorter than its type", lambda data: _sealed(data[:-5] + data[-4:]), False),
    "too-long": ("longer than its type", lambda data: _sealed(data[:-4] + bytes(1) + data[-4:]), False),
    "no-tag": ("without a tag", lambda data: _sealed(data[:-20] + data[-4:]), True),
    "tag": ("with a wrong tag", lambda data: _sealed(_flipped(data, len(data) - 5)), True),
}
_HEADERS: dict[str, tuple[str, Callable[[Tester], Iterable[dict[str, int]]], int]] = {
    "session": ("of another session", lambda t: [{"session": one} for one in ((t.session + 1) & WRAP, 0)], 1),
    "address": ("from another address", lambda t: [{"peer": 1}], 2),
    "sequence": (
        "of a doubled or old sequence number",
        lambda t: ({"sequence": (t.sequence - back) & WRAP} for back in (0, 1, 1000, _HALF)),
        1,
    ),
    "future": ("that answers a sample yet to come", lambda t: [{"answers": one} for one in (-1000, -_HALF)], 1),
    "stale": (
        "that answers a sample older than `watchdog`",
        lambda t: [{"answers": 1 + (0 if t.welcome.lockstep else t.welcome.watchdog // t.welcome.period)}],
        1,
    ),
}
for _name, (_said, _change, _keyed) in _CHANGES.items():
    _check(f"a frame {_said} is ignored", _name, keyed=_keyed)(
        lambda t, said=_said, change=_change: _ignored(t, said, change)
    )
for _name, (_said, _headers, _peers) in _HEADERS.items():
    _check(f"a CMD {_said} is ignored", _name, peers=_peers)(
        lambda t, said=_said, headers=_headers: [_ignored(t, said, **one) for one in headers(t)][0]
    )


@_check("frames that only a device sends are ignored")
def _direction(t: Tester) -> object:
    t.bring(State.ACTIVE)
    ack = wire.ControlAck(t.request + 1, Operation.TRIP, 0, State.FAULT, 1)
    for body in (t.last.body, ack, t.welcome, wire.EstopAck(draw(), State.FAULT, Fault.ESTOP, 0, ZERO)):
        t.links[0].send(t.encode(body, sequence=t.sequence + 1))
        t.expect(State.ACTIVE)


# the emergency stop


def _stopped(t: Tester, peer: int = 0, faults: int = Fault.ESTOP) -> str:
    """Ask for an emergency stop until no current is measured after it; return how long that took."""
    body, begun, first = wire.Estop(draw()), t.now(), None
    while True:
        frame = t.exchange(body, peer=peer) or fail("no answer to ESTOP")
        one, first = frame.body, first or frame
        same("state, faults in ESTOP_ACK", (one.state, one.faults), (State.FAULT, faults))
        if not 0 <= frame.time - one.sampled <= 2 * t.welcome.period:
            fail(f"sampled at {one.sampled} ns, said at {frame.time} ns")
        if t.welcome.lockstep or (one.sampled > first.time and is_off(one.currents)):
            return f"{(t.now() - begun) / 1e6:.1f} ms until no current was measured"
        if t.now() - begun > 1_000_000_000:
            fail(f"{shown(one.currents)} A measured 1 s after ESTOP")
        t.wait(0.005)


@_check("ESTOP is obeyed in every state, again and again, and answered with currents measured after it: zero")
def _estop(t: Tester) -> object:
    for state, faults in zip(State, (Fault.ESTOP, Fault.ESTOP, Fault.ESTOP | Fault.HOST)):
        t.bring(state, lambda frame: t.half)
        said = _stopped(t, faults=faults)
        t.expect(State.FAULT, faults)
        _stopped(t, faults=faults)
    return said


@_check("ESTOP needs no session")
def _estop_without_session(t: Tester) -> object:
    t.ask(Operation.BYE)
    if t.exchange(wire.Estop(draw())) is None:
        fail("no answer to ESTOP")
    t.join()
    return same("state, faults", (t.welcome.state, t.welcome.faults), (State.FAULT, Fault.ESTOP))


@_check(f"ESTOP is obeyed from another address, within 0.25 s behind {_JUNK} frames that are none", peers=2)
def _estop_elsewhere(t: Tester) -> object:
    t.bring(State.ACTIVE, lambda frame: t.half)
    _stopped(t, peer=1)
    t.expect(State.FAULT, Fault.ESTOP)
    t.bring(State.ACTIVE, lambda frame: t.half)
    for count in range(_JUNK):
        t.links[1].send(_CHANGES["crc"][1](t.encode(wire.Estop(count))))
    begun = t.now()
    if t.exchange(wire.Estop(draw()), 0.25, peer=1) is None:
        fail(f"no answer behind {_JUNK} frames")
    return t.expect(State.FAULT, Fault.ESTOP) and f"{(t.now() - begun) / 1e6:.1f} ms behind {_JUNK} frames"


# silence


def _silence(t: Tester, hover: Sequence[float], arrived: int = 0) -> str:
    """Say nothing; see HOLDING and WATCHDOG by the device's own clock and measured currents."""
    one, t.answering = t.welcome, False
    seen = t.states(one.watchdog // one.period + 8)
    ages = [frame.time - 1000 * frame.body.age for frame in seen if frame.body.age != _NEVER]
    arrived = ages[-1] if ages else arrived
    held = [frame for frame in seen if frame.body.flags & Flag.HOLDING] or fail("HOLDING is never said")
    cut = [frame for frame in seen if frame.body.state == State.FAULT] or fail("no WATCHDOG")
    holds, falls = held[0].time - arrived, cut[0].time - arrived
    said = f"HOLDING after {holds / 1e6:.3g} ms, WATCHDOG after {falls / 1e6:.4g} ms"
    rounding = 1000  # of an age [ns]
    on_time = 2 * one.period - rounding <= holds <= 3 * one.period + rounding
    if not (on_time and one.watchdog - rounding <= falls <= one.watchdog + one.period + rounding):
        fail(f"{said}; the period is {one.period / 1e6:g} ms, `watchdog` {one.watchdog / 1e6:g} ms")
    same(f"{said}; faults", cut[0].body.faults, Fault.WATCHDOG)
    for frame in seen:
        if held[0].time + one.delay < frame.time <= cut[0].time:
            _close(frame, hover)
        elif frame.time > cut[0].time and not is_off(frame.body.currents):
            fail(f"{said}, and {shown(frame.body.currents)} A after it")
    return said


@_check("silence after ARM: its hover currents after two periods, WATCHDOG and zero after `watchdog`", real_time=True)
def _silence_after_arm(t: Tester) -> object:
    t.answering = False
    t.ask(Operation.ARM)
    return _silence(t, t.half, t.asked_at)


@_check("silence after commands: the same, counted from the last one", real_time=True)
def _silence_after_commands(t: Tester) -> object:
    t.bring(State.ACTIVE)
    return _silence(t, t.half)


# flights


def _bad_line(t: Tester) -> str:
    t.loss = 0.05
    t.states(2_000_000_000 // t.welcome.period)
    return t.hovers()


def _let_go(t: Tester, operation: Operation) -> object:
    answer: Any = t.ask(operation)
    if operation == Operation.BYE:
        t.join()
        answer = t.welcome
    same("state", answer.state, State.INACTIVE)
    return _zero(t)


def _over_current(t: Tester) -> object:
    t.command(t.last.sequence, [1.001 * t.welcome.current_limit] * 6)
    return t.expect(State.FAULT, Fault.COIL_OVERCURRENT, 1) and _zero(t)


_FLIGHTS: dict[str, tuple[str, Callable[[Tester], object], bool]] = {
    "hover": ("it hovers at the centre, and lands", Tester.hovers, False),
    "bad-line": ("it hovers with 5 % of the CMDs lost, as many damaged, as many doubled", _bad_line, True),
    "flight-silence": ("its hover currents, then WATCHDOG", lambda t: _silence(t, t.calibration.hover.tolist()), True),
    "flight-over-current": ("a CMD beyond current_limit cuts", _over_current, False),
    "flight-estop": ("ESTOP cuts", _stopped, False),
    "flight-disarm": ("DISARM cuts", lambda t: _let_go(t, Operation.DISARM), False),
    "flight-bye": ("BYE cuts", lambda t: _let_go(t, Operation.BYE), False),
}


def _flown(t: Tester, end: Callable[[Tester], object]) -> object:
    with t.flying():
        return end(t)


for _name, (_said, _end, _real_time) in _FLIGHTS.items():
    _check(f"in flight: {_said}", _name, flight=True, real_time=_real_time)(lambda t, end=_end: _flown(t, end))


# rules of all frames, at last

_RULES = {
    "frames": "every frame has its length, seal, zeros, session and sequence number, and a time that does not go back",
    "samples": "every STATE is finite, whole periods after the one before, with conversions; FAULT has faults",
    "cut": "no current is measured outside ACTIVE",
}
for _name, _said in _RULES.items():
    _check(_said, _name)(lambda t, rule=_name: fail(t.wrong[rule]) if rule in t.wrong else None)


# what checks need


def _close(frame: Any, wanted: Sequence[float]) -> None:
    """See that measured currents are those wanted."""
    if any(abs(one - other) > 0.1 + 0.1 * abs(other) for one, other in zip(frame.body.currents, wanted)):
        fail(f"{shown(frame.body.currents)} A measured instead of {shown(wanted)} A")


def _zero(t: Tester) -> None:
    """See that no current is measured from the sample after next on."""
    for frame in t.states(4)[1:]:
        if not is_off(frame.body.currents):
            fail(f"{shown(frame.body.currents)} A after the cut")
