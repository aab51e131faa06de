"""Times of calls, in turns, and the columns that every table of the benchmarks has."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from maglev_mj import Controller, drive
from maglev_mj.frames import Array
from maglev_mj.plants import SampledPlant


class Run(NamedTuple):
    """What was timed, by its own account: a cost is divided by what ran, never by what was asked for."""

    seconds: float
    devices: int | None
    """Number of devices; None where a device has no meaning, as in the start of a program."""
    ticks: int
    """Ticks, or what a section counts instead of them: frames, starts, cells, calls."""
    pose: Array = np.full(6, np.nan)
    """Poses at the end [m, rad], (..., 6)."""

    @property
    def each(self) -> float:
        """Time of a tick, a device [s]."""
        return self.seconds / self.ticks / (self.devices or 1)


def columns(runs: Mapping[str, Run | Sequence[Run]], counted: str = "tick") -> dict[str, dict[str, float]]:
    """Return total, devices, ticks, and time of a tick and device of each row: of several runs the median.

    Args:
        runs: One run or several by the name of the row.
        counted: What the section counts, in the singular.

    Raises:
        ValueError: If two runs of a row count different devices or ticks.
    """
    rows = {name: [some] if isinstance(some, Run) else list(some) for name, some in runs.items()}
    for name, some in rows.items():
        sizes = {(run.devices, run.ticks) for run in some}
        if len(sizes) != 1:
            raise ValueError(f"{name}: runs must count the same devices and {counted}s (got {sorted(sizes)})")
    first = {name: some[0] for name, some in rows.items()}
    devices: dict[str, float] = {name: run.devices for name, run in first.items() if run.devices is not None}
    seconds = {name: statistics.median(run.seconds for run in some) for name, some in rows.items()}
    each = {name: 1e6 * run._replace(seconds=seconds[name]).each for name, run in first.items()}
    return {
        "seconds": seconds,
        **({"devices": devices} if devices else {}),
        f"{counted}s": {name: run.ticks for name, run in first.items()},
        f"µs a {counted}{' and device' if devices else ''}": each,
    }


def driven(plant: SampledPlant, controller: Controller, ticks: int) -> Run:
    """Time a closed loop on a new plant."""
    start = time.perf_counter()
    last = drive(plant, controller, ticks)
    return Run(time.perf_counter() - start, math.prod(last.pose.shape[:-1]), last.tick, last.pose)


def timed(work: Callable[[], object]) -> float:
    """Return the time of one call [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def answered(work: Callable[[], Any], repeats: int = 1) -> tuple[float, Any]:
    """Return the least time of several calls [s], and the last result."""
    least = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        least = min(least, time.perf_counter() - start)
    return least, result


def in_turns(work: Mapping[str, Callable[[], Any]], turns: int) -> dict[str, list[Any]]:
    """Return what calls measure, times or runs, in turns: a busy machine slows all alike."""
    times: dict[str, list[Any]] = {name: [] for name in work}
    for _ in range(turns):
        for name, one in work.items():
            times[name].append(one())
    return times


def medians(times: Mapping[str, list[float]], scale: float) -> dict[str, float]:
    """Return the median of each [s], times a scale; of those that are no NaN."""
    return {name: float(np.nanmedian(values)) * scale for name, values in times.items()}


def ratio(one: list[float], other: list[float]) -> float:
    """Return the median of ratios pair by pair, of those that are no NaN."""
    return float(np.nanmedian(np.divide(one, other)))
