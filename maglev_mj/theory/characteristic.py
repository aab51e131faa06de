"""Characteristic polynomial of a wall's closed loop.

It is explicit in the gains.

The polynomial is linear in the gains, p0(z) + k p1(z) + b p2(z), for every design here: PD with any linear velocity
estimate or prediction, and the observer. For an eigenvalue on the unit circle, z = exp(i theta), it gives two real
equations, so k and b are explicit in theta: ratios of polynomials in x = cos theta. At a given damping, all stiffnesses
of a root crossing are the roots of one such polynomial, so none is missed as in a scan. A circle of another radius
gives the boundary of a margin in the same way.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.theory.closed_loop import SampledLoop

_LEAST, _TRIM = 1e-11, 1e-10
_PAIRS = np.array([[0.0, 1.0, 0.0, 2.0], [0.0, 0.0, 1.0, 2.0]])
_Series: TypeAlias = Array


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
