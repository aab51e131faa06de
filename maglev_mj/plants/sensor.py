"""What the sensor makes of the true pose: steps and noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component, components, join
from maglev_mj.model import beams
from maglev_mj.parameters import number, numbers
from maglev_mj.sensing import Beams

__all__ = ["PoseSensor", "Sensor", "SpotSensor"]

Measure: TypeAlias = Callable[[Sequence[Component]], list[Component]]
"""From the components of the true pose to those measured."""


class PoseSensor(Protocol):
    """What a plant asks of a sensor."""

    def start(self) -> Measure:
        """Return what turns the components of the true pose into those measured, from the beginning on."""


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

        number("seed", self.seed, at_least=0)

    def start(self) -> Measure:
        """Return what turns the components of the true pose into those measured, from the seed on."""
        quantum, noise = np.asarray(self.quantum), np.asarray(self.noise)
        generator = np.random.default_rng(self.seed) if noise.any() else None
        step = np.where(quantum > 0.0, quantum, 1.0)

        def measure(position: Sequence[Component]) -> list[Component]:
            pose: Array = join(position)
            if generator is not None:
                pose = pose + noise * generator.standard_normal(pose.shape)
            return components(np.where(quantum > 0.0, np.rint(pose / step) * step, pose))

        return measure


@dataclass(frozen=True, kw_only=True, eq=False)
class SpotSensor:
    """The device's own sensor: where three beams meet three diodes, in steps, and Newton's pose from that.

    Args:
        beams: The geometry; that of the model by default.
        quantum: Resolution of a spot's place [m]; 0 for none.

    Raises:
        ParameterError: If the resolution is negative.
    """

    beams: Beams | None = None
    quantum: float = 0.0

    def __post_init__(self) -> None:
        number("quantum", self.quantum, at_least=0.0)

    def start(self) -> Measure:
        """Return what turns the components of the true pose into those measured; each search begins at the last."""
        last: Array | None = None
        geometry = self.beams or beams()

        def measure(position: Sequence[Component]) -> list[Component]:
            nonlocal last
            spots = geometry.spots(join(position))
            if self.quantum > 0.0:
                spots = np.rint(spots / self.quantum) * self.quantum
            last = geometry.pose(spots, last)
            return components(last)

        return measure
