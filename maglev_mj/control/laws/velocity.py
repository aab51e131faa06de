"""Velocity estimators for sampled positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import LinearController, choose
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Component, Six
from maglev_mj.keywords import checked
from maglev_mj.parameters import number, store, whole
from maglev_mj.spec import RESOLUTION

_LONGEST = 1000
"""Largest window length [samples]: 1 s at 1 kHz."""


class Estimator:
    """Base class of the package's velocity estimators; see `VelocityEstimator`."""

    called: ClassVar[str]
    """Value of `--velocity`; "" for an estimator that is not offered there."""

    settles_in: ClassVar = 40
    """Samples, at intervals of about 2 ms, within which the velocity of a ramp is exact to 1e-9."""

    @classmethod
    def of(cls, resolution: float) -> Self:
        """Return the estimator for a sensor resolution [m, rad]."""
        return cls()

    def __call__(self, position: Six, state: Any, period: float) -> tuple[Six, Any]:
        """See `VelocityEstimator`."""
        raise NotImplementedError


@checked
@dataclass(frozen=True)
class FiniteDifference(Estimator):
    """Backward difference v[k] = (x[k] - x[k-1]) / T; zero at the first sample.

    Source: Salcudean & Vlaar 1997, eq. (3).

    Example:
        >>> from maglev_mj import FiniteDifference
        >>> velocity, state = FiniteDifference()([0.002, 0, 0, 0, 0, 0], [0.001, 0, 0, 0, 0, 0], 0.005)
        >>> velocity[0]
        0.2
    """

    called: ClassVar = "difference"

    def __call__(self, position: Six, state: Six | None, period: float) -> tuple[Six, Six]:
        """Return the velocity and the next state, the positions."""
        # written out, because it runs on every tick: a loop over six components takes twice as long
        x, y, z, rx, ry, rz = position
        x0, y0, z0, rx0, ry0, rz0 = position if state is None else state
        return (
            (x - x0) / period,
            (y - y0) / period,
            (z - z0) / period,
            (rx - rx0) / period,
            (ry - ry0) / period,
            (rz - rz0) / period,
        ), position

    def linear(self, period: ArrayLike) -> LinearController:
        """Return the state space model of one axis; its state is the last position."""
        return Window(samples=1).linear(period)


@checked
@dataclass(frozen=True)
class LowPass(Estimator):
    """Finite difference with a first-order low-pass filter.

    v[k] = v[k-1] + (1 - exp(-2 pi f T)) ((x[k] - x[k-1]) / T - v[k-1]).

    Args:
        cutoff: Cutoff frequency f [Hz].

    Raises:
        ParameterError: If the cutoff frequency is not above 0.

    Example:
        >>> from maglev_mj import LowPass
        >>> estimate, state = LowPass(cutoff=50.0), None
        >>> for x in (0.0, 0.001, 0.002, 0.003):  # 0.2 m/s
        ...     velocity, state = estimate([x, 0, 0, 0, 0, 0], state, 0.005)
        >>> round(velocity[0], 3)
        0.198
    """

    called: ClassVar = "low-pass"

    cutoff: float = 50.0

    def __post_init__(self) -> None:
        number("cutoff", self.cutoff, above=0.0)

    def __call__(self, position: Six, state: Any, period: float) -> tuple[Six, Any]:
        """Return the filtered velocity, zero at the first sample, and the next state."""
        previous, velocity = (position, (0.0,) * len(position)) if state is None else state
        share = -math.expm1(-2.0 * math.pi * self.cutoff * period)
        filtered = [
            speed + share * ((now - before) / period - speed)
            for now, before, speed in zip(position, previous, velocity)
        ]
        return filtered, (position, filtered)

    def linear(self, period: ArrayLike) -> LinearController:
        """Return the state space model of one axis; its state is the last position and estimate."""
        time = np.asarray(period, dtype=np.float64)
        share = -np.expm1(-2.0 * math.pi * self.cutoff * time)
        zero, one = np.zeros_like(time), np.ones_like(time)
        give = np.stack([-share / time, 1.0 - share], axis=-1)
        advance = np.stack([np.stack([zero, zero], axis=-1), give], axis=-2)
        return LinearController(advance, np.stack([one, share / time], axis=-1), give, share / time)


