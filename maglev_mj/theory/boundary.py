"""Stability boundary over the gains.

It is the largest stiffness up to which every wall is stable; stable ranges beyond it are islands.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.parameters import common_shape, number, numbers
from maglev_mj.theory.characteristic import SampledCurve, characteristic, crossings, scales
from maglev_mj.theory.closed_loop import ROUNDING, LoopKeywords, SampledLoop, is_stable

__all__ = [
    "StiffestWall",
    "boundary_of",
    "first_end",
    "flattened",
    "largest_stable_stiffness",
    "ranges_of",
    "spans",
    "stable_ranges",
    "stiffest_of",
    "stiffest_wall",
]

_HIGHEST = 8.0
_NEAR = 1e-7
_LOWEST, _APART = 8e-4, 1e-9
_CLOSE = np.array([-1e-4, -2e-7, 2e-7, 1e-4])
_EVEN = np.array([0.0, 0.3, 0.7, 1.0])
_GRID = np.geomspace(_LOWEST, _HIGHEST, 60)


class StiffestWall(NamedTuple):
    """Largest stable stiffness [N/m] and its damping [N s/m].

    (...,) each.
    """

    stiffness: Array
    damping: Array


def flattened(loop: SampledLoop, damping: Array) -> tuple[SampledLoop, Array, tuple[int, ...]]:
    """Return loop and dampings flattened to N, and their shape."""
    shape = common_shape("damping and loop", damping.shape, loop.shape)
    return loop.part(shape, slice(None)), np.broadcast_to(damping, shape).reshape(-1), shape


def spans(loop: SampledLoop, damping: Array, limit: float) -> tuple[Array, Mask]:
    """Return stiffness ranges of constant verdict, and their verdicts.

    Range edges are (N, c + 1), verdicts (N, c).

    Args:
        loop: One loop, or N of them.
        damping: (N,).
        limit: Largest modulus allowed.
    """
    stiff, damp = scales(loop)
    crossed = np.minimum(crossings(characteristic(loop, limit), damping / damp), _HIGHEST)
    edges = np.pad(crossed, ((0, 0), (1, 1)), constant_values=(0.0, _HIGHEST))
    edges = edges * np.broadcast_to(stiff, damping.shape)[:, None]
    low, high = edges[:, :-1], edges[:, 1:]
    rows, place = np.nonzero(high > low)
    good = np.zeros(low.shape, dtype=bool)
    middle = 0.5 * (low + high)[rows, place]
    good[rows, place] = is_stable(loop.part(damping.shape, rows).modulus(middle, damping[rows]), limit)
    return edges, good


def ranges_of(loop: SampledLoop, damping: float, limit: float = 1.0) -> list[tuple[float, float]]:
    """Return all stable stiffness ranges for any SampledLoop.

    See `stable_ranges`.
    """
    if loop.shape:
        raise ParameterError(f"loop must be one, not {loop.shape}")
    limit = number("limit", limit, above=0.0, at_most=1.0)
    edges, good = spans(loop, numbers("damping", [damping], at_least=0.0), limit)
    ranges: list[tuple[float, float]] = []
    for low, high, inside in zip(edges[0], edges[0, 1:], good[0]):
        if inside and high > low:
            joined = ranges and ranges[-1][1] == low
            ranges[-1:] = [(ranges[-1][0], float(high))] if joined else [*ranges[-1:], (float(low), float(high))]
    return ranges


def stable_ranges(damping: float, *, limit: float = 1.0, **loop: Unpack[LoopKeywords]) -> list[tuple[float, float]]:
    """Return all stable stiffness ranges at one damping.

    The first begins at 0 unless no soft wall is stable; any other is an island, beyond unstable walls.

    Args:
        damping: Wall damping [N s/m].
        limit: Largest modulus allowed; 1 for stability.
        loop: Keywords of `SampledLoop`, each a number.

    Returns:
        Lower and upper end of each range [N/m], ascending, at most 8 m/T².

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    return ranges_of(SampledLoop(**loop), damping, limit)


@overload
def largest_stable_stiffness(damping: ArrayLike, **loop: Unpack[LoopKeywords]) -> Array: ...


@overload
def largest_stable_stiffness(damping: None = None, **loop: Unpack[LoopKeywords]) -> StiffestWall: ...


def largest_stable_stiffness(damping: ArrayLike | None = None, **loop: Unpack[LoopKeywords]) -> Array | StiffestWall:
    """Return the largest stiffness with all softer walls stable [N/m].

    An island of stable walls beyond unstable ones does not count (see `stable_ranges`).

    Args:
        damping: Wall damping [N s/m], (...,); None searches over all of them.
        loop: Keywords of `SampledLoop`; they broadcast with the damping.

    Returns:
        The stiffness (...,), 0 if no soft wall is stable, and 8 m/T² at most; for `damping=None` stiffness and
        damping.

    Raises:
        ParameterError: If a value is outside its bounds.

    Example:
        >>> from maglev_mj import largest_stable_stiffness
        >>> delays = [0.0015, 0.004]
        >>> largest_stable_stiffness(80.0, period=0.005, delay=delays, mass=0.7).round().tolist()
        [10107.0, 4831.0]
    """
    if damping is None:
        return stiffest_wall(**loop)
    return boundary_of(SampledLoop(**loop), numbers("damping", damping, at_least=0.0))


