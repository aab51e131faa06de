"""Times of calls, in turns, for the sections of bench.py."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


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


def in_turns(work: Mapping[str, Callable[[], float]], turns: int) -> dict[str, list[float]]:
    """Return times that calls measure, in turns: a busy machine slows all alike."""
    times: dict[str, list[float]] = {name: [] for name in work}
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
