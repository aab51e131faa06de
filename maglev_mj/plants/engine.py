"""MuJoCo engine of a plant: model options, integrators, initial state and steps."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ModelError, PlantError, check_one_of
from maglev_mj.frames import AXES, Array, Component, quaternion
from maglev_mj.lazy import has_engine, mujoco
from maglev_mj.parameters import flag, number
from maglev_mj.plants.device_walls import HALF_ACCELERATION, HALF_ANGULAR
from maglev_mj.plants.hand import Hand
from maglev_mj.plants.model import CompiledModel, Model, acceleration, load_model, reference_state

Drive: TypeAlias = tuple[Sequence[float | None], Sequence[float], Any]
"""Commanded wrench, or (None, N currents); engine controls; inverse coil map, None without coils."""

STOP_TIME = 0.02
"""Time constant of friction along a metal stop [s]; assumed."""

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

_LAG_CACHE = 64

NOTHING = 1e-12
"""Rounding tolerance of angles [rad]."""


@contextmanager
def engine_warnings_silenced() -> Iterator[None]:
    """Suppress the engine's warnings on terminal and in its log file; a plant raises them as errors.

    The warning handler is global to the process; it is restored on exit.
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


def warned(counts: Sequence[int]) -> str:
    """Return the names of the engine's warnings with a count above 0, in the order of mjtWarning; "" without."""
    return ", ".join(mujoco.mjtWarning(kind).name for kind, count in enumerate(counts) if count)


# not mjcb_time, a timer, which MuJoCo's viewer sets
_CALLBACKS = "act_bias", "act_dyn", "act_gain", "contactfilter", "control", "passive", "sensor"


def check_callbacks() -> None:
    """Reject a callback of another component: MuJoCo's are global to the process and would act on every plant.

    Raises:
        PlantError: If one is set.
    """
    for name in _CALLBACKS:
        if (callback := getattr(mujoco, f"get_mjcb_{name}")()) is not None:
            raise PlantError(
                f"mjcb_{name} must be None, because MuJoCo callbacks act on every plant of the process (got "
                f"{callback!r}); mujoco.set_mjcb_{name}(None) clears it"
            )


INTEGRATORS = {
    "euler": "mjINT_EULER",
    "rk4": "mjINT_RK4",
    "implicit": "mjINT_IMPLICIT",
    "implicitfast": "mjINT_IMPLICITFAST",
    "discrete": "mjINT_DISCRETE",
    "corrected": "mjINT_EULER",
}
"""MuJoCo's integrators by name, and "corrected": Euler with a half-step correction (see `CorrectedSteps`)."""


def prepared(
    model: Model = "drop",
    *,
    gravity: ArrayLike | None = None,
    integrator: str = "rk4",
    stops: bool = False,
    force_falloff: float = 0.0,
    **device: Any,
) -> CompiledModel:
    """Load a device and configure its model for a plant.

    Args:
        model: See `load_model`.
        gravity: Gravitational acceleration along -z, or in stator axes (3,) [m/s²], instead of the model's.
        integrator: One of `INTEGRATORS`.
        stops: Enable the metal stops.
        force_falloff: See `MuJoCoPlant`; needs a range of motion in the model.
        device: Other keywords of `load_model`.

    Raises:
        ParameterError: If a value is outside its bounds.
        ModelError: If the model is invalid, or lacks joint limits needed for stops and falloff.
        PlantError: If a MuJoCo callback is set.
    """
    check_callbacks()
    check_one_of("integrator", INTEGRATORS, integrator)
    loaded = load_model(model, **device)
    options = loaded.model.opt
    options.integrator = mujoco.mjtIntegrator.__members__[INTEGRATORS[integrator]]
    options.gravity[:] = loaded.gravity if gravity is None else acceleration(gravity)
    options.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    if not _has_passive_forces(loaded.model):  # both flags together disable all passive forces
        options.disableflags |= mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER
    # an automatic reset would hide divergence; currents are limited by the plant
    options.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    if flag("stops", stops):
        options.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
    else:
        options.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    falloff = number("force_falloff", force_falloff, at_least=0.0, at_most=1.0)
    if (stops or falloff) and not np.isfinite(loaded.range).all():
        raise ModelError("stops and force_falloff need joint limits on x, y, z and rotation in the model")
    return loaded


