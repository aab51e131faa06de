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

_NOTHING = 1e-12
"""Angle [rad] that is rounding."""


class CorrectedPlant(MuJoCoPlant):
    """`MuJoCoPlant` with Euler's step and its half-step correction: the cheapest engine for what it gives.

    A semi-implicit step of h moves the flotor by h times the velocity at its end, where a constant force moves it by h
    times the mean: (h/2) dv too far. That is taken off at each sample. Translation is exact to rounding, as with
    RK4, and a step costs a third of its. What changes within a step, a hand's force, lagging drivers, the torques of
    turning about several axes, leaves an error of first order in the step.

    Args:
        args: As for `MuJoCoPlant`.
        keywords: As for `MuJoCoPlant`; the integrator is "euler", whose step the other semi-implicit ones share on a
            free body.

    Raises:
        ParameterError: As for `MuJoCoPlant`, and for another integrator.
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **_with_euler(keywords))
        self._read_engine, self._read_pose = self._read_pose, self._read_corrected
        self._read_velocity = self._qvel.tolist
        self._read_acceleration = self._data.qacc[self.device.velocity_address :][:6].tolist
        self._put = partial(struct.pack_into, "7d", self._qpos.data, 0)
        # with damping in the engine the velocity gains something else than the step times the acceleration
        self._damped = bool(self._model.dof_damping.any() or self._model.tendon_damping.any())
        # how far each stretch since the last correction went too far: a factor, and what it is a factor of
        self._stretches: list[tuple[float, Sequence[float]]] = []

    def _advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        if pieces > 1 or self._damped:
            before = self._read_velocity()
            MuJoCoPlant._advance(self, duration, drive, pieces)
            gained = [after - earlier for after, earlier in zip(self._read_velocity(), before)]
            self._stretches.append((0.5 * duration / pieces, gained))
            return
        if drive is not self._applied:
            self._apply(drive)
        self._options.timestep = duration
        self._step()
        self._stretches.append((0.5 * duration * duration, self._read_acceleration()))

    def _look(self) -> tuple[float, float, float, float, float, float, float]:
        x, y, z, w, a, b, c = self._read_engine()
        rx = ry = rz = 0.0
        for factor, (u, v, up, p, q, r) in self._stretches:
            x -= factor * u
            y -= factor * v
            z -= factor * up
            rx += factor * p
            ry += factor * q
            rz += factor * r
        if rx * rx + ry * ry + rz * rz > _NOTHING * _NOTHING:
            w, a, b, c = _turned_back(w, a, b, c, rx, ry, rz)
        return x, y, z, w, a, b, c

    def _read_corrected(self) -> Sequence[float]:
        """Move the flotor back by what the steps since the last correction are ahead; return where it is then."""
        pose = self._look()
        self._stretches.clear()
        self._put(*pose)
        return pose


class CorrectedBatchPlant(MuJoCoBatchPlant):
    """`MuJoCoBatchPlant` with Euler's step and its half-step correction; see `CorrectedPlant`.

    Args:
        args: As for `MuJoCoBatchPlant`.
        keywords: As for `MuJoCoBatchPlant`; the integrator is "euler".

    Raises:
        ParameterError: As for `MuJoCoBatchPlant`, and for another integrator.
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **_with_euler(keywords))
        self._over: Any = 0.0

    def _advance(self, duration: Component, drive: BatchDrive, pieces: int = 1) -> None:
        before = self._qvel.copy()
        super()._advance(duration, drive, pieces)
        self._over = self._over + np.reshape(0.5 * np.asarray(duration) / pieces, (-1, 1)) * (self._qvel - before)

    def _components(self) -> list[Component]:
        over, self._over = self._over, 0.0
        if np.ndim(over):
            self._qpos[:, :3] -= over[:, :3]
            if (np.abs(over[:, 3:]) > _NOTHING).any():
                w, a, b, c = self._qpos[:, 3:].T.copy()
                self._qpos[:, 3:] = np.stack(_turned_back(w, a, b, c, *over[:, 3:].T), axis=-1)
        return super()._components()


def _with_euler(keywords: dict[str, Any]) -> dict[str, Any]:
    """Return a plant's keywords with Euler's integrator."""
    if keywords.setdefault("integrator", "euler") != "euler":
        raise ParameterError(f"integrator must be euler, which is what is corrected, not {keywords['integrator']!r}")
    return keywords


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
