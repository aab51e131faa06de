"""Stability boundary over the gains, and the damping that makes a wall passive.

The boundary is the critical stiffness: all softer walls are stable. Stable ranges above it are islands.

The characteristic polynomial of a wall's closed loop is linear in the gains, p0(z) + k p1(z) + b p2(z), for PD with any
linear velocity estimate or prediction. For an eigenvalue on the unit circle, z = exp(i theta), it gives two real
equations, so k and b are explicit in theta: ratios of polynomials in x = cos theta. At a fixed damping, the stiffnesses
at which a pole crosses the circle are the roots of one such polynomial, so none is missed. A circle of another radius
gives the boundary for a margin.

Passivity needs damping of the device itself. The levitated flotor has almost none, so no wall on it is passive, but
many are stable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control.timeline import split_delay
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask, unit_of
from maglev_mj.keywords import checked
from maglev_mj.parameters import common_shape, number, numbers
from maglev_mj.plants.hand import Mode
from maglev_mj.spec import MAX_DELAY_PERIODS, MIN_PERIOD
from maglev_mj.theory.delay import LEAST_ANGLE, ROUNDING
from maglev_mj.theory.frequencies import angles_of, peak
from maglev_mj.theory.loop_array import (
    Design,
    LoopArray,
    LoopKeywords,
    bisect,
    is_stable,
    pd,
    rendered_stiffness,
    sampled_fields,
)

# Units: stiffness in m/T², damping in m/T, angles of the unit circle in rad.
# -- ranges of the searches
_MOST_STIFFNESS, _MOST_BESIDE_DEVICE_LAW = 8.0, 64.0
"""Largest stiffness searched: no wall of a free mass is stable above 8; a damper on the device allows more."""
_LEAST_OF_GRID = 8e-5
"""Least damping, or stiffness, of a grid: softer walls are 1e-5 of the largest."""
_DAMPING_GRID = np.array([0.0, *np.geomspace(_LEAST_OF_GRID, _MOST_STIFFNESS, 720)])
_EVERY_NTH = 8
"""Every so many points of that grid are enough where the boundary is a single hill."""
_PASSIVITY_ANGLES = np.geomspace(1e-5, np.pi, 1000)

# -- a stiffest wall
_ROUGH_ACCURACY, _FINE_ACCURACY = 1e-5, 1e-7
"""Relative width of damping at which a search for a maximum ends, before and after refinement by eigenvalues."""
_POINTS_OF_REFINEMENT, _FLAT_PEAK = 16, 1e-10
"""Points of each refinement, and relative difference below which heights are rounding."""
_AROUND_PEAK, _BESIDE_PEAK = 1e-2 * np.linspace(-1.0, 1.0, 9), 1e-6 * np.linspace(-1.0, 1.0, 5)
"""Relative offsets by which a rough maximum is refined, and at which a jump of the boundary is looked for."""
_JUMP = 1e-3
"""Relative fall within `_BESIDE_PEAK` that is a jump; documented in `StiffestWall`."""

# -- crossings of the unit circle
_GAIN_PAIRS = np.array([[0.0, 1.0, 0.0, 2.0], [0.0, 0.0, 1.0, 2.0]])
"""Stiffnesses and dampings at which a polynomial that is linear in both is read; the last pair tests that it is."""
_STEP_OF_TURN, _MOST_TURNS, _BESIDE_POLE = 0.25, 300.0, 40
"""Angle step of a delayed loop as a share of a turn, turns covered, and steps to either side of a pole of its own."""
_MOST_CROSSINGS, _MOST_STEPS = 6, 60
"""Crossings kept for each damping, and most steps of the Illinois method."""
_SCAN_POINTS, _SCAN_HALVINGS = 240, 40
"""Stiffnesses of a scan where no polynomial is known, and bisections of a change: to rounding."""
_BESIDE_ROUGH = np.array([-1e-4, -1e-7, 1e-7, 1e-4])
_BESIDE_INTERPOLATED, _EVEN_SHARES = np.array([-1e-4, -2e-7, 2e-7, 1e-4]), np.array([0.0, 0.3, 0.7, 1.0])
"""Offsets at which a crossing is bracketed by eigenvalues: relative; as shares of the bracket, and even ones."""

# -- what counts as zero
_EQUAL_RADII = 2e-15
"""Difference of two spectral radii that is rounding."""
_LEAST_STIFFNESS, _ZERO_STIFFNESS, _ZERO_COEFFICIENT = 1e-9, 1e-11, 1e-10
"""Least stiffness that is called stable, that of a crossing above 0, and least coefficient relative to the largest."""

# -- rates beside a flexible mode
_FASTEST_OF_MODE, _COARSE_RATES, _FINE_RATES, _RATE_HALVINGS = 20.0, 25, 16, 8
"""Highest rate as a multiple of the mode's frequency; walls up to it, rates between two, bisections of a change."""
_MOST_ALIASES, _BESIDE_ALIAS = 12, np.linspace(-0.03, 0.03, 25)
"""Aliases of a mode that are tried, and relative offsets beside each: unstable ranges of rates are narrow there."""


