"""The engine set up for a plant: integrator, gravity, the state at release, and the step it needs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np

from maglev_mj.detail import Detail
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, quaternion
from maglev_mj.hand import Hand
from maglev_mj.model import COILS, Device, load
from maglev_mj.parameters import flag, number
from maglev_mj.spec import GRAVITY, Spec

__all__ = [
    "INTEGRATORS",
    "FadingCoils",
    "effort_addresses",
    "engine_warnings_silenced",
    "longest_step",
    "near_stops",
    "prepared",
    "start_state",
]

_HAND_STEP, _STOP_STEP, _FALLOFF_STEP, _BEND_STEP = 5e-4, 2.5e-4, 2.5e-4, 5e-5


@contextmanager
def engine_warnings_silenced() -> Iterator[None]:
    """Keep the engine's warnings off the terminal and out of its log file; a plant raises them as errors anyway.

    The engine has one warning handler for the whole process, which is put back at the end.
    """
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


_KINDS = mujoco.mjtIntegrator.__members__
INTEGRATORS = {name.removeprefix("mjINT_").lower(): kind for name, kind in _KINDS.items()}
"""The engine's integrators by name."""


def prepared(
    scene: str,
    *,
    mass: float | None = None,
    gravity: float = GRAVITY,
    coils: bool = True,
    driver_lag: bool = False,
    hand: Hand | None = None,
    integrator: str = "rk4",
    detail: Detail | None = None,
) -> Device:
    """Load a device and set its model up for a plant.

    Raises:
        ParameterError: If a value is outside its bounds.
        ModelError: If the scene cannot be used.
    """
    if integrator not in INTEGRATORS:
        raise ParameterError(f"integrator must be one of {', '.join(INTEGRATORS)}, not {integrator!r}")
    device = load(scene, mass=mass, driver_lag=driver_lag, coils=coils, hand=hand, detail=detail)
    options = device.model.opt
    options.integrator = INTEGRATORS[integrator]
    options.gravity[:] = 0.0, 0.0, -number("gravity", gravity)
    # an automatic reset would make a diverging run look stable, and the plant limits currents itself
    options.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    if detail is not None and detail.stops:
        options.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return device


def start_state(device: Device, pose: Array, twist: Array, hand: Hand | None) -> tuple[Array, Array]:
    """Return qpos and qvel of a device at release; a hand in a soft grip starts in balance, as fast as the flotor.

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
    for index, axis in enumerate(AXES[:3]):
        if hand is not None and hand.soft and index in hand.indices:
            joint = model.joint(f"hand_{axis}").id
            position[model.jnt_qposadr[joint]] = hand.place(pose[index])
            velocity[model.jnt_dofadr[joint]] = twist[index]
    return position, velocity


def effort_addresses(device: Device, hand: Hand | None) -> tuple[int, int, int]:
    """Return the indices into qvel on which a hand's muscles act along x, y and z: its own where its grip is soft."""
    first, second, third = (
        int(device.model.joint(f"hand_{axis}").dofadr[0])
        if hand is not None and hand.soft and index in hand.indices
        else device.velocity_address + index
        for index, axis in enumerate(AXES[:3])
    )
    return first, second, third


def longest_step(device: Device, driver_lag: bool, hand: Hand | None, detail: Detail | None = None) -> float | None:
    """Return the integration step [s] that a device needs beyond its switches; None for none."""
    detail = detail or Detail()
    needed = [0.25 * device.driver_time_constant] * flag("driver_lag", driver_lag) + [_HAND_STEP] * (hand is not None)
    needed += (
        [_STOP_STEP] * detail.stops + [_BEND_STEP] * detail.flexible + [_FALLOFF_STEP] * (detail.force_falloff > 0)
    )
    return min(needed, default=None)


_FIERCEST, _FIERCEST_TURN = 60.0, 2500.0
"""Half the largest acceleration that coils and a hand give the flotor [m/s², rad/s²]."""

_RANGE, _ANGLE = Spec.translation_range.value, math.radians(Spec.rotation_range.value)


def near_stops(position: Sequence[float], velocity: Sequence[float], period: float) -> bool:
    """Return whether a flotor may meet a stop within a period, which takes short steps; elsewhere they are waste.

    Args:
        position: x y z [m] and a quaternion.
        velocity: Linear and angular [m/s, rad/s].
        period: Sample period [s].
    """
    x, y, z, w, *_ = position
    u, v, s, p, q, r = velocity
    if max(abs(x), abs(y), abs(z)) + period * (max(abs(u), abs(v), abs(s)) + _FIERCEST * period) > _RANGE:
        return True
    angle = 2.0 * math.sqrt(max(1.0 - w * w, 0.0))
    return angle + period * (math.sqrt(p * p + q * q + r * r) + _FIERCEST_TURN * period) > _ANGLE


class FadingCoils:
    """A step of the engine with coils that push the less the further they are from their magnets' centre.

    The force constants of a step are those half way through it, so that the error is of second order in the step.

    Args:
        device: With its coils.
        data: Its state.
        falloff: See `Detail`.
    """

    def __init__(self, device: Device, data: mujoco.MjData, falloff: float) -> None:
        self._model, self._data, self._falloff = device.model, data, falloff
        self._centre = _lengths_at_centre(device)
        self._flat = device.model.actuator_gainprm[: len(COILS), 0].copy()
        self._range = Spec.translation_range.value

    def __call__(self, steps: int = 1) -> None:
        """Make some steps."""
        model, data, coils = self._model, self._data, slice(len(COILS))
        gains, length, speed = (
            model.actuator_gainprm[coils, 0],
            data.actuator_length[coils],
            data.actuator_velocity[coils],
        )
        half = 0.5 * model.opt.timestep
        for _ in range(steps):
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            gains[:] = self._flat * self._share(length + half * speed)
            mujoco.mj_step(model, data)

    def share(self) -> Array:
        """Return what share of its force each coil gives where the flotor is, (6,)."""
        mujoco.mj_fwdPosition(self._model, self._data)
        return self._share(self._data.actuator_length[: len(COILS)])

    def _share(self, length: Array) -> Array:
        stroke = (length - self._centre) / self._range
        return 1.0 - self._falloff * stroke * stroke


def _lengths_at_centre(device: Device) -> Array:
    """Return where each coil is along its force with the flotor at centre [m], (6,)."""
    data = mujoco.MjData(device.model)
    mujoco.mj_forward(device.model, data)
    lengths: Array = data.actuator_length[: len(COILS)].copy()
    return lengths
