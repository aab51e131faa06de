"""Ratios that say whether a cost is flat: over the engine's profiler, the length of a run and the size of a grid.

`measure` is a section of bench.py. Processor times, the least of several in turns, so that other work counts little.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from maglev_mj import MuJoCoPlant, Timing, find_scene, run, sweep
from timing import in_turns


def _spent(work: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    start = time.process_time()
    work()
    return time.process_time() - start


def _steps(profiled: bool, count: int) -> float:
    """Return the time of steps of the rigid body with the engine's profiler on or off [s]."""
    model = MuJoCoPlant(Timing(), integrator="euler", coils=False).device.model
    data = mujoco.MjData(model)
    if profiled:
        mujoco.set_mjcb_time(None)  # as at import
    try:
        return _spent(lambda: [mujoco.mj_step(model, data) for _ in range(count)])
    finally:
        _stop_profiler()


def _stop_profiler() -> None:
    import maglev_mj.lazy

    getattr(maglev_mj.lazy, "stop_profiler", int)()  # not in the revision before it


def _recorded(ticks: int) -> float:
    """Return the time of a recorded run on the exact plant [s]."""
    drop: Any = find_scene("drop")
    scene = drop(duration=ticks * drop().period)
    return _spent(lambda: run(scene, plant="exact"))


def _swept(cells: int) -> float:
    """Return the time of a sweep of walls in this process [s]."""
    side = round(cells**0.5)
    vary = {"stiffness": np.linspace(500.0, 4000.0, side).tolist(), "damping": np.linspace(5.0, 50.0, side).tolist()}
    return _spent(lambda: sweep("wall", vary, plant="exact"))


def measure(quick: bool) -> dict[str, Any]:
    """Return the ratios; quick for a test."""
    many, long, cells = (1000, 1000, 16) if quick else (100_000, 100_000, 900)
    work = {
        "profiled": lambda: _steps(True, many),
        "steps": lambda: _steps(False, many),
        "long": lambda: _recorded(long),
        "short": lambda: _recorded(long // 10),
        "large": lambda: _swept(cells),
        "small": lambda: _swept(cells // 9),
    }
    least = {name: min(times) for name, times in in_turns(work, 2 if quick else 3).items()}
    return {
        "a step with MuJoCo's profiler over one without": least["profiled"] / least["steps"],
        "10^5 recorded ticks over ten times 10^4": least["long"] / (10.0 * least["short"]),
        "a sweep of 900 walls over one of 100": least["large"] / least["small"],
        "µs a recorded tick of 10^5": 1e6 * least["long"] / long,
    }
