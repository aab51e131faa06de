"""The MuJoCo plant: the device model, stepped only from force switch to force switch."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeAlias, Unpack, cast

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.coils import UPRIGHT, CoilMap
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array, Command, Component, rotation_vector
from maglev_mj.hand import Hand
from maglev_mj.model import COILS, Model, load
from maglev_mj.parameters import flag, number, numbers
from maglev_mj.plants.base import PlantKeywords, SampledPlant
from maglev_mj.plants.currents import CoilDrive
from maglev_mj.plants.engine import (
    CorrectedSteps,
    Drive,
    Steps,
    effort_addresses,
    longest_step,
    near_stops,
    prepared,
    start_state,
    turned_work,
)
from maglev_mj.plants.sensor import Measure
from maglev_mj.spec import GRAVITY
from maglev_mj.timeline import Timing

__all__ = ["MuJoCoPlant"]


_Kept: TypeAlias = tuple[Sequence[float], Sequence[float], Drive]
"""Where the flotor is, as x y z and a quaternion, its velocity in the engine's form, and the drive as it acts."""

_ENGINE_BOUND = 1e10


class MuJoCoPlant(SampledPlant):
    """The device in MuJoCo, by default RK4 with a step boundary at every switch: exact to rounding in translation.

    It takes wrenches (`write`) and, for a host that knows the coils, currents (`drive`). Nothing is limited unless
    asked for: the device gives 60 N along z, which takes `current_limit=10`.

    Args:
        timing: Sample period, delay and phase (a number).
        model: The device: name of a model of the package, MJCF file, or specification; see `load`.
        mass: Moving mass in place of the model's [kg].
        inertia: Moments of inertia about x, y, z in place of the model's [kg m²], (3,).
        pose: Pose at release [m, rad], (6,).
        twist: Velocity at release [m/s, rad/s], (6,).
        gravity: Acceleration of free fall along -z, or in stator axes (3,) where the base is not level [m/s²].
        coils: True sends each wrench through the six coils, by their map at the flotor's angle when the sample
            was taken, as the sensor measured it if there is one; False applies it to the flotor itself, as an ideal
            actuator would.
        coil_map: Coils in place of the model's, such as calibrated ones.
        current_limit: Largest current in any coil [A]; None for no limit. Without coils, what it leaves of a wrench is
            that of coils that stay upright.
        driver_lag: Switch the current drivers' first-order lag on.
        driver_time_constant: Time constant of that lag in place of the model's [s].
        hand: A hand on the flotor, along x, y or z.
        integrator: One of `INTEGRATORS`.
        stops: The metal stops at the ends of the range.
        stop_damping: A stop that is touched slows motion along it as well, within 20 ms; assumed. Without it a flotor
            slides and turns along its stops without end.
        force_falloff: Share of its force constant that a coil has lost when it is as far from its magnets' centre,
            along its force, as the device's range goes; the loss goes with the square of the distance. Assumed.
        flexible: The handle swings against the flotor along z; see `load`.
        keywords: Those of `SampledPlant`: wrench, wrench_limit, sensor, escape, record, hand_force, longest_step,
            metered. The longest integration step is None for as long as the wrench is constant, and by default a
            quarter of the drivers' time constant where their lag is on, 0.5 ms where a hand is.

    Attributes:
        start: Pose and twist at release [m, rad; m/s, rad/s], (6,) each.

    Raises:
        ParameterError: If a value is outside its bounds or the shapes do not fit.
        ModelError: If the model cannot be used.
    """

    # as in `SampledPlant`: what is not used on every tick
    __slots__ = (
        "_angle",
        "_coil_drive",
        "_coils",
        "_data",
        "_effort_addresses",
        "_look",
        "_model",
        "_push_on",
        "_qpos",
        "_qvel",
        "_reach",
        "_rotation",
        "_turning",
        "_warnings",
        "current_limit",
        "device",
    )

    def __init__(
        self,
        timing: Timing | None = None,
        *,
        model: Model = "drop",
        mass: float | None = None,
        inertia: ArrayLike | None = None,
        pose: ArrayLike = (0.0,) * 6,
        twist: ArrayLike = (0.0,) * 6,
        gravity: ArrayLike = GRAVITY,
        coils: bool = True,
        coil_map: CoilMap | None = None,
        current_limit: float | None = None,
        driver_lag: bool = False,
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
        start, motion = numbers("pose", pose), numbers("twist", twist)
        if start.shape != (6,) or motion.shape != (6,) or np.ndim(timing.phase):
            raise ParameterError(
                f"a MuJoCo plant is one device: pose and twist must be (6,) and phase a number, "
                f"not {start.shape}, {motion.shape} and {np.shape(timing.phase)}"
            )
        self.hand, self.start = hand, (start, motion)
        self.device = prepared(
            model,
            gravity=gravity,
            integrator=integrator,
            stops=stops,
            force_falloff=force_falloff,
            mass=mass,
            inertia=inertia,
            coils=coils,
            coil_map=coil_map if coils else None,
            driver_lag=driver_lag,
            driver_time_constant=driver_time_constant,
            hand=hand,
            flexible=flexible,
        )
        if not coils and (driver_lag or force_falloff):
            raise ParameterError("driver_lag and force_falloff need coils=True")
        self.current_limit = None if current_limit is None else number("current_limit", current_limit, at_least=0.0)
        self._coils = self.device.coils
        known = self._coils
        if known is None and current_limit is not None:
            known = load(model, coil_map=coil_map).coils
        self._coil_drive = None if known is None else CoilDrive(known, self.current_limit)
        self._open(integrator, force_falloff, flag("stop_damping", stop_damping), hand)
        self._data.qpos[:], self._data.qvel[:] = start_state(self.device, start, motion, hand)
        free = False
        if keywords.get("longest_step") is None:
            needs: dict[str, Any] = {
                "driver_lag": driver_lag,
                "hand": hand,
                "force_falloff": force_falloff,
                "flexible": flexible,
            }
            free = longest_step(self.device, **needs) is None
            keywords["longest_step"] = longest_step(self.device, stops=stops, **needs)
        super().__init__(timing, batch=(), **keywords)
        # where stops alone ask for short steps, those are for when the flotor is near one
        self._reach = None
        if stops and free and self._recorder is None:
            self._reach = float(self.device.range[:3].min()), float(self.device.range[3])
        if driver_lag:
            self._data.act[:] = self._timeline.acting[1]
        self._limits |= current_limit is not None
        if self._measure is not None and self._coils is not None:
            self._upright = math.inf
            self._measure = self._noted(self._measure)
        # it warns of positions and velocities that are not finite or beyond 1e10, each an escape too unless that is
        # wider still; and of controls, which it then leaves out
        self._warns_unseen = max(self._escape) > _ENGINE_BOUND or stops

    def _open(self, integrator: str, falloff: float, stop_damping: bool, hand: Hand | None) -> None:
        """Make the engine's state, and live views of it: reaching for them on each tick costs as much as using them."""
        model, device = self.device.model, self.device
        self._data = mujoco.MjData(model)
        mujoco.mj_step(model, self._data)  # the first step fetches its memory, which would make the first tick late
        mujoco.mj_resetData(model, self._data)
        self._model = model
        steps = CorrectedSteps if integrator == "corrected" else Steps
        self._steps = steps(device, self._data, falloff, stop_damping)
        self._look, self._settle = self._steps.look, self._steps.settle
        self._qpos = self._data.qpos[device.position_address :][:7]
        self._qvel = self._data.qvel[device.velocity_address :][:6]
        self._push_on = self._data.qfrc_applied
        self._effort_addresses = effort_addresses(device, hand)
        self._turning = slice(device.velocity_address + 3, device.velocity_address + 6)
        self._rotation = np.zeros(9)
        self._last: Drive = (), (), None
        # whether the coils' map is to be renewed for the next wrench, and the angle measured if there is a sensor
        self._stale = self._turned = False
        self._angle: Sequence[float] | None = None
        self._upright = math.inf if self._coils is None else UPRIGHT * UPRIGHT
        self._warnings = self._data.warning.number
        self._refused = memoryview(self._warnings)[int(mujoco.mjtWarning.mjWARN_BADCTRL) :]

    def drive(
        self,
        currents: Sequence[float],
        pulsed: Sequence[float] | None = None,
        width: float = 0.0,
        *,
        after: float | None = None,
    ) -> None:
        """Switch the currents; what was to be switched later than that is not.

        Where a switch of the currents falls as a wrench's would, and they are those that `write` computes, the motion
        is the same to the last bit.

        Args:
            currents: Currents from then on [A], six.
            pulsed: In place of them for the first `width` seconds [A], six.
            width: How long [s]; 0 for no pulse.
            after: When, since the last sample [s]; the timing's delay by default.

        Raises:
            PlantError: If a current is not finite, no sample was read, or the plant has no coils.
        """
        if self._coils is None:
            raise PlantError("there are no currents: the plant was made with coils=False")
        if self._tick < 0 or not math.isfinite(sum(currents) + sum(pulsed or ()) + width):
            raise PlantError(f"currents must be finite and follow a sample, not {tuple(currents)} for {width:g} s")
        held = _of_currents(currents)
        ahead = held if pulsed is None else _of_currents(pulsed)
        self._timeline.answer(self._tick, held, ahead, width, after=after)

    def open_coil(self, coil: int) -> None:
        """Let a coil, 0 to 5, give no force from now on, as one whose wire is broken."""
        self._model.actuator_gainprm[coil, 0] = 0.0

    @cached_property
    def inertia(self) -> Array:
        """Mass and moments of inertia of the model, handle included [kg, kg m²], (6,); to 12 digits, as it adds up."""
        return np.array([float(f"{part:.12g}") for part in (*[self.device.mass] * 3, *self.device.inertia)])

    @property
    def load(self) -> Array:
        """Weight [N, N m], (6,)."""
        weight: Array = np.append(self.device.model.opt.gravity * self.inertia[:3] + 0.0, np.zeros(3))
        return weight

    @property
    def met_stops(self) -> bool:
        """True if a metal stop of the model has acted since release."""
        return bool(self._data.maxuse_efc)

    @property
    def stop_wrench(self) -> Array:
        """Wrench of the metal stops in the engine's last step [N, N m], (6,)."""
        wrench: Array = self._data.qfrc_constraint[self.device.velocity_address :][:6].copy()
        if wrench[3:].any():  # the engine turns about the flotor's axes
            wrench[3:] = self._data.xmat[self.device.flotor].reshape(3, 3) @ wrench[3:]
        return wrench

    @property
    def currents(self) -> Array:
        """Currents in the six coils at the last sample [A], (6,); those commanded where the drivers lag.

        Raises:
            PlantError: If the plant has no coils.
        """
        if self._coils is None:
            raise PlantError("there are no currents: the plant was made with coils=False")
        currents: Array = self._data.ctrl[: len(COILS)].copy()
        return currents

    @property
    def segments(self) -> list[tuple[float, Sequence[float]]]:
        """Controls from the sample before the last one to that: how long each acted [s], and six [A]."""
        return [(duration, drive[1]) for duration, drive in self._segments]

    def _limited(self, command: Command) -> Command:
        command = super()._limited(command)
        if self.current_limit is None:
            return command
        if self._stale:
            self._follow_turn()
        assert self._coil_drive is not None
        return self._coil_drive.limited(command)

    def _prepare(self, force: Sequence[float]) -> Drive:
        given = tuple(force)  # the caller may use its list again
        if self._coils is None:
            return given, given, None
        if self._stale:
            self._follow_turn()
        drive = self._coil_drive
        assert drive is not None
        if given != self._last[0] or drive.inverse_map is not self._last[2]:
            self._last = given, drive.currents(force), drive.inverse_map
        return self._last

    @property
    def _carry(self) -> Callable[..., None]:
        return self._steps.advance if self._total is None else self._advance_metered  # a call less than `_advance`

    def _advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        self._steps.advance(duration, drive, pieces)

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
        x, y, z, q0, q1, q2, q3 = self._settle()
        rx, ry, rz = rotation_vector(q0, q1, q2, q3)
        turned = rx * rx + ry * ry + rz * rz
        far, far_turned = self._escape
        position = [x, y, z, rx, ry, rz]
        if not (x * x + y * y + z * z < far and turned < far_turned):
            self._check_warnings()
            self._check_escape(position)
        if turned > self._upright:
            self._stale = self._turned = True
        elif self._turned:
            self._stale, self._turned = True, False
        if self._reach is not None:
            near = near_stops(self._reach, (x, y, z, q0), self._qvel.tolist(), self._period)
            self._run = self._run_in_pieces if near else self._carry
        return position

    def _follow_turn(self) -> None:
        """Renew the coils' map for the angle at the last sample."""
        self._stale = False
        assert self._coil_drive is not None
        rotation = None
        if self._turned:
            mujoco.mju_quat2Mat(self._rotation, self._qpos[3:])
            rotation = self._rotation
        # no two maps of a turned flotor are the same, so no two commands
        self._timeline.compares = self._coil_drive.follow(rotation, self._angle)

    def _noted(self, measure: Measure) -> Measure:
        """Return the measurement with one thing more: the coils' map is renewed for the angle that is measured."""

        def measured(position: Sequence[Component]) -> list[Component]:
            known = measure(position)
            self._angle, self._stale = known[3:], True
            return known

        return measured

    def _check_warnings(self) -> None:
        """Raise what the engine warned of."""
        counts = self._warnings.tolist()
        if any(counts):
            names = ", ".join(mujoco.mjtWarning(kind).name for kind, count in enumerate(counts) if count)
            raise PlantError(f"MuJoCo warns at {self.timing.time(self._tick):.4g} s: {names}")

    def _where(self) -> Sequence[float]:
        return self._look()

    def _work(self, drive: Drive, before: Sequence[float], after: Sequence[float]) -> float:
        known = drive[0][0] is not None
        force: Any = drive[0] if known else self._wrench(self._acting(drive), before)
        return float(turned_work(force, before, after))

    def _acting(self, drive: Drive) -> Drive:
        """Return a drive as it acts now: with the currents in the coils, and no wrench where they give another."""
        _, controls, inverse = drive
        falloff = self._steps.falloff
        if self._coils is None or (inverse is not None and not self._model.na and falloff is None):
            return drive
        currents = np.array(self._data.act if self._model.na else controls)
        return (None,), (currents if falloff is None else currents * falloff.share()).tolist(), inverse

    def _wrench(self, acting: Drive, place: Sequence[float]) -> Sequence[float]:
        """Return the wrench on the flotor, six, under a drive as it acts, at x y z and a quaternion."""
        force, currents, inverse = acting
        if force[0] is not None:
            return cast("Sequence[float]", force)
        assert self._coils is not None
        if inverse is None:
            mujoco.mju_quat2Mat(self._rotation, np.array(place[3:]))
            inverse = self._coils.inverse_at(self._rotation)
        wrench: list[float] = np.linalg.solve(inverse, currents).tolist()
        return wrench

    def _kept(self, drive: Drive) -> _Kept:
        return self._look(), self._qvel.tolist(), self._acting(drive)

    def _arrays(self, kept: Sequence[_Kept]) -> tuple[Array, Array, Array]:
        places, velocities, actings = zip(*kept)
        pose = [[x, y, z, *rotation_vector(q0, q1, q2, q3)] for x, y, z, q0, q1, q2, q3 in places]
        twist, matrices = np.array(velocities), np.empty((len(kept), 9))
        for matrix, turn in zip(matrices, np.array(places)[:, 3:], strict=True):
            mujoco.mju_quat2Mat(matrix, turn)
        twist[:, 3:] = np.matmul(matrices.reshape(-1, 3, 3), twist[:, 3:, None])[..., 0]
        return np.array(pose), twist, np.array([self._wrench(*one) for one in zip(actings, places)])


def _of_currents(currents: Sequence[float]) -> Drive:
    """Return the drive of currents that nobody asked for as a wrench; none of those is alike."""
    return (None, *currents), tuple(currents), None
