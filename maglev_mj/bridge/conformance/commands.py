"""Checks of commands, emergency stops, silence and flights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from maglev_mj.bridge import wire
from maglev_mj.bridge.conformance.check import HALF, NAN, check, close, flipped, ignored, stopped, with_crc, zero
from maglev_mj.bridge.conformance.tester import Tester, Unexpected, fail, is_off, same, shown
from maglev_mj.bridge.connection import draw
from maglev_mj.bridge.wire import NEVER, WRAP, Fault, Flag, HelloStatus, Operation, Result, State
from maglev_mj.frames import ZERO

_JUNK = 500


# commands


@check("CMDs do nothing while INACTIVE or FAULT, whatever is in them")
def _not_active(t: Tester) -> str:
    for state, faults in ((State.INACTIVE, 0), (State.FAULT, Fault.HOST)):
        t.bring(state)
        for held in (t.half, NAN, (100.0,) * 6):
            t.once = [[held]]
            t.expect(state, faults)
            zero(t)
    return "not obeyed, not examined"


def _bad_commands(name: str, fault: Fault, expected: str, values: Callable[[Tester], Iterable[float]]) -> None:
    """Add a check of commands with invalid values.

    The value is put in each of the currents in turn, or is the pulse width.
    """

    def run(t: Tester) -> str:
        places = [12] if name == "width" else range(12)
        for place, value in ((place, value) for place in places for value in values(t)):
            t.bring(State.ACTIVE, lambda frame: t.half)
            numbers = [*t.half, *t.half, 0.0]
            numbers[place] = value
            t.once = [[numbers[:6], numbers[6:12], numbers[12]]]
            try:
                t.expect(State.FAULT, fault, 1)
                zero(t)
                same("result of ARM", t.ask(Operation.ARM).result, Result.REFUSED)
                t.expect(State.FAULT, fault, 2)
            except Unexpected as error:
                fail(f"{value:g} in place {place} of held, pulsed, width: {error}")
        return f"{fault.name}, {len(places)} places"

    check(f"a CMD {expected} ends in {fault.name}: currents zero, until RESET", name)(run)


_UNREAL = (math.nan, math.inf, -math.inf)
_bad_commands("not-finite", Fault.INVALID_COMMAND, "that is not finite", lambda t: _UNREAL)
_bad_commands("width", Fault.INVALID_COMMAND, "of a width outside 0 to 1 s", lambda t: (*_UNREAL, -1e-6, 1.001))
_bad_commands(
    "over-current",
    Fault.COIL_OVERCURRENT,
    "beyond current_limit, held or pulsed,",
    lambda t: (1.001 * t.welcome.current_limit, -1.001 * t.welcome.current_limit),
)


@check("sequence numbers go round 2^32")
def _sequence_numbers(t: Tester) -> str:
    t.bring(State.ACTIVE)
    for t.sequence in (HALF - 1, 2 * HALF - 2, WRAP - 3):
        t.expect(State.ACTIVE)
    if (behind := (t.states(8)[-1].sequence - t.last.body.answered) & WRAP) > 2:
        fail(f"the last command obeyed is {behind} samples old, at number {t.sequence}")
    return ignored(t, "from before the wrap", back=t.sequence + 3)


@check("a CMD far ahead deafens to CMDs alone: CTRL and ESTOP are heard, and it ends in WATCHDOG")
def _far_ahead(t: Tester) -> str:
    for end in ("ESTOP", "DISARM") if t.welcome.lockstep else ("ESTOP", "DISARM", "WATCHDOG"):
        t.bring(State.ACTIVE)
        far, t.answering = (t.sequence + HALF) & WRAP, not t.welcome.lockstep
        t.links[0].send(t.encode(wire.Command(t.last.sequence, 0, ZERO, ZERO, 0.0), sequence=far))
        if end == "ESTOP":
            stopped(t)
        elif end == "DISARM":
            same("state after DISARM", t.ask(Operation.DISARM).state, State.INACTIVE)
        else:
            t.states(t.welcome.watchdog // t.welcome.period + 2)
            t.expect(State.FAULT, Fault.WATCHDOG)
        t.sequence = far
    return f"heard; it ended in {end}"


@check("a CMD that is late by less than `stale` is obeyed", real_time=True)
def _late_command(t: Tester) -> str:
    t.bring(State.ACTIVE)
    behind = t.welcome.stale // t.welcome.period - 1
    t.states(behind)
    t.answering = False
    t.command(late := t.last.sequence - behind, ZERO)
    same("answered", t.states(1)[0].body.answered, late & WRAP)
    return f"{behind} samples late"


@check("CMDs that answer samples older than `stale` feed nothing, use up their numbers, show a host", real_time=True)
def _stale_answers(t: Tester) -> str:
    one = t.welcome
    t.bring(State.ACTIVE)
    t.answering = False
    for _ in range((one.watchdog + 1_100_000_000) // one.period + 2):
        t.states(1)
        t.command(t.last.sequence - one.stale // one.period - 1, ZERO)
        t.links[0].send(t.encode(wire.Command(t.last.sequence, 0, NAN, NAN, 0.0), sequence=t.sequence))
    t.expect(State.FAULT, Fault.WATCHDOG)
    return same("WATCHDOG; status of another host's HELLO", t.greet(draw()).body.status, HelloStatus.BUSY)


# frames that are ignored

_CHANGES: dict[str, tuple[str, Callable[[bytes], bytes], bool]] = {
    "magic": ("of another magic", lambda data: with_crc(b"NJ" + data[2:]), False),
    "crc": ("whose CRC is wrong", lambda data: flipped(data, len(data) - 1), False),
    "frame-version": ("of another version", lambda data: with_crc(data[:2] + b"\x01" + data[3:]), False),
    "type": ("of an unknown type", lambda data: with_crc(data[:3] + b"\x09" + data[4:]), False),
    "too-short": ("shorter than its type", lambda data: with_crc(data[:-5] + data[-4:]), False),
    "too-long": ("longer than its type", lambda data: with_crc(data[:-4] + bytes(1) + data[-4:]), False),
    "no-tag": ("without a tag", lambda data: with_crc(data[:-20] + data[-4:]), True),
    "tag": ("with a wrong tag", lambda data: with_crc(flipped(data, len(data) - 5)), True),
}
_HEADERS: dict[str, tuple[str, Callable[[Tester], Iterable[dict[str, int]]], int]] = {
    "session": ("of another session", lambda t: [{"session": one} for one in ((t.session + 1) & WRAP, 0)], 1),
    "address": ("from another address", lambda t: [{"peer": 1}], 2),
    "sequence": (
        "of a doubled or old sequence number",
        lambda t: [{"back": one} for one in (0, 1, 1000, HALF)],
        1,
    ),
    "future": ("that answers a sample yet to come", lambda t: [{"answers": one} for one in (-1000, -HALF)], 1),
    "stale": ("that answers a sample older than `stale`", lambda t: _old_answers(t), 1),
}


def _old_answers(t: Tester) -> list[dict[str, int]]:
    """Return answers that are too old: by samples, and by the time within one."""
    samples, rest = divmod(0 if t.welcome.lockstep else t.welcome.stale, t.welcome.period)
    within = {"answers": samples, "wait": rest + t.welcome.period // 4}
    return [{"answers": 1 + samples}, *([] if t.welcome.lockstep else [within])]


def _all_ignored(t: Tester, said: str, headers: Callable[[Tester], Iterable[dict[str, int]]]) -> str:
    for header in headers(t):
        ignored(t, said, bytes, **header)
    return "ignored"


for _name, (_said, _change, _keyed) in _CHANGES.items():
    check(f"a frame {_said} is ignored", _name, keyed=_keyed)(partial(ignored, said=_said, change=_change))
for _name, (_said, _headers, _peers) in _HEADERS.items():
    check(f"a CMD {_said} is ignored", _name, peers=_peers)(partial(_all_ignored, said=_said, headers=_headers))


@check("frames that only a device sends are ignored")
def _direction(t: Tester) -> str:
    t.bring(State.ACTIVE)
    ack = wire.ControlAck(t.request + 1, Operation.TRIP, 0, State.FAULT, 1)
    for body in (t.last.body, ack, t.welcome, wire.EstopAck(draw(), State.FAULT, Fault.ESTOP, 0, ZERO)):
        t.links[0].send(t.encode(body, sequence=t.sequence + 1))
        t.expect(State.ACTIVE)
    return "ignored"


# the emergency stop


@check("ESTOP is obeyed in every state, again and again, and answered with currents measured after it: zero")
def _estop(t: Tester) -> str:
    for state, faults in zip(State, (Fault.ESTOP, Fault.ESTOP, Fault.ESTOP | Fault.HOST)):
        t.bring(state, lambda frame: t.half)
        said = stopped(t, faults=faults)
        t.expect(State.FAULT, faults)
        stopped(t, faults=faults)
    return said


@check("ESTOP needs no session")
def _estop_without_session(t: Tester) -> str:
    t.ask(Operation.BYE)
    if t.exchange(wire.Estop(draw())) is None:
        fail("no answer to ESTOP")
    t.join()
    return same("state, faults", (t.welcome.state, t.welcome.faults), (State.FAULT, Fault.ESTOP))


@check(f"ESTOP is obeyed from another address, within 0.25 s behind {_JUNK} frames that are none", peers=2)
def _estop_elsewhere(t: Tester) -> str:
    t.bring(State.ACTIVE, lambda frame: t.half)
    stopped(t, peer=1)
    t.expect(State.FAULT, Fault.ESTOP)
    t.bring(State.ACTIVE, lambda frame: t.half)
    for count in range(_JUNK):
        t.links[1].send(_CHANGES["crc"][1](t.encode(wire.Estop(count))))
    begun = t.now()
    if t.exchange(wire.Estop(draw()), 0.25, peer=1) is None:
        fail(f"no answer behind {_JUNK} frames")
    t.expect(State.FAULT, Fault.ESTOP)
    return f"{(t.now() - begun) / 1e6:.1f} ms behind {_JUNK} frames"


# silence


def _silence(t: Tester, hover: Sequence[float], arrived: int = 0) -> str:
    """Send nothing; check HOLDING and WATCHDOG.

    Times are those of the device's own clock and measured currents.
    """
    one, t.answering = t.welcome, False
    seen = t.states(one.watchdog // one.period + 8)
    ages = [frame.time - 1000 * frame.body.age for frame in seen if frame.body.age != NEVER]
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
            close(frame, hover)
        elif frame.time > cut[0].time and not is_off(frame.body.currents):
            fail(f"{said}, and {shown(frame.body.currents)} A after it")
    return said


@check("silence after ARM: its hover currents after two periods, WATCHDOG and zero after `watchdog`", real_time=True)
def _silence_after_arm(t: Tester) -> str:
    t.answering = False
    t.ask(Operation.ARM)
    return _silence(t, t.half, t.asked_at)


@check("silence after commands: the same, counted from the last one", real_time=True)
def _silence_after_commands(t: Tester) -> str:
    t.bring(State.ACTIVE)
    return _silence(t, t.half)


# flights


def _bad_line(t: Tester) -> str:
    t.loss = 0.05
    t.states(2_000_000_000 // t.welcome.period)
    return t.hovers()


def _let_go(t: Tester, operation: Operation) -> str:
    answer: Any = t.ask(operation)
    if operation == Operation.BYE:
        t.join()
        answer = t.welcome
    same("state", answer.state, State.INACTIVE)
    return zero(t)


def _over_current(t: Tester) -> str:
    t.once = [[[1.001 * t.welcome.current_limit] * 6]]
    t.expect(State.FAULT, Fault.COIL_OVERCURRENT, 1)
    return zero(t)


_FLIGHTS: dict[str, tuple[str, Callable[[Tester], str], bool]] = {
    "hover": ("it hovers at the centre, and lands", Tester.hovers, False),
    "bad-line": ("it hovers with 5 % of the CMDs lost, as many damaged, as many doubled", _bad_line, True),
    "flight-silence": ("its hover currents, then WATCHDOG", lambda t: _silence(t, t.calibration.hover.tolist()), True),
    "flight-over-current": ("a CMD beyond current_limit cuts", _over_current, False),
    "flight-estop": ("ESTOP cuts", stopped, False),
    "flight-disarm": ("DISARM cuts", lambda t: _let_go(t, Operation.DISARM), False),
    "flight-bye": ("BYE cuts", lambda t: _let_go(t, Operation.BYE), False),
}


def _flown(t: Tester, end: Callable[[Tester], str]) -> str:
    with t.flying():
        return end(t)


for _name, (_said, _end, _real_time) in _FLIGHTS.items():
    check(f"in flight: {_said}", _name, flight=True, real_time=_real_time)(partial(_flown, end=_end))


# rules of all frames, at last

_RULES = {
    "frames": "every frame has its length, CRC, tag, zeros, session and sequence number; its time does not go back",
    "samples": "every STATE is finite, whole periods after the one before, with conversions; FAULT has faults",
    "cut": "no current is measured outside ACTIVE",
}


def _kept(t: Tester, rule: str) -> str:
    return fail(t.wrong[rule]) if rule in t.wrong else "as expected"


for _name, _said in _RULES.items():
    check(_said, _name)(partial(_kept, rule=_name))
