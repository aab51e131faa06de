"""The task with python-control: six double integrators, or the rigid body as a nonlinear system.

The linear models take the rotation vector's second derivative to be torque over moment of inertia: exact about one
axis, second order in the angle about several.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import control
import numpy as np

from peers.task import Array, Task, Variant

_Advance = Callable[[Array, float, list[float]], Array]

_ONE_STEP: dict[str, Any] = {"rtol": 1.0, "atol": 1.0}
_TIGHT: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-12}


def variants() -> list[Variant]:
    """Return the methods to simulate the task with python-control."""
    table: list[tuple[str, Callable[[Task], Callable[[], Array]], str]] = [
        ("nlsys a segment, RK45, default", partial(_nonlinear, method="RK45", options={}), "rtol 1e-3"),
        ("nlsys a segment, RK45, 1e-9", partial(_nonlinear, method="RK45", options=_TIGHT), ""),
        ("nlsys a segment, RK23, one step", partial(_nonlinear, method="RK23", options=_ONE_STEP, whole=True), ""),
        ("nlsys a segment, LSODA, default", partial(_nonlinear, method="LSODA", options={}), "rtol 1e-3"),
        ("ss, forced_response a segment", _forced, "a matrix exponential every time"),
        ("ss, sampled for each length, dynamics()", partial(_sampled, bare=False), "exact; set up once"),
        ("ss, sampled for each length, A x + B u", partial(_sampled, bare=True), "exact; the loop is numpy's"),
        ("interconnect, discrete 0.5 ms", partial(_interconnected, step=5e-4), "exact; switches on the grid"),
    ]
    return [Variant("control", name, build, note) for name, build, note in table]


def _closed_loop(task: Task, advance: _Advance) -> Callable[[], Array]:
    """Return a closed-loop run with a given segment integrator.

    It takes twelve states over a segment with a constant wrench.
    """

    def run() -> Array:
        state = np.array([*task.pose, *[0.0] * 6])
        law, held, poses = task.law(), [0.0] * 6, []
        for _ in range(task.ticks):
            pose = state[:6].tolist()
            poses.append(pose)
            force, pulse = law(pose)
            for length, wrench in task.segments(held, force, pulse):
                state = advance(state, length, wrench)
            held = force
        poses.append(state[:6].tolist())
        return np.array(poses)

    return run


def _double_integrators(task: Task) -> Any:
    """Return double integrators of pose under seven inputs.

    The wrench [N, N m], and 1 for the weight.
    """
    body = task.body
    rates, inputs = np.zeros((12, 12)), np.zeros((12, 7))
    rates[:6, 6:] = np.eye(6)
    inputs[6:, :6] = np.diag([1.0 / part for part in body])
    inputs[8, 6] = -task.gravity
    return control.ss(rates, inputs, np.eye(6, 12), np.zeros((6, 7)))


def _nonlinear(task: Task, method: str, options: dict[str, Any], whole: bool = False) -> Callable[[], Array]:
    """Respond segment by segment with an integrator of SciPy's.

    Args:
        task: The task.
        method: Integrator, as solve_ivp names it.
        options: Further arguments of solve_ivp.
        whole: Whether the first step tried is the segment.
    """
    bodies, gravity = task.body, task.gravity

    def update(_: float, state: Array, wrench: Array, __: Any) -> list[float]:
        # plain floats: at this size cheaper than numpy
        rates: list[float] = state[6:].tolist()
        rates += [part / body for part, body in zip(wrench.tolist(), bodies)]
        rates[8] -= gravity
        return rates

    # the response's outputs are the states, without a call for each
    flotor = control.nlsys(update, None, inputs=6, states=12, outputs=12)

    def advance(state: Array, length: float, wrench: list[float]) -> Array:
        held = np.array((wrench, wrench)).T
        response = control.input_output_response(
            flotor,
            (0.0, length),
            held,
            state,
            solve_ivp_method=method,
            solve_ivp_kwargs={**options, "first_step": length} if whole else options,
        )
        states: Array = response.states
        return states[:, -1]

    return _closed_loop(task, advance)


def _forced(task: Task) -> Callable[[], Array]:
    """Respond segment by segment with the matrix exponential of forced_response."""
    flotor = _double_integrators(task)

    def advance(state: Array, length: float, wrench: list[float]) -> Array:
        held = np.array(([*wrench, 1.0],) * 2).T
        states: Array = control.forced_response(flotor, (0.0, length), held, state).states
        return states[:, -1]

    return _closed_loop(task, advance)


def _sampled(task: Task, bare: bool) -> Callable[[], Array]:
    """Sample the system at each segment length, and step.

    Args:
        task: The task.
        bare: Whether the loop multiplies the matrices itself.
    """
    flotor = _double_integrators(task)
    segments = task.segments([], [], []) + task.segments([], [], None)
    systems = {length: control.sample_system(flotor, length, method="zoh") for length, _ in segments}
    matrices = {length: (system.A, system.B) for length, system in systems.items()}

    def by_system(state: Array, length: float, wrench: list[float]) -> Array:
        following: Array = systems[length].dynamics(0.0, state, [*wrench, 1.0])
        return following

    def by_matrices(state: Array, length: float, wrench: list[float]) -> Array:
        a, b = matrices[length]
        following: Array = a @ state + b @ [*wrench, 1.0]
        return following

    return _closed_loop(task, by_matrices if bare else by_system)


class _Controller:
    """The sampled controller on a grid that holds every switch.

    Its eighteen states are the wrench in effect, what follows it at the delay, and what follows that after a pulse.

    Args:
        task: The task; period, delay and pulse_width are multiples of the step.
        step: Of the grid [s].
    """

    def __init__(self, task: Task, step: float) -> None:
        self._task, self._step = task, step
        self.period, self._delay = round(task.period / step), round(task.delay / step)
        self._pulse_end = round((task.delay + task.pulse_width) / step)
        self.restart()

    def restart(self) -> None:
        """Reset to the start of a run.

        python-control calls `update` once a step, so the law may remember.
        """
        self._law = self._task.law()

    def update(self, time: float, state: Array, pose: Array, _: Any) -> Array:
        """Return the states at the next step of the grid."""
        phase = round(time / self._step) % self.period
        if phase == 0:
            force, pulse = self._law(pose.tolist())
            state = np.array([*state[:6], *(pulse or force), *force])
        if phase + 1 == self._delay:
            return np.concatenate([state[6:12], state[6:]])
        if phase + 1 == self._pulse_end:
            return np.concatenate([state[12:], state[6:]])
        return state


def _interconnected(task: Task, step: float) -> Callable[[], Array]:
    """Connect plant and controller on one grid; respond once."""
    logic = _Controller(task, step)
    poses, wrenches = [f"pose[{axis}]" for axis in range(6)], [f"wrench[{axis}]" for axis in range(6)]
    flotor = control.sample_system(_double_integrators(task), step, method="zoh")
    # signals of one name are connected
    flotor = control.ss(flotor, name="flotor", inputs=[*wrenches, "one"], outputs=poses)
    controller = control.nlsys(
        logic.update,
        lambda _, state, *__: state[:6],
        name="controller",
        inputs=poses,
        states=18,
        outputs=wrenches,
        dt=step,
    )
    loop = control.interconnect([flotor, controller], inputs=["one"], outputs=poses)
    time = np.arange(task.ticks * logic.period + 1) * step
    one, start = np.ones_like(time), [*task.pose, *[0.0] * 24]

    def run() -> Array:
        logic.restart()
        outputs: Array = control.input_output_response(loop, time, one, start).outputs
        return outputs[:, :: logic.period].T

    return run
