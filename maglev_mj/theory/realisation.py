"""State space of a controller whose impulse response is long.

Its states are those that the response needs, by Ho and Kalman's method: the response's block Hankel matrix has their
number as its rank, and its column space the same one sample later.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.theory.linearise import loop_matrices

_RANK, _FIT, _MOST, _INTEGRATES = 1e-7, 1e-6, 24, 1e-7
"""Least singular value, largest error, most states, and distance of an integrator's root.

Responses are known to 1e-9 of their largest value.
"""


class StateSpace(NamedTuple):
    """Linear controller without units.

    q[k+1] = advance q[k] + take x[k], and force[k] = give q[k] + direct x[k].

    Positions times sqrt(inertia), forces times T²/sqrt(inertia).
    """

    advance: Array
    take: Array
    give: Array
    direct: Array

    def moments(self) -> tuple[Array, Array]:
        """Return the sums of the response and of age times response, (n, n) each.

        The first is infinite if the controller integrates.
        """
        still = np.eye(len(self.advance)) - self.advance
        if (np.abs(np.linalg.eigvals(still)) < _INTEGRATES).any():
            return np.full_like(self.direct, -np.inf), np.zeros_like(self.direct)
        once = np.linalg.solve(still, self.take)
        return self.direct + self.give @ once, self.give @ np.linalg.solve(still, once)

    def closed_loop(self, *, period: float, delay: float, inertia: Array) -> Array:
        """Return the closed loop's matrix; see `loop_matrices`.

        Args:
            period: Sample period [s].
            delay: Transport delay [s], up to 10 periods.
            inertia: Mass or moments of inertia [kg, kg m²], (n,).
        """
        root, n = np.sqrt(inertia), len(inertia)
        size = np.outer(root, root) / period**2
        unit = np.array([self.direct * size, np.eye(n), np.zeros((n, n))])[:, None]
        body, driven, alone = loop_matrices(unit, period=period, delay=delay, inertia=inertia)
        force = (driven - alone)[:, :n] @ (self.give * root[:, None] / period**2)
        enters = np.zeros((len(self.take), len(body)))
        enters[:, :n] = self.take * root
        return np.block([[body, force], [enters, self.advance]])


def realised(response: Array) -> StateSpace | None:
    """Return the least controller with an impulse response, or None.

    None is for a response of no linear law with few states.

    Args:
        response: Answer at sample j to a unit displacement at sample 0 alone, (M, n, n): [j, to, from].
    """
    direct, later = response[0], response[1:]
    half, n = len(later) // 2, response.shape[1]
    hankel = np.block([[later[row + column] for column in range(half)] for row in range(half)])
    to, sizes, come = np.linalg.svd(hankel)
    states = int((sizes > _RANK * sizes[0]).sum())
    if states > _MOST:
        return None
    root = np.sqrt(sizes[:states])
    seen, reached = to[:, :states] * root, root[:, None] * come[:states]
    advance = np.linalg.lstsq(seen[:-n], seen[n:], rcond=None)[0]
    state, fits = reached[:, :n], 0.0
    for answer in later:
        fits = max(fits, float(np.abs(seen[:n] @ state - answer).max()))
        state = advance @ state
    if not fits <= _FIT * np.abs(response).max():
        return None
    return StateSpace(advance, reached[:, :n], seen[:n], direct)
