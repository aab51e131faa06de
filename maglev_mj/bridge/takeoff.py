"""Takeoff and landing: detection of rest, and the leading controller."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.control import Bias, Hold
from maglev_mj.control.controller import Controller
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.parameters import number
from maglev_mj.plants.hand import Trajectory
from maglev_mj.spec import Spec

_ASIDE, _ASKEW = 0.002, math.radians(3.0)

_SLOW, _SLOW_SPIN = 5e-3, 0.1
"""Largest speed [m/s] and angular speed [rad/s] at rest.

At 200 Hz they are 300 times the apparent speed due to noise of half a spot's step, and 3 times that due to 50 µm.
"""

_ON_STOP = 0.6 * Spec.translation_range.value
_WATCHED, _BLOCKS = 0.1, 5


class Motion:
    """Pose and speed of the flotor over 0.1 s.

    The speeds are the range of the mean poses of five blocks, over the time between the first and the last: noise
    counts the less the faster the sampling, and a swing to and fro below 25 Hz is not missed.

    Args:
        period: Sample period [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._seen: deque[Sample] = deque(maxlen=max(round(_WATCHED / period), 2) + 1)
        self.add = self._seen.append

    @property
    def full(self) -> bool:
        """True if the samples cover 0.1 s."""
        return len(self._seen) == self._seen.maxlen

    @property
    def pose(self) -> list[float]:
        """Mean pose [m, rad], six; NaN without samples."""
        return np.mean([one.position for one in self._seen] or [[math.nan] * 6], axis=0).tolist()  # type: ignore[no-any-return]

    @property
    def speeds(self) -> tuple[float, float]:
        """Speed [m/s] and angular speed [rad/s].

        NaN for less than two samples.
        """
        if len(self._seen) < 2:
            return math.nan, math.nan
        rows = np.array([(one.tick * self._period, *one.position) for one in self._seen])
        means = np.array([block.mean(axis=0) for block in np.array_split(rows, min(_BLOCKS, len(rows)))])
        gone = np.ptp(means[:, 1:], axis=0) / (means[-1, 0] - means[0, 0])
        return math.hypot(*gone[:3]), math.hypot(*gone[3:])

    @property
    def at_rest(self) -> bool:
        """True if the flotor is at rest."""
        speed, spin = self.speeds
        return speed <= _SLOW and spin <= _SLOW_SPIN

    def __str__(self) -> str:
        return _speeds_shown(*self.speeds)


class LandingReport(NamedTuple):
    """Pose and motion of a flotor after landing.

    Attributes:
        error: Distance from the pose before takeoff [m]; NaN if its pose is not known.
        speed: Speed over the last 0.1 s [m/s].
        spin: Angular speed over the last 0.1 s [rad/s].
        at_rest: True if it rests.
    """

    error: float
    speed: float
    spin: float
    at_rest: bool

    def __str__(self) -> str:
        how = "at rest" if self.at_rest else f"NOT at rest: {_speeds_shown(self.speed, self.spin)}"
        return f"landed {self.error * 1e3:.2f} mm from where it lay, {how}"


class Leader:
    """Controller that leads the flotor along a minimum-jerk path.

    A soft spring and damper, and the weight carried.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].
        delay: Total time from a sample to its command's effect [s].

    Attributes:
        period: Sample period [s].
    """

    def __init__(self, calibration: Calibration, period: float, delay: float) -> None:
        self.period = period
        inertia = np.concatenate([[calibration.mass] * 3, calibration.inertia])
        weight = np.concatenate([-calibration.mass * calibration.gravity, np.zeros(3)])
        hold = Hold.critically_damped(inertia=inertia, period=period, delay=delay)
        self._controller = Controller([Bias(weight), hold], period=period)
        self.aim(ZERO, ZERO, 1.0)

    def aim(
        self,
        start: Sequence[float],
        end: Sequence[float],
        duration: float,
        astray: Callable[[Sequence[float]], object] | None = None,
    ) -> None:
        """Begin a path between two poses at the next sample.

        Poses are [m, rad], six each.

        Args:
            start: First pose.
            end: Last pose.
            duration: Time between them [s].
            astray: Called with the pose if the flotor does not follow.

        Raises:
            ParameterError: If the duration is not above 0.
        """
        self._path = Trajectory([0.0, number("duration", duration, above=0.0)], [list(start), list(end)])
        self._astray, self._first = astray, -1
        self.motion = Motion(self.period)
        self._controller.reset()

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        if self._first < 0:
            self._first = sample.tick
        self.motion.add(sample)
        goal = self._path.at((sample.tick - self._first) * self.period)
        off = [found - wanted for found, wanted in zip(sample.position, goal)]
        if self._astray is not None and (math.hypot(*off[:3]) > _ASIDE or math.hypot(*off[3:]) > _ASKEW):
            self._astray(sample.position)
        return self._controller.step(Sample(sample.tick, sample.time, off))


def _speeds_shown(speed: float, spin: float) -> str:
    return f"{speed * 1e3:.2g} mm/s and {spin:.2g} rad/s"


def off_stop(pose: Sequence[float], gravity: Sequence[float]) -> bool:
    """Return True if a pose is off the lower stop.

    The stop is the lower one with respect to gravity [m/s²]; without gravity no pose is off it.
    """
    return sum(one * other for one, other in zip(pose, gravity)) < _ON_STOP * math.hypot(*gravity)


def shown(position: Sequence[float]) -> str:
    """Return a pose as text."""
    return ", ".join(f"{part * 1e3:.2f}" for part in position) + " (mm, mrad)"
