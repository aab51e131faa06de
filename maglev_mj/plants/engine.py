"""MuJoCo engine of a plant: integrator, initial state, steps."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ModelError, ParameterError, check_one_of
from maglev_mj.frames import AXES, Array, Component, quaternion
from maglev_mj.lazy import has_engine, mujoco
from maglev_mj.parameters import flag, number, numbers
from maglev_mj.plants.hand import Hand
from maglev_mj.plants.model import COILS, Device, Model, at_reference, load_model
from maglev_mj.spec import GRAVITY

Drive: TypeAlias = tuple[Sequence[float | None], Sequence[float], Any]
"""Commanded wrench, engine controls, inverse coil map.

The wrench is (None, six currents) if currents were commanded; the map is None without coils.
"""

STOP_TIME = 0.02
"""Time constant of friction along a stop [s]; assumed."""

_HAND_STEP, _STOP_STEP, _FALLOFF_STEP, _BEND_STEP = 5e-4, 2.5e-4, 2.5e-4, 5e-5

_PASSIVE = (
    "jnt_stiffness",
    "jnt_stiffnesspoly",
    "dof_damping",
    "dof_dampingpoly",
    "tendon_stiffness",
    "tendon_stiffnesspoly",
    "tendon_damping",
    "tendon_dampingpoly",
    "body_gravcomp",
)

NOTHING = 1e-12
"""Largest angle [rad] treated as rounding error."""


@contextmanager
def engine_warnings_silenced() -> Iterator[None]:
    """Suppress the engine's warnings on terminal and log file.

    A plant raises them as errors anyway.

    The engine has one warning handler for the whole process; it is restored at the end.
    """
    if not has_engine():
        yield
        return
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


INTEGRATORS = {
    "euler": "mjINT_EULER",
    "rk4": "mjINT_RK4",
    "implicit": "mjINT_IMPLICIT",
    "implicitfast": "mjINT_IMPLICITFAST",
    "discrete": "mjINT_DISCRETE",
    "corrected": "mjINT_EULER",
}
"""Integrators by name, and their names in the engine.

