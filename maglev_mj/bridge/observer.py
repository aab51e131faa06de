"""Observer of the hand's wrench and of the residual of a flight; calibration as found in takeoff."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.residual import Residual, Sums
from maglev_mj.control.timeline import Timeline, Timing
from maglev_mj.frames import ZERO, Array, Command
from maglev_mj.plants.coils import wrench_of

_CORNER_FREQUENCY = 31.0
"""Corner of each of two cascaded low-pass filters [Hz]; -3 dB at 20 Hz together.

Higher, the noise of the second difference of the pose grows with its square; lower, the force of a hand is late.
"""

# -- fit of the path in takeoff
_LEAST_SAMPLES_OF_FIT = 8
"""Fewest samples after liftoff: 36 equations beside the drift for seven unknowns; four samples would just do."""
_MOST_SAMPLES_OF_FIT = 60
"""Samples above which every n-th one is fitted, so that effort is bounded: the projection is (N, N)."""
_TIME_PER_ORDER = 0.2
"""Time per order of the polynomial that is projected out [s].

With jitter the integrated currents drift: a longer time makes faulty coils of that, a shorter one hides the causes.
"""
_LARGEST_GAIN_ERROR = 0.02
"""Largest standard error of a gain that is reported: three of them are below `_LEAST_ERROR_OF_CAUSE`."""
_LARGEST_DELAY_ERROR = 2e-4
"""Largest standard error of the sensor's delay that is reported [s]: 0.4 of the least delay acted on at 1 kHz."""
LATE = 0.5
"""Smallest delay of a sensor that is acted on, in sample periods: above its uncertainty over a jittery line."""

# -- causes of a path
_LEAST_ERROR_OF_CAUSE = 0.07
"""Least error of a coil's gain, of the mass and of the inertia that is not as calibrated; see flight_safety.md."""
_MOST_CAUSES = 3
"""Most causes of a path: with more, any path has an explanation."""
_MOST_LEFT_BY_CAUSE = 0.4
"""Largest share of the squared error that one more cause leaves; a larger one would name causes that explain little."""
_EXPLAINED_ERROR = 0.25
"""Root mean square error of a path that is explained, in noises.

In tests/bridge/test_takeoff_causes.py a calibrated flotor left 0.13, a coil 9 % too weak 1.5.
"""
_LEAST_ROTATION_BY_COIL = 500.0
"""Least rotation on the stop that shows a coil, in noises: six coils, all too weak to lift, rotated it by 1.3."""
_CAUSE_NAMES = [*(f"coil {coil}" for coil in range(6)), "delay", "mass", "inertia"]

UNKNOWN: Sequence[float] = (math.nan,) * 6  # pose or wrench that is not available
_MOST_LOST = 64
"""Samples whose answers are kept, and most that may be lost in a row: 64 ms at 1 kHz, the watchdog ends at 50 ms."""

_Drive: TypeAlias = tuple[Sequence[float], Sequence[float], Sequence[float]]
"""Wrench, currents, and the wrench of the probe in it, six numbers each."""

_NO_DRIVE: _Drive = ZERO, ZERO, ZERO


