"""Simulated walls against the exact map: grids, hands, and integrators that shift the boundary."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from maglev_mj.control import LowPass, VelocityEstimator
from maglev_mj.errors import ParameterError
from maglev_mj.plants import Timing
from maglev_mj.plants.hand import HANDS, get_hand
from maglev_mj.studies import stability_map as growing
from maglev_mj.studies.levels import _SteppedLoop, boundary_shift
from maglev_mj.studies.stability_map import (
    RestingWall,
    StabilityParameters,
    measure_growth,
    run_stability,
)
from maglev_mj.theory import critical_delay, largest_stable_stiffness, spectral_radius, stiffest_wall
from maglev_mj.theory.boundary import boundary_of, stiffest_of
from maglev_mj.theory.loop_array import LoopArray
from tests.sweeps import further
from tests.theory.failures import random_delay_rate

T, M = 0.005, 0.7
DELAYS = (0.0, 0.0015, 0.003, 0.005)


@pytest.mark.parametrize(
    ("plant", "grid", "delay"),
    [
        ("exact", 6, 0.005),
        *further(*((plant, grid, delay) for plant, grid in (("exact", 60), ("mujoco", 24)) for delay in DELAYS)),
    ],
)
def test_every_cell_of_the_map_settles_or_grows_as_theory_has_it(plant: str, grid: int, delay: float) -> None:
    # Except within half a percent of the boundary; 60 x 60 on MuJoCo: `maglev-mj map --of mujoco`.
    result = run_stability(StabilityParameters(plant=plant, grid=grid, delay=delay))
    assert result.simulated is not None and result.disagreement is not None
    assert not result.disagreement.any()
    share = result.simulated.mean()
    assert 0.3 < share < 0.7 and result.near.mean() < 0.05  # a map of both kinds, with little left out


def walls(stiffness: ArrayLike, damping: ArrayLike, **values: Any) -> list[RestingWall]:
    pairs = np.broadcast_arrays(np.atleast_1d(stiffness), damping)
    return [RestingWall(stiffness=k, damping=b, **values) for k, b in zip(*(pair.tolist() for pair in pairs))]


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.study)])
def test_growth_is_the_spectral_radius(count: int) -> None:
    # Over a random sample, away from pairs of modes that beat.
    random = np.random.default_rng(4)
    k, b = random.uniform(500.0, 9000.0, count), random.uniform(10.0, 100.0, count)
    growth = measure_growth(walls(k, b))
    radius = spectral_radius(k, b, period=T, delay=0.0015)
    long = growth.ticks > 200
    assert long.sum() > count / 4
    np.testing.assert_allclose(np.log(growth.rate[long]), np.log(radius[long]), atol=0.01)


SOFT = "0.2,10,200,2,800"
"""A hand with a soft grip."""


class Averaged(RestingWall):
    """A wall with another velocity estimate."""

    def velocity_estimator(self) -> VelocityEstimator:
        return LowPass(50.0)


@pytest.mark.parametrize(
    ("wall", "damping", "around", "plant"),
    [
        (RestingWall(hand="arm"), 70.0, {"hand": "arm"}, "exact"),
        (RestingWall(hand=SOFT), 70.0, {"hand": SOFT}, "exact"),
        (Averaged(), 30.0, {"velocity": LowPass(50.0)}, "exact"),
        *further(
            (Averaged(), 30.0, {"velocity": LowPass(50.0)}, "mujoco"),
            *(
                (RestingWall(hand=hand), 70.0, {"hand": hand}, plant)
                for hand in (*HANDS, SOFT, "0.6,0,1050", "0.02,28,40")
                for plant in ("exact", "mujoco")
            ),
        ),
    ],
)
def test_hands_and_estimates_shift_the_boundary_as_the_map_says(
    wall: RestingWall, damping: float, around: dict[str, Any], plant: str
) -> None:
    # 5 % below the boundary it settles, 5 % above it grows; on the engine as on the exact plant.
    around = {**around, "hand": get_hand(around.get("hand", "none"))}
    boundary = float(largest_stable_stiffness(damping, period=T, delay=0.0015, **around))
    two = [wall.replace(stiffness=share * boundary, damping=damping) for share in (0.95, 1.05)]
    assert measure_growth(two, plant).stable.tolist() == [True, False]


@pytest.mark.parametrize(
    ("steps", "delay"),
    [([5e-5, 1e-4], 0.0015), *further(*(([2e-5, 5e-5, 1e-4], delay) for delay in (0.0, 0.0015, 0.005)))],
)
@pytest.mark.parametrize("integrator", ["euler", "implicit", "implicitfast", "discrete"])
def test_semi_implicit_steps_overstate_the_boundary_to_first_order(
    integrator: str, steps: list[float], delay: float
) -> None:
    # Numerical damping hides instability: at every step an unstable wall looks stable, in proportion to it.
    loop = LoopArray(period=T, delay=delay)
    shift = np.array([boundary_shift(integrator, step, loop) for step in steps])
    assert (shift > 0.0).all()
    assert np.polyfit(np.log(steps), np.log(shift), 1)[0] == pytest.approx(1.0, abs=0.05)


def test_steps_that_miss_the_switch_lengthen_the_delay() -> None:
    # RK4 at 1 ms sees a delay of 1.5 ms as 2 ms.
    found = stiffest_of(_SteppedLoop(period=T, delay=0.0015, integrator="rk4", step=1e-3, aligned=False)).stiffness
    assert found == pytest.approx(float(stiffest_wall(period=T, delay=0.002).stiffness), rel=1e-6)


@pytest.mark.parametrize(
    ("dampings", "margin"), [([110.0], 0.03), pytest.param([60.0, 90.0, 110.0], 0.005, marks=pytest.mark.study)]
)
def test_a_simulation_in_closed_loop_agrees_with_the_measured_shift(dampings: list[float], margin: float) -> None:
    # MuJoCo itself, with Euler at 0.5 ms, settles in walls that are unstable, and that grow without long steps.
    b = np.array(dampings)
    shifted = boundary_of(_SteppedLoop(period=T, delay=0.0015, integrator="euler", step=5e-4), b)
    assert (shifted > 1.03 * largest_stable_stiffness(b, period=T, delay=0.0015)).all()
    below, above = (walls(share * shifted, b) for share in (1.0 - margin, 1.0 + margin))
    found = measure_growth(below + above, "mujoco", integrator="euler", longest_step=5e-4).stable
    assert found.tolist() == [True] * b.size + [False] * b.size
    assert not measure_growth(below, "mujoco").stable.any()


@pytest.mark.parametrize(("mean", "jitter"), [(0.003, 0.002), (0.0034, 0.0015)])
def test_random_delay_acts_as_its_mean_and_not_as_its_worst(mean: float, jitter: float) -> None:
    # A third of the delays may be too long; only the mean being too long makes the loop grow, in the plant too.
    k, b = 6000.0, 80.0
    critical = float(critical_delay(k, b, period=T))
    delays = [Timing(delay=mean, jitter=jitter, seed=0).rest_at(tick) for tick in range(2000)]
    assert np.mean(np.array(delays) > critical) > 0.25
    assert (random_delay_rate(k, b, delays) < 1.0) == (mean < critical)
    wall = RestingWall(delay=mean)
    growth = measure_growth([wall], timing=replace(wall.timing(), jitter=jitter))
    assert bool(growth.stable[0]) == (mean < critical)


def test_bad_resting_walls_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"plant must be one of exact, mujoco \(got 'moon'\)"):
        measure_growth([RestingWall()], "moon")
    with pytest.raises(ParameterError, match="stiffness must be above 0"):
        RestingWall(stiffness=0.0)
    with pytest.raises(ParameterError, match="integrator must be one of"):
        measure_growth([RestingWall()], "mujoco", integrator="magic")


@pytest.mark.parametrize("rate", [0.999, 0.9999, 1.0001, 1.001])
def test_a_loop_that_no_block_decides_is_judged_by_its_trend(rate: float) -> None:
    # beside one that grew a thousandfold at once and one that decayed
    blocks = np.arange(16)
    slow = rate ** (growing._BLOCK * blocks)
    assert 1.0 / growing._DECIDED < slow.min() and slow.max() < growing._DECIDED
    sizes = np.stack(
        [slow, 10.0 * growing._DECIDED ** (blocks + 1.0), 0.1 * growing._DECIDED ** -(blocks + 1.0)], axis=1
    )
    found, decided = growing._growths(sizes, last=True)
    assert decided.all() and found.stable.tolist() == [rate < 1.0, False, True]
    assert found.rate[0] == pytest.approx(rate, rel=1e-12)
    _, decided = growing._growths(sizes, last=False)
    assert decided.tolist() == [False, True, True]


def test_walls_of_several_loops_have_their_own_growth_in_their_own_place() -> None:
    # Runs end when the last of a batch is decided: others are as they are alone.
    periods = (0.005, 0.004, 0.003, 0.005, 0.004)
    walls = [RestingWall(stiffness=4000.0 * (1 + place), period=period) for place, period in enumerate(periods)]
    found, alone = measure_growth(walls), [measure_growth([wall]) for wall in walls]
    assert found.rate.tolist() == [one.rate[0] for one in alone] and len(set(found.rate)) == 5
    assert found.stable.tolist() == [one.stable[0] for one in alone] and len(set(found.stable)) == 2
    assert found.ticks.tolist() == [one.ticks[0] for one in alone]