class StiffestWall(NamedTuple):
    """Largest stable stiffness over all dampings, with its damping, (...,) each.

    Attributes:
        stiffness: The stiffness [N/m]; 0 if no wall is stable.
        damping: Its damping [N s/m]; 0 if no wall is stable.
        on_jump: True if the stiffness falls by 0.1 % or more at a damping within 1e-6 of this one.
    """

    stiffness: Array
    damping: Array
    on_jump: Mask

    def describe(self, axis: str = "z") -> str:
        """Return one wall as a phrase, in the units of an axis."""
        if not self.stiffness > 0.0:
            return "none: no wall is stable"
        jump = ", at a jump of the boundary" if self.on_jump else ""
        force, damping = unit_of("N/m", axis), unit_of("N s/m", axis)
        if axis.startswith("r"):
            return f"{float(self.stiffness):.4g} {force} at {float(self.damping):.4g} {damping}{jump}"
        return f"{self.stiffness:.0f} {force} at {self.damping:.1f} {damping}{jump}"


def flattened(loop: LoopArray, damping: Array) -> tuple[LoopArray, Array, tuple[int, ...]]:
    """Return loop and dampings flattened to N, and their shape."""
    shape = common_shape("damping and loop", damping.shape, loop.shape)
    return loop.part(shape, slice(None)), np.broadcast_to(damping, shape).reshape(-1), shape


def spans(loop: LoopArray, damping: Array, limit: float) -> tuple[Array, Mask]:
    """Return the edges of stiffness ranges (N, c + 1), and whether each is stable (N, c).

    Args:
        loop: One loop, or N of them.
        damping: (N,).
        limit: Spectral radius allowed.
    """
    (stiff, damp), highest = scales(loop), _MOST_STIFFNESS if loop.device is None else _MOST_BESIDE_DEVICE_LAW
    if _is_delayed(loop):
        crossed = np.minimum(_delayed(loop, damping, limit) / np.broadcast_to(stiff, damping.shape)[:, None], highest)
    elif loop.affine:
        crossed = np.minimum(crossings(characteristic(loop, limit), damping / damp), highest)
    else:
        crossed = _scanned(loop, damping, limit)
    edges = np.pad(crossed, ((0, 0), (1, 1)), constant_values=(0.0, highest))
    edges = edges * np.broadcast_to(stiff, damping.shape)[:, None]
    low, high = edges[:, :-1], edges[:, 1:]
    rows, column = np.nonzero(high > low)
    good = np.zeros(low.shape, dtype=bool)
    middle = 0.5 * (low + high)[rows, column]
    good[rows, column] = loop.part(damping.shape, rows).stable(middle, damping[rows], limit)
    return edges, good


def _is_delayed(loop: LoopArray) -> bool:
    """Return True above ten periods of delay, where the polynomial is too long."""
    return loop.affine and bool((loop.periods > MAX_DELAY_PERIODS).any())


