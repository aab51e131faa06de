"""A spring and damper to a target pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

from numpy.typing import ArrayLike

from maglev_mj.frames import AXES, Component
from maglev_mj.parameters import axis_indices, batch_shape, number, numbers, per_axis

__all__ = ["Hold"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Hold:
    """PD hold, f = stiffness (target - x) - damping v, on the axes named.

    Each parameter is a number for all of the law's axes, one number an axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        stiffness: Stiffness [N/m, N m/rad].
        damping: Damping [N s/m, N m s/rad].
        target: Pose held [m, rad].

    Raises:
        ParameterError: If a gain is negative, or a value is not finite or of the wrong shape.
    """

    axes: str | Sequence[str] = AXES
    stiffness: ArrayLike
    damping: ArrayLike
    target: ArrayLike = 0.0

    batch: tuple[int, ...] = field(init=False)
    pulse_width: float = field(init=False, default=0.0)
    _gains: tuple[tuple[int, Component, Component, Component], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        indices = axis_indices(self.axes)
        values = [
            numbers("hold stiffness", self.stiffness, at_least=0.0),
            numbers("hold damping", self.damping, at_least=0.0),
            numbers("hold target", self.target),
        ]
        split = [per_axis("hold parameter", value, len(indices)) for value in values]
        object.__setattr__(self, "batch", batch_shape("hold", values))
        object.__setattr__(self, "_gains", tuple(zip(indices, *split, strict=True)))

    @classmethod
    def critically_damped(
        cls,
        axes: str | Sequence[str] = AXES,
        *,
        inertia: ArrayLike,
        period: float,
        delay: float,
        target: ArrayLike = 0.0,
    ) -> Self:
        """Return a soft hold that keeps well clear of what period and delay allow.

        The natural frequency is 1/4 rad over the time from sample to sample and on to the force, at most
        50 rad/s, and the damping critical. That holds for any delay: the eigenvalues are in the tests.

        Args:
            axes: Names from AXES.
            inertia: Mass or moment of inertia on these axes [kg, kg m²].
            period: Sample period [s].
            delay: Transport delay [s].
            target: Pose held [m, rad].
        """
        reach = number("period", period, above=0.0) + number("delay", delay, at_least=0.0)
        frequency = min(50.0, 0.25 / reach)
        body = numbers("inertia", inertia, at_least=0.0)
        return cls(axes=axes, stiffness=body * frequency**2, damping=2.0 * body * frequency, target=target)

    def start(self) -> None:
        """Return the state before the first sample: a hold has none."""

    def __call__(
        self,
        position: Sequence[Component],
        velocity: Sequence[Component],
        state: None,
        wrench: list[Component],
    ) -> tuple[None, None]:
        """Answer one sample; see `Law`."""
        for axis, stiffness, damping, target in self._gains:
            wrench[axis] = wrench[axis] + (stiffness * (target - position[axis]) - damping * velocity[axis])
        return None, None
