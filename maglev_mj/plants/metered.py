"""A MuJoCo plant that adds up the work of its actuators."""

from __future__ import annotations

from typing import Any

from maglev_mj.plants.mujoco import Drive, MuJoCoPlant

__all__ = ["MeteredPlant"]


class MeteredPlant(MuJoCoPlant):
    """`MuJoCoPlant` with a meter for the work of its actuators.

    Their wrench is constant over each stretch of the motion, so the work is wrench times way, whatever else pushes:
    exact for the translations, to second order in the angle for the rotations. With lagging drivers it is that of
    the commanded wrench.

    Args:
        args: As for `MuJoCoPlant`.
        keywords: As for `MuJoCoPlant`.

    Attributes:
        work: Work since release [J].
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        self.work = 0.0
        super().__init__(*args, **keywords)

    def _advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        x, y, z, w, a, b, c = self._look()
        super()._advance(duration, drive, pieces)
        p, q, r, d, i, j, k = self._look()
        fx, fy, fz, tx, ty, tz = drive[0]
        # twice the vector part of the turn between the two orientations
        rx = w * i - a * d - b * k + c * j
        ry = w * j - b * d - c * i + a * k
        rz = w * k - c * d - a * j + b * i
        self.work += fx * (p - x) + fy * (q - y) + fz * (r - z) + 2.0 * (tx * rx + ty * ry + tz * rz)
