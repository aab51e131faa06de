"""What the sensor makes of the true pose: steps and noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component, components, join
from maglev_mj.parameters import number, numbers

__all__ = ["Sensor"]


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

    def start(self) -> Callable[[Sequence[Component]], list[Component]]:
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
