"""Guards of a flight: one list with one signature, from a sample to an alarm or nothing.

An alarm without a fault lands the flotor; how a fault ends the flight stands in `ENDINGS` alone.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from functools import partial
from typing import NamedTuple, TypeAlias

from maglev_mj.bridge.connection import SampleCounter
from maglev_mj.bridge.safety import WARNING_RISE, CoilGuard, FlotorGuard, HostLimits, Limits, SpotGuard, reading_fault
from maglev_mj.bridge.wire import Ending, Fault, Flag, State, StateReport, ending_of
from maglev_mj.device import published_device
from maglev_mj.errors import SensingError
from maglev_mj.frames import ZERO
from maglev_mj.result import number_text
from maglev_mj.scale import Scale
from maglev_mj.spec import INERTIA, MAX_DELAY_PERIODS

_DELAY_SHARE = 0.8
"""Delay limit as a share of the critical delay: near the critical delay a loop rings long after a tap."""
_FULL_SHARE = 0.005
"""Critical delay up to which the limit is the critical delay itself [s]: a share would stop usual delays.

Both are counted from the device's own delay, which does not change: a share of the sum could be below it.
"""
_LONGEST = 0.03
"""Longest delay for which margins are computed [s]."""
_RULES = (3, 5, 3.0), (8, 16, 1.25), (48, 64, 1.0)
"""Late answers, window, and factor on the delay limit.

