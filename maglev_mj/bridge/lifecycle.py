"""Takeoff and landing: the flotor led from where it lies to the centre and back, and stopped if it does not follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from maglev_mj.bridge.calibration import Calibration
from maglev_mj.controller import Controller
from maglev_mj.frames import Command, Sample
from maglev_mj.hand import Path
from maglev_mj.laws import Bias, Hold
from maglev_mj.parameters import number

__all__ = ["Leader"]

_ASIDE, _ASKEW = 0.002, math.radians(3.0)


class Leader:
    """A controller that leads the flotor along a minimum-jerk path by a soft spring and damper, and carries its weight.

    Args:
        calibration: What is known of the device.
        start: Where the path begins [m, rad], six components.
        end: Where it ends.
        duration: How long it takes [s].
        period: Sample period [s].
        delay: From a sample to its command taking effect [s], however it comes about.
        astray: Called with the pose where the flotor does not follow.

    Attributes:
        period: Sample period [s].

    Raises:
        ParameterError: If the duration is not above 0.
    """

    def __init__(
        self,
        calibration: Calibration,
        start: Sequence[float],
        end: Sequence[float],
        *,
        duration: float,
        period: float,
        delay: float,
        astray: Callable[[Sequence[float]], object],
    ) -> None:
        self.period = period
        self._path = Path([0.0, number("duration", duration, above=0.0)], [list(start), list(end)])
        self._astray = astray
        inertia = np.concatenate([[calibration.mass] * 3, calibration.inertia])
        weight = np.concatenate([-calibration.mass * calibration.gravity, np.zeros(3)])
        hold = Hold.critically_damped(inertia=inertia, period=period, delay=delay)
        self._controller = Controller([Bias(weight), hold], period=period)
        self._first: int | None = None

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        if self._first is None:
            self._first = sample.tick
        goal = self._path.at((sample.tick - self._first) * self.period)
        off = [found - wanted for found, wanted in zip(sample.position, goal)]
        if math.hypot(*off[:3]) > _ASIDE or math.hypot(*off[3:]) > _ASKEW:
            self._astray(sample.position)
        return self._controller.step(Sample(sample.tick, sample.time, off))
