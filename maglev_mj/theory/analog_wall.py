"""Closed-form drop on the ideal analog wall."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.parameters import number, numbers
from maglev_mj.spec import GRAVITY


def analog_wall(
    time: ArrayLike,
    *,
    height: float,
    stiffness: float,
    damping: float,
    mass: float,
    bandwidth: float = 10e3,
    gravity: float = GRAVITY,
) -> tuple[Array, Array, Array]:
    """Simulate a drop on the ideal analog wall.

    The wall is that of eq. (1). The wall force passes a first-order low-pass.

    The motion is a closed form inside the wall (three modes) and outside it (free fall with a decaying force); the
    crossings between the two are found to rounding.

    Args:
        time: Times since release [s], ascending, (M,).
        height: Drop height above the wall at z = 0 [m].
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        mass: Falling mass [kg].
        bandwidth: Cut-off of the low-pass [Hz].
        gravity: Acceleration of free fall [m/s²].

    Returns:
        Height [m], velocity [m/s] and wall force [N], (M,) each.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: Salcudean & Vlaar 1997, eq. (1) and figure 4.
    """
    times = np.atleast_1d(numbers("time", time, at_least=0.0))
    if times.ndim > 1 or (np.diff(times) < 0.0).any():
        raise ParameterError("time must be (M,) and ascending")
    k, b = number("stiffness", stiffness, above=0.0), number("damping", damping, at_least=0.0)
    m, g = number("mass", mass, above=0.0), number("gravity", gravity, above=0.0)
    rate = 2.0 * math.pi * number("bandwidth", bandwidth, above=0.0)
    inside, outside = _in_wall(k, b, m, g, rate), _in_air(m, g, rate)
    scan = 0.02 * min(math.sqrt(m / k), math.sqrt(2.0 * number("height", height, above=0.0) / g))
    state, start, end = np.array([height, 0.0, 0.0]), 0.0, float(times[-1]) if times.size else 0.0
    out = np.empty((times.size, 3))
    touching = False
    while True:
        motion = inside if touching else outside
        leave = _next_crossing(motion, state, scan, end - start, touching)
        here = (times >= start) & (times <= start + leave)
        out[here] = motion(state, times[here] - start)
        if start + leave >= end:
            return out[:, 0], out[:, 1], out[:, 2]
        state, start, touching = motion(state, np.array([leave]))[0], start + leave, not touching
        state[0] = 0.0


Motion = Callable[[Array, Array], Array]
"""Function from a state and times to states.

From (z, v, f) and (M,) to (M, 3).
"""


def _in_wall(k: float, b: float, m: float, g: float, rate: float) -> Motion:
    matrix = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / m], [-rate * k, -rate * b, -rate]])
    values, vectors = np.linalg.eig(matrix)
    inverse = np.linalg.inv(vectors)
    rest = np.array([-m * g / k, 0.0, m * g])

    def motion(state: Array, time: Array) -> Array:
        modes = inverse @ (state - rest) * np.exp(np.multiply.outer(time, values))
        states: Array = rest + (modes @ vectors.T).real
        return states

    return motion


def _in_air(m: float, g: float, rate: float) -> Motion:
    def motion(state: Array, time: Array) -> Array:
        z, v, f = state
        gone = -np.expm1(-rate * time)
        push = f / (m * rate)
        height = z + time * (v - 0.5 * g * time) + push * (time - gone / rate)
        return np.stack([height, v - g * time + push * gone, f * (1.0 - gone)], axis=-1)

    return motion


def _next_crossing(motion: Motion, state: Array, scan: float, longest: float, inside: bool) -> float:
    """Return the time until z changes sign, at most `longest`.

    It is scanned, then bisected to rounding.
    """
    sign = -1.0 if inside else 1.0
    for start in np.arange(0.0, longest, 256 * scan):
        grid = start + scan * np.arange(1, 258)
        out = np.flatnonzero(sign * motion(state, grid)[:, 0] < 0.0)
        if out.size:
            high = float(grid[out[0]])
            low = high - scan
            for _ in range(60):
                middle = 0.5 * (low + high)
                if sign * motion(state, np.array([middle]))[0, 0] < 0.0:
                    high = middle
                else:
                    low = middle
            return min(high, longest)
    return longest
