"""Guards of a flight.

Those of the device cut its currents. Those of late answers, and of laws that vibrate or give out energy, land it.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, TypeAlias

from maglev_mj.bridge.connection import SampleCounter
from maglev_mj.bridge.safety import WARNING_RISE, CoilGuard, FlotorGuard, HostLimits, Limits, SpotGuard, reading_fault
from maglev_mj.bridge.wire import Fault, Flag, State, StateReport
from maglev_mj.errors import SensingError
from maglev_mj.frames import ZERO
from maglev_mj.spec import INERTIA
from maglev_mj.theory.closed_loop import MOST_PERIODS

_BORNE = 0.8
"""Share of what laws bear from which answers are late.

Near what it bears, a loop swings long after a tap.
"""
_SURE = 0.005
"""Delay up to which laws are taken to bear the whole [s].

Usual delays leave no room for a share.
"""
_LONGEST = 0.03
"""Longest delay to which margins are known [s]."""
_RULES = (3, 5, 3.0), (8, 16, 1.25), (48, 64, 1.0)
"""Late answers, of how many, beyond how much of the delay from which they are late.

A busy machine has answers a little late for a tenth of a second; a loop swings up slowly there.
"""
_MEMORY = 0.2
"""Time constant in which reversals are forgotten [s]."""
_SWING = 10.0
"""Largest part of a swing in the second sum of reversals [N].

A blow is a few hard swings, which weak vibrations exceed by their number.
"""
_REVERSALS, _SMALL = 380.0, 190.0
"""Most reversals of a law's force in both sums [N].

Twice the largest of good flights: 184 and 86 N, taps of 20 N on the stiffest published wall at 200 Hz.
"""
_SPAN = 1.0
_ENERGY = 0.045
"""Most energy that laws may give out in a second [J].

More than twice the largest of good flights, 18 mJ: 20 N let go after a second against a wall.
"""
_HEAVY = 1e9
_SIZES = tuple(math.sqrt(own / INERTIA[0]) for own in INERTIA)
"""Radius of gyration of each rotation, 1 for translations [m].

