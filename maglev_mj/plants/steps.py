"""The map of one step of the engine along z, measured, for the theory of what steps do."""

from __future__ import annotations

import mujoco
import numpy as np

from maglev_mj.frames import Array
from maglev_mj.hand import Hand
from maglev_mj.plants.engine import prepared

__all__ = ["one_step"]


def one_step(
    integrator: str, mass: float, step: float, hand: Hand | None = None, driver_lag: bool = False
) -> tuple[Array, Array]:
    """Return the map of one step of the engine along z, from steps that each begin with one unit of one state.

    The state is that of `motion`: position and velocity of the flotor, then those of a hand in a soft grip, then the
    force of the drivers where they lag.

    Args:
        integrator: One of `INTEGRATORS`.
        mass: Moving mass [kg].
        step: Time step [s].
        hand: A hand on the flotor.
        driver_lag: Switch the current drivers' first-order lag on.

    Returns:
        State after it from that before, (n, n), and from the force commanded, (n,).

    Raises:
        ParameterError: If there is no such integrator.
    """
    device = prepared(
        "drop", gravity=0.0, coils=driver_lag, integrator=integrator, mass=mass, hand=hand, driver_lag=driver_lag
    )
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
