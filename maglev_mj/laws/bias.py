"""Constant wrench, such as the compensation of the flotor's weight."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component
from maglev_mj.laws.base import Gains, Law
from maglev_mj.parameters import numbers, per_axis


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
        object.__setattr__(self, "batch", wrench.shape[:-1])
        object.__setattr__(self, "_parts", per_axis("bias wrench", wrench, len(AXES)))

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
