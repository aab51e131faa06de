"""Speed against accuracy: cost and error of each method.

Draws a chart of every scene, one of the drop with what a user would take instead, and curves of what the step does
to the stability boundary and to the energy of a bounce; writes every figure to speed_accuracy.json. Costs are medians
of repeats in turn within this one run, so that their ratios hold on a machine that is not alone. `measure` is a section
of bench.py.
"""

from __future__ import annotations

import json
import math
import os
import re
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

# six by six matrices gain nothing from threads, and some peers lose much; numpy reads this once
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from maglev_mj import Controller, drive
from maglev_mj.cli.declare import Parser
from maglev_mj.cli.output import script_options
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.pictures import ChartPanel, PictureFolder, small_multiples
from maglev_mj.plants import INTEGRATORS, ExactPlant, MuJoCoBatchPlant, SampledPlant, Timing
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.scenes.wall_scene import wall_controller
from maglev_mj.spec import GRAVITY, Spec
from maglev_mj.studies import levels
from maglev_mj.studies.fidelity import preset_of, stepping_name
from maglev_mj.studies.levels import LevelMotion, apart, closed_loop, level_parts, median_times, motion_of
from maglev_mj.theory.loop import Loop
from maglev_mj.versions import versions
from peers import Task, available
from work_precision import EXACT_ENOUGH, WorkPoint, pareto, work_precision

CLOSED_FORM = ("drop", "drop-no-pulse", "press", "stick-slip")
_LOOP = Loop.of("ubc", stiffness=0.0, damping=0.0)[0].array()
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


def energy_error(motion: LevelMotion, truth: LevelMotion) -> float:
    """Return the largest error of energy along z, as a share of a whole fall's."""
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
    error = float(apart(motion_of(*exact()).pose, truth.pose, scene.hardware))
    methods = [Method("exact", "exact plant", partial(closed_loop, exact), error, duration, "exact", None, 0.0)]
    for level, group, integrator, step in single_methods(quick):
        make = partial(level_parts, scene, level, integrator=integrator, longest_step=step)
        motion = motion_of(*make())
        method = stepping_name(integrator, step) + (", coils" if level == "turning" else "")
        energy = energy_error(motion, truths[level]) if name.startswith("drop") else None
        error = float(apart(motion.pose, truths[level].pose, scene.hardware))
        methods.append(Method(method, group, partial(closed_loop, make), error, duration, integrator, step, energy))
    count = 100 if quick else 1000
    many: tuple[tuple[str, str, Callable[..., SampledPlant], dict[str, Any]], ...] = (
        ("exact", "exact plant", ExactPlant, {}),
        ("corrected", GROUPS["corrected"], MuJoCoBatchPlant, {"coils": False, "integrator": "corrected"}),
        ("rk4", GROUPS["rk4"], MuJoCoBatchPlant, {"coils": False}),
    )
    for method, group, kind, options in many:
        many_parts = partial(batch_of, scene, kind, count, **options)
        error = float(apart(poses_of(*many_parts()), truth.pose, scene.hardware))
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
        error = float(apart(poses, truth, scene.hardware))
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


TITLES = {
    "drop": "on a wall, with a braking pulse",
    "drop-no-pulse": "without the pulse",
    "press": "an arm hits, then presses",
    "stick-slip": "pulled out of friction",
    "twist": "free, at 3.7 rad/s",
    "six-axes": "drawn back to the centre",
}
BENCHED = "drop", "drop-no-pulse", "press", "six-axes"
"""Scenes of `make bench`: the others repeat the results of the drop, or of six-axes."""

STEPPED = {
    "mujoco": "Euler, steps of {} ms",
    "drake": "scripted, discrete {} ms",
    "pybullet": "steps of {} ms",
    "pinocchio": "semi-implicit Euler, steps of {} ms",
    "scipy": "solve_ivp a period, RK45, max_step {} ms",
}
"""Names of a peer's fixed-step methods, without the step: the first choice of its user."""

PERIOD, DELAY = Timing().period, Timing().delay


def add_scenes(parser: Parser) -> None:
    """Add --scenes."""
    parser.add_argument(
        "--scenes", nargs="+", default=list(TITLES), choices=TITLES, metavar="SCENE", help=", ".join(TITLES)
    )


class PeersDrop(Drop):
    """Drop from the pose and length of the peers' task."""

    def start(self) -> Start:
        """See `Scene`."""
        return Start(pose=Task().pose)

    def ticks(self, timing: Timing) -> int:
        """See `Scene`."""
        return round(self.duration / self.period)


def boundary_shifts(quick: bool) -> dict[str, Any]:
    """Return each integrator's shift of the stiffest stable wall over the step, and its order."""
    steps = [1e-3, 1e-4] if quick else [2.5e-3, 1e-3, 5e-4, 2.5e-4, 1e-4]
    rows: dict[str, Any] = {"steps": steps, "shifts": {}, "orders": {}}
    for integrator in INTEGRATORS:
        rows["shifts"][integrator] = [boundary_shift(integrator, step) for step in steps]
    for integrator in ("euler", "rk4"):
        missed = [boundary_shift(integrator, 0.93 * step, aligned=False) for step in steps]
        rows["shifts"][f"{integrator}, steps that miss the switches"] = missed
    for name, shifts in rows["shifts"].items():
        if min(map(abs, shifts)) > 1e-9:
            rows["orders"][name] = float(np.polyfit(np.log(steps), np.log(np.abs(shifts)), 1)[0])
    return rows