def boundary_of(loop: SampledLoop, damping: Array) -> Array:
    """Return the largest stable stiffness for any SampledLoop [N/m].

    See `largest_stable_stiffness`.
    """
    flat, b, shape = flattened(loop, damping)
    edges, good = spans(flat, b, 1.0)
    rough, first = first_end(edges, good)
    wide, b = flat.widened(), b[:, None]
    # the crossing is exact to rounding except for a slow one; the eigenvalues decide
    ends = rough[:, None] * [1.0 - _NEAR, 1.0 + _NEAR]
    moduli = wide.modulus(ends, b)
    verdicts = is_stable(moduli)
    apart = 0.5 * (edges[:, :-1] + edges[:, 1:])
    rows = np.arange(len(edges))
    last = np.minimum(first, apart.shape[-1] - 1)
    low = np.where(verdicts[:, 0], ends[:, 0], apart[rows, np.maximum(last - 1, 0)])
    high = np.where(verdicts[:, 1], apart[rows, last], ends[:, 1])
    found = (first > 0) & (first < good.shape[-1])
    while (found & (high - low > 1e-13 * high)).any():
        # closely around the point of modulus 1 by linear interpolation; evenly, because the modulus is not linear
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = (1.0 - ROUNDING - moduli[:, 0]) / (moduli[:, -1] - moduli[:, 0])
        shares = np.where(np.isfinite(crossing), crossing, 0.5)[:, None] + _CLOSE
        shares = np.sort(np.concatenate([np.clip(shares, 0.0, 1.0), np.tile(_EVEN, (rows.size, 1))], axis=1))
        middle = low[:, None] + (high - low)[:, None] * shares
        moduli = wide.modulus(middle, b)
        steady = is_stable(moduli[:, 1:-1])
        # the part that ends with the first unstable one; the upper end is always unstable
        part = np.where(steady.all(axis=-1), steady.shape[-1], np.argmin(steady, axis=-1))
        low, high = middle[rows, part], middle[rows, part + 1]
        moduli = np.stack([moduli[rows, part], moduli[rows, part + 1]], axis=-1)
    return np.where(found, low, rough).reshape(shape)


def first_end(edges: Array, good: Mask) -> tuple[Array, Array]:
    """Return the end of the first stable range, (N,).

    The index of the first unstable part is returned too.
    """
    good = good | (edges[:, 1:] <= edges[:, :-1])
    first = np.where(good.all(axis=-1), good.shape[-1], np.argmin(good, axis=-1))
    return edges[np.arange(len(edges)), first], first


def stiffest_wall(**loop: Unpack[LoopKeywords]) -> StiffestWall:
    """Return the largest stable stiffness over all dampings.

    Its damping is returned too.

    Args:
        loop: Keywords of `SampledLoop`.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    return stiffest_of(SampledLoop(**loop))


def stiffest_of(loop: SampledLoop) -> StiffestWall:
    """Return the stiffest wall for any SampledLoop.

    See `stiffest_wall`.
    """
    found = [_stiffest(loop.part(loop.shape, index)) for index in range(math.prod(loop.shape))]
    stiffness, damping = np.array(found).reshape(*loop.shape, 2).transpose(-1, *range(len(loop.shape)))
    return StiffestWall(stiffness, damping)


def _stiffest(loop: SampledLoop) -> tuple[float, float]:
    """Return stiffness and damping of one loop's stiffest wall.

    The boundary over the damping can have its maximum at a smooth maximum of the explicit curve, a fold of it, its
    intersection with the line of z = -1, or an end of the range. Two parts of the curve may also cross; crossings are
    searched between the other points. All are found by samples of the curve to about 1e-8; the eigenvalues decide.
    """
    unit = float(scales(loop)[1])
    curve = SampledCurve(characteristic(loop, 1.0))
    places = np.array([damping for damping in curve.extremes if _LOWEST < damping < _HIGHEST])
    sides = np.outer(1.0 + _APART * np.array([-1.0, 0.0, 1.0]), places).ravel()
    dampings, low, high = _GRID, _LOWEST, _HIGHEST
    while True:
        # a fold or a corner is found only at its exact damping
        dampings = np.unique([*dampings, *sides[(low <= sides) & (sides <= high)]])
        stiffness = np.minimum(curve.reach(dampings), _HIGHEST)
        stiffness[np.isin(dampings, places)] *= 1.0 + 1e-12
        level = np.flatnonzero(stiffness >= stiffness.max() * (1.0 - 1e-14))
        best = dampings[level[len(level) // 2]]
        low = dampings[dampings < best * (1.0 - 10.0 * _APART)].max(initial=low)
        high = dampings[dampings > best * (1.0 + 10.0 * _APART)].min(initial=high)
        if high - low <= 60.0 * _APART * high:
            return float(boundary_of(loop, np.asarray(best * unit))), float(best * unit)
        dampings = np.linspace(low, high, 33)
