"""Stability of sampled loops at any delay, without a matrix that grows with it.

Cut at the host's command, a loop with a delay of q + r periods, q whole, is 1 + z^-q L_r(z) = 0. On the unit circle
|z^-q| is 1, so the angles a at which |L_r| = 1 do not depend on q. There L_r has the phase -p, and |L_r| falls
(s = 1) or rises (s = -1) with the angle. By the Nyquist criterion the number of unstable poles is an integer formula:

N(q, r) = N(0, r) + 2 sum_i s_i (floor((p_i + q a_i + pi)/2 pi) - floor((p_i + pi)/2 pi)) + q [|L_r(-1)| > 1].

Of n coupled axes L_r is a matrix, det(I + z^-q L_r(z)) = 0, and the same holds for all of its eigenvalues together.

Source: derived for this project.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.frames import Array, Mask

FRACTIONS = 40
"""Fractions of a period at which a delay is tried: a narrower stable or unstable range may be missed."""
# Angles in rad, delays in periods.
# -- what counts as equal
ROUNDING = 1e-12
"""Relative distance of a spectral radius from 1 that is rounding: larger would call slow growth stable."""
_FREE_POLE = 1e-7
"""Distance from 1 of the poles of free motion: rounding moves a double pole by its root, 2e-8."""
_ERROR_OF_CROSSING = 1e-8
"""Largest error of a loop gain of 1 at a crossing: Newton's method reaches rounding or does not converge."""
_ERROR_OF_SOLUTION, _ERROR_OF_RADIUS = 1e-9, 1e-8
"""Largest errors of a dominant pole: of its equation, and of the logarithm of its radius against the bracket."""
_SAME_ANGLE = 1e-8
"""Relative distance of crossings at one angle: equal axes have one each, which rounding of the gain sets apart."""
_LAST_DIGIT = 4e-16
"""Where false position ends: relative width of the angle, or logarithm of the gain, at two units in the last place."""

# -- angles
LEAST_ANGLE = 1e-7
"""Least angle of a crossing, which stands for 0: below it, poles at 1 hide it."""
_ANGLE_0 = complex(np.exp(1j * LEAST_ANGLE))
_ANGLES, _EVEN_ANGLES = np.geomspace(LEAST_ANGLE, np.pi, 600), np.linspace(0.0, np.pi, 1000)
"""Grids: at all scales, and for poles near the real axis at -1, where the first is coarse."""
_SMALL_TURN = 1e-6
"""Turn to both sides for the derivative of an eigenvalue: truncation is 1e-12 of it, rounding 1e-10."""
_OFF_POLE, _OFF_OWN_POLE = 1e-13, 1e-8
"""Relative distances kept from a pole of L, where it is infinite, and of a start beside one from it."""

# -- crossings
_NEARLY_IMAGINARY = 1e-2
"""Real part of an eigenvalue that may be imaginary, relative to its size.

At a tangent, rounding moves it by its root and more; a larger value only adds starts that the refinement drops.
"""
_NEWTON_STEPS = 8
"""Steps of Newton's method, which doubles the digits in each: of starts within 1e-2, four would do; two do not."""
_LARGEST_MOVE = 0.05
"""Largest relative move of an angle by its refinement: a start that moves further has found another's crossing."""
_LEAST_GAIN = 1e-300
"""Gain in place of 0, whose logarithm is infinite."""
_NEAR_PEAK = 1.0
"""Distance of a peak's logarithm from 0 up to which it may cross between two points of the grid; effort alone above."""
_REFINEMENTS, _REFINED_POINTS = 4, 21
"""Refinements of the grid at a peak, and points of each: to 1e-4 of a step, 1e-8 of the height."""
_MOST_FALSE_POSITIONS = 60
"""Most steps of false position; bisection alone would take 50."""

# -- delays at which stability changes
_MOST_EDGES = 40
"""Most edges of stable intervals that are listed: a table of more is of no use."""
_MOST_SECANTS, _BESIDE_EDGE = 8, 1e-9
"""Most steps of the secant method, and relative distance from its result at which stability is checked."""
_SECTIONS, _INNER_POINTS = 11, 15
"""Divisions of an interval where the secant method fails, and points of each: 16 ** -11 of it, to rounding."""

# -- dominant poles: logarithm of the radius, times periods
_FIRST_STEP, _DOUBLINGS, _LEAST_RADIUS = 0.05, 60, 600.0
"""First step of the bracket, doublings of it, and largest step inwards, as exp(-700) is no number."""
_BISECTIONS = 12
"""Bisections of a bracket before Newton's method, which then converges; four times as many without it."""
_MOST_STARTS = 8
"""Starts from which a pole near the real axis is refined: one gave equal poles of 40 random loops; effort alone."""