Those of the engine, and "corrected": Euler with a half-step correction (see `CorrectedSteps`).
"""


def prepared(
    model: Model = "drop",
    *,
    gravity: ArrayLike = GRAVITY,
    integrator: str = "rk4",
    stops: bool = False,
    force_falloff: float = 0.0,
    **device: Any,
) -> Device:
    """Load a device with its model configured for a plant.

    Args:
        model: See `load_model`.
        gravity: Acceleration of free fall along -z, or in stator axes (3,) [m/s²].
        integrator: One of `INTEGRATORS`.
        stops: Let the metal stops act.
        force_falloff: See `MuJoCoPlant`; the model must have a range for it.
        device: Further keywords of `load_model`.

    Raises:
        ParameterError: If a value is outside its bounds.
        ModelError: If the model cannot be used, or lacks the stops that are needed.
    """
    check_one_of("integrator", INTEGRATORS, integrator)
    made = load_model(model, **device)
    options = made.model.opt
    options.integrator = mujoco.mjtIntegrator.__members__[INTEGRATORS[integrator]]
    falling = numbers("gravity", gravity)
    if falling.shape not in ((), (3,)):
        raise ParameterError(f"gravity must be a number or (3,), not {falling.shape}")
    options.gravity[:] = falling if falling.ndim else (0.0, 0.0, -float(falling))
    if not _has_passive_forces(made.model):  # else both flags together would take all of them away
        options.disableflags |= mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER
    # an automatic reset would make a diverging run look stable, and the plant limits currents itself
    options.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    if flag("stops", stops):
        options.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
    else:
        options.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    falloff = number("force_falloff", force_falloff, at_least=0.0, at_most=1.0)
    if (stops or falloff) and not np.isfinite(made.range).all():
        raise ModelError("stops and force_falloff need limits on the joints x, y, z and rotation of the model")
    return made


def _has_passive_forces(model: mujoco.MjModel) -> bool:
    """Return True if a model may exert passive forces.

    Sources are joints, tendons, a fluid, flexes and plugins.
    """
    springs = (getattr(model, name) for name in _PASSIVE)
    options = model.opt
    return bool(any(map(np.any, springs)) or options.density or options.viscosity or model.nflex or model.nplugin)


def start_state(device: Device, pose: Array, twist: Array, hand: Hand | None) -> tuple[Array, Array]:
    """Return qpos and qvel of a device at release.

    A hand in a soft grip starts in equilibrium, at the flotor's velocity.

    Args:
        device: The device.
        pose: Pose of the flotor [m, rad], (6,).
        twist: Its velocity [m/s, rad/s], (6,).
        hand: The hand on it.
    """
    model = device.model
    position, velocity, rotation = np.zeros(model.nq), np.zeros(model.nv), np.zeros(9)
    first, start = device.position_address, device.velocity_address
    position[first : first + 3], position[first + 3 : first + 7] = pose[:3], quaternion(pose[3:])
    mujoco.mju_quat2Mat(rotation, position[first + 3 : first + 7])
    # the engine turns about the flotor's axes
    velocity[start : start + 3], velocity[start + 3 : start + 6] = twist[:3], twist[3:] @ rotation.reshape(3, 3)
    if hand is not None and hand.soft:
        for index in hand.indices:
            joint = model.joint(f"hand_{AXES[index]}")
            position[joint.qposadr], velocity[joint.dofadr] = hand.place(pose[index]), twist[index]
    return position, velocity


def effort_addresses(device: Device, hand: Hand | None) -> list[int]:
    """Return indices into qvel of the hand's muscle forces.

    They are for x, y and z; they are the hand's own if its grip is soft, otherwise the flotor's.
    """
    addresses = [device.velocity_address + index for index in range(3)]
    for index in hand.indices if hand is not None and hand.soft else ():
        addresses[index] = int(device.model.joint(f"hand_{AXES[index]}").dofadr[0])
    return addresses


def longest_step(
    device: Device,
    driver_lag: bool = False,
    hand: Hand | None = None,
    stops: bool = False,
    force_falloff: float = 0.0,
    flexible: bool = False,
) -> float | None:
    """Return the longest integration step of a device [s].

    None if it needs steps at force switches only.

    Args:
        device: The device, for its drivers' time constant.
        driver_lag: True if the drivers' lag is on.
        hand: The hand on the flotor.
        stops: True if the stops act.
        force_falloff: Share of the force lost at the ends of the range.
        flexible: True if the handle swings.
    """
    needed = (
        (driver_lag, 0.25 * device.driver_time_constant),
        (hand is not None, _HAND_STEP),
        (stops, _STOP_STEP),
        (force_falloff > 0.0, _FALLOFF_STEP),
        (flexible, _BEND_STEP),
    )
    return min((step for asked, step in needed if asked), default=None)


_FIERCEST, _FIERCEST_TURN = 60.0, 2500.0
"""Half the largest acceleration [m/s², rad/s²].

