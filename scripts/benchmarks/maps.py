"""Cost of stability maps simulated in the engine.

The whole one takes too long for here: `maglev-mj stability --plant mujoco --grid 60`.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.theory import is_stable

_GRID, _QUICK, _HELD = 24, 6, 4


def measure(quick: bool) -> dict[str, Any]:
    """Return seconds of maps, and verdicts that differ from theory.

    In MuJoCo and on the exact plant.
    """
    grid = _QUICK if quick else _GRID
    found = {"mujoco": _map("mujoco", grid), "exact": _map("exact", grid)}
    if not quick:
        found["mujoco, in a stylus"] = _map("mujoco", _HELD, hand="stylus")
    return found


def _map(plant: str, grid: int, **around: Any) -> dict[str, float]:
    start = time.perf_counter()
    result = run_stability(StabilityParameters(plant=plant, grid=grid, **around))
    seconds = time.perf_counter() - start
    return {
        "seconds": seconds,
        "cells": grid * grid,
        "verdicts that differ from theory": int(np.sum(is_stable(result.modulus) != result.simulated)),
    }