class Cut(NamedTuple):
    """Loop cut at the host's command, at a delay below one period: L(z) = give (z - advance)^-1 take.

    Attributes:
        advance: (P, N, N).
        take: (P, N).
        give: (P, N).
    """

    advance: Array
    take: Array
    give: Array

    @property
    def loops(self) -> int:
        """Number of loops, P."""
        return len(self.take)

    def rows(self, index: Rows) -> Cut:
        """Return some of the loops."""
        return Cut(*(part[index] for part in self))

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles without whole periods of delay, (P, N)."""
        return np.linalg.eigvals(self.advance - self.take[:, :, None] * self.give[:, None]).astype(np.complex128)

    def own_angles(self, row: int) -> Array:
        """Return a grid of angles, denser beside the poles of the loop that is cut."""
        return _grid_of(np.linalg.eigvals(self.advance[row]))

    def gains(self, rows: Rows, z: NDArray[np.complex128]) -> Array:
        """Return |L| at z of some loops, (M, 1)."""
        return np.abs(self.response(rows, z)[0])[:, None]

    def crossings(self) -> tuple[Rows, Array, Array, Array]:
        """Return rows, angles, signs and phases p in [0, 2 pi) of the crossings of |L| = 1."""
        rows, angles = _polished(self, *_angles(self))
        change = _above(self, _ANGLE_0) - _above(self, -1.0)
        wrong = np.bincount(rows, _signs(self, rows, angles), self.loops) != change
        if wrong.any():  # at small angles the eigenvalues lose a crossing
            searched = _searched(self, np.flatnonzero(wrong))
            kept = ~wrong[rows]
            rows, angles = (np.concatenate([part[kept], other]) for part, other in zip((rows, angles), searched))
        gain, _ = self.response(rows, np.exp(1j * angles))
        return rows, angles, _signs(self, rows, angles), np.mod(-np.angle(gain), 2.0 * np.pi)

    def outside(self, radius: Array, periods: Array) -> Cut:
        """Return the loops with z scaled by radii (P,), so that poles outside a circle are outside the unit circle."""
        inverse = 1.0 / radius[:, None]
        size = np.exp(-periods * np.log(radius))[:, None]
        return Cut(self.advance * inverse[:, None], self.take * inverse * size, self.give)

    def response(
        self, rows: Rows, z: NDArray[np.complex128], whole: Array | None = None
    ) -> tuple[NDArray[np.complex128], ...]:
        """Return L and its derivative at z of some loops, (M,) each; for `whole` see `CoupledCut`."""
        one, advance = np.eye(self.take.shape[-1]), self.advance[rows]
        try:
            resolvent = np.linalg.inv(z[:, None, None] * one - advance)
        except np.linalg.LinAlgError:  # exactly at a pole
            resolvent = np.linalg.inv((z * (1.0 + _OFF_POLE))[:, None, None] * one - advance)
        right = (resolvent @ self.take[rows, :, None])[..., 0]
        left = (self.give[rows, None] @ resolvent)[:, 0]
        return (self.give[rows] * right).sum(axis=-1), -(left * right).sum(axis=-1)


class CoupledCut(NamedTuple):
    """Loop of n coupled axes cut at the host's commands, at delays below one period: L(z), (n, n).

    L = -K(z) diag(P_i(z)) with the law K, and the position P_i on axis i after its command. Only P depends on the
    delay.

    Attributes:
        axes: State transition of each axis over a period, position first, (n, F, F).
        old: Effect of the last command on each axis, (P, n, F).
        new: Effect of the present one, (P, n, F).
        law: Advance (S, S), take (S, n), give (n, S) and direct (n, n) of the law.
    """

    axes: Array
    old: Array
    new: Array
    law: tuple[Array, Array, Array, Array]

    @property
    def loops(self) -> int:
        """Number of loops, P."""
        return len(self.new)

    def rows(self, index: Rows) -> CoupledCut:
        """Return some of the loops."""
        return self._replace(old=self.old[index], new=self.new[index])

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles without whole periods of delay, (P, N)."""
        (advance, take, give, direct), (n, size) = self.law, self.axes.shape[:2]
        body, places = n * size, np.arange(n) * size
        command = np.zeros((n, body + n + len(advance)))
        command[:, places], command[:, body + n :] = direct, give
        matrix = np.zeros((self.loops, len(command[0]), len(command[0])))
        for axis, first in enumerate(places.tolist()):
            own = slice(first, first + size)
            matrix[:, own, own], matrix[:, own, body + axis] = self.axes[axis], self.old[:, axis]
            matrix[:, own] += self.new[:, axis, :, None] * command[axis]
        matrix[:, body : body + n] = command
        matrix[:, body + n :, places], matrix[:, body + n :, body + n :] = take, advance
        return np.linalg.eigvals(matrix).astype(np.complex128)

    def own_angles(self, row: int) -> Array:
        """See `Cut`; all rows have equal poles."""
        return _grid_of(np.concatenate([np.linalg.eigvals(self.law[0]), np.linalg.eigvals(self.axes).ravel()]))

    def eigenvalues(self, rows: Rows, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the eigenvalues of L at z of some loops, the largest first, (M, n)."""
        (points, place), (advance, take, give, direct) = np.unique(z, return_inverse=True), self.law
        turn = points[:, None, None]
        law = give @ np.linalg.solve(turn * np.eye(len(advance)) - advance, take.astype(complex)) + direct
        one = np.eye(self.axes.shape[-1])
        seen = np.linalg.inv(turn[:, None] * one - self.axes)[..., 0, :]
        body = (seen[place.reshape(-1)] * (self.new[rows] + self.old[rows] / z[:, None, None])).sum(axis=-1)
        found = np.linalg.eigvals(-law[place.reshape(-1)] * body[:, None])
        return np.take_along_axis(found, np.argsort(-np.abs(found), axis=-1), axis=-1)

    def gains(self, rows: Rows, z: NDArray[np.complex128]) -> Array:
        """Return the magnitudes of the eigenvalues at z of some loops, the largest first, (M, n)."""
        return np.abs(self.eigenvalues(rows, z))

    def response(
        self, rows: Rows, z: NDArray[np.complex128], whole: Array | None = None
    ) -> tuple[NDArray[np.complex128], ...]:
        """Return one eigenvalue and its derivative at z of some loops, (M,) each.

        It is that nearest to a pole at z with whole periods of delay, (M,); None for that nearest to the magnitude 1.
        """
        here, *beside = (
            self.eigenvalues(rows, z * turn) for turn in (1.0, np.exp(1j * _SMALL_TURN), np.exp(-1j * _SMALL_TURN))
        )
        if whole is None:
            distance = np.abs(np.log(np.maximum(np.abs(here), _LEAST_GAIN)))
        else:
            distance = np.abs(here + (z**whole)[:, None])
        gain = np.take_along_axis(here, distance.argmin(axis=-1)[:, None], axis=-1)
        ends = [np.take_along_axis(one, np.abs(one - gain).argmin(axis=-1)[:, None], axis=-1)[:, 0] for one in beside]
        return gain[:, 0], (ends[0] - ends[1]) / (2j * np.sin(_SMALL_TURN) * z)

    def crossings(self) -> tuple[Rows, Array, Array, Array]:
        """See `Cut`; of all eigenvalues. The i-th largest magnitude is continuous, and searched for each i."""
        rows, order, low, high = self._brackets()
        below, above = (self._logarithms(rows, order, angles) for angles in (low, high))
        signs = np.sign(below - above)
        angles, least = low, np.abs(below)
        for _ in range(_MOST_FALSE_POSITIONS):  # an end that stays counts half
            middle = low + (high - low) * np.clip(below / (below - above), 0.001, 0.999)
            value = self._logarithms(rows, order, middle)
            angles, least = np.where(np.abs(value) < least, middle, angles), np.minimum(np.abs(value), least)
            lower = np.sign(value) == np.sign(below)
            low, high = np.where(lower, middle, low), np.where(lower, high, middle)
            below, above = np.where(lower, value, 0.5 * below), np.where(lower, 0.5 * above, value)
            if not ((least > _LAST_DIGIT) & (high - low > _LAST_DIGIT * high)).any():
                break
        return rows, angles, signs, self._phases(rows, angles)

    def _logarithms(self, rows: Rows, order: Rows, angles: Array) -> Array:
        """Return the logarithm of the magnitude of some order at angles of some loops, (M,)."""
        gains = self.gains(rows, np.exp(1j * angles))
        return np.asarray(np.log(np.maximum(gains, _LEAST_GAIN))[np.arange(len(rows)), order])

    def _brackets(self) -> tuple[Rows, Rows, Array, Array]:
        """Return rows, orders of magnitude, and ends of intervals of the angle with one crossing each."""
        grid, size = self.own_angles(0), self.axes.shape[0]
        rows = np.repeat(np.arange(self.loops), len(grid))
        gains = self.gains(rows, np.exp(1j * np.tile(grid, self.loops))).reshape(self.loops, len(grid), size)
        values = np.log(np.maximum(gains, _LEAST_GAIN))
        row, at, order = np.nonzero((values[:, 1:] > 0.0) != (values[:, :-1] > 0.0))
        found = [(row, order, grid[at], grid[at + 1])]
        # between two points a peak may rise above 1, or a dip fall below
        side = np.where(values > 0.0, -1.0, 1.0)
        height, inner = side * values, np.s_[:, 1:-1]
        peak = (height[inner] >= (side[inner] * values[:, :-2])) & (height[inner] >= (side[inner] * values[:, 2:]))
        peak &= (side[:, :-2] == side[inner]) & (side[:, 2:] == side[inner]) & (height[inner] > -_NEAR_PEAK)
        row, at, order = np.nonzero(peak)
        low, high, sign = grid[at], grid[at + 2], side[row, at + 1, order]
        for _ in range(_REFINEMENTS if len(row) else 0):
            points = low + (high - low) * np.linspace(0.0, 1.0, _REFINED_POINTS)[:, None]
            part = self._logarithms(np.tile(row, _REFINED_POINTS), np.tile(order, _REFINED_POINTS), points.ravel())
            best = np.clip((sign * part.reshape(points.shape)).argmax(axis=0), 1, _REFINED_POINTS - 2)
            top = np.take_along_axis(sign * part.reshape(points.shape), best[None], axis=0)[0]
            low, middle, high = (np.take_along_axis(points, (best + step)[None], axis=0)[0] for step in (-1, 0, 1))
            if (crosses := top > 0.0).any():
                kept = np.flatnonzero(crosses)
                found += [(row[kept], order[kept], grid[at[kept]], middle[kept])]
                found += [(row[kept], order[kept], middle[kept], grid[at[kept] + 2])]
                row, order, low, high, sign, at = (part[~crosses] for part in (row, order, low, high, sign, at))
        row, order, low, high = (np.concatenate(part) for part in zip(*found))
        return row, order, low, high

    def _phases(self, rows: Rows, angles: Array) -> Array:
        """Return the phases of crossings; several at one angle, as of equal axes, have one eigenvalue each."""
        every = self.eigenvalues(rows, np.exp(1j * angles))
        nearest = np.abs(np.log(np.maximum(np.abs(every), _LEAST_GAIN))).argsort(axis=-1)
        every = np.take_along_axis(every, nearest, axis=-1)
        rank, order = np.zeros(len(rows), dtype=int), np.lexsort((angles, rows))
        for last, this in pairwise(order.tolist()):
            if rows[last] == rows[this] and angles[this] - angles[last] < _SAME_ANGLE * angles[this]:
                rank[this] = rank[last] + 1
        for first in order[:-1][(rank[order[:-1]] == 0) & (rank[order[1:]] > 0)]:
            same = np.flatnonzero(
                (rows == rows[first]) & (np.abs(angles - angles[first]) < _SAME_ANGLE * angles[first])
            )
            every[same, rank[same]] = every[first, rank[same]]
        return np.mod(-np.angle(every[np.arange(len(rows)), rank]), 2.0 * np.pi)


AnyCut: TypeAlias = Cut | CoupledCut

Rows: TypeAlias = NDArray[Any]
"""Indices of loops."""

CutOf: TypeAlias = Callable[[Rows, Array], Cut]
"""Function from indices of loops (P,) and fractions of a period (P,) to the cut loops."""

AnyCutOf: TypeAlias = Callable[[Rows, Array], AnyCut]
"""The same, of single or coupled loops."""


class AnyDelay:
    """Number of unstable poles of loops for any number of whole periods of delay.

    Args:
        cut: The loops, P of them.
        free: True for loops whose free motion has poles at 1, which do not count, (P,).
    """

    def __init__(self, cut: AnyCut, free: Mask) -> None:
        self.rows, self.angles, self.signs, self.phases = cut.crossings()
        rounding = np.where(free, _FREE_POLE, ROUNDING)[:, None]
        self.start = (np.abs(cut.poles()) > 1.0 + rounding).sum(axis=-1)
        self.flipped = _above(cut, -1.0)

    def unstable(self, periods: NDArray[Any]) -> NDArray[np.int64]:
        """Return the number of unstable poles at whole periods of delay (P,), (P,)."""
        whole = np.asarray(periods, dtype=np.int64)
        turns = np.floor((self.phases + whole[self.rows] * self.angles + np.pi) / (2.0 * np.pi)) - (
            self.phases >= np.pi
        )
        crossed = np.bincount(self.rows, 2.0 * self.signs * turns, len(self.start))
        return np.asarray(self.start + crossed.round().astype(np.int64) + whole * self.flipped)

    def first(self) -> Array:
        """Return the least whole periods of delay at which there are unstable poles, (P,); infinity for none."""
        falls = self.signs > 0
        waiting = np.ceil(_waiting(self.phases, self.angles)[falls])
        result = np.where(self.flipped > 0, 1.0, np.inf)
        np.minimum.at(result, self.rows[falls], np.maximum(waiting, 1.0))
        return np.where(self.start > 0, 0.0, result)

    def changes(self, row: int, longest: int) -> tuple[Array, Array]:
        """Return whole periods of delay, ascending, up to a longest, and the number of unstable poles from each on."""
        periods, steps = [np.zeros(1)], [np.array([float(self.start[row])])]
        for index in np.flatnonzero(self.rows == row):
            first, turn = _waiting(self.phases[index], self.angles[index]), 2.0 * np.pi / self.angles[index]
            times = np.ceil(first + turn * np.arange(max(math.floor((longest - first) / turn) + 1, 0)))
            periods, steps = [*periods, times], [*steps, np.full(len(times), 2.0 * self.signs[index])]
        if self.flipped[row]:
            periods, steps = (
                [*periods, np.arange(1.0, longest + 1)],
                [*steps, np.full(longest, float(self.flipped[row]))],
            )
        at, place = np.unique(np.concatenate(periods), return_inverse=True)
        total = np.cumsum(np.bincount(place.reshape(-1), np.concatenate(steps), len(at))).round()
        kept = at <= longest
        return at[kept], np.asarray(total[kept], dtype=np.float64)


def _waiting(phases: Array, angles: Array) -> Array:
    """Return the delay at which crossings first change the number of unstable poles [periods]."""
    return np.asarray((np.pi - np.where(phases < np.pi, phases, phases - 2.0 * np.pi)) / angles)


def _signs(cut: Cut, rows: Rows, angles: Array) -> Array:
    z = np.exp(1j * angles)
    gain, slope = cut.response(rows, z)
    return np.asarray(-np.sign((1j * z * slope / gain).real))


def _angles(cut: Cut) -> tuple[Rows, Array]:
    """Return rows and angles of |L| = 1: imaginary eigenvalues of a symplectic pencil after Cayley's map.

    On the circle 1 - L(z) L(1/z) = 0 is the pencil z [I, -b b'; 0, A'] = [A, 0; -c' c, I].
    """
    size = cut.take.shape[-1]
    reach, seen, up, down = np.abs(cut.take), np.abs(cut.give), cut.take, cut.give
    for _ in range(size):  # states of equal size, from what reaches each and what is seen of it
        up, down = (cut.advance @ up[..., None])[..., 0], (down[:, None] @ cut.advance)[:, 0]
        reach, seen = np.maximum(reach, np.abs(up)), np.maximum(seen, np.abs(down))
    both = (reach > 0.0) & (seen > 0.0)
    scale = np.sqrt(np.where(both, reach, 1.0) / np.where(both, seen, 1.0))
    advance = cut.advance / scale[..., None] * scale[:, None]
    take, give = cut.take / scale, cut.give * scale
    largest = np.abs(give).max(axis=-1)
    even = np.sqrt(np.where(largest > 0.0, largest, 1.0) / np.abs(take).max(axis=-1))[:, None]
    take, give = take * even, give / even
    left, right = np.zeros((2, len(take), 2 * size, 2 * size))
    left[:, :size, :size], left[:, size:, :size] = advance, -give[:, :, None] * give[:, None]
    right[:, :size, size:], right[:, size:, size:] = -take[:, :, None] * take[:, None], advance.swapaxes(-1, -2)
    left[:, size:, size:] = right[:, :size, :size] = np.eye(size)
    try:
        turned = np.linalg.eigvals(np.linalg.solve(left + right, left - right))
    except np.linalg.LinAlgError:  # |L(-1)| is exactly 1
        return np.zeros(0, dtype=int), np.zeros(0)
    rows, column = np.nonzero((turned.imag > 0.0) & (np.abs(turned.real) < _NEARLY_IMAGINARY * np.abs(turned)))
    return rows, 2.0 * np.arctan(turned.imag[rows, column])


def _polished(cut: AnyCut, rows: Rows, angles: Array, whole: Array | None = None) -> tuple[Rows, Array]:
    """Return the crossings refined by Newton's method on ln |L|, each once; those that leave or miss are dropped."""
    start, angles = angles, angles.copy()
    for _ in range(_NEWTON_STEPS):
        z = np.exp(1j * angles)
        gain, derivative = cut.response(rows, z, whole)
        slope = (1j * z * derivative / gain).real
        move = -np.log(np.abs(gain)) / np.where(slope == 0.0, np.inf, slope)
        angles = np.clip(angles + move, 1e-12, np.pi)
        if not (np.abs(move) > 1e-15 * angles).any():
            break
    gain, _ = cut.response(rows, np.exp(1j * angles), whole)
    good = (np.abs(np.abs(gain) - 1.0) < _ERROR_OF_CROSSING) & (np.abs(angles - start) < _LARGEST_MOVE * start)
    good &= angles < np.pi * (1.0 - 1e-13)
    rows, angles = rows[good], angles[good]
    order = np.lexsort((angles, rows))
    rows, angles = rows[order], angles[order]
    again = np.zeros(len(rows), dtype=bool)
    again[1:] = (rows[1:] == rows[:-1]) & (np.diff(angles) < 1e-10 * angles[1:])
    return rows[~again], angles[~again]


def _searched(cut: Cut, rows: Rows) -> tuple[Rows, Array]:
    """Return crossings of some loops by a grid of angles and those of the loop's own poles."""
    found: list[tuple[Rows, Array]] = []
    for row in rows.tolist():
        grid = cut.own_angles(row)
        above = np.abs(cut.response(np.full(len(grid), row), np.exp(1j * grid))[0]) > 1.0
        index = np.flatnonzero(above[1:] != above[:-1])
        low, high, upper = grid[index], grid[index + 1], above[index]
        same = np.full(len(index), row)
        for _ in range(_BISECTIONS):
            middle = np.sqrt(low * high)
            before = (np.abs(cut.response(same, np.exp(1j * middle))[0]) > 1.0) == upper
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        found.append(_polished(cut, same, np.sqrt(low * high)))
    rows, angles = (np.concatenate(part) for part in zip(*found))
    return rows, angles


def _grid_of(poles: NDArray[Any]) -> Array:
    """Return a grid of angles, denser at and beside those of some poles."""
    own = np.abs(np.angle(poles))
    own = own[(own > LEAST_ANGLE) & (own < np.pi)]
    beside = [own * (1.0 + share) for share in (-0.01, -0.001, 0.0, 0.001, 0.01)]
    return np.unique(np.concatenate([_ANGLES, *beside]))


def _above(cut: AnyCut, z: complex) -> NDArray[np.int64]:
    """Return the number of loop gains above 1 at z, (P,)."""
    every = np.arange(cut.loops)
    return np.asarray((cut.gains(every, np.full(cut.loops, z, dtype=np.complex128)) > 1.0).sum(axis=-1))


def first_delays(cut_of: AnyCutOf, free: Mask) -> Array:
    """Return the least delay at which loops are unstable [periods], (G,).

    Infinity without a crossing at any of the fractions: the loop gain is below 1 at every frequency, so that every
    delay is stable.

    Args:
        cut_of: See `CutOf`.
        free: See `AnyDelay`, (G,).
    """
    every, shares = np.arange(len(free)), np.arange(FRACTIONS) / FRACTIONS
    high = AnyDelay(cut_of(every, np.zeros(len(free))), free).first()
    some = np.flatnonzero(high)  # the others are unstable without delay
    if some.size:
        index = np.repeat(some, FRACTIONS)
        first = AnyDelay(cut_of(index, np.tile(shares, len(some))), free[index]).first().reshape(-1, FRACTIONS)
        high[some] = (first + shares).min(axis=-1)
    result: Array = high.copy()
    rows = np.flatnonzero((high > 0.0) & np.isfinite(high))
    if rows.size:
        low = np.maximum(high[rows] - 1.0 / FRACTIONS, 0.0)
        result[rows] = _edges(cut_of, free, rows, low, high[rows])
    return result


class Intervals(NamedTuple):
    """Stable delays of one loop.

    Attributes:
        ends: Lower and upper end of each interval [periods]; the last may be `searched`.
        searched: End of the search [periods].
        largest_gain: Largest loop gain if it is below 1 at every frequency and fraction, so that any delay is stable.
    """

    ends: tuple[tuple[float, float], ...]
    searched: float
    largest_gain: float | None


def stable_intervals(cut_of: AnyCutOf, free: bool, longest: float) -> Intervals:
    """Return all stable delays of one loop up to a longest one [periods]."""
    shares = np.arange(FRACTIONS + 1) / FRACTIONS
    alone = np.array([free])
    cut = cut_of(np.zeros(len(shares), dtype=int), shares)
    loops = AnyDelay(cut, np.full(len(shares), free))
    if not len(loops.rows) and not loops.flipped.any() and not loops.start.any():
        return Intervals(((0.0, longest),), longest, _largest_gain(cut))
    last = math.ceil(longest)
    changes = [loops.changes(row, last) for row in range(FRACTIONS)]
    at = np.unique(np.concatenate([times for times, _ in changes]))
    good = np.array([total[np.searchsorted(times, at, side="right") - 1] == 0.0 for times, total in changes]).T
    spans = np.diff(at, append=last + 1.0).astype(int)
    mixed = good.any(axis=-1) != good.all(axis=-1)
    # the first row of a span of equal ones stands for all, unless it has edges itself
    repeats = np.where(mixed, np.minimum(spans, _MOST_EDGES + 1), 1)
    offsets = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    whole, flags = np.repeat(at, repeats) + offsets, np.repeat(good, repeats, axis=0)
    delays, stable = (whole[:, None] + shares[:-1]).reshape(-1), flags.reshape(-1)
    kept = delays <= longest * (1.0 + 1e-12)
    delays, stable = delays[kept], stable[kept]
    change = np.flatnonzero(stable[1:] != stable[:-1])[: _MOST_EDGES + 1]
    searched = longest
    if len(change) > _MOST_EDGES:  # the delays between two edges are known, the later ones are not listed
        searched, change = float(delays[change[-1]]), change[:-1]
    high = delays[change + 1]
    ends = _edges(cut_of, alone, np.zeros(len(change), dtype=int), high - 1.0 / FRACTIONS, high).tolist()
    ends = [0.0] * bool(stable[0]) + ends
    ends += [searched] * (len(ends) % 2)
    return Intervals(tuple(zip(ends[::2], ends[1::2])), searched, None)


def _edges(cut_of: AnyCutOf, free: Mask, index: Rows, low: Array, high: Array) -> Array:
    """Return the delays between two [periods] at which loops become stable or unstable, (E,).

    A crossing that reaches the phase pi is followed by the secant method, and checked to both sides; where there is
    none, the interval is divided.
    """
    if not len(index):
        return np.zeros(0)
    whole = np.floor(low + 1e-9)

    def stable(rows: Rows, delays: Array) -> Mask:
        shares = np.clip(delays - whole[rows], 0.0, 1.0)
        found = AnyDelay(cut_of(index[rows], shares), free[index[rows]])
        return np.asarray(found.unstable(whole[rows]) == 0)

    every = np.arange(len(index))
    before = stable(every, low)
    result = _followed(cut_of, index, whole, low, high, free)
    beside = _BESIDE_EDGE * np.maximum(result, 1.0)
    sides = [np.clip(np.nan_to_num(result, nan=0.0) + side, low, high) for side in (-beside, beside)]
    sides = [np.where(np.isnan(result), low, side) for side in sides]
    found = stable(np.tile(every, 2), np.concatenate(sides)).reshape(2, -1)
    rows = np.flatnonzero(~((found[0] == before) & (found[1] != before)))
    if rows.size:
        lower, upper, was = low[rows], high[rows], before[rows]
        for _ in range(_SECTIONS):
            grid = lower + (upper - lower) * (np.arange(1, _INNER_POINTS + 1) / (_INNER_POINTS + 1.0))[:, None]
            changed = stable(np.tile(rows, _INNER_POINTS), grid.reshape(-1)).reshape(grid.shape) != was
            grid = np.concatenate([lower[None], grid, upper[None]])
            first = np.argmax(np.concatenate([changed, np.ones((1, len(rows)), dtype=bool)]), axis=0) + 1
            lower, upper = (grid[first - side, np.arange(len(rows))] for side in (1, 0))
        result[rows] = upper
    return result


def _followed(cut_of: AnyCutOf, index: Rows, whole: Array, low: Array, high: Array, free: Mask) -> Array:
    """Return the delay at which the crossing nearest to the phase pi reaches it [periods]; NaN without one."""
    result = np.full(len(index), np.nan)
    start = AnyDelay(cut_of(index, high - whole), free[index])
    if not len(start.rows):
        return result
    excess = _wrapped(start.phases + whole[start.rows] * start.angles)
    order = np.lexsort((np.abs(excess), start.rows))
    rows, first = np.unique(start.rows[order], return_index=True)
    angles, excess, slopes = start.angles[order][first], excess[order][first], start.angles[order][first]
    delays = high[rows]
    for _ in range(_MOST_SECANTS):
        moved = np.clip(delays - excess / np.where(slopes == 0.0, np.inf, slopes), low[rows], high[rows])
        step, delays, last = moved - delays, moved, excess
        if not (np.abs(step) > 1e-15 * np.maximum(delays, 1.0)).any():
            break
        cut = cut_of(index[rows], delays - whole[rows])
        own, near = _polished(cut, np.arange(len(rows)), angles, whole[rows])
        if len(own) < len(rows):
            rows, delays, last, step, slopes = (part[own] for part in (rows, delays, last, step, slopes))
            cut = cut.rows(own)
        angles = near
        if not len(rows):
            return result
        gain, _ = cut.response(np.arange(len(rows)), np.exp(1j * angles), whole[rows])
        excess = _wrapped(-np.angle(gain) + whole[rows] * angles)
        slopes = np.where(step == 0.0, slopes, (excess - last) / np.where(step == 0.0, 1.0, step))
    result[rows] = delays
    return result


def _wrapped(phases: Array) -> Array:
    """Return the distance of phases from pi, within a half turn."""
    return np.asarray(np.mod(phases, 2.0 * np.pi) - np.pi)


def _largest_gain(cut: AnyCut) -> float:
    """Return the largest loop gain over all frequencies and loops."""
    most = 0.0
    for row in range(cut.loops):
        grid = cut.own_angles(row)
        for _ in range(_REFINEMENTS):
            gains = cut.gains(np.full(len(grid), row), np.exp(1j * grid)).max(axis=-1)
            best = int(gains.argmax())
            most = max(most, float(gains[best]))
            grid = np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)], _REFINED_POINTS)
    return most