A busy machine exceeds the limit slightly for 0.1 s, and there a loop diverges slowly.
"""
_HELD = 2.0
"""Periods without an answer after which a device may hold."""
_MEMORY = 0.2
"""Time constant of the sums of reversals [s]."""
_FORGOTTEN = 1.0
"""Time constant of the decay of generated energy [s]."""
_HEAVY = 1e9

_ACTIVE, _ENABLED, _HOLDING = State.ACTIVE.value, Flag.ENABLED.value, Flag.HOLDING.value  # faster than enum members


class DeviceSample(NamedTuple):
    """Input of the guards: one sample of a device.

    Attributes:
        report: Device's report.
        before: Report of the previous sample; None for the first.
        samples: Counter of samples, up to this one.
        active: True if this host has switched the currents on.
        guided: True unless a scene is rendered; the larger of the device's own and the chosen envelope then applies.
        pose: Measured pose [m, rad], six; NaN if no pose matches the spots.
        error: Error of the pose measurement; None without.
        since: Time since the last pose [s].
        expected: Currents that should flow [A], six; None if not available.
        modelled: Temperature rises computed from the sent currents, six; 1 trips.
        reversed: True if the measured pose moves against the commands; see `Residual`.
        force: Force of the limited command that is about to be sent [N, N m], six; None before it is known.
    """

    report: StateReport
    before: StateReport | None
    samples: SampleCounter
    active: bool
    guided: bool
    pose: Sequence[float]
    error: SensingError | None
    since: float
    expected: Sequence[float] | None
    modelled: Sequence[float]
    reversed: bool
    force: Sequence[float] | None = None


class Alarm(NamedTuple):
    """Result of a failed guard.

    Attributes:
        faults: The faults; none to land.
        message: Message of one line.
        removes_walls: True if walls on the device are removed before a controlled stop, which would keep them: they act
            on a pose that is wrong.
    """

    faults: Fault
    message: str
    removes_walls: bool = False

    @property
    def ending(self) -> Ending:
        """How it ends a flight."""
        return ending_of(self.faults)


def landing(message: str) -> Alarm | None:
    """Return the alarm that lands the flotor for a message; None without one."""
    return Alarm(Fault(0), message) if message else None


class When(Enum):
    """Times at which guards are asked."""

    SAMPLED = "a sample has arrived"
    COMMANDED = "its answer is known, and not yet sent"
    ANSWERED = "its answer is sent"


Guard: TypeAlias = tuple[When, Callable[[DeviceSample], Alarm | None]]
"""When to check a sample of a device, and the check; it returns an alarm or None."""


def device_guards(limits: Limits, own: HostLimits, period: float, scale: Scale) -> list[Guard]:
    """Return the guards of a device in order of priority: the first alarm names the fault.

    Args:
        limits: The smaller of the device's and the host's limits.
        own: Limits of the host.
        period: Sample period [s].
        scale: Scale of the device.
    """
    checks: list[Callable[[DeviceSample], Alarm | None]] = [
        partial(_spots, SpotGuard(limits, period)),
        partial(_readings, limits),
        _pose,
        _response,
        partial(_envelope, FlotorGuard(own, scale)),
        partial(_currents, CoilGuard(limits)),
        partial(_holding, 1e6 * _HELD * period),
        _enabled,
        _clock,
        _Temperatures(),
    ]
    return [(When.SAMPLED, check) for check in checks]


def _spots(guard: SpotGuard, sample: DeviceSample) -> Alarm | None:
    report = sample.report
    if not (fault := guard.check(report.spots, report.valid, report.conversions, sample.samples.elapsed)):
        return None
    spots = ", ".join(f"{spot * 1e3:.3f}" for spot in report.spots)
    return Alarm(fault, f"spots {spots} mm, valid {report.valid:03b}, conversion {report.conversions}")


def _readings(limits: Limits, sample: DeviceSample) -> Alarm | None:
    readings = sample.report.currents, sample.report.temperatures
    if not (fault := reading_fault(limits, *readings)):
        return None
    return Alarm(fault, "measured currents {} A, temperatures {}".format(*(_listed(six, ".3g") for six in readings)))


def _pose(sample: DeviceSample) -> Alarm | None:
    return None if sample.error is None else Alarm(Fault.SENSOR_OUT_OF_RANGE, str(sample.error))


def _response(sample: DeviceSample) -> Alarm | None:
    if not (sample.active and sample.reversed):
        return None
    return Alarm(Fault.NOT_FOLLOWING, f"the measured pose moves against the commanded force, at {shown(sample.pose)}")


def _envelope(guard: FlotorGuard, sample: DeviceSample) -> Alarm | None:
    if sample.error is not None or not (fault := guard.check(sample.pose, sample.since, sample.guided)):
        return None
    return Alarm(fault, f"the flotor is at {shown(sample.pose)}")


def _currents(guard: CoilGuard, sample: DeviceSample) -> Alarm | None:
    measured = sample.report.currents
    expected = sample.expected if sample.active else None
    if not (fault := guard.check(expected, measured)) or expected is None:
        return None
    return Alarm(fault, f"measured currents {_listed(measured, '.2f')} A, commanded {_listed(expected, '.2f')} A")


def _holding(recent: float, sample: DeviceSample) -> Alarm | None:
    """Check that a device whose newest answer is younger than `recent` [µs] is not HOLDING."""
    report = sample.report
    if not (sample.active and report.flags & _HOLDING and report.age < recent):
        return None
    return Alarm(Fault.HOST, f"the device reports HOLDING, but its newest answer is only {report.age} µs old")


def _enabled(sample: DeviceSample) -> Alarm | None:
    """Check that two samples in a row are not without ENABLED: the first may be from before arming."""
    if not (sample.active and _is_open(sample.report) and sample.before is not None and _is_open(sample.before)):
        return None
    return Alarm(Fault.HOST, "amplifiers not ENABLED, but the device has not cut the currents")


def _clock(sample: DeviceSample) -> Alarm | None:
    message = sample.samples.out_of_step
    return Alarm(Fault.CLOCK, message) if message and sample.active else None


class _Temperatures:
    """Check of the coil temperatures; warns once."""

    _warned = False

    def __call__(self, sample: DeviceSample) -> Alarm | None:
        if not sample.active or max(*sample.report.temperatures, *sample.modelled) < WARNING_RISE:
            return None
        rises = list(map(max, sample.report.temperatures, sample.modelled))
        if (warmest := max(rises)) >= 1.0:
            return Alarm(Fault.COIL_OVERTEMP, f"coil {rises.index(warmest)} reached its temperature limit")
        if not self._warned:
            self._warned = True
            warnings.warn(f"coil temperature at {100.0 * warmest:.0f} % of its limit", stacklevel=3)
        return None


def _is_open(report: StateReport) -> bool:
    return not report.flags & _ENABLED and report.state == _ACTIVE


def shown(position: Sequence[float]) -> str:
    """Return a pose as text."""
    return ", ".join(f"{part * 1e3:.2f}" for part in position) + " (mm, mrad)"


def _listed(values: Sequence[float], form: str) -> str:
    return ", ".join(f"{value:{form}}" for value in values)


def delay_limit(critical_delay: float, period: float, own: float = 0.0) -> float:
    """Return the delay limit of the `DelayGuard` [s].

    Args:
        critical_delay: Critical delay of the laws [s], as of `Verdict.critical_delay`; NaN if not computed.
        period: Sample period [s].
        own: Delay without link and host [s].
    """
    longest = min(_LONGEST, MAX_DELAY_PERIODS * period)
    critical = (critical_delay if critical_delay < longest else longest) - own  # also for NaN
    return own + max(_DELAY_SHARE * critical, min(critical, _FULL_SHARE))


class DelayGuard:
    """Detector of a loop delay above the limit of the rendered laws.

    Single late answers do not destabilise a loop. The guard trips at 48 of the last 64 samples above the limit, 8 of 16
    above 1.25 times the limit, or 3 of 5 above three times the limit.

    Args:
        limit: Delay limit, from a sample to its answer's effect [s]; see `delay_limit`.

    Attributes:
        limit: The delay limit [s]; may be changed.
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        longest = max(window for _, window, _ in _RULES)
        self._delays = deque([0.0] * longest, maxlen=longest)

    def check(self, delay: float) -> str:
        """Add the delay of one sample [s]; return an error message, or ""."""
        delays, limit = self._delays, self.limit
        delays.append(delay)
        if delay <= limit:
            return ""
        recent = list(delays)
        for threshold, window, factor in _RULES:
            bound = factor * limit
            if delay > bound and (count := sum(x > bound for x in recent[-window:])) >= threshold:
                above = f"{count} of the last {window} delays above {bound * 1e3:.2f} ms"
                return f"loop delay too long for the scene: {above}, newest {delay * 1e3:.2f} ms"
        return ""