def _delayed(loop: LoopArray, damping: Array, limit: float) -> Array:
    """Return the lowest stiffnesses at which a pole crosses a circle [N/m], (N, c), ascending, padded with infinity.

    At a delay of q periods the loop z^q + L(z) = 0 is linear in the gains, L = L0 + k L1 + b L2, so that k is explicit
    at each angle: -(z^q + L0 + b L2)/L1, where it is real. Its zeros are bracketed on a grid of angles that resolves
    z^q, up to 300 turns of it and beside the poles of the loop that is cut, and refined by the method of Illinois.
    """
    batched = [np.broadcast_to(value, damping.shape) for value in loop.batched()]
    kinds, place = np.unique(np.array([*batched, np.zeros(damping.shape)]), axis=1, return_inverse=True)
    found: list[tuple[NDArray[Any], Array]] = []
    for kind in range(kinds.shape[1]):
        rows = np.flatnonzero(place.reshape(-1) == kind)
        found.append((rows, _lowest(loop.part(damping.shape, rows[:1]), damping[rows], limit)))
    result = np.full((len(damping), max(part.shape[1] for _, part in found)), np.inf)
    for index, lowest in found:
        result[index, : lowest.shape[1]] = lowest
    return result


def _lowest(loop: LoopArray, damping: Array, limit: float) -> Array:
    """Return the crossings of one loop, (N, c); see `_delayed`."""
    stiff, damp = (float(np.asarray(unit).reshape(-1)[0]) for unit in scales(loop))
    cut, periods, _ = loop.cut_at_delay(_GAIN_PAIRS[0] * stiff, _GAIN_PAIRS[1] * damp)
    free, first, second, both = give = cut.give
    whole, alike = float(periods[0]), np.ptp(cut.advance, axis=0).max() == np.ptp(cut.take, axis=0).max() == 0.0
    if not alike or not np.allclose(both + 3.0 * free, 2.0 * (first + second), atol=1e-9 * np.abs(give).max()):
        raise ParameterError("design must have a characteristic polynomial that is linear in its gains")
    parts = np.stack([free, (first - free) / stiff, (second - free) / damp])
    step = _STEP_OF_TURN / max(whole, 1.0)
    own = np.abs(np.angle(np.linalg.eigvals(cut.advance[0])))
    beside = own[own > 2.0 * LEAST_ANGLE, None] + step * np.arange(-_BESIDE_POLE, _BESIDE_POLE + 1)
    even = step * np.arange(1, math.ceil(min(np.pi, _MOST_TURNS * 2.0 * np.pi / whole) / step))
    grid = np.concatenate([np.geomspace(LEAST_ANGLE, step, 60)[:-1], even, beside.reshape(-1)])
    grid = np.append(np.unique(grid[(grid > 0.0) & (grid < np.pi)]), np.pi)

    def terms(angles: Array) -> tuple[Array, Array, Array]:
        z = limit * np.exp(1j * angles)
        size = len(cut.take[0])
        states = np.linalg.solve(z[:, None, None] * np.eye(size) - cut.advance[0], cut.take[0][:, None])[..., 0]
        own, sprung, damped = parts @ states.T
        turned = np.exp(1j * whole * angles) * limit**whole
        return turned + own, sprung, damped

    def held(angles: Array, dampings: Array) -> tuple[Array, Array]:
        """Return the imaginary part that vanishes at a crossing, and the stiffness there."""
        rest, sprung, damped = terms(angles)
        ratio = -(rest + dampings * damped) / sprung
        return ratio.imag, ratio.real

    imaginary, stiffness = held(grid, damping[:, None])
    imaginary[:, -1] = 0.0  # at half the rate all is real
    rows, column = np.nonzero(np.sign(imaginary[:, 1:-1]) != np.sign(imaginary[:, :-2]))
    share = imaginary[rows, column] / (imaginary[rows, column] - imaginary[rows, column + 1])
    rough = stiffness[rows, column] + share * (stiffness[rows, column + 1] - stiffness[rows, column])
    room = np.abs(stiffness[rows, column + 1] - stiffness[rows, column])
    kept = rough + room > 0.0
    rows, column, rough = rows[kept], column[kept], rough[kept]
    order = np.lexsort((rough, rows))
    rank = np.arange(len(rows)) - np.searchsorted(rows[order], rows[order])
    chosen = order[rank < _MOST_CROSSINGS]
    rows, column = rows[chosen], column[chosen]
    low, high, below, above = grid[column], grid[column + 1], imaginary[rows, column], imaginary[rows, column + 1]
    for _ in range(_MOST_STEPS):
        middle = (low * above - high * below) / (above - below)
        value, _ = held(middle, damping[rows])
        beyond = np.sign(value) == np.sign(below)
        above, below = np.where(beyond, 0.5 * above, value), np.where(beyond, value, 0.5 * below)
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
        if not ((high - low > 1e-15 * high) & (value != 0.0)).any():
            break
    _, exact = held(middle if len(rows) else low, damping[rows])
    result = np.full((len(damping), _MOST_CROSSINGS + 2), np.inf)
    result[:, -1] = stiffness[:, -1]
    if limit < 1.0:  # a real pole; at 1 the stiffness is 0
        result[:, -2:-1] = held(np.zeros(1), damping[:, None])[1]
    result[rows, rank[rank < _MOST_CROSSINGS]] = exact
    return np.sort(np.where(result > _ZERO_STIFFNESS * stiff, result, np.inf), axis=-1)


