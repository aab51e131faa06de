"""Passivity control: damping added whenever the rendered environment has given out more energy than it took in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from numpy.typing import ArrayLike

from maglev_mj.frames import AXES, Component
from maglev_mj.laws.friction import choose
from maglev_mj.parameters import axis_indices, batch_shape, number, numbers, per_axis

__all__ = ["PassivityController"]

_AxisState: TypeAlias = tuple[Component, Component, Component]
"""Energy taken in so far [J], position and force of the last sample."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PassivityController:
    """A law to put last: it watches the energy of what the laws before it have rendered, and damps what they make.

    At each sample the energy taken in over the last period is -f[k-1] (x[k] - x[k-1]), which is what a hold without
    delay exchanges, its own damping included. Where the sum is below 0, a damper is added that would dissipate the
    lack over one period at the present speed, up to `most`: more would not be stable under the delay.

    Args:
        axes: Names from AXES; all six by default.
        period: Sample period [s].
        most: Largest damping added [N s/m, N m s/rad]; a number, one an axis, or (N, axes).
        slow: Speed below which nothing is added [m/s, rad/s]: there the damper would have to be infinite.

    Raises:
        ParameterError: If a value is outside its bounds or a shape does not fit.

    Source: Hannaford & Ryu 2002, series controller in impedance causality; formula as quoted by others.
    """

    axes: str | Sequence[str] = AXES
    period: float
    most: ArrayLike
    slow: float = 1e-4

    batch: tuple[int, ...] = field(init=False)
    pulse_width: float = field(init=False, default=0.0)
    _limits: tuple[tuple[int, Component], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        indices = axis_indices(self.axes)
        most = numbers("most", self.most, at_least=0.0)
        number("period", self.period, above=0.0)
        number("slow", self.slow, above=0.0)
        object.__setattr__(self, "batch", batch_shape("passivity controller", [most]))
        object.__setattr__(self, "_limits", tuple(zip(indices, per_axis("most", most, len(indices)), strict=True)))

    def start(self) -> list[_AxisState]:
        """Return the state before the first sample."""
        return [(0.0, math.nan, 0.0)] * len(self._limits)

    def __call__(
        self,
        position: Sequence[Component],
        velocity: Sequence[Component],
        state: Sequence[_AxisState],
        wrench: list[Component],
    ) -> tuple[list[_AxisState], None]:
        """Answer one sample; see `Law`. The first entry of each axis's state is its energy."""
        following: list[_AxisState] = []
        for (axis, most), (energy, place, force) in zip(self._limits, state):
            now, rendered = position[axis], wrench[axis]
            moved = choose(place == place, now - place, 0.0 * now)  # no energy before the first sample
            energy = energy - force * moved
            speed = velocity[axis]
            fast = (speed > self.slow) | (speed < -self.slow)
            power = self.period * speed * speed
            wanted = choose(fast & (energy < 0.0), -energy / (power + (power == 0.0)), 0.0 * now)
            added = choose(wanted < most, wanted, most + 0.0 * now)
            total = rendered - added * speed
            wrench[axis] = total
            following.append((energy, now, total))
        return following, None
