"""The task with SciPy's integrators and hand-written equations.

The state has thirteen numbers: position [m], quaternion (w first), velocity in world axes [m/s] and angular velocity in
the flotor's axes [rad/s]. Its rates are computed in plain floats: at this size that costs a third of numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from scipy.integrate import RK23, RK45, ode, odeint, solve_ivp

from peers.task import Array, Task, Variant, quaternion, rotation_vector

_Rates: TypeAlias = Callable[[Array, list[float]], list[float]]
_Advance: TypeAlias = Callable[[Array, float, list[float]], Array]
_Segments: TypeAlias = list[tuple[float, list[float]]]

_ONE_STEP: dict[str, Any] = {"rtol": 1.0, "atol": 1.0}
_LOOSE: dict[str, Any] = {"rtol": 1e-3, "atol": 1e-6}
_TIGHT: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-12}


def variants() -> list[Variant]:
    """Return the methods to simulate the task with SciPy."""
    table: list[tuple[str, Callable[[Task], Callable[[], Array]], str]] = []
    for method in ("RK23", "RK45", "DOP853", "LSODA"):
        for label, options in (("default tolerances", _LOOSE), ("1e-9", _TIGHT)):
            name = f"solve_ivp a segment, {method}, {label}"
            table.append((name, partial(_segmented, method=method, options=options), ""))
    for method in ("RK23", "RK45", "DOP853"):
        name = f"solve_ivp a segment, {method}, one step"
        table.append((name, partial(_segmented, method=method, options=_ONE_STEP, whole=True), "tolerance of 1"))
    table += [
        ("RK23 stepper a segment, one step", partial(_stepper, method=RK23), "the class behind solve_ivp"),
        ("RK45 stepper a segment, one step", partial(_stepper, method=RK45), "the class behind solve_ivp"),
        ("odeint a segment, 1e-9", partial(_odeint, options=_TIGHT), "LSODA in one call"),
        ("ode a segment, dopri5, one step", partial(_ode, options=_ONE_STEP), "loop in compiled code"),
        ("ode a segment, dopri5, 1e-9", partial(_ode, options=_TIGHT), "loop in compiled code"),
        ("solve_ivp a period, RK45, 1e-3", partial(_periodic, options=_LOOSE), "switches inside the right-hand side"),
        ("solve_ivp a period, RK45, 1e-9", partial(_periodic, options=_TIGHT), "switches inside the right-hand side"),
        ("solve_ivp a period, RK45, max_step 0.5 ms", partial(_periodic, options=_grid(5e-4)), "switches on the grid"),
        ("solve_ivp a period, RK45, max_step 0.1 ms", partial(_periodic, options=_grid(1e-4)), "switches on the grid"),
        ("solve_ivp with events, RK45, 1e-9", partial(_eventful, options=_TIGHT), "each switch a terminal event"),
        ("solve_ivp with events, RK23, one step", partial(_eventful, options=_ONE_STEP, method="RK23"), ""),
    ]
    return [Variant("scipy", name, build, note) for name, build, note in table]


def _grid(step: float) -> dict[str, Any]:
    return {**_LOOSE, "max_step": step, "first_step": step}


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


def _closed_loop(task: Task, period: Callable[[Array, _Segments], Array]) -> Callable[[], Array]:
    """Return a closed-loop run with a given period integrator."""

    def run() -> Array:
        state = np.array([*task.offset, *quaternion(task.pose[3:]), *[0.0] * 6])
        law, held, poses = task.law(), [0.0] * 6, []
        for _ in range(task.ticks):
            pose = _pose(state)
            poses.append(pose)
            force, pulse = law(pose)
            state = period(state, task.segments(held, force, pulse))
            held = force
        poses.append(_pose(state))
        return np.array(poses)

    return run


def _pose(state: Array) -> list[float]:
    x, y, z, *turned = state[:7].tolist()
    return [x, y, z, *rotation_vector(*turned)]


def _each(advance: _Advance) -> Callable[[Array, _Segments], Array]:
    """Return a period integrator from a segment integrator."""

    def period(state: Array, segments: _Segments) -> Array:
        for length, wrench in segments:
            state = advance(state, length, wrench)
        return state

    return period


def _segmented(task: Task, method: str, options: dict[str, Any], whole: bool = False) -> Callable[[], Array]:
    """Solve each segment on its own, with a constant wrench.

    There is no switch to step over.

    Args:
        task: The task.
        method: Of solve_ivp.
        options: Further arguments of solve_ivp.
        whole: Whether the first step tried is the segment.
    """
    rates = _rates(task)

    def advance(state: Array, length: float, wrench: list[float]) -> Array:
        first = length if whole else None
        solution = solve_ivp(
            lambda _, y: rates(y, wrench), (0.0, length), state, method, t_eval=(length,), first_step=first, **options
        )
        states: Array = solution.y
        return states[:, -1]

    return _closed_loop(task, _each(advance))


def _stepper(task: Task, method: Any) -> Callable[[], Array]:
    """Step a solver class by segment, without solve_ivp's overhead."""
    rates = _rates(task)

    def advance(state: Array, length: float, wrench: list[float]) -> Array:
        solver = method(lambda _, y: rates(y, wrench), 0.0, state, length, first_step=length, **_ONE_STEP)
        while solver.status == "running":
            solver.step()
        state = solver.y
        return state

    return _closed_loop(task, _each(advance))