@dataclass(frozen=True)
class Window(Estimator):
    """Mean velocity over a window of n samples: v[k] = (x[k] - x[k-n]) / (n T), with the time between them for n T.

    The flotor is assumed at rest before the first sample.

    Args:
        samples: Window length n, 1 to 1000; 1 is the finite difference.

    Raises:
        ParameterError: If `samples` is not a whole number from 1 to 1000.
    """

    called: ClassVar = ""

    samples: int = 3

    def __post_init__(self) -> None:
        store(self, samples=whole("samples", self.samples, at_least=1, at_most=_LONGEST))

    def __call__(self, position: Six, state: Any, period: float) -> tuple[Six, Any]:
        """Return the mean velocity, zero at the first sample, and the next state."""
        past, periods = state or ((position,) * self.samples, (period,) * self.samples)
        periods = (period, *periods[:-1])
        time = math.fsum(periods)  # as exact as the product n T
        velocity = [(now - before) / time for now, before in zip(position, past[-1])]
        return velocity, ((position, *past[:-1]), periods)

    def linear(self, period: ArrayLike) -> LinearController:
        """Return the state space model of one axis; its state is the last n positions, newest first."""
        time, count = np.asarray(period, dtype=np.float64), self.samples
        advance, take = np.eye(count, k=-1), np.eye(count)[0]
        oldest = np.eye(count)[-1]
        return LinearController(advance, take, -oldest / (count * time[..., None]), 1.0 / (count * time))


@dataclass(frozen=True)
class AdaptiveWindow(Estimator):
    """First-order adaptive windowing (FOAW) velocity estimator.

    The estimate is the slope of the chord over the longest window in which every sample is within `noise` of the chord
    from the first sample to the last. With a quantized sensor the window grows at low speed, which refines the velocity
    resolution, and shrinks when the velocity changes.

    Args:
        noise: Half-width of the band around the chord [m, rad], six numbers; the sensor resolution by default.
        longest: Largest window length [samples], 1 to 1000.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: end-fit FOAW of Janabi-Sharifi, Hayward & Chen 2000 (not opened), as in `foaw.c` of
    github.com/radarsat1/FOAW.
    """

    called: ClassVar = "adaptive"

    noise: Sequence[float] = RESOLUTION
    longest: int = 16

    def __post_init__(self) -> None:
        store(self, longest=whole("longest", self.longest, at_least=1, at_most=_LONGEST))
        if len(self.noise) != len(AXES):
            raise ParameterError(f"noise must have {len(AXES)} numbers (got {len(self.noise)})")
        for value in self.noise:
            number("noise", value, at_least=0.0)

    @classmethod
    def of(cls, resolution: float) -> Self:
        """See `Estimator`."""
        return cls(noise=(max(resolution, 1e-12),) * 6)

    def __call__(self, position: Six, state: Any, period: float) -> tuple[Six, Any]:
        """Return the velocity, zero at the first sample, and the next state."""
        past, periods = state or ([], [])
        history, periods = [position, *past[: self.longest]], [period, *periods[: self.longest]]
        ages = [math.fsum(periods[:index]) for index in range(len(history))]
        velocity = [self._slope([sample[axis] for sample in history], self.noise[axis], ages) for axis in range(6)]
        return velocity, (history, periods)

    @staticmethod
    def _slope(samples: list[Component], noise: float, ages: list[float]) -> Component:
        """Return the slope over the longest fitting window; `samples`, of these ages [s], are newest first."""
        newest = samples[0]
        if len(samples) == 1:
            return newest - newest
        slope = (newest - samples[1]) / ages[1]
        fits = slope == slope
        for width in range(2, len(samples)):
            chord = (newest - samples[width]) / ages[width]
            for age in range(1, width):
                fits = fits & (abs(newest - ages[age] * chord - samples[age]) <= noise)
            if fits is False:
                break
            slope = choose(fits, chord, slope)
        return slope
