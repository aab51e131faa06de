"""The task in bare MuJoCo: a loop over mj_step.

Steps end on a grid of their own, each under the wrench that is in effect at its start, or at every switch of the
wrench, which is then constant within a step; or the engine itself sees to the timing, by its control callback or the
delay of its actuators.

Under a constant force RK4 is exact. The other integrators are semi-implicit, and each of their steps goes h/2 dv too
far: who knows takes it off after each.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np

from peers.task import Array, Simulate, Task, Variant, quaternion, rotation_vector, steps_in

_STEPS = (5e-3, 1e-3, 5e-4, 1e-4, 1e-5)

_MODEL = """
<mujoco>
  <option integrator="{integrator}" timestep="{step!r}" gravity="0 0 {gravity!r}">
    <flag contact="disable" constraint="disable" autoreset="disable" sensor="disable" spring="disable"
      damper="disable" island="disable" midphase="disable" warmstart="disable" actuation="{actuation}"/>
  </option>
  <worldbody>
    <body>
      <inertial pos="0 0 0" mass="{mass!r}" diaginertia="{inertia}"/>
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="ball" type="ball"/>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""


def variants() -> list[Variant]:
    """Return the methods to simulate the task in MuJoCo."""
    grid = [("Euler", step) for step in _STEPS] + [("RK4", 5e-4)]
    table: list[tuple[str, Callable[[Task], Simulate], str]] = [
        (f"{integrator}, steps of {step * 1e3:g} ms", partial(_stepped, integrator=integrator, step=step), "")
        for integrator, step in grid
    ]
    table += [
        ("split, RK4", _split, "MuJoCo by hand, RK4"),
        ("split, Euler, half-kick", _half_kicked, "MuJoCo by hand, half-kick"),
        # the last substage sees what is due at the end of the step, and belongs to the next
        ("callback, RK4, steps of 0.5 ms", partial(_called_back, integrator="RK4", step=5e-4), ""),
        ("native delay, RK4, steps of 0.5 ms", partial(_delayed, integrator="RK4", step=5e-4), ""),
    ]
    return [Variant("mujoco", *row) for row in table]


class _Flotor:
    """The flotor, a body with nothing to collide with, and cheap access to its numbers.

    Attributes:
        options: Options of the model.
        step: Takes a step, or as many as it is told.
        push: Sets the wrench on the flotor, in world axes, six numbers.
        control: Sets the controls of the actuators.
        position: Reads the generalised position.
        acceleration: Reads the generalised acceleration in the last step: of a turning body in its own axes.
        put: Sets the generalised position.

    Args:
        task: The task.
        integrator: Of the engine.
        step: Time step at the start [s].
        actuation: Whether actuators and the control callback work.
        actuators: MJCF elements.
    """

    def __init__(
        self, task: Task, integrator: str, step: float = 1e-3, *, actuation: bool = False, actuators: str = ""
    ) -> None:
        text = _MODEL.format(
            integrator=integrator,
            step=step,
            gravity=-task.gravity,
            actuation="enable" if actuation else "disable",
            mass=task.mass,
            inertia=" ".join(map(repr, task.inertia)),
            actuators=actuators,
        )
        self._model = model = mujoco.MjModel.from_xml_string(text)
        self._data = data = mujoco.MjData(model)
        self.options = model.opt
        self.step = partial(mujoco.mj_step, model, data)
        # live views of the engine's memory: a slice through `data` at each step costs several times as much
        self.push = partial(struct.Struct("6d").pack_into, data.xfrc_applied[1].data, 0)
        self.control = partial(struct.Struct(f"{model.nu}d").pack_into, data.ctrl.data, 0)
        self.put = partial(struct.Struct("7d").pack_into, data.qpos.data, 0)
        self.position: Callable[[], list[float]] = data.qpos.tolist
        self.acceleration: Callable[[], list[float]] = data.qacc.tolist
        self._start = task.pose[:3] + quaternion(task.pose[3:])

    def reset(self) -> None:
        """Return the flotor to its start, at rest, without wrench."""
        mujoco.mj_resetData(self._model, self._data)
        self.put(*self._start)

    def pose(self) -> list[float]:
        """Return the pose [m, rad]."""
        x, y, z, qw, qx, qy, qz = self.position()
        return [x, y, z, *rotation_vector(qw, qx, qy, qz)]

    def settle(self, h: float, a: list[float], k: float, b: list[float]) -> list[float]:
        """Correct the pose by h a + k b of two accelerations, and return it."""
        x, y, z, qw, qx, qy, qz = self.position()
        ax, ay, az, ap, aq, ar = a
        bx, by, bz, bp, bq, br = b
        x, y, z = x - h * ax - k * bx, y - h * ay - k * by, z - h * az - k * bz
        turned = _turned_back(qw, qx, qy, qz, h * ap + k * bp, h * aq + k * bq, h * ar + k * br)
        self.put(x, y, z, *turned)
        return [x, y, z, *rotation_vector(*turned)]