def _odeint(task: Task, options: dict[str, Any]) -> Callable[[], Array]:
    """Solve each segment by odeint, whose loop is compiled."""
    rates = _rates(task)

    def advance(state: Array, length: float, wrench: list[float]) -> Array:
        states: Array = odeint(lambda y, _: rates(y, wrench), state, (0.0, length), **options)
        return states[-1]  # type: ignore[no-any-return]

    return _closed_loop(task, _each(advance))


def _ode(task: Task, options: dict[str, Any]) -> Callable[[], Array]:
    """Solve each segment by ode, set up once; its loop is compiled."""
    rates = _rates(task)
    wrench_now = [0.0] * 6
    # a first step given need not be guessed, which costs evaluations
    solver = ode(lambda _, y: rates(y, wrench_now)).set_integrator("dopri5", first_step=task.period, **options)

    def advance(state: Array, length: float, wrench: list[float]) -> Array:
        wrench_now[:] = wrench
        solver.set_initial_value(state, 0.0)
        state = solver.integrate(length)
        return state

    return _closed_loop(task, _each(advance))


def _periodic(task: Task, options: dict[str, Any]) -> Callable[[], Array]:
    """Solve each period; the right-hand side selects the wrench."""
    rates = _rates(task)
    delay, pulse_end, length = task.delay, task.delay + task.pulse_width, task.period

    def period(state: Array, segments: _Segments) -> Array:
        held, first, last = segments[0][1], segments[1][1], segments[-1][1]

        def switched(time: float, y: Array) -> list[float]:
            return rates(y, held if time < delay else first if time < pulse_end else last)

        states: Array = solve_ivp(switched, (0.0, length), state, t_eval=(length,), **options).y
        return states[:, -1]

    return _closed_loop(task, period)


def _eventful(task: Task, options: dict[str, Any], method: str = "RK45") -> Callable[[], Array]:
    """Solve to the end, stopped by an event each switch."""
    rates = _rates(task)

    def advance(state: Array, length: float, wrench: list[float]) -> Array:
        def switch(time: float, _: Array) -> float:
            return time - length

        switch.terminal = True  # type: ignore[attr-defined]
        solution = solve_ivp(
            lambda _, y: rates(y, wrench), (0.0, task.duration), state, method, events=switch, **options
        )
        state = solution.y_events[0][0]
        return state

    return _closed_loop(task, _each(advance))