def _has_passive_forces(model: mujoco.MjModel) -> bool:
    """Return True if joints, tendons, a fluid, flexes or plugins may exert passive forces."""
    springs = (getattr(model, name) for name in _PASSIVE)
    options = model.opt
    return bool(any(map(np.any, springs)) or options.density or options.viscosity or model.nflex or model.nplugin)


def start_state(device: CompiledModel, pose: Array, twist: Array, hand: Hand | None) -> tuple[Array, Array]:
    """Return qpos and qvel of a device at release.

    A hand with a soft grip starts in static equilibrium with the flotor, at its velocity.

    Args:
        device: CompiledModel.
        pose: Pose of the flotor [m, rad], (6,).
        twist: Its velocity [m/s, rad/s], (6,).
        hand: Hand on the flotor.
    """
    model = device.model
    position, velocity, rotation = np.zeros(model.nq), np.zeros(model.nv), np.zeros(9)
    first, start = device.position_address, device.velocity_address
    position[first : first + 3], position[first + 3 : first + 7] = pose[:3], quaternion(pose[3:])
    mujoco.mju_quat2Mat(rotation, position[first + 3 : first + 7])
    # MuJoCo's angular velocity is in flotor axes
    velocity[start : start + 3], velocity[start + 3 : start + 6] = twist[:3], twist[3:] @ rotation.reshape(3, 3)
    if hand is not None and hand.soft:
        for index in hand.indices:
            joint = model.joint(f"hand_{AXES[index]}")
            position[joint.qposadr], velocity[joint.dofadr] = hand.position_at_rest(pose[index]), twist[index]
    return position, velocity


def hand_addresses(device: CompiledModel, hand: Hand | None) -> list[int]:
    """Return the indices into qvel of the hand's muscle forces on x, y and z.

    They act on the hand's own mass in a soft grip, otherwise on the flotor.
    """
    addresses = [device.velocity_address + index for index in range(3)]
    for index in hand.indices if hand is not None and hand.soft else ():
        addresses[index] = int(device.model.joint(f"hand_{AXES[index]}").dofadr[0])
    return addresses


def longest_step(
    hand: Hand | None = None, stops: bool = False, force_falloff: float = 0.0, flexible: bool = False
) -> float | None:
    """Return the largest integrator step [s]; None if steps at force switches are enough.

    Args:
        hand: Hand on the flotor.
        stops: Metal stops enabled.
        force_falloff: Fraction of the force lost at the ends of the range.
        flexible: Flexible handle.
    """
    limits = (
        (hand is not None, _HAND_STEP),
        (stops, _STOP_STEP),
        (force_falloff > 0.0, _FALLOFF_STEP),
        (flexible, _BEND_STEP),
    )
    return min((step for applies, step in limits if applies), default=None)


def near_stops(reach: Sequence[float], position: Sequence[float], velocity: Sequence[float], period: float) -> bool:
    """Return True if the flotor may reach a metal stop within one period, so that contact needs short steps.

    Args:
        reach: Smallest displacement and smallest angle of a stop [m, rad].
        position: x y z [m] and the scalar part of the quaternion.
        velocity: Linear and angular velocity [m/s, rad/s].
        period: Sample period [s].
    """
    x, y, z, w = position
    u, v, s, p, q, r = velocity
    if max(abs(x), abs(y), abs(z)) + period * (max(abs(u), abs(v), abs(s)) + HALF_ACCELERATION * period) > reach[0]:
        return True
    angle = 2.0 * math.sqrt(max(1.0 - w * w, 0.0))
    return angle + period * (math.sqrt(p * p + q * q + r * r) + HALF_ANGULAR * period) > reach[1]