def _scanned(loop: LoopArray, damping: Array, limit: float) -> Array:
    """Return the stiffnesses at which stability changes [m/T²], (N, c), ascending, padded with the highest one.

    By a grid and bisection, for a polynomial that is not linear in the gains: a narrower range may be missed.
    """
    grid = np.geomspace(_LEAST_OF_GRID, _MOST_BESIDE_DEVICE_LAW, _SCAN_POINTS)
    stiff = np.broadcast_to(scales(loop)[0], damping.shape)
    good = is_stable(loop.widened().spectral_radius(stiff[:, None] * grid, damping[:, None]), limit)
    rows, columns = np.nonzero(good[:, 1:] != good[:, :-1])
    result = np.full((len(damping), int(np.bincount(rows, minlength=1).max(initial=0))), _MOST_BESIDE_DEVICE_LAW)
    if rows.size:
        part, was = loop.part(damping.shape, rows), good[rows, columns]

        def changed(stiffness: Array) -> Mask:
            return np.asarray(is_stable(part.spectral_radius(stiffness * stiff[rows], damping[rows]), limit) != was)

        places = np.arange(rows.size) - np.searchsorted(rows, rows)
        result[rows, places] = bisect(changed, grid[columns], grid[columns + 1], _SCAN_HALVINGS)
    return result


def ranges_of(loop: LoopArray, damping: float, limit: float = 1.0) -> list[tuple[float, float]]:
    """Return all stable stiffness ranges of a LoopArray; see `stable_ranges`."""
    if loop.shape:
        raise ParameterError(f"loop must be a single one (got shape {loop.shape})")
    limit = number("limit", limit, above=0.0, at_most=1.0)
    edges, good = spans(loop, numbers("damping", [damping], at_least=0.0), limit)
    ranges: list[tuple[float, float]] = []
    for low, high, inside in zip(edges[0], edges[0, 1:], good[0]):
        if inside and high > low:
            joined = ranges and ranges[-1][1] == low
            ranges[-1:] = [(ranges[-1][0], float(high))] if joined else [*ranges[-1:], (float(low), float(high))]
    return ranges


@checked
def stable_ranges(damping: float, *, limit: float = 1.0, **loop: Unpack[LoopKeywords]) -> list[tuple[float, float]]:
    """Return all stable stiffness ranges at one damping.

    The first begins at 0 unless soft walls are unstable; the others are islands above unstable walls.

    Args:
        damping: Wall damping [N s/m].
        limit: Spectral radius allowed; 1 for stability.
        loop: Keywords of `LoopArray`, each a number.

    Returns:
        Lower and upper end of each range [N/m], ascending, at most 8 m/T².

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    return ranges_of(LoopArray(**sampled_fields(loop)), damping, limit)


@overload
def largest_stable_stiffness(damping: ArrayLike, **loop: Unpack[LoopKeywords]) -> Array: ...


@overload
def largest_stable_stiffness(damping: None = None, **loop: Unpack[LoopKeywords]) -> StiffestWall: ...


@checked
def largest_stable_stiffness(damping: ArrayLike | None = None, **loop: Unpack[LoopKeywords]) -> Array | StiffestWall:
    """Return the critical stiffness: all softer walls are stable [N/m].

    Islands of stable walls above unstable ones do not count (see `stable_ranges`).

    Args:
        damping: Wall damping [N s/m], (...,); None searches over all of them.
        loop: Keywords of `LoopArray`; they broadcast with the damping.

    Returns:
        The stiffness (...,), 0 if no soft wall is stable, and 8 m/T² at most, 64 beside a device law; for
        `damping=None` a `StiffestWall`.

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
    return boundary_of(LoopArray(**sampled_fields(loop)), numbers("damping", damping, at_least=0.0))


