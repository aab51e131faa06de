"""Extrema and crossings over frequency: grids that contain the frequencies of poles, then refined.

A peak of a lightly damped pole is narrower than the steps of any fixed grid. Every figure that is an extremum or a
crossing over frequency is found here. Frequencies are angles per sample [rad], 2 pi f T.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array

HIGHEST = 0.999 * np.pi
"""Largest angle of a grid: half the sample rate itself is of no signal."""

_LOWEST_ANGLE, _ANGLES_OF_GRID = 1e-4 * np.pi, 80
"""Lowest angle of a grid above 0, and number of angles: 20 a decade, as narrower peaks are those of poles."""
_BESIDE_PEAK = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])
"""Angles beside a pole's own, in widths of its peak."""
_MAXIMA_REFINED = 3
"""Maxima that are refined: of several of almost equal height, the grid may show another one as the highest."""
_STEPS_OF_MAXIMUM, _STEPS_OF_CROSSING = 14, 50
"""Halvings of an interval: with a maximum, to 1e-8 of the height's change, and with a crossing, to rounding."""


def angles_of(poles: ArrayLike, grid: Array | None = None) -> Array:
    """Return a grid of angles that contains those of poles and of their peaks, ascending.

    Args:
        poles: Poles of each loop, (..., n).
        grid: Angles common to all, (F,); None for 0 and 80 others.

    Returns:
        The angles, (..., F + 5 n); some may be equal.
    """
    poles = np.asarray(poles)
    common = np.array([0.0, *np.geomspace(_LOWEST_ANGLE, HIGHEST, _ANGLES_OF_GRID)]) if grid is None else grid
    width = -np.log(np.clip(np.abs(poles), 1e-3, 1.0 - 1e-12))
    own = np.abs(np.angle(poles))[..., None] + width[..., None] * _BESIDE_PEAK
    own = np.clip(own, common[0], common[-1]).reshape(*poles.shape[:-1], -1)
    return np.sort(np.concatenate([np.broadcast_to(common, (*own.shape[:-1], common.size)), own], axis=-1), axis=-1)


def peak(value: Callable[[Array], Array], grid: Array) -> tuple[Array, Array]:
    """Return the angle and the height of the highest peak of each loop, (...,) each.

    The three highest maxima on the grid are refined.

    Args:
        value: Function of angles (..., M) that returns values (..., M).
        grid: Ascending angles, (..., F); see `angles_of`.
    """
    angles, heights = _maxima(value, grid)
    best = np.argmax(heights, axis=-1)[..., None]
    return np.take_along_axis(angles, best, axis=-1)[..., 0], np.take_along_axis(heights, best, axis=-1)[..., 0]


def first_crossing(value: Callable[[Array], Array], grid: Array) -> Array:
    """Return the first angle at which a value falls to 0, (...,); that of the end without one.

    Args:
        value: Function of angles (..., M) that returns values (..., M).
        grid: Ascending angles, (..., F); see `angles_of`.
    """
    dips, _ = _maxima(lambda angles: -value(angles), grid)
    grid = np.sort(np.concatenate([grid, dips], axis=-1), axis=-1)
    over = ~(value(grid) > 0.0)
    index = np.where(over.any(axis=-1), np.argmax(over, axis=-1), grid.shape[-1] - 1)[..., None]
    high, low = (np.take_along_axis(grid, np.maximum(index - back, 0), axis=-1) for back in (0, 1))
    for _ in range(_STEPS_OF_CROSSING):
        middle = 0.5 * (low + high)
        positive = value(middle) > 0.0
        low, high = np.where(positive, middle, low), np.where(positive, high, middle)
    return np.asarray(np.where(over.any(axis=-1), high[..., 0], grid[..., -1]))


def _maxima(value: Callable[[Array], Array], grid: Array) -> tuple[Array, Array]:
    """Return angles and values of the highest maxima, refined, (..., 3) each."""
    values = value(grid)
    sides = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(1, 1)], constant_values=-np.inf)
    tops = np.where((values >= sides[..., :-2]) & (values >= sides[..., 2:]), values, -np.inf)
    index = np.argsort(-tops, axis=-1, kind="stable")[..., :_MAXIMA_REFINED]
    middle, best = (np.take_along_axis(part, index, axis=-1) for part in (grid, values))
    wide = grid[..., None, :]
    # equal angles are one: its neighbours are the next others
    low = np.where(wide < middle[..., None], wide, grid[..., :1, None]).max(axis=-1)
    high = np.where(wide > middle[..., None], wide, grid[..., -1:, None]).min(axis=-1)
    for _ in range(_STEPS_OF_MAXIMUM):
        left, right = 0.5 * (low + middle), 0.5 * (middle + high)
        tried = value(np.concatenate([left, right], axis=-1))
        one, other = tried[..., :_MAXIMA_REFINED], tried[..., _MAXIMA_REFINED:]
        to_left, to_right = (one > best) & (one >= other), (other > best) & (other > one)
        low, high = (
            np.where(to_left, low, np.where(to_right, middle, left)),
            np.where(to_right, high, np.where(to_left, middle, right)),
        )
        middle = np.where(to_left, left, np.where(to_right, right, middle))
        best = np.where(to_left, one, np.where(to_right, other, best))
    return middle, best
