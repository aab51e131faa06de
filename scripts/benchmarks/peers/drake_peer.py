"""The task in Drake: a MultibodyPlant and a Python controller.

Two methods to close the loop: a LeafSystem with periodic events in a diagram, or a script that advances the simulator
from switch to switch of the wrench.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import QuaternionFloatingJoint, RpyFloatingJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from peers.task import Array, Task, Variant, quaternion, rotation_vector

# An update of a discrete plant belongs after the switch at the same time; rounding must not decide which comes first.
_JUST_BEFORE = 1e-9


@dataclass(frozen=True, kw_only=True)
class _Choice:
    """Choices of a Drake user.

    Attributes:
        scheme: Integration scheme; "" for the simulator's own.
        max_step: Longest step of the integrator [s]; switches of the wrench cut it.
        accuracy: Target of the error control; None for fixed steps.
        time_step: Step of a discrete plant [s]; 0 for a continuous one.
        roll_pitch_yaw: Whether the joint's coordinates are angles rather than a quaternion.
        spatial: Whether the wrench enters at the port for spatial forces rather than that for generalised ones.
        corrected: Whether the known offset of a discrete plant's pose is taken off.
    """

    scheme: str = ""
    max_step: float = 0.005
    accuracy: float | None = None
    time_step: float = 0.0
    roll_pitch_yaw: bool = True
    spatial: bool = False
    corrected: bool = False


def variants() -> list[Variant]:
    """Return the methods to simulate the task in Drake."""
    rk2 = _Choice(scheme="runge_kutta2")
    rk3 = _Choice(scheme="runge_kutta3", roll_pitch_yaw=False)
    careful = _Choice(scheme="runge_kutta3", accuracy=1e-9, roll_pitch_yaw=False)
    table: list[tuple[str, Callable[..., Callable[[], Array]], _Choice, str]] = [
        ("LeafSystem, RK2", _diagram, rk2, "one step a segment; roll-pitch-yaw joint"),
        ("LeafSystem, RK2, quaternion", _diagram, _Choice(scheme="runge_kutta2", roll_pitch_yaw=False), ""),
        ("LeafSystem, RK2, spatial-force port", _diagram, _Choice(scheme="runge_kutta2", spatial=True), "dearer port"),
        ("LeafSystem, RK3", _diagram, rk3, "one step a segment; quaternion joint"),
        ("LeafSystem, RK3, accuracy 1e-9", _diagram, careful, "error controlled"),
        (
            "LeafSystem, default integrator",
            _diagram,
            _Choice(roll_pitch_yaw=False),
            "RK3, error controlled as Drake sets it up",
        ),
        ("LeafSystem, discrete 0.5 ms", _diagram, _Choice(time_step=5e-4, roll_pitch_yaw=False), ""),
        ("LeafSystem, discrete 0.1 ms", _diagram, _Choice(time_step=1e-4, roll_pitch_yaw=False), ""),
        ("scripted, RK2", _scripted, rk2, "one step a segment; roll-pitch-yaw joint"),
        ("scripted, RK2, spatial-force port", _scripted, _Choice(scheme="runge_kutta2", spatial=True), "dearer port"),
        ("scripted, RK3", _scripted, rk3, "one step a segment; quaternion joint"),
        ("scripted, RK5", _scripted, _Choice(scheme="runge_kutta5", roll_pitch_yaw=False), ""),
        ("scripted, Euler 0.5 ms", _scripted, _Choice(scheme="explicit_euler", max_step=5e-4), ""),
        ("scripted, Euler 0.1 ms", _scripted, _Choice(scheme="explicit_euler", max_step=1e-4), ""),
        ("scripted, discrete 1 ms", _scripted, _Choice(time_step=1e-3), "switches at 1.5 ms fall between steps"),
        ("scripted, discrete 0.5 ms", _scripted, _Choice(time_step=5e-4), ""),
        ("scripted, discrete 0.1 ms", _scripted, _Choice(time_step=1e-4), ""),
        ("scripted, discrete 0.5 ms, corrected", _scripted, _Choice(time_step=5e-4, corrected=True), "pose - h/2 v"),
    ]
    return [Variant("drake", name, partial(build, choice=choice), note) for name, build, choice, note in table]


def _vector(*numbers: float) -> Any:
    """Return an array typed loosely enough for Drake's stubs; they take a shape for a number."""
    return np.array(numbers)