def sweep_of_drops(stiffnesses: int, dampings: int, repeats: int) -> dict[str, Any]:
    """Return cost a drop [s] and wrong endings of a sweep over the wall's gains.

    A drop counts as settled if it moves by less than a tenth of a millimetre in its last quarter.
    """
    grid = np.meshgrid(np.linspace(500.0, 16000.0, stiffnesses), np.linspace(20.0, 180.0, dampings))
    stiffness, damping = (values.ravel() for values in grid)
    makers: dict[str, Callable[..., SampledPlant]] = {
        "exact": ExactPlant,
        "MuJoCo, corrected": partial(MuJoCoBatchPlant, integrator="corrected", coils=False, threads=2),
        "MuJoCo, corrected, coils": partial(MuJoCoBatchPlant, integrator="corrected", threads=2),
        "MuJoCo, rk4": partial(MuJoCoBatchPlant, coils=False, threads=2),
    }
    raw = partial(MuJoCoBatchPlant, coils=False, threads=2, integrator="euler")
    makers["MuJoCo, raw euler"] = raw
    makers["MuJoCo, raw euler, 0.1 ms"] = partial(raw, longest_step=1e-4)
    pose = np.zeros((stiffness.size, 6))
    pose[:, 2] = Spec.translation_range.value
    costs: dict[str, list[float]] = {name: [] for name in makers}
    settled: dict[str, Array] = {}
    for _ in range(repeats):
        for name, make in makers.items():
            plant = make(Timing(period=PERIOD, delay=DELAY), pose=pose, escape=(1e6, 1.0))
            controller = wall_controller(
                stiffness=stiffness,
                damping=damping,
                pulse=220.0,
                pulse_width=0.003,
                period=PERIOD,
                delay=DELAY,
                mass=Spec.moving_mass.value,
            )
            heights: list[Array] = []

            def keep(sample: Sample, _: Command, heights: list[Array] = heights) -> None:
                heights.append(sample.position[2])

            start = time.perf_counter()
            drive(plant, controller, 80, observe=keep)
            costs[name].append((time.perf_counter() - start) / stiffness.size)
            settled[name] = np.ptp(heights[60:], axis=0) < 1e-4
    return {
        "drops": int(stiffness.size),
        "cost": {name: statistics.median(values) for name, values in costs.items()},
        "disagreement": {name: int((verdict != settled["exact"]).sum()) for name, verdict in settled.items()},
    }


def measure(quick: bool, scenes: Sequence[str] = BENCHED) -> dict[str, Any]:
    """Return cost and error of every method, the peers' too, and the step's effect.

    Args:
        quick: Fewer steps and repeats.
        scenes: Names from TITLES.
    """
    methods = {name: our_methods(name, preset_of(name).scene, quick) for name in scenes}
    drop = PeersDrop(force_limit=0.0)
    peers, missing = peer_methods(drop, Task(), quick)
    everyone = our_methods("drop", drop, quick) + peers
    for some in (*methods.values(), everyone):
        take_times(some, 1 if quick else 3)
    return {
        "scenes": {name: as_json(some) for name, some in methods.items()},
        "peers": as_json(everyone),
        "boundary": boundary_shifts(quick),
        "sweep": sweep_of_drops(10, 10, 1) if quick else sweep_of_drops(40, 25, 1),
        "missing": missing,
    }


def main() -> None:
    """Measure, print, draw, write."""
    options = script_options(__doc__, "fewer steps and repeats", add_scenes)
    data = measure(options.quick, options.scenes)
    for line in data["missing"]:
        print(line)
    print("what nothing beats, the cheapest first")
    for name, part in {**data["scenes"], "with peers": data["peers"]}.items():
        print(f"  {name:<14} one device: {'; '.join(part['front'])}")
        print(f"  {'':<14}       many: {'; '.join(part['front_of_many'])}")
    print("\na sweep of drops, on two threads: cost of a drop, and drops that end otherwise than exact")
    for name, cost in data["sweep"]["cost"].items():
        print(f"  {name:<28}{cost * 1e6:8.1f} µs{data['sweep']['disagreement'][name]:6d}")
    print("\nshift of the stiffest stable wall: order in the step")
    for name, order in data["boundary"]["orders"].items():
        first = data["boundary"]["shifts"][name][0]
        print(f"  {name:<44}{order:5.2f}   {first:+.1%} at {data['boundary']['steps'][0] * 1e3:g} ms")
    figures = options.pictures.path("speed_accuracy", "json")
    figures.write_text(json.dumps({**data, "versions": versions()}, indent=1) + "\n")
    for path in [figures, *draw(options.pictures, data)]:
        print(f"wrote {path}")


