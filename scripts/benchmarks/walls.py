"""Cost of nonlinear walls on the exact plant.

In parts and in one; of sweeps one by one and as batches.
"""

import os
import resource
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from maglev_mj import find_scene
from maglev_mj.control.loop import drive
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.plants import ExactPlant, Sensor, Timing
from maglev_mj.scenes.bench import along, wall_controller
from maglev_mj.spec import Spec
from maglev_mj.studies.cells import Cell
from maglev_mj.studies.sweep import run_scene_cells, swept_cells

PART, SAMPLES = 10_000, 400
PULSE, WIDTH, LIMIT, QUANTUM = 220.0, 0.003, 60.0, 5e-6
AROUND: dict[str, Any] = {"period": 0.005, "delay": 0.0015, "mass": 0.7}


def measure(quick: bool) -> dict[str, Any]:
    """Return costs [s, µs] and differences between equal computations; all on one core."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        return {"walls": walls(20_000 if quick else 100_000), "sweeps": sweeps(quick), **door(quick)}
    finally:
        os.sched_setaffinity(0, cores)


def walls(count: int) -> dict[str, float]:
    """Return the cost of walls, whole and in parts.

    A wall and sample [µs], a million [s], and the memory [MB].
    """
    random = np.random.default_rng(0)
    stiffness, damping = random.uniform(500.0, 12_500.0, count), random.uniform(5.0, 190.0, count)
    results, costs = [], []
    for size in (PART, count):
        start = time.perf_counter()
        results.append(
            np.concatenate([swings(stiffness[s : s + size], damping[s : s + size]) for s in range(0, count, size)])
        )
        costs.append((time.perf_counter() - start) / count)
        if size == PART:
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    parts, whole = results
    quiet = whole < 1e-4  # what goes on bouncing is chaotic: rounding grows in it
    return {
        "parts_us_a_wall_and_sample": costs[0] / SAMPLES * 1e6,
        "one_part_us_a_wall_and_sample": costs[1] / SAMPLES * 1e6,
        "million_s": costs[0] * 1e6,
        "memory_mb": memory,
        "largest_difference_of_quiet_m": float(np.abs(parts - whole)[quiet].max()),
        "quiet_in_one_alone": float(np.mean(quiet != (parts < 1e-4))),
    }


def swings(stiffness: Array, damping: Array) -> Array:
    """Return the final swing of N dropped flotors [m], (N,).

    Over the last quarter of the samples.
    """
    plant = ExactPlant(
        Timing(period=AROUND["period"], delay=AROUND["delay"]),
        mass=AROUND["mass"],
        pose=along("z", np.full(stiffness.size, Spec.translation_range.value)),
        escape=(1e9, 1.0),
        wrench_limit=np.where(np.eye(6)[2] > 0.0, LIMIT, np.inf),
        sensor=Sensor(quantum=np.eye(6)[2] * QUANTUM),
    )
    controller = wall_controller(stiffness=stiffness, damping=damping, pulse=PULSE, pulse_width=WIDTH, **AROUND)
    least, most = np.full(stiffness.size, np.inf), np.full(stiffness.size, -np.inf)

    def observe(sample: Sample, _: Command) -> None:
        if sample.tick >= 3 * SAMPLES // 4:
            np.minimum(least, sample.position[2], out=least)
            np.maximum(most, sample.position[2], out=most)

    drive(plant, controller, SAMPLES, observe=observe)
    swing: Array = most - least
    return swing


def sweeps(quick: bool) -> dict[str, Any]:
    """Return the cost of a sweep's cell [ms].

    One by one and together, and the difference of the figures.
    """
    grids: dict[str, dict[str, tuple[float, float]]] = {
        "drop": {"stiffness": (1000.0, 9000.0), "damping": (40.0, 100.0)},
        "press": {"stiffness": (2000.0, 8000.0), "press": (2.0, 6.0)},
        "stick-slip": {"breakaway": (0.5, 2.5), "spring": (500.0, 1500.0)},
        "wall": {"stiffness": (2000.0, 16000.0), "damping": (20.0, 160.0)},
    }
    found: dict[str, Any] = {}
    for name, ends in grids.items():
        if quick and name != "drop":
            continue
        for side, other in ((8, 8), (40, 25)) if name in ("drop", "stick-slip") and not quick else ((8, 8),):
            vary = {one: np.linspace(*end, n).tolist() for (one, end), n in zip(ends.items(), (side, other))}
            cells = swept_cells(find_scene(name)(), vary, plant="exact")
            some = cells[:: max(len(cells) // (8 if name in ("press", "wall") else 32), 1)]
            run_scene_cells(cells[:1])  # what is imported and kept by the first
            alone, one_by_one = timed(partial(each, some))
            row = found[f"{name}_{len(cells)}"] = {"alone_ms": alone / len(some) * 1e3}
            if find_spec("maglev_mj.scenes.together"):
                together, at_once = timed(partial(run_scene_cells, cells))
                row["together_ms"] = together / len(cells) * 1e3
                row["ratio"] = row["alone_ms"] / row["together_ms"]
                kept = {str(cell): result for cell, result in zip(cells, at_once)}
                row["largest_relative_difference"] = max(
                    apart(kept[str(cell)], result) for cell, result in zip(some, one_by_one)
                )
    return found


def each(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return the results of cells that run one by one."""
    return [run_scene_cells([cell])[0] for cell in cells]


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return a call's time [s] and its result."""
    start = time.perf_counter()
    result = function()
    return time.perf_counter() - start, result


def apart(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Return the largest relative difference of two runs' figures, over the figure's size and a micro-unit."""
    pairs = [(np.array(one.get(name), dtype=float), np.array(value, dtype=float)) for name, value in other.items()]
    missing = [(np.isnan(a) != np.isnan(b)).any() for a, b in pairs]
    shares = [np.nan_to_num(np.abs(a - b) / (np.abs(b) + 1e-6)).max(initial=0.0) for a, b in pairs]
    return float("inf") if any(missing) else float(max(shares))


def door(quick: bool) -> dict[str, Any]:
    """Return the cost of a million cells [s].

    Through the map of drops, verdicts and theory's boundary included.
    """
    try:
        from maglev_mj.studies.drop_map import DropMapParameters, run_drop_map
    except ImportError:
        return {}
    grid = 100 if quick else 400
    p = DropMapParameters(grid=grid, pulse=PULSE, pulse_width=WIDTH, force_limit=LIMIT, quantize=QUANTUM)
    took, result = timed(lambda: run_drop_map(p))
    wrong = (result.settles & ~result.stable_by_theory).mean()
    return {"map": {"million_s": took / grid**2 * 1e6, "settles_though_unstable": float(wrong)}}