class Steps:
    """Engine steps of one device under constant controls.

    Args:
        device: CompiledModel.
        data: Its state.
        falloff: See `MuJoCoPlant`.
        stop_damping: See `MuJoCoPlant`.

    Attributes:
        look: Function that returns x y z [m] and a quaternion without changing the state.
        settle: The same at a sample, after which the state is that position.
    """

    def __init__(
        self, device: CompiledModel, data: mujoco.MjData, falloff: float = 0.0, stop_damping: bool = False
    ) -> None:
        self._options = device.model.opt
        controls = data.xfrc_applied[device.flotor] if device.coils is None else data.ctrl[: len(device.coils)]
        # equivalent to controls[:] = values, in half the time
        self._control = partial(struct.Struct(f"{len(controls)}d").pack_into, controls.data, 0)
        self._drive: Drive | None = None  # of the last step: its controls are set
        self.stops = _DampedStops(device, data) if stop_damping else None
        step = self.stops or partial(mujoco.mj_step, device.model, data)
        self.falloff = _Falloff(device, data, falloff, step) if falloff else None
        self._step: Callable[..., object] = self.falloff or step
        self._position = data.qpos[device.position_address :][:7]
        self.look: Callable[[], Sequence[float]] = self._position.tolist
        self.settle: Callable[[], Sequence[float]] = self.look

    def reset(self, actual: Sequence[float]) -> None:
        """Start again from a reset state, with controls that only `LaggingSteps` remember."""
        self._drive = None
        if self.stops is not None:
            self.stops.reset()

    def advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        """Advance the state by `duration` [s] under a drive, in `pieces` equal steps."""
        if drive is not self._drive:
            self._drive = drive
            self._control(*drive[1])
        if pieces != 1:
            duration /= pieces
        self._options.timestep = duration
        self._step(pieces)


class CorrectedSteps(Steps):
    """Euler steps, corrected to be exact under a constant force.

    A semi-implicit step h moves the flotor by h v[k+1]; under a constant force the exact displacement is
    h (v[k] + v[k+1]) / 2. The excess (h/2) (v[k+1] - v[k]) is subtracted at each sample. Translation is exact to
    rounding, as with RK4, at a third of the cost per step. Forces that vary within a step (hand, rotation about several
    axes) leave an error of first order in h.
    """

    def __init__(
        self, device: CompiledModel, data: mujoco.MjData, falloff: float = 0.0, stop_damping: bool = False
    ) -> None:
        super().__init__(device, data, falloff, stop_damping)
        self._read, self.look, self.settle = self.look, self._look, self._settle
        self._velocity = data.qvel[device.velocity_address :][:6].tolist
        self._acceleration = data.qacc[device.velocity_address :][:6].tolist
        self._put = partial(struct.pack_into, "7d", self._position.data, 0)
        # with implicit damping in the engine, the change in velocity is not step times acceleration
        self._damped = bool(device.model.dof_damping.any() or device.model.tendon_damping.any())
        # excess per interval since the last correction: a factor, and the change in velocity or the acceleration
        self._excess: list[tuple[float, Sequence[float]]] = []

    def advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        """Advance the state; see `Steps`."""
        if pieces > 1 or self._damped:
            before = self._velocity()
            super().advance(duration, drive, pieces)
            change = [after - earlier for after, earlier in zip(self._velocity(), before)]
            self._excess.append((0.5 * duration / pieces, change))
            return
        if drive is not self._drive:
            self._drive = drive
            self._control(*drive[1])
        self._options.timestep = duration
        self._step()
        self._excess.append((0.5 * duration * duration, self._acceleration()))

    def reset(self, actual: Sequence[float]) -> None:
        """Start again; see `Steps`."""
        super().reset(actual)
        self._excess.clear()

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
        """Subtract the accumulated excess; return x y z [m] and a quaternion."""
        pose = self._look()
        self._excess.clear()
        self._put(*pose)
        return pose


