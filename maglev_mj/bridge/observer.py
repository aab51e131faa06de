"""Observer of the hand's wrench, and check of the coils in takeoff."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.control.timeline import Timeline, Timing
from maglev_mj.frames import ZERO, Array, Command

_CORNER = 31.0
"""Corner of each of two low passes [Hz]; both together pass 20 Hz at -3 dB."""

_LIFTED = 4e-4
"""Way from the stop from which a flotor is in the air [m]."""

_FEWEST, _MOST = 8, 60
"""Fewest samples in the air, and most that are fitted."""

_ARM = 0.03
"""Lever arm by which angles count as paths [m]."""

_NOISE, _CERTAIN, _ASTRAY, _BESIDE = 3e-6, 0.02, 0.07, 0.2
"""Noise of a pose [m]; errors of a known gain, a fault, and one beside it."""

_UNKNOWN = (math.nan,) * 6
_KEPT = 64


_Drive: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]
"""Wrench and currents, six numbers each."""

_Sampled: TypeAlias = tuple[int, Sequence[float], list[tuple[float, _Drive]]]
"""One sample: number, pose, drives since the sample period before."""


class HandObserver:
    """Observer of the force that coils, weight and motion do not explain.

    That is the hand's, where the flotor touches nothing else. The mean force around a sample, weighted by a triangle
    of two periods, follows exactly from three positions and the currents between them; it is low-passed at 20 Hz, and
    known one period late.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].

    Attributes:
        currents: Currents that should flow at the last sample [A], six; None if its newest answer is not known, or one
            may flow that another has overtaken.
        coils: Estimator of the coils' gains; it is fed while `tries` is True.
        tries: True in takeoff.
    """

    def __init__(self, calibration: Calibration, period: float) -> None:
        self._period = period
        self._keep = math.exp(-2.0 * math.pi * _CORNER * period)
        self._calibration = calibration
        self._body = [one / period**2 for one in (*[calibration.mass] * 3, *calibration.inertia.tolist())]
        self._weight = [*(calibration.mass * calibration.gravity).tolist(), 0.0, 0.0, 0.0]
        self.tries = False
        self.reset()

    def reset(self) -> None:
        """Forget all; the wrench is not known for the next three samples."""
        self._wrench: Sequence[float] = _UNKNOWN
        self.currents: Sequence[float] | None = None
        self.coils = CoilEstimator(self._calibration, self._period)
        self._timeline = Timeline(Timing(period=self._period, delay=0.0), (ZERO, ZERO))
        self._sent: list[tuple[int | None, tuple[_Drive, _Drive, float] | None]] = [(None, None)] * _KEPT
        self._waiting: deque[_Sampled] = deque(maxlen=_KEPT)
        self._answered, self._sure = 0, 0.0  # newest answer, and instant from which no earlier one flows [s]
        self._taken = self._known = 0
        self._low: Sequence[float] | None = None
        self._lower: Sequence[float]
        self._poses: tuple[Sequence[float], Sequence[float]] = ZERO, ZERO  # the last two
        self._rising: list[tuple[float, _Drive]] = []

    def answered(
        self, tick: int, command: Command, held: Sequence[float], pulsed: Sequence[float] | None, width: float
    ) -> None:
        """Add the answer sent to a sample.

        Args:
            tick: Number of the sample.
            command: The command, limited.
            held: Its currents [A], six.
            pulsed: Those of its pulse; None without one.
            width: Width of the pulse [s].
        """
        first = drive = tuple(command.force), tuple(held)
        if pulsed is not None and command.extra is not None:
            first = tuple([one + other for one, other in zip(command.force, command.extra)]), tuple(pulsed)
        self._sent[tick % _KEPT] = tick, (drive, first, width)

    def sampled(self, tick: int, elapsed: int, position: Sequence[float], answered: int, delay: float) -> None:
        """Add a sample.

        Args:
            tick: Number of the sample.
            elapsed: Sample periods since the last one.
            position: Measured pose [m, rad], six.
            answered: Number of the sample that the newest answer in force answers.
            delay: Time from that sample to the answer's effect [s]; NaN if no new answer has come.
        """
        timeline, period, early = self._timeline, self._period, tick - 1 - answered
        number, sent = self._sent[answered % _KEPT]
        if delay != delay or number != answered:
            sent = None
        else:
            if answered - self._answered > 1:  # of two answers within a period the device reports the newer
                self._sure = answered * period + delay
            self._answered = answered
        known = sent is not None and tick * period >= self._sure
        if sent is not None and early:  # an effect before the last sample cannot be undone
            timeline.answer(answered, *sent, after=max(delay, early * period))
            sent = None
        if elapsed > 1:
            for missed in range(tick - min(elapsed, _KEPT), tick - 1):
                timeline.period(missed)
        intervals = timeline.period(tick - 1, sent, after=delay if delay > 0.0 else 0.0)
        if len(self._waiting) == _KEPT:  # nobody has asked for long
            self._low = None
        self._waiting.append((tick, position, intervals))
        self.currents = timeline.now()[1] if known else None
        if self.tries:
            self._take()

    @property
    def wrench(self) -> Sequence[float]:
        """Estimate at the last sample but one [N, N m], six; NaN while unknown.

        It costs nothing while nobody asks.
        """
        if self._waiting:
            self._take()
        return self._wrench

    def _take(self) -> None:
        """Take up the samples that wait; across lost ones the estimate stays."""
        period, square, keep = self._period, self._period**2, self._keep
        for tick, now, intervals in self._waiting:
            if tick - 1 != self._taken:
                self._known, self.coils = 0, CoilEstimator(self._calibration, period)
            self._taken = tick
            acting, start, self._rising = self._rising, 0.0, []
            for duration, drive in intervals:
                middle, share = start + 0.5 * duration, duration / square
                acting.append(((period - middle) * share, drive))
                self._rising.append((middle * share, drive))
                start += duration
            (before, last), self._poses = self._poses, (self._poses[1], now)
            self._known += 1
            if self._known < 3:
                continue
            if self.tries:
                self.coils.add(now, _mean([(share, currents) for share, (_, currents) in acting]))
            explained = _mean([(share, wrench) for share, (wrench, _) in acting])
            raw = [
                mass * (one - 2.0 * two + three) - force - weight
                for mass, one, two, three, force, weight in zip(self._body, now, last, before, explained, self._weight)
            ]
            if self._low is None:
                self._low = self._lower = raw
            self._low = [one + keep * (old - one) for one, old in zip(raw, self._low)]
            self._wrench = self._lower = [one + keep * (old - one) for one, old in zip(self._low, self._lower)]
        self._waiting.clear()


def _mean(parts: Sequence[tuple[float, Sequence[float]]]) -> list[float]:
    """Return the sum of vectors (6,), each times its share."""
    total = [0.0] * 6
    for share, vector in parts:
        total = [one + share * other for one, other in zip(total, vector)]
    return total


class CoilEstimator:
    """Estimator of each coil's gain from a motion without a hand.

    The path that the currents would have given, integrated twice, is fitted to the measured path by the gains, in
    translation only off the stop. A gain is known where the coil carried current.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].
    """

    def __init__(self, calibration: Calibration, period: float) -> None:
        body = np.array([*[calibration.mass] * 3, *calibration.inertia])
        self._paths = calibration.coils.wrench_per_current * (period**2 / body)[:, None]
        self._fall = np.concatenate([period**2 * calibration.gravity, np.zeros(3)])
        self._rows: list[tuple[float, ...]] = []

    def add(self, position: Sequence[float], currents: Sequence[float]) -> None:
        """Add a pose and the currents around the sample before it [m, rad], [A], six each."""
        self._rows.append((*position, *currents, 1.0))

    def _summed(self) -> Array:
        """Return poses, and currents and ones integrated twice, (N, 13)."""
        rows = np.array(self._rows).reshape(-1, 13)
        rows[:, 6:] = rows[:, 6:].cumsum(axis=0).cumsum(axis=0)
        return rows

    def gains(self) -> Array:
        """Return each coil's gain, (6,): 1 for one as calibrated, NaN for an unknown one."""
        rows = self._summed()
        lifted = np.flatnonzero(np.abs(rows[:, :3] - rows[:1, :3]).max(axis=1, initial=0.0) > _LIFTED)
        if not lifted.size or len(rows) - lifted[0] < _FEWEST:
            return np.full(6, np.nan)
        matrix, left = self._fit(rows[lifted[0] :], range(6))
        changes = np.linalg.lstsq(matrix, left, rcond=None)[0]
        errors = _NOISE * np.sqrt(np.diag(np.linalg.pinv(matrix.T @ matrix)))
        return np.where(errors < _CERTAIN, 1.0 + changes, np.nan)

    def fault(self, lost: bool = False) -> str:
        """Return the coils that are not as calibrated, in words; "" if all are.

        A gain that all coils share is no fault of theirs: so does a weight on the handle look.

        Args:
            lost: True if the flotor does not follow; where no gain is known, the coil that explains most is named.
        """
        gains = self.gains()
        known = gains[np.isfinite(gains)]
        changes = np.abs(gains - (np.median(known) if known.size else 1.0))
        wrong = np.flatnonzero(changes > max(_ASTRAY, _BESIDE * np.nan_to_num(changes).max()))
        if wrong.size:
            return ", ".join(f"coil {coil} gives {100.0 * gains[coil]:.0f} % of its calibrated force" for coil in wrong)
        if not lost or len(self._rows) < 3:
            return ""
        # on its stop a flotor may turn, which three axes show
        matrix, left = self._fit(self._summed(), range(3, 6))
        sizes = (matrix**2).sum(axis=0) + _NOISE**2
        return f"coil {int(np.argmax((matrix.T @ left) ** 2 / sizes))} explains it best: weak, dead or reversed"

    def _fit(self, rows: Array, axes: Sequence[int]) -> tuple[Array, Array]:
        """Return how changed gains change the path on some axes, and the path left to explain."""
        rows = rows[:: max(len(rows) // _MOST, 1)]
        start = np.stack([np.ones(len(rows)), np.linspace(0.0, 1.0, len(rows))], axis=1)
        away = np.eye(len(rows)) - start @ np.linalg.pinv(start)  # without what any start and speed explain
        parts, paths = [], []
        for axis in axes:
            size = 1.0 if axis < 3 else _ARM
            parts.append(size * away @ (rows[:, 6:12] * self._paths[axis]))
            paths.append(size * away @ (rows[:, axis] - self._fall[axis] * rows[:, 12]))
        matrix = np.vstack(parts)
        return matrix, np.concatenate(paths) - matrix.sum(axis=1)
