"""Times of calls, in turns, for the sections of bench.py."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from maglev_mj import Controller, drive
from maglev_mj.frames import Array
from maglev_mj.plants import SampledPlant


class Run(NamedTuple):
    """What was timed, by its own account: a cost is divided by what ran, never by what was asked for."""

    seconds: float
    devices: int
    ticks: int
    pose: Array
    """Poses at the end [m, rad], (..., 6)."""

    @property
    def each(self) -> float:
        """Time of a tick, a device [s]."""
        return self.seconds / self.ticks / self.devices


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
