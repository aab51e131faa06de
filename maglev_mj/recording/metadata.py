"""Mechanics of a recorded run."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from maglev_mj.frames import ZERO
from maglev_mj.parameters import numbers
from maglev_mj.spec import GRAVITY, INERTIA

__all__ = ["Mechanics"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanics:
    """What the actuators push at, which says where the energy goes; the device as published by default.

    Attributes:
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        load: Constant wrench that acts besides the actuators', its weight [N, N m], (6,).
        before: Wrench of the actuators until the first command takes effect [N, N m], (6,).

    Raises:
        ParameterError: If a value is not finite, or an inertia is not above 0.
    """

    inertia: ArrayLike = INERTIA
    load: ArrayLike = (0.0, 0.0, -INERTIA[2] * GRAVITY, 0.0, 0.0, 0.0)
    before: ArrayLike = ZERO

    def __post_init__(self) -> None:
        numbers("inertia", self.inertia, at_least=1e-12)
        numbers("load", self.load)
        numbers("before", self.before)
