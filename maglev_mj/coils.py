"""Six coils: currents to wrench and back, and what that allows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from maglev_mj.errors import ModelError, ParameterError
from maglev_mj.frames import Array

__all__ = ["CoilMap"]


@dataclass(frozen=True, eq=False)
class CoilMap:
    """The linear map between six coil currents and the wrench on the flotor at its centre.

    The map is that of the centred flotor. The coils turn with the flotor while the forces keep their
    directions, so at an angle the true wrench differs: by under 1 % up to 1 degree.

    Args:
        wrench_per_current: Columns are the wrench of one ampere in each coil [N/A, N m/A], (6, 6).

    Raises:
        ModelError: If the map is not (6, 6), or singular: the coils then cannot give every wrench.
    """

    wrench_per_current: Array
    current_per_wrench: Array = field(init=False)

    def __post_init__(self) -> None:
        if self.wrench_per_current.shape != (6, 6):
            raise ModelError(f"six coils are needed for six axes, not a map of shape {self.wrench_per_current.shape}")
        try:
            inverse = np.linalg.inv(self.wrench_per_current)
        except np.linalg.LinAlgError:
            raise ModelError("the six coils cannot give every wrench: their map is singular") from None
        object.__setattr__(self, "current_per_wrench", inverse)

    def currents(self, wrench: Array) -> Array:
        """Return the currents [A] (..., 6) that give a wrench [N, N m] (..., 6)."""
        return wrench @ self.current_per_wrench.T

    def wrench(self, currents: Array) -> Array:
        """Return the wrench [N, N m] (..., 6) that currents [A] (..., 6) give."""
        return currents @ self.wrench_per_current.T

    def limited(self, wrench: Array, limit: float) -> Array:
        """Return the wrench (..., 6) that is left when no current may exceed a limit [A]."""
        return self.wrench(np.clip(self.currents(wrench), -limit, limit))

    def largest_wrench(self, current: float) -> Array:
        """Return the largest pure force or torque on each axis [N, N m], (6,), the others being zero.

        Args:
            current: Largest current in any coil [A].

        Raises:
            ParameterError: If the current is negative.
        """
        if current < 0.0:
            raise ParameterError(f"current must be at least 0, not {current:g}")
        largest: Array = current / np.abs(self.current_per_wrench).max(axis=0)
        return largest

    def condition_number(self, length: float) -> float:
        """Return the 2-norm condition number with torques divided by a length [m], which makes it unitless."""
        scale = np.array([1.0, 1.0, 1.0, 1.0 / length, 1.0 / length, 1.0 / length])
        return float(np.linalg.cond(scale[:, None] * self.wrench_per_current))
