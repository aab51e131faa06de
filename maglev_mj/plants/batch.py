"""N devices in one MuJoCo batch, stepped by several threads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias, Unpack

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.timeline import Timing
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array, Component, components, join, rotation_vector
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import number, numbers
from maglev_mj.plants.base import PlantKeywords, SampledPlant
from maglev_mj.plants.coils import UPRIGHT, CoilMap
from maglev_mj.plants.engine import (
    NOTHING,
    effort_addresses,
    longest_step,
    prepared,
    start_state,
    turned_back,
    turned_work,
)
from maglev_mj.plants.hand import Hand
from maglev_mj.plants.model import COILS, Model
from maglev_mj.spec import GRAVITY

Drive: TypeAlias = tuple[Array, Array]
"""Wrenches (N, 6) and engine controls (N, 6)."""

_Kept: TypeAlias = tuple[Sequence[Component], Array, Array, Array, Array | None, Array | None]
"""Snapshot of a batch.

Position x y z and quaternion, the engine's own quaternion (N, 4), velocities (N, 6), wrenches (N, 6), currents (N, 6),
inverse coil maps.
"""


class MuJoCoBatchPlant(SampledPlant):
    """N MuJoCo devices advanced by one engine call.

    Each device is as in `MuJoCoPlant` with its coils.

    Args:
        timing: Sample period, delay and phase; (N,) phases go with poses (N, 6).
        model: See `MuJoCoPlant`, and for mass, inertia, gravity, coils, coil_map, driver_lag, driver_time_constant.
        mass: Moving mass in place of the model's [kg].
        inertia: Moments of inertia in place of the model's [kg m²], (3,).
        pose: Poses at release [m, rad], (N, 6).
        twist: Velocities at release [m/s, rad/s], (N, 6) or (6,).
        gravity: Acceleration of free fall [m/s²].
        coils: Send each wrench through the coils.
        coil_map: Coils in place of the model's.
        driver_lag: Switch the current drivers' first-order lag on.
        driver_time_constant: Time constant of that lag in place of the model's [s].
        hand: A hand on each flotor, all alike.
        integrator: One of `INTEGRATORS`.
        threads: Number of stepping threads; 0 for one per processor.
        keywords: As for `MuJoCoPlant`.

    Raises:
        ParameterError: If a value is outside its bounds or the shapes do not fit.
        ModelError: If the model cannot be used.
    """

    def __init__(
        self,
        timing: Timing | None = None,
        *,
        model: Model = "drop",
        mass: float | None = None,
        inertia: ArrayLike | None = None,
        pose: ArrayLike,
        twist: ArrayLike = (0.0,) * 6,
        gravity: ArrayLike = GRAVITY,
        coils: bool = True,
        coil_map: CoilMap | None = None,
        driver_lag: bool = False,
        driver_time_constant: float | None = None,
        hand: Hand | None = None,
        integrator: str = "rk4",
        threads: int = 0,
        **keywords: Unpack[PlantKeywords],
    ) -> None:
        timing = timing or Timing()
        start, motion = numbers("pose", pose), numbers("twist", twist)
        if start.ndim != 2 or start.shape[1] != 6 or np.shape(timing.phase) not in ((), start.shape[:1]):
            raise ParameterError(
                f"pose must be (N, 6) and phase a number or (N,), not {start.shape} and {np.shape(timing.phase)}"
            )
        if motion.shape not in ((6,), start.shape):
            raise ParameterError(f"twist must be (6,) or {start.shape}, not {motion.shape}")
        count = int(number("threads", threads, at_least=0))
        if driver_lag and not coils:
            raise ParameterError("driver_lag needs coils=True")
        self.device = prepared(
            model,
            gravity=gravity,
            integrator=integrator,
            mass=mass,
            inertia=inertia,
            coils=coils,
            coil_map=coil_map if coils else None,
            driver_lag=driver_lag,
            driver_time_constant=driver_time_constant,
            hand=hand,
        )
        from mujoco.batch import Batch  # the engine is loaded by now

        self._engine = Batch(self.device.model, len(start), count)
        for row, (place, speed) in enumerate(zip(start, np.broadcast_to(motion, start.shape), strict=True)):
            self._engine.qpos[row], self._engine.qvel[row] = start_state(self.device, place, speed, hand)
        self._qpos = self._engine.bind("qpos")[:, self.device.position_address :][:, :7]
        self._qvel = self._engine.bind("qvel")[:, self.device.velocity_address :][:, :6]
        self._controls = (
            self._engine.bind("ctrl")[:, : len(COILS)]
            if coils
            else self._engine.bind("xfrc_applied").reshape(len(start), -1, 6)[:, self.device.flotor]
        )
        self._timestep = self._engine.expand("opt.timestep")
        self._efforts = self._engine.bind("qfrc_applied")
        self._effort_addresses = effort_addresses(self.device, hand)
        # inverse maps of the coils, (N, 6, 6) while any flotor is turned; None without coils
        self._inverse_map = None if self.device.coils is None else self.device.coils.current_per_wrench
        if keywords.get("longest_step") is None:
            keywords["longest_step"] = longest_step(self.device, driver_lag=driver_lag, hand=hand)
        self._corrects, self._excess = integrator == "corrected", np.zeros((len(start), 6))
        super().__init__(timing, batch=start.shape[:1], **keywords)
        if driver_lag:
            self._engine.bind("act")[:] = self._timeline.acting[1]

    def _prepare(self, force: Sequence[Component]) -> Drive:
        wrench = np.broadcast_to(join(force), (*self.batch, 6))
        if self._inverse_map is None:
            return wrench, wrench
        return wrench, np.matmul(self._inverse_map, wrench[..., None])[..., 0]

    def _advance(self, duration: Component, drive: Drive, pieces: int = 1) -> None:
        self._controls[:] = drive[1]
        self._timestep[:] = np.reshape(duration, (-1, *(1,) * (self._timestep.ndim - 1))) / pieces
        if not self._corrects:
            self._engine.step(nstep=pieces)
            return
        before = self._qvel.copy()
        self._engine.step(nstep=pieces)
        half = np.reshape(0.5 * np.asarray(duration) / pieces, (-1, 1))
        self._excess = self._excess + half * (self._qvel - before)

    def _where(self) -> Sequence[Component]:
        return self._corrected()

    def _work(self, drive: Drive, before: Sequence[Component], after: Sequence[Component]) -> Component:
        return turned_work(components(drive[0]), before, after)

    def _corrected(self) -> list[Component]:
        """Return x y z and a quaternion, corrected.

        The lead of the steps since the last sample is taken off; see `CorrectedSteps`.
        """
        places: list[Component] = [column.copy() for column in self._qpos.T]  # a batch of one would return live views
        if not self._corrects or not self._excess.any():
            return places
        over = self._excess.T
        moved = [place - ahead for place, ahead in zip(places[:3], over[:3])]
        turned = np.abs(over[3:]).max() > NOTHING
        return [*moved, *(turned_back(*places[3:], *over[3:]) if turned else places[3:])]

    def _settle(self) -> None:
        """Subtract the accumulated step error from the flotors' positions."""
        if self._corrects:
            self._qpos[:] = np.stack(self._corrected(), axis=-1)
            self._excess[:] = 0.0

    def _exert(self, effort: Sequence[Component]) -> None:
        wrench = np.broadcast_to(join(effort), (*self.batch, 6))
        self._efforts[:, list(self._effort_addresses)] = wrench[:, :3]
        start = self.device.velocity_address + 3
        # about the flotors' axes
        self._efforts[:, start : start + 3] = np.einsum(
            "na,nab->nb", wrench[:, 3:], self._rotations().reshape(-1, 3, 3)
        )

    def _position(self) -> list[Component]:
        if self._engine.warning.any():
            raise PlantError(f"MuJoCo warns at tick {self._tick}, in {int(self._engine.warning.any(-1).sum())} devices")
        self._settle()
        position = self._components()
        squared = self._check_escape(position)
        if (coils := self.device.coils) is not None:
            upright = (squared < UPRIGHT**2).all()
            self._inverse_map = coils.current_per_wrench if upright else coils.inverse_at(self._rotations())
        return position

    def _components(self) -> list[Component]:
        return _pose(self._corrected())

    def _rotations(self) -> Array:
        """Return the flotors' rotation matrices, (N, 9)."""
        return _matrices(self._qpos[:, 3:])

    def _kept(self, drive: Drive) -> _Kept:
        currents = None
        if self.device.model.na:  # the drivers lag: their currents, not the commanded ones
            currents = self._engine.bind("act").copy()
        return self._corrected(), self._qpos[:, 3:].copy(), self._qvel.copy(), drive[0], currents, self._inverse_map

    def _arrays(self, kept: Sequence[_Kept]) -> tuple[Array, Array, Array]:
        pose, twist, wrench = (np.stack(part) for part in zip(*map(self._parts, kept)))
        return pose, twist, wrench

    def _parts(self, kept: _Kept) -> tuple[Array, Array, Array]:
        """Return pose, twist and wrench of one snapshot.

        (N, 6) each.
        """
        place, turns, velocity, wrench, currents, inverse_map = kept
        spin = np.einsum("nab,nb->na", _matrices(turns).reshape(-1, 3, 3), velocity[:, 3:])
        if currents is not None:
            maps = np.broadcast_to(np.asarray(inverse_map), (*self.batch, 6, 6))
            wrench = np.linalg.solve(maps, currents[..., None])[..., 0]
        return join(_pose(place)), np.column_stack([velocity[:, :3], spin]), wrench


def _pose(place: Sequence[Component]) -> list[Component]:
    """Return pose components from x y z and a quaternion.

    (N,) each.
    """
    x, y, z, q0, q1, q2, q3 = place
    return [x, y, z, *rotation_vector(q0, q1, q2, q3, np.sqrt, np.arctan2)]


def _matrices(turns: Array) -> Array:
    """Return rotation matrices (N, 9) of quaternions (N, 4)."""
    matrices = np.empty((len(turns), 9))
    for matrix, turn in zip(matrices, turns, strict=True):
        mujoco.mju_quat2Mat(matrix, turn)
    return matrices
