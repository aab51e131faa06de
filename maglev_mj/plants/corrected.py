"""Semi-implicit Euler made exact under a constant force, by taking off what its steps add to the position."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Component
from maglev_mj.plants.batch import Drive as BatchDrive
from maglev_mj.plants.batch import MuJoCoBatchPlant
from maglev_mj.plants.mujoco import Drive, MuJoCoPlant

__all__ = ["CorrectedBatchPlant", "CorrectedPlant"]

_NOT_OVER = (0.0,) * 6
_NOTHING = 1e-12
"""Angle [rad] that is rounding."""


class CorrectedPlant(MuJoCoPlant):
    """`MuJoCoPlant` with Euler's step and its half-step correction: the cheapest engine for what it gives.

    A semi-implicit step of h moves the flotor by h times the velocity at its end, where a constant force moves it by h
    times the mean: (h/2) dv too far. That is taken off at each sample. Translation is exact to rounding, as with
    RK4, at a third of its cost; rotation is off by the second order of the step. Under a force that changes within a
    step, as a hand's and lagging drivers' do, an error of first order in the step stays.

    Args:
        args: As for `MuJoCoPlant`.
        integrator: "euler", "implicit", "implicitfast" or "discrete": on a free body their steps are one and the same.
        keywords: As for `MuJoCoPlant`.

    Raises:
        ParameterError: As for `MuJoCoPlant`, and for "rk4".
    """

    def __init__(self, *args: Any, integrator: str = "euler", **keywords: Any) -> None:
        super().__init__(*args, integrator=_semi_implicit(integrator), **keywords)
        self._read_engine, self._read_pose = self._read_pose, self._read_corrected
        self._read_velocity = self._qvel.tolist
        self._put = partial(struct.pack_into, "7d", self._qpos.data, 0)
        self._before: Sequence[float] = self._read_velocity()
        self._over = _NOT_OVER

    def _advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        MuJoCoPlant._advance(self, duration, drive, pieces)  # by name: super() takes longer
        half = 0.5 * duration / pieces
        u0, v0, w0, p0, q0, r0 = self._before
        self._before = u, v, w, p, q, r = self._read_velocity()
        x, y, z, rx, ry, rz = self._over
        self._over = (
            x + half * (u - u0),
            y + half * (v - v0),
            z + half * (w - w0),
            rx + half * (p - p0),
            ry + half * (q - q0),
            rz + half * (r - r0),
        )

    def _read_corrected(self) -> Sequence[float]:
        """Move the flotor back by what the steps since the last correction are ahead; return where it is then."""
        x, y, z, w, a, b, c = self._read_engine()
        dx, dy, dz, rx, ry, rz = self._over
        self._over = _NOT_OVER
        if rx * rx + ry * ry + rz * rz > _NOTHING * _NOTHING:
            w, a, b, c = _turned_back(w, a, b, c, rx, ry, rz)
        pose = x - dx, y - dy, z - dz, w, a, b, c
        self._put(*pose)
        return pose


class CorrectedBatchPlant(MuJoCoBatchPlant):
    """`MuJoCoBatchPlant` with Euler's step and its half-step correction; see `CorrectedPlant`.

    Args:
        args: As for `MuJoCoBatchPlant`.
        integrator: As for `CorrectedPlant`.
        keywords: As for `MuJoCoBatchPlant`.

    Raises:
        ParameterError: As for `MuJoCoBatchPlant`, and for "rk4".
    """

    def __init__(self, *args: Any, integrator: str = "euler", **keywords: Any) -> None:
        super().__init__(*args, integrator=_semi_implicit(integrator), **keywords)

    def _advance(self, duration: Component, drive: BatchDrive, pieces: int = 1) -> None:
        before = self._qvel.copy()
        super()._advance(duration, drive, pieces)
        half = np.reshape(0.5 * np.asarray(duration) / pieces, (-1, 1))
        over = half * (self._qvel - before)
        self._qpos[:, :3] -= over[:, :3]
        if (np.abs(over[:, 3:]) > _NOTHING).any():
            w, a, b, c = self._qpos[:, 3:].T.copy()
            self._qpos[:, 3:] = np.stack(_turned_back(w, a, b, c, *over[:, 3:].T), axis=-1)


def _semi_implicit(integrator: str) -> str:
    if integrator == "rk4":
        raise ParameterError("integrator must be a semi-implicit one to be corrected, not 'rk4'")
    return integrator


def _turned_back(
    w: Component, a: Component, b: Component, c: Component, rx: Component, ry: Component, rz: Component
) -> tuple[Component, Component, Component, Component]:
    """Return a unit quaternion turned by a small angle (rx, ry, rz) [rad] about its own axes, backward."""
    # the engine normalizes what it reads
    p, q, r = -0.5 * rx, -0.5 * ry, -0.5 * rz
    one = 1.0 - 0.5 * (p * p + q * q + r * r)
    return (
        w * one - a * p - b * q - c * r,
        w * p + a * one + b * r - c * q,
        w * q - a * r + b * one + c * p,
        w * r + a * q - b * p + c * one,
    )
