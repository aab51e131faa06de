"""Checks of sessions, requests and samples."""

from __future__ import annotations

import math
from itertools import pairwise

from maglev_mj.bridge import wire
from maglev_mj.bridge.conformance.check import HALF, NAN, QUIET, check, close, flipped, stopped, with_crc, zero
from maglev_mj.bridge.conformance.tester import Tester, fail, is_off, same, shown
from maglev_mj.bridge.connection import draw, profile_of
from maglev_mj.bridge.wire import NEVER, VERSION, WRAP, Fault, Flag, HelloStatus, Operation, Result, State
from maglev_mj.frames import ZERO


@check("HELLO_ACK has this version and calibration, and plausible numbers")
def _welcome(t: Tester) -> str:
    one, period, least = t.welcome, t.welcome.period, max(abs(t.calibration.hover))
    same("version, calibration", (one.version, one.calibration), (VERSION, t.calibration.digest))
    profile_of(one, t.greeted)
    if one.enable < 2 * period or one.hover_limit < least:
        fail(f"enable {one.enable} ns, hover_limit {one.hover_limit} A; needed are {2 * period} ns and {least:.4g} A")
    return f"device {one.device}, {1e9 / period:g} Hz, delay {one.delay / 1e6:g} ms, up to {one.current_limit:g} A"


@check("the same nonce gets the same session and changes nothing")
def _hello_again(t: Tester) -> str:
    t.bring(State.ACTIVE)
    t.answering = False
    t.states(1)
    again = t.greet(t.nonce)
    same("status, session, state", (again.body.status, again.session, again.body.state), (0, t.session, State.ACTIVE))
    t.links[0].send(t.encode(wire.Command(t.last.sequence, 0, NAN, NAN, 0.0), sequence=t.sequence))
    t.answering = True
    t.command(t.last.sequence, ZERO)
    return t.expect(State.ACTIVE) and f"session {t.session}, sequence numbers kept"


@check("any other HELLO gets BUSY, whatever its calibration, and the session goes on")
def _busy(t: Tester) -> str:
    t.bring(State.ACTIVE)
    same("status", t.greet(draw(), flipped(t.calibration.digest, 0)).body.status, HelloStatus.BUSY)
    for peer, nonce in [(0, draw()), *([(1, draw()), (1, t.nonce)] if len(t.links) > 1 else [])]:
        same("status", t.greet(nonce, peer=peer).body.status, HelloStatus.BUSY)
    t.expect(State.ACTIVE)
    return "BUSY"


@check("HELLO with another calibration gets CALIBRATION, and no session")
def _calibration(t: Tester) -> str:
    t.ask(Operation.BYE)
    for place in (0, 7, 15):
        one = t.greet(draw(), flipped(t.calibration.digest, place)).body
        same("status", one.status, HelloStatus.CALIBRATION)
        same("calibration", [*one.calibration], [*t.calibration.digest])
    t.join()
    return "CALIBRATION"


@check("HELLO of another version gets VERSION, whatever its length, unless its CRC is wrong")
def _version(t: Tester) -> str:
    hello = t.encode(wire.Hello(draw(), t.calibration.digest))
    for version in (VERSION - 1, VERSION + 1, 255):
        for data in (hello, hello[:20] + bytes(8), hello + bytes(40)):
            t.links[0].send(with_crc(data[:2] + bytes([version]) + data[3:]))
            answer = t.wait(QUIET, wire.HelloAck) or fail(f"no answer to version {version} in {len(data)} bytes")
            same("nonce, status, version", (answer.body[:2], answer.body.version), ((0, HelloStatus.VERSION), VERSION))
    t.links[0].send(hello[:2] + bytes([255]) + hello[3:])
    if t.wait(QUIET, wire.HelloAck) is not None:
        fail("an answer in spite of the CRC")
    return f"VERSION, and {VERSION} as its own"


@check("session numbers are drawn: none twice, not counted up")
def _drawn(t: Tester) -> str:
    drawn = []
    for _ in range(6):
        t.ask(Operation.BYE)
        t.join()
        drawn.append(t.session)
    steps = {one - other for one, other in pairwise(drawn)}
    return shown(drawn) if len(steps) == 5 and max(map(abs, steps)) >= 1 << 16 else fail(shown(drawn))


