"""Velocity from sampled positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from maglev_mj.frames import Component

__all__ = ["FiniteDifference"]


@dataclass(frozen=True)
class FiniteDifference:
    """First-order backward difference; zero at the first sample.

    Source: Salcudean & Vlaar 1997, eq. (3).
    """

    def __call__(
        self, position: Sequence[Component], state: Sequence[Component] | None, period: float
    ) -> tuple[Sequence[Component], Sequence[Component]]:
        """Return (x[k] - x[k-1]) / T for each component, and the positions as the next state."""
        # written out: a loop over six components takes twice as long, and this runs on every tick
        x, y, z, rx, ry, rz = position
        x0, y0, z0, rx0, ry0, rz0 = position if state is None else state
        return (
            (x - x0) / period,
            (y - y0) / period,
            (z - z0) / period,
            (rx - rx0) / period,
            (ry - ry0) / period,
            (rz - rz0) / period,
        ), position
