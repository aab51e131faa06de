"""The task in PyBullet, without a window.

Bullet steps by semi-implicit Euler: the velocity is exact under a constant force, the position h/2 dv off after each
step. That offset adds up in closed form, so a user who knows it takes one long step a segment and is exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pybullet

from peers.task import Array, Task, Variant, quaternion, rotation_vector


def variants() -> list[Variant]:
    """Return the methods to simulate the task in PyBullet."""
    table: list[tuple[str, Callable[[Task], Callable[[], Array]], str]] = [
        ("steps of 1 ms", partial(_stepped, step=1e-3), "switches at 1.5 ms fall between steps"),
        ("steps of 0.5 ms", partial(_stepped, step=5e-4), "all switches on the grid"),
        ("steps of 0.1 ms", partial(_stepped, step=1e-4), ""),
        ("step a segment", partial(_segmented, corrected=False), "raw positions"),
        ("step a segment, corrected", partial(_segmented, corrected=True), "less h/2 dv a segment"),
        ("step a segment, corrected, force as gravity", partial(_segmented, corrected=True, as_gravity=True), ""),
    ]
    return [Variant("pybullet", name, build, note) for name, build, note in table]


class _Flotor:
    """The flotor in a world of its own."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self.client = pybullet.connect(pybullet.DIRECT)
        # as a multibody: rigid bodies (useMaximalCoordinates) are damped and put to sleep by other rules
        self.body = pybullet.createMultiBody(baseMass=task.mass, physicsClientId=self.client)
        pybullet.changeDynamics(
            self.body,
            -1,
            localInertiaDiagonal=task.inertia,
            linearDamping=0.0,
            angularDamping=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=self.client,
        )
        w, x, y, z = quaternion(task.pose[3:])
        self._start: tuple[list[float], list[float]] = (task.pose[:3], [x, y, z, w])

    def reset(self) -> None:
        """Put the flotor back to the start, at rest."""
        pybullet.resetBasePositionAndOrientation(self.body, *self._start, physicsClientId=self.client)
        pybullet.resetBaseVelocity(self.body, [0.0] * 3, [0.0] * 3, physicsClientId=self.client)
        pybullet.setGravity(0.0, 0.0, -self._task.gravity, physicsClientId=self.client)

    def pose(self) -> list[float]:
        """Return the pose [m, rad]."""
        position, (x, y, z, w) = pybullet.getBasePositionAndOrientation(self.body, physicsClientId=self.client)
        return [*position, *rotation_vector(w, x, y, z)]

    def position(self) -> Any:
        """Return the position [m]."""
        return pybullet.getBasePositionAndOrientation(self.body, physicsClientId=self.client)[0]

    def push(self, wrench: list[float], position: Any) -> None:
        """Apply a wrench for the next step, at the flotor: Bullet forgets it after each."""
        pybullet.applyExternalForce(
            self.body, -1, wrench[:3], position, pybullet.WORLD_FRAME, physicsClientId=self.client
        )
        self.turn(wrench)

    def lift(self, wrench: list[float]) -> None:
        """Apply a force as gravity; it lasts, and needs no point of attack."""
        mass = self._task.mass
        x, y, z = wrench[:3]
        pybullet.setGravity(x / mass, y / mass, z / mass - self._task.gravity, physicsClientId=self.client)

    def turn(self, wrench: list[float]) -> None:
        """Apply the torque of a wrench for the next step."""
        pybullet.applyExternalTorque(self.body, -1, wrench[3:], pybullet.WORLD_FRAME, physicsClientId=self.client)


def _stepped(task: Task, step: float) -> Callable[[], Array]:
    """Step on a fixed grid with the wrench in effect."""
    flotor = _Flotor(task)
    client = flotor.client
    steps = round(task.period / step)
    begins = math.ceil(task.delay / step - 1e-9)
    ends = math.ceil((task.delay + task.pulse_width) / step - 1e-9)

    def run() -> Array:
        flotor.reset()
        pybullet.setTimeStep(step, physicsClientId=client)
        law, held, poses = task.law(), [0.0] * 6, []
        for _ in range(task.ticks):
            pose = flotor.pose()
            poses.append(pose)
            force, pulse = law(pose)
            for index in range(steps):
                wrench = held if index < begins else force if pulse is None or index >= ends else pulse
                flotor.push(wrench, flotor.position() if index else pose[:3])
                pybullet.stepSimulation(physicsClientId=client)
            held = force
        poses.append(flotor.pose())
        return np.array(poses)

    return run


def _segmented(task: Task, corrected: bool, as_gravity: bool = False) -> Callable[[], Array]:
    """Take one step from switch to switch of the wrench.

    Args:
        task: The task.
        corrected: Whether what semi-implicit Euler is off by is taken off the pose.
        as_gravity: Whether the force is given as gravity.
    """
    flotor = _Flotor(task)
    client, body = flotor.client, task.body
    free_fall = [0.0, 0.0, -task.gravity, 0.0, 0.0, 0.0]

    def run() -> Array:
        flotor.reset()
        law, held, poses, ahead = task.law(), [0.0] * 6, [], [0.0] * 6
        for _ in range(task.ticks):
            raw = flotor.pose()
            pose = [part - extra for part, extra in zip(raw, ahead)]
            poses.append(pose)
            force, pulse = law(pose)
            at: Any = raw[:3]
            for length, wrench in task.segments(held, force, pulse):
                pybullet.setTimeStep(length, physicsClientId=client)
                if as_gravity:
                    flotor.lift(wrench)
                    flotor.turn(wrench)
                else:
                    flotor.push(wrench, at or flotor.position())
                pybullet.stepSimulation(physicsClientId=client)
                at = None
                if corrected:
                    half = 0.5 * length * length
                    ahead = [a + half * (w / m + g) for a, w, m, g in zip(ahead, wrench, body, free_fall)]
            held = force
        poses.append([part - extra for part, extra in zip(flotor.pose(), ahead)])
        return np.array(poses)

    return run
