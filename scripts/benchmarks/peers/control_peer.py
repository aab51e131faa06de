"""The task with python-control: six double integrators, as matrices or as a nonlinear system.

They take the rotation vector's second derivative to be torque over moment of inertia: exact about one axis, second
order in the angle about several.
"""

from __future__ import annotations

from typing import Any

import control
import numpy as np

from peers.task import Array, Simulate, Task, Variant, closed_loop


def variants() -> list[Variant]:
    """Return the methods to simulate the task with python-control."""
    return [
        Variant("control", "nlsys an interval, RK23, one step", _nonlinear, "python-control, response"),
        Variant("control", "ss, sampled for each length, A x + B u", _sampled, "python-control, sampled matrices"),
    ]


def _nonlinear(task: Task) -> Simulate:
    """Respond interval by interval with an integrator of SciPy's, whose first step is the interval."""
    bodies, gravity = task.body, task.gravity
    start, states = np.array([*task.pose, *[0.0] * 6]), np.zeros(12)

    def update(_: float, state: Array, wrench: Array, __: Any) -> list[float]:
        # plain floats: at this size cheaper than numpy
        rates: list[float] = state[6:].tolist()
        rates += [part / body for part, body in zip(wrench.tolist(), bodies)]
        rates[8] -= gravity
        return rates

    # the response's outputs are the states, without a call for each
    flotor = control.nlsys(update, None, inputs=6, states=12, outputs=12)

    def restart() -> None:
        states[:] = start

    def advance(length: float, wrench: list[float]) -> None:
        held = np.array((wrench, wrench)).T
        coarse = {"rtol": 1.0, "atol": 1.0, "first_step": length}
        response = control.input_output_response(
            flotor, (0.0, length), held, states, solve_ivp_method="RK23", solve_ivp_kwargs=coarse
        )
        states[:] = response.states[:, -1]

    return closed_loop(task, restart, lambda: states[:6].tolist(), advance)


def _sampled(task: Task) -> Simulate:
    """Sample the system at each interval length, and step by the products of its matrices."""
    rates, inputs = np.zeros((12, 12)), np.zeros((12, 7))
    rates[:6, 6:] = np.eye(6)
    inputs[6:, :6] = np.diag([1.0 / part for part in task.body])
    inputs[8, 6] = -task.gravity  # a seventh input, 1, for the weight
    flotor = control.ss(rates, inputs, np.eye(6, 12), np.zeros((6, 7)))
    intervals = task.intervals([], [], []) + task.intervals([], [], None)
    systems = {length: control.sample_system(flotor, length, method="zoh") for length, _ in intervals}
    matrices = {length: (system.A, system.B) for length, system in systems.items()}
    start, states = np.array([*task.pose, *[0.0] * 6]), np.zeros(12)

    def restart() -> None:
        states[:] = start

    def advance(length: float, wrench: list[float]) -> None:
        a, b = matrices[length]
        states[:] = a @ states + b @ [*wrench, 1.0]

    return closed_loop(task, restart, lambda: states[:6].tolist(), advance)