def boundary_of(loop: LoopArray, damping: Array) -> Array:
    """Return the critical stiffness of a LoopArray [N/m]; see `largest_stable_stiffness`."""
    flat, b, shape = flattened(loop, damping)
    edges, good = spans(flat, b, 1.0)
    rough, first = first_end(edges, good)
    if _is_delayed(flat):
        return rough.reshape(shape)
    wide, b = flat.widened(), b[:, None]
    midpoints = 0.5 * (edges[:, :-1] + edges[:, 1:])
    rows = np.arange(len(edges))
    last = np.minimum(first, midpoints.shape[-1] - 1)
    low, high = midpoints[rows, np.maximum(last - 1, 0)], midpoints[rows, last]
    bracketed = (first > 0) & (first < good.shape[-1])
    # a crossing with a small slope is less accurate than the eigenvalues, so refine by them
    near = np.clip(rough[:, None] * (1.0 + _BESIDE_ROUGH), low[:, None], high[:, None])
    middle = np.concatenate([low[:, None], near, high[:, None]], axis=1)
    while True:
        spectral_radii = wide.spectral_radius(middle, b)
        steady = is_stable(spectral_radii[:, 1:-1])
        # bracket of the first unstable point; the upper end is always unstable
        part = np.where(steady.all(axis=-1), steady.shape[-1], np.argmin(steady, axis=-1))
        low, high = middle[rows, part], middle[rows, part + 1]
        below, above = spectral_radii[rows, part], spectral_radii[rows, part + 1]
        if not (bracketed & (high - low > 1e-13 * high) & (above - below > _EQUAL_RADII)).any():
            break
        # dense around the interpolated crossing, and an even grid because the radius is not linear
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = (1.0 - ROUNDING - below) / (above - below)
        shares = np.where(np.isfinite(crossing), crossing, 0.5)[:, None] + _BESIDE_INTERPOLATED
        shares = np.sort(np.concatenate([np.clip(shares, 0.0, 1.0), np.tile(_EVEN_SHARES, (rows.size, 1))], axis=1))
        middle = low[:, None] + (high - low)[:, None] * shares
    return np.where(bracketed, low, rough).reshape(shape)


def highest_of(loop: LoopArray) -> Array:
    """Return the stiffness at which the search for a boundary ends, less rounding [N/m], (...,)."""
    return np.asarray(
        (_MOST_STIFFNESS if loop.device is None else _MOST_BESIDE_DEVICE_LAW) * scales(loop)[0] * (1.0 - 1e-9)
    )


def first_end(edges: Array, good: Mask) -> tuple[Array, Array]:
    """Return the end of the first stable range, and the index of the first unstable one, (N,) each."""
    good = good | (edges[:, 1:] <= edges[:, :-1])
    first = np.where(good.all(axis=-1), good.shape[-1], np.argmin(good, axis=-1))
    return edges[np.arange(len(edges)), first], first


