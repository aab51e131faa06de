"""Extrema and crossings over frequency: grids that contain the frequencies of poles, then refined.

A peak of a lightly damped pole is narrower than the steps of any fixed grid. Every figure that is an extremum or a
crossing over frequency is found here. Frequencies are angles per sample [rad], 2 pi f T.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array

HIGHEST = 0.999 * np.pi
"""Largest angle of a grid: half the sample rate itself is of no signal."""

_LOWEST, _COUNT = 1e-4 * np.pi, 80
_BESIDE = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])
"""Angles beside a pole's own, in widths of its peak."""

_MAXIMA, _HALVINGS, _FINEST = 3, 14, 50
_ALIASES, _NEAR = 24, np.array([0.99, 1.0, 1.01])


def angles_of(poles: ArrayLike, grid: Array | None = None) -> Array:
    """Return a grid of angles that contains those of poles and of their peaks, ascending.

    Args:
        poles: Poles of each loop, (..., n).
        grid: Angles common to all, (F,); None for 0 and 80 others.

    Returns:
        The angles, (..., F + 5 n); some may be equal.
    """
    poles = np.asarray(poles)
    common = np.array([0.0, *np.geomspace(_LOWEST, HIGHEST, _COUNT)]) if grid is None else grid
    width = -np.log(np.clip(np.abs(poles), 1e-3, 1.0 - 1e-12))
    own = np.abs(np.angle(poles))[..., None] + width[..., None] * _BESIDE
    own = np.clip(own, common[0], common[-1]).reshape(*poles.shape[:-1], -1)
    return np.sort(np.concatenate([np.broadcast_to(common, (*own.shape[:-1], common.size)), own], axis=-1), axis=-1)


def aliases(frequency: float, low: float, high: float) -> Array:
    """Return the sample rates, and some beside each, at which a frequency lies at half the rate or at 0 [Hz]."""
    order = np.arange(1.0, min(math.floor(2.0 * frequency / low), _ALIASES) + 1.0)
    rates = np.outer(2.0 * frequency / order, _NEAR).ravel()
    return np.asarray(rates[(rates > low) & (rates < high)])


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
    for _ in range(_FINEST):
        middle = 0.5 * (low + high)
        positive = value(middle) > 0.0
        low, high = np.where(positive, middle, low), np.where(positive, high, middle)
    return np.asarray(np.where(over.any(axis=-1), high[..., 0], grid[..., -1]))


def _maxima(value: Callable[[Array], Array], grid: Array) -> tuple[Array, Array]:
    """Return angles and values of the highest maxima, refined, (..., 3) each."""
    values = value(grid)
    sides = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(1, 1)], constant_values=-np.inf)
    tops = np.where((values >= sides[..., :-2]) & (values >= sides[..., 2:]), values, -np.inf)
    index = np.argsort(-tops, axis=-1, kind="stable")[..., :_MAXIMA]
    middle, best = (np.take_along_axis(part, index, axis=-1) for part in (grid, values))
    wide = grid[..., None, :]
    # equal angles are one: its neighbours are the next others
    low = np.where(wide < middle[..., None], wide, grid[..., :1, None]).max(axis=-1)
    high = np.where(wide > middle[..., None], wide, grid[..., -1:, None]).min(axis=-1)
    for _ in range(_HALVINGS):
        left, right = 0.5 * (low + middle), 0.5 * (middle + high)
        tried = value(np.concatenate([left, right], axis=-1))
        one, other = tried[..., :_MAXIMA], tried[..., _MAXIMA:]
        to_left, to_right = (one > best) & (one >= other), (other > best) & (other > one)
        low, high = (
            np.where(to_left, low, np.where(to_right, middle, left)),
            np.where(to_right, high, np.where(to_left, middle, right)),
        )
        middle = np.where(to_left, left, np.where(to_right, right, middle))
        best = np.where(to_left, one, np.where(to_right, other, best))
    return middle, best
