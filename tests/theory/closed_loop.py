"""Closed-loop matrices derived independently of the package, for tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def pd_matrix(stiffness: float, damping: float, *, period: float, delay: float, mass: float) -> NDArray[np.float64]:
    """Return the exact map over one period, for any delay.

    The state is (x, v, x[k-1], forces not yet in effect).

    A force computed at sample k takes effect `delay` later and holds for one period.
    """
    whole = int(np.floor(delay / period + 1e-9))
    rest = delay - whole * period
    size = 4 + whole
    # state: x, v, previous x, then the forces of the samples k-1, k-2, ..., newest first
    force = np.zeros(size)
    force[0], force[2] = -stiffness - damping / period, damping / period
    advance = np.zeros((size, size))
    old, new = np.zeros(size), force if whole == 0 else np.eye(size)[3 + whole - 1]
    old[3 + whole] = 1.0
    left = period - rest
    advance[0, :2] = 1.0, period
    advance[1, 1] = 1.0
    advance[0] += (old * (rest * left + 0.5 * rest**2) + new * 0.5 * left**2) / mass
    advance[1] += (old * rest + new * left) / mass
    advance[2, 0] = 1.0
    advance[3] = force
    for place in range(4, size):
        advance[place, place - 1] = 1.0
    return advance


def spectral_radius(stiffness: float, damping: float, *, period: float, delay: float, mass: float) -> float:
    """Return the spectral radius of `pd_matrix`."""
    matrix = pd_matrix(stiffness, damping, period=period, delay=delay, mass=mass)
    return float(np.abs(np.linalg.eigvals(matrix)).max())