@checked
def stiffest_wall(**loop: Unpack[LoopKeywords]) -> StiffestWall:
    """Return the largest stable stiffness over all dampings, and its damping.

    Dampings from 0 to 8 m/T are searched by grids that refine the highest maxima. At a jump of the boundary `on_jump`
    is True: at a slightly different damping softer walls are unstable.

    Args:
        loop: Keywords of `LoopArray`.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    return stiffest_of(LoopArray(**sampled_fields(loop)))


def stiffest_of(loop: LoopArray, finest: float | None = None) -> StiffestWall:
    """Return the stiffest wall of a LoopArray, to a relative accuracy if stated; see `stiffest_wall`."""
    walls = [_stiffest(loop.part(loop.shape, index), finest) for index in range(math.prod(loop.shape))]
    stiffness, damping, on_jump = np.moveaxis(np.array(walls).reshape(*loop.shape, 3), -1, 0)
    return StiffestWall(stiffness, damping, on_jump.astype(bool))


def _stiffest(loop: LoopArray, finest: float | None = None) -> tuple[float, float, bool]:
    """Return stiffness, damping and `on_jump` of one loop's stiffest wall."""
    stiff, damp = scales(loop)
    grid = _DAMPING_GRID * float(damp) * loop.narrowed

    def beside(positions: Array, shares: Array) -> Array:
        return np.unique(np.maximum(positions + np.maximum(positions, grid[1]) * shares, 0.0))

    def crossing(dampings: Array) -> Array:
        return first_end(*spans(loop, dampings, 1.0))[0]

    if finest is not None or not loop.affine or _is_delayed(loop):
        rough = maxima(crossing, grid[::_EVERY_NTH], finest or _ROUGH_ACCURACY, peaks=1)
        top = float(crossing(rough)[0])
        return (top, float(rough[0]), False) if top > _LEAST_STIFFNESS * float(stiff) else (0.0, 0.0, False)
    # crossings of an almost undamped pole are accurate to 1e-3 only; refine by the eigenvalues
    rough = maxima(crossing, grid, _ROUGH_ACCURACY)
    best = maxima(partial(boundary_of, loop), beside(rough[:, None], _AROUND_PEAK), _FINE_ACCURACY, peaks=1)
    near = beside(best, _BESIDE_PEAK)
    exact = boundary_of(loop, near)
    most = float(exact.max())
    if not most > _LEAST_STIFFNESS * float(stiff):
        return 0.0, 0.0, False
    return most, float(near[np.argmax(exact)]), bool(exact.min() < most * (1.0 - _JUMP))


def rates_beside(mode: Mode) -> Array:
    """Return sample rates at and beside twice a mode's frequency and its fractions, where it aliases [Hz].

    Loops may be unstable in a narrow range of rates there.
    """
    aliased = 2.0 * float(mode.values[0]) / np.arange(1.0, _MOST_ALIASES + 1.0)
    return np.asarray(np.unique(aliased[:, None] * (1.0 + _BESIDE_ALIAS)))


def rigid_note(loop: LoopArray) -> str:
    """Return in words up to which sample rate half of the rigid device's limit holds with the mode of a single loop.

    The delay stays the same, a device law is left out. Half of the stiffest wall's stiffness, at its damping, is tried
    at rates from the present one to 20 times the mode's frequency, and beside those at which the mode aliases. The
    stiffest wall is interpolated between rates; the rate at which stability changes is refined with that of its own.
    """
    mode, loop = loop.mode, replace(loop, device=None)
    assert mode is not None
    rigid, own = replace(loop, mode=None), 1.0 / float(np.asarray(loop.period))
    fastest = max(min(_FASTEST_OF_MODE * float(mode.values[0]), 1.0 / MIN_PERIOD), own)
    coarse = np.geomspace(own, fastest, _COARSE_RATES if fastest > own else 1)
    text = "rigid device: half of its stiffness limit is"

    def half(rate: float) -> Array:
        """Return the gains of half of the stiffest wall."""
        stiffness, damping, _ = stiffest_of(replace(rigid, period=1.0 / rate), _ROUGH_ACCURACY)
        return np.array([0.5 * stiffness, damping])

    def unstable(rate: Array) -> Mask:
        return ~replace(loop, period=1.0 / float(rate)).stable(*half(float(rate)))

    ends, aliased = half(own), rates_beside(mode)
    if not replace(loop, period=1.0 / own).stable(*ends):
        return f"{text} unstable with this mode at this rate"
    last = own
    for low, high in zip(coarse[:-1].tolist(), coarse[1:].tolist()):
        rates = np.concatenate([np.geomspace(low, high, _FINE_RATES), aliased[(aliased > low) & (aliased < high)]])
        rates.sort()
        starts, ends = ends, half(high)
        share = np.log(rates / low) / math.log(high / low)
        gains = starts[:, None] + (ends - starts)[:, None] * share
        delay = np.broadcast_to(np.asarray(loop.delay), rates.shape)
        good = replace(loop, period=1.0 / rates, delay=delay).stable(*gains)
        if not good.all():
            first = int(np.argmin(good))
            below = rates[first - 1] if first else np.asarray(last)
            edge = float(bisect(unstable, below, rates[first], _RATE_HALVINGS))
            return f"{text} unstable with this mode above {edge:.0f} Hz at this delay"
        last = float(rates[-2])
    return f"{text} stable with this mode up to {fastest:.0f} Hz at this delay"


