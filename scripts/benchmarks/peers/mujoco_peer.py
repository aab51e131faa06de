"""The task in bare MuJoCo: a loop over mj_step.

Steps end on a grid of their own, each under the wrench that is in effect at its start, or at every switch of the
wrench, which is then constant within a step; or the engine itself sees to the timing, by its control callback or the
delay of its actuators.

Under a constant force RK4 is exact. The other integrators are semi-implicit, and each of their steps goes h/2 dv too
far: who knows takes it off, where a pose is read or after each step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np

from peers.mujoco_flotor import INTEGRATORS, SEMI_IMPLICIT, Flotor, turned_back
from peers.task import Array, Task, Variant, rotation_vector

_STEPS = (5e-3, 1e-3, 5e-4, 1e-4, 1e-5)
_NOTES = {
    5e-3: "a whole period: a command waits for the next sample, a pulse is over before it is seen",
    1e-3: "switches at 1.5 ms fall between steps",
}


def variants() -> list[Variant]:
    """Return the methods to simulate the task in MuJoCo."""
    return [*_on_a_grid(), *_at_switches(), *_timed_by_engine()]


def _variant(name: str, build: Callable[[Task], Callable[[], Array]], note: str = "") -> Variant:
    return Variant("mujoco", name, build, note)


def _grid(integrator: str, step: float, corrected: bool = False) -> Variant:
    name = f"{integrator}, steps of {step * 1e3:g} ms" + ", corrected" * corrected
    note = "pose - h/2 v" if corrected else _NOTES.get(step, "")
    return _variant(name, partial(_stepped, integrator=integrator, step=step, corrected=corrected), note)


def _on_a_grid() -> list[Variant]:
    raw = [_grid(integrator, step) for integrator in INTEGRATORS for step in _STEPS]
    return raw + [_grid(integrator, step, corrected=True) for integrator in SEMI_IMPLICIT for step in (5e-4, 1e-4)]


def _at_switches() -> list[Variant]:
    kicked = "less h/2 dv a step"
    table = [_variant(f"split, {name}", partial(_split, integrator=name), "raw positions") for name in SEMI_IMPLICIT]
    table.append(_variant("split, RK4", partial(_split, integrator="RK4")))
    table.append(_variant("split, Euler, half-kick", _half_kicked, kicked))
    for joints in ("slides and ball", "z alone"):
        note = "one degree of freedom" if joints == "z alone" else ""
        table.append(_variant(f"split, RK4, {joints}", partial(_split, integrator="RK4", joints=joints), note))
        table.append(_variant(f"split, Euler, half-kick, {joints}", partial(_half_kicked, joints=joints), kicked))
    return table


def _timed_by_engine() -> list[Variant]:
    # the last substage is at the end of the step, where a sample or a command may be due that belongs to the next step
    ahead = "the last substage sees what is due at the end of the step"
    table = []
    for integrator, step in (("Euler", 5e-4), ("Euler", 1e-4), ("RK4", 5e-4)):
        name = f"callback, {integrator}, steps of {step * 1e3:g} ms"
        build = partial(_called_back, integrator=integrator, step=step)
        table.append(_variant(name, build, ahead * (integrator == "RK4")))
    for integrator in ("Euler", "RK4"):
        name = f"native delay, {integrator}, steps of 0.5 ms"
        build = partial(_delayed, integrator=integrator, step=5e-4)
        table.append(_variant(name, build, ahead * (integrator == "RK4")))
    return table


def _steps_in(duration: float, step: float) -> int:
    """Return the number of steps begun before a time, rounding aside."""
    return math.ceil(duration / step - 1e-9)


def _stepped(task: Task, integrator: str, step: float, corrected: bool = False) -> Callable[[], Array]:
    """Step on a fixed grid, counting steps.

    A command is first seen by the step that begins as it takes effect, or next.

    Args:
        task: The task.
        integrator: Name of the integrator.
        step: Time step [s].
        corrected: Whether poses are read half a step's motion back, where they lie from rest.
    """
    flotor = Flotor(task, integrator, step)
    step_on, push = flotor.step, flotor.push
    pose = partial(_half_step_back, flotor, 0.5 * step) if corrected else flotor.pose
    delay = _steps_in(task.delay, step)
    pulsed = _steps_in(task.delay + task.pulse_width, step) - delay
    steps = round(task.period / step)
    left, rest = steps - delay, steps - delay - pulsed

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
            step_on(rest if pulse else left)
        poses.append(pose())
        return np.array(poses)

    return run


def _half_step_back(flotor: Flotor, half: float) -> list[float]:
    x, y, z, qw, qx, qy, qz = flotor.position()
    u, v, w, p, q, r = flotor.velocity()
    turned = turned_back(qw, qx, qy, qz, half * p, half * q, half * r)
    return [x - half * u, y - half * v, z - half * w, *rotation_vector(*turned)]


def _split(task: Task, integrator: str, joints: str = "free") -> Callable[[], Array]:
    """Take one step from switch to switch of the wrench.

    The positions are taken as they come.
    """
    flotor = Flotor(task, integrator, joints=joints)
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
        return _simulated(poses, joints)

    return run


def _half_kicked(task: Task, joints: str = "free") -> Callable[[], Array]:
    """Step as `_split` by Euler, corrected at the end.

    Each step's error is taken off, since nothing reads the state before the period is over.
    """
    flotor = Flotor(task, "Euler", joints=joints)
    step, push, options, acceleration = flotor.step, flotor.push, flotor.options, flotor.acceleration
    settle = partial(_slide_settled if joints == "z alone" else _settled, flotor)
    delay, width, left = task.delay, task.pulse_width, task.period - task.delay
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
        return _simulated(poses, joints)

    return run


def _settled(flotor: Flotor, h: float, a: list[float], k: float, b: list[float]) -> list[float]:
    """Correct a free body's pose, by h a + k b."""
    x, y, z, qw, qx, qy, qz = flotor.position()
    ax, ay, az, ap, aq, ar = a
    bx, by, bz, bp, bq, br = b
    x, y, z = x - h * ax - k * bx, y - h * ay - k * by, z - h * az - k * bz
    turned = turned_back(qw, qx, qy, qz, h * ap + k * bp, h * aq + k * bq, h * ar + k * br)
    flotor.put(x, y, z, *turned)
    return [x, y, z, *rotation_vector(*turned)]