A torque over it is a force, an angle times it a path.
"""

_ACTIVE, _ENABLED, _HOLDING = State.ACTIVE.value, Flag.ENABLED.value, Flag.HOLDING.value  # quicker than the members


class DeviceSample(NamedTuple):
    """One sample of a device, for its guards.

    Attributes:
        report: Device's report.
        before: Report of the sample before; None for the first.
        samples: Counter of samples, up to this one.
        active: True if this host has switched the currents on.
        led: True unless a scene is rendered: the default envelope applies if it is the larger.
        pose: Measured pose [m, rad], six; NaN for spots that no pose has.
        error: Why there is no pose; None if there is one.
        since: Time since the last pose [s].
        expected: Currents that should flow [A], six; None if not known.
        modelled: Temperature rises by the currents sent, six; 1 trips.
    """

    report: StateReport
    before: StateReport | None
    samples: SampleCounter
    active: bool
    led: bool
    pose: Sequence[float]
    error: SensingError | None
    since: float
    expected: Sequence[float] | None
    modelled: Sequence[float]


class Alarm(NamedTuple):
    """Result of a guard: faults, and what is wrong in one line."""

    faults: Fault
    message: str


Guard: TypeAlias = Callable[[DeviceSample], Alarm | None]
"""Check of a device: it adds a sample, and returns what is wrong or None."""


def device_guards(limits: Limits, own: HostLimits, period: float) -> list[Guard]:
    """Return the guards of a device, in their order: the first that finds a fault names it.

    Args:
        limits: The smaller of the device's and the host's limits.
        own: Limits of the host.
        period: Sample period [s].
    """
    return [
        partial(_spots, SpotGuard(limits, period)),
        partial(_readings, limits),
        _pose,
        partial(_envelope, FlotorGuard(own)),
        partial(_currents, CoilGuard()),
        partial(_holding, 2e6 * period),
        _enabled,
        _clock,
        _Temperatures(),
    ]


def _spots(guard: SpotGuard, sample: DeviceSample) -> Alarm | None:
    report = sample.report
    if not (fault := guard.check(report.spots, report.valid, report.conversions, sample.samples.elapsed)):
        return None
    spots = ", ".join(f"{part * 1e3:.3f}" for part in report.spots)
    return Alarm(fault, f"spots {spots} mm, valid {report.valid:03b}, conversion {report.conversions}")


def _readings(limits: Limits, sample: DeviceSample) -> Alarm | None:
    six = sample.report.currents, sample.report.temperatures
    if not (fault := reading_fault(limits, *six)):
        return None
    return Alarm(fault, "measured currents {} A, temperatures {}".format(*(_listed(one, ".3g") for one in six)))


def _pose(sample: DeviceSample) -> Alarm | None:
    return None if sample.error is None else Alarm(Fault.SENSOR_OUT_OF_RANGE, str(sample.error))


def _envelope(guard: FlotorGuard, sample: DeviceSample) -> Alarm | None:
    if sample.error is not None or not (fault := guard.check(sample.pose, sample.since, sample.led)):
        return None
    return Alarm(fault, f"the flotor is at {shown(sample.pose)}")


def _currents(guard: CoilGuard, sample: DeviceSample) -> Alarm | None:
    measured = sample.report.currents
    expected = sample.expected if sample.active else measured  # which ends a series of strikes
    if expected is None or not (fault := guard.check(expected, measured)):
        return None
    return Alarm(fault, f"the device measures {_listed(measured, '.2f')} A, and was told {_listed(expected, '.2f')} A")


def _holding(recent: float, sample: DeviceSample) -> Alarm | None:
    """Check that a device whose newest answer is younger than some time [µs] does not hold."""
    report = sample.report
    if not (sample.active and report.flags & _HOLDING and report.age < recent):
        return None
    return Alarm(Fault.HOST, f"the device is HOLDING for want of answers, the newest {report.age} µs old")


def _enabled(sample: DeviceSample) -> Alarm | None:
    """Check two samples; one from before arming need not be ENABLED."""
    if not (sample.active and _is_open(sample.report) and sample.before is not None and _is_open(sample.before)):
        return None
    return Alarm(Fault.HOST, "the amplifiers are not ENABLED, and the device does not cut the currents")


def _clock(sample: DeviceSample) -> Alarm | None:
    wrong = sample.samples.out_of_step
    return Alarm(Fault.CLOCK, wrong) if wrong and sample.active else None


class _Temperatures:
    """Check of the temperatures, which warns once."""

    _warned = False

    def __call__(self, sample: DeviceSample) -> Alarm | None:
        if not sample.active or max(*sample.report.temperatures, *sample.modelled) < WARNING_RISE:
            return None
        rises = larger(sample.report.temperatures, sample.modelled)
        if (warmest := max(rises)) >= 1.0:
            return Alarm(Fault.COIL_OVERTEMP, f"coil {rises.index(warmest)} bears no more")
        if not self._warned:
            self._warned = True
            warnings.warn(f"a coil is at {warmest:.0%} of what it bears", stacklevel=3)
        return None


def larger(reported: Sequence[float], modelled: Sequence[float]) -> list[float]:
    """Return the larger of reported and modelled temperature rises, six."""
    return [max(one, other) for one, other in zip(reported, modelled)]


def _is_open(report: StateReport) -> bool:
    return not report.flags & _ENABLED and report.state == _ACTIVE


def shown(position: Sequence[float]) -> str:
    """Return a pose as text."""
    return ", ".join(f"{part * 1e3:.2f}" for part in position) + " (mm, mrad)"


def _listed(values: Sequence[float], form: str) -> str:
    return ", ".join(f"{value:{form}}" for value in values)


def late_delay(bears: float, period: float) -> float:
    """Return the delay from which answers are late [s].

    Args:
        bears: Longest delay that the laws bear [s], as `delay_margins` returns it: NaN or infinity if it is not known.
        period: Sample period [s].
    """
    longest = min(_LONGEST, MOST_PERIODS * period)
    known = bears if bears < longest else longest  # which NaN is not
    return max(_BORNE * known, min(known, _SURE))


class DelayGuard:
    """Detector of answers later than the rendered laws bear.

    A single late answer makes no loop unstable, nor do some that are a little late: it takes 48 of the last 64 samples
    beyond what the laws bear, 8 of 16 beyond 1.25 times that, or 3 of 5 beyond three times.

    Args:
        bears: Longest delay from a sample to its answer's effect that the laws bear [s]; see `late_delay`.

    Attributes:
        bears: As given; it may be changed.
    """

    def __init__(self, bears: float) -> None:
        self.bears = bears
        most = max(last for _, last, _ in _RULES)
        self._delays = deque([0.0] * most, maxlen=most)

    def check(self, delay: float) -> str:
        """Add the delay of one sample [s]; return what is wrong, or ""."""
        delays, bears = self._delays, self.bears
        delays.append(delay)
        if delay <= bears:
            return ""
        recent = list(delays)
        for most, last, share in _RULES:
            bound = share * bears
            if delay > bound and (late := sum(one > bound for one in recent[-last:])) >= most:
                return (
                    f"the line is slower than the scene bears: {late} of the last {last} delays are above "
                    f"{bound * 1e3:.2f} ms, the newest {delay * 1e3:.2f} ms"
                )
        return ""


class PowerGuard:
    """Detector of laws that vibrate, or give out energy.

    Torques count as the forces, and angles as the paths, of a body with the axis' moment of inertia at the moving mass.
    Reversals are the smaller of two swings of a force to and fro, summed and forgotten in 0.2 s: whole, and up to 10 N
    of each. Energy is force times path over the last second. All are of the laws alone, without the weight carried.

    Args:
        period: Sample period [s].
    """

    def __init__(self, period: float) -> None:
        self._growth = math.exp(period / _MEMORY)
        self._weight = 1.0  # of a reversal now: it grows where the older ones would shrink
        self._reversals, self._small = [0.0] * 6, [0.0] * 6
        self._turns, self._swings, self._rises = [0.0] * 6, [0.0] * 6, [False] * 6
        self._place: Sequence[float] = ZERO
        self._last: Sequence[float] = ZERO
        span = max(round(_SPAN / period), 1) + 1
        self._sums = deque([0.0] * span, maxlen=span)

    def check(self, position: Sequence[float], force: Sequence[float]) -> str:
        """Add one sample's pose and the laws' answer to it; return what is wrong, or ""."""
        given, rises, swings, most, capped = self._sums[-1], self._rises, self._swings, 0.0, 0.0
        self._weight = weight = self._weight * self._growth
        parts = zip(self._last, force, self._place, position, rises)
        for axis, (before, part, start, end, rose) in enumerate(parts):
            given += before * (end - start)
            if part != before and (part > before) is not rose:
                rises[axis] = not rose
                swing = abs(before - self._turns[axis]) / _SIZES[axis]
                less = swing if swing < swings[axis] else swings[axis]
                self._turns[axis], swings[axis] = before, swing
                self._reversals[axis] = whole = self._reversals[axis] + weight * less
                self._small[axis] = small = self._small[axis] + weight * (less if less < _SWING else _SWING)
                if whole > most:
                    most = whole
                if small > capped:
                    capped = small
        most, capped = most / weight, capped / weight
        self._sums.append(given)
        self._place, self._last = position, force
        if weight > _HEAVY:
            self._reversals, self._small = ([one / weight for one in six] for six in (self._reversals, self._small))
            self._weight = 1.0
        if most > _REVERSALS:
            return f"the laws vibrate: {most:.0f} N of reversals in {_MEMORY:g} s, {_REVERSALS:g} N allowed"
        if capped > _SMALL:
            return (
                f"the laws vibrate: {capped:.0f} N of reversals of at most {_SWING:g} N each in {_MEMORY:g} s, "
                f"{_SMALL:g} N allowed"
            )
        if (out := given - self._sums[0]) > _ENERGY:
            return f"the laws give out energy: {out * 1e3:.0f} mJ in {_SPAN:g} s, {_ENERGY * 1e3:g} mJ allowed"
        return ""