def maxima(function: Callable[[Array], Array], grid: Array, finest: float, peaks: int = 3) -> Array:
    """Return the arguments of a function's highest maxima, (M,), M at most `peaks`.

    Args:
        function: Function of an array; may be discontinuous.
        grid: First grid, ascending; its maxima are refined.
        finest: Relative width of the last interval, unless the function is constant in a wider one.
        peaks: Largest number of maxima.
    """
    values = function(grid)
    sides = np.pad(values, 1, constant_values=-1.0)
    tops = np.flatnonzero((values > sides[:-2]) & (values >= sides[2:]))
    arguments = []
    for best in tops[np.argsort(-values[tops], kind="stable")[:peaks]]:
        finer, heights = grid, values
        while True:
            low, high = finer[max(best - 1, 0)], finer[min(best + 1, finer.size - 1)]
            if high - low <= finest * max(high, grid[1]) or heights.min() >= (1.0 - _FLAT_PEAK) * heights.max():
                break
            # keep the best point: at a jump all the others may be lower
            finer = np.unique([*np.linspace(low, high, _POINTS_OF_REFINEMENT), finer[best]])
            heights = function(finer)
            best = int(np.argmax(heights))
        arguments.append(finer[best])
    return np.array(arguments)


class _Characteristic(NamedTuple):
    """Coefficients of p0, p1 and p2 on a circle, lowest power first, (..., n + 1) each.

    Gains are in units of m/T² and m/T, so that all coefficients are of order one.
    """

    free: Array
    stiff: Array
    damped: Array


def scales(loop: LoopArray) -> tuple[Array, Array]:
    """Return the units of stiffness and damping, m/T² and m/T, (...,) each."""
    period = np.asarray(loop.period)
    shape = np.broadcast_shapes(loop.shape, period.shape)
    return np.broadcast_to(loop.moving_mass / period**2, shape), np.broadcast_to(loop.moving_mass / period, shape)


def characteristic(loop: LoopArray, radius: float) -> _Characteristic:
    """Return the characteristic polynomial of a loop, with the circle of `radius` scaled to the unit circle.

    Raises:
        ParameterError: If the polynomial is not linear in the gains.
    """
    stiff, damp = (np.asarray(unit)[..., None] for unit in scales(loop))
    matrices = loop.widened().matrix(_GAIN_PAIRS[0] * stiff, _GAIN_PAIRS[1] * damp)
    size = matrices.shape[-1]
    turns = radius * np.exp(2j * np.pi * np.arange(size + 1) / (size + 1))
    values = np.linalg.det(turns[:, None, None] * np.eye(size) - matrices[..., None, :, :])
    free, first, second, both = np.moveaxis(np.fft.fft(values, axis=-1).real / (size + 1), -2, 0)
    if not np.allclose(both + 3.0 * free, 2.0 * (first + second), rtol=0.0, atol=1e-9 * np.abs(both).max()):
        raise ParameterError("design must have a characteristic polynomial that is linear in its gains")
    return _Characteristic(free, first - free, second - free)


def crossings(parts: _Characteristic, damping: Array) -> Array:
    """Return the stiffnesses at which a pole may cross the circle, (N, c), ascending, padded with infinity.

    Args:
        parts: (N, n + 1) each, or (n + 1,).
        damping: In units of m/T, (N,).
    """
    damped = parts.free + damping[:, None] * parts.damped
    angles = _roots(_sine_series(damped, np.broadcast_to(parts.stiff, damped.shape)))
    return np.sort(_stiffness(damped, parts.stiff, angles), axis=-1)


def _stiffness(damped: Array, stiff: Array, angles: Array) -> Array:
    """Return the stiffness at angles on the circle, (..., A); infinity unless above 0."""
    powers = np.exp(1j * angles[..., None] * np.arange(damped.shape[-1]))
    held, sprung = (np.matmul(powers, part[..., None])[..., 0] for part in (damped, stiff))
    with np.errstate(divide="ignore", invalid="ignore"):
        stiffness = -(held * sprung.conj()).real / np.abs(sprung) ** 2
    return np.where(stiffness > _ZERO_STIFFNESS, stiffness, np.inf)


