"""Observer of the hand's wrench; delay of the sensor; coils that do not act as calibrated."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import median
from typing import TypeAlias

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.control.timeline import Timeline, Timing
from maglev_mj.frames import ZERO, Array, Command
from maglev_mj.plants.coils import wrench_of

_CORNER = 31.0
"""Corner of each of two cascaded low-pass filters [Hz]; -3 dB at 20 Hz together."""

_FEWEST, _MOST = 8, 60
"""Fewest samples after liftoff, and most that are fitted."""

_CERTAIN, _PROMPT = 0.02, 2e-4
"""Largest standard errors of a gain and of the sensor's delay [s]."""

LATE = 0.5
"""Smallest delay of a sensor that is acted on, in sample periods: above its uncertainty over a jittery line."""

_FAULTY, _RELATIVE = 0.07, 0.2
"""Gain error of a faulty coil, absolute and relative to the largest error."""

_STEP, _LAGS, _WINDOW = 0.002, 5, 0.05
"""Smallest step of a delay in flight [s], number of steps, and time constant of the sums [s]."""

_EXCITED, _LARGEST, _STILL, _EXPLAINED = 1.0, 0.6, 0.04, 0.25
"""Least sum of squared changes that tells a delay in flight [m²/s⁴], most and least of a change; largest share left."""

_REVERSED = 2.0
"""The same least sum for a reversed motion: few changes of a delayed pose look reversed [m²/s⁴]."""

_FREE = _LARGEST, _EXCITED, _EXPLAINED, math.inf, _EXPLAINED
_WALLED = 5.0, 0.25, 0.25, 6.0, 0.45
"""Bounds while walls stand on the device: largest square; least sum and largest share left; the same, if much moved.

A delayed wall grows within 50 ms from noise to 0.3 m/s, and at 200 Hz 3 ms of delay leave (2 ms / 3 ms)² with 5 ms.
"""

_DRIFT = 0.2
"""Time per order of the polynomial that is projected out [s]: with jitter, the integrated currents drift."""

_COIL_STEP, _COMPARED, _BETWEEN, _EVERY = 0.005, 2, 3, 2
"""Step of the check of the coils in flight [s]; steps that are compared, between them, and from check to check."""

_LOSSES, _UNSURE, _REST = (1.0, 2.0), 0.1, 0.005
"""Loss of gain of a dead and a reversed coil; tolerance; largest share left of the squared change."""

UNKNOWN: Sequence[float] = (math.nan,) * 6  # pose or wrench that is not available
_BUFFER = 64


_Drive: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]
"""Wrench and currents, six numbers each."""

_NONE: _Drive = ZERO, ZERO