@check("another host gets the session after 1 s without a frame, not before", real_time=True)
def _takeover(t: Tester) -> str:
    t.answering, old = False, t.session
    t.states(700_000_000 // t.welcome.period)  # by the device's clock: loaded machines stall
    same("status after 0.7 s", t.greet(draw()).body.status, HelloStatus.BUSY)
    t.states(400_000_000 // t.welcome.period + 1)
    same("status after 1.1 s", t.greet(draw()).body.status, HelloStatus.WELCOME)
    trip = wire.Control(t.request + 1, Operation.TRIP, 0, ZERO)
    if t.exchange(trip, QUIET, session=old) is not None:
        fail("the old session is still obeyed")
    t.join()
    return "BUSY after 0.7 s, WELCOME after 1.1 s"


@check("BYE ends the session: no STATE, no answer; a latched fault stays")
def _bye(t: Tester) -> str:
    t.bring(State.FAULT)
    old = t.last.sequence
    t.ask(Operation.BYE)
    body = wire.Control(t.request, Operation.BYE, 0, ZERO)
    if t.exchange(body, max(QUIET, 4e-9 * t.welcome.period)) is not None or (t.last.sequence - old) & WRAP > 1:
        fail("the session still answers")
    t.join()
    return same("state, faults", (t.welcome.state, t.welcome.faults), (State.FAULT, Fault.HOST))


# requests


@check("a request is done once: repeated it is acknowledged again, an older one is dropped")
def _requests(t: Tester) -> str:
    t.bring(State.FAULT)
    t.ask(Operation.RESET)
    stopped(t)
    again = t.exchange(wire.Control(t.request, Operation.TRIP, Fault.CLOCK, ZERO)) or fail("no answer to a repetition")
    same("answer to a repetition", again.body[1:], (Operation.RESET, Result.DONE, State.FAULT, Fault.ESTOP))
    for behind in (1, 1000, HALF):
        body = wire.Control((t.request - behind) & WRAP, Operation.RESET, 0, ZERO)
        if t.exchange(body, QUIET) is not None:
            fail(f"an answer to a request {behind} older")
    t.expect(State.FAULT, Fault.ESTOP)
    return "acknowledged again, older ones dropped"


@check("request numbers begin anywhere and go round 2^32, whatever the header's sequence number")
def _request_numbers(t: Tester) -> str:
    t.ask(Operation.BYE)
    t.join()
    t.request = WRAP - 3
    for sequence in (0, 5, 0, WRAP, 0, HALF, 1):
        t.ask(Operation.DISARM, sequence=sequence)
    for _ in range(3):
        t.request = (t.request + HALF - 1) & WRAP
        t.ask(Operation.DISARM)
    return "from 0xfffffffd to 3, and on by 2^31 - 1 three times"


@check("operations lead where the table says, unknown ones are REFUSED")
def _operations(t: Tester) -> str:
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


@check("ARM is refused with a hover current that is not finite or above hover_limit")
def _arm(t: Tester) -> str:
    above = 1.01 * t.welcome.hover_limit
    for coil in range(6):
        for current in (above, -above, math.nan, math.inf, -math.inf):
            answer = t.ask(Operation.ARM, hover=[*t.half[:coil], current, *t.half[coil + 1 :]])
            same(f"{current:g} A: result, state", (answer.result, answer.state), (Result.REFUSED, State.INACTIVE))
    t.expect(State.INACTIVE)
    return f"30 of 30, at {above:.3g} A"


@check("RESET is refused while a measured current is above 0.25 A")
def _reset_flowing(t: Tester) -> str:
    t.bring(State.ACTIVE, lambda frame: t.half)
    t.answering = False
    t.ask(Operation.TRIP)
    answer = t.ask(Operation.RESET)
    if answer.result != Result.REFUSED and not is_off(t.last.body.currents):
        fail(f"done with {shown(t.last.body.currents)} A")
    return f"result {answer.result}"


@check("TRIP latches the bits of the table, HOST where there is none of them, and adds later ones")
def _trip(t: Tester) -> str:
    unknown = 1 << 31
    for faults in (*Fault, 0, unknown, unknown | Fault.BOUNDARY):
        t.bring(State.INACTIVE if faults else State.ACTIVE)
        wanted = faults & ~unknown or Fault.HOST
        same("faults", t.ask(Operation.TRIP, faults=faults).faults, wanted)
        same("faults with CLOCK", t.ask(Operation.TRIP, faults=Fault.CLOCK).faults, wanted | Fault.CLOCK)
    t.expect(State.FAULT, Fault.BOUNDARY | Fault.CLOCK)
    return f"{len(Fault)} bits, 0, an unknown one"


@check("HELLO_ACK says what is latched, what came first and when; RESET clears it")
def _first_fault(t: Tester) -> str:
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


@check("STATEs come by `period`, by time stamps and by arrival; diodes are valid, nothing flows, no flag is set")
def _period(t: Tester) -> str:
    period, count = t.welcome.period, max(100, 500_000_000 // t.welcome.period)
    begun, found = t.states(1)[0] and t.arrived, t.states(count)
    took = (t.arrived - begun) / count
    if not t.welcome.lockstep and abs(took / period - 1.0) > 0.05:
        fail(f"{took / 1e6:.3f} ms by arrival instead of {period / 1e6:g} ms")
    for one in (frame.body for frame in found):
        on = max(map(abs, one.spots)) <= t.welcome.spot_limit
        seen = one.valid, one.flags, on, is_off(one.currents)
        same("valid, flags, spots on their diodes, currents off", seen, (7, 0, 1, 1))
    return f"{period / 1e6:g} ms stamped, {took / 1e6:.3f} ms by arrival"


@check("`answered` and `age` are of the command in force; there is none after ARM")
def _answered(t: Tester) -> str:
    t.answering = False
    t.states(0 if t.welcome.lockstep else 1)
    t.ask(Operation.ARM)
    for frame in t.states(0 if t.welcome.lockstep else 1):
        same("answered, age before any command", (frame.body.answered, frame.body.age), (NEVER, NEVER))
    t.bring(State.ACTIVE)
    return _recorded(t)


@check("while INACTIVE `answered` and `age` are of the newest CMD, whatever is in it")
def _answered_inactive(t: Tester) -> str:
    t.law = lambda frame: NAN
    t.states(1)
    return _recorded(t)


def _recorded(t: Tester) -> str:
    """Check that each STATE names the answer to the one before."""
    for frame in t.states(5):
        same("answered", frame.body.answered, (frame.sequence - 1) & WRAP)
        if frame.body.age * 1000 > t.welcome.period:
            fail(f"age {frame.body.age} us")
    return "the sample before, less than a period old"


@check("ENABLED is said while ACTIVE, and for at most `enable` + 1 period after it")
def _enabled(t: Tester) -> str:
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


@check("measured currents are those commanded, and zero after DISARM and TRIP")
def _currents(t: Tester) -> str:
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE, lambda frame: t.half)
        close(t.states(1)[0], t.half)
        t.ask(leave)
        zero(t)
    return f"{shown(t.half)} A, then zero"


@check("a command under way when the currents are cut never flows", real_time=True)
def _forgotten(t: Tester) -> str:
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE)
        t.answering = False
        t.command(t.states(1)[0].sequence, t.half)
        t.ask(leave)
        zero(t)
    return "nothing flows"


@check("a pulse replaces the command for its width", real_time=True)
def _pulse(t: Tester) -> str:
    one = t.welcome
    if 2 * one.delay > one.period:
        return "not looked at: the delay is more than half a period"
    t.bring(State.ACTIVE)
    t.answering = False
    t.command(t.states(1)[0].sequence, ZERO, t.half, one.period * 1e-9)
    during, after = t.states(2)
    close(during, t.half)
    close(after, ZERO)
    return f"{shown(t.half)} A for a period"


@check("no sample is taken before the last one is answered", name="lockstep", lockstep=True)
def _lockstep(t: Tester) -> str:
    t.answering = False
    number = t.states(1)[0].sequence
    t.wait(0.2)
    return same("sample after 0.2 s", t.last.sequence, number)


@check("temperatures rise as the measured currents say")
def _temperatures(t: Tester) -> str:
    t.bring(State.ACTIVE, lambda frame: t.half)
    one, (first, *rest) = t.welcome, t.states(60)
    share, rises = -math.expm1(-one.period * 1e-9 / one.thermal_time), list(first.body.temperatures)
    for frame in rest:
        squares = [(current / one.continuous_current) ** 2 for current in frame.body.currents]
        rises = [rise + share * (square - rise) for rise, square in zip(rises, squares)]
    for cold, rise, said in zip(first.body.temperatures, rises, rest[-1].body.temperatures):
        if abs(said - rise) > 0.2 * abs(rise - cold) + 1e-6:
            fail(f"{said:.3g} instead of {rise:.3g}, from {cold:.3g}")
    return f"from {max(first.body.temperatures):.3g} to {max(rest[-1].body.temperatures):.3g}"
