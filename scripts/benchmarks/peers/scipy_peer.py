"""The task with SciPy's integrators and hand-written equations.

The state has thirteen numbers: position [m], quaternion (w first), velocity in world axes [m/s] and angular velocity in
the flotor's axes [rad/s]. Its rates are computed in plain floats: at this size that costs a third of numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from scipy.integrate import ode, solve_ivp

from peers.task import Array, Intervals, Simulate, Task, Variant, closed_loop, quaternion, rotation_vector

_Rates: TypeAlias = Callable[[Array, list[float]], list[float]]

_ONE_STEP: dict[str, Any] = {"rtol": 1.0, "atol": 1.0}
_DEFAULT: dict[str, Any] = {"rtol": 1e-3, "atol": 1e-6}


def variants() -> list[Variant]:
    """Return the methods to simulate the task with SciPy."""
    table: list[tuple[str, Callable[[Task], Simulate], str]] = [
        ("solve_ivp an interval, RK45, default tolerances", _by_intervals, "SciPy, solve_ivp"),
        ("ode an interval, dopri5, one step", _ode, "SciPy, ode dopri5"),
        ("solve_ivp a period, RK45, default tolerances", partial(_periodic, options=_DEFAULT), ""),
    ]
    for step in (5e-4, 1e-4):
        options = {**_DEFAULT, "max_step": step, "first_step": step}
        table.append((f"solve_ivp a period, RK45, max_step {step * 1e3:g} ms", partial(_periodic, options=options), ""))
    return [Variant("scipy", *row) for row in table]


def _rates(task: Task) -> _Rates:
    """Return the state's rate function under a world wrench [N, N m]."""
    mass, gravity = task.mass, task.gravity
    ix, iy, iz = task.inertia

    def rates(state: Array, wrench: list[float]) -> list[float]:
        _, _, _, w, x, y, z, vx, vy, vz, p, q, r = state.tolist()
        fx, fy, fz, tx, ty, tz = wrench
        # the torque in the flotor's axes: t - 2 w (u x t) + 2 u x (u x t), u the quaternion's vector
        cx, cy, cz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
        tx, ty, tz = (
            tx - 2.0 * (w * cx - y * cz + z * cy),
            ty - 2.0 * (w * cy - z * cx + x * cz),
            tz - 2.0 * (w * cz - x * cy + y * cx),
        )
        return [
            vx,
            vy,
            vz,
            -0.5 * (x * p + y * q + z * r),
            0.5 * (w * p + y * r - z * q),
            0.5 * (w * q + z * p - x * r),
            0.5 * (w * r + x * q - y * p),
            fx / mass,
            fy / mass,
            fz / mass - gravity,
            (tx - (iz - iy) * q * r) / ix,
            (ty - (ix - iz) * r * p) / iy,
            (tz - (iy - ix) * p * q) / iz,
        ]

    return rates


def _start(task: Task) -> Array:
    return np.array([*task.offset, *quaternion(task.pose[3:]), *[0.0] * 6])


def _pose(state: Array) -> list[float]:
    x, y, z, *turned = state[:7].tolist()
    return [x, y, z, *rotation_vector(*turned)]


def _by_intervals(task: Task) -> Simulate:
    """Solve each interval under its constant wrench: no switch to step over."""
    rates, start, state = _rates(task), _start(task), _start(task)

    def restart() -> None:
        state[:] = start

    def advance(length: float, wrench: list[float]) -> None:
        solution = solve_ivp(lambda _, y: rates(y, wrench), (0.0, length), state, "RK45", t_eval=(length,), **_DEFAULT)
        state[:] = solution.y[:, -1]

    return closed_loop(task, restart, lambda: _pose(state), advance)


def _ode(task: Task) -> Simulate:
    """Solve each interval by ode, set up once; its loop is compiled."""
    rates, start, state, wrench_now = _rates(task), _start(task), _start(task), [0.0] * 6
    # a first step given need not be guessed, which costs evaluations
    solver = ode(lambda _, y: rates(y, wrench_now)).set_integrator("dopri5", first_step=task.period, **_ONE_STEP)

    def restart() -> None:
        state[:] = start

    def advance(length: float, wrench: list[float]) -> None:
        wrench_now[:] = wrench
        solver.set_initial_value(state, 0.0)
        state[:] = solver.integrate(length)

    return closed_loop(task, restart, lambda: _pose(state), advance)


def _periodic(task: Task, options: dict[str, Any]) -> Simulate:
    """Solve each period; the right-hand side selects the wrench."""
    rates, start, state = _rates(task), _start(task), _start(task)
    delay, pulse_end = task.delay, task.delay + task.pulse_width
    switches: list[list[float]] = []

    def restart() -> None:
        state[:] = start

    def switched(time: float, y: Array) -> list[float]:
        held, first, last = switches
        return rates(y, held if time < delay else first if time < pulse_end else last)

    def whole(held: list[float], force: list[float], pulse: list[float] | None) -> Intervals:
        switches[:] = held, pulse or force, force
        return [(task.period, force)]

    def advance(length: float, _: list[float]) -> None:
        state[:] = solve_ivp(switched, (0.0, length), state, t_eval=(length,), **options).y[:, -1]

    return closed_loop(task, restart, lambda: _pose(state), advance, whole)
