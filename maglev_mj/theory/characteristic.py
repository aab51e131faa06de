"""Characteristic polynomial of a wall's closed loop.

It is explicit in the gains.

The polynomial is linear in the gains, p0(z) + k p1(z) + b p2(z), for every design here: PD with any linear velocity
estimate or prediction, and the observer. For an eigenvalue on the unit circle, z = exp(i theta), it gives two real
equations, so k and b are explicit in theta: ratios of polynomials in x = cos theta. At a given damping, all stiffnesses
of a root crossing are the roots of one such polynomial, so none is missed as in a scan. A circle of another radius
gives the boundary of a margin in the same way.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.theory.closed_loop import SampledLoop

__all__ = ["Characteristic", "SampledCurve", "characteristic", "crossings", "scales"]

_LEAST, _MOST, _FAR = 1e-11, 1e3, 3.0
_TRIM = 1e-10
_SLOWEST, _SLOW, _EACH = 1e-4, 0.25, 20
"""Angles and numbers of the samples.

Least angle sampled [rad], end of the geometric spacing [rad], and samples per power of z beyond it.
"""
_PAIRS = np.array([[0.0, 1.0, 0.0, 2.0], [0.0, 0.0, 1.0, 2.0]])
_Series: TypeAlias = Array
_Index: TypeAlias = NDArray[np.intp]


class Characteristic(NamedTuple):
    """Coefficients of p0, p1 and p2, lowest power first.

    (..., n + 1) each, on a circle of some radius.

    Gains are in units of m/T² and m/T, so that all coefficients are of order one.
    """

    free: Array
    stiff: Array
    damped: Array


def scales(loop: SampledLoop) -> tuple[Array, Array]:
    """Return the units of stiffness and damping.

    They are m/T² and m/T, (...,) each.
    """
    period = np.asarray(loop.period)
    shape = np.broadcast_shapes(loop.shape, period.shape)
    return np.broadcast_to(loop.moving_mass / period**2, shape), np.broadcast_to(loop.moving_mass / period, shape)


def characteristic(loop: SampledLoop, radius: float) -> Characteristic:
    """Return the scaled characteristic polynomial of a loop.

    A circle of `radius` is scaled to the unit circle.

    Raises:
        ParameterError: If the polynomial is not linear in the gains.
    """
    stiff, damp = (np.asarray(unit)[..., None] for unit in scales(loop))
    matrices = loop.widened().matrix(_PAIRS[0] * stiff, _PAIRS[1] * damp)
    size = matrices.shape[-1]
    turns = radius * np.exp(2j * np.pi * np.arange(size + 1) / (size + 1))
    values = np.linalg.det(turns[:, None, None] * np.eye(size) - matrices[..., None, :, :])
    free, first, second, both = np.moveaxis(np.fft.fft(values, axis=-1).real / (size + 1), -2, 0)
    if not np.allclose(both + 3.0 * free, 2.0 * (first + second), rtol=0.0, atol=1e-9 * np.abs(both).max()):
        raise ParameterError("design must be linear in its gains: its characteristic polynomial is not")
    return Characteristic(free, first - free, second - free)


def crossings(parts: Characteristic, damping: Array) -> Array:
    """Return all stiffnesses of possible root crossings, ascending.

    (N, c), above 0, filled with infinity. A crossing is that of a root through the circle.

    Args:
        parts: (N, n + 1) each, or (n + 1,).
        damping: In units of m/T, (N,).
    """
    damped = parts.free + damping[:, None] * parts.damped
    angles = _roots(_turned(damped, np.broadcast_to(parts.stiff, damped.shape)))
    return np.sort(_stiffness(damped, parts.stiff, angles), axis=-1)


def _stiffness(damped: Array, stiff: Array, angles: Array) -> Array:
    """Return the stiffness at angles of a curve, (..., A).

    It is infinity if not above 0.
    """
    powers = np.exp(1j * angles[..., None] * np.arange(damped.shape[-1]))
    held, sprung = (np.matmul(powers, part[..., None])[..., 0] for part in (damped, stiff))
    with np.errstate(divide="ignore", invalid="ignore"):
        stiffness = -(held * sprung.conj()).real / np.abs(sprung) ** 2
    return np.where(stiffness > _LEAST, stiffness, np.inf)


class SampledCurve:
    """Gains with a root on the circle, densely sampled.

    The samples serve many dampings at once.

    Args:
        parts: Characteristic polynomial of one loop, (n + 1,) each.

    Attributes:
        extremes: Dampings of the curve's extremes, folds and crossings with the line of z = -1, in units of m/T.
    """

    def __init__(self, parts: Characteristic) -> None:
        self._parts, turning = parts, _turning_angles(parts)
        usual = _samples(parts.free.size)
        angles, sines, powers = (np.concatenate(both) for both in zip(usual, _tables(turning, parts.free.size)))
        order = np.argsort(angles)
        self._angles = angles[order]
        self._series = np.array([_turned(part, parts.stiff) for part in (parts.free, parts.damped)])
        self._sides = sines[order] @ self._series.T
        values = powers[order] @ np.array(parts).T
        self._real, self._imag = values.real.copy(), values.imag.copy()
        held, damped = (sines[usual[0].size :] @ self._series.T).T
        with np.errstate(divide="ignore", invalid="ignore"):
            self._leans = -(values[:, ::2] / values[:, 1:2]).real
            self.extremes = -held / damped

    def reach(self, damping: Array) -> Array:
        """Return the largest stable stiffness at each damping, (N,).

        Every softer wall is stable too. Both gains are without units.
        """
        rows, angles = self._crossings(damping)
        damped = self._parts.free + damping[:, None] * self._parts.damped
        stiff = np.broadcast_to(self._parts.stiff, damped.shape)
        ends = np.broadcast_to([0.0, np.pi], (damping.size, 2))
        result = _stiffness(damped, stiff, ends).min(axis=-1)
        np.minimum.at(result, rows, _stiffness(damped[rows], stiff[rows], angles[:, None])[:, 0])
        return np.where(self._stable(0.5 * np.minimum(result, _MOST), damping), result, 0.0)

    def _crossings(self, damping: Array) -> tuple[_Index, Array]:
        """Return row indices and angles of candidate crossings.

        The rows are those of the dampings; the least stiffness of each row is at one of its angles between 0 and pi.
        """
        sides = self._sides[:, 0] + damping[:, None] * self._sides[:, 1]
        above = sides[:, 1:-1] > 0.0  # it always vanishes at the ends
        rows, place = np.nonzero(above[:, 1:] != above[:, :-1])
        place = place + 1
        one, other = (self._leans[place + on, 0] + damping[rows] * self._leans[place + on, 1] for on in (0, 1))
        high, least = np.maximum(one, other), np.full(damping.size, np.inf)
        np.minimum.at(least, rows, np.where(high > 0.0, high, np.inf))
        near = ~((high <= 0.0) | (np.minimum(one, other) > _FAR * least[rows]))  # at a pole of the curve too
        rows, place = rows[near], place[near]
        low, high, left, right = (
            self._angles[place],
            self._angles[place + 1],
            sides[rows, place],
            sides[rows, place + 1],
        )
        angles = low + (high - low) * left / (left - right)
        series = self._series[0] + damping[rows, None] * self._series[1]
        order = np.arange(1, series.shape[-1] + 1)
        for _ in range(2):
            turns = angles[:, None] * order
            with np.errstate(divide="ignore", invalid="ignore"):
                step = (np.sin(turns) * series).sum(axis=-1) / (np.cos(turns) * (order * series)).sum(axis=-1)
            angles = np.clip(angles - step, low, high)
        return rows, angles

    def _stable(self, stiffness: Array, damping: Array) -> Mask:
        """Return True for gains with all roots inside.

        The polynomial then makes n half turns on half of the circle.
        """
        gains = np.stack([np.ones_like(damping), stiffness, damping])
        real, imag = ((part @ gains).T for part in (self._real, self._imag))
        above, first, last = imag[:, 1:-1] > 0.0, real[:, 0] < 0.0, real[:, -1] < 0.0
        rows, place = np.nonzero(above[:, 1:] != above[:, :-1])
        here, there = (real[rows, place + ahead] + 1j * imag[rows, place + ahead] for ahead in (1, 2))
        turns = np.bincount(rows, np.sign((here.conj() * there).imag), minlength=damping.size)
        turns += np.where(above[:, 0], 0.0, np.where(first, 1.0, -1.0))
        turns += (turns % 2.0 != last) - 1.0 * first
        return np.asarray(turns == self._parts.free.size - 1)


def _turning_angles(parts: Characteristic) -> Array:
    """Return the angles of the curve's extremes and folds.

    Crossings with the line of z = -1 are included.
    """
    # k = a / c and b = d / c along the curve, series of T_m(cos theta)
    a, d, c = (
        _chebyshev(sign * _turned(*pair))
        for sign, pair in (
            (-1.0, (parts.free, parts.damped)),
            (1.0, (parts.free, parts.stiff)),
            (1.0, (parts.stiff, parts.damped)),
        )
    )
    last = [float(part @ (-1.0) ** np.arange(part.size)) for part in parts]
    rising = [
        chebyshev.chebsub(
            *(chebyshev.chebmul(*pair) for pair in ((chebyshev.chebder(up), c), (up, chebyshev.chebder(c))))
        )
        for up in (a, d)
    ]
    meets = chebyshev.chebadd(chebyshev.chebadd(last[1] * a, last[2] * d), last[0] * c)
    roots = np.concatenate(
        [chebyshev.chebroots(chebyshev.chebtrim(series, _TRIM * np.abs(series).max())) for series in (*rising, meets)]
    )
    angles = np.arccos(roots[(roots.imag == 0.0) & (np.abs(roots) <= 1.0)].real)
    return np.asarray(angles[(angles > _SLOWEST) & (angles < np.pi - _SLOWEST)])


def _chebyshev(series: _Series) -> Array:
    """Convert a sine series to a Chebyshev series.

    From sin((m + 1) theta) over sin(theta) to T_m(cos theta).
    """
    result = np.zeros(series.size)
    for order, value in enumerate(series):  # U_m = 2 (T_m + T_{m-2} + ...), T_0 counted once
        result[order::-2] += 2.0 * value
    result[0] *= 0.5
    return result


def _turned(one: Array, other: Array) -> _Series:
    """Return Im(one conj(other)) as a sine series, (..., n).

    On the unit circle, as a series of sin((m + 1) theta).
    """
    size = max(one.shape[-1], other.shape[-1])
    terms = [
        (one[..., shift:] * other[..., : size - shift] - one[..., : size - shift] * other[..., shift:]).sum(axis=-1)
        for shift in range(1, size)
    ]
    return np.stack(terms, axis=-1)


def _roots(series: _Series) -> Array:
    """Return the zeros of sine series in [0, pi].

    The series are of sin((m + 1) theta), the angles (N, n) to (N, n + 1), NaN for none.

    Both ends are always zeros. Those between are eigenvalues of the comrade matrix of U_m(cos theta), for each degree
    that occurs, refined by Newton's method.
    """
    count, most = series.shape
    result = np.full((count, most + 1), np.nan)
    result[:, -2:] = 0.0, np.pi
    known = np.abs(series) > _TRIM * np.abs(series).max(axis=-1, keepdims=True)
    degrees = np.where(known.any(axis=-1), most - 1 - np.argmax(known[:, ::-1], axis=-1), 0)
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


@lru_cache(maxsize=32)
def _samples(size: int) -> tuple[Array, Array, Array]:
    """Return `_tables` for the sample angles from 0 to pi."""
    slow = np.geomspace(_SLOWEST, _SLOW, 8 * _EACH, endpoint=False)
    return _tables(np.array([0.0, *slow, *np.linspace(_SLOW, np.pi - _SLOWEST, _EACH * size), np.pi]), size)


def _tables(angles: Array, size: int) -> tuple[Array, Array, Array]:
    """Return angles, sines of their multiples, powers of z.

    (A,), (A, size - 1) and (A, size).
    """
    powers = np.exp(1j * angles[:, None] * np.arange(size))
    return angles, powers.imag[:, 1:], powers
