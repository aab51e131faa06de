"""Passivity control: damping added whenever the rendered environment has given out more energy than it took in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from typing import TypeAlias

from numpy.typing import ArrayLike

from maglev_mj.frames import Component
from maglev_mj.laws.base import AxisLaw, gain
from maglev_mj.laws.friction import choose
from maglev_mj.parameters import number
from maglev_mj.timeline import MOST_PERIODS, split_delay

__all__ = ["PassivityController"]

_AxisState: TypeAlias = tuple[Component, Component, tuple[Component, ...]]
"""Energy taken in so far [J], position of the last sample, and forces up to it, newest first."""


class PassivityController(AxisLaw):
    """A law to put last: it watches the energy of what the laws before it have rendered, and damps what they make.

    The energy taken in over the last period is -f (x[k] - x[k-1]), its own damping included, with f the force then in
    effect, or the mean of two where a delay has them change in between. Where the sum is below 0, a damper is added
    that would dissipate the lack over one period at the present speed, up to `most`: more would not be stable under
    the delay. Without delay that makes any wall passive; a delay lets the damper come too late.

    Args:
        axes: Names from AXES; all six by default.
        period: Sample period [s].
        most: Largest damping added [N s/m, N m s/rad]; a number, one an axis, or (N, axes).
        delay: Transport delay [s].
        slow: Speed below which nothing is added [m/s, rad/s]: there the damper would have to be infinite.

    Raises:
        ParameterError: If a value is outside its bounds or a shape does not fit.

    Source: Hannaford & Ryu 2002, series controller in impedance causality; formula as quoted by others.
    """

    period: float
    most: ArrayLike = gain(unit="N s/m, N m s/rad")
    delay: float = 0.0
    slow: float = 1e-4

    _whole: int = field(init=False, repr=False)
    _rest: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        period = number("period", self.period, above=0.0)
        delay = number("delay", self.delay, at_least=0.0, at_most=MOST_PERIODS * period)
        whole, rest = split_delay(delay, period)
        object.__setattr__(self, "_whole", int(whole))
        object.__setattr__(self, "_rest", rest)
        number("slow", self.slow, above=0.0)

    def start(self) -> list[_AxisState]:
        """Return the state before the first sample."""
        return [(0.0, math.nan, (0.0,) * (self._whole + 2))] * len(self._each)

    def signals(self, state: Sequence[_AxisState]) -> dict[str, Sequence[Component]]:
        """Return energy: taken in so far [J]."""
        return {"energy": [one[0] for one in state]}

    def __call__(
        self,
        position: Sequence[Component],
        velocity: Sequence[Component],
        state: Sequence[_AxisState],
        wrench: list[Component],
    ) -> tuple[list[_AxisState], None]:
        """Answer one sample; see `Law`."""
        following: list[_AxisState] = []
        for (axis, gains), (energy, place, forces) in zip(self._each, state):
            most = gains.most
            now, rendered = position[axis], wrench[axis]
            moved = choose(place == place, now - place, 0.0 * now)  # no energy before the first sample
            share = self._rest / self.period
            energy = energy - (share * forces[-1] + (1.0 - share) * forces[-2]) * moved
            speed = velocity[axis]
            fast = (speed > self.slow) | (speed < -self.slow)
            power = self.period * speed * speed
            wanted = choose(fast & (energy < 0.0), -energy / (power + (power == 0.0)), 0.0 * now)
            added = choose(wanted < most, wanted, most + 0.0 * now)
            total = rendered - added * speed
            wrench[axis] = total
            following.append((energy, now, (total, *forces[:-1])))
        return following, None
