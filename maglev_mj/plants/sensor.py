"""Sensor models: resolution and noise."""

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
from maglev_mj.parameters import number, numbers, whole
from maglev_mj.plants.beams import Beams, FastBeams, PoseTracker
from maglev_mj.plants.model import beams

Measure: TypeAlias = Callable[[Sequence[Component]], list[Component]]
"""Function from true to measured pose components."""


class PoseSensor(Protocol):
    """Interface of a pose sensor to a plant."""

    def start(self) -> Measure:
        """Return the measurement function in its initial state.

        It maps the components of the true pose to the measured ones.
        """


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
    """Pose sensor with limited resolution and white Gaussian noise.

    The noise is added before quantization.

    Args:
        quantum: Resolution, (6,) or a number [m, rad]; zero for none.
        noise: Standard deviation of the noise, (6,) or a number [m, rad]; devices of a batch draw their own.
        seed: Seed of the noise: the same seed gives the same run.

    Raises:
        ParameterError: If a value is negative or of another shape.

    Example:
        >>> from maglev_mj import ExactPlant, Sensor
        >>> with ExactPlant(pose=[1.4e-5, 0, 0, 0, 0, 0], sensor=Sensor(quantum=1e-5)) as plant:
        ...     measured = plant.read().position[0]
        >>> round(measured, 9)
        1e-05
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
        """Return the measurement function in its initial state.

        It maps the components of the true pose to the measured ones; the noise begins at the seed.
        """
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
"""Offset for rounding a float to a whole number.

x + _WHOLE - _WHOLE is x rounded to the nearest whole number, halves to the even one.

This holds below 2**51; beyond that, a float's own rounding is larger. NaN and infinity stay.
"""


def _quantizer(quantum: Sequence[float]) -> Callable[[Iterable[Component]], list[Component]]:
    """Return a function that quantizes six components.

    The steps are six [m, rad]; a step of 0 leaves its component unchanged.

    The result equals np.rint to the last bit, except for the sign of a zero.
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
    """Return an endless iterator of noise samples.

    A sample is six components of shape (...,).

    For one device many samples are drawn at once, with the same values as one by one.
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
    """Simulated diode electronics of one device.

    The light spots of the true pose are returned with noise and quantization.

    Args:
        beams: The geometry.
        quantum: Resolution of a spot's position [m]; 0 for none.
        noise: Standard deviation of white Gaussian noise on each coordinate of a spot before quantization [m].
        seed: Seed of the noise: the same seed gives the same run.

    Raises:
        ParameterError: If a value is negative.
    """

    def __init__(self, beams: Beams, quantum: float = 0.0, noise: float = 0.0, seed: int = 0) -> None:
        self._beams = FastBeams(beams)
        self._quantize = _quantizer([number("quantum", quantum, at_least=0.0)] * 6)
        spread, seed = number("noise", noise, at_least=0.0), whole("seed", seed)
        self._draws = _draws([spread] * 6, seed) if spread else None

    def __call__(self, pose: Sequence[float]) -> list[float]:
        """Return six measured spot coordinates [m] of a true pose.

        The pose is six floats [m, rad].

        Raises:
            SensingError: If a beam runs along its diode, or the pose is not finite.
        """
        spots = self._beams.spots(pose)
        return self._quantize(spots if self._draws is None else map(add, spots, next(self._draws)))


@dataclass(frozen=True, kw_only=True, eq=False)
class SpotSensor:
    """The device's own optical sensor with three light beams.

    Spots of the beams on three diodes are read with noise and quantization, and the pose is computed from them.

    One device is measured by a `SpotReader` and a `PoseTracker`, a batch at once by `Beams`.

    Args:
        beams: The geometry; that of the model by default.
        quantum: Resolution of a spot's position [m]; 0 for none.
        noise: Standard deviation of white Gaussian noise on each coordinate of a spot before quantization [m]; devices
            of a batch draw their own.
        seed: Seed of the noise: the same seed gives the same run.

    Raises:
        ParameterError: If a value is negative.

    Example:
        >>> from maglev_mj import ExactPlant, SpotSensor
        >>> with ExactPlant(pose=[1e-3, 0, 0, 0, 0, 0], sensor=SpotSensor(quantum=5e-6)) as plant:
        ...     measured = plant.read().position[0]
        >>> abs(measured - 1e-3) < 1e-5
        True
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
        """Return the measurement function in its initial state.

        It maps the components of the true pose to the measured ones. Each search begins at the last pose found.

        The function raises SensingError if no pose fits the spots, and for one device also beyond a quarter turn.
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
        """Return the measurement function of one device."""
        reader = SpotReader(geometry, self.quantum, self.noise, self.seed)
        # the plant checks the distance (its `escape`); no two poses within a quarter turn give the same spots
        tracker = PoseTracker(geometry, farthest=math.inf, most_turned=0.5 * math.pi)
        return lambda position: tracker(reader(position))

    def _many(self, geometry: Beams) -> Measure:
        """Return the measurement function of a batch."""
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
