"""Cost of many walls on one core: nonlinear ones in parts, sweeps as batches.

`measure` is a section of bench.py.
"""

import os
import resource
from functools import partial
from typing import Any

import numpy as np

from maglev_mj import find_scene
from maglev_mj.control.loop import drive
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.plants import Timing
from maglev_mj.scenes.wall_scene import along, wall_controller, wall_plant
from maglev_mj.spec import Spec
from maglev_mj.studies.sweep import Grid, run_scene_cells
from timing import Run, answered, columns

PART, SAMPLES = 10_000, 400
PULSE, WIDTH, LIMIT, QUANTUM = 220.0, 0.003, 60.0, 5e-6
AROUND: dict[str, Any] = {"period": 0.005, "delay": 0.0015, "mass": 0.7}


def measure(quick: bool) -> dict[str, Any]:
    """Return costs and memory, on one core."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        return {"walls": walls(20_000 if quick else 100_000), "sweeps": sweeps(quick)}
    finally:
        os.sched_setaffinity(0, cores)


def walls(count: int) -> dict[str, dict[str, float]]:
    """Return the cost of walls in parts, of a million of them [s], and the memory [MB]."""
    random = np.random.default_rng(0)
    stiffness, damping = random.uniform(500.0, 12_500.0, count), random.uniform(5.0, 190.0, count)
    parts = [slice(part, part + PART) for part in range(0, count, PART)]
    seconds, runs = answered(lambda: [swings(stiffness[part], damping[part]) for part in parts])
    name, (ticks,) = "nonlinear walls", {ticks for _, ticks in runs}
    run = Run(seconds, sum(swing.size for swing, _ in runs), ticks)
    return {
        **columns({name: run}),
        "seconds a million": {name: 1e6 * run.ticks * run.each},
        "memory (MB)": {name: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3},
    }


def swings(stiffness: Array, damping: Array) -> tuple[Array, int]:
    """Return swings of dropped flotors over the last quarter of the samples [m], (N,), and the number of ticks."""
    plant = wall_plant(
        Timing(period=AROUND["period"], delay=AROUND["delay"]),
        height=np.full(stiffness.size, Spec.translation_range.value),
        quantum=QUANTUM,
        mass=AROUND["mass"],
        wrench_limit=along("z", LIMIT, np.inf),
    )
    controller = wall_controller(stiffness=stiffness, damping=damping, pulse=PULSE, pulse_width=WIDTH, **AROUND)
    least, most = np.full(stiffness.size, np.inf), np.full(stiffness.size, -np.inf)

    def observe(sample: Sample, _: Command) -> None:
        if sample.tick >= 3 * SAMPLES // 4:
            np.minimum(least, sample.position[2], out=least)
            np.maximum(most, sample.position[2], out=most)

    last = drive(plant, controller, SAMPLES, observe=observe)
    return most - least, last.tick


def sweeps(quick: bool) -> dict[str, dict[str, float]]:
    """Return the cost of a sweep's cell, by scene and number of cells; a cell is one device."""
    grids: dict[str, dict[str, tuple[float, float]]] = {
        "drop": {"stiffness": (1000.0, 9000.0), "damping": (40.0, 100.0)},
        "press": {"stiffness": (2000.0, 8000.0), "press": (2.0, 6.0)},
        "stick-slip": {"breakaway": (0.5, 2.5), "spring": (500.0, 1500.0)},
        "wall": {"stiffness": (2000.0, 16000.0), "damping": (20.0, 160.0)},
    }
    runs = {}
    for name, ends in grids.items():
        if quick and name != "drop":
            continue
        for side, other in ((8, 8), (40, 25)) if name in ("drop", "stick-slip") and not quick else ((8, 8),):
            vary = {one: np.linspace(*end, n).tolist() for (one, end), n in zip(ends.items(), (side, other))}
            cells = Grid(find_scene(name)(), vary, plant="exact")
            run_scene_cells(cells[:1])  # what is imported and kept by the first
            seconds, rows = answered(partial(run_scene_cells, cells))
            runs[f"{name}, {len(cells)}"] = Run(seconds, None, len(rows))
    return columns(runs, "cell")