def merged(curves: list[tuple[str, list[Any], list[Any]]]) -> list[tuple[str, list[Any], list[Any]]]:
    """Return curves with those named together that are equal wherever both are known."""
    kept: list[tuple[str, list[Any], list[Any]]] = []
    for name, steps, values in curves:
        for place, (other, over, known) in enumerate(kept):
            shared = dict(zip(over, known, strict=True))
            if set(steps) <= set(shared) and np.allclose(values, [shared[step] for step in steps], rtol=1e-6):
                kept[place] = f"{other}, {name}", over, known
                break
        else:
            kept.append((name, steps, values))
    return kept


def chart_points(rows: Sequence[Mapping[str, Any]]) -> list[WorkPoint]:
    """Return chart points of a scene; raw Euler's stand for all that are one with it."""
    points = []
    for row in rows:
        integrator, step, group = row["integrator"], row["step"], row["group"]
        if integrator in SEMI_IMPLICIT[1:] or not math.isfinite(row["error"]):
            continue
        joined = integrator in GROUPS and "coils" not in group
        label = group
        if joined:
            finest = min(other["step"] or math.inf for other in rows if other["group"] == group)
            label = f"{group}, {1e3 * step:g} ms" if step == finest else ""
            label = f"{1e3 * step:g} ms" if integrator == "euler" and step in (1e-3, 1e-4) else label
        points.append(_point(row, group, label, joined))
    return points


def _stem(name: str) -> str:
    """Return a method's name without its step."""
    return re.sub(r"[0-9.]+ ms", "{} ms", name)


def _point(row: Mapping[str, Any], group: str, label: str, joined: bool) -> WorkPoint:
    cost, many = 1e-3 * row["microseconds_a_millisecond"], "at once" in row["name"]
    return WorkPoint(row["name"], group, cost, row["error"], many, label, joined)


def peer_points(rows: Sequence[Mapping[str, Any]]) -> list[WorkPoint]:
    """Return this package's plants and each peer's methods within a nanometre or on a grid."""
    ours = {"exact plant", "exact plant, 1000 at once", GROUPS["corrected"], GROUPS["rk4"]}
    points = [
        _point(row, f"this package, {row['group']}", "", False)
        for row in rows
        if row["group"] in ours and row["error"] <= EXACT_ENOUGH
    ]
    for peer, name in PEERS.items():
        mine = [row for row in rows if row["group"] == name]
        points += [_point(row, name, "", False) for row in mine if row["error"] <= EXACT_ENOUGH]
        grid = [row for row in mine if _stem(row["name"]) == STEPPED.get(peer) and row["error"] > EXACT_ENOUGH]
        points += [_point(row, name, name if row is grid[-1] else "", True) for row in grid]
    return points


def step_panels(data: Mapping[str, Any]) -> list[ChartPanel]:
    """Return the step's effect on boundary and bounce energy."""
    boundary = data["boundary"]
    shifts = [(name, boundary["steps"], np.abs(boundary["shifts"][name]).tolist()) for name in boundary["orders"]]
    energies = []
    for kind in SEMI_IMPLICIT:
        rows = [row for row in data["scenes"].get("drop-no-pulse", {}).get("methods", ()) if row["integrator"] == kind]
        mine = sorted((row["step"], row["energy_error"]) for row in rows if row["step"])
        energies.append((kind, [step for step, _ in mine], [error for _, error in mine]))
    tables = {
        "shift of the stiffest stable wall": ("relative shift", shifts),
        "energy of a bounce": ("largest error, relative to the fall", [curve for curve in energies if curve[1]]),
    }
    return [
        ChartPanel(title=title, labels=("time step (s)", label), curves=merged(curves), log="xy", marked=True)
        for title, (label, curves) in tables.items()
        if curves
    ]


def draw(pictures: PictureFolder, data: Mapping[str, Any]) -> list[Path]:
    """Draw the charts; return their files."""
    rate = f"{1.0 / PERIOD:g} Hz, delay {1e3 * DELAY:g} ms"
    drawn = [
        work_precision(
            f"{name}: {TITLES[name]}, {rate}",
            chart_points(part["methods"]),
            "exact plant",
            pictures.path(f"speed_accuracy_{name}"),
        )
        for name, part in data["scenes"].items()
    ]
    everyone = peer_points(data["peers"]["methods"])
    title = f"the same drop on six axes in each simulator, {rate}"
    drawn.append(work_precision(title, everyone, "exact plant", pictures.path("speed_accuracy_peers")))
    shift = max(np.abs(shifts).max() for shifts in data["boundary"]["shifts"].values())
    head = [
        f"Time steps up to {1e3 * max(data['boundary']['steps']):g} ms shift the boundary by up to {100 * shift:.2g} %",
        f"critical stiffness and a bounce of the drop, {rate}",
    ]
    return [*drawn, small_multiples(head, step_panels(data), pictures.path("speed_accuracy_steps"))]


if __name__ == "__main__":
    main()
