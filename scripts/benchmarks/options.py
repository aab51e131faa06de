"""Cost of each option over the plain loop.

`measure` is a section of bench.py; its times are medians of repeats in turn, its ratios medians of theirs pair by pair.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control.timeline import Timing
from maglev_mj.frames import Array
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, MuJoCoPlant, SampledPlant, Sensor
from maglev_mj.plants.hand import Hand
from maglev_mj.scenes.drop import Drop
from maglev_mj.spec import Spec
from timing import Run, columns, driven, in_turns, ratio, timed

PLAIN = "plain"
START = np.array([0.5e-3, -0.3e-3, Spec.translation_range.value, 0.0, 0.0, 0.0])
JITTER = 1e-4
ANY_PLANT: Mapping[str, Mapping[str, Any]] = {
    PLAIN: {},
    "quantized sensor": {"sensor": Sensor(quantum=5e-6)},
    "quantized sensor with noise": {"sensor": Sensor(quantum=5e-6, noise=1e-6)},
    "jitter": {"timing": Timing(jitter=JITTER)},
    "wrench limit": {"wrench_limit": 60.0},
    "hand on z": {"hand": Hand(mass=0.1, damping=5.0, stiffness=100.0, axes="z")},
    "recording": {"record": True},
    "recording and its trace": {"record": True},
}
EXACT = {
    **ANY_PLANT,
    "driver lag": {"driver_lag": True},
    "dry friction on z": {"dry_friction": [0.0, 0.0, 0.01, 0.0, 0.0, 0.0]},
    "dry friction on all axes": {"dry_friction": 0.01},
}
ENGINE = {**ANY_PLANT, "current limit": {"current_limit": 10.0}}
_LONG, _SHORT = 400, 60


class Loop(NamedTuple):
    """A plant with options, its number of devices and ticks.

    Attributes:
        make: Makes the plant.
        options: Keywords of the plant by the option's name.
        pose: Pose at release [m, rad], (..., 6).
        ticks: Samples of a run that is timed.
        runs: How many of these.
    """

    make: Callable[..., SampledPlant]
    options: Mapping[str, Mapping[str, Any]]
    pose: Array
    ticks: int
    runs: int

    @property
    def devices(self) -> int:
        """Number of devices."""
        return math.prod(self.pose.shape[:-1])


def many(count: int, spread: float) -> Array:
    """Return random poses within a range [m, rad], (count, 6)."""
    return START + np.random.default_rng(1).uniform(-spread, spread, (count, 6))


_CORRECTED: dict[str, Any] = {"coils": False, "integrator": "corrected"}
LOOPS = {
    "exact plant": Loop(ExactPlant, EXACT, START, _LONG, 12),
    "corrected, body": Loop(partial(MuJoCoPlant, **_CORRECTED), ENGINE, START, _LONG, 8),
    "RK4, coils": Loop(MuJoCoPlant, ENGINE, START, _LONG, 4),
    "exact plant, 1000 alike": Loop(ExactPlant, EXACT, many(1000, 0.0), _SHORT, 6),
    "exact plant, 1000 apart": Loop(ExactPlant, EXACT, many(1000, 3e-4), _SHORT, 5),
    "exact plant, 100 000 alike": Loop(ExactPlant, EXACT, many(100_000, 0.0), 5, 3),
    "exact plant, 100 000 apart": Loop(ExactPlant, EXACT, many(100_000, 3e-4), 4, 3),
    "corrected, body, 1000 apart": Loop(
        partial(MuJoCoBatchPlant, threads=1, **_CORRECTED), ANY_PLANT, many(1000, 3e-4), 8, 2
    ),
}


def run(loop: Loop, name: str, ticks: int) -> Run:
    """Return a timed drop with an option."""
    plant = loop.make(**{"timing": Timing(), "pose": loop.pose, **loop.options[name]})
    ran = driven(plant, Drop().controller(), ticks)
    return ran._replace(seconds=ran.seconds + timed(plant.trace)) if "trace" in name else ran


def over_plain(loop: Loop, quick: bool) -> dict[str, Any]:
    """Return the cost of each option over the plain loop, and what each ran.

    Raises:
        ValueError: If an option ran another number of devices or ticks than the plain loop.
    """
    ticks = min(_SHORT, loop.ticks) if quick else loop.ticks
    runs = in_turns({name: partial(run, loop, name, ticks) for name in loop.options}, 1 if quick else loop.runs)
    times = {name: [one.seconds for one in some] for name, some in runs.items()}
    sizes = {name: (one.devices, one.ticks) for name, some in runs.items() for one in some}
    if len(set(sizes.values())) > 1:
        raise ValueError(f"devices and ticks must be the same for each option: {sizes}")
    return {"over plain": {name: ratio(values, times[PLAIN]) for name, values in times.items()}, **columns(runs)}


def measure(quick: bool) -> dict[str, Any]:
    """Return ratios to the plain loop by plant and option, devices and ticks; quick on small plants alone."""
    some = {name: loop for name, loop in LOOPS.items() if not quick or loop.devices <= 1000}
    return {name: over_plain(loop, quick) for name, loop in some.items()}
