"""Runs of many ticks: their states and signals are packed into arrays block by block."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from typing import Any

import numpy as np
import pytest

from maglev_mj import DivergenceError, find_scene, run
from maglev_mj.plants import trace
from maglev_mj.scenes.results import RunResult
from tests.all_of import SCENES

RUN = sys.modules[RunResult.__module__.replace("results", "run")]
CASES = [*((name, "exact", phase) for name in SCENES for phase in (0.3, np.array([0.0, 0.5]))), ("drop", "mujoco", 0.3)]


def arrays(result: RunResult) -> dict[str, Any]:
    motion = {name: getattr(result.trace, name) for name in ("time", "pose", "twist", "wrench")}
    return {**motion, "sample_time": result.sample_time, **result.samples}


@pytest.mark.parametrize(("name", "plant", "phase"), CASES)
def test_a_run_is_the_same_in_blocks_of_any_size(name: str, plant: str, phase: Any, monkeypatch: Any) -> None:
    whole = arrays(run(name, plant=plant, phase=phase))
    for module in (trace, RUN):
        monkeypatch.setattr(module, "BLOCK", 4)
    parts = arrays(run(name, plant=plant, phase=phase))
    assert parts.keys() == whole.keys() and len(parts["time"]) > 8
    for key, column in parts.items():
        assert column.dtype == whole[key].dtype and np.array_equal(column, whole[key], equal_nan=True), key


def test_a_diverging_run_keeps_all_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace, "BLOCK", 10)
    drop: Any = find_scene("drop")
    scene = drop(duration=5.0, stiffness=40_000.0, force_limit=0.0)
    with pytest.raises(DivergenceError) as caught:
        run(scene, plant="exact")
    times = caught.value.partial.trace.time
    assert len(times) > 20 and times[0] == 0.0 and (np.diff(times) >= 0.0).all()


@pytest.mark.parametrize("name", ["drop", "stick-slip"])
def test_a_long_run_keeps_less_than_400_bytes_a_tick(name: str) -> None:
    """Two knots of 19 numbers are 304 bytes."""
    chosen: Any = find_scene(name)
    scene = chosen(duration=10.0)
    run(scene, plant="exact")
    gc.collect()
    tracemalloc.start()
    try:
        result = run(scene, plant="exact")
        gc.collect()  # the plant and its log
        held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert held < 400 * 10.0 / scene.period and len(result.trace.time) > 10.0 / scene.period
