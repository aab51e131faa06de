"""Methods to simulate a scene: timed runs and their errors."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from maglev_mj import Controller, drive
from maglev_mj.frames import Array
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, SampledPlant, Timing
from maglev_mj.scenes.scene import Scene
from maglev_mj.spec import GRAVITY, Spec
from maglev_mj.studies import levels
from maglev_mj.studies.fidelity import stepping_name
from maglev_mj.studies.levels import Motion, apart, closed_loop, level_parts, median_times, motion_of
from maglev_mj.theory.closed_loop import SampledLoop
from peers import Task, available
from work_precision import WorkPoint, pareto

CLOSED_FORM = ("drop", "drop-no-pulse", "press", "stick-slip")
_LOOP = SampledLoop()
SEMI_IMPLICIT = ("euler", "implicit", "implicitfast", "discrete")
_LEAST_STEP = dict.fromkeys(("corrected", "rk4", *SEMI_IMPLICIT), 1e-4) | {"euler": 1e-5}
GROUPS = {"corrected": "corrected Euler", "rk4": "RK4"} | dict.fromkeys(SEMI_IMPLICIT, "raw Euler")
"""Names of integrators in a chart."""

PEERS = {
    "mujoco": "MuJoCo by hand",
    "drake": "Drake",
    "pybullet": "PyBullet",
    "scipy": "SciPy",
    "pinocchio": "Pinocchio by hand",
    "control": "python-control",
    "bdsim": "bdsim",
}
"""Names of peers in a chart."""


@dataclass
class Method:
    """A method to simulate a scene.

    Its timed run, for how much simulated time, and its error.
    """

    name: str
    group: str
    prepare: Callable[[], Callable[[], object]]
    error: float
    simulated: float
    integrator: str | None = None
    step: float | None = None
    energy: float | None = None
    cost: float = math.inf


def batch_of(scene: Scene, kind: Callable[..., SampledPlant], count: int, **options: Any) -> Any:
    """Return plant, controller and tick count of many devices."""
    timing, pose = scene.timing(), np.tile(scene.start().pose, (count, 1))
    plant = scene.plant(kind, pose=pose, **options | {"record": False, "longest_step": None})
    return plant, scene.controller(), scene.ticks(timing)


def energy_error(motion: Motion, truth: Motion) -> float:
    """Return the largest relative error of mechanical energy.

    Along z, as a share of that of a fall from the range's end.
    """
    mass, fall = Spec.moving_mass.value, Spec.translation_range.value
    kept = [0.5 * mass * one.twist[:, 2] ** 2 + mass * GRAVITY * one.pose[:, 2] for one in (motion, truth)]
    return float(np.abs(kept[0] - kept[1]).max() / (mass * GRAVITY * fall))


def single_methods(quick: bool) -> Iterator[tuple[str, str, str, float | None]]:
    """Yield the methods for one device: level, group, integrator and longest step."""
    steps = (1e-3, 1e-4) if quick else (2.5e-3, 1e-3, 5e-4, 1e-4, 1e-5)
    for integrator in ("corrected", "rk4", *SEMI_IMPLICIT):
        yield "body", GROUPS[integrator], integrator, None
        # the other semi-implicit ones are one with Euler: two steps show it
        for step in (1e-3, 1e-4) if integrator in SEMI_IMPLICIT[1:] else steps:
            if step >= _LEAST_STEP[integrator]:  # the dearer ones would take seconds a run
                yield "body", GROUPS[integrator], integrator, step
    for integrator in ("corrected", "rk4"):
        yield "turning", f"{GROUPS[integrator]}, coils", integrator, None


def our_methods(name: str, scene: Scene, quick: bool) -> list[Method]:
    """Return every method of this package for a scene."""
    truths = {
        "turning": motion_of(*level_parts(scene, "turning", longest_step=2e-5)),
        "body": motion_of(
            *(level_parts(scene, "axes") if name in CLOSED_FORM else level_parts(scene, "body", longest_step=2e-5))
        ),
    }
    exact = partial(level_parts, scene, "axes")
    truth, duration = truths["body"], exact()[2] * scene.period
    error = float(apart(motion_of(*exact()).pose, truth.pose))
    methods = [Method("exact", "exact plant", partial(closed_loop, exact), error, duration, "exact", None, 0.0)]
    for level, group, integrator, step in single_methods(quick):
        make = partial(level_parts, scene, level, integrator=integrator, longest_step=step)
        motion = motion_of(*make())
        method = stepping_name(integrator, step) + (", coils" if level == "turning" else "")
        energy = energy_error(motion, truths[level]) if name.startswith("drop") else None
        error = float(apart(motion.pose, truths[level].pose))
        methods.append(Method(method, group, partial(closed_loop, make), error, duration, integrator, step, energy))
    count = 100 if quick else 1000
    many: tuple[tuple[str, str, Callable[..., SampledPlant], dict[str, Any]], ...] = (
        ("exact", "exact plant", ExactPlant, {}),
        ("corrected", GROUPS["corrected"], MuJoCoBatchPlant, {"coils": False, "integrator": "corrected"}),
        ("rk4", GROUPS["rk4"], MuJoCoBatchPlant, {"coils": False}),
    )
    for method, group, kind, options in many:
        many_parts = partial(batch_of, scene, kind, count, **options)
        error = float(apart(poses_of(*many_parts()), truth.pose))
        methods.append(
            Method(
                f"{method}, {count} at once",
                f"{group}, {count} at once",
                partial(closed_loop, many_parts),
                error,
                duration * count,
            )
        )
    return methods


def poses_of(plant: SampledPlant, controller: Controller, ticks: int) -> Array:
    """Return the last device's sampled poses, (K, 6)."""
    poses: list[Array] = []
    drive(plant, controller, ticks, observe=lambda *_: poses.append(plant.state()[0][-1]))
    return np.array([*poses, plant.state()[0][-1]])


