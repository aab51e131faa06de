"""Checks in flight, and of the rules for all frames."""

from __future__ import annotations

from itertools import pairwise

from maglev_mj.bridge.conformance.check import check, stopped, zero
from maglev_mj.bridge.conformance.protocol import silence
from maglev_mj.bridge.conformance.tester import Tester, fail, same
from maglev_mj.bridge.wire import Fault, Operation, State

_GENTLE = 0.1
"""Largest speed at which a controlled stop sets the flotor down [m/s]."""


check("in flight: hovers at the centre and lands", "hover", flight=True)(Tester.hovers)


@check("in flight: hovers with 5 % of the CMDs lost, 5 % damaged and 5 % duplicated", flight=True, real_time=True)
def _bad_line(t: Tester) -> str:
    t.loss = 0.05
    t.states(2_000_000_000 // t.welcome.period)
    return t.hovers()


def _set_down(t: Tester) -> str:
    """Check that a controlled stop sets the flotor down gently."""
    heights = [t.locate(frame)[2] for frame in t.states(600_000_000 // t.welcome.period)]
    speed = max(before - after for before, after in pairwise(heights)) * 1e9 / t.welcome.period
    return fail(f"it falls at {speed:.2f} m/s") if speed > _GENTLE else f"{zero(t)}, set down at {speed:.2f} m/s"


@check("in flight: silence gives hover currents, WATCHDOG, and a controlled stop", flight=True, real_time=True)
def _flight_silence(t: Tester) -> str:
    return f"{silence(t, t.calibration.hover.tolist())}; {_set_down(t)}"


@check("in flight: a CMD above current_limit ends in a controlled stop", flight=True)
def _flight_over_current(t: Tester) -> str:
    t.once = [[[1.001 * t.welcome.current_limit] * 6]]
    t.expect(State.FAULT, Fault.COIL_OVERCURRENT, 1)
    return _set_down(t)


check("in flight: ESTOP cuts the currents", "flight-estop", flight=True)(stopped)


@check("in flight: DISARM cuts the currents", flight=True)
def _flight_disarm(t: Tester) -> str:
    same("state", t.ask(Operation.DISARM).state, State.INACTIVE)
    return zero(t)


@check("in flight: BYE cuts the currents", flight=True)
def _flight_bye(t: Tester) -> str:
    t.ask(Operation.BYE)
    t.join()
    same("state", t.welcome.state, State.INACTIVE)
    return zero(t)


# rules for all frames, evaluated last


def _keeps(name: str, expected: str) -> None:
    """Add a check of a rule for all frames received so far."""
    check(expected, name)(lambda t: fail(t.wrong[name]) if name in t.wrong else "as expected")


_keeps("frames", "every frame has the right length, CRC, tag, zeros, session and number; time never decreases")
_keeps("samples", "every STATE is finite, whole periods after the last, with conversions; FAULT has faults")
_keeps("cut", "no current outside ACTIVE, except in a controlled stop")