def _turned_back(
    qw: float, qx: float, qy: float, qz: float, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Return a quaternion turned back by a small rotation vector [rad] in body axes."""
    square = x * x + y * y + z * z
    w = 1.0 - 0.125 * square  # to the fourth order of the angle, far below rounding here
    scale = square / 48.0 - 0.5
    x, y, z = scale * x, scale * y, scale * z
    return (
        qw * w - qx * x - qy * y - qz * z,
        qw * x + qx * w + qy * z - qz * y,
        qw * y - qx * z + qy * w + qz * x,
        qw * z + qx * y - qy * x + qz * w,
    )


def _stepped(task: Task, integrator: str, step: float) -> Simulate:
    """Step on a fixed grid; a command waits for the next step."""
    flotor = _Flotor(task, integrator, step)
    step_on, push, pose = flotor.step, flotor.push, flotor.pose
    delay = steps_in(task.delay, step)
    pulsed = steps_in(task.delay + task.pulse_width, step) - delay
    left = round(task.period / step) - delay

    def run() -> Array:
        flotor.reset()
        law, poses = task.law(), []
        for _ in range(task.ticks):
            seen = pose()
            poses.append(seen)
            force, pulse = law(seen)
            step_on(delay)
            if pulse:
                push(*pulse)
                step_on(pulsed)
            push(*force)
            step_on(left - pulsed if pulse else left)
        poses.append(pose())
        return np.array(poses)

    return run


def _split(task: Task) -> Simulate:
    """Take one step of RK4 from switch to switch of the wrench."""
    flotor = _Flotor(task, "RK4")
    step, push, pose, options = flotor.step, flotor.push, flotor.pose, flotor.options
    delay, width, left = task.delay, task.pulse_width, task.period - task.delay
    rest = left - width

    def run() -> Array:
        flotor.reset()
        law, poses = task.law(), []
        for _ in range(task.ticks):
            seen = pose()
            poses.append(seen)
            force, pulse = law(seen)
            options.timestep = delay
            step()
            if pulse:
                push(*pulse)
                options.timestep = width
                step()
            push(*force)
            options.timestep = rest if pulse else left
            step()
        poses.append(pose())
        return np.array(poses)

    return run


def _half_kicked(task: Task) -> Simulate:
    """Step as `_split` by Euler, corrected at the end.

    Each step's error is taken off, since nothing reads the state before the period is over.
    """
    flotor = _Flotor(task, "Euler")
    step, push, options, acceleration = flotor.step, flotor.push, flotor.options, flotor.acceleration
    settle, delay, width, left = flotor.settle, task.delay, task.pulse_width, task.period - task.delay
    rest = left - width
    # half a step times what the velocity changed by, which is the step times the acceleration
    in_delay, in_width, in_left, in_rest = (0.5 * length**2 for length in (delay, width, left, rest))

    def run() -> Array:
        flotor.reset()
        law, seen = task.law(), flotor.pose()
        poses = [seen]
        for _ in range(task.ticks):
            force, pulse = law(seen)
            options.timestep = delay
            step()
            before = acceleration()
            if pulse:
                push(*pulse)
                options.timestep = width
                step()
                settle(in_delay, before, in_width, acceleration())
            push(*force)
            options.timestep = rest if pulse else left
            step()
            if pulse:
                seen = settle(in_rest, acceleration(), 0.0, before)
            else:
                seen = settle(in_delay, before, in_left, acceleration())
            poses.append(seen)
        return np.array(poses)

    return run


def _called_back(task: Task, integrator: str, step: float) -> Simulate:
    """Run the controller in the engine's control callback; it looks at the clock."""
    flotor = _Flotor(task, integrator, step, actuation=True)
    pose, push = flotor.pose, flotor.push
    steps = round(task.duration / step)

    def run() -> Array:
        flotor.reset()
        law = task.law()
        poses: list[list[float]] = []
        due: list[tuple[float, list[float]]] = []
        sample = 0.0

        def control(_: Any, data: Any) -> None:
            nonlocal sample
            now = data.time + 1e-9  # the clock adds up its steps, and may fall short by rounding
            if now >= sample and len(poses) < task.ticks:
                seen = pose()
                poses.append(seen)
                force, pulse = law(seen)
                starts = sample + task.delay
                due.append((starts, pulse or force))
                if pulse:
                    due.append((starts + task.pulse_width, force))
                sample = len(poses) * task.period
            while due and now >= due[0][0]:
                push(*due.pop(0)[1])

        mujoco.set_mjcb_control(control)
        try:
            flotor.step(steps)
        finally:
            mujoco.set_mjcb_control(None)
        poses.append(pose())
        return np.array(poses)

    return run


def _delayed(task: Task, integrator: str, step: float) -> Simulate:
    """Set controls when sampled; six delayed motors apply them."""
    delay = f'delay="{task.delay!r}" nsample="{steps_in(task.delay, step)}"'
    motors = "".join(f'<motor joint="{axis}" {delay}/>' for axis in "xyz")
    # in the parent: torque in world axes
    motors += "".join(f'<motor jointinparent="ball" gear="{gear}" {delay}/>' for gear in ("1 0 0", "0 1 0", "0 0 1"))
    flotor = _Flotor(task, integrator, step, actuation=True, actuators=motors)
    pose, step_on, control = flotor.pose, flotor.step, flotor.control
    pulsed, steps = steps_in(task.pulse_width, step), round(task.period / step)

    def run() -> Array:
        flotor.reset()
        law, poses = task.law(), []
        for _ in range(task.ticks):
            seen = pose()
            poses.append(seen)
            force, pulse = law(seen)
            if pulse:
                control(*pulse)
                step_on(pulsed)
            control(*force)
            step_on(steps - pulsed if pulse else steps)
        poses.append(pose())
        return np.array(poses)

    return run
