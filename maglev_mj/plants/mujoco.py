"""MuJoCo plants, stepped from force switch to force switch: one device, or a batch of N."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import cached_property
from typing import Any, TypeAlias, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.timeline import Timing
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array, Command, Component, Six, components, join, rotation_vector
from maglev_mj.keywords import checked, explained
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import flag, number, numbers, whole
from maglev_mj.plants import engine
from maglev_mj.plants.base import PlantKeywords, SampledPlant, restore, states_of
from maglev_mj.plants.coils import UPRIGHT, CoilDrive, CoilMap, wrench_of
from maglev_mj.plants.hand import Hand
from maglev_mj.plants.model import Model, drivers_lag, load_model
from maglev_mj.plants.sensor import Measure

_Snapshot: TypeAlias = tuple[Sequence[float], Sequence[float], engine.Drive]
"""Position and quaternion, velocity as in MuJoCo's qvel, and drive in effect."""

_ENGINE_BOUND = 1e10
_SELDOM = 63  # callbacks are checked every 64th sample: on each, it would cost a tenth of a tick


@checked(own="coil_map escape integrator sensor")
class MuJoCoPlant(SampledPlant):
    """One device in MuJoCo, stepped at every force switch.

    With RK4, the default, translation is exact to rounding. The plant accepts wrenches (`write`) and, for a host with
    its own coil map, currents (`drive`). By default nothing saturates: for the device's limit of 60 N along z, set
    `current_limit=10`.

    Args:
        timing: Sample period, delay and phase (a number).
        model: Device: name of a model of the package, MJCF file, or specification; see `load_model`. Its integrator
            and time step are not used.
        mass: Moving mass [kg], instead of the model's.
        inertia: Moments of inertia about x, y, z [kg m²], (3,), instead of the model's.
        pose: Pose at release [m, rad], (6,).
        twist: Velocity at release [m/s, rad/s], (6,).
        gravity: Gravitational acceleration along -z, or in stator axes (3,) for a tilted base [m/s²], instead of the
            model's.
        coils: True applies each wrench by the coils, with the coil map at the flotor's angle at the sample (as
            measured, if there is a sensor); False applies it to the flotor directly.
        coil_map: Coils instead of the model's, such as calibrated ones.
        current_limit: Largest current in any coil [A]; None for no limit. Without coils, the wrench is limited as by
            coils at angle zero.
        driver_lag: First-order lag of the drivers, of the currents or of an ideal wrench; None for that of a device
            file.
        driver_time_constant: Time constant of that lag [s], instead of the model's.
        hand: Hand on the flotor, along x, y or z.
        integrator: One of `INTEGRATORS`.
        stops: Enable the metal stops at the ends of the range.
        stop_damping: A stop in contact also slows motion along it, with a time constant of 20 ms (assumed). Otherwise
            the flotor slides and rotates along its stops indefinitely.
        force_falloff: Fraction of a coil's force constant lost at the end of the range along its force; grows with the
            square of the distance from the magnets' centre (assumed).
        flexible: Handle that swings against the flotor along z; see `load_model`.
        keywords: Those of `SampledPlant`: wrench, wrench_limit, sensor, escape, record, hand_force, longest_step,
            metered. By default an integrator step lasts as long as the command is constant, and at most 0.5 ms with a
            hand. Driver lag needs no shorter one: translation stays exact.

    Attributes:
        start: Pose and twist at release [m, rad; m/s, rad/s], (6,) each.

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.
        ModelError: If the model is invalid.
        PlantError: If a MuJoCo callback is set, which would act on every plant of the process.

    Example:
        >>> from maglev_mj import Command, MuJoCoPlant
        >>> with MuJoCoPlant() as plant:
        ...     start = plant.read()
        ...     written = plant.write(Command([0.0] * 6))
        ...     fallen = plant.read()
        >>> fallen.time, round(fallen.position[2], 9)  # -g t²/2
        (0.005, -0.000122625)
    """

    # rarely used attributes, as in `SampledPlant`
    __slots__ = (
        "_angle",
        "_coil_drive",
        "_coils",
        "_data",
        "_effort_addresses",
        "_gains",
        "_look",
        "_model",
        "_push_on",
        "_qpos",
        "_qvel",
        "_reach",
        "_rotation",
        "_sensor",
        "_turning",
        "_warnings",
        "current_limit",
        "device",
    )

    _steps: engine.Steps | engine.LaggingSteps

    def __init__(
        self,
        timing: Timing | None = None,
        *,
        model: Model = "drop",
        mass: float | None = None,
        inertia: ArrayLike | None = None,
        pose: ArrayLike = (0.0,) * 6,
        twist: ArrayLike = (0.0,) * 6,
        gravity: ArrayLike | None = None,
        coils: bool = True,
        coil_map: CoilMap | None = None,
        current_limit: float | None = None,
        driver_lag: bool | None = None,
        driver_time_constant: float | None = None,
        hand: Hand | None = None,
        integrator: str = "rk4",
        stops: bool = False,
        stop_damping: bool = False,
        force_falloff: float = 0.0,
        flexible: bool = False,
        **keywords: Unpack[PlantKeywords],
    ) -> None:
        timing = timing or Timing()
        start = self._checked_start(timing, pose, twist)
        self.hand = hand
        self.device = engine.prepared(
            model,
            gravity=gravity,
            integrator=integrator,
            stops=stops,
            force_falloff=force_falloff,
            mass=mass,
            inertia=inertia,
            coils=coils,
            coil_map=coil_map if coils else None,
            driver_time_constant=driver_time_constant,
            hand=hand,
            flexible=flexible,
        )
        if not coils and force_falloff:
            raise ParameterError("force_falloff needs coils=True")
        self._lag = drivers_lag(model, driver_lag, self.device.driver_time_constant)
        self.current_limit = None if current_limit is None else number("current_limit", current_limit, at_least=0.0)
        self._coils = self.device.coils
        limiting = self._coils
        if limiting is None and current_limit is not None:
            limiting = load_model(model, coil_map=coil_map).coils
        self._coil_drive = None if limiting is None else CoilDrive(limiting, self.current_limit)
        self._open(integrator, force_falloff, flag("stop_damping", stop_damping), hand)
        free = False
        if keywords.get("longest_step") is None:
            free = not (hand is not None or force_falloff or flexible)
            keywords["longest_step"] = engine.longest_step(hand, stops, force_falloff, flexible)
        super().__init__(timing, batch=(), **keywords)
        # if only the stops need short steps, take them only near a stop
        self._reach = None
        if stops and free and not keywords.get("record"):
            self._reach = float(self.device.range[:3].min()), float(self.device.range[3])
        self._limits |= current_limit is not None
        # MuJoCo warns of positions and velocities that are not finite or above 1e10, which the escape check catches too
        # unless its bounds are wider; and of controls, which it then ignores
        self._warns_unseen = max(self._escape) > _ENGINE_BOUND or stops
        self._release(timing, start, self._started())

    def _check_timing(self, timing: Timing) -> None:
        numbers("phase of one device", timing.phase, shape="()")
        super()._check_timing(timing)

    def _checked_start(self, timing: Timing, pose: ArrayLike, twist: ArrayLike) -> tuple[Array, Array]:
        return numbers("pose", pose, shape="(6,)").copy(), numbers("twist", twist, shape="(6,)").copy()

    def _release(self, timing: Timing, start: tuple[Array, Array], measure: Measure | None) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._model.actuator_gainprm[:, 0] = self._gains
        if self._steps.falloff is not None:
            self._steps.falloff.central[:] = self._gains[: len(self._steps.falloff.central)]
        self._data.qpos[:], self._data.qvel[:] = engine.start_state(self.device, *start, self.hand)
        if self._coil_drive is not None:
            self._coil_drive.reset()
        self._last: engine.Drive = (), (), None
        # whether the coil map is outdated (updated for the next wrench); measured angle, with a sensor
        self._stale = self._turned = False
        self._angle: Sequence[float] | None = None
        super()._release(timing, start, measure)
        self._steps.reset(self._timeline.acting[1])
        self._sensor = measure
        self._upright = math.inf if self._coils is None else UPRIGHT * UPRIGHT
        if measure is not None and self._coils is not None:
            self._upright = math.inf
            self._measure = self._measured

    def _open(self, integrator: str, falloff: float, stop_damping: bool, hand: Hand | None) -> None:
        """Create the engine's state and views of it, which are too expensive to look up on each tick."""
        model, device = self.device.model, self.device
        self._data = mujoco.MjData(model)
        mujoco.mj_step(model, self._data)  # allocates memory, which would delay the first tick
        self._model, self._gains = model, model.actuator_gainprm[:, 0].copy()
        kind = engine.CorrectedSteps if integrator == "corrected" else engine.Steps
        steps = kind(device, self._data, falloff, stop_damping)
        self._steps = engine.LaggingSteps(steps, engine.LagFactors(self._lag, integrator)) if self._lag else steps
        self._look, self._settle = self._steps.look, self._steps.settle
        self._qpos = self._data.qpos[device.position_address :][:7]
        self._qvel = self._data.qvel[device.velocity_address :][:6]
        self._push_on = self._data.qfrc_applied
        self._effort_addresses = engine.hand_addresses(device, hand)
        self._turning = slice(device.velocity_address + 3, device.velocity_address + 6)
        self._rotation = np.zeros(9)
        self._warnings = self._data.warning.number
        self._refused = memoryview(self._warnings)[int(mujoco.mjtWarning.mjWARN_BADCTRL) :]

    @explained
    def drive(
        self,
        currents: Sequence[float],
        pulsed: Sequence[float] | None = None,
        width: float = 0.0,
        *,
        after: float | None = None,
    ) -> None:
        """Switch the currents; cancel later switches.

        Bit-identical to `write` for equal currents and switching times.

        Args:
            currents: Currents after the pulse [A], N.
            pulsed: Currents during the first `width` seconds [A], N.
            width: Pulse width [s]; 0 for no pulse.
            after: Delay from the last sample to the switch [s]; the timing's delay by default.

        Raises:
            PlantError: If a current is not finite, no sample was read, or the plant has no coils.
        """
        if self._coils is None:
            raise PlantError("no currents: the plant was created with coils=False")
        self._switch(_of_currents, currents, pulsed, width, after)

    def _raised(self, drive: engine.Drive, currents: Sequence[float]) -> engine.Drive:
        """Return a drive with currents added to its own [A], N."""
        return _of_currents([own + extra for own, extra in zip(drive[1], currents)])

    def open_coil(self, coil: int) -> None:
        """Disconnect a coil, counted from 0, as by a broken wire."""
        self._model.actuator_gainprm[whole("coil", coil, at_most=len(self.currents) - 1), 0] = 0.0
        if self._steps.falloff is not None:
            self._steps.falloff.central[coil] = 0.0

    @cached_property
    def inertia(self) -> Array:
        """Mass and moments of inertia of flotor and handle [kg, kg m²], (6,), rounded to 12 digits."""
        return np.array([float(f"{part:.12g}") for part in (*[self.device.mass] * 3, *self.device.inertia)])

    @property
    def load(self) -> Array:
        """Weight [N, N m], (6,)."""
        return np.append(self.device.model.opt.gravity * self.inertia[:3] + 0.0, np.zeros(3))

    @property
    def met_stops(self) -> bool:
        """True if a metal stop has acted since release."""
        return bool(self._data.maxuse_efc)

    @property
    def stop_wrench(self) -> Array:
        """Wrench of the metal stops in the engine's last step [N, N m], (6,)."""
        wrench: Array = self._data.qfrc_constraint[self.device.velocity_address :][:6].copy()
        if wrench[3:].any():  # MuJoCo's torques are about flotor axes
            wrench[3:] = self._data.xmat[self.device.flotor].reshape(3, 3) @ wrench[3:]
        return wrench

    @property
    def currents(self) -> Array:
        """Commanded coil currents at the last sample [A], (N,), without driver lag.

        Raises:
            PlantError: If the plant has no coils.
        """
        if self._coils is None:
            raise PlantError("no currents: the plant was created with coils=False")
        if isinstance(self._steps, engine.LaggingSteps):
            return np.array(self._steps.commanded)
        return np.array(self._data.ctrl[: len(self._coils)])

    def saved(self) -> tuple[Any, ...]:
        """Return the present state between two ticks, for `restore`.

        A user-defined sensor is saved if it can be deep-copied: its state must be in an object, not in a closure.
        """
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self._model, kind))
        mujoco.mj_getState(self._model, self._data, state, kind)
        steps = self._steps
        inner = steps.inner if isinstance(steps, engine.LaggingSteps) else None
        parts = (self, self._timeline, steps, inner, steps.stops, self._coil_drive, self._walls)
        states = states_of(*(part for part in parts if part is not None))
        own = None if self._walls is None else _copy_of(self._walls.measure)
        return states, state, (self.given, self.start), self._angle, _copy_of(self._sensor), self._walls, own

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Restore a state of `saved`, from which the motion repeats exactly."""
        states, state, (self.given, self.start), self._angle, sensor, self._walls, own = saved
        restore(states)
        if self._walls is not None:
            self._walls.measure = _copy_of(own)
        mujoco.mj_setState(self._model, self._data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        direct, self._sensor = self._measure is self._sensor, _copy_of(sensor)
        if direct:
            self._measure = self._sensor

    @property
    def intervals(self) -> list[tuple[float, Sequence[float]]]:
        """Durations [s] and N commanded currents [A] (wrenches without coils) of the last period, in order."""
        return [(duration, drive[1]) for duration, drive in self._last_intervals]

    def _limited(self, command: Command) -> Command:
        command = super()._limited(command)
        if self.current_limit is None:
            return command
        if self._stale:
            self._follow_turn()
        assert self._coil_drive is not None
        return self._coil_drive.limited(command)

    def _prepare(self, force: Sequence[float]) -> engine.Drive:
        wrench = tuple(force)  # copied: the caller may reuse its list
        if self._coils is None:
            return wrench, wrench, None
        if self._stale:
            self._follow_turn()
        drive = self._coil_drive
        assert drive is not None
        if wrench != self._last[0] or drive.inverse_map is not self._last[2]:
            self._last = wrench, drive.currents(force), drive.inverse_map
        return self._last

    @property
    def _carry(self) -> Callable[..., None]:
        return self._steps.advance if self._total is None else self._advance_metered  # saves a call of `_advance`

    def _advance(self, duration: float, drive: engine.Drive, pieces: int = 1) -> None:
        self._steps.advance(duration, drive, pieces)

    def _exert(self, effort: Sequence[float]) -> None:
        push = self._push_on
        for index, address in enumerate(self._effort_addresses[:3]):
            push[address] = effort[index]
        if any(effort[3:]):
            mujoco.mju_quat2Mat(self._rotation, self._qpos[3:])
            push[self._turning] = np.dot(effort[3:], self._rotation.reshape(3, 3))  # in flotor axes
        else:
            push[self._turning] = 0.0

    def _motion(self) -> tuple[Six, Six]:
        x, y, z, q0, q1, q2, q3 = self._look()
        return [x, y, z, *rotation_vector(q0, q1, q2, q3)], self._qvel.tolist()

    def _position(self) -> list[float]:
        if not self._tick & _SELDOM:
            engine.check_callbacks()
        if self._warns_unseen or self._refused[0]:
            self._check_warnings()
        x, y, z, q0, q1, q2, q3 = self._settle()
        rx, ry, rz = rotation_vector(q0, q1, q2, q3)
        turned = rx * rx + ry * ry + rz * rz  # squared angle
        largest_distance, largest_angle = self._escape
        position = [x, y, z, rx, ry, rz]
        if not (x * x + y * y + z * z < largest_distance and turned < largest_angle):
            self._check_warnings()
            self._check_escape(position)
        if turned > self._upright:
            self._stale = self._turned = True
        elif self._turned:
            self._stale, self._turned = True, False
        if self._reach is not None:
            near = engine.near_stops(self._reach, (x, y, z, q0), self._qvel.tolist(), self._period)
            self._run = self._run_in_pieces if near else self._carry
        return position

    def _follow_turn(self) -> None:
        """Update the coil map to the last sample's angle."""
        self._stale = False
        assert self._coil_drive is not None
        rotation = None
        if self._turned:
            mujoco.mju_quat2Mat(self._rotation, self._qpos[3:])
            rotation = self._rotation
        # the map of a rotated flotor is always new, and so are its drives
        self._timeline.compares = self._coil_drive.follow(rotation, self._angle)

    def _measured(self, position: Six) -> list[Component]:
        """Return the measurement, and mark the coil map as outdated."""
        assert self._sensor is not None
        measurement = self._sensor(position)
        self._angle, self._stale = measurement[3:], True
        return measurement

    def _check_warnings(self) -> None:
        """Raise PlantError if the engine has warned."""
        if names := engine.warned(self._warnings.tolist()):
            raise PlantError(f"MuJoCo warns at {self.timing.time(self._tick):.4g} s: {names}")

    def _where(self) -> Sequence[float]:
        return self._look()

    def _work(self, drive: engine.Drive, before: Sequence[float], after: Sequence[float]) -> float:
        commanded = drive[0][0] is not None
        force: Any = drive[0] if commanded else self._wrench(self._acting(drive), before)
        return float(engine.wrench_work(force, before, after))

    def _acting(self, drive: engine.Drive) -> engine.Drive:
        """Return a drive with the actual coil currents, and without its wrench if they produce a different one."""
        _, controls, inverse = drive
        steps, falloff = self._steps, self._steps.falloff
        if isinstance(steps, engine.LaggingSteps):
            controls = steps.actual
            if self._coils is None:
                return controls, controls, None
        elif self._coils is None or (inverse is not None and falloff is None):
            return drive
        currents = np.array(controls)
        return (None,), (currents if falloff is None else currents * falloff.share()).tolist(), inverse

    def _wrench(self, acting: engine.Drive, position: Sequence[float]) -> Sequence[float]:
        """Return the wrench of a drive of `_acting` on a flotor at `position`, x y z and a quaternion."""
        force, currents, inverse = acting
        if force[0] is not None:
            return cast("Sequence[float]", force)
        assert self._coils is not None
        if inverse is None:
            mujoco.mju_quat2Mat(self._rotation, np.array(position[3:]))
            inverse = self._coils.inverse_at(self._rotation)
        wrench: list[float] = wrench_of(inverse, np.array(currents)).tolist()
        return wrench

    def _snapshot(self, drive: engine.Drive) -> _Snapshot:
        return self._look(), self._qvel.tolist(), self._acting(drive)

    def _arrays(self, snapshots: Sequence[_Snapshot]) -> tuple[Array, Array, Array]:
        positions, velocities, drives = zip(*snapshots)
        pose = [[x, y, z, *rotation_vector(q0, q1, q2, q3)] for x, y, z, q0, q1, q2, q3 in positions]
        twist, matrices = np.array(velocities), _matrices(np.array(positions)[:, 3:])
        twist[:, 3:] = np.matmul(matrices.reshape(-1, 3, 3), twist[:, 3:, None])[..., 0]
        return np.array(pose), twist, np.array([self._wrench(*pair) for pair in zip(drives, positions)])


