"""Checks of the emergency stop, of silence, in flight, and of the rules for all frames."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from maglev_mj.bridge import wire
from maglev_mj.bridge.conformance import walls  # noqa: F401, registers its checks before those in flight
from maglev_mj.bridge.conformance.protocol import wrong_crc
from maglev_mj.bridge.conformance.tester import Tester, case, check, fail, same, shown
from maglev_mj.bridge.connection import draw
from maglev_mj.bridge.wire import NEVER, Fault, Flag, Frame, Operation, State

_JUNK = 500
_GENTLE = 1.0 / 3.0
"""Largest speed at which a controlled stop sets the flotor down, as a share of that of a dropped one."""


# the emergency stop


@check("ESTOP works in every state, repeatedly; the answer reports currents at most off_current, measured after it")
def _estop(t: Tester) -> str:
    for state, faults in zip(State, (Fault.ESTOP, Fault.ESTOP, Fault.ESTOP | Fault.HOST)):
        t.bring(state, t.half)
        with case(f"in {state.name}"):
            duration = t.stopped(faults=faults)
            t.expect(State.FAULT, faults)
            t.stopped(faults=faults)
    return duration


@check("ESTOP needs no session")
def _estop_without_session(t: Tester) -> str:
    t.ask(Operation.BYE)
    if t.exchange(wire.Estop(draw())) is None:
        fail("no answer to ESTOP")
    t.join()
    return same("state, faults", (t.welcome.state, t.welcome.faults), (State.FAULT, Fault.ESTOP))


@check(f"ESTOP works from another address, within 0.25 s behind {_JUNK} invalid frames", peers=2)
def _estop_elsewhere(t: Tester) -> str:
    t.bring(State.ACTIVE, t.half)
    t.stopped(peer=1)
    t.expect(State.FAULT, Fault.ESTOP)
    t.bring(State.ACTIVE, t.half)
    for count in range(_JUNK):
        t.links[1].send(wrong_crc(t.encode(wire.Estop(count))))
    start = t.now()
    if t.exchange(wire.Estop(draw()), 0.25, peer=1) is None:
        fail(f"no answer behind {_JUNK} frames")
    t.expect(State.FAULT, Fault.ESTOP)
    return f"{(t.now() - start) / 1e6:.1f} ms behind {_JUNK} frames"


# silence


def silence(t: Tester, hover: Sequence[float], arrived: int = 0) -> tuple[str, list[Frame]]:
    """Send nothing; check HOLDING and WATCHDOG. Return their times by the device's clock as text, and the samples."""
    welcome, t.answering = t.welcome, False
    frames = t.states(welcome.watchdog // welcome.period + 8)
    arrivals = [frame.time - 1000 * frame.body.age for frame in frames if frame.body.age != NEVER]
    arrived = arrivals[-1] if arrivals else arrived
    held = [frame for frame in frames if frame.body.flags & Flag.HOLDING] or fail("HOLDING is never set")
    cut = [frame for frame in frames if frame.body.state == State.FAULT] or fail("no WATCHDOG")
    holding, watchdog = held[0].time - arrived, cut[0].time - arrived
    times = f"HOLDING after {holding / 1e6:.3g} ms, WATCHDOG after {watchdog / 1e6:.4g} ms"
    rounding = 1000  # of an age [ns]
    on_time = 2 * welcome.period - rounding <= holding <= 3 * welcome.period + rounding
    if not (on_time and welcome.watchdog - rounding <= watchdog <= welcome.watchdog + welcome.period + rounding):
        fail(f"{times}; the period is {welcome.period / 1e6:g} ms, `watchdog` {welcome.watchdog / 1e6:g} ms")
    same(f"{times}; faults", cut[0].body.faults, Fault.WATCHDOG)
    for frame in frames:
        if held[0].time + welcome.delay < frame.time <= cut[0].time:
            t.close(frame, hover)
        elif frame.time > cut[0].time and not (frame.body.flags & Flag.STOPPING or t.is_off(frame.body.currents)):
            fail(f"{times}, then {shown(frame.body.currents)} A")
    return times, frames


@check("silence after ARM: hover currents after two periods, WATCHDOG and the cut after `watchdog`", real_time=True)
def _silence_after_arm(t: Tester) -> str:
    t.answering = False
    t.ask(Operation.ARM)
    return silence(t, t.half, t.asked_at)[0]


@check("silence after commands: the same, timed from the last command", real_time=True, state=State.ACTIVE)
def _silence_after_commands(t: Tester) -> str:
    return silence(t, t.half)[0]


# in flight


check("in flight: hovers at the centre and lands", "hover", flight=True)(Tester.hovers)


@check("in flight: hovers with 5 % of the CMDs lost, 5 % damaged and 5 % duplicated", flight=True, real_time=True)
def _bad_line(t: Tester) -> str:
    t.loss = 0.05
    t.states(2_000_000_000 // t.welcome.period)
    return t.hovers()


def _set_down(t: Tester, frames: Sequence[Frame] = ()) -> str:
    """Check that a controlled stop sets the flotor down gently, from its first samples on."""
    heights = [t.locate(frame)[2] for frame in (*frames, *t.states(600_000_000 // t.welcome.period))]
    speed = max(before - after for before, after in pairwise(heights)) * 1e9 / t.welcome.period
    if speed > _GENTLE * t.calibration.device.scale.drop:
        fail(f"it falls at {speed:.2f} m/s")
    return f"{t.zero()}, set down at {speed:.2f} m/s"


@check("in flight: silence gives hover currents, WATCHDOG, and a controlled stop", flight=True, real_time=True)
def _flight_silence(t: Tester) -> str:
    times, frames = silence(t, t.calibration.hover.tolist())
    return f"{times}; {_set_down(t, frames)}"


@check("in flight: a CMD above current_limit ends in a controlled stop", flight=True)
def _flight_over_current(t: Tester) -> str:
    t.once = [[[1.001 * t.welcome.current_limit] * 6]]
    t.expect(State.FAULT, Fault.COIL_OVERCURRENT, 1)
    return _set_down(t)


check("in flight: ESTOP cuts the currents", "flight-estop", flight=True)(Tester.stopped)


@check("in flight: DISARM cuts the currents", flight=True)
def _flight_disarm(t: Tester) -> str:
    same("state", t.ask(Operation.DISARM).state, State.INACTIVE)
    return t.zero()


@check("in flight: BYE cuts the currents", flight=True)
def _flight_bye(t: Tester) -> str:
    t.ask(Operation.BYE)
    t.join()
    same("state", t.welcome.state, State.INACTIVE)
    return t.zero()


# rules for all frames, evaluated last


def _keeps(name: str, expected: str) -> None:
    """Add a check of a rule for all frames received so far."""
    check(expected, name)(lambda t: fail(t.wrong[name]) if name in t.wrong else "as expected")


_keeps("frames", "every frame has the right length, CRC, tag, zeros, session and number; time never decreases")
_keeps("samples", "every STATE is finite, whole periods after the last, with conversions; FAULT has faults")
_keeps("cut", "currents at most off_current outside ACTIVE, except in a controlled stop")
