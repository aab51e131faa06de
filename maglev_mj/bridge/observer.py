"""Observer of the hand's wrench, and check of the coils in takeoff."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.control.timeline import Timeline, Timing
from maglev_mj.frames import Array

_CORNER = 31.0
"""Corner of each of two low passes [Hz]; both together pass 20 Hz at -3 dB."""

_UNKNOWN = (math.nan,) * 6
_KEPT = 64


class _Drive(NamedTuple):
    """Wrench sent in answer to a sample, held and pulsed [N, N m], (6,) each."""

    held: Array
    pulsed: Array
    width: float


class HandObserver:
    """Observer of the force that coils, weight and motion do not explain.

    That is the hand's, where the flotor touches nothing else. The mean force around a sample, weighted by a triangle
    of two periods, follows exactly from three positions and the currents between them; it is low-passed at 20 Hz, and
    known one period late.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].

    Attributes:
        wrench: Estimate at the last sample but one [N, N m], six; NaN while it is not known.
    """

    def __init__(self, calibration: Calibration, period: float) -> None:
        self._period = period
        self._keep = math.exp(-2.0 * math.pi * _CORNER * period)
        self._coils = calibration.coils
        self._body = np.array([*[calibration.mass] * 3, *calibration.inertia]) / period**2
        self._weight = np.concatenate([calibration.mass * calibration.gravity, np.zeros(3)])
        self._sent: dict[int, _Drive] = {}
        self.reset()

    def reset(self) -> None:
        """Forget all; the wrench is not known for the next two samples."""
        self.wrench: Sequence[float] = _UNKNOWN
        self._timeline = Timeline(Timing(period=self._period, delay=0.0), np.zeros(6))
        self._known = 0
        self._low = self._lower = np.zeros(6)
        self._before = self._last = np.zeros(6)
        self._moment = np.zeros(6)
        self._sent.clear()

    def answered(self, tick: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Add the answer sent to a sample.

        Wrenches [N, N m], six each, and the width of the pulse [s].
        """
        force = np.array(held)
        self._sent[tick] = _Drive(force, force if pulsed is None else np.array(pulsed), width)
        if len(self._sent) > _KEPT:
            del self._sent[next(iter(self._sent))]

    def sampled(self, tick: int, elapsed: int, position: Sequence[float], answered: int, delay: float) -> None:
        """Add a sample.

        Args:
            tick: Number of the sample.
            elapsed: Sample periods since the last one.
            position: Measured pose [m, rad], six.
            answered: Number of the sample that the newest answer in force answers.
            delay: Time from that sample to the answer's effect [s]; NaN if no new answer has come.
        """
        if elapsed != 1:
            self.reset()
            self._last = np.array(position)
            return
        if delay == delay and (drive := self._sent.get(answered)) is not None:
            early = tick - 1 - answered  # an effect before the last sample cannot be undone
            self._timeline.answer(answered, *drive, after=max(delay, early * self._period))
        now, start = np.array(position), 0.0
        impulse, moment = np.zeros(6), np.zeros(6)
        for duration, force in self._timeline.period(tick - 1):
            impulse = impulse + duration * force
            moment = moment + (duration * (start + 0.5 * duration)) * force
            start += duration
        period = self._period
        acting = (self._moment + period * impulse - moment) / period**2
        bent = now - 2.0 * self._last + self._before
        self._before, self._last, self._moment = self._last, now, moment
        self._known += 1
        if self._known < 2:
            return
        raw = self._body * bent - acting - self._weight
        keep = self._keep if self._known > 2 else 0.0
        self._low = raw + keep * (self._low - raw)
        self._lower = self._low + keep * (self._lower - self._low)
        self.wrench = self._lower.tolist()
