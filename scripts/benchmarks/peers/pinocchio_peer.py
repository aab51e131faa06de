"""The task with Pinocchio: articulated-body dynamics, integrated in Python.

Pinocchio has dynamics and the arithmetic of configurations, but no simulator: its users write the step. That of its
examples is semi-implicit Euler. A step by the mean of the velocities at both ends costs no more, and is exact in
translation under a constant force, so that one step an interval will do.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio

from peers.task import Array, Simulate, Task, Variant, closed_loop, quaternion, rotation_vector

_RAW, _MEAN = 1.0, 0.5  # shares of a step's change of velocity that the flotor moves by


def variants() -> list[Variant]:
    """Return the methods to simulate the task with Pinocchio."""
    table: list[tuple[str, Callable[[Task], Simulate], str]] = [
        (f"semi-implicit Euler, steps of {step * 1e3:g} ms", partial(_simulated, share=_RAW, step=step), "")
        for step in (1e-3, 5e-4, 1e-4)
    ]
    table += [
        ("semi-implicit Euler, step an interval", partial(_simulated, share=_RAW), ""),
        ("mean velocity, step an interval", partial(_simulated, share=_MEAN), "Pinocchio, mean velocity"),
    ]
    return [Variant("pinocchio", *row) for row in table]


def _simulated(task: Task, share: float, step: float | None = None) -> Simulate:
    """Return a run with the flotor on three slides in world axes and a ball.

    Args:
        task: The task.
        share: Share of a step's change of velocity that the flotor moves by: 1 for semi-implicit Euler.
        step: Of a fixed grid [s]; None for a step from switch to switch.
    """
    model, last = pinocchio.Model(), 0
    for joint in (pinocchio.JointModelTranslation(), pinocchio.JointModelSpherical()):
        last = model.addJoint(last, joint, pinocchio.SE3.Identity(), f"joint {last}")
    inertia = pinocchio.Inertia(task.mass, np.zeros(3), np.diag(task.inertia))
    model.appendBodyToJoint(last, inertia, pinocchio.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -task.gravity])
    data, aba, integrate = model.createData(), pinocchio.aba, pinocchio.integrate
    w, *turned = quaternion(task.pose[3:])
    start = np.array([*task.pose[:3], *turned, w])
    applied, velocity = np.zeros(6), np.zeros(6)
    position: Array = start
    x, y, z, qx, qy, qz, qw = start.tolist()

    def restart() -> None:
        nonlocal position, x, y, z, qx, qy, qz, qw
        position, velocity[:] = start, 0.0
        x, y, z, qx, qy, qz, qw = start.tolist()

    def pose() -> list[float]:
        return [x, y, z, *rotation_vector(qw, qx, qy, qz)]

    def advance(length: float, wrench: list[float]) -> None:
        nonlocal position, x, y, z, qx, qy, qz, qw
        fx, fy, fz, *torque = wrench
        applied[:] = fx, fy, fz, *_in_body_axes(qw, qx, qy, qz, *torque)
        change = length * aba(model, data, position, velocity, applied)
        position = integrate(model, position, length * (velocity + share * change))
        velocity[:] += change
        x, y, z, qx, qy, qz, qw = position.tolist()

    return closed_loop(task, restart, pose, advance, None if step is None else task.grid(step))


def _in_body_axes(
    qw: float, qx: float, qy: float, qz: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return a world vector in body axes, cheaper in plain floats than by a product."""
    a, b, c = 2.0 * (qy * z - qz * y), 2.0 * (qz * x - qx * z), 2.0 * (qx * y - qy * x)
    return x - qw * a + qy * c - qz * b, y - qw * b + qz * a - qx * c, z - qw * c + qx * b - qy * a
