"""Cost of the theory's answers.

Stiffest wall, boundary, a designed wall, and a setting that is checked.
"""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from maglev_mj.control import FiniteDifference, LowPass, VelocityEstimator, Window
from maglev_mj.errors import ParameterError
from maglev_mj.interop.foxglove.settings import State, checked
from maglev_mj.plants.hand import get_hand
from maglev_mj.scenes import BUILT_IN, find_scene
from maglev_mj.scenes.scene import Scene
from maglev_mj.session import settable
from maglev_mj.theory import WallRequirements, design_wall, is_stable, largest_modulus, largest_stable_stiffness
from maglev_mj.theory.closed_loop import LoopKeywords
from maglev_mj.views.margin import margin

HANDS = "none", "arm", "stylus", "fingertip", "0.1,5,300,20,5000"
ESTIMATES: Sequence[VelocityEstimator] = (FiniteDifference(), LowPass(), Window(samples=8))
DELAYS = 0.0, 0.3, 1.0, 1.5, 3.0, 5.0, 10.0
DESIGNED: dict[str, Any] = {
    "mass": (0.56, 0.84),
    "delay": (0.0012, 0.0018),
    "hands": ("none", "arm", "stylus", "fingertip"),
}
_COUNT, _FEW, _REPEATS = 40, 6, 2
_APART = 1e-7


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
    """Return seconds of each answer, and its errors, over many loops the median and the worst."""
    chosen = loops(_FEW if quick else _COUNT)
    repeats = 1 if quick else _REPEATS
    stiffest, single, curve, wrong = [], [], [], 0
    for loop in chosen:
        seconds, best = _timed(partial(largest_stable_stiffness, **loop), repeats)
        stiffest.append(seconds)
        damping = 0.7 * float(best.damping)
        seconds, boundary = _timed(partial(largest_stable_stiffness, damping, **loop), repeats)
        single.append(seconds)
        beside = largest_modulus(boundary * [1.0 - _APART, 1.0 + _APART], damping, **loop)
        wrong += int(is_stable(beside).tolist() != [True, False])
    dampings = np.linspace(0.0, 200.0, 60)
    for late in (0.0, 0.0015, 0.005):
        curve.append(_timed(partial(largest_stable_stiffness, dampings, delay=late), repeats)[0])
    seconds, wall = _timed(partial(design_wall, WallRequirements(**DESIGNED)), 1)
    return {
        "stiffest wall": _spread(stiffest),
        "boundary at a damping": {**_spread(single), "verdicts that differ 1e-7 beside it": wrong},
        "curve of 60 dampings": _spread(curve),
        "design_wall": {"seconds": seconds, "modulus beyond 0.97": wall.modulus - 0.97, "stiffness": wall.stiffness},
        "settings": _settings(repeats),
    }


def _settings(repeats: int) -> dict[str, Any]:
    """Return seconds to check a setting, over the scenes.

    To refuse it, to accept it, and to compute a margin.
    """
    refused: list[float] = []
    accepted: list[float] = []
    margins = []
    for scene in (find_scene(name)() for name in BUILT_IN):
        margins.append(_timed(partial(margin, scene), repeats)[0])
        if "stiffness" not in settable(scene):
            continue
        state, present = State(scene, scene.delay, None, "running"), float(scene.as_json()["stiffness"])
        for gain, times in ((0.9 * present, accepted), (6e4, refused)):
            seconds, verdict = _timed(partial(checked, state, {"stiffness": gain}), repeats)
            if isinstance(verdict, Scene) != (times is accepted):
                raise ParameterError(f"the verdict on {scene.name} must be the other, not {verdict}")
            times.append(seconds)
    return {"refused": _spread(refused), "accepted": _spread(accepted), "margin": _spread(margins)}


def _timed(answer: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Return the least time of several calls [s], and the last result."""
    least = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        result = answer()
        least = min(least, time.perf_counter() - start)
    return least, result


def _spread(seconds: Sequence[float]) -> dict[str, float]:
    return {"median": statistics.median(seconds), "worst": max(seconds)}
