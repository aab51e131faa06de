"""Checks of sessions, requests, samples, commands, the controlled stop, floods and ignored frames."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any, TypeAlias

from maglev_mj.bridge import wire
from maglev_mj.bridge.conformance.tester import Tester, case, check, fail, same, shown
from maglev_mj.bridge.connection import draw, profile_of
from maglev_mj.bridge.wire import NEVER, VERSION, WRAP, Fault, Flag, HelloStatus, Operation, Outcome, State, fault_names
from maglev_mj.frames import ZERO

QUIET = 0.06
"""Silence that counts as no answer [s]."""

HALF = 0x7FFFFFFF
NAN = (math.nan,) * 6
_FLOOD = 256
"""HELLOs of a flood."""
_FADE = (*ZERO, 0.2, 1.0)
"""Controlled stop of 0.2 s without damping."""


@check("HELLO_ACK has this version and calibration, and plausible limits")
def _welcome(t: Tester) -> str:
    ack, period, least = t.welcome, t.welcome.period, max(abs(t.calibration.hover))
    same("version, calibration", (ack.version, ack.calibration), (VERSION, t.calibration.digest))
    profile_of(ack, t.greeted)
    if ack.enable < 2 * period or ack.hover_limit < least:
        fail(f"enable {ack.enable} ns, hover_limit {ack.hover_limit} A; needed: {2 * period} ns, {least:.4g} A")
    return f"device {ack.device}, {1e9 / period:g} Hz, delay {ack.delay / 1e6:g} ms, up to {ack.current_limit:g} A"


@check("HELLO with the same nonce returns the same session and changes nothing")
def _hello_again(t: Tester) -> str:
    t.bring(State.ACTIVE, answering=False)
    t.states(1)
    again = t.greet(t.nonce)
    same("status, session, state", (again.body.status, again.session, again.body.state), (0, t.session, State.ACTIVE))
    t.links[0].send(t.encode(wire.CommandFrame(t.last.sequence, 0, NAN, NAN, 0.0), sequence=t.sequence))
    t.answering = True
    t.command(t.last.sequence, ZERO)
    return t.expect(State.ACTIVE) and f"session {t.session}, sequence numbers kept"


@check("any other HELLO gets BUSY, whatever its calibration, and the session continues", state=State.ACTIVE)
def _busy(t: Tester) -> str:
    own = t.calibration.digest
    hellos = {"of another calibration": (draw(), flipped(own, 0), 0), "of another nonce": (draw(), own, 0)}
    if len(t.links) > 1:
        hellos |= {"from another address": (draw(), own, 1), "repeated from another address": (t.nonce, own, 1)}
    for name, hello in hellos.items():
        same(f"HELLO {name}: status", t.greet(*hello).body.status, HelloStatus.BUSY)
    t.expect(State.ACTIVE)
    return "BUSY"


@check("HELLO with another calibration gets CALIBRATION and no session")
def _calibration(t: Tester) -> str:
    t.ask(Operation.BYE)
    for index in (0, 7, 15):
        ack = t.greet(draw(), flipped(t.calibration.digest, index)).body
        name = f"byte {index} of the calibration changed"
        same(f"{name}: status", ack.status, HelloStatus.CALIBRATION)
        same(f"{name}: calibration", ack.calibration.hex(), t.calibration.digest.hex())
    t.join()
    return "CALIBRATION"


@check("HELLO of another version gets VERSION, whatever its length, unless its CRC is wrong")
def _version(t: Tester) -> str:
    hello = t.encode(wire.Hello(draw(), t.calibration.digest))
    for version in (VERSION - 1, VERSION + 1, 255):
        for data in (hello, hello[:20] + bytes(8), hello + bytes(40)):
            t.links[0].send(with_crc(data[:2] + bytes([version]) + data[3:]))
            with case(f"HELLO of version {version} in {len(data)} bytes"):
                ack = (t.wait(QUIET, wire.HelloAck) or fail("no answer")).body
                same("nonce, status, version", (*ack[:2], ack.version), (0, HelloStatus.VERSION, VERSION))
    t.links[0].send(hello[:2] + bytes([255]) + hello[3:])
    if t.wait(QUIET, wire.HelloAck) is not None:
        fail("an answer despite the wrong CRC")
    return f"VERSION, reporting version {VERSION}"


@check("session numbers are random: no repetition, no counting")
def _drawn(t: Tester) -> str:
    drawn = []
    for _ in range(6):
        t.ask(Operation.BYE)
        t.join()
        drawn.append(t.session)
    steps = {first - second for first, second in pairwise(drawn)}
    return shown(drawn) if len(steps) == 5 and max(map(abs, steps)) >= 1 << 16 else fail(shown(drawn))


@check("another host gets the session after 1 s of silence, not earlier; a repeated HELLO is silence", real_time=True)
def _takeover(t: Tester) -> str:
    t.answering, old = False, t.session
    t.states(700_000_000 // t.welcome.period)  # by the device's clock, as a loaded machine stalls
    same("status after 0.7 s", t.greet(draw()).body.status, HelloStatus.BUSY)
    same("status of the HELLO repeated", t.greet(t.nonce).body.status, HelloStatus.WELCOME)  # by whoever recorded it
    t.states(400_000_000 // t.welcome.period + 1)
    same("status after 1.1 s", t.greet(draw()).body.status, HelloStatus.WELCOME)
    trip = wire.ControlRequest(t.request + 1, Operation.TRIP, 0, ZERO)
    if t.exchange(trip, QUIET, session=old) is not None:
        fail("the old session is still accepted")
    t.join()
    return "BUSY after 0.7 s, WELCOME after 1.1 s"


@check("BYE ends the session: no STATE, no answer; a latched fault remains", state=State.FAULT)
def _bye(t: Tester) -> str:
    old = t.last.sequence
    t.ask(Operation.BYE)
    body = wire.ControlRequest(t.request, Operation.BYE, 0, ZERO)
    if t.exchange(body, max(QUIET, 4e-9 * t.welcome.period)) is not None or (t.last.sequence - old) & WRAP > 1:
        fail("the session still answers")
    t.join()
    return same("state, faults", (t.welcome.state, t.welcome.faults), (State.FAULT, Fault.HOST))


# requests


@check("a request is executed once: a repetition is acknowledged again, an older one is dropped", state=State.FAULT)
def _requests(t: Tester) -> str:
    t.ask(Operation.RESET)
    t.stopped()
    again = t.exchange(wire.ControlRequest(t.request, Operation.TRIP, Fault.CLOCK, ZERO)) or fail(
        "no answer to a repetition"
    )
    same("answer to a repetition", again.body[1:], (Operation.RESET, Outcome.DONE, State.FAULT, Fault.ESTOP))
    for behind in (1, 1000, HALF):
        body = wire.ControlRequest((t.request - behind) & WRAP, Operation.RESET, 0, ZERO)
        if t.exchange(body, QUIET) is not None:
            fail(f"an answer to a request {behind} older")
    t.expect(State.FAULT, Fault.ESTOP)
    return "acknowledged again, older ones dropped"


@check("request numbers start anywhere and wrap at 2^32, whatever the header's sequence number")
def _request_numbers(t: Tester) -> str:
    t.ask(Operation.BYE)
    t.join()
    t.request = WRAP - 3
    for sequence in (0, 5, 0, WRAP, 0, HALF, 1):
        t.ask(Operation.DISARM, sequence=sequence)
    for _ in range(3):
        t.request = (t.request + HALF - 1) & WRAP
        t.ask(Operation.DISARM)
    return "from 0xfffffffd to 3, then three steps of 2^31 - 1"


@check("each operation leads to the specified state; unknown ones are REFUSED")
def _operations(t: Tester) -> str:
    done, refused = Outcome.DONE, Outcome.REFUSED
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
        for operation, expected in table.items():
            t.bring(state)
            answer = t.ask(operation)
            same(f"operation {operation} in {state.name}: result, state", (answer.result, answer.state), expected)
        t.join()
    return f"{3 * len(table)} of {3 * len(table)}"


@check("ARM is refused if a hover current or a number of the controlled stop is not finite or exceeds its bounds")
def _arm(t: Tester) -> str:
    above, most = 1.01 * t.welcome.hover_limit, 1.01 * t.welcome.continuous_current / max(map(abs, t.half))
    cases: list[tuple[str, Sequence[float], int, float]] = [
        *(("hover", t.half, coil, current) for coil in range(6) for current in (above, -above, *UNREAL)),
        *(("stop", _FADE, index, value) for index in range(8) for value in UNREAL),
        *(("stop", _FADE, index, value) for index, value in ((6, -1e-6), (6, 1.001), (7, -1e-6), (7, most))),
    ]
    for field, values, index, value in cases:
        changed: dict[str, Any] = {field: [*values[:index], value, *values[index + 1 :]]}
        answer, name = t.ask(Operation.ARM, **changed), f"{value:g} in {field}[{index}]: result, state"
        same(name, (answer.result, answer.state), (Outcome.REFUSED, State.INACTIVE))
    t.expect(State.INACTIVE)
    return f"{len(cases)} of {len(cases)}, hover currents at {above:.3g} A"


@check("RESET is refused while a measured current is above off_current")
def _reset_flowing(t: Tester) -> str:
    t.bring(State.ACTIVE, t.half, answering=False)
    t.ask(Operation.TRIP)
    answer = t.ask(Operation.RESET)
    if answer.result != Outcome.REFUSED and not t.is_off(t.last.body.currents):
        fail(f"done with {shown(t.last.body.currents)} A")
    return f"result {answer.result}"


@check("TRIP latches the known fault bits, or HOST if there are none, and adds later ones")
def _trip(t: Tester) -> str:
    unknown = 1 << 31
    for faults in (*Fault, 0, unknown, unknown | Fault.BOUNDARY):
        t.bring(State.INACTIVE if faults else State.ACTIVE)
        expected, name = Fault(faults & ~unknown or Fault.HOST), f"TRIP of {fault_names(faults)}"
        same(f"{name}: faults", t.ask(Operation.TRIP, faults=faults).faults, expected)
        same(f"{name}, then CLOCK: faults", t.ask(Operation.TRIP, faults=Fault.CLOCK).faults, expected | Fault.CLOCK)
    t.expect(State.FAULT, Fault.BOUNDARY | Fault.CLOCK)
    return f"{len(Fault)} bits, 0, an unknown one"


@check("HELLO_ACK reports latched faults, the first ones and their time; RESET clears them")
def _first_fault(t: Tester) -> str:
    t.ask(Operation.TRIP, faults=Fault.BOUNDARY)
    at = t.asked_at
    t.states(2)
    t.ask(Operation.TRIP, faults=Fault.CLOCK)
    ack = t.greet(t.nonce).body
    same("faults, first", (ack.faults, ack.first), (Fault.BOUNDARY | Fault.CLOCK, Fault.BOUNDARY))
    if abs(ack.fault_time - at) > t.welcome.period:
        fail(f"fault_time {ack.fault_time} ns, but TRIP was executed at {at} ns")
    t.ask(Operation.RESET)
    ack = t.greet(t.nonce).body
    return same("state, faults, first, time", (ack.state, ack.faults, ack.first, ack.fault_time), (0, 0, 0, 0))


# samples


@check("STATEs are `period` apart, by time stamp and by arrival; diodes valid, currents off, no flag set")
def _period(t: Tester) -> str:
    period, count = t.welcome.period, max(100, 500_000_000 // t.welcome.period)
    start, frames = t.states(1)[0] and t.arrived, t.states(count)
    mean = (t.arrived - start) / count
    if not t.welcome.lockstep and abs(mean / period - 1.0) > 0.05:
        fail(f"{mean / 1e6:.3f} ms by arrival instead of {period / 1e6:g} ms")
    for body in (frame.body for frame in frames):
        on = max(map(abs, body.spots)) <= t.welcome.spot_limit
        seen = body.valid, body.flags, on, t.is_off(body.currents)
        same("valid, flags, spots on their diodes, currents off", seen, (7, 0, 1, 1))
    return f"{period / 1e6:g} ms by time stamp, {mean / 1e6:.3f} ms by arrival"


@check("`answered` and `age` describe the active command; none directly after ARM")
def _answered(t: Tester) -> str:
    t.answering = False
    t.states(0 if t.welcome.lockstep else 1)
    t.ask(Operation.ARM)
    for frame in t.states(0 if t.welcome.lockstep else 1):
        same("answered, age before any command", (frame.body.answered, frame.body.age), (NEVER, NEVER))
    t.bring(State.ACTIVE)
    return _recorded(t)


@check("while INACTIVE `answered` and `age` describe the newest CMD, whatever its contents")
def _answered_inactive(t: Tester) -> str:
    t.law = lambda frame: NAN
    t.states(1)
    return _recorded(t)


def _recorded(t: Tester) -> str:
    """Check that each STATE reports the answer to the previous one."""
    for frame in t.states(5):
        same("answered", frame.body.answered, (frame.sequence - 1) & WRAP)
        if frame.body.age * 1000 > t.welcome.period:
            fail(f"age {frame.body.age} us")
    return "the previous sample, age below a period"


@check("ENABLED is set while ACTIVE, and for at most `enable` + 1 period afterwards")
def _enabled(t: Tester) -> str:
    welcome = t.welcome
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE)
        same("ENABLED", {frame.body.flags & Flag.ENABLED for frame in t.states(20)}, {Flag.ENABLED})
        t.ask(leave)
        later = t.states(welcome.enable // welcome.period + 5)
        duration = max((frame.time - t.asked_at for frame in later if frame.body.flags & Flag.ENABLED), default=0)
        if duration > welcome.enable + welcome.period:
            fail(f"ENABLED {duration / 1e6:.3g} ms after {leave.name}")
    return f"for {duration / 1e6:.3g} ms afterwards; `enable` is {welcome.enable / 1e6:g} ms"


@check("measured currents follow commands, and are at most off_current after DISARM and TRIP")
def _currents(t: Tester) -> str:
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE, t.half)
        with case(f"in ACTIVE, before {leave.name}"):
            t.close(t.states(1)[0], t.half)
        t.ask(leave)
        with case(f"after {leave.name}"):
            off = t.zero()
    return f"{shown(t.half)} A, then {off}"


@check("a pending command is discarded when the currents are cut", real_time=True)
def _forgotten(t: Tester) -> str:
    for leave in (Operation.DISARM, Operation.TRIP):
        t.bring(State.ACTIVE, answering=False)
        t.command(t.states(1)[0].sequence, t.half)
        t.ask(leave)
        with case(f"after a CMD of {shown(t.half)} A and {leave.name}"):
            off = t.zero()
    return off


@check("a pulse replaces the held currents for its width", real_time=True)
def _pulse(t: Tester) -> str:
    welcome = t.welcome
    if 2 * welcome.delay > welcome.period:
        return "not checked: the delay is above half a period"
    t.bring(State.ACTIVE, answering=False)
    t.command(t.states(1)[0].sequence, ZERO, t.half, welcome.period * 1e-9)
    during, after = t.states(2)
    t.close(during, t.half)
    t.close(after, ZERO)
    return f"{shown(t.half)} A for a period"


@check("no sample before the last one is answered", lockstep=True)
def _lockstep(t: Tester) -> str:
    t.answering = False
    number = t.states(1)[0].sequence
    t.wait(0.2)
    return same("sample after 0.2 s", t.last.sequence, number)


@check("temperatures follow from the measured currents")
def _temperatures(t: Tester) -> str:
    t.bring(State.ACTIVE, t.half)
    welcome, (first, *later) = t.welcome, t.states(60)
    share, rises = -math.expm1(-welcome.period * 1e-9 / welcome.thermal_time), list(first.body.temperatures)
    for frame in later:
        squares = [(current / welcome.continuous_current) ** 2 for current in frame.body.currents]
        rises = [rise + share * (square - rise) for rise, square in zip(rises, squares)]
    for coil, (cold, rise, reported) in enumerate(zip(first.body.temperatures, rises, later[-1].body.temperatures)):
        if abs(reported - rise) > 0.2 * abs(rise - cold) + 1e-6:
            fail(f"coil {coil}: {reported:.3g} instead of {rise:.3g}, from {cold:.3g}")
    return f"from {max(first.body.temperatures):.3g} to {max(later[-1].body.temperatures):.3g}"


# commands


@check("CMDs have no effect in INACTIVE and FAULT, whatever their contents")
def _not_active(t: Tester) -> str:
    for state, faults in ((State.INACTIVE, 0), (State.FAULT, Fault.HOST)):
        t.bring(state)
        for held in (t.half, NAN, (100.0,) * 6):
            t.once = [[held]]
            with case(f"CMD of {shown(held)} A in {state.name}"):
                t.expect(state, faults)
                t.zero()
    return "ignored, contents not examined"


def _too_large(t: Tester) -> Sequence[float]:
    return 1.001 * t.welcome.current_limit, -1.001 * t.welcome.current_limit


def _bad_commands(name: str, fault: Fault, expected: str, values: Callable[[Tester], Iterable[float]]) -> None:
    """Add a check of commands with an invalid value in each current in turn, or in the pulse width."""

    def run(t: Tester) -> str:
        entries = [12] if name == "width" else range(12)
        for index, value in ((index, value) for index in entries for value in values(t)):
            t.bring(State.ACTIVE, t.half)
            numbers = [*t.half, *t.half, 0.0]
            numbers[index] = value
            t.once = [[numbers[:6], numbers[6:12], numbers[12]]]
            with case(f"{value:g} in entry {index} of held, pulsed, width"):
                t.expect(State.FAULT, fault, 1)
                t.zero()
                same("result of ARM", t.ask(Operation.ARM).result, Outcome.REFUSED)
                t.expect(State.FAULT, fault, 2)
        return f"{fault.name}, {len(entries)} entries"

    check(f"a CMD {expected} ends in {fault.name}: currents at most off_current, until RESET", name)(run)


UNREAL = (math.nan, math.inf, -math.inf)
_bad_commands("not-finite", Fault.INVALID_COMMAND, "with a non-finite value", lambda t: UNREAL)
_bad_commands("width", Fault.INVALID_COMMAND, "with a width outside 0 to 1 s", lambda t: (*UNREAL, -1e-6, 1.001))
_bad_commands("over-current", Fault.COIL_OVERCURRENT, "with a held or pulsed current above current_limit", _too_large)


@check("sequence numbers wrap at 2^32", state=State.ACTIVE)
def _sequence_numbers(t: Tester) -> str:
    for t.sequence in (HALF - 1, 2 * HALF - 2, WRAP - 3):
        with case(f"CMDs from number {t.sequence} on"):
            t.expect(State.ACTIVE)
    if (behind := (t.states(8)[-1].sequence - t.last.body.answered) & WRAP) > 2:
        fail(f"the last accepted command is {behind} samples old, at number {t.sequence}")
    return ignored(t, "from before the wrap", back=t.sequence + 3)


@check("a CMD far ahead blocks later CMDs only: CTRL and ESTOP still work, and WATCHDOG follows")
def _far_ahead(t: Tester) -> str:
    for end in ("ESTOP", "DISARM") if t.welcome.lockstep else ("ESTOP", "DISARM", "WATCHDOG"):
        with case(f"{end} after a CMD far ahead"):
            t.bring(State.ACTIVE)
            far, t.answering = (t.sequence + HALF) & WRAP, not t.welcome.lockstep
            t.links[0].send(t.encode(wire.CommandFrame(t.last.sequence, 0, ZERO, ZERO, 0.0), sequence=far))
            if end == "ESTOP":
                t.stopped()
            elif end == "DISARM":
                same("state", t.ask(Operation.DISARM).state, State.INACTIVE)
            else:
                t.states(t.welcome.watchdog // t.welcome.period + 2)
                t.expect(State.FAULT, Fault.WATCHDOG)
            t.sequence = far
    return f"CTRL and ESTOP work; ended in {end}"


@check("a CMD that is late by less than `stale` is accepted", real_time=True, state=State.ACTIVE)
def _late_command(t: Tester) -> str:
    behind = t.welcome.stale // t.welcome.period - 1
    t.states(behind)
    t.answering = False
    t.command(number := t.last.sequence - behind, ZERO)
    same("answered", t.states(1)[0].body.answered, number & WRAP)
    return f"{behind} samples late"


@check("CMDs older than `stale` do not feed the watchdog, use their numbers, keep the session", real_time=True)
def _stale_answers(t: Tester) -> str:
    welcome = t.welcome
    t.bring(State.ACTIVE, answering=False)
    for _ in range((welcome.watchdog + 1_100_000_000) // welcome.period + 2):
        t.states(1)
        t.command(t.last.sequence - welcome.stale // welcome.period - 1, ZERO)
        t.links[0].send(t.encode(wire.CommandFrame(t.last.sequence, 0, NAN, NAN, 0.0), sequence=t.sequence))
    t.expect(State.FAULT, Fault.WATCHDOG)
    return same("WATCHDOG; status of another host's HELLO", t.greet(draw()).body.status, HelloStatus.BUSY)


# the controlled stop


@check("controlled stop: TRIP and an invalid CMD fade the hover currents out; RESET is refused meanwhile", "stop")
def _fading(t: Tester) -> str:
    period = t.welcome.period
    trips = [((), Fault(0)), ((), Fault.CLOCK)]
    for held, faults in (*trips, (NAN, 0), ((1.001 * t.welcome.current_limit,) * 6, 0)):
        with case(f"by a CMD of {shown(held)} A" if held else f"by TRIP of {fault_names(faults)}"):
            t.bring(State.ACTIVE, t.half, stop=_FADE)
            t.once = [[held]] if held else []
            t.states(1) if held else t.ask(Operation.TRIP, faults=faults)
            frames = t.states(150_000_000 // period)
            same("result of RESET", t.ask(Operation.RESET).result, Outcome.REFUSED)
            frames += t.states(50_000_000 // period + 8)
            on = [frame for frame in frames if frame.body.flags & Flag.STOPPING] or fail("STOPPING is never set")
            if abs((span := on[-1].time - on[0].time) - 200_000_000) > 2 * period:
                fail(f"ended after {span / 1e6:.4g} ms instead of 200 ms")
            for frame in on:
                t.close(frame, [(1.0 - (frame.time - on[0].time) / 2e8) * current for current in t.half])
            off = t.zero()
    return f"{off} after {span / 1e6:.4g} ms"


@check("ESTOP, DISARM and any other fault cut during a controlled stop; before the first command no stop begins")
def _stop_cut(t: Tester) -> str:
    for end in (None, Operation.DISARM, Operation.TRIP):
        with case(end.name if end else "ESTOP"):
            t.bring(State.ACTIVE, t.half, stop=_FADE)
            t.ask(Operation.TRIP)
            t.ask(end, faults=Fault.BOUNDARY) if end else t.stopped(faults=Fault.ESTOP | Fault.HOST)
            t.zero()
    t.bring(State.INACTIVE, answering=False)
    t.ask(Operation.ARM, stop=_FADE)
    t.ask(Operation.TRIP)
    t.answering = True
    return t.zero()


# a flood of frames


@check("a flood of HELLOs delays no sample, and no ESTOP behind them by more than a period", real_time=True, peers=2)
def _flood(t: Tester) -> str:
    flood = [t.encode(wire.Hello(draw(), t.calibration.digest)) for _ in range(_FLOOD)]
    t.bring(State.ACTIVE, t.half)
    before, begun = t.states(1)[0].sequence, t.now()
    for data in (*flood, t.encode(wire.Estop(draw()))):
        t.links[1].send(data)
    sent, frames = t.now() - begun, t.states(10)
    same("samples", [(frame.sequence - before) & WRAP for frame in frames], [*range(1, 11)])
    stopped = [frame.sequence for frame in frames if frame.body.faults & Fault.ESTOP] or fail("ESTOP not in 10 samples")
    # the sample before the flood, and the next after a period
    if (after := (stopped[0] - before) & WRAP) > 2 + sent / t.welcome.period:
        fail(f"ESTOP {after} samples after {sent / 1e6:.3g} ms of HELLOs")
    while t.receive(QUIET, peer=1) is not None:
        pass  # the answers
    return f"{_FLOOD} HELLOs in {sent / 1e6:.3g} ms, ESTOP after {after} samples"


# frames that are ignored


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
    bodies: list[Any] = [wire.CommandFrame(0, 0, NAN, NAN, 0.0)]
    if back is None and not answers:
        bodies.append(wire.ControlRequest((t.request + 1) & WRAP, Operation.TRIP, 0, ZERO))
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
        if isinstance(body, wire.CommandFrame):
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


_Change: TypeAlias = Callable[[bytes], bytes]
_Headers: TypeAlias = Callable[[Tester], list[dict[str, int]]]


def _ignores(name: str, flaw: str, change: _Change = bytes, headers: _Headers = lambda t: [{}], **needs: Any) -> None:
    """Add a check that frames with a flaw are ignored; `headers` returns keywords of `ignored`."""

    def run(t: Tester) -> str:
        for header in headers(t):
            ignored(t, flaw, change, **header)
        return "ignored"

    check(f"a {'CMD' if change is bytes else 'frame'} {flaw} is ignored", name, **needs)(run)


def wrong_crc(data: bytes) -> bytes:
    """Return data with a wrong CRC."""
    return flipped(data, len(data) - 1)


def _old_answers(t: Tester) -> list[dict[str, int]]:
    """Return answers that are too old, by whole samples and by a fraction of a period."""
    samples, remainder = divmod(0 if t.welcome.lockstep else t.welcome.stale, t.welcome.period)
    within = {"answers": samples, "wait": remainder + t.welcome.period // 4}
    return [{"answers": 1 + samples}, *([] if t.welcome.lockstep else [within])]


_ignores("magic", "with another magic number", lambda data: with_crc(b"NJ" + data[2:]))
_ignores("crc", "with a wrong CRC", wrong_crc)
_ignores("frame-version", "of another version", lambda data: with_crc(data[:2] + b"\x01" + data[3:]))
_ignores("type", "of an unknown type", lambda data: with_crc(data[:3] + b"\x09" + data[4:]))
_ignores("too-short", "shorter than its type", lambda data: with_crc(data[:-5] + data[-4:]))
_ignores("too-long", "longer than its type", lambda data: with_crc(data[:-4] + bytes(1) + data[-4:]))
_ignores("no-tag", "without a tag", lambda data: with_crc(data[:-20] + data[-4:]), keyed=True)
_ignores("tag", "with a wrong tag", lambda data: with_crc(flipped(data, len(data) - 5)), keyed=True)
_ignores("session", "of another session", headers=lambda t: [{"session": (t.session + 1) & WRAP}, {"session": 0}])
_ignores("address", "from another address", headers=lambda t: [{"peer": 1}], peers=2)
_ignores("sequence", "with a repeated or old number", headers=lambda t: [{"back": n} for n in (0, 1, 1000, HALF)])
_ignores("future", "that answers a future sample", headers=lambda t: [{"answers": -1000}, {"answers": -HALF}])
_ignores("stale", "that answers a sample older than `stale`", headers=_old_answers)


@check("frames that only a device sends are ignored", state=State.ACTIVE)
def _direction(t: Tester) -> str:
    ack = wire.ControlAck(t.request + 1, Operation.TRIP, 0, State.FAULT, 1)
    for body in (t.last.body, ack, t.welcome, wire.blank(wire.EstopAck)._replace(request=draw())):
        t.links[0].send(t.encode(body, sequence=t.sequence + 1))
        with case(type(body).__name__):
            t.expect(State.ACTIVE)
    return "ignored"
