"""Hold of a pose by PD control, and a constant wrench."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import AxisLaw, Gains, Law, gain
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component
from maglev_mj.parameters import axis_indices, number, numbers, per_axis, store
from maglev_mj.spec import INERTIA


class Hold(AxisLaw):
    """PD hold of a target pose.

    f = stiffness (target - x) - damping v.

    Each parameter is a number for all of the law's axes, one number an axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        stiffness: Stiffness [N/m, N m/rad].
        damping: Damping [N s/m, N m s/rad].
        target: Target pose [m, rad].

    Raises:
        ParameterError: If a gain is negative, or a value is not finite or of the wrong shape.

    Example:
        >>> from maglev_mj import Controller, Hold, Sample
        >>> hold = Hold(axes=["x", "y"], stiffness=3000.0, damping=30.0)
        >>> Controller([hold], period=0.005).step(Sample(0, 0.0, [1e-3, 0, 0, 0, 0, 0])).force[0]
        -3.0
    """

    stiffness: ArrayLike = gain(unit="N/m, N m/rad")
    damping: ArrayLike = gain(unit="N s/m, N m s/rad")
    target: ArrayLike = gain(unit="m, rad", default=0.0, at_least=-math.inf)

    _gains: tuple[tuple[int, Component, Component, Component], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, _gains=tuple((axis, one.stiffness, one.damping, one.target) for axis, one in self._each))

    @classmethod
    def critically_damped(
        cls,
        axes: str | Sequence[str] = AXES,
        *,
        period: float,
        delay: float,
        inertia: ArrayLike | None = None,
        target: ArrayLike = 0.0,
    ) -> Self:
        """Return a critically damped hold with wide stability margin.

        The natural frequency is 1/4 rad over the time from sample to sample and on to the force, at most
        50 rad/s. It is stable for any delay; the tests check the eigenvalues.

        Args:
            axes: Names from AXES.
            period: Sample period [s].
            delay: Transport delay [s].
            inertia: Mass or moment of inertia on these axes [kg, kg m²]; the published device's by default.
            target: Pose held [m, rad].
        """
        reach = number("period", period, above=0.0) + number("delay", delay, at_least=0.0)
        frequency = min(50.0, 0.25 / reach)
        body = (
            np.array(INERTIA)[list(axis_indices(axes))]
            if inertia is None
            else numbers("inertia", inertia, at_least=0.0)
        )
        return cls(axes=axes, stiffness=body * frequency**2, damping=2.0 * body * frequency, target=target)

    def __call__(
        self, position: Sequence[Component], velocity: Sequence[Component], state: Any, wrench: list[Component]
    ) -> tuple[Any, None]:
        """Answer one sample; see `Law`.

        Written out for speed: calling `force` for each axis takes a quarter of the tick more.
        """
        for axis, stiffness, damping, target in self._gains:
            wrench[axis] = wrench[axis] + (stiffness * (target - position[axis]) - damping * velocity[axis])
        return state, None

    def gains(self) -> Iterable[Gains]:
        """Return stiffness and damping, always in effect."""
        return (Gains("always", self.on_axes(self.stiffness), self.on_axes(self.damping)),)


@dataclass(frozen=True, eq=False)
class Bias(Law):
    """Constant wrench added to the other laws.

    Args:
        wrench: The wrench [N, N m], (..., 6).

    Raises:
        ParameterError: If the wrench is not finite, or its last dimension is not six.

    Example:
        >>> from maglev_mj import Bias, Controller, Sample
        >>> weight = Bias([0.0, 0.0, 0.7 * 9.81, 0.0, 0.0, 0.0])
        >>> round(Controller([weight], period=0.005).step(Sample(0, 0.0, [0.0] * 6)).force[2], 3)
        6.867
    """

    per_device: ClassVar[Sequence[str]] = ("wrench",)

    wrench: ArrayLike

    batch: tuple[int, ...] = field(init=False)
    _parts: tuple[Component, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        wrench = numbers("bias wrench", self.wrench)
        if wrench.shape[-1:] != (len(AXES),):
            raise ParameterError(f"bias wrench must be (..., 6), not {wrench.shape}")
        store(self, batch=wrench.shape[:-1], _parts=per_axis("bias wrench", wrench, len(AXES)))

    def __call__(
        self, position: Sequence[Component], velocity: Sequence[Component], state: None, wrench: list[Component]
    ) -> tuple[None, None]:
        """Answer one sample; see `Law`."""
        for axis, part in enumerate(self._parts):
            wrench[axis] = wrench[axis] + part
        return None, None

    def gains(self) -> Iterable[Gains]:
        """Return no gains.

        A constant wrench has neither stiffness nor damping.
        """
        return ()

    def carried(self) -> Array:
        """Return the wrench [N, N m], (..., 6)."""
        return np.asarray(self.wrench, dtype=np.float64)
