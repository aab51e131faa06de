"""The task in PyBullet, without a window.

Bullet steps by semi-implicit Euler: the velocity is exact under a constant force, the position h/2 dv off after each
step. That offset adds up in closed form, so a user who knows it takes one long step an interval and is exact.
"""

from __future__ import annotations

from functools import partial

import pybullet

from peers.task import Simulate, Task, Variant, closed_loop, quaternion, rotation_vector


def variants() -> list[Variant]:
    """Return the methods to simulate the task in PyBullet."""
    grid = [
        Variant("pybullet", f"steps of {step * 1e3:g} ms", partial(_stepped, step=step)) for step in (1e-3, 5e-4, 1e-4)
    ]
    name, title = "step an interval, corrected, force as gravity", "PyBullet, force as gravity"
    return [*grid, Variant("pybullet", name, _by_intervals, title)]


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

    def turn(self, wrench: list[float]) -> None:
        """Apply the torque of a wrench for the next step; Bullet forgets it after each."""
        pybullet.applyExternalTorque(self.body, -1, wrench[3:], pybullet.WORLD_FRAME, physicsClientId=self.client)


def _stepped(task: Task, step: float) -> Simulate:
    """Step on a fixed grid with the wrench in effect."""
    flotor = _Flotor(task)
    client, body = flotor.client, flotor.body

    def restart() -> None:
        flotor.reset()
        pybullet.setTimeStep(step, physicsClientId=client)

    def advance(_: float, wrench: list[float]) -> None:
        at = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)[0]
        pybullet.applyExternalForce(body, -1, wrench[:3], at, pybullet.WORLD_FRAME, physicsClientId=client)
        flotor.turn(wrench)
        pybullet.stepSimulation(physicsClientId=client)

    return closed_loop(task, restart, flotor.pose, advance, task.grid(step))


def _by_intervals(task: Task) -> Simulate:
    """Take one step from switch to switch of the wrench.

    The force is given as gravity, which lasts and needs no point of attack; what semi-implicit Euler is off by is taken
    off the pose.
    """
    flotor = _Flotor(task)
    client, mass = flotor.client, task.mass
    free_fall = [0.0, 0.0, -task.gravity, 0.0, 0.0, 0.0]
    ahead = [0.0] * 6

    def restart() -> None:
        flotor.reset()
        ahead[:] = [0.0] * 6

    def pose() -> list[float]:
        return [part - extra for part, extra in zip(flotor.pose(), ahead)]

    def advance(length: float, wrench: list[float]) -> None:
        x, y, z = wrench[:3]
        pybullet.setTimeStep(length, physicsClientId=client)
        pybullet.setGravity(x / mass, y / mass, z / mass - task.gravity, physicsClientId=client)
        flotor.turn(wrench)
        pybullet.stepSimulation(physicsClientId=client)
        half = 0.5 * length * length
        ahead[:] = [a + half * (w / m + g) for a, w, m, g in zip(ahead, wrench, task.body, free_fall)]

    return closed_loop(task, restart, pose, advance)