_Sampled: TypeAlias = tuple[Sequence[float], list[tuple[float, _Drive]]]
"""One sample: pose, NaN if lost, and drives in the period before."""


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

    Attributes:
        currents: Currents that should flow at the last sample [A], six; None if the newest answer is not reported, an
            overtaken one may be in effect, or walls stand on the device: it compares their currents itself.
        coils: Estimator of the coil gains; updated while `check_coils` is True.
        check_coils: True in takeoff.
        sensor: Estimator of the sensor's delay in flight.
        failing: Detector of a coil that fails in flight.
        measured: Measured currents at the next sample to add [A], six, while walls stand on the device; else None.
            Their difference from the sent ones is due to the walls.
    """

    measured: Sequence[float] | None = None

    def __init__(self, calibration: Calibration, period: float, delay: float, age: float = 0.0) -> None:
        self._period, self._delay, self._split = period, delay, 0.5 * period - age
        self._keep = math.exp(-2.0 * math.pi * _CORNER * period)
        self._calibration = calibration
        self._body = [inertia / period**2 for inertia in calibration.body.inertia.tolist()]
        self._weight = calibration.body.load.tolist()
        self.check_coils = False
        self.reset()

    def reset(self) -> None:
        """Clear all state; the wrench is NaN for the next three samples."""
        self._wrench = self._low = self._lower = UNKNOWN  # the estimate, and its stages
        self.currents: Sequence[float] | None = None
        self.coils = CoilEstimator(self._calibration, self._period)
        self.sensor = DelayEstimator(self._period, self._calibration.mass)
        self.failing = CoilMonitor(self._calibration, self._period)
        self._timeline = Timeline(Timing(period=self._period, delay=0.0), _NONE)
        self._sent: list[tuple[int | None, tuple[_Drive, _Drive, float] | None]] = [(None, None)] * _BUFFER
        self._pending: deque[_Sampled] = deque(maxlen=_BUFFER)
        self._added = _NONE  # by walls on the device, at the last sample
        self._answered, self._valid_from = 0, 0.0  # newest answer; time after which no earlier one is in effect [s]
        self._poses: tuple[Sequence[float], Sequence[float]] = UNKNOWN, UNKNOWN  # the last two
        self._rising: list[tuple[float, _Drive]] = []

    def answered(
        self, tick: int, command: Command, held: Sequence[float], pulsed: Sequence[float] | None, width: float
    ) -> None:
        """Add the answer sent to a sample.

        Args:
            tick: Number of the sample.
            command: The limited command.
            held: Held currents [A], six.
            pulsed: Pulsed currents [A], six; None without a pulse.
            width: Pulse width [s].
        """
        first = drive = tuple(command.force), tuple(held)
        if pulsed is not None and command.extra is not None:
            first = tuple([x + dx for x, dx in zip(command.force, command.extra)]), tuple(pulsed)
        self._sent[tick % _BUFFER] = tick, (drive, first, width)

    def sampled(self, tick: int, elapsed: int, position: Sequence[float], answered: int, delay: float) -> None:
        """Add a sample.

        Args:
            tick: Number of the sample.
            elapsed: Sample periods since the last one.
            position: Measured pose [m, rad], six.
            answered: Number of the sample answered by the newest command in effect.
            delay: Time from that sample to the command's effect [s]; NaN without a new command.
        """
        timeline, period, last = self._timeline, self._period, max(tick - elapsed, tick - _BUFFER)
        number, sent = self._sent[answered % _BUFFER]
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
        if elapsed > _BUFFER:
            self.coils = CoilEstimator(self._calibration, period)
        for missed in range(last, tick - 1):
            self._pending.append((UNKNOWN, timeline.period(missed)))
            self.failing.add(self._pending[-1])
            self.sensor.add(*self._pending[-1])
        intervals = timeline.period(tick - 1, sent, after=delay if delay > 0.0 else 0.0)
        before, self._added = self._added, _NONE
        self.sensor.bounds = _FREE if self.measured is None else _WALLED
        if self.measured is not None:
            added = tuple([x - y for x, y in zip(self.measured, timeline.now()[1])])
            turned = self._calibration.coils.inverse_at_angle(*position[3:])
            self._added, split = (tuple(wrench_of(turned, np.array(added)).tolist()), added), self._split
            # superposed, from the start of the period again: the last reading up to halfway less its age, then this one
            intervals = [*intervals, (-period, _NONE), (split, before), (period - split, self._added)]
        if len(self._pending) == _BUFFER:  # buffer overflow: `wrench` was not read
            self._low, self._poses = UNKNOWN, (UNKNOWN, UNKNOWN)
        self._pending.append((position, intervals))
        self.failing.add(self._pending[-1])
        self.sensor.add(position, intervals)
        self.currents = timeline.now()[1] if certain and self.measured is None else None
        if self.check_coils:
            self._process()

    def _overtaken(self, answered: int, earliest: float) -> None:
        """Assume that answers that are not reported took effect evenly spaced from `earliest` [s] to the newest."""
        first, span = self._answered, answered - self._answered
        for tick in range(max(first + 1, answered - _BUFFER + 1), answered):
            number, sent = self._sent[tick % _BUFFER]
            if number == tick and sent is not None:
                effect = earliest + (tick - first) / span * (self._valid_from - earliest)
                self._timeline.answer(tick, *sent, after=effect - tick * self._period)

    @property
    def wrench(self) -> Sequence[float]:
        """Estimate at the previous sample [N, N m], six; NaN if not available. Computed on access."""
        self._process()
        return self._wrench

    def _process(self) -> None:
        """Process the pending samples; the estimate is held across lost ones."""
        period, square, keep = self._period, self._period**2, self._keep
        for now, intervals in self._pending:
            acting, start, self._rising = self._rising, 0.0, []
            for duration, drive in intervals:
                middle, share = start + 0.5 * duration, duration / square
                acting.append(((period - middle) * share, drive))
                self._rising.append((middle * share, drive))
                start += duration
            (before, last), self._poses = self._poses, (self._poses[1], now)
            if self.check_coils:
                self.coils.add(now, _mean([(share, currents) for share, (_, currents) in acting]))
            if math.isnan(before[0] + last[0] + now[0]):
                continue
            explained = _mean([(share, wrench) for share, (wrench, _) in acting])
            raw = [
                mass * (x - 2.0 * x1 + x2) - force - weight
                for mass, x, x1, x2, force, weight in zip(self._body, now, last, before, explained, self._weight)
            ]
            if self._low is UNKNOWN:
                self._low = self._lower = raw
            self._low = [new + keep * (old - new) for new, old in zip(raw, self._low)]
            self._wrench = self._lower = [new + keep * (old - new) for new, old in zip(self._low, self._lower)]
        self._pending.clear()


def _mean(parts: Sequence[tuple[float, Sequence[float]]]) -> list[float]:
    """Return the weighted sum of vectors (6,)."""
    total = [0.0] * 6
    for share, vector in parts:
        total = [x + share * y for x, y in zip(total, vector)]
    return total


class DelayEstimator:
    """Estimator of the delay of the measured pose in flight.

    The measured acceleration changes with the commanded one, whatever a slow hand does; that of a delayed pose changes
    with the commanded one of some samples before. Both are low-passed at 31 Hz. The squared differences decay with
    0.05 s; each is bounded, because a blow by a hand or on a stop is a few large ones.

    Args:
        period: Sample period [s].
        mass: Mass of the flotor [kg].

    Attributes:
        delay: Largest delay found [s].
        reversed: True while the pose moves against the commands.
        bounds: `_FREE`, or `_WALLED` while walls stand on the device.
    """

    reversed = False

    def __init__(self, period: float, mass: float) -> None:
        self._period, self._keep = period, math.exp(-2.0 * math.pi * _CORNER * period)
        self._share, self._stride = 1.0 / (mass * period**2), max(1, round(_STEP / period))
        self._decay = math.exp(-self._stride * period / _WINDOW)
        self.delay, self.bounds, self._before, self._last = 0.0, _FREE, UNKNOWN[:3], UNKNOWN[:3]  # last two positions
        self._rising: Sequence[float] = ZERO[:3]  # part of the last period in the next commanded acceleration
        self._restart()

    def _restart(self) -> None:
        self._low = self._marked = UNKNOWN  # accelerations, measured and commanded
        self._left, self._quiet, self._changes = 0, 0, deque([(0.0,) * 4] * (_LAGS + 1), maxlen=_LAGS + 1)
        self._errors = [0.0] * (_LAGS + 3)  # of each delay, without any response, and of a reversed one

    def add(self, position: Sequence[float], intervals: Sequence[tuple[float, _Drive]]) -> None:
        """Add a pose, NaN if lost, and the drives in the period before it."""
        period, start, (u, v, w) = self._period, 0.0, self._rising
        p = q = r = 0.0
        for duration, ((x, y, z, _, _, _), _) in intervals:
            share = duration * self._share
            later = (start + 0.5 * duration) * share
            earlier = period * share - later
            u, v, w = u + earlier * x, v + earlier * y, w + earlier * z
            p, q, r = p + later * x, q + later * y, r + later * z
            start += duration
        self._rising = p, q, r
        (x0, y0, z0), (x1, y1, z1), (x, y, z, _, _, _) = self._before, self._last, position
        self._before, self._last, share, keep = self._last, (x, y, z), period**-2, self._keep
        x, y, z = (x - 2.0 * x1 + x0) * share, (y - 2.0 * y1 + y0) * share, (z - 2.0 * z1 + z0) * share
        a, b, c, d, e, f = self._low
        if a != a or x != x:  # NaN: the first, or lost
            self._restart()
            self._low = self._marked = x, y, z, u, v, w
            return
        self._low = low = (
            *(x + keep * (a - x), y + keep * (b - y), z + keep * (c - z)),
            *(u + keep * (d - u), v + keep * (e - v), w + keep * (f - w)),
        )
        self._left += 1
        if self._left == self._stride:
            self._left = 0
            self._compare(*[new - old for new, old in zip(low, self._marked)])
            self._marked = low

    def _compare(self, x: float, y: float, z: float, u: float, v: float, w: float) -> None:
        """Add changes of the measured and of the commanded acceleration [m/s²]."""
        self.reversed = False
        moved, driven, p, q, r = x * x + y * y + z * z, u * u + v * v + w * w, x - u, y - v, z - w
        self._changes.appendleft((u, v, w, driven))
        self._quiet = self._quiet + 1 if driven < _STILL and p * p + q * q + r * r < _STILL else 0
        if self._quiet > _LAGS:
            self._errors = [0.0] * (_LAGS + 3)
            return
        decay, (largest, excited, explained, strong, share) = self._decay, self.bounds
        squares = [moved + own - 2.0 * (x * a + y * b + z * c) for a, b, c, own in self._changes]
        squares += moved, moved + driven + 2.0 * (x * u + y * v + z * w)
        self._errors = errors = [
            decay * error + (square if square < largest else largest) for error, square in zip(self._errors, squares)
        ]
        excitation = min(errors[0], errors[-2])
        if excitation > excited and (least := min(errors)) < (share if excitation > strong else explained) * excitation:
            if least == errors[-1]:
                # currents of walls are known too roughly
                self.reversed = self.bounds is _FREE and excitation > _REVERSED
            else:
                self.delay = max(self.delay, errors.index(least) * self._stride * self._period)


class CoilEstimator:
    """Estimator of each coil's gain and of the sensor's delay from a motion without a hand.

    Least squares: the path computed from the currents by double integration is fitted to the measured path, after
    liftoff. A gain is identifiable if the coil carried current.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].

    Attributes:
        sensor_delay: Delay of the sensor at the last call of `fault` [s]; NaN if not identifiable.
    """

    sensor_delay = math.nan

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

    def estimate(self) -> tuple[Array, float]:
        """Return the coil gains relative to the calibration, (6,), and the sensor's delay [s]; NaN if uncertain."""
        rows = self._summed()
        lifted = np.flatnonzero(np.abs(rows[:, :3] - rows[:1, :3]).max(axis=1, initial=0.0) > self._scale.lifted)
        if not lifted.size or len(rows) - lifted[0] < _FEWEST:
            return np.full(6, np.nan), math.nan
        matrix, residual = self._fit(rows[lifted[0] :], range(6))
        changes = np.linalg.lstsq(matrix, residual, rcond=None)[0]
        errors = self._scale.noise * np.sqrt(np.diag(np.linalg.pinv(matrix.T @ matrix)))
        *gains, delay = np.where(errors < [_CERTAIN] * 6 + [_PROMPT], changes, np.nan)
        return 1.0 + np.array(gains), float(delay)

    def fault(self, lost: bool = False) -> str:
        """Return a message about coils that are not as calibrated; "" if all are.

        A gain common to all coils is not a coil fault: a weight on the handle has the same effect.

        Args:
            lost: True if the flotor does not follow: if no faulty gain is identified, name the most likely cause.
        """
        gains, self.sensor_delay = self.estimate()
        changes = np.abs(gains - median([gain for gain in gains.tolist() if math.isfinite(gain)] or [1.0]))
        bad = np.flatnonzero(changes > max(_FAULTY, _RELATIVE * np.nan_to_num(changes).max()))
        if bad.size:
            return ", ".join(_gain_text(int(coil), gains[coil]) for coil in bad)
        if not lost or len(self._rows) < 3:
            return ""
        if self.sensor_delay > LATE * self._period:
            return f"the sensor is delayed by {self.sensor_delay * 1e3:.1f} ms"
        # on its stop the flotor can still rotate
        matrix, path = self._fit(self._summed(), range(3, 6))
        matrix = matrix[:, :6]
        sizes = (matrix**2).sum(axis=0) + self._scale.noise**2
        return f"coil {int(np.argmax((matrix.T @ path) ** 2 / sizes))} is the most likely cause: weak, dead or reversed"

    def _fit(self, rows: Array, axes: Sequence[int]) -> tuple[Array, Array]:
        """Return the Jacobian of the path on some axes to gains and delay, (N, 7), and the residual path."""
        rows = rows[:: max(len(rows) // _MOST, 1)]
        time = rows[:, 20] - rows[:, 20].mean()
        drift = np.vander(time, 2 + int(np.ptp(time) / _DRIFT))  # initial position and speed; integrated errors
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


def _gain_text(coil: int, gain: float) -> str:
    return f"coil {coil} gives {100.0 * gain:.0f} % of its calibrated force"


class CoilMonitor:
    """Detector of a coil that stops acting, or acts in reverse, in flight.

    The wrench that the currents do not explain, divided by the wrench per current, is a current of each coil. That of a
    failing coil changes within 25 ms, by its own current times the loss of its gain, and no other does. A hand changes
    several: every force takes at least two coils.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].

    Attributes:
        add: Adds a sample; see `HandObserver.sampled`.
    """

    def __init__(self, calibration: Calibration, period: float) -> None:
        self._stride = stride = max(1, round(_COIL_STEP / period))
        self._step, self._left, steps = stride * period, 0, 2 * _COMPARED + _BETWEEN
        self._centres = self._step * np.arange(1, steps + 1)[:, None]
        self._samples: deque[_Sampled] = deque(maxlen=(steps + 1) * stride + 1)
        self.add = self._samples.append
        to_currents = np.linalg.inv(calibration.coils.wrench_per_current).T
        self._per_change = (calibration.body.inertia / self._step**2)[:, None] * to_currents
        self._least = _COMPARED * calibration.device.scale.least**2

    def fault(self) -> str:
        """Return a message about a coil that fails; "" if none does. Call it after each sample: every 10 ms it checks.

        Second differences of the pose over two steps are compared with the currents between, with triangular weights.
        """
        self._left -= 1
        if self._left > 0 or len(self._samples) < (self._samples.maxlen or 0):
            return ""
        self._left = _EVERY * self._stride
        first, *rest = self._samples
        poses = np.array([first[0], *(position for position, _ in rest[self._stride - 1 :: self._stride])])
        flowed = np.array([(duration, *six) for _, intervals in rest for duration, (_, six) in intervals])
        shares, currents = flowed[:, 0], flowed[:, 1:]
        distances = np.abs(shares.cumsum() - 0.5 * shares - self._centres)
        acting = (np.maximum(1.0 - distances / self._step, 0.0) * shares / self._step) @ currents
        unexplained = np.diff(poses, 2, axis=0) @ self._per_change - acting
        changes = unexplained[-_COMPARED:] - unexplained[:_COMPARED].mean(axis=0)
        squares = (changes**2).sum(axis=0)
        coil, total = int(squares.argmax()), float(squares.sum())
        if not total > self._least:  # also for NaN, of a lost sample
            return ""
        flowing, before = acting[-_COMPARED:, coil], acting[:_COMPARED, coil].mean()
        for driven in (flowing, flowing - before):  # failed between both; or before them
            common, own = float(changes[:, coil] @ driven), float(driven @ driven)
            near = min(abs(common + loss * own) for loss in _LOSSES)
            if near < _UNSURE * own and total - common**2 / own < _REST * total:
                return _gain_text(coil, 1.0 + common / own)
        return ""