class HandObserver:
    """Observer of the external wrench: inertia times acceleration, minus coil wrench and weight.

    It is the hand's if the flotor touches nothing else. The mean force around a sample, with triangular weights over
    two periods, follows exactly from three positions and the currents between them; it is low-passed at 20 Hz and
    available one period later.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].
        delay: Time from an answer's arrival to its effect [s].
        age: Mean age of the currents of walls on the device at a sample [s].
        seed: Seed of the signs of a probe.

    Attributes:
        currents: Currents that should flow at the last sample [A], six; None if the newest answer is not reported, an
            overtaken one may be in effect, or walls stand on the device: it compares their currents itself.
        wrench: Estimate at the previous sample [N, N m], six; NaN if not available, held across lost samples.
        coils: Estimator of the calibration; updated while `check_coils` is True.
        check_coils: True in takeoff.
        residual: What the currents do not explain, and its causes.
        measured: Measured currents at the next sample to add [A], six, while walls stand on the device; else None.
            Their difference from the sent ones is due to the walls.
    """

    measured: Sequence[float] | None = None

    def __init__(self, calibration: Calibration, period: float, delay: float, age: float = 0.0, seed: int = 0) -> None:
        self._period, self._delay, self._split, self._seed = period, delay, 0.5 * period - age, seed
        self._keep = math.exp(-2.0 * math.pi * _CORNER_FREQUENCY * period)
        self._calibration = calibration
        self._body = [inertia / period**2 for inertia in calibration.body.inertia.tolist()]
        self._weight = calibration.body.load.tolist()
        self.check_coils = False
        self.residual = Residual(calibration, period, delay, seed)
        self.reset()

    def reset(self) -> None:
        """Clear all state; the wrench is NaN for the next three samples."""
        self.wrench = self._low = UNKNOWN  # the estimate, and its first stage
        self.currents: Sequence[float] | None = None
        self.coils = CoilEstimator(self._calibration, self._period)
        self.residual.reset()
        self._timeline = Timeline(Timing(period=self._period, delay=0.0), _NO_DRIVE)
        self._sent: list[tuple[int | None, tuple[_Drive, _Drive, float] | None]] = [(None, None)] * _MOST_LOST
        self._added = _NO_DRIVE  # by walls on the device, at the last sample
        self._answered, self._valid_from = 0, 0.0  # newest answer; time after which no earlier one is in effect [s]
        self._poses: tuple[Sequence[float], Sequence[float]] = UNKNOWN, UNKNOWN  # the last two
        self._rising: tuple[Sums, Sums] = _NO_SUMS, _NO_SUMS  # of wrench and currents, in the last period

    def weigh(self, calibration: Calibration) -> None:
        """Continue with another mass and inertia."""
        self._calibration = calibration
        self._body = [inertia / self._period**2 for inertia in calibration.body.inertia.tolist()]
        self._weight = calibration.body.load.tolist()
        self.residual = Residual(calibration, self._period, self._delay, self._seed)

    def answered(
        self,
        tick: int,
        command: Command,
        held: Sequence[float],
        pulsed: Sequence[float] | None,
        width: float,
        probe: Sequence[float] = ZERO,
    ) -> None:
        """Add the answer sent to a sample.

        Args:
            tick: Number of the sample.
            command: The limited command.
            held: Held currents [A], six.
            pulsed: Pulsed currents [A], six; None without a pulse.
            width: Pulse width [s].
            probe: Wrench of the probe, included in the others [N, N m], six.
        """
        first = drive = tuple(command.force), tuple(held), probe
        if pulsed is not None and command.extra is not None:
            first = tuple([x + dx for x, dx in zip(command.force, command.extra)]), tuple(pulsed), probe
        self._sent[tick % _MOST_LOST] = tick, (drive, first, width)

    def sampled(self, tick: int, elapsed: int, position: Sequence[float], answered: int, delay: float) -> None:
        """Add a sample.

        Args:
            tick: Number of the sample.
            elapsed: Sample periods since the last one.
            position: Measured pose [m, rad], six.
            answered: Number of the sample answered by the newest command in effect.
            delay: Time from that sample to the command's effect [s]; NaN without a new command.
        """
        timeline, period, last = self._timeline, self._period, max(tick - elapsed, tick - _MOST_LOST)
        number, sent = self._sent[answered % _MOST_LOST]
        if delay != delay or number != answered:
            sent = None
        else:
            if answered - self._answered > 1:  # of two answers within one period the device reports the newer
                self._valid_from = answered * period + delay
                self._overtaken(answered, last * period + self._delay)
            self._answered = answered
        certain = sent is not None and tick * period >= self._valid_from
        if sent is not None and answered != tick - 1:  # effects before the last sample are already applied
            timeline.answer(answered, *sent, after=max(delay, (last - answered) * period))
            sent = None
        if elapsed > _MOST_LOST:
            self.coils = CoilEstimator(self._calibration, period)
        for missed in range(last, tick - 1):
            self._add(UNKNOWN, timeline.period(missed))
        intervals = timeline.period(tick - 1, sent, after=delay if delay > 0.0 else 0.0)
        before, self._added = self._added, _NO_DRIVE
        if self.measured is not None:
            added = tuple([x - y for x, y in zip(self.measured, timeline.now()[1])])
            turned = self._calibration.coils.inverse_at_angle(*position[3:])
            self._added, split = (tuple(wrench_of(turned, np.array(added)).tolist()), added, ZERO), self._split
            # superposed, from the start of the period again: the last reading up to halfway less its age, then this one
            intervals = [*intervals, (-period, _NO_DRIVE), (split, before), (period - split, self._added)]
        self._add(position, intervals)
        self.currents = timeline.now()[1] if certain and self.measured is None else None

    def _overtaken(self, answered: int, earliest: float) -> None:
        """Assume that answers that are not reported took effect evenly spaced from `earliest` [s] to the newest."""
        first, span = self._answered, answered - self._answered
        for tick in range(max(first + 1, answered - _MOST_LOST + 1), answered):
            number, sent = self._sent[tick % _MOST_LOST]
            if number == tick and sent is not None:
                effect = earliest + (tick - first) / span * (self._valid_from - earliest)
                self._timeline.answer(tick, *sent, after=effect - tick * self._period)

    def _add(self, now: Sequence[float], intervals: Sequence[tuple[float, _Drive]]) -> None:
        """Add a pose, NaN if lost, and the drives in the period before it."""
        period, keep, driven = self._period, self._keep, _sums(intervals, 0)
        (before, last), self._poses = self._poses, (self._poses[1], now)
        (rising, flowing), self._rising = self._rising, (driven, _NO_SUMS)
        self.residual.add(now, driven, _sums(intervals, 2))
        if self.check_coils:
            flowed = _sums(intervals, 1)
            self._rising = driven, flowed
            self.coils.add(now, _between(flowing, flowed, period))
        if math.isnan(before[0] + last[0] + now[0]):
            return
        explained = _between(rising, driven, period)
        raw = [
            mass * (x - 2.0 * x1 + x2) - force - weight
            for mass, x, x1, x2, force, weight in zip(self._body, now, last, before, explained, self._weight)
        ]
        if self._low is UNKNOWN:
            self._low = self.wrench = raw
        self._low = [new + keep * (old - new) for new, old in zip(raw, self._low)]
        self.wrench = [new + keep * (old - new) for new, old in zip(self._low, self.wrench)]