class LagFactors:
    """Steps of constant controls in place of controls that follow a command u by a first-order lag.

    From controls f they are u + (f - u) exp(-t / lag). Two halves of a step with the constant controls u + a (f - u)
    and u + b (f - u) give a free mass the same velocity and displacement; in one step, for an integrator of first
    order, a gives it the velocity.

    Args:
        lag: Time constant of the drivers [s].
        integrator: One of `INTEGRATORS`.
    """

    def __init__(self, lag: float, integrator: str) -> None:
        self._lag, self._halves = lag, integrator in ("rk4", "corrected")
        self._cache: dict[float, tuple[tuple[Component, ...], Component]] = {}

    def of(self, step: Component) -> tuple[tuple[Component, ...], Component]:
        """Return the factors of f - u, (a, b) or (a,), and of what is left of it after a step [s]."""
        if step.__class__ is float and step in self._cache:
            return self._cache[step]
        gone = -np.expm1(-step / self._lag)
        mean = self._lag * gone / step  # over the step
        twice = 4.0 * self._lag * (1.0 - mean) / step
        found = (twice - mean, 3.0 * mean - twice) if self._halves else (mean,)
        if step.__class__ is not float:
            return found, 1.0 - gone
        if len(self._cache) > _LAG_CACHE:  # jittered durations do not recur
            self._cache.clear()
        result = tuple(map(float, found)), float(1.0 - gone)
        self._cache[step] = result
        return result


class LaggingSteps:
    """Engine steps of one device whose controls lag behind their command; otherwise as `Steps`.

    Exact for translations under RK4 and "corrected", however long a step is; see `LagFactors`.

    Args:
        steps: Steps under constant controls.
        factors: Those of the lag.

    Attributes:
        commanded: Commanded controls of the last step.
        actual: Controls at present.
    """

    def __init__(self, steps: Steps, factors: LagFactors) -> None:
        self.inner, self._factors = steps, factors
        self.stops, self.falloff, self.look, self.settle = steps.stops, steps.falloff, steps.look, steps.settle
        self.commanded: list[float] = []
        self.actual: list[float] = []

    def reset(self, actual: Sequence[float]) -> None:
        """Start again, with the controls at release; see `Steps`."""
        self.inner.reset(actual)
        self.commanded = self.actual = list(actual)

    def advance(self, duration: float, drive: Drive, pieces: int = 1) -> None:
        """Advance the state; see `Steps`."""
        self.commanded = commanded = list(drive[1])
        step = duration / pieces
        parts, left = self._factors.of(step)
        step /= len(parts)
        for _ in range(pieces):
            error = [actual - u for actual, u in zip(self.actual, commanded)]
            for part in parts:
                self.inner.advance(step, ((None,), [u + part * e for u, e in zip(commanded, error)], None))
            self.actual = [u + left * e for u, e in zip(commanded, error)]


def turned_back(
    w: Component, a: Component, b: Component, c: Component, rx: Component, ry: Component, rz: Component
) -> tuple[Component, Component, Component, Component]:
    """Rotate a unit quaternion backward by a small angle (rx, ry, rz) [rad] about body axes."""
    # second-order expansion; the engine normalizes the quaternion
    p, q, r = -0.5 * rx, -0.5 * ry, -0.5 * rz
    cosine = 1.0 - 0.5 * (p * p + q * q + r * r)
    return (
        w * cosine - a * p - b * q - c * r,
        w * p + a * cosine + b * r - c * q,
        w * q - a * r + b * cosine + c * p,
        w * r + a * q - b * p + c * cosine,
    )


def wrench_work(force: Sequence[Component], before: Sequence[Component], after: Sequence[Component]) -> Component:
    """Return the work [J] of a constant wrench between two positions, each x y z [m] and a quaternion.

    Exact for translations, to second order in the angle for rotations.
    """
    x, y, z, w, a, b, c = before
    p, q, r, d, i, j, k = after
    fx, fy, fz, tx, ty, tz = force
    # vector part of the relative quaternion
    rx = w * i - a * d - b * k + c * j
    ry = w * j - b * d - c * i + a * k
    rz = w * k - c * d - a * j + b * i
    return fx * (p - x) + fy * (q - y) + fz * (r - z) + 2.0 * (tx * rx + ty * ry + tz * rz)


class _DampedStops:
    """Engine step with friction along stops in contact.

    A joint limit acts along its own coordinate only: without friction, a flotor at its angle limit rotates
    indefinitely.
    """

    def __init__(self, device: CompiledModel, data: mujoco.MjData) -> None:
        self._model, self._data = device.model, data
        self._damping = device.model.dof_damping[device.velocity_address :][:6]
        self._free = self._damping.copy()
        device.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_DAMPER)
        self._touching = self._free + np.append([device.mass] * 3, device.inertia) / STOP_TIME
        self._touched = False

    def reset(self) -> None:
        """Start again without contact."""
        self._touched = False
        self._damping[:] = self._free

    def __call__(self, steps: int = 1) -> None:
        """Step `steps` times."""
        for _ in range(steps):
            self._damping[:] = self._touching if self._touched else self._free
            mujoco.mj_step(self._model, self._data)
            self._touched = bool(self._data.nl)


