"""Costs of a simulated second, measured in turns."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial

from maglev_mj.controller import Controller
from maglev_mj.loop import drive
from maglev_mj.plants import SampledPlant

__all__ = ["closed_loop", "measure_costs", "median_times"]

_SHORT, _LONG = 2e-3, 0.1

Parts = tuple[SampledPlant, Controller, int]


def measure_costs(makers: Sequence[Callable[[], Parts]], seconds: Sequence[float], repeats: int) -> tuple[float, ...]:
    """Return the cost of a simulated second of each closed loop [s], the controller included; see `median_times`.

    Args:
        makers: Make plant, controller and number of samples.
        seconds: Time that each took before [s]; what took long is not run again.
        repeats: Turns.
    """
    quick = [place for place, taken in enumerate(seconds) if taken < _LONG]
    taken = list(seconds)
    found = median_times([partial(closed_loop, makers[place]) for place in quick], repeats)
    for place, median in zip(quick, found, strict=True):
        taken[place] = median
    simulated = [ticks * plant.period for plant, _, ticks in (make() for make in makers)]
    return tuple(cost / span for cost, span in zip(taken, simulated, strict=True))


def closed_loop(make: Callable[[], Parts]) -> Callable[[], object]:
    """Return a closed loop of new parts, ready to run."""
    return partial(drive, *make())


def median_times(prepare: Sequence[Callable[[], Callable[[], object]]], repeats: int) -> tuple[float, ...]:
    """Return how long each piece of work takes [s].

    Medians over repeats in turn, so that their ratios hold on a machine that is not alone. Short work counts several
    times a turn, after once that warms the processor's caches; what takes long has two turns only.

    Args:
        prepare: Each makes its work ready, which is not timed, and returns it.
        repeats: Turns.
    """
    times: list[list[float]] = [[] for _ in prepare]
    for turn in range(repeats):
        for kept, make in zip(times, prepare, strict=True):
            if turn > 1 and kept[0] > _LONG:
                continue
            first = _timed(make())
            kept += [first] if first > _LONG else [_timed(make()) for _ in range(min(math.ceil(_SHORT / first), 10))]
    return tuple(statistics.median(kept) for kept in times)


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