class PowerGuard:
    """Detector of vibration and of energy generated by the laws.

    Rotations are converted to forces and paths by their radius of gyration. A reversal is the smaller of two successive
    opposite swings of an axis' force. Two sums decay with 0.2 s: of reversals, and of capped reversals: a tap is a few
    large ones, weak vibration is many small ones. Laws may return the energy, force times path, that a hand has put
    in. The path within the next period is predicted from the force alone, as no hand is needed to move the flotor.
    Weight compensation is excluded.

    Args:
        period: Sample period [s].
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], six.
        scale: Scale of the device: the limits; that of the published joystick for a device without coils.
    """

    def __init__(self, period: float, inertia: Sequence[float] = INERTIA, scale: Scale | None = None) -> None:
        scale = scale or published_device().scale
        self._cap, self._limits = scale.cap, (scale.reversals, scale.capped, scale.stored, -scale.generated)
        self._sizes = [math.sqrt(part / inertia[0]) for part in inertia]  # radii of gyration [m], 1 for translations
        self._growth = math.exp(period / _MEMORY)
        self._weight = 1.0  # of a new reversal: grows instead of decaying the older ones
        self._reversals, self._small = [0.0] * 6, [0.0] * 6
        self._turns, self._swings, self._rises = [0.0] * 6, [0.0] * 6, [False] * 6
        self._position: Sequence[float] | None = None
        self._force: Sequence[float] = ZERO
        self._forget = math.exp(-period / _FORGOTTEN)
        self._stored = 0.0  # [J]; below 0 generated
        self._moved = [0.5 * period**2 / part for part in inertia]  # path per force within a period, from rest

    def check(self, position: Sequence[float], force: Sequence[float]) -> str:
        """Add one sample's pose and the laws' force; return an error message, or ""."""
        energy, coming, rises, swings, most, capped, cap = 0.0, 0.0, self._rises, self._swings, 0.0, 0.0, self._cap
        self._weight = weight = self._weight * self._growth
        parts = zip(self._force, force, self._position or position, position, rises, self._moved)
        for axis, (before, part, start, end, rose, moved) in enumerate(parts):
            energy += before * (end - start)
            coming += part * (end - start + part * moved)
            if part != before and (part > before) is not rose:
                rises[axis] = not rose
                swing = abs(before - self._turns[axis]) / self._sizes[axis]
                reversal = swing if swing < swings[axis] else swings[axis]
                self._turns[axis], swings[axis] = before, swing
                self._reversals[axis] = total = self._reversals[axis] + weight * reversal
                self._small[axis] = small = self._small[axis] + weight * (reversal if reversal < cap else cap)
                if total > most:
                    most = total
                if small > capped:
                    capped = small
        most, capped, (strong, weak, free, least) = most / weight, capped / weight, self._limits
        stored = self._stored - energy
        if stored < 0.0:
            stored *= self._forget
        elif stored > free:  # a tap, given back at once
            stored = free + (stored - free) / self._growth
        self._stored = stored
        self._position, self._force = position, force
        if weight > _HEAVY:
            self._reversals, self._small = ([x / weight for x in six] for six in (self._reversals, self._small))
            self._weight = 1.0
        if most > strong:
            return _vibration(most, "force reversals", strong)
        if capped > weak:
            return _vibration(capped, f"force reversals capped at {number_text(cap, 3)} N each", weak)
        if coming > 0.0:
            stored -= coming
        if stored < least:
            excess, limit = number_text(-1e3 * stored, 3), number_text(-1e3 * least, 3)
            return f"the laws generate energy: {excess} mJ more than they absorbed, limit {limit} mJ"
        return ""


def _vibration(total: float, reversals: str, limit: float) -> str:
    total_text, limit_text = number_text(total, 3), number_text(limit, 3)
    return f"the laws vibrate: {total_text} N of {reversals} in {_MEMORY:g} s, limit {limit_text} N"
