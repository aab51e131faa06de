"""Cost over devices, sample rate, cells and workers.

`measure` is a section of bench.py. An estimate for many workers is worked out from what one and two show; its
assumptions stand in `ASSUMED`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import wait
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np
from mujoco import rollout

from maglev_mj import Controller, Hold, Timing, Wall
from maglev_mj.pictures import ChartPanel, PictureFolder, small_multiples
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, MuJoCoPlant, SampledPlant
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import find_scene
from maglev_mj.spec import INERTIA, Spec
from maglev_mj.studies.cells import Workers, dask_workers, local_workers
from maglev_mj.studies.sweep import sweep
from timing import Run, columns, driven, in_turns, ratio, timed

MANY = 100
CELLS = 100_000
JOBS_EACH = 32  # jobs a worker of a cluster gets in a sweep, each of at most `MOST_TOGETHER` cells; see studies.sweep
MOST_TOGETHER = 50
ASSUMED = (
    "each worker has a core of its own, as fast as one of these two when both work",
    "they are slowed down by one another no more than these two are",
    "the scheduler has a core of its own, and hands out as many empty jobs a second as here, over the loopback",
    "starting a hundred workers takes as long as starting two: they are started at once, each on its machine",
    "results are figures of some hundred bytes a cell, so that the network adds nothing",
)
"""Assumptions of the estimate for many workers."""

_POSE = [0.5e-3, -0.3e-3, Spec.translation_range.value, 0.0, 0.0, 0.0]
_TICKS = 60  # of a run: the flotor falls, hits the wall and rests in it
_CELLS = 24  # of a sweep beside the rollout
_SPENT = 1.5  # on the repeats of a run [s]


def plants() -> dict[str, tuple[Callable[..., SampledPlant], Callable[..., SampledPlant], int]]:
    """Return single and batch plants with their largest batch."""
    single, batch = partial(MuJoCoPlant, coils=False), partial(MuJoCoBatchPlant, coils=False)
    euler = {"integrator": "corrected"}
    return {
        "exact plant": (ExactPlant, ExactPlant, 1_000_000),
        "corrected, MuJoCo": (partial(single, **euler), partial(batch, **euler), 10_000),
        "RK4, MuJoCo": (single, batch, 10_000),
    }


def cheapest_run(make: Callable[..., SampledPlant], devices: int) -> Run:
    """Return the cheapest of some runs of the drop."""
    pose = np.tile(_POSE, (devices, 1)) if devices > 1 else _POSE

    def run() -> Run:
        return driven(make(Timing(), pose=pose), Drop().controller(), _TICKS)

    first = run()
    more = min(int(_SPENT / first.seconds), 4)
    return min([first, *(run() for _ in range(more))], key=lambda one: one.seconds)


def nested(runs: Mapping[str, Mapping[int, Run]]) -> dict[str, dict[str, dict[int, float]]]:
    """Return the columns of runs by plant and number."""
    found: dict[str, dict[str, dict[int, float]]] = {}
    for name, some in runs.items():
        for head, column in columns({str(key): run for key, run in some.items()}).items():
            found.setdefault(head, {})[name] = {int(key): value for key, value in column.items()}
    return found


def against_devices(quick: bool) -> dict[str, dict[str, dict[int, float]]]:
    """Return the cost of a tick and device, by plant and number of devices."""
    counts = [1, 10, 100, 1000, 5000, 10_000, 20_000, 50_000, 100_000, 1_000_000]
    counts = counts[:3] if quick else counts
    found = {}
    for name, (one, batch, most) in plants().items():
        runs = [cheapest_run(one if count == 1 else batch, count) for count in counts if count <= most]
        found[name] = {run.devices or 1: run for run in runs}
    return nested(found)


def against_rate(quick: bool) -> dict[str, dict[str, dict[int, float]]]:
    """Return simulated seconds a second and what ran, by plant and rate, at a delay of 0.3 periods."""
    makers: dict[str, Callable[..., SampledPlant]] = {
        "exact plant": ExactPlant,
        "corrected, MuJoCo": partial(MuJoCoPlant, integrator="corrected", coils=False),
        "RK4, MuJoCo, coils": MuJoCoPlant,
    }
    ticks, found = 40 if quick else 2000, {}
    for name, make in makers.items():
        found[name] = {
            rate: min((_rate_run(make, 1.0 / rate, ticks) for _ in range(3)), key=lambda run: run.seconds)
            for rate in ((200, 20_000) if quick else (200, 500, 1000, 2000, 5000, 10_000, 20_000))
        }
    speeds = {name: {rate: 1.0 / rate / run.each for rate, run in some.items()} for name, some in found.items()}
    return {"simulated seconds a second": speeds, **nested(found)}


def _rate_run(make: Callable[..., SampledPlant], period: float, ticks: int) -> Run:
    """Hold a centred flotor."""
    delay = 0.3 * period
    laws = (
        Wall(axes="z", lower=-1e-3, stiffness=6000, damping=20),
        Hold.critically_damped(inertia=INERTIA, period=period, delay=delay),
    )
    plant = make(Timing(period=period, delay=delay), pose=[1e-4, 0.0, 0.0, 0.0, 0.0, 0.0])
    return driven(plant, Controller(list(laws), period=period), ticks)


def against_rollout(quick: bool) -> dict[str, dict[str, float]]:
    """Return costs of a MuJoCo batch relative to `mujoco.rollout` with as many steps of the same model.

    The rollout has no controller: it is the bound of what a batch on these cores can reach.
    """
    devices, turns = (50, 2) if quick else (2000, 9)
    found: dict[str, dict[str, float]] = {}
    least: dict[str, dict[str, float]] = {}
    for integrator in ("corrected", "rk4"):
        for threads in (1, os.cpu_count() or 1):
            name = f"{integrator}, {threads} thread{'s' * (threads > 1)}"
            times = in_turns(_rollout_runs(integrator, devices, threads), turns)
            least[name] = {work: min(values) for work, values in times.items()}
            for work in times.keys() - {"rollout"}:
                found.setdefault(f"{work}, over rollout", {})[name] = ratio(times[work], times["rollout"])
            each = 1e6 * least[name]["rollout"] / devices / _TICKS
            found.setdefault("rollout, µs a tick and device", {})[name] = each
    for integrator in ("corrected", "rk4"):
        one, *more = (some for name, some in least.items() if name.startswith(integrator))
        for all_cores in more:
            for work, value in all_cores.items():
                found.setdefault("one thread over all cores", {})[f"{integrator}, {work}"] = one[work] / value
    return found


def against_new_plants(quick: bool) -> dict[str, dict[str, float]]:
    """Return the cost of a new plant relative to a restart of one, by plant."""
    found = {}
    for name, (make, _, _) in plants().items():
        plant = make(Timing(), pose=_POSE)
        work: dict[str, Callable[[], float]] = {
            "new": partial(timed, partial(make, Timing(), pose=_POSE)),
            "restart": partial(timed, partial(plant.restart, _POSE)),
        }
        times = in_turns(work, 5 if quick else 300)
        found[name] = ratio(times["new"], times["restart"])
    return {"new plant over restart": found}


def _rollout_runs(integrator: str, devices: int, threads: int) -> dict[str, Callable[[], float]]:
    """Return runs of the drop by name; each returns its time [s]."""
    pose = np.tile(_POSE, (devices, 1))
    plant = MuJoCoBatchPlant(Timing(), pose=pose, coils=False, integrator=integrator, threads=threads)
    steps = [0]
    advance = plant._engine.step

    def counted(nstep: int) -> None:
        steps[0] += nstep
        advance(nstep=nstep)

    with patch.object(plant._engine, "step", counted):
        driven(plant, Drop().controller(), _TICKS)
    model = plant.device.model
    model.opt.timestep = _TICKS * plant.period / steps[0]
    workers, kind = [mujoco.MjData(model) for _ in range(threads)], mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, workers[0], start, kind)
    starts = np.tile(start, (devices, 1))
    roll = rollout.Rollout(nthread=threads if threads > 1 else 0)

    def closed() -> float:
        plant.restart(pose)
        return driven(plant, Drop().controller(), _TICKS).seconds

    runs = {
        "rollout": lambda: timed(lambda: roll.rollout(model, workers, starts, nstep=steps[0])),
        "batch, steps alone": lambda: timed(lambda: [advance(nstep=1) for _ in range(steps[0])]),
        "batch, closed loop": closed,
    }
    if integrator == "rk4" and threads == 1:
        each = devices * _TICKS / (_CELLS * Drop().ticks(Timing()))  # scaled to as many ticks as the batch
        runs["sweep in one process"] = lambda: each * sweep_time(local_workers(0), _CELLS)
    return runs


def sweep_time(workers: Workers, cells: int) -> float:
    """Return the time of a sweep of drops [s], in the engine, the workers' start included."""
    vary = {"stiffness": np.linspace(1000.0, 6000.0, cells // 4).tolist(), "damping": [60.0, 70.0, 80.0, 90.0]}
    return timed(lambda: sweep(find_scene("drop"), vary, plant="mujoco", workers=workers))


def jobs_a_second(workers: Workers, count: int) -> float:
    """Return empty jobs a second of started workers."""
    with workers.make() as executor:
        wait([executor.submit(time.sleep, 0.0) for _ in range(8)])
        taken = timed(lambda: wait([executor.submit(time.sleep, 0.0) for _ in range(count)]))
    return count / taken


@contextmanager
def cluster(count: int) -> Iterator[Workers]:
    """Start a local Dask cluster of processes; yield its workers."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None) as scheduler:
        yield dask_workers(scheduler.scheduler_address)


def against_cells(workers: Workers, few: int, many: int) -> dict[str, float]:
    """Return start [s] and rate [cells/s] of workers, from sweeps of few and of many cells."""
    short, long = min(sweep_time(workers, few) for _ in range(2)), sweep_time(workers, many)
    rate = (many - few) / max(long - short, 1e-9)
    return {"cells": many, "seconds": long, "cells a second": rate, "start (s)": max(short - few / rate, 0.0)}


def against_workers(quick: bool) -> dict[str, Any]:
    """Return start, rate and jobs a second by worker kind."""
    few, many, jobs = (4, 24, 20) if quick else (40, 440, 1000)
    kinds = {"this process": local_workers(0), "1 worker": local_workers(1), "2 workers": local_workers(2)}
    found: dict[str, Any] = {name: against_cells(workers, few, many) for name, workers in kinds.items()}
    if quick:  # a cluster takes seconds to start
        return found
    found["2 workers"]["empty jobs a second"] = jobs_a_second(kinds["2 workers"], jobs)
    start = time.perf_counter()
    try:
        with cluster(2) as workers:
            found["Dask, 2 workers"] = {"start of the cluster (s)": time.perf_counter() - start}
            found["Dask, 2 workers"] |= against_cells(workers, few, many)
            found["Dask, 2 workers"]["empty jobs a second"] = jobs_a_second(workers, jobs)
    except ImportError:
        found["missing"] = "distributed is not installed: no Dask cluster"
    return found


def estimate(found: Mapping[str, Any], workers: int = MANY, cells: int = CELLS) -> dict[str, Any]:
    """Return the extrapolated rate of a cluster of many workers.

    From one and two workers here; see `ASSUMED`.

    Args:
        found: See `against_workers`.
        workers: How many.
        cells: Of the sweep.
    """
    one, two = found["1 worker"]["cells a second"], found["2 workers"]["cells a second"]
    dask = found.get("Dask, 2 workers", found["2 workers"])
    each = min(one, 0.5 * dask["cells a second"], 0.5 * two)
    together = min(max(cells // (JOBS_EACH * workers), 1), MOST_TOGETHER)
    by_workers = workers * each
    by_scheduler = together * dask.get("empty jobs a second", by_workers)
    rate = min(by_workers, by_scheduler)
    start = dask.get("start of the cluster (s)", 0.0) + dask["start (s)"]
    return {
        "workers": workers,
        "cells": cells,
        "cells a second and worker": each,
        "cells a second, by the workers": by_workers,
        "cells a second, by the scheduler": by_scheduler,
        "cells a second": rate,
        "seconds": start + cells / rate,
        "most workers that the scheduler feeds": by_scheduler / each,
    }


def measure(quick: bool) -> dict[str, Any]:
    """Return costs over devices, rate and workers, and the estimate."""
    devices, workers = against_devices(quick), against_workers(quick)
    rates = against_rate(quick)
    return {
        **devices,
        **against_rollout(quick),
        **against_new_plants(quick),
        "simulated seconds a second": rates.pop("simulated seconds a second"),
        "over rate": rates,
        "workers": workers,
        "estimate": estimate(workers),
        "assumed": list(ASSUMED),
    }


def _curves(table: Mapping[str, Mapping[Any, float]]) -> list[tuple[str, list[float], list[float]]]:
    """Return curves of a table with text keys from JSON."""
    return [(name, [float(key) for key in values], list(values.values())) for name, values in table.items()]


def draw(pictures: PictureFolder, found: Mapping[str, Any]) -> list[Path]:
    """Draw the growth; return the file."""
    workers = {name: row for name, row in found["workers"].items() if isinstance(row, Mapping)}
    counts, cells = [1, 2, 5, 10, 20, 50, 100], np.geomspace(1.0, 1e6, 25)
    guesses = {count: estimate(workers, count) for count in counts}
    rates = [("processes", [1, 2], [workers[name]["cells a second"] for name in ("1 worker", "2 workers")])]
    if "Dask, 2 workers" in workers:
        rates.append(("Dask", [2], [workers["Dask, 2 workers"]["cells a second"]]))
    rates.append(("estimate, Dask", counts, [guesses[count]["cells a second"] for count in counts]))
    taken = [(name, cells, row["start (s)"] + cells / row["cells a second"]) for name, row in workers.items()]
    taken.append((f"estimate, {MANY}", cells, [estimate(workers, MANY, int(count))["seconds"] for count in cells]))
    panels = [
        ChartPanel(
            title="a tick of many devices in one process",
            labels=("devices at once", "µs per tick and device"),
            curves=_curves(found["µs a tick and device"]),
            log="xy",
            marked=True,
        ),
        ChartPanel(
            title="one device, faster samples",
            labels=("samples per second", "simulated seconds per second"),
            curves=_curves(found["simulated seconds a second"]),
            log="xy",
            marked=True,
            level=1.0,
        ),
        ChartPanel(
            title="a sweep in the engine, over its workers",
            labels=("workers", "cells per second"),
            curves=rates,
            log="xy",
            marked=True,
        ),
        ChartPanel(
            title="the same with its start-up, over its cells",
            labels=("cells", "seconds"),
            curves=taken,
            log="xy",
        ),
    ]
    name, devices, costs = min(panels[0].curves, key=lambda curve: min(curve[2]))
    cheapest = int(np.argmin(costs))
    head = f"{name}: one of {devices[cheapest]:.0f} devices at once costs {costs[cheapest] / costs[0]:.1g} of one alone"
    loop = Timing()
    detail = (
        f"drop, {1.0 / loop.period:g} Hz, delay {1e3 * loop.delay:g} ms; "
        "faster samples: six axes held, delay 0.3 periods; sweeps: MuJoCo, RK4"
    )
    return [small_multiples([head, detail], panels, pictures.path("speed_growth"))]