def dominant_poles(cut: Cut, periods: Array, free: NDArray[Any]) -> NDArray[np.complex128]:
    """Return the dominant pole of loops at whole periods of delay, (P,), above or on the real axis.

    `free` is the number of poles at 1 of free motion, which do not count, (P,).

    The radius of the circle outside of which there is no pole is bracketed by the number of poles outside, then the
    pole is refined by Newton's method on ln L(z) - q ln z = j pi.
    """
    count = len(periods)
    every, unit = np.arange(count), 1.0 / (periods + 1.0)

    def out(logarithms: Array, rows: Rows) -> AnyDelay:
        return AnyDelay(cut.rows(rows).outside(np.exp(logarithms), periods[rows]), np.zeros(len(rows), dtype=bool))

    def outside(logarithms: Array, rows: Rows) -> Mask:
        own = np.where(logarithms < 0.0, free[rows], 0)
        return np.asarray(out(logarithms, rows).unstable(periods[rows]) > own)

    below, above = np.full((2, count), np.nan)
    outward = outside(np.zeros(count), every)
    below[outward] = above[~outward] = 0.0
    step, rows = _FIRST_STEP * unit, every
    for _ in range(_DOUBLINGS):
        logarithms = np.where(outward, step, np.maximum(-step, -_LEAST_RADIUS * unit))[rows]
        has = outside(logarithms, rows)
        has |= logarithms <= -_LEAST_RADIUS * unit[rows]
        below[rows] = np.where(has, logarithms, below[rows])
        above[rows] = np.where(has, above[rows], logarithms)
        rows = rows[has == outward[rows]]
        if not rows.size:
            break
        step = 2.0 * step

    def halved(rows: Rows, steps: int) -> None:
        for _ in range(steps if rows.size else 0):
            middle = 0.5 * (below[rows] + above[rows])
            has = outside(middle, rows)
            below[rows], above[rows] = np.where(has, middle, below[rows]), np.where(has, above[rows], middle)

    halved(every, _BISECTIONS)
    found = out(above, every)  # just outside, the crossing nearest to the phase pi is the pole's
    excess = np.abs(_wrapped(found.phases + periods[found.rows] * found.angles))
    order, angles = np.lexsort((excess, found.rows)), np.zeros(count)
    rows, first = np.unique(found.rows[order], return_index=True)
    angles[rows] = found.angles[order][first]
    poles, exact = _newton(cut, periods, every, np.exp(above + 1j * angles))
    width = above - below
    radius = np.log(np.abs(np.where(exact, poles, 1.0)))
    exact &= (radius > below - width) & (radius < above + width)
    exact &= ~outside(np.where(exact, radius + _BESIDE_EDGE * unit, above), every)
    rows = np.flatnonzero(~exact)
    halved(rows, 4 * _BISECTIONS)
    for row in rows.tolist():  # a real pole, or a crossing that is almost a tangent
        starts = np.exp(above[row] + 1j * np.concatenate([[0.0], _ANGLES, _EVEN_ANGLES]))
        gain, _ = cut.response(np.full(len(starts), row), starts)
        with np.errstate(all="ignore"):
            starts = starts[np.argsort(np.abs(1.0 + gain * starts ** -periods[row]))[:_MOST_STARTS]]
        own = np.linalg.eigvals(cut.advance[row])
        starts = np.append(starts, own * (1.0 + _OFF_OWN_POLE))
        same = np.full(len(starts), row)
        pairs = _newton(cut, periods, same, starts), _newton(cut, periods, same, starts, reciprocal=True)
        refined, exact = (np.concatenate(part) for part in zip(*pairs))
        error = np.where(exact, np.abs(np.log(np.abs(np.where(exact, refined, 2.0))) - above[row]), np.inf)
        best = int(error.argmin())
        if not error[best] < _ERROR_OF_RADIUS:  # closer to a pole of the loop that is cut than Newton's method resolves
            best = int(np.abs(np.abs(own) - np.exp(above[row])).argmin())
            refined = np.exp(above[row] + 1j * np.angle(own))
        poles[row] = refined[best]
    for row in np.flatnonzero(~cut.give.any(axis=-1)).tolist():  # no law on the host
        own = np.linalg.eigvals(cut.advance[row])
        own = own[np.argsort(np.abs(own - 1.0))][int(free[row]) :]
        poles[row] = own[np.abs(own).argmax()] if len(own) else 0.0
    return np.where(poles.imag < 0.0, poles.conj(), poles)


def _newton(
    cut: Cut, periods: Array, rows: Rows, poles: NDArray[np.complex128], *, reciprocal: bool = False
) -> tuple[NDArray[np.complex128], Mask]:
    """Return solutions of ln L(z) - q ln z = j pi, or of z^q/L(z) = -1, from starts, and whether each converged."""
    poles, whole = poles.astype(np.complex128), periods[rows]
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            good = np.abs(np.log(np.abs(poles))) < 1.0  # not at 0, where the memory of one sample has a pole
            gain, slope = cut.response(rows, np.where(good, poles, 2.0))
            error = np.log(-gain) - whole * np.log(poles)
            error = error.real + 1j * _wrapped(error.imag + np.pi)
            ratio = np.exp(-error)
            step = (ratio - 1.0) / ratio if reciprocal else -error
            poles = poles + step / (slope / gain - whole / poles)
        return poles, np.isfinite(poles) & (np.abs(error) < _ERROR_OF_SOLUTION)