_NO_SUMS: Sums = ZERO, ZERO


def _sums(intervals: Sequence[tuple[float, _Drive]], part: int) -> Sums:
    """Return the integral of a part of the drive over a period, and that of time times it, six each."""
    impulse: Sequence[float] = ZERO
    moment: Sequence[float] = ZERO
    start = 0.0
    for duration, drive in intervals:
        if (values := drive[part]) is not ZERO:
            middle = (start + 0.5 * duration) * duration
            impulse = [p + duration * x for p, x in zip(impulse, values)]
            moment = [q + middle * x for q, x in zip(moment, values)]
        start += duration
    return impulse, moment


def _between(before: Sums, now: Sums, period: float) -> list[float]:
    """Return the mean drive around the sample between two periods, with triangular weights."""
    square = period**2
    return [(rising + period * p - q) / square for rising, p, q in zip(before[1], *now)]


class CoilEstimator:
    """Estimator of coil gains, sensor delay, mass and inertia from a motion without a hand.

    Least squares: the path computed from the currents by double integration is fitted to the measured path, after
    liftoff. A gain is identifiable if the coil carried current. Of all causes the fewest that explain the path count: a
    weight on the handle is a weight, not two coils.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].

    Attributes:
        sensor_delay: Delay of the sensor at the last call of `fault` [s]; NaN if not identifiable.
        mass: Mass relative to the calibrated one at that call; 1 within 7 %.
        inertia: Moments of inertia, the same.
    """

    sensor_delay = math.nan
    mass = inertia = 1.0

    def __init__(self, calibration: Calibration, period: float) -> None:
        self._period, self._scale = period, calibration.device.scale
        self._paths = calibration.coils.wrench_per_current * (period**2 / calibration.body.inertia)[:, None]
        self._fall = np.concatenate([period**2 * calibration.gravity, np.zeros(3)])
        self._rows: list[tuple[float, ...]] = []

    def add(self, position: Sequence[float], currents: Sequence[float]) -> None:
        """Add a pose and the currents around the sample before it [m, rad], [A], six each."""
        self._rows.append((*position, *currents, 1.0))

    def _summed(self) -> Array:
        """Return poses that were measured, currents and ones integrated twice, both once, and times [s], (N, 21)."""
        rows = np.array(self._rows).reshape(-1, 13)
        once = rows[:, 6:].cumsum(axis=0)
        rows = np.column_stack([rows[:, :6], once.cumsum(axis=0), once, self._period * np.arange(len(rows))])
        measured: Array = rows[np.isfinite(rows[:, 0])]
        return measured

    def _flown(self) -> Array | None:
        """Return the rows of `_summed` after liftoff; None if too few."""
        rows = self._summed()
        lifted = np.flatnonzero(np.abs(rows[:, :3] - rows[:1, :3]).max(axis=1, initial=0.0) > self._scale.lifted)
        return rows[lifted[0] :] if lifted.size and len(rows) - lifted[0] >= _LEAST_SAMPLES_OF_FIT else None

    def estimate(self) -> tuple[Array, float]:
        """Return the coil gains relative to the calibration, (6,), and the sensor's delay [s]; NaN if uncertain."""
        rows = self._flown()
        if rows is None:
            return np.full(6, np.nan), math.nan
        matrix, residual = self._fit(rows, range(6))
        changes = np.linalg.lstsq(matrix, residual, rcond=None)[0]
        errors = self._scale.noise * np.sqrt(np.diag(np.linalg.pinv(matrix.T @ matrix)))
        *gains, delay = np.where(errors < [_LARGEST_GAIN_ERROR] * 6 + [_LARGEST_DELAY_ERROR], changes, np.nan)
        return 1.0 + np.array(gains), float(delay)

    def causes(self) -> dict[str, float]:
        """Return the fewest causes that explain the path, and their sizes; {} if it is as calibrated, or too short.

        Relative changes of a coil's gain ("coil 0"), of 1 / mass and of 1 / inertia; the sensor's delay [s]. The cause
        that leaves least is added, at most three times, while it leaves at most 40 % of the squared error.
        """
        rows = self._flown()
        if rows is None:
            return {}
        matrix, residual = self._fit(rows, range(6))
        common = matrix[:, :6].sum(axis=1).reshape(6, -1)
        scaled = [(common * np.repeat(axes, 3)[:, None]).ravel() for axes in ([1.0, 0.0], [0.0, 1.0])]
        columns = np.column_stack([matrix, *scaled])
        chosen: list[int] = []
        sizes, left = np.zeros(0), residual
        explained = (_EXPLAINED_ERROR * self._scale.noise) ** 2 * len(residual)
        while len(chosen) < _MOST_CAUSES and float(left @ left) > explained:
            tries = []
            for k in set(range(columns.shape[1])) - set(chosen):
                part = columns[:, [*chosen, k]]
                values = np.linalg.lstsq(part, residual, rcond=None)[0]
                rest = residual - part @ values
                tries.append((float(rest @ rest), k, values, rest))
            least, best, values, rest = min(tries, key=lambda each: each[0])
            if least > _MOST_LEFT_BY_CAUSE * float(left @ left):
                break
            chosen.append(best)
            sizes, left = values, rest
        return {_CAUSE_NAMES[k]: float(size) for k, size in zip(chosen, sizes)}

    def fault(self, lost: bool = False) -> str:
        """Return a message about coils that are not as calibrated; "" if all are. Stores delay, mass and inertia.

        Args:
            lost: True if the flotor does not follow: if no faulty gain is identified, name the most likely cause.
        """
        causes, (_, self.sensor_delay) = self.causes(), self.estimate()
        large = {name: size for name, size in causes.items() if abs(size) > _LEAST_ERROR_OF_CAUSE and name != "delay"}
        self.mass, self.inertia = (1.0 / max(1.0 + large.pop(name, 0.0), 0.05) for name in ("mass", "inertia"))
        if large:
            return ", ".join(
                f"{name} gives {100.0 * (1.0 + large[name]):.0f} % of its calibrated force" for name in sorted(large)
            )
        if not lost or len(self._rows) < 3:
            return ""
        if self.sensor_delay > LATE * self._period:
            return f"the sensor is delayed by {self.sensor_delay * 1e3:.1f} ms"
        if text := self.weight:
            return text
        # on its stop the flotor can still rotate
        matrix, path = self._fit(self._summed(), range(3, 6))
        matrix = matrix[:, :6]
        sizes = (matrix**2).sum(axis=0) + self._scale.noise**2
        shown = (matrix.T @ path) ** 2 / sizes
        if float(shown.max()) < (_LEAST_ROTATION_BY_COIL * self._scale.noise * self._scale.lever) ** 2:
            return "it does not lift off: the weight, the currents, the forces or the sensor are not as calibrated"
        return f"coil {int(np.argmax(shown))} is the most likely cause: weak, dead or reversed"

    @property
    def weight(self) -> str:
        """Message about mass and inertia that differ from the calibration at the last call of `fault`; "" without."""
        found = ("mass", self.mass), ("inertia", self.inertia)
        text = " and ".join(f"{ratio:.2f} times the calibrated {name}" for name, ratio in found if ratio != 1.0)
        return text and f"the flotor has {text}"

    def _fit(self, rows: Array, axes: Sequence[int]) -> tuple[Array, Array]:
        """Return the Jacobian of the path on some axes to gains and delay, (N, 7), and the residual path."""
        rows = rows[:: max(len(rows) // _MOST_SAMPLES_OF_FIT, 1)]
        time = rows[:, 20] - rows[:, 20].mean()
        # initial position and speed; integrated errors
        drift = np.vander(time, 2 + int(np.ptp(time) / _TIME_PER_ORDER))
        project = np.eye(len(rows)) - drift @ np.linalg.pinv(drift)
        parts, paths = [], []
        for axis in axes:
            scaled = (1.0 if axis < 3 else self._scale.lever) * project
            coils, fall = self._paths[axis], self._fall[axis]
            speed = (rows[:, 13:19] @ coils + fall * rows[:, 19]) / self._period
            parts.append(scaled @ np.column_stack([rows[:, 6:12] * coils, -speed]))
            paths.append(scaled @ (rows[:, axis] - fall * rows[:, 12]))
        matrix = np.vstack(parts)
        return matrix, np.concatenate(paths) - matrix[:, :6].sum(axis=1)