def peer_methods(scene: Scene, task: Task, quick: bool) -> tuple[list[Method], list[str]]:
    """Return the peers' methods, and a line each missing."""
    truth = motion_of(*level_parts(scene, "axes", inertia=task.inertia)).pose
    variants, missing = available()
    methods = []
    for variant in variants:
        simulate = variant.build(task)
        start = time.perf_counter()
        poses = simulate()
        if quick and time.perf_counter() - start > 0.05:
            continue
        error = float(apart(poses, truth))
        methods.append(Method(variant.name, PEERS[variant.peer], partial(_same, simulate), error, task.duration))
    return methods, missing


def _same(simulate: Callable[[], object]) -> Callable[[], object]:
    """Prepare nothing: a peer's run begins anew by itself."""
    return simulate


def take_times(methods: list[Method], repeats: int) -> None:
    """Time every method in turn."""
    for method, taken in zip(methods, median_times([method.prepare for method in methods], repeats), strict=True):
        method.cost = taken / method.simulated


@cache
def boundary_shift(integrator: str, step: float, aligned: bool = True) -> float:
    """Return an integrator's relative shift of the stiffest wall, at a step [s] and usual timing."""
    return levels.boundary_shift(integrator, step, _LOOP, aligned=aligned)


def as_json(methods: list[Method]) -> dict[str, Any]:
    """Return a scene's methods, and names of the best."""
    rows = [
        {
            "name": method.name,
            "group": method.group,
            "microseconds_a_millisecond": method.cost * 1e3,
            "real_time_factor": 1.0 / method.cost,
            "error": method.error,
            "energy_error": method.energy,
            "boundary_shift": None
            if method.integrator is None
            else boundary_shift(method.integrator, method.step or Timing().period),
            "integrator": method.integrator,
            "step": method.step,
        }
        for method in methods
    ]
    front = [[point.name for point in pareto(some)] for some in _parted(points_of(methods))]
    return {"methods": rows, "front": front[0], "front_of_many": front[1]}


def _parted(points: list[WorkPoint]) -> tuple[list[WorkPoint], list[WorkPoint]]:
    """Return the points of single devices, and those of many."""
    return [point for point in points if not point.many], [point for point in points if point.many]


def points_of(methods: list[Method]) -> list[WorkPoint]:
    """Return the methods as points of a chart."""
    return [
        WorkPoint(method.name, method.group, method.cost, method.error, many="at once" in method.name)
        for method in methods
        if math.isfinite(method.error)
    ]
