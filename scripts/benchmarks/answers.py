"""Cost of answers: stiffest wall, boundary, designed wall, checked scene, map in the engine.

`measure` is a section of bench.py.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from maglev_mj.control import FiniteDifference, LowPass, VelocityEstimator, Window
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import get_hand
from maglev_mj.scenes import BUILT_IN, find_scene
from maglev_mj.session import settable, unstable_loop
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.theory import WallRequirements, design_wall, largest_stable_stiffness
from maglev_mj.theory.closed_loop import LoopKeywords
from maglev_mj.views.readings import margin
from timing import answered

HANDS = "none", "arm", "stylus", "fingertip", "0.1,5,300,20,5000"
ESTIMATES: Sequence[VelocityEstimator] = (FiniteDifference(), LowPass(), Window(samples=8))
DELAYS = 0.0, 0.3, 1.0, 1.5, 3.0, 5.0, 10.0
DESIGNED: dict[str, Any] = {
    "mass": (0.56, 0.84),
    "delay": (0.0012, 0.0018),
    "hands": ("none", "arm", "stylus", "fingertip"),
}
_COUNT, _FEW, _REPEATS = 40, 6, 2
_GRID, _QUICK_GRID = 24, 6


def loops(count: int) -> list[LoopKeywords]:
    """Return loops spread over all parameters, hardest first.

    Rate, delay, hand, driver lag, velocity estimate and prediction.
    """
    product = itertools.product((0.0005, 0.005), DELAYS, HANDS, (0.0, 8e-5), ESTIMATES, (0.0, 0.5))
    found: list[LoopKeywords] = [
        {
            "period": period,
            "delay": late * period,
            "hand": get_hand(hand),
            "driver_lag": lag,
            "velocity": velocity,
            "prediction": ahead * period,
        }
        for period, late, hand, lag, velocity, ahead in product
    ]
    order = np.random.default_rng(1).permutation(len(found))[: count - 1]
    hardest: LoopKeywords = {
        "period": 0.0005,
        "delay": 0.005,
        "hand": get_hand(HANDS[-1]),
        "driver_lag": 8e-5,
        "velocity": Window(samples=8),
    }
    return [hardest, *(found[place] for place in order)]


def measure(quick: bool) -> dict[str, Any]:
    """Return seconds of each answer, over many loops the median and the worst."""
    repeats, stiffest, single = 1 if quick else _REPEATS, [], []
    for loop in loops(_FEW if quick else _COUNT):
        seconds, best = answered(partial(largest_stable_stiffness, **loop), repeats)
        stiffest.append(seconds)
        single.append(answered(partial(largest_stable_stiffness, 0.7 * float(best.damping), **loop), repeats)[0])
    unstable, margins = [], []
    for scene in (find_scene(name)() for name in BUILT_IN):
        margins.append(answered(partial(margin, scene), repeats)[0])
        if "stiffness" in settable(scene):
            seconds, verdict = answered(partial(unstable_loop, scene.replace(stiffness=6e4)), repeats)
            if verdict is None:
                raise ParameterError(f"{scene.name} must be unstable at 60000 N/m")
            unstable.append(seconds)
    grid = _QUICK_GRID if quick else _GRID
    return {
        "stiffest wall": _spread(stiffest),
        "boundary at a damping": _spread(single),
        "design_wall": answered(partial(design_wall, WallRequirements(**DESIGNED)))[0],
        "unstable scene": _spread(unstable),
        "margin": _spread(margins),
        f"map of {grid} x {grid} in MuJoCo": answered(
            partial(run_stability, StabilityParameters(plant="mujoco", grid=grid))
        )[0],
    }


def _spread(seconds: Sequence[float]) -> dict[str, float]:
    return {"median": statistics.median(seconds), "worst": max(seconds)}