It is that of the flotor under coils and hand.
"""


def near_stops(reach: Sequence[float], position: Sequence[float], velocity: Sequence[float], period: float) -> bool:
    """Return True if a flotor may reach a stop.

    That is within one period. Contact needs short steps; elsewhere they are wasted.

    Args:
        reach: Least displacement and least angle of a stop [m, rad].
        position: x y z [m] and the first part of a quaternion.
        velocity: Linear and angular [m/s, rad/s].
        period: Sample period [s].
    """
    x, y, z, w = position
    u, v, s, p, q, r = velocity
    if max(abs(x), abs(y), abs(z)) + period * (max(abs(u), abs(v), abs(s)) + _FIERCEST * period) > reach[0]:
        return True
    angle = 2.0 * math.sqrt(max(1.0 - w * w, 0.0))
    return angle + period * (math.sqrt(p * p + q * q + r * r) + _FIERCEST_TURN * period) > reach[1]


class Steps:
    """Engine steps of one device under constant controls.

    Args:
        device: The device.
        data: Its state.
        falloff: See `MuJoCoPlant`.
        stop_damping: See `MuJoCoPlant`.

    Attributes:
        look: Function that returns x y z [m] and a quaternion, without a change of state.
        settle: The same at a sample.
    """

    def __init__(self, device: Device, data: mujoco.MjData, falloff: float = 0.0, stop_damping: bool = False) -> None:
        self._options = device.model.opt
        controls = data.xfrc_applied[device.flotor] if device.coils is None else data.ctrl[: len(COILS)]
        # as `controls[:] = values`, in half the time
        self._control = partial(struct.Struct("6d").pack_into, controls.data, 0)
        self._drive: Drive | None = None
        self.stops = _DampedStops(device, data) if stop_damping else None
        step = self.stops or partial(mujoco.mj_step, device.model, data)
        self.falloff = _Falloff(device, data, falloff, step) if falloff else None
        self._step: Callable[..., object] = self.falloff or step
        self._position = data.qpos[device.position_address :][:7]
        self.look: Callable[[], Sequence[float]] = self._position.tolist
        self.settle: Callable[[], Sequence[float]] = self.look

    def advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        """Advance the state by `duration` [s] under a drive.

        The engine makes `pieces` equal steps.
        """
        if drive is not self._drive:
            self._drive = drive
            self._control(*drive[1])
        if pieces != 1:
            duration /= pieces
        self._options.timestep = duration
        self._step(pieces)


class CorrectedSteps(Steps):
    """Euler steps corrected to be exact under constant force.

    A semi-implicit step of h moves the flotor by h times the velocity at its end. Under a constant force the exact
    motion is h times the mean velocity, so the step is (h/2) dv too far. This excess is subtracted at each sample.
    Translation is exact to rounding, as with RK4, at a third of the cost per step. Forces that change within a step
    (of a hand, lagging drivers, rotation about several axes) leave an error of first order in the step.
    """

    def __init__(self, device: Device, data: mujoco.MjData, falloff: float = 0.0, stop_damping: bool = False) -> None:
        super().__init__(device, data, falloff, stop_damping)
        self._read, self.look, self.settle = self.look, self._look, self._settle
        self._velocity = data.qvel[device.velocity_address :][:6].tolist
        self._acceleration = data.qacc[device.velocity_address :][:6].tolist
        self._put = partial(struct.pack_into, "7d", self._position.data, 0)
        # with damping in the engine the velocity gains something else than the step times the acceleration
        self._damped = bool(device.model.dof_damping.any() or device.model.tendon_damping.any())
        # excess of each interval since the last correction: a factor, and the velocity gain or acceleration
        self._excess: list[tuple[float, Sequence[float]]] = []

    def advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        """See `Steps`."""
        if pieces > 1 or self._damped:
            before = self._velocity()
            super().advance(duration, drive, pieces)
            gained = [after - earlier for after, earlier in zip(self._velocity(), before)]
            self._excess.append((0.5 * duration / pieces, gained))
            return
        if drive is not self._drive:
            self._drive = drive
            self._control(*drive[1])
        self._options.timestep = duration
        self._step()
        self._excess.append((0.5 * duration * duration, self._acceleration()))

    def _look(self) -> tuple[float, float, float, float, float, float, float]:
        x, y, z, w, a, b, c = self._read()
        rx = ry = rz = 0.0
        for factor, (u, v, up, p, q, r) in self._excess:
            x -= factor * u
            y -= factor * v
            z -= factor * up
            if p or q or r:
                rx += factor * p
                ry += factor * q
                rz += factor * r
        if rx * rx + ry * ry + rz * rz > NOTHING * NOTHING:
            w, a, b, c = turned_back(w, a, b, c, rx, ry, rz)
        return x, y, z, w, a, b, c

    def _settle(self) -> Sequence[float]:
        """Subtract the accumulated step error; return the position.

        The position is x y z and a quaternion.
        """
        pose = self._look()
        self._excess.clear()
        self._put(*pose)
        return pose


def turned_back(
    w: Component, a: Component, b: Component, c: Component, rx: Component, ry: Component, rz: Component
) -> tuple[Component, Component, Component, Component]:
    """Rotate a unit quaternion backward by a small angle.

    The angle (rx, ry, rz) [rad] is about the quaternion's own axes.
    """
    # the engine normalizes the quaternion
    p, q, r = -0.5 * rx, -0.5 * ry, -0.5 * rz
    one = 1.0 - 0.5 * (p * p + q * q + r * r)
    return (
        w * one - a * p - b * q - c * r,
        w * p + a * one + b * r - c * q,
        w * q - a * r + b * one + c * p,
        w * r + a * q - b * p + c * one,
    )


def turned_work(force: Sequence[Component], before: Sequence[Component], after: Sequence[Component]) -> Component:
    """Return a constant wrench's work [J] between two positions.

    A position is x y z [m] and a quaternion.

    Exact for the translations, to second order in the angle for the rotations.
    """
    x, y, z, w, a, b, c = before
    p, q, r, d, i, j, k = after
    fx, fy, fz, tx, ty, tz = force
    # twice the vector part of the turn between the two orientations
    rx = w * i - a * d - b * k + c * j
    ry = w * j - b * d - c * i + a * k
    rz = w * k - c * d - a * j + b * i
    return fx * (p - x) + fy * (q - y) + fz * (r - z) + 2.0 * (tx * rx + ty * ry + tz * rz)


class _DampedStops:
    """Engine step with friction along touched stops.

    A joint limit acts along its own coordinate only: a flotor rotating at its angle limit would never come to rest.
    """

    def __init__(self, device: Device, data: mujoco.MjData) -> None:
        self._model, self._data = device.model, data
        self._damping = device.model.dof_damping[device.velocity_address :][:6]
        self._free = self._damping.copy()
        device.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_DAMPER)
        self._touching = self._free + np.append([device.mass] * 3, device.inertia) / STOP_TIME
        self._touched = False

    def __call__(self, steps: int = 1) -> None:
        """Make `steps` steps."""
        for _ in range(steps):
            self._damping[:] = self._touching if self._touched else self._free
            mujoco.mj_step(self._model, self._data)
            self._touched = bool(self._data.nl)


class _Falloff:
    """Engine step with coil force decreasing with stroke.

    The force constants of a step are those at its middle, so that the error is of second order in the step.
    """

    def __init__(self, device: Device, data: mujoco.MjData, falloff: float, step: Callable[[], object]) -> None:
        self._model, self._data, self._falloff, self._step = device.model, data, falloff, step
        self._centre = at_reference(device.model).actuator_length[: len(COILS)].copy()
        self._flat = device.model.actuator_gainprm[: len(COILS), 0].copy()
        self._range = float(device.range[:3].max())

    def __call__(self, steps: int = 1) -> None:
        """Make `steps` steps."""
        model, data, coils = self._model, self._data, slice(len(COILS))
        gains = model.actuator_gainprm[coils, 0]
        length, speed = data.actuator_length[coils], data.actuator_velocity[coils]
        half = 0.5 * model.opt.timestep
        for _ in range(steps):
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            gains[:] = self._flat * self._share(length + half * speed)
            self._step()

    def share(self) -> Array:
        """Return each coil's present force share, (6,)."""
        mujoco.mj_fwdPosition(self._model, self._data)
        return self._share(self._data.actuator_length[: len(COILS)])

    def _share(self, length: Array) -> Array:
        stroke = (length - self._centre) / self._range
        return np.asarray(1.0 - self._falloff * stroke * stroke)


