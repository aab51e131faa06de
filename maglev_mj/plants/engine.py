"""The engine set up for a plant: integrator, gravity, the state at release, and the step it needs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, quaternion
from maglev_mj.hand import Hand
from maglev_mj.model import Device, load
from maglev_mj.parameters import number
from maglev_mj.spec import GRAVITY

__all__ = ["INTEGRATORS", "UPRIGHT", "engine_warnings_silenced", "longest_step", "prepared", "start_state"]

_HAND_STEP = 5e-4

UPRIGHT = 1e-9
"""Angle [rad] up to which the coils' map is that of the upright flotor: its error is below any figure here."""


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
) -> Device:
    """Load a device and set its model up for a plant.

    Raises:
        ParameterError: If a value is outside its bounds.
        ModelError: If the scene cannot be used.
    """
    if integrator not in INTEGRATORS:
        raise ParameterError(f"integrator must be one of {', '.join(INTEGRATORS)}, not {integrator!r}")
    device = load(scene, mass=mass, driver_lag=driver_lag, coils=coils, hand=hand)
    options = device.model.opt
    options.integrator = INTEGRATORS[integrator]
    options.gravity[:] = 0.0, 0.0, -number("gravity", gravity)
    # an automatic reset would make a diverging run look stable, and the plant limits currents itself
    options.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
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


def longest_step(device: Device, driver_lag: bool, hand: Hand | None) -> float | None:
    """Return the integration step [s] that a device needs beyond its switches; None for none."""
    needed = [0.25 * device.driver_time_constant] * driver_lag + [_HAND_STEP] * (hand is not None)
    return min(needed, default=None)
