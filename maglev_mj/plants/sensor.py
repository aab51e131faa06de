"""What the sensor makes of the true pose: steps and noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, count
from operator import add
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component, components, join
from maglev_mj.model import beams
from maglev_mj.parameters import number, numbers, whole
from maglev_mj.sensing.geometry import Beams
from maglev_mj.sensing.solver import FastBeams, PoseTracker

__all__ = ["PoseSensor", "Sensor", "SpotReader", "SpotSensor", "measuring"]

Measure: TypeAlias = Callable[[Sequence[Component]], list[Component]]
"""From the components of the true pose to those measured."""


class PoseSensor(Protocol):
    """What a plant asks of a sensor."""

    def start(self) -> Measure:
        """Return what turns the components of the true pose into those measured, from the beginning on."""


def measuring(sensor: PoseSensor) -> Measure:
    """Start a sensor and return its measuring function.

    Raises:
        ParameterError: If it has no `start`, or that returns no function.
    """
    start = None if isinstance(sensor, type) else getattr(sensor, "start", None)
    measure = start() if callable(start) else None
    if not callable(measure):
        raise ParameterError(f"sensor must have start(), which returns a function of six components, not {sensor!r}")
    return measure  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensor:
    """A sensor of limited resolution with white Gaussian noise ahead of its steps.

    Args:
        quantum: Resolution, (6,) or a number [m, rad]; zero for none.
        noise: Standard deviation of the noise, (6,) or a number [m, rad]; devices of a batch draw their own.
        seed: Of the noise: the same seed gives the same run.

    Raises:
        ParameterError: If a value is negative or of another shape.
    """

    quantum: ArrayLike = 0.0
    noise: ArrayLike = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("quantum", "noise"):
            values = numbers(name, getattr(self, name), at_least=0.0)
            if values.shape not in ((), (6,)):
                raise ParameterError(f"{name} must be a number or have the shape (6,), not {values.shape}")
            object.__setattr__(self, name, np.broadcast_to(values, (6,)))
        object.__setattr__(self, "seed", whole("seed", self.seed))

    def start(self) -> Measure:
        """Return what turns the components of the true pose into those measured, from the seed on."""
        noise, quantize = np.asarray(self.noise).tolist(), _quantizer(np.asarray(self.quantum).tolist())
        if not any(noise):
            return quantize
        draw: Callable[[], list[Component]] | None = None

        def measure(position: Sequence[Component]) -> list[Component]:
            nonlocal draw
            if draw is None:
                draw = _draws(noise, self.seed, np.broadcast_shapes(*map(np.shape, position))).__next__
            return quantize(map(add, position, draw()))

        return measure


_WHOLE = 1.5 * 2.0**52
"""Next to this number floats are whole numbers: x + _WHOLE - _WHOLE is x to the nearest one, halves to the even one.