def _plant(task: Task, choice: _Choice) -> Any:
    """Return the flotor as a plant in world-axis velocities."""
    plant = MultibodyPlant(choice.time_step)
    unit = UnitInertia(*(moment / task.mass for moment in task.inertia))
    body = plant.AddRigidBody("flotor", SpatialInertia(task.mass, _vector(0.0, 0.0, 0.0), unit))
    joint = RpyFloatingJoint if choice.roll_pitch_yaw else QuaternionFloatingJoint
    plant.AddJoint(joint("free", plant.world_frame(), body.body_frame()))
    plant.mutable_gravity_field().set_gravity_vector(_vector(0.0, 0.0, -task.gravity))
    plant.Finalize()
    return plant


def _start(task: Task, choice: _Choice) -> Array:
    """Return positions and velocities at the start."""
    rotation = task.pose[3:]
    # the tilt is about x alone, where roll, pitch and yaw are the rotation vector
    turned = rotation if choice.roll_pitch_yaw else quaternion(rotation)
    return np.array([*turned, *task.pose[:3], *[0.0] * 6])


def _read(state: Any, choice: _Choice) -> list[float]:
    """Return the pose [m, rad] from the joint's state."""
    if not choice.roll_pitch_yaw:
        w, qx, qy, qz, x, y, z, *_ = state.tolist()
        return [x, y, z, *rotation_vector(w, qx, qy, qz)]
    roll, pitch, yaw, x, y, z, *velocity = state.tolist()
    sr, sp, sy = math.sin(0.5 * roll), math.sin(0.5 * pitch), math.sin(0.5 * yaw)
    cr, cp, cy = math.cos(0.5 * roll), math.cos(0.5 * pitch), math.cos(0.5 * yaw)
    turned = rotation_vector(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    pose = [x, y, z, *turned]
    if not choice.corrected:
        return pose
    # semi-implicit Euler from rest is ahead by exactly half a step of the velocity, whatever the forces were
    half = 0.5 * choice.time_step
    wx, wy, wz, vx, vy, vz = velocity
    return [part - half * speed for part, speed in zip(pose, (vx, vy, vz, wx, wy, wz))]


def _simulator(system: Any, choice: _Choice) -> Any:
    simulator: Any = Simulator(system)
    if choice.scheme:
        integrator = ResetIntegratorFromFlags(simulator, choice.scheme, choice.max_step)
        if choice.accuracy is None:
            integrator.set_fixed_step_mode(True)
        else:
            integrator.set_target_accuracy(choice.accuracy)
    return simulator


def _applied(plant: Any) -> Any:
    """Return an empty spatial force at the flotor's centre."""
    applied = ExternallyAppliedSpatialForce()
    applied.body_index = plant.GetBodyByName("flotor").index()
    applied.p_BoBq_B = _vector(0.0, 0.0, 0.0)
    return applied


class _Controller(LeafSystem):  # type: ignore[misc, unused-ignore]
    """The sampled controller by periodic events.

    It samples, applies, and ends the pulse; the wrench is its state.

    What the law remembers stays in the object, which costs less than abstract state in the context.
    """

    def __init__(self, task: Task, choice: _Choice, plant: Any) -> None:
        super().__init__()
        self._task, self._choice = task, choice
        self._force_on_body = _applied(plant)
        self.restart()
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        wrench = self.DeclareDiscreteState(6)
        if choice.spatial:
            self.DeclareAbstractOutputPort(
                "forces", lambda: AbstractValue.Make([_applied(plant)]), self._forces, {self.xd_ticket()}
            )
        else:
            self.DeclareStateOutputPort("wrench", wrench)  # a copy in C++, without a call into Python
        # a discrete plant's state belongs to its next update: half a step early is on the safe side of rounding
        early = 0.5 * choice.time_step
        self.DeclareInitializationPublishEvent(self._sample)
        self.DeclarePeriodicPublishEvent(task.period, task.period - early, self._sample)
        self.DeclarePeriodicDiscreteUpdateEvent(task.period, task.delay - early, self._apply)
        self.DeclarePeriodicDiscreteUpdateEvent(task.period, task.delay + task.pulse_width - early, self._end_pulse)

    def restart(self) -> None:
        """Reset the law, the force and the poses."""
        self._law = self._task.law()
        self._force: list[float] = [0.0] * 6
        self._pulse: list[float] | None = None
        self.poses: list[list[float]] = []

    def _sample(self, context: Any) -> None:
        pose = _read(self._state.Eval(context), self._choice)
        self.poses.append(pose)
        self._force, self._pulse = self._law(pose)

    def _apply(self, context: Any, discrete: Any) -> None:
        wrench = self._pulse or self._force
        discrete.get_mutable_vector(0).SetFromVector(wrench[3:] + wrench[:3])

    def _end_pulse(self, context: Any, discrete: Any) -> None:
        if self._pulse:
            discrete.get_mutable_vector(0).SetFromVector(self._force[3:] + self._force[:3])

    def _forces(self, context: Any, output: Any) -> None:
        self._force_on_body.F_Bq_W = SpatialForce(context.get_discrete_state_vector().value())
        output.set_value([self._force_on_body])


def _diagram(task: Task, choice: _Choice) -> Callable[[], Array]:
    """Connect plant and controller, and simulate the diagram."""
    builder = DiagramBuilder()
    plant: Any = builder.AddSystem(_plant(task, choice))
    controller: Any = builder.AddSystem(_Controller(task, choice, plant))
    builder.Connect(plant.get_state_output_port(), controller.get_input_port())
    if choice.spatial:
        builder.Connect(controller.get_output_port(), plant.get_applied_spatial_force_input_port())
    else:
        builder.Connect(controller.get_output_port(), plant.get_applied_generalized_force_input_port())
    simulator = _simulator(builder.Build(), choice)
    context = simulator.get_mutable_context()
    flotor = plant.GetMyMutableContextFromRoot(context)
    commands: Any = controller.GetMyMutableContextFromRoot(context)
    start, zero, duration = _start(task, choice), np.zeros(6), task.duration

    def run() -> Array:
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(flotor, start)
        commands.SetDiscreteState(zero)
        controller.restart()
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return np.array(controller.poses)

    return run


def _input(plant: Any, context: Any, choice: _Choice) -> Callable[[list[float]], None]:
    """Fix the plant's input port; return its setter."""
    if not choice.spatial:
        value = plant.get_applied_generalized_force_input_port().FixValue(context, np.zeros(6))

        def generalised(wrench: list[float]) -> None:
            value.GetMutableData().get_mutable_value().SetFromVector(wrench[3:] + wrench[:3])

        return generalised
    applied = _applied(plant)
    forces = plant.get_applied_spatial_force_input_port().FixValue(context, [applied])

    def spatial(wrench: list[float]) -> None:
        applied.F_Bq_W = SpatialForce(_vector(*wrench[3:], *wrench[:3]))
        forces.GetMutableData().set_value([applied])

    return spatial


def _scripted(task: Task, choice: _Choice) -> Callable[[], Array]:
    """Advance a lone plant from switch to switch: the wrench is a fixed input between them."""
    plant = _plant(task, choice)
    simulator = _simulator(plant, choice)
    context = simulator.get_mutable_context()
    apply = _input(plant, context, choice)
    start, advance, state = _start(task, choice), simulator.AdvanceTo, plant.GetPositionsAndVelocities
    early = _JUST_BEFORE if choice.time_step else 0.0

    def run() -> Array:
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(context, start)
        simulator.Initialize()
        law, held, poses = task.law(), [0.0] * 6, []
        for tick in range(task.ticks):
            time = tick * task.period - early
            pose = _read(state(context), choice)
            poses.append(pose)
            force, pulse = law(pose)
            for length, wrench in task.segments(held, force, pulse):
                apply(wrench)
                time += length
                advance(time)
            held = force
        poses.append(_read(state(context), choice))
        return np.array(poses)

    return run
