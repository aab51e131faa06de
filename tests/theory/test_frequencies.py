"""Extrema and crossings over frequency, against dense grids."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from maglev_mj.plants.hand import Mode
from maglev_mj.studies.card import _transparent
from maglev_mj.theory import least_dynamic_stiffness, least_passive_damping
from maglev_mj.theory.boundary import rigid_note
from maglev_mj.theory.frequencies import HIGHEST, angles_of, first_crossing, peak
from maglev_mj.theory.loop_array import LoopArray, is_stable, pd, rendered_stiffness

DENSE = np.sort(np.concatenate([np.linspace(0.0, HIGHEST, 10_000), np.geomspace(1e-5, HIGHEST, 10_000)]))


def loops(seed: int, count: int) -> Iterator[tuple[dict[str, Any], float, float]]:
    """Yield random stable loops with their stiffness and damping."""
    random = np.random.default_rng(seed)
    while count:
        period, mass = 10.0 ** random.uniform(-4.0, -2.0), 10.0 ** random.uniform(-1.3, 0.5)
        loop: dict[str, Any] = {"period": period, "delay": period * random.uniform(0.0, 3.0), "mass": mass}
        if random.random() < 0.4:
            loop["hand"] = str(random.choice(["arm", "stylus", "fingertip"]))
        if random.random() < 0.4:
            loop["mode"] = Mode(
                random.uniform(0.1, 2.0) / period, 10.0 ** random.uniform(-3, -1), random.uniform(-1, 1)
            )
        if random.random() < 0.4:
            loop["driver_lag"] = min(0.01, period * random.uniform(0.0, 1.0))
        if random.random() < 0.4:
            loop["own_damping"] = 10.0 ** random.uniform(-1.0, 1.0)
        stiffness = mass / period**2 * 10.0 ** random.uniform(-4.0, -0.3)
        damping = mass / period * 10.0 ** random.uniform(-3.0, 0.0)
        if is_stable(LoopArray(**loop).spectral_radius(stiffness, damping)):
            count -= 1
            yield loop, stiffness, damping


def test_the_least_dynamic_stiffness_is_the_least_over_all_frequencies() -> None:
    missed = 0
    for loop, *gains in loops(1, 20):
        forced = LoopArray(**loop).forced(*gains)
        dense, found = np.abs(forced.compliance(DENSE)).max(), 1.0 / float(least_dynamic_stiffness(*gains, **loop))
        assert found >= dense * (1.0 - 1e-4)
        angle, height = peak(forced.magnitude, angles_of(forced.poles))
        reached = np.abs(forced.compliance(angle[None]))[0]
        assert [reached, height] == pytest.approx([found] * 2, rel=1e-12)
        missed += found > 1.01 * np.abs(forced.compliance(np.linspace(0.0, HIGHEST, 50))).max()
    assert missed >= 5  # a fixed grid of fifty does not see it


def test_the_worst_hand_of_a_wall_is_named() -> None:
    least = {
        hand: float(least_dynamic_stiffness(6271.0, 64.1, period=0.005, delay=0.0018, mass=0.56, hand=hand))
        for hand in ("none", "arm", "stylus")
    }
    assert min(least, key=lambda hand: least[hand]) == "stylus"
    assert [least["stylus"], least["none"]] == pytest.approx([833.19, 974.36], abs=0.01)
    with_arrays = least_dynamic_stiffness([[6271.0], [5000.0]], [64.1, 70.0], period=0.005, delay=0.0018, mass=0.56)
    assert with_arrays.shape == (2, 2) and with_arrays[0, 0] == pytest.approx(least["none"], rel=1e-12)


def test_the_transparency_bandwidth_is_the_first_crossing() -> None:
    for loop, *gains in loops(2, 12):
        forced, period = LoopArray(**loop).forced(*gains), loop["period"]
        found = 2.0 * math.pi * period * _transparent(forced, gains[0], gains[1], period)

        def within(angles: Any) -> Any:
            return np.abs(np.log(np.abs(forced.compliance(angles)) * np.hypot(gains[0], gains[1] * angles / period)))  # noqa: B023

        outside = DENSE[within(DENSE) >= 0.5 * math.log(2.0)]
        assert found <= (outside[0] if outside.size else HIGHEST) * (1.0 + 1e-9)
        if 0.0 < found < HIGHEST:
            assert within(np.array([found]))[0] == pytest.approx(0.5 * math.log(2.0), abs=1e-9)
            assert within(np.linspace(0.0, found * (1.0 - 1e-9), 20_000)).max() < 0.5 * math.log(2.0)


def test_a_crossing_between_two_points_of_the_grid_is_found() -> None:
    grid = np.linspace(0.0, 1.0, 6)
    for place in (0.0, 0.31, 1.0):
        found = first_crossing(lambda x: (x - place) ** 2 - 1e-6, grid)  # noqa: B023
        assert found == pytest.approx(max(place - 1e-3, 0.0), abs=1e-9)
    assert first_crossing(lambda x: 1.0 + x, grid) == 1.0


def test_the_least_passive_damping_is_that_of_a_dense_grid() -> None:
    random, angles = np.random.default_rng(3), np.linspace(1e-5, np.pi, 20_000)
    for _ in range(10):
        period, (k, b) = 10.0 ** random.uniform(-4, -2), 10.0 ** random.uniform([1.0, 0.0], [4.0, 2.0])
        delay = period * random.uniform(0.0, 1.0)
        z, share = np.exp(1j * angles), delay / period
        wall = rendered_stiffness(pd()(*map(np.asarray, (k, b, period))), z)
        real = period * (wall * (1.0 - share + share / z) / (1.0 - z)).real
        dense = 0.5 * (real + np.sqrt(real**2 + share * (1.0 - share) * (period * np.abs(wall)) ** 2))
        found = float(least_passive_damping(k, b, period=period, delay=delay))
        assert found == pytest.approx(dense.max(), rel=1e-4) and found >= dense.max() * (1.0 - 1e-7)


def test_the_note_on_a_mode_names_the_first_rate_that_is_unstable() -> None:
    loop = LoopArray(period=0.005, delay=0.0015, mass=0.7, mode=Mode(1100.0, 0.01, -1.0))
    assert "unstable with this mode above 2149 Hz" in rigid_note(loop)


def test_a_peak_narrower_than_the_steps_of_the_grid_is_found() -> None:
    random = np.random.default_rng(4)
    for _ in range(50):
        poles = (1.0 - 10.0 ** random.uniform(-6.0, -3.0, 3)) * np.exp(1j * random.uniform(0.02, 3.0, 3))

        def size(x: Any) -> Any:
            return np.abs(1.0 / (np.exp(1j * x)[..., None] - poles)).sum(axis=-1)  # noqa: B023

        angle, height = peak(size, angles_of(poles))
        assert height >= size(np.angle(poles)).max() and np.abs(angle - np.angle(poles)).min() < 1e-3