That holds below 2**51, beyond which a float's own rounding is larger than what is added; NaN and infinity stay.
"""


def _quantizer(quantum: Sequence[float]) -> Callable[[Iterable[Component]], list[Component]]:
    """Return what rounds six components to whole steps [m, rad], six; a step of 0 leaves its component.

    It is np.rint to the last bit, but for the sign of a zero.
    """
    if not all(quantum):
        return lambda position: [
            (part / step + _WHOLE - _WHOLE) * step if step else part for part, step in zip(position, quantum)
        ]
    x_step, y_step, z_step, rx_step, ry_step, rz_step = quantum

    def quantize(position: Iterable[Component]) -> list[Component]:
        x, y, z, rx, ry, rz = position  # written out: this runs on every tick
        return [
            (x / x_step + _WHOLE - _WHOLE) * x_step,
            (y / y_step + _WHOLE - _WHOLE) * y_step,
            (z / z_step + _WHOLE - _WHOLE) * z_step,
            (rx / rx_step + _WHOLE - _WHOLE) * rx_step,
            (ry / ry_step + _WHOLE - _WHOLE) * ry_step,
            (rz / rz_step + _WHOLE - _WHOLE) * rz_step,
        ]

    return quantize


def _draws(noise: Sequence[float], seed: int, shape: tuple[int, ...] = ()) -> Iterator[list[Component]]:
    """Return draws of noise without end, six components of shape (...,) at a time.

    For one device many are drawn at once, the same as one by one.
    """
    generator = np.random.default_rng(seed)
    if not shape:
        spread = np.asarray(noise)
        return chain.from_iterable((spread * generator.standard_normal((256, 6))).tolist() for _ in count())
    drawn = np.empty((*shape, 6))

    def columns() -> list[Component]:
        generator.standard_normal(out=drawn)
        return [one * drawn[..., index] for index, one in enumerate(noise)]

    return (columns() for _ in count())


class SpotReader:
    """The diodes' electronics of one device: the spots of the true pose, with noise, in steps.

    Args:
        beams: The geometry.
        quantum: Resolution of a spot's place [m]; 0 for none.
        noise: Standard deviation of white Gaussian noise on each coordinate of a spot, ahead of its steps [m].
        seed: Of the noise: the same seed gives the same run.

    Raises:
        ParameterError: If a value is negative.
    """

    def __init__(self, beams: Beams, quantum: float = 0.0, noise: float = 0.0, seed: int = 0) -> None:
        self._beams = FastBeams(beams)
        self._quantize = _quantizer([number("quantum", quantum, at_least=0.0)] * 6)
        spread, seed = number("noise", noise, at_least=0.0), whole("seed", seed)
        self._draws = _draws([spread] * 6, seed) if spread else None

    def __call__(self, pose: Sequence[float]) -> list[float]:
        """Return the six coordinates of the spots [m] that are measured of the true pose, six floats [m, rad].

        Raises:
            SensingError: If a beam runs along its diode, or the pose is not finite.
        """
        spots = self._beams.spots(pose)
        return self._quantize(spots if self._draws is None else map(add, spots, next(self._draws)))


@dataclass(frozen=True, kw_only=True, eq=False)
class SpotSensor:
    """The device's own sensor: where three beams meet three diodes, with noise, in steps, and the pose from that.

    One device is measured by a `SpotReader` and a `PoseTracker`, a batch at once by `Beams`.

    Args:
        beams: The geometry; that of the model by default.
        quantum: Resolution of a spot's place [m]; 0 for none.
        noise: Standard deviation of white Gaussian noise on each coordinate of a spot, ahead of its steps [m]; devices
            of a batch draw their own.
        seed: Of the noise: the same seed gives the same run.

    Raises:
        ParameterError: If a value is negative.
    """

    beams: Beams | None = None
    quantum: float = 0.0
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("quantum", "noise"):
            number(name, getattr(self, name), at_least=0.0)
        object.__setattr__(self, "seed", whole("seed", self.seed))

    def start(self) -> Measure:
        """Return what turns the components of the true pose into those measured; each search begins at the last.

        What it returns raises SensingError where no pose fits the spots, for one device also beyond a quarter turn.
        """
        geometry = self.beams or beams()
        chosen: Measure | None = None

        def measure(position: Sequence[Component]) -> list[Component]:
            nonlocal chosen
            if chosen is None:
                chosen = self._one(geometry) if join(position).ndim == 1 else self._many(geometry)
            return chosen(position)

        return measure

    def _one(self, geometry: Beams) -> Measure:
        """Return what measures one device."""
        reader = SpotReader(geometry, self.quantum, self.noise, self.seed)
        # how far is too far is for the plant to say (its `escape`); no two poses within a quarter turn look alike
        tracker = PoseTracker(geometry, farthest=math.inf, most_turned=0.5 * math.pi)
        return lambda position: tracker(reader(position))

    def _many(self, geometry: Beams) -> Measure:
        """Return what measures a batch."""
        generator = np.random.default_rng(self.seed)
        last: Array | None = None

        def measure(position: Sequence[Component]) -> list[Component]:
            nonlocal last
            spots = geometry.spots(join(position))
            if self.noise > 0.0:
                spots = spots + self.noise * generator.standard_normal(spots.shape)
            if self.quantum > 0.0:
                spots = np.rint(spots / self.quantum) * self.quantum
            last = geometry.pose(spots, last)
            return components(last)

        return measure
