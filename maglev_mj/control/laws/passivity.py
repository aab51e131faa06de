"""Time-domain passivity control.

Damping is added while the rendered environment has given out more energy than it has absorbed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from typing import TypeAlias

from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import AxisLaw, gain
from maglev_mj.control.laws.friction import choose
from maglev_mj.control.timeline import MOST_PERIODS, split_delay
from maglev_mj.frames import Component
from maglev_mj.parameters import number

_AxisState: TypeAlias = tuple[Component, Component, tuple[Component, ...]]
"""Absorbed energy [J], last position, past forces.

The forces are newest first.
"""


class PassivityController(AxisLaw):
    """Time-domain passivity controller; must be the last law.

    It observes the energy rendered by the laws before it and dissipates any surplus.

    The energy absorbed over the last period is -f (x[k] - x[k-1]), its own damping included. f is the force in effect;
    with a delay, it is the weighted mean of the two forces in effect. While the sum is negative, a damper is added that
    would dissipate the deficit over one period at the present speed, up to `most`: more would not be stable under the
    delay. Without delay this makes any wall passive; with a delay the damper acts too late.

    Args:
        axes: Names from AXES; all six by default.
        period: Sample period [s].
        most: Largest damping added [N s/m, N m s/rad]; a number, one an axis, or (N, axes).
        delay: Transport delay [s].
        slow: Least speed for added damping [m/s, rad/s]: at lower speed the damper would tend to infinity.

    Raises:
        ParameterError: If a value is outside its bounds or a shape does not fit.

    Source: Hannaford & Ryu 2002, series controller in impedance causality; not checked against the original.
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
        """Return the absorbed energy [J] of each axis."""
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