def _slide_settled(flotor: Flotor, h: float, a: list[float], k: float, b: list[float]) -> list[float]:
    """Correct a slide's pose by h a + k b."""
    flotor.put(flotor.position()[0] - h * a[0] - k * b[0])
    return flotor.pose()


def _simulated(poses: list[list[float]], joints: str) -> Array:
    """Return poses, NaN for axes that a model lacks."""
    table = np.array(poses)
    if joints == "z alone":
        table[:, [0, 1, 3, 4, 5]] = math.nan
    return table


def _called_back(task: Task, integrator: str, step: float) -> Callable[[], Array]:
    """Run the controller in the engine's control callback; it looks at the clock."""
    flotor = Flotor(task, integrator, step, actuation=True)
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


def _delayed(task: Task, integrator: str, step: float) -> Callable[[], Array]:
    """Set controls when sampled; six delayed motors apply them."""
    delay = f'delay="{task.delay!r}" nsample="{_steps_in(task.delay, step)}"'
    gears = [" ".join("1" if axis == other else "0" for other in range(6)) for axis in range(6)]
    # in the parent: force and torque in world axes
    motors = "".join(f'<motor jointinparent="free" gear="{gear}" {delay}/>' for gear in gears)
    flotor = Flotor(task, integrator, step, actuation=True, actuators=motors)
    pose, step_on, control = flotor.pose, flotor.step, flotor.control
    pulsed, steps = _steps_in(task.pulse_width, step), round(task.period / step)

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
