"""Stability boundary against dense eigenvalue scans, over random loops and margins."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maglev_mj.control import LinearController, LowPass, Window
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.plants.hand import Hand, get_hand
from maglev_mj.theory import is_stable, largest_stable_stiffness, stable_ranges
from maglev_mj.theory.boundary import boundary_of, ranges_of, scales, stiffest_of
from maglev_mj.theory.loop_array import LoopArray, pd
from tests.sweeps import further, sweep

# a soft grip whose own resonance leaves walls stable again beyond ones that are not
ISLAND: dict[str, Any] = {
    "period": 8.5065e-3,
    "delay": 1.6242e-3,
    "mass": 0.30672,
    "hand": Hand(
        mass=1.70343, damping=5.66451, stiffness=363.848, grip_damping=23.7146, grip_stiffness=7005.97
    ),
}  # fmt: skip


def random_loop(random: np.random.Generator) -> LoopArray:
    """Return a loop of random rate, delay, mass, hand, lag, velocity estimate and prediction."""
    period = 10.0 ** random.uniform(-3.3, -2.0)
    late = random.choice([0.0, random.uniform(0.0, 1.0), random.uniform(0.0, 4.0), 1.0])
    arm: dict[str, Any] = {
        "mass": random.uniform(0.05, 2.0),
        "damping": random.uniform(0.0, 20.0),
        "stiffness": random.uniform(0.0, 800.0),
    }
    grip: dict[str, Any] = {"grip_damping": random.uniform(0.0, 30.0), "grip_stiffness": random.uniform(100.0, 20000.0)}
    chosen: dict[str, Any] = {
        "period": period,
        "delay": late * period,
        "mass": random.uniform(0.1, 2.0),
        "hand": (None, Hand(**arm), Hand(**arm, **grip))[random.integers(3)],
        "driver_lag": 10.0 ** random.uniform(-5.0, -3.5) * (random.random() < 0.4),
        "velocity": (None, Window(samples=3), LowPass(cutoff=10.0 ** random.uniform(1.0, 2.3)))[random.integers(3)],
        "prediction": random.uniform(0.0, 1.0) * period * (random.random() < 0.25),
    }
    return LoopArray(**chosen)


def dampings_of(loop: LoopArray, random: np.random.Generator, count: int) -> Array:
    return np.asarray(loop.moving_mass / np.asarray(loop.period) * 8.0 * 10.0 ** random.uniform(-4.0, 0.0, count))


@pytest.mark.parametrize("seed", [*range(6), *further(*range(6, 30))])
def test_every_wall_up_to_the_boundary_is_stable_and_the_next_is_not(seed: int) -> None:
    random = np.random.default_rng(seed)
    loop = random_loop(random)
    damping = dampings_of(loop, random, 12)
    top = 8.0 * float(loop.moving_mass) / float(np.asarray(loop.period)) ** 2
    found = boundary_of(loop, damping)
    below = np.concatenate([np.geomspace(1e-6, 1.0, 200), np.linspace(0.005, 1.0, 200)]) * (1.0 - 1e-9)
    assert is_stable(loop.spectral_radius(found[:, None] * below, damping[:, None]))[found > 0.0].all()
    inside = (found > 0.0) & (found < top)
    assert not is_stable(loop.spectral_radius(found * (1.0 + 1e-7), damping))[inside].any()
    none = found == 0.0
    assert not is_stable(loop.spectral_radius(1e-6 * top, damping[none])).any()


@pytest.mark.parametrize(("seed", "limit"), sweep(range(100, 112), [1.0, 0.97], every=6))
def test_ranges_are_those_of_a_dense_scan(seed: int, limit: float) -> None:
    random = np.random.default_rng(seed)
    loop = random_loop(random)
    top = 8.0 * float(loop.moving_mass) / float(np.asarray(loop.period)) ** 2
    stiffness = top * np.geomspace(1e-7, 1.0, 3000)
    for damping in dampings_of(loop, random, 4):
        stable = is_stable(loop.spectral_radius(stiffness, damping), limit)
        inside, near = np.zeros(stiffness.size, dtype=bool), np.zeros(stiffness.size, dtype=bool)
        for low, high in ranges_of(loop, float(damping), limit):
            inside |= (stiffness >= low) & (stiffness <= high)
            near |= (abs(stiffness / max(low, 1e-9) - 1.0) < 1e-6) | (abs(stiffness / high - 1.0) < 1e-6)
        np.testing.assert_array_equal(stable[~near], inside[~near])


def test_an_island_is_named_and_not_taken() -> None:
    ranges = np.array(stable_ranges(3.48, **ISLAND))
    np.testing.assert_allclose(ranges, [[0.0, 2642.2583], [6941.5018, 7068.2785]], rtol=1e-7)
    assert largest_stable_stiffness(3.48, **ISLAND) == pytest.approx(2642.258, rel=1e-6)


HELD = "none", "rigid", "published", "lightly damped", "undamped", "heavy"


def held_loop(seed: int) -> LoopArray:
    """Return a random loop of the six kinds of hands in turn."""
    random = np.random.default_rng(seed)
    mass, stiffness, grip = (10.0 ** random.uniform(*ends) for ends in ((-1.5, 0.5), (0.0, 3.0), (2.0, 4.5)))
    soft = {"mass": mass, "stiffness": stiffness, "grip_stiffness": grip}
    own, between = 2.0 * np.sqrt(mass * np.array([stiffness, grip])) * 10.0 ** random.uniform(-3.0, -1.0, 2)
    less = random.random(4) < 0.5
    hands = {
        "none": None,
        "rigid": Hand(mass=random.uniform(0.05, 2.0), damping=random.uniform(0.0, 20.0), stiffness=stiffness),
        "published": get_hand(str(random.choice(["arm", "stylus", "fingertip"]))),
        "lightly damped": Hand(**soft, damping=own, grip_damping=between),
        "undamped": Hand(**soft),
        "heavy": Hand(
            mass=10.0 ** random.uniform(0.5, 1.7),
            damping=random.uniform(0.0, 20.0) * less[0],
            stiffness=random.uniform(0.0, 800.0) * less[1],
            grip_damping=random.uniform(0.0, 100.0) * less[2],
            grip_stiffness=10.0 ** random.uniform(3.0, 6.0),
        ),
    }
    period = 10.0 ** random.uniform(-math.log10(2000.0), -2.0)
    late = random.choice([0.0, random.uniform(0.0, 1.0), 1.0, random.uniform(1.0, 2.0)])
    mass = 10.0 ** random.uniform(-1.0, 0.5)
    return LoopArray(period=period, delay=late * period, mass=mass, hand=hands[HELD[seed % 6]])


@pytest.mark.parametrize(
    ("seeds", "count"),
    [(range(1, 4), 300), *(pytest.param(range(first, 300, 10), 4000, marks=pytest.mark.study) for first in range(10))],
)
def test_no_wall_of_a_dense_scan_is_stiffer_than_the_stiffest(seeds: range, count: int) -> None:
    for seed in seeds:
        loop = held_loop(seed)
        scan = boundary_of(loop, np.array([0.0, *np.geomspace(8e-5, 8.0, count - 1)]) * float(scales(loop)[1]))
        found = stiffest_of(loop)
        assert float(found.stiffness) >= scan.max() * (1.0 - 1e-4), seed
        assert found.stiffness == pytest.approx(float(boundary_of(loop, found.damping)), rel=1e-9)  # asked alone


UNDAMPED = LoopArray(hand=Hand(mass=50.0, grip_stiffness=1e6))
SOFT = LoopArray(
    period=8.95e-3,
    delay=0.0,
    mass=0.3704,
    hand=Hand(mass=0.09998, damping=3.4292, stiffness=396.06, grip_damping=2.4546, grip_stiffness=2123.8),
)


@pytest.mark.parametrize(("loop", "stiffness"), [(UNDAMPED, 22454.34), (SOFT, 7936.464)])
def test_a_stiffest_wall_on_a_jump_is_found_and_named(loop: LoopArray, stiffness: float) -> None:
    found = stiffest_of(loop)
    assert float(found.stiffness) == pytest.approx(stiffness, rel=1e-6)
    assert found.on_jump and found.describe().endswith("N s/m, at a jump of the boundary")
    beside = boundary_of(loop, float(found.damping) * np.array([1.0 - 1e-4, 1.0 + 1e-4]))
    assert beside.min() < 0.99 * found.stiffness
    plain = stiffest_of(replace(loop, hand=None))
    assert not plain.on_jump and plain.describe().endswith("N s/m")
    several = stiffest_of(LoopArray(hand=Hand(mass=np.array([50.0, 1.0]), grip_stiffness=1e6)))
    assert several.on_jump.tolist() == [True, False] and several.stiffness.shape == (2,)
    assert largest_stable_stiffness(delay=np.empty((0, 2))).stiffness.shape == (0, 2)


# of the second, walls of 2e-6 N/m at 3e-8 N s/m seem stable: rounding
@pytest.mark.parametrize(
    "hand",
    [
        Hand(stiffness=5e4),
        Hand(mass=0.04303898803108822, stiffness=153.9000777684674, grip_stiffness=21653.888990913685),
    ],
)
def test_no_wall_is_stable_where_none_but_of_rounding_is(hand: Hand) -> None:
    period = 0.0065823829718961654
    one = largest_stable_stiffness(period=period, delay=period, mass=0.5584942084002594, hand=hand)
    assert [value.item() for value in one] == [0.0, 0.0, False]
    assert one.describe() == "none: no wall is stable"


@pytest.mark.parametrize(("damping", "stiffness"), [(5.0, 5.5091955), (20.0, 22.0354686)])
def test_the_stiffest_wall_may_have_no_damping_at_all(damping: float, stiffness: float) -> None:
    # behind this grip any damping of the wall feeds the resonance, and the arm alone bears a soft wall
    loop = LoopArray(delay=0.005, hand=Hand(mass=10.0, damping=damping, grip_stiffness=30000.0))
    found = stiffest_of(loop)
    assert found.damping == 0.0 and float(found.stiffness) == pytest.approx(stiffness, rel=1e-6)
    assert is_stable(loop.spectral_radius(0.999 * found.stiffness, 0.0))
    assert not is_stable(loop.spectral_radius(found.stiffness, np.geomspace(0.1, 1000.0, 400))).any()


def test_a_maximum_that_is_a_narrow_point_is_found() -> None:
    hand = Hand(
        mass=0.09110459,
        damping=0.1696513,
        stiffness=1801.002,
        grip_damping=0.004873455,
        grip_stiffness=80.54509,
    )
    loop = LoopArray(period=0.007477498, delay=0.0009048618, mass=0.9563588, hand=hand)
    broad, narrow = (boundary_of(loop, np.linspace(*ends, 250)).max() for ends in ((80.0, 105.0), (108.6, 108.8)))
    assert 1.001 < narrow / broad < 1.0011
    assert float(stiffest_of(loop).stiffness) >= narrow * (1.0 - 1e-6)


def test_the_stiffest_wall_is_found_where_rounding_moves_the_extreme_of_the_curve() -> None:
    grip: dict[str, Any] = {"grip_damping": 5.255968574528895, "grip_stiffness": 303.05798920824077}
    loop = LoopArray(
        period=0.00038868256085192215,
        delay=0.003109460486815377,
        mass=1.144867948611289,
        hand=Hand(mass=0.036934050333148866, damping=0.30835285690314435, stiffness=86.7280435217133, **grip),
        driver_lag=8e-5,
        velocity=LowPass(cutoff=78.01673581424564),
    )
    found = stiffest_of(loop)
    for share in (np.linspace(0.98, 1.02, 11), np.linspace(0.5, 1.5, 31)):
        dense = boundary_of(loop, float(found.damping) * share)
        assert float(found.stiffness) >= dense.max() * (1.0 - 1e-8)


def test_a_design_that_is_not_linear_in_its_gains_is_refused() -> None:
    def squared(stiffness: Any, damping: Any, period: Any) -> LinearController:
        return pd()(stiffness**2, damping, period)

    with pytest.raises(ParameterError, match="linear in its gains"):
        boundary_of(LoopArray(design=squared), np.asarray(20.0))
    with pytest.raises(ParameterError, match="loop must be a single one"):
        stable_ranges(20.0, delay=[0.0, 0.001])
    with pytest.raises(ParameterError, match="limit must be"):
        stable_ranges(20.0, limit=1.5)
