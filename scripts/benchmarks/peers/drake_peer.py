"""The task in Drake: a MultibodyPlant and a Python controller.

Two methods to close the loop: a LeafSystem with periodic events in a diagram, or a script that advances the simulator
from switch to switch of the wrench.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RpyFloatingJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from peers.task import Array, Simulate, Task, Variant, closed_loop, rotation_vector

# An update of a discrete plant belongs after the switch at the same time; rounding must not decide which comes first.
_JUST_BEFORE = 1e-9


def variants() -> list[Variant]:
    """Return the methods to simulate the task in Drake."""
    return [
        Variant("drake", "LeafSystem, RK2", _diagram, "Drake, LeafSystem"),
        Variant("drake", "scripted, RK2", _scripted, "Drake, scripted"),
        *(
            Variant("drake", f"scripted, discrete {step * 1e3:g} ms", partial(_scripted, time_step=step))
            for step in (1e-3, 5e-4, 1e-4)
        ),
    ]


def _vector(*numbers: float) -> Any:
    """Return an array typed loosely enough for Drake's stubs; they take a shape for a number."""
    return np.array(numbers)


def _plant(task: Task, time_step: float = 0.0) -> Any:
    """Return the flotor as a plant in world-axis velocities, continuous for a step of 0 s."""
    plant = MultibodyPlant(time_step)
    unit = UnitInertia(*(moment / task.mass for moment in task.inertia))
    body = plant.AddRigidBody("flotor", SpatialInertia(task.mass, _vector(0.0, 0.0, 0.0), unit))
    plant.AddJoint(RpyFloatingJoint("free", plant.world_frame(), body.body_frame()))
    plant.mutable_gravity_field().set_gravity_vector(_vector(0.0, 0.0, -task.gravity))
    plant.Finalize()
    return plant


def _start(task: Task) -> Array:
    """Return positions and velocities at the start."""
    # the tilt is about x alone, where roll, pitch and yaw are the rotation vector
    return np.array([*task.pose[3:], *task.pose[:3], *[0.0] * 6])


def _read(state: Any) -> list[float]:
    """Return the pose [m, rad] from the joint's state."""
    roll, pitch, yaw, x, y, z, *_ = state.tolist()
    sr, sp, sy = math.sin(0.5 * roll), math.sin(0.5 * pitch), math.sin(0.5 * yaw)
    cr, cp, cy = math.cos(0.5 * roll), math.cos(0.5 * pitch), math.cos(0.5 * yaw)
    turned = rotation_vector(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return [x, y, z, *turned]


def _simulator(system: Any, task: Task, continuous: bool = True) -> Any:
    """Return a simulator that takes one step of RK2 an interval of a continuous plant."""
    simulator: Any = Simulator(system)
    if continuous:
        ResetIntegratorFromFlags(simulator, "runge_kutta2", task.period).set_fixed_step_mode(True)
    return simulator


class _Controller(LeafSystem):  # type: ignore[misc, unused-ignore]
    """The sampled controller by periodic events: it samples, applies, and ends the pulse.

    The wrench is its state. What the law remembers stays in the object, which costs less than abstract state in the
    context.
    """

    def __init__(self, task: Task, plant: Any) -> None:
        super().__init__()
        self._task = task
        self.restart()
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareStateOutputPort("wrench", self.DeclareDiscreteState(6))  # a copy in C++, no call into Python
        self.DeclareInitializationPublishEvent(self._sample)
        self.DeclarePeriodicPublishEvent(task.period, task.period, self._sample)
        self.DeclarePeriodicDiscreteUpdateEvent(task.period, task.delay, self._apply)
        self.DeclarePeriodicDiscreteUpdateEvent(task.period, task.delay + task.pulse_width, self._end_pulse)

    def restart(self) -> None:
        """Reset the law, the force and the poses."""
        self._law = self._task.law()
        self._force: list[float] = [0.0] * 6
        self._pulse: list[float] | None = None
        self.poses: list[list[float]] = []

    def _sample(self, context: Any) -> None:
        pose = _read(self._state.Eval(context))
        self.poses.append(pose)
        self._force, self._pulse = self._law(pose)

    def _apply(self, context: Any, discrete: Any) -> None:
        wrench = self._pulse or self._force
        discrete.get_mutable_vector(0).SetFromVector(wrench[3:] + wrench[:3])

    def _end_pulse(self, context: Any, discrete: Any) -> None:
        if self._pulse:
            discrete.get_mutable_vector(0).SetFromVector(self._force[3:] + self._force[:3])


def _diagram(task: Task) -> Simulate:
    """Connect plant and controller, and simulate the diagram."""
    builder = DiagramBuilder()
    plant: Any = builder.AddSystem(_plant(task))
    controller: Any = builder.AddSystem(_Controller(task, plant))
    builder.Connect(plant.get_state_output_port(), controller.get_input_port())
    builder.Connect(controller.get_output_port(), plant.get_applied_generalized_force_input_port())
    simulator = _simulator(builder.Build(), task)
    context = simulator.get_mutable_context()
    flotor = plant.GetMyMutableContextFromRoot(context)
    commands: Any = controller.GetMyMutableContextFromRoot(context)
    start, zero, duration = _start(task), np.zeros(6), task.duration

    def run() -> Array:
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(flotor, start)
        commands.SetDiscreteState(zero)
        controller.restart()
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return np.array(controller.poses)

    return run


def _scripted(task: Task, time_step: float = 0.0) -> Simulate:
    """Advance a lone plant from switch to switch: the wrench is a fixed input between them."""
    plant = _plant(task, time_step)
    simulator = _simulator(plant, task, continuous=not time_step)
    context = simulator.get_mutable_context()
    value = plant.get_applied_generalized_force_input_port().FixValue(context, np.zeros(6))
    start, advance_to, state = _start(task), simulator.AdvanceTo, plant.GetPositionsAndVelocities
    tick, time, early = 0, 0.0, _JUST_BEFORE if time_step else 0.0

    def restart() -> None:
        nonlocal tick
        tick = 0
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(context, start)
        simulator.Initialize()

    def pose() -> list[float]:
        nonlocal tick, time
        tick, time = tick + 1, tick * task.period - early
        return _read(state(context))

    def advance(length: float, wrench: list[float]) -> None:
        nonlocal time
        value.GetMutableData().get_mutable_value().SetFromVector(wrench[3:] + wrench[:3])
        time += length
        advance_to(time)

    return closed_loop(task, restart, pose, advance)
