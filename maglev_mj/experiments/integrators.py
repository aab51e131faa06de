"""What an integrator's step does to stability: the boundary of the loop as MuJoCo simulates it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.parameters import flag, number
from maglev_mj.plants import INTEGRATORS, one_step
from maglev_mj.sampled import SampledLoop
from maglev_mj.spec import Spec
from maglev_mj.stability import StiffestWall, stiffest_of

__all__ = ["INTEGRATORS", "SteppedLoop", "stiffest_simulated"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SteppedLoop(SampledLoop):
    """A sampled loop whose flotor moves as an integrator has it.

    The map of one step is measured on the drop model along z, without gravity; the rest is the exact loop. The
    delay is within one period, and there is neither hand nor driver lag.

    Args:
        integrator: One of `INTEGRATORS`, or "corrected" for Euler's with its half-step correction.
        step: Longest time step [s].
        aligned: True ends a step at each switch of the force, in equal steps; False steps at a fixed step, and the
            new command is first seen by the step that begins after it takes effect, as in a plain simulation loop.
    """

    integrator: str = "rk4"
    step: float = 1e-3
    aligned: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        flag("aligned", self.aligned)

    def flotor(self) -> tuple[Array, Array, Array, Array, int]:
        """See `SampledLoop`."""
        period, delay = float(np.asarray(self.period)), float(np.asarray(self.delay))
        longest = number("step", self.step, above=0.0, at_most=period)
        number("delay", delay, at_most=period)
        if self.aligned:
            before = max(math.ceil(delay / longest - 1e-9), 0)
            after = max(math.ceil((period - delay) / longest - 1e-9), 0)
            first = delay / before if before else longest
            second = (period - delay) / after if after else longest
        else:
            steps = math.ceil(period / longest - 1e-9)
            first = second = period / steps
            before = math.ceil(delay / first - 1e-9)
            after = steps - before
        early, old = self._steps(first, before)
        late, new = self._steps(second, after)
        whole = np.asarray(0.0)
        if after == 0:  # a full period of delay: the command before is all there is
            return early, old, old, np.asarray(1.0), 1
        return late @ early, late @ old, new, whole, int(before > 0)

    def _steps(self, step: float, count: int) -> tuple[Array, Array]:
        """Return the map of some steps and the share of a force that acts throughout."""
        return _steps(self.integrator, float(np.asarray(self.mass)), step, count)


@lru_cache(maxsize=256)
def _steps(integrator: str, mass: float, step: float, count: int) -> tuple[Array, Array]:
    one, push = one_step("euler" if integrator == "corrected" else integrator, mass, step)
    if integrator == "corrected":  # the position goes back by half a step of the speed gained
        one[0] -= 0.5 * step * (one[1] - [0.0, 1.0])
        push[0] -= 0.5 * step * push[1]
    total, share = np.eye(2), np.zeros(2)
    for _ in range(count):
        total, share = one @ total, one @ share + push
    return total, share


def stiffest_simulated(
    integrator: str,
    step: float,
    *,
    period: float,
    delay: float,
    mass: float = Spec.moving_mass.value,
    aligned: bool = True,
) -> StiffestWall:
    """Return the stiffest wall that a simulation with this integrator and step takes for stable.

    Args:
        integrator: As for `SteppedLoop`.
        step: Longest time step [s].
        period: Sample period [s].
        delay: Transport delay [s], up to a period.
        mass: Moving mass [kg].
        aligned: See `SteppedLoop`.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    return stiffest_of(
        SteppedLoop(period=period, delay=delay, mass=mass, integrator=integrator, step=step, aligned=aligned)
    )
