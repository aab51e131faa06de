"""The drop with this package and with the best variants of other simulators.

`measure` is a section of bench.py. Every method runs in turn, so that costs are compared pair by pair.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np

from maglev_mj import ExactPlant, MuJoCoPlant, Timing, drive
from maglev_mj.device import published_device
from maglev_mj.plants import stop_profiler
from maglev_mj.scenes.wall_scene import wall_controller
from maglev_mj.studies.levels import apart
from peers import Simulate, Task, available
from timing import Run, columns, medians, ratio, timed

OURS: dict[str, Callable[..., Any]] = {
    "this package, corrected": partial(MuJoCoPlant, integrator="corrected", coils=False),
    "this package, RK4": partial(MuJoCoPlant, coils=False),
    "this package, exact plant": ExactPlant,
}
"""This package's plants by table name, the reference first."""

_TURNS, _DEAR_TURNS, _RUNS, _DEAR = 7, 2, 4, 0.01


def our_run(make: Callable[..., Any], task: Task) -> Callable[[], list[Any]]:
    """Return a closed loop on a new plant, run once; it returns the poses."""
    plant = make(Timing(period=task.period, delay=task.delay), pose=task.pose)
    gains: dict[str, Any] = {name: getattr(task, name) for name in ("stiffness", "damping", "pulse", "pulse_width")}
    controller = wall_controller(**gains, period=task.period, delay=task.delay, mass=task.mass)
    poses: list[Any] = []

    def run() -> list[Any]:
        last = drive(plant, controller, task.ticks, observe=lambda sample, _: poses.append(sample.position))
        return [*poses, last.position]

    return run


def prepared(task: Task) -> tuple[dict[str, Callable[[], Callable[[], Any]]], list[str]]:
    """Return the runs by name, and missing peers."""
    methods: dict[str, Callable[[], Callable[[], Any]]] = {
        name: partial(our_run, make, task) for name, make in OURS.items()
    }
    variants, missing = available()
    for variant in variants:
        if variant.title:
            methods[variant.title] = partial(_itself, variant.build(task))
    return methods, missing


def _itself(simulate: Simulate) -> Simulate:
    """Return a peer's run: it begins anew by itself."""
    return simulate


def measure(quick: bool) -> dict[str, Any]:
    """Return costs, ratios to the first of OURS, errors [m] and ticks: costs in µs a simulated ms.

    Each with MuJoCo's profiler on, as its Python bindings start it, and off, as the commands of this package stop it.
    """
    figures: dict[str, Any] = {}
    for ticks in (Task.ticks, 5 * Task.ticks):
        task = Task(ticks=ticks)
        methods, missing = prepared(task)
        truth = np.array(our_run(ExactPlant, task)())
        poses = {name: np.array(prepare()()) for name, prepare in methods.items()}
        costs: dict[str, dict[str, list[float]]] = {
            state: {name: [] for name in methods} for state in ("profiler off", "profiler on")
        }
        for turn in range(3 if quick else _TURNS):
            for state, some in costs.items():
                _profile(state == "profiler on")
                for name, prepare in methods.items():
                    dear = bool(some[name]) and some[name][0] * task.duration > _DEAR
                    if turn >= _DEAR_TURNS and dear:
                        some[name].append(math.nan)
                    else:  # the least of several, as the method before has left the processor's caches cold
                        some[name].append(min(timed(prepare()) for _ in range(1 if dear else _RUNS)) / task.duration)
        stop_profiler()
        for state, some in costs.items():
            case, first = f"{ticks} ticks, {state}", next(iter(some.values()))
            figures[f"µs a simulated ms, {case}"] = medians(some, 1e3)
            figures[f"over corrected, {case}"] = {name: ratio(values, first) for name, values in some.items()}
            runs = {name: [Run(cost * task.duration, 1, ticks) for cost in some[name] if cost > 0.0] for name in some}
        figures[f"error (m), {ticks} ticks"] = {
            name: float(apart(motion, truth, published_device())) for name, motion in poses.items()
        }
    return {**figures, **columns(runs), "missing": missing}


def _profile(on: bool) -> None:
    """Start MuJoCo's profiler, or stop it."""
    if on:
        mujoco.set_mjcb_time(None)  # as at import
    else:
        stop_profiler()