def _sine_series(p: Array, q: Array) -> Array:
    """Return Im(p conj(q)) on the unit circle as coefficients of sin((m + 1) theta), (..., n)."""
    size = max(p.shape[-1], q.shape[-1])
    terms = [
        (p[..., shift:] * q[..., : size - shift] - p[..., : size - shift] * q[..., shift:]).sum(axis=-1)
        for shift in range(1, size)
    ]
    return np.stack(terms, axis=-1)


def _roots(series: Array) -> Array:
    """Return the zeros in [0, pi] of series of sin((m + 1) theta), (N, n) to (N, n + 1), padded with NaN.

    Both ends are zeros. The inner ones are eigenvalues of the comrade matrix of U_m(cos theta) for each degree, refined
    by Newton's method.
    """
    count, most = series.shape
    result = np.full((count, most + 1), np.nan)
    result[:, -2:] = 0.0, np.pi
    significant = np.abs(series) > _ZERO_COEFFICIENT * np.abs(series).max(axis=-1, keepdims=True)
    degrees = np.where(significant.any(axis=-1), most - 1 - np.argmax(significant[:, ::-1], axis=-1), 0)
    for degree in np.unique(degrees[degrees > 0]):
        rows = np.flatnonzero(degrees == degree)
        comrade = np.zeros((rows.size, degree, degree))
        comrade[:] = 0.5 * (np.eye(degree, k=1) + np.eye(degree, k=-1))
        comrade[:, -1] -= 0.5 * series[rows, :degree] / series[rows, degree, None]
        roots = np.linalg.eigvals(comrade)
        real = (roots.imag == 0.0) & (np.abs(roots.real) <= 1.0)
        result[rows[:, None], np.arange(degree)] = np.where(real, np.arccos(np.where(real, roots.real, 0.0)), np.nan)
    order = np.arange(1, most + 1)
    inner = result[:, :-2]
    for _ in range(3):
        turns = inner[..., None] * order
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.sin(turns) @ series[..., None] / (np.cos(turns) @ (order * series)[..., None])
        inner -= np.where(np.abs(step[..., 0]) < 0.1, step[..., 0], 0.0)
    return result


@checked
def least_passive_damping(
    stiffness: ArrayLike,
    damping: ArrayLike = 0.0,
    *,
    period: ArrayLike,
    delay: ArrayLike = 0.0,
    design: Design | None = None,
) -> Array:
    """Return the least physical damping to ground that makes a wall passive against every motion [N s/m].

    For the law's force -H(z) x, a delay of (q + r) T and z = exp(j w T), it is the largest, over 0 < w <= pi/T, of

    (R + sqrt(R² + r (1 - r) T² abs(H)²)) / 2  with  R = T Re(H z^-q (1 - r + r/z) / (1 - z)).

    Args:
        stiffness: Wall stiffness K [N/m], (...,).
        damping: Virtual damping B [N s/m], (...,).
        period: Sample period T [s], (...,).
        delay: Transport delay [s], (...,).
        design: Linear controller; None for the PD wall.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: derived here, as the least eigenvalue of the absorbed power over all aliases of a frequency; without delay
    it is K T/2 + abs(B), the condition of Colgate & Schenkel 1997 as quoted by others.
    """
    gains = numbers("stiffness", stiffness), numbers("damping", damping)
    times = numbers("period", period, at_least=0.0, above=0.0), numbers("delay", delay, at_least=0.0)
    k, b, step, late = (part[..., None] for part in (*gains, *times))
    law, (whole, rest) = (design or pd())(k, b, step), split_delay(late, step)
    share = rest / step

    def needed(angles: Array) -> Array:
        z = np.exp(1j * angles)
        wall = rendered_stiffness(law, z)
        real = step * (wall * z**-whole * (1.0 - share + share / z) * (0.5 + 0.5j / np.tan(0.5 * angles))).real
        return np.asarray(0.5 * (real + np.sqrt(real**2 + share * (1.0 - share) * (step * np.abs(wall)) ** 2)))

    shape = np.broadcast_shapes(k.shape, b.shape, step.shape, late.shape, law.direct.shape)[:-1]
    poles = np.asarray(np.linalg.eigvals(law.advance))  # of the law; those of all gains have one axis more
    grid = angles_of(poles if poles.ndim == 1 else poles[..., 0, :], _PASSIVITY_ANGLES)
    return peak(needed, np.broadcast_to(grid, (*shape, grid.shape[-1])))[1]