def one_step(
    integrator: str, mass: float, step: float, hand: Hand | None = None, driver_lag: bool = False
) -> tuple[Array, Array]:
    """Return the state transition of one engine step along z.

    It is found from steps that each begin with one unit of one state.

    The state is that of `motion`: position and velocity of the flotor, then those of a hand in a soft grip, then the
    force of the drivers if they lag. For "corrected" it is Euler's: the correction is made at the sample.

    Args:
        integrator: One of `INTEGRATORS`.
        mass: Moving mass [kg].
        step: Time step [s].
        hand: A hand on the flotor.
        driver_lag: Switch the current drivers' first-order lag on.

    Returns:
        Transition matrix, (n, n), and input vector of the commanded force, (n,).

    Raises:
        ParameterError: If there is no such integrator.
    """
    device = prepared(gravity=0.0, coils=driver_lag, integrator=integrator, mass=mass, hand=hand, driver_lag=driver_lag)
    model, coils = device.model, device.coils
    model.opt.timestep = step
    positions, speeds = [device.position_address + 2], [device.velocity_address + 2]
    if hand is not None and hand.soft and 2 in hand.indices:
        joint = model.joint("hand_z")
        positions, speeds = [*positions, int(joint.qposadr[0])], [*speeds, int(joint.dofadr[0])]
    size = 2 * len(positions) + driver_lag
    columns = []
    for start in np.eye(size + 1):
        data = mujoco.MjData(model)
        data.qpos[positions], data.qvel[speeds] = start[: size - driver_lag : 2], start[1 : size - driver_lag : 2]
        after = np.empty(size)
        if coils is None:
            data.xfrc_applied[device.flotor, 2] = start[-1]
            mujoco.mj_step(model, data)
        else:
            data.act[:], data.ctrl[:] = np.outer(start[-2:], coils.current_per_wrench[:, 2])
            mujoco.mj_step(model, data)
            after[-1] = coils.wrench_per_current[2] @ data.act
        after[: size - driver_lag : 2], after[1 : size - driver_lag : 2] = data.qpos[positions], data.qvel[speeds]
        columns.append(after)
    whole = np.array(columns).T
    return whole[:, :size], whole[:, size]
