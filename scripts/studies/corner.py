"""A corner of two walls and a rotation stop.

Three contacts at once, on axes that the device couples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from maglev_mj.control import Hold, Wall
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.frames import Array
from maglev_mj.plants import ExactPlant, MuJoCoPlant, Timing, engine_warnings_silenced
from maglev_mj.spec import INERTIA

_MASS = INERTIA[0]


def corner(plant: str, pose: Sequence[float], twist: Sequence[float], *, duration: float = 2.0) -> tuple[Array, Array]:
    """Throw the flotor into a corner, pulled by a spring.

    Walls at x = 0 and z = 0 and a stop at ry = 0.

    The gains of the stop are those of the walls scaled by inertia, and so is the spring, on all six axes.

    Args:
        plant: "exact" or "mujoco".
        pose: Pose at release [m, rad], (6,).
        twist: Velocity at release [m/s, rad/s], (6,).
        duration: Simulated time [s].

    Returns:
        Sampled poses (K, 6), and kinetic energy at the samples [J], (K,).
    """
    body = np.array(INERTIA)
    into = np.array([0, 2, 4])
    share = body[into] / _MASS
    # a press of 0.4 N at the walls, and as much acceleration at the stop
    pull = Hold(stiffness=200.0 * body / _MASS, damping=4.0 * body / _MASS, target=np.isin(np.arange(6), into) * -2e-3)
    walls = Wall(
        axes=("x", "z", "ry"),
        lower=0.0,
        stiffness=6000.0 * share,
        damping=80.0 * share,
        pulse=220.0 * share,
        pulse_width=0.003,
    )
    kind = ExactPlant if plant == "exact" else MuJoCoPlant
    with kind(Timing(), pose=pose, twist=twist, gravity=0.0, record=True) as made, engine_warnings_silenced():
        drive(made, Controller([walls, pull], period=made.period), round(duration / made.period))
        time = np.arange(round(duration / made.period)) * made.period
        poses, twists, _ = made.trace().at(time)
    return poses, 0.5 * (body * twists**2).sum(axis=1)
