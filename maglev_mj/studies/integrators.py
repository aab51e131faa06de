"""Effect of an integrator's step on stability.

It is the stability boundary of the loop as simulated by MuJoCo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.hand import Hand
from maglev_mj.parameters import flag, number
from maglev_mj.plants import INTEGRATORS, one_step
from maglev_mj.theory.boundary import stiffest_of
from maglev_mj.theory.closed_loop import SampledLoop
from maglev_mj.timeline import split_delay

__all__ = ["INTEGRATORS", "SteppedLoop", "boundary_shift"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SteppedLoop(SampledLoop):
    """Sampled loop with the flotor moved by an integrator.

    The map of one step is measured on the drop model along z, without gravity; the rest is the exact loop.

    Args:
        integrator: One of `INTEGRATORS`.
        step: Longest time step [s].
        aligned: True ends a step at each switch of the force, in equal steps; False uses a fixed step, and a new
            command acts from the first step that begins after its time, as in a plain simulation loop.
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
        whole, rest = map(float, split_delay(delay, period))
        if self.aligned:
            before = max(math.ceil(rest / longest - 1e-9), 0)
            after = max(math.ceil((period - rest) / longest - 1e-9), 0)
            first = rest / before if before else longest
            second = (period - rest) / after if after else longest
        else:
            steps = math.ceil(period / longest - 1e-9)
            first = second = period / steps
            before = math.ceil(rest / first - 1e-9)
            after = steps - before
        early, held = self._steps(first, before)
        late, new = self._steps(second, after)
        phi, old = late @ early, late @ held
        if self.integrator == "corrected":  # at the sample the position goes back by half a step of the speed gained
            new = new - 0.5 * second * new[1] * _PLACE[: len(new)]
            old = old - 0.5 * (first * held[1] + second * (old[1] - held[1])) * _PLACE[: len(old)]
            before_it = np.eye(len(phi))[1]
            gained = first * (early[1] - before_it) + second * (phi[1] - early[1])
            phi = phi - 0.5 * np.outer(_PLACE[: len(phi)], gained)
        return phi, old, new, np.asarray(whole), int(whole) + int(before > 0)

    def _steps(self, step: float, count: int) -> tuple[Array, Array]:
        """Return the transition of several steps and the force's share.

        The force acts throughout the steps.
        """
        lags = self.driver_lag > 0.0
        return _steps(self.integrator, float(np.asarray(self.mass)), step, count, self.hand, lags)


_PLACE = np.eye(5)[0]


@lru_cache(maxsize=256)
def _steps(integrator: str, mass: float, step: float, count: int, hand: Hand | None, lags: bool) -> tuple[Array, Array]:
    one, push = one_step(integrator, mass, step, hand, lags)
    total, share = np.eye(len(push)), np.zeros(len(push))
    for _ in range(count):
        total, share = one @ total, one @ share + push
    return total, share


def boundary_shift(integrator: str, step: float, loop: SampledLoop, *, aligned: bool = True) -> float:
    """Return the relative shift of the stiffest wall.

    It is the shift by an integrator and its step.

    Args:
        integrator: As for `SteppedLoop`; 0 for "exact" and "closed form".
        step: Longest time step [s].
        loop: The loop itself: period, delay, mass, hand and lag of the model's drivers.
        aligned: See `SteppedLoop`.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    flag("aligned", aligned)
    if integrator in ("exact", "closed form"):
        return 0.0
    stepped = SteppedLoop(
        period=loop.period,
        delay=loop.delay,
        mass=loop.mass,
        hand=loop.hand,
        driver_lag=loop.driver_lag,
        integrator=integrator,
        step=step,
        aligned=aligned,
    )
    return float(stiffest_of(stepped).stiffness) / _stiffest(loop) - 1.0


@lru_cache(maxsize=16)
def _stiffest(loop: SampledLoop) -> float:
    return float(stiffest_of(loop).stiffness)
