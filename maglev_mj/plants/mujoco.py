"""The MuJoCo plant: the device model, stepped only from force switch to force switch."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias, Unpack

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.coils import UPRIGHT, limited_wrench
from maglev_mj.detail import Detail
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array, Command, rotation_vector
from maglev_mj.hand import Hand
from maglev_mj.model import COILS, load
from maglev_mj.parameters import number, numbers
from maglev_mj.plants.base import PlantKeywords, SampledPlant
from maglev_mj.plants.engine import FadingCoils, effort_addresses, longest_step, near_stops, prepared, start_state
from maglev_mj.plants.sensor import Measure
from maglev_mj.spec import GRAVITY
from maglev_mj.timeline import Timing

__all__ = ["MuJoCoPlant"]


Drive: TypeAlias = tuple[Sequence[float], Any]
"""A wrench, and the map from it to the currents; None for a wrench applied to the flotor itself."""


_ENGINE_BOUND = 1e10


class MuJoCoPlant(SampledPlant):
    """The device in MuJoCo, by default RK4 with a step boundary at every switch: exact to rounding in translation.

    Nothing is limited unless asked for: the device gives 60 N along z, which takes `current_limit=10`.

    Args:
        timing: Sample period, delay and phase (a number).
        scene: Name of the model.
        mass: Moving mass in place of the model's [kg].
        pose: Pose at release [m, rad], (6,).
        twist: Velocity at release [m/s, rad/s], (6,).
        gravity: Acceleration of free fall along -z [m/s²].
        coils: True sends each wrench through the six coils, by their map at the flotor's angle when the sample
            was taken, as the sensor measured it if there is one; False applies it to the flotor itself, as an ideal
            actuator would.
        current_limit: Largest current in any coil [A]; None for no limit. Without coils, what it leaves of a wrench is
            that of coils that stay upright.
        driver_lag: Switch the current drivers' first-order lag on.
        hand: A hand on the flotor, along x, y or z.
        integrator: One of `INTEGRATORS`.
        detail: What else the device has.
        keywords: Those of `SampledPlant`: wrench, wrench_limit, sensor, escape, record, hand_force, longest_step. The
            longest integration step is None for as long as the wrench is constant, and by default a quarter of the
            drivers' time constant where their lag is on, 0.5 ms where a hand is.

    Raises:
        ParameterError: If a value is outside its bounds or the shapes do not fit.
        ModelError: If the scene cannot be used.
    """

    def __init__(
        self,
        timing: Timing | None = None,
        *,
        scene: str = "drop",
        mass: float | None = None,
        pose: ArrayLike = (0.0,) * 6,
        twist: ArrayLike = (0.0,) * 6,
        gravity: float = GRAVITY,
        coils: bool = True,
        current_limit: float | None = None,
        driver_lag: bool = False,
        hand: Hand | None = None,
        integrator: str = "rk4",
        detail: Detail | None = None,
        **keywords: Unpack[PlantKeywords],
    ) -> None:
        timing = timing or Timing()
        start, motion = numbers("pose", pose), numbers("twist", twist)
        if start.shape != (6,) or motion.shape != (6,) or np.ndim(timing.phase):
            raise ParameterError(
                f"a MuJoCo plant is one device: pose and twist must be (6,) and phase a number, "
                f"not {start.shape}, {motion.shape} and {np.shape(timing.phase)}"
            )
        detail = detail or Detail()
        if not coils and (driver_lag or detail != Detail()):
            raise ParameterError("driver_lag and detail need coils=True")
        self.device = prepared(
            scene,
            mass=mass,
            gravity=gravity,
            coils=coils,
            driver_lag=driver_lag,
            hand=hand,
            integrator=integrator,
            detail=detail,
        )
        self.current_limit = None if current_limit is None else number("current_limit", current_limit, at_least=0.0)
        self._open(detail, hand)
        self._data.qpos[:], self._data.qvel[:] = start_state(self.device, start, motion, hand)
        # where stops alone ask for short steps, those are for when the flotor is near one
        free = longest_step(self.device, driver_lag, hand, replace(detail, stops=False)) is None
        watches_stops = detail.stops and free and keywords.get("longest_step") is None
        if keywords.get("longest_step") is None:
            keywords["longest_step"] = longest_step(self.device, driver_lag, hand, detail)
        super().__init__(timing, batch=(), **keywords)
        if watches_stops and self._recorder is None:
            self._before_period = self._choose_steps
        if driver_lag:
            self._data.act[:] = self._inverse_map @ np.array(self._timeline.acting[0])
        if self.current_limit is not None:
            self._limits = True
            upright = load(scene).coils
            assert upright is not None  # it is loaded with them
            self._limiting_map: Any = None if coils else upright.current_per_wrench
        if self._measure is not None and self._coils is not None:
            self._upright = math.inf
            self._measure = self._as_measured(self._measure)
        # it warns of positions and velocities that are not finite or beyond 1e10, each an escape too unless that is
        # wider still; and of controls, which it then leaves out
        self._warns_unseen = max(self._escape) > _ENGINE_BOUND or detail.stops

    def _open(self, detail: Detail, hand: Hand | None) -> None:
        """Make the engine's state, and live views of it: reaching for them on each tick costs as much as using them."""
        model, coils = self.device.model, self.device.coils
        self._data = mujoco.MjData(model)
        mujoco.mj_step(model, self._data)  # the first step fetches its memory, which would make the first tick late
        mujoco.mj_resetData(model, self._data)
        self._model, self._options = model, model.opt
        self._step: Callable[..., object] = partial(mujoco.mj_step, model, self._data)
        if detail.force_falloff:
            self._step = FadingCoils(self.device, self._data, detail.force_falloff)
        self._qpos = self._data.qpos[self.device.position_address :][:7]
        self._qvel = self._data.qvel[self.device.velocity_address :][:6]
        self._read_pose: Callable[[], Sequence[float]] = self._qpos.tolist
        self._push_on = self._data.qfrc_applied
        self._effort_addresses = effort_addresses(self.device, hand)
        self._turning = slice(self.device.velocity_address + 3, self.device.velocity_address + 6)
        self._rotation = np.zeros(9)
        self._currents = self._data.ctrl[: len(COILS)]
        self._wrench = self._data.xfrc_applied[self.device.flotor] if coils is None else np.zeros(6)
        # as `self._wrench[:] = drive`, in half the time
        self._fill = partial(struct.pack_into, "6d", self._wrench.data, 0)
        self._applied: Drive | None = None
        self._coils = coils
        # None without coils; the map of the upright flotor until it is seen to turn
        self._inverse_map: Any = None if coils is None else coils.current_per_wrench
        self._turned = False
        self._upright = math.inf if coils is None else UPRIGHT * UPRIGHT
        self._warnings = self._data.warning.number
        self._refused = memoryview(self._warnings)[int(mujoco.mjtWarning.mjWARN_BADCTRL) :]

    def _limited(self, command: Command) -> Command:
        command = super()._limited(command)
        if self.current_limit is None:
            return command
        force = self._with_limited_currents(command.force)
        if command.extra is None:
            return Command(force)
        total = self._with_limited_currents([one + other for one, other in zip(command.force, command.extra)])
        return Command(force, [one - other for one, other in zip(total, force)], command.pulse_width)

    def _with_limited_currents(self, force: Sequence[float]) -> Sequence[float]:
        """Return the wrench that is left when every current is clipped; the wrench itself where none is."""
        inverse_map = self._inverse_map if self._limiting_map is None else self._limiting_map
        return limited_wrench(inverse_map, force, self.current_limit or 0.0)[0]

    def _prepare(self, force: Sequence[float]) -> Drive:
        return tuple(force), self._inverse_map  # the caller may use its list again

    def _choose_steps(self) -> None:
        """Take short steps over the next period only if the flotor may meet a stop."""
        near = near_stops(self._read_pose(), self._qvel.tolist(), self._period)
        self._run = self._run_in_pieces if near else self._advance

    def _apply(self, drive: Drive) -> None:
        """Hand a drive to the engine."""
        self._applied = drive
        force, inverse_map = drive
        self._fill(*force)
        if inverse_map is not None:
            inverse_map.dot(self._wrench, out=self._currents)

    def _advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        if drive is not self._applied:
            self._apply(drive)
        if pieces == 1:
            self._options.timestep = duration
            self._step()
        else:
            self._options.timestep = duration / pieces
            self._step(pieces)

    @property
    def met_stops(self) -> bool:
        """True if a metal stop of the model has acted since release."""
        return bool(self._data.maxuse_efc)

    @property
    def currents(self) -> Array:
        """Currents in the six coils at the last sample [A], (6,); those commanded where the drivers lag.

        Raises:
            PlantError: If the plant has no coils.
        """
        if self._coils is None:
            raise PlantError("there are no currents: the plant was made with coils=False")
        currents: Array = self._currents.copy()
        return currents

    def _exert(self, effort: Sequence[float]) -> None:
        push = self._push_on
        for place, address in enumerate(self._effort_addresses[:3]):
            push[address] = effort[place]
        if any(effort[3:]):
            mujoco.mju_quat2Mat(self._rotation, self._qpos[3:])
            push[self._turning] = np.dot(effort[3:], self._rotation.reshape(3, 3))  # about the flotor's axes
        else:
            push[self._turning] = 0.0

    def _position(self) -> list[float]:
        if self._warns_unseen or self._refused[0]:
            self._check_warnings()
        x, y, z, q0, q1, q2, q3 = self._read_pose()
        rx, ry, rz = rotation_vector(q0, q1, q2, q3)
        turned = rx * rx + ry * ry + rz * rz
        far, far_turned = self._escape
        position = [x, y, z, rx, ry, rz]
        if not (x * x + y * y + z * z < far and turned < far_turned):
            self._check_warnings()
            self._check_escape(position)
        if turned > self._upright or self._turned:
            self._follow_turn(turned > self._upright)
        return position

    def _follow_turn(self, turned: bool) -> None:
        """Renew the coils' map for a flotor that is turned, or is upright again."""
        assert self._coils is not None
        self._timeline.compares = not (turned or self._turned)  # the map differs from sample to sample
        self._turned = turned
        if turned:
            mujoco.mju_quat2Mat(self._rotation, self._qpos[3:])
            self._inverse_map = self._coils.inverse_at(self._rotation)
        else:
            self._inverse_map = self._coils.current_per_wrench

    def _as_measured(self, measure: Measure) -> Measure:
        """Return the measurement with one thing more: the coils' map is renewed for the angle that is measured."""
        coils = self._coils
        assert coils is not None
        upright = coils.current_per_wrench

        def measured(position: Sequence[float]) -> list[float]:
            known = measure(position)
            before, self._inverse_map = self._inverse_map, coils.inverse_turned(*known[3:])
            self._timeline.compares = before is upright is self._inverse_map
            return known

        return measured

    def _check_warnings(self) -> None:
        """Raise what the engine warned of."""
        counts = self._warnings.tolist()
        if any(counts):
            names = ", ".join(mujoco.mjtWarning(kind).name for kind, count in enumerate(counts) if count)
            raise PlantError(f"MuJoCo warns at {self.timing.time(self._tick):.4g} s: {names}")

    def _look(self) -> Sequence[float]:
        """Return where the flotor is, x y z and a quaternion, and change nothing."""
        return self._read_pose()

    def _state(self, drive: Drive) -> tuple[Array, Array, Array]:
        x, y, z, q0, q1, q2, q3 = self._look()
        force, inverse_map = drive
        wrench = np.array(force)
        if self._model.na or isinstance(self._step, FadingCoils):  # not what was commanded
            currents = self._data.act if self._model.na else inverse_map @ wrench
            share = self._step.share() if isinstance(self._step, FadingCoils) else 1.0
            wrench = np.linalg.solve(inverse_map, currents * share)
        mujoco.mju_quat2Mat(self._rotation, np.array([q0, q1, q2, q3]))
        twist = np.concatenate([self._qvel[:3], self._rotation.reshape(3, 3) @ self._qvel[3:]])
        return np.array([x, y, z, *rotation_vector(q0, q1, q2, q3)]), twist, wrench
