"""The task with Pinocchio: articulated-body dynamics, integrated in Python.

Pinocchio has dynamics and the arithmetic of configurations, but no simulator: its users write the step. That of its
examples is semi-implicit Euler. A step by the mean of the velocities at both ends costs no more, and is exact in
translation under a constant force, so that one step a segment will do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import pinocchio

from peers.task import Array, Task, Variant, quaternion, rotation_vector

_Steps: TypeAlias = Callable[[list[float], list[float], list[float] | None], list[tuple[float, list[float]]]]
"""Function from wrenches to step lengths and wrenches; see `Task`.

From the wrench held, the wrench answered and that of a pulse.
"""

_RAW, _MEAN = 1.0, 0.5  # shares of a step's change of velocity that the flotor moves by


def variants() -> list[Variant]:
    """Return the methods to simulate the task with Pinocchio."""
    table: list[tuple[str, Callable[[Task], Callable[[], Array]], str]] = [
        (f"free flyer, steps of {step * 1e3:g} ms", partial(_stepped, step=step), "semi-implicit Euler")
        for step in (1e-3, 5e-4, 1e-4)
    ]
    table += [
        ("free flyer, step a segment", partial(_segmented, share=_RAW), "semi-implicit Euler"),
        ("free flyer, step a segment, mean velocity", _segmented, ""),
        ("slides and ball, step a segment, mean velocity", partial(_segmented, free=False), "world axes"),
    ]
    return [Variant("pinocchio", name, build, note) for name, build, note in table]


def _model(task: Task, free: bool) -> Any:
    """Return the flotor on one joint, or on four.

    One with forces in body axes, or three slides in world axes and a ball.
    """
    model, last = pinocchio.Model(), 0
    joints = [pinocchio.JointModelTranslation(), pinocchio.JointModelSpherical()]
    for joint in [pinocchio.JointModelFreeFlyer()] if free else joints:
        last = model.addJoint(last, joint, pinocchio.SE3.Identity(), f"joint {last}")
    inertia = pinocchio.Inertia(task.mass, np.zeros(3), np.diag(task.inertia))
    model.appendBodyToJoint(last, inertia, pinocchio.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -task.gravity])
    return model


def _stepped(task: Task, step: float) -> Callable[[], Array]:
    """Step by semi-implicit Euler on a fixed grid.

    With the wrench in effect at the start of each step.
    """
    steps = round(task.period / step)
    begins = math.ceil(task.delay / step - 1e-9)
    ends = math.ceil((task.delay + task.pulse_width) / step - 1e-9)

    def grid(held: list[float], force: list[float], pulse: list[float] | None) -> list[tuple[float, list[float]]]:
        pulsed = [(step, pulse or force)] * (ends - begins)
        return [(step, held)] * begins + pulsed + [(step, force)] * (steps - ends)

    return _closed_loop(task, grid, _RAW, free=True)


def _segmented(task: Task, share: float = _MEAN, free: bool = True) -> Callable[[], Array]:
    """Take one step a wrench switch; see `_closed_loop`."""
    return _closed_loop(task, task.segments, share, free)


def _closed_loop(task: Task, steps: _Steps, share: float, free: bool) -> Callable[[], Array]:
    """Return a run of the closed loop.

    Args:
        task: The task.
        steps: Between two samples.
        share: Share of a step's change of velocity that the flotor moves by: 1 for semi-implicit Euler.
        free: Whether the joint is a free flyer.
    """
    model = _model(task, free)
    data, aba, integrate = model.createData(), pinocchio.aba, pinocchio.integrate
    w, *turned = quaternion(task.pose[3:])
    start = np.array([*task.pose[:3], *turned, w])
    applied = np.zeros(6)

    def run() -> Array:
        law, held, poses = task.law(), [0.0] * 6, []
        position, velocity = start, np.zeros(6)
        x, y, z, qx, qy, qz, qw = position.tolist()
        for _ in range(task.ticks):
            pose = [x, y, z, *rotation_vector(qw, qx, qy, qz)]
            poses.append(pose)
            force, pulse = law(pose)
            for length, wrench in steps(held, force, pulse):
                fx, fy, fz, *torque = wrench
                if free:
                    fx, fy, fz = _in_body_axes(qw, qx, qy, qz, fx, fy, fz)
                applied[:] = fx, fy, fz, *_in_body_axes(qw, qx, qy, qz, *torque)
                change = length * aba(model, data, position, velocity, applied)
                position = integrate(model, position, length * (velocity + share * change))
                velocity += change
                x, y, z, qx, qy, qz, qw = position.tolist()
            held = force
        poses.append([x, y, z, *rotation_vector(qw, qx, qy, qz)])
        return np.array(poses)

    return run


def _in_body_axes(
    qw: float, qx: float, qy: float, qz: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return a world vector in body axes.

    In plain floats, at this size cheaper than a product.
    """
    a, b, c = 2.0 * (qy * z - qz * y), 2.0 * (qz * x - qx * z), 2.0 * (qx * y - qy * x)
    return x - qw * a + qy * c - qz * b, y - qw * b + qz * a - qx * c, z - qw * c + qx * b - qy * a
