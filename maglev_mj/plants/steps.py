"""What one step of an integrator does to the flotor, measured."""

from __future__ import annotations

import mujoco
import numpy as np

from maglev_mj.frames import Array
from maglev_mj.plants.engine import prepared

__all__ = ["one_step"]


def one_step(integrator: str, mass: float, step: float) -> tuple[Array, Array]:
    """Return the map of one step of the engine along z, from three steps that begin with 1 m, 1 m/s and 1 N.

    Args:
        integrator: One of `INTEGRATORS`.
        mass: Moving mass [kg].
        step: Time step [s].

    Returns:
        Position and velocity after it from those before, (2, 2), and from the force, (2,).

    Raises:
        ParameterError: If there is no such integrator.
    """
    device = prepared("drop", gravity=0.0, coils=False, integrator=integrator, mass=mass)
    device.model.opt.timestep = step
    place, speed = device.position_address + 2, device.velocity_address + 2
    columns = []
    for start in np.eye(3):
        data = mujoco.MjData(device.model)
        data.qpos[place], data.qvel[speed], data.xfrc_applied[device.flotor, 2] = start
        mujoco.mj_step(device.model, data)
        columns.append([data.qpos[place], data.qvel[speed]])
    whole = np.array(columns).T
    return whole[:, :2], whole[:, 2]
