"""Cost of answers: stiffest wall, boundary, designed wall, checked scene, diagnosed loops, map in the engine."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from maglev_mj import diagnose
from maglev_mj.control import FiniteDifference, LowPass, VelocityEstimator, Window
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import get_hand
from maglev_mj.scenes import BUILT_IN, find_scene
from maglev_mj.scenes.stability_check import stability_warning
from maglev_mj.session import settable_parameters
from maglev_mj.session.margin import margin
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.theory import WallRequirements, design_wall, largest_stable_stiffness
from maglev_mj.theory.loop_array import LoopKeywords
from system import Table
from timing import Run, answered, columns

HANDS = "none", "arm", "stylus", "fingertip", "0.1,5,300,20,5000"
ESTIMATES: Sequence[VelocityEstimator] = (FiniteDifference(), LowPass(), Window(samples=8))
DELAYS = 0.0, 0.3, 1.0, 1.5, 3.0, 5.0, 10.0
DESIGNED: dict[str, Any] = {"mass": (0.56, 0.84), "delay": (0.0012, 0.0018), "hand": HANDS[:4]}


def loops(count: int) -> list[LoopKeywords]:
    """Return loops spread over rate, delay, hand, driver lag, velocity estimate and prediction, the hardest first."""

    def keywords(period: float, late: float, hand: str, lag: float, velocity: Any, ahead: float) -> LoopKeywords:
        loop: LoopKeywords = {"period": period, "delay": late * period, "hand": get_hand(hand), "driver_lag": lag}
        return {**loop, "velocity": velocity, "prediction": ahead * period}

    every = list(itertools.product((0.0005, 0.005), DELAYS, HANDS, (0.0, 8e-5), ESTIMATES, (0.0, 0.5)))
    order = np.random.default_rng(1).permutation(len(every))[: count - 1]
    hardest = 0.0005, DELAYS[-1], HANDS[-1], 8e-5, ESTIMATES[-1], 0.0
    return [keywords(*loop) for loop in (hardest, *(every[index] for index in order))]


def arrays(count: int) -> dict[str, Any]:
    """Return values of random loops, for `diagnose`: some 40 % are unstable."""
    rng = np.random.default_rng(1)
    period = 10.0 ** rng.uniform(-3.3, -2.0, count)
    gains = {"stiffness": 10.0 ** rng.uniform(1.0, 4.0, count), "damping": 10.0 ** rng.uniform(-1.0, 2.0, count)}
    delay, mass = period * rng.uniform(0.0, 2.0, count), 10.0 ** rng.uniform(-1.0, 0.5, count)
    return {**gains, "period": period, "delay": delay, "mass": mass}


def _diagnosed(count: int, figure: str) -> Any:
    """Return a figure of random loops, which computes it, or a function of them."""
    found = getattr(diagnose(**arrays(count)), figure)
    return found() if callable(found) else found


def measure(quick: bool) -> dict[str, Table]:
    """Return the time of each answer, over many loops also the median and the worst."""
    repeats, grid = (1, 6) if quick else (2, 24)
    seconds: dict[str, list[float]] = {}

    def answer(name: str, question: partial[Any], times: int = repeats) -> Any:
        least, result = answered(question, times)
        seconds.setdefault(name, []).append(least)
        return result

    for loop in loops(6 if quick else 40):
        best = answer("stiffest wall", partial(largest_stable_stiffness, **loop))
        answer("boundary at a damping", partial(largest_stable_stiffness, 0.7 * float(best.damping), **loop))
    for scene in (find_scene(name)() for name in BUILT_IN):
        answer("margin", partial(margin, scene))
        if "stiffness" in settable_parameters(scene):
            unstable = scene.replace(stiffness=6e4)
            if answer("unstable scene", partial(stability_warning, unstable)) is None:
                raise ParameterError(f"{scene.name} must be unstable at 60000 N/m")
    answer("design_wall", partial(design_wall, WallRequirements(**DESIGNED)), 1)
    mapped = f"map of {grid} x {grid} in MuJoCo"
    found = answer(mapped, partial(run_stability, StabilityParameters(plant="mujoco", grid=grid)), 1)
    devices = dict.fromkeys(seconds, 1) | {mapped: found.simulated.size}
    if find_spec("maglev_mj.studies.diagnosed_loops"):  # not before version 0.4
        many = 100 if quick else 10_000
        diagnosed = {f"critical stiffness of {many} loops": "ratio", f"all columns of {many} loops": "columns"}
        for name, figure in diagnosed.items():
            answer(name, partial(_diagnosed, many, figure), 1)
            devices[name] = many
    return {
        "answers": {
            **columns({name: Run(sum(some), devices[name], len(some)) for name, some in seconds.items()}, "call"),
            "median": {name: statistics.median(some) for name, some in seconds.items()},
            "worst": {name: max(some) for name, some in seconds.items()},
        }
    }
