"""What a simulated plant says when it cannot go on."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from maglev_mj.errors import DivergenceError, PlantError
from maglev_mj.frames import AXES, Component, join

__all__ = ["escaped", "refusal"]


def refusal(force: Sequence[Component], tick: int, batch: tuple[int, ...], what: str = "a command") -> PlantError:
    """Return the error that names the first thing that is wrong with six components.

    Args:
        force: Components of a wrench, not finite or of a shape that does not fit [N, N m].
        tick: The sample that they answer.
        batch: Shape of the plant's batch.
        what: What to call them.
    """
    if len(force) != 6:
        return PlantError(f"{what} must have 6 components, not {len(force)}")
    wrench = join(force)
    if wrench.shape[:-1] not in ((), batch):
        return PlantError(f"{what} must have the batch shape {batch} of the plant, not {wrench.shape[:-1]}")
    place = tuple(np.argwhere(~np.isfinite(wrench))[0])
    device = f", device {place[:-1]}" if len(place) > 1 else ""
    name = what.removeprefix("a ")
    return PlantError(f"{name} at tick {tick} must be finite, not {wrench[place]:g} along {AXES[place[-1]]}{device}")


def escaped(
    distance: Component, angle: Component, bounds: tuple[float, float], at: Component, batch: tuple[int, ...]
) -> DivergenceError:
    """Return the error that names the first flotor far outside its range.

    Args:
        distance: Squares of the distances from the centre [m²].
        angle: Squares of the angles [rad²].
        bounds: Squares of the bounds of both.
        at: When [s].
        batch: Shape of the plant's batch.
    """
    far, turned, time = np.broadcast_arrays(np.sqrt(distance), np.sqrt(angle), at)
    out = ~((far**2 < bounds[0]) & (turned**2 < bounds[1]))
    place = tuple(np.argwhere(out)[0]) if out.ndim else ()
    device = f" (device {', '.join(map(str, place))} of {batch})" if place else ""
    return DivergenceError(
        f"the flotor is {far[place]:.3g} m and {turned[place]:.3g} rad from its centre "
        f"at {time[place]:.4g} s{device}; a run has diverged beyond "
        f"{math.sqrt(bounds[0]):.3g} m or {math.sqrt(bounds[1]):.3g} rad"
    )