def _copy_of(sensor: Measure | None) -> Measure | None:
    try:
        return deepcopy(sensor)
    except Exception:  # user-defined, with a lock or similar: shared instead of copied
        return sensor


def _of_currents(currents: Sequence[float]) -> engine.Drive:
    """Return the drive of directly commanded currents; such drives are never equal."""
    return (None, *currents), tuple(currents), None


_BatchDrive: TypeAlias = tuple[Array, Array]
"""Wrenches (N, 6) and engine controls, (N, 6) or one per coil."""

_BatchSnapshot: TypeAlias = tuple[Sequence[Component], Array, Array, Array, Array | None, Array | None]
"""Position x y z and quaternion, MuJoCo's quaternion (N, 4), velocities (N, 6), wrenches (N, 6), currents,
inverse coil maps."""


class MuJoCoBatchPlant(SampledPlant):
    """N MuJoCo devices, each as in `MuJoCoPlant`, advanced by one engine call.

    Args:
        timing: Sample period, delay and phase; phases may be (N,).
        model: Device; see `MuJoCoPlant` for this and for the following options.
        mass: Moving mass [kg], instead of the model's.
        inertia: Moments of inertia [kg m²], (3,), instead of the model's.
        pose: Poses at release [m, rad], (N, 6).
        twist: Velocities at release [m/s, rad/s], (N, 6) or (6,).
        gravity: Gravitational acceleration [m/s²], instead of the model's.
        coils: True applies each wrench by the coils.
        coil_map: Coils instead of the model's.
        driver_lag: First-order lag of the drivers; None for that of a device file.
        driver_time_constant: Time constant of that lag [s], instead of the model's.
        hand: Hand on each flotor, equal for all.
        integrator: One of `INTEGRATORS`.
        threads: Number of threads; 0 for one per processor.
        keywords: As for `MuJoCoPlant`.

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.
        ModelError: If the model is invalid.
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
        gravity: ArrayLike | None = None,
        coils: bool = True,
        coil_map: CoilMap | None = None,
        driver_lag: bool | None = None,
        driver_time_constant: float | None = None,
        hand: Hand | None = None,
        integrator: str = "rk4",
        threads: int = 0,
        **keywords: Unpack[PlantKeywords],
    ) -> None:
        timing = timing or Timing()
        start = _batch_start(timing, pose, twist)
        devices, self.hand = len(start[0]), hand
        count = int(number("threads", threads, at_least=0))
        self.device = engine.prepared(
            model,
            gravity=gravity,
            integrator=integrator,
            mass=mass,
            inertia=inertia,
            coils=coils,
            coil_map=coil_map if coils else None,
            driver_time_constant=driver_time_constant,
            hand=hand,
        )
        self._lag = lag = drivers_lag(model, driver_lag, self.device.driver_time_constant)
        from mujoco.batch import Batch  # imported late, to load MuJoCo on demand

        self._engine = Batch(self.device.model, devices, count)
        self._qpos = self._engine.bind("qpos")[:, self.device.position_address :][:, :7]
        self._qvel = self._engine.bind("qvel")[:, self.device.velocity_address :][:, :6]
        self._controls = (
            self._engine.bind("ctrl")[:, : len(self.device.coils)]
            if self.device.coils is not None
            else self._engine.bind("xfrc_applied").reshape(devices, -1, 6)[:, self.device.flotor]
        )
        self._timestep = self._engine.expand("opt.timestep")
        self._efforts = self._engine.bind("qfrc_applied")
        self._effort_addresses = engine.hand_addresses(self.device, hand)
        if keywords.get("longest_step") is None:
            keywords["longest_step"] = engine.longest_step(hand)
        self._corrects = integrator == "corrected"
        super().__init__(timing, batch=(devices,), **keywords)
        self._factors = engine.LagFactors(lag, integrator) if lag else None
        self._release(timing, start, self._started())

    def _checked_start(self, timing: Timing, pose: ArrayLike, twist: ArrayLike) -> tuple[Array, Array]:
        start = _batch_start(timing, pose, twist)
        if start[0].shape[:1] != self.batch:
            raise ParameterError(f"pose must have shape {(*self.batch, 6)}, as at first (got {start[0].shape})")
        return start

    def _release(self, timing: Timing, start: tuple[Array, Array], measure: Measure | None) -> None:
        self._engine.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        for row, (at, speed) in enumerate(zip(*start, strict=True)):
            self._engine.qpos[row], self._engine.qvel[row] = engine.start_state(self.device, at, speed, self.hand)
        # inverse coil maps, one each while any flotor is rotated; None without coils
        self._inverse_map = None if self.device.coils is None else self.device.coils.current_per_wrench
        self._excess = np.zeros((len(start[0]), 6))
        super()._release(timing, start, measure)
        self._actual = self._timeline.acting[1]

    inertia = MuJoCoPlant.inertia

    def _prepare(self, force: Six) -> _BatchDrive:
        wrench = np.broadcast_to(join(force), (*self.batch, 6))
        if self._inverse_map is None:
            return wrench, wrench
        return wrench, np.matmul(self._inverse_map, wrench[..., None])[..., 0]

    def _advance(self, duration: Component, drive: _BatchDrive, pieces: int = 1) -> None:
        engine.check_callbacks()
        if self._factors is None:
            return self._step(duration, drive[1], pieces)
        step = duration / pieces
        parts, left = self._factors.of(step)
        for _ in range(pieces):
            error = self._actual - drive[1]
            for part in parts:
                self._step(step / len(parts), drive[1] + np.reshape(part, (-1, 1)) * error)
            self._actual = drive[1] + np.reshape(left, (-1, 1)) * error

    def _step(self, duration: Component, controls: Array, pieces: int = 1) -> None:
        self._controls[:] = controls
        self._timestep[:] = np.reshape(duration, (-1, *(1,) * (self._timestep.ndim - 1))) / pieces
        if not self._corrects:
            self._engine.step(nstep=pieces)
            return
        before = self._qvel.copy()
        self._engine.step(nstep=pieces)
        half = np.reshape(0.5 * np.asarray(duration) / pieces, (-1, 1))
        self._excess = self._excess + half * (self._qvel - before)

    def _work(self, drive: _BatchDrive, before: Sequence[Component], after: Sequence[Component]) -> Component:
        return engine.wrench_work(components(drive[0]), before, after)

    def _where(self) -> list[Component]:
        """Return x y z and a quaternion without the excess since the last sample; see `CorrectedSteps`."""
        parts: list[Component] = [column.copy() for column in self._qpos.T]  # copied: a batch of one has live views
        if not self._corrects or not self._excess.any():
            return parts
        excess = self._excess.T
        moved = [part - over for part, over in zip(parts[:3], excess[:3])]
        turned = np.abs(excess[3:]).max() > engine.NOTHING
        return [*moved, *(engine.turned_back(*parts[3:], *excess[3:]) if turned else parts[3:])]

    def _exert(self, effort: Six) -> None:
        wrench = np.broadcast_to(join(effort), (*self.batch, 6))
        self._efforts[:, list(self._effort_addresses)] = wrench[:, :3]
        start = self.device.velocity_address + 3
        # in flotor axes
        self._efforts[:, start : start + 3] = np.einsum(
            "na,nab->nb", wrench[:, 3:], _matrices(self._qpos[:, 3:]).reshape(-1, 3, 3)
        )

    def _motion(self) -> tuple[Six, Six]:
        return _pose(self._where()), list(self._qvel.T)

    def _position(self) -> list[Component]:
        if self._engine.warning.any():
            raise PlantError(f"MuJoCo warns at tick {self._tick}, in {int(self._engine.warning.any(-1).sum())} devices")
        if self._corrects:  # subtract the excess from the state
            self._qpos[:] = np.stack(self._where(), axis=-1)
            self._excess[:] = 0.0
        position = _pose(self._where())
        squared = self._check_escape(position)
        if (coils := self.device.coils) is not None:
            upright = (squared < UPRIGHT**2).all()
            self._inverse_map = coils.current_per_wrench if upright else coils.inverse_at(_matrices(self._qpos[:, 3:]))
        return position

    def _snapshot(self, drive: _BatchDrive) -> _BatchSnapshot:
        wrench, currents = drive[0], None
        if self._factors is not None:  # actual controls, not the commanded ones
            wrench, currents = (self._actual, None) if self._inverse_map is None else (wrench, self._actual)
        return self._where(), self._qpos[:, 3:].copy(), self._qvel.copy(), wrench, currents, self._inverse_map

    def _arrays(self, snapshots: Sequence[_BatchSnapshot]) -> tuple[Array, Array, Array]:
        pose, twist, wrench = (np.stack(part) for part in zip(*map(self._parts, snapshots)))
        return pose, twist, wrench

    def _parts(self, snapshot: _BatchSnapshot) -> tuple[Array, Array, Array]:
        """Return pose, twist and wrench of one snapshot, (N, 6) each."""
        position, quaternions, velocity, wrench, currents, inverse_map = snapshot
        spin = np.einsum("nab,nb->na", _matrices(quaternions).reshape(-1, 3, 3), velocity[:, 3:])
        if currents is not None:
            wrench = wrench_of(np.asarray(inverse_map), currents)
        return join(_pose(position)), np.column_stack([velocity[:, :3], spin]), wrench


def _batch_start(timing: Timing, pose: ArrayLike, twist: ArrayLike) -> tuple[Array, Array]:
    """Return checked copies of pose and twist of a batch, (N, 6) each."""
    start = numbers("pose", pose, shape="(N, 6)").copy()
    motion = numbers("twist", twist, shape=f"(6,) or {start.shape}")
    numbers("phase", timing.phase, shape=f"() or {start.shape[:1]}")
    return start, np.broadcast_to(motion, start.shape).copy()


def _pose(position: Sequence[Component]) -> list[Component]:
    """Return pose components, (N,) each, from x y z and a quaternion."""
    x, y, z, q0, q1, q2, q3 = position
    return [x, y, z, *rotation_vector(q0, q1, q2, q3, np.sqrt, np.arctan2)]


def _matrices(quaternions: Array) -> Array:
    """Return rotation matrices (N, 9) of quaternions (N, 4)."""
    matrices = np.empty((len(quaternions), 9))
    for matrix, quaternion in zip(matrices, quaternions, strict=True):
        mujoco.mju_quat2Mat(matrix, quaternion)
    return matrices