class _Falloff:
    """Engine step with a coil force that decreases with stroke s: 1 - falloff (s / range)².

    Force constants are evaluated at midstep, for an error of second order in the step.

    Attributes:
        central: Force constants at the centre of the range [N/A], (N,); 0 for an open coil.
    """

    def __init__(self, device: CompiledModel, data: mujoco.MjData, falloff: float, step: Callable[[], object]) -> None:
        self._model, self._data, self._falloff, self._step = device.model, data, falloff, step
        assert device.coils is not None  # required by the plant
        self._coils = slice(len(device.coils))
        self._centre = reference_state(device.model).actuator_length[self._coils].copy()
        self.central = device.model.actuator_gainprm[self._coils, 0].copy()
        self._range = float(device.range[:3].max())

    def __call__(self, steps: int = 1) -> None:
        """Step `steps` times."""
        model, data, coils = self._model, self._data, self._coils
        gains = model.actuator_gainprm[coils, 0]
        length, speed = data.actuator_length[coils], data.actuator_velocity[coils]
        half = 0.5 * model.opt.timestep
        for _ in range(steps):
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            gains[:] = self.central * self._share(length + half * speed)
            self._step()

    def share(self) -> Array:
        """Return the relative force constant of each coil at present, (N,)."""
        mujoco.mj_fwdPosition(self._model, self._data)
        return self._share(self._data.actuator_length[self._coils])

    def _share(self, length: Array) -> Array:
        stroke = (length - self._centre) / self._range
        return np.asarray(1.0 - self._falloff * stroke * stroke)


def one_step(
    integrator: str, mass: float, step: float, hand: Hand | None = None, driver_lag: float = 0.0
) -> tuple[Array, Array]:
    """Return the state transition of one engine step along z, one column per unit initial state.

    The state is that of `motion`: position and velocity of the flotor, then those of a hand with a soft grip, then the
    lagging driver force. For "corrected" it is Euler's: the correction is made at the sample.

    Args:
        integrator: One of `INTEGRATORS`.
        mass: Moving mass [kg].
        step: Integrator step [s].
        hand: Hand on the flotor.
        driver_lag: Time constant of the drivers [s]; 0 for no lag.

    Returns:
        Transition matrix, (n, n), and input vector of the commanded force, (n,).

    Raises:
        ParameterError: If the integrator is unknown.
    """
    if driver_lag:
        factors, left = LagFactors(driver_lag, integrator).of(step)
        one, push = one_step(integrator, mass, step / len(factors), hand)
        still = len(push)
        matrix = np.eye(still + 1, still + 2)  # columns: state, force, command
        for part in factors:
            force = np.zeros(still + 2)
            force[still:] = part, 1.0 - part
            matrix[:still] = one @ matrix[:still] + np.outer(push, force)
        matrix[still, still:] = left, 1.0 - left
        return matrix[:, :-1], matrix[:, -1]
    device = prepared(gravity=0.0, coils=False, integrator=integrator, mass=mass, hand=hand)
    model = device.model
    model.opt.timestep = step
    positions, speeds = [device.position_address + 2], [device.velocity_address + 2]
    if hand is not None and hand.soft and 2 in hand.indices:
        joint = model.joint("hand_z")
        positions, speeds = [*positions, int(joint.qposadr[0])], [*speeds, int(joint.dofadr[0])]
    size = 2 * len(positions)
    columns = []
    for start in np.eye(size + 1):
        data = mujoco.MjData(model)
        data.qpos[positions], data.qvel[speeds] = start[:size:2], start[1:size:2]
        state = np.empty(size)
        data.xfrc_applied[device.flotor, 2] = start[-1]
        mujoco.mj_step(model, data)
        state[::2], state[1::2] = data.qpos[positions], data.qvel[speeds]
        columns.append(state)
    matrix = np.array(columns).T
    return matrix[:, :size], matrix[:, size]
