"""Walls with prediction, passivity control, and perceived hardness."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from maglev_mj import Controller, ExactPlant, Sample, Timing, Wall, drive
from maglev_mj.control import HalfSampleWall, Law, PassivityController
from maglev_mj.plants.hand import exponential
from maglev_mj.plants.trace import PassivityObserver, actuator_work
from maglev_mj.scenes.figures import perceived_hardness
from tests.sweeps import sweep

T, M = 0.005, 0.7
PHASES = 12


def bounce(laws: list[Law], delay: float) -> tuple[NDArray[np.float64], PassivityObserver, Any]:
    """Return the restitution of energy at each phase, of a flotor thrown at a wall."""
    timing = Timing(period=T, delay=delay, phase=np.arange(PHASES) / PHASES)
    pose, twist = np.zeros((PHASES, 6)), np.zeros((PHASES, 6))
    pose[:, 2], twist[:, 2] = 3e-3, -0.2
    plant = ExactPlant(timing, pose=pose, twist=twist, gravity=0.0, record=True, escape=(1e3, 1.0))
    watch = PassivityObserver(timing, inertia=[M, M, M, 1e-3, 1e-3, 1e-3])
    drive(plant, Controller(laws, period=T), 200, observe=watch)
    trace = plant.trace()
    return (trace.twist[-1, :, 2] / 0.2) ** 2, watch, trace


def plain(stiffness: float) -> Wall:
    return Wall(axes="z", lower=0.0, stiffness=stiffness, damping=0.0)


@pytest.mark.parametrize("stiffness", [1000.0, 4000.0])
def test_half_sample_prediction_gives_back_what_it_took(stiffness: float) -> None:
    # The ideal spring returns all; the sampled one makes a third to four fifths more, prediction at most 4 %.
    ahead = HalfSampleWall(axes="z", stiffness=stiffness, period=T)
    predicted, sampled = bounce([ahead], 0.0)[0], bounce([plain(stiffness)], 0.0)[0]
    assert np.abs(predicted - 1.0).max() < 1e-5 * stiffness
    formula = math.exp(math.pi * 0.5 * T * math.sqrt(stiffness / M))
    np.testing.assert_allclose(sampled, formula, rtol=0.05)
    assert (predicted < sampled).all()


def test_the_line_across_the_edge_counts_for_its_part_inside() -> None:
    # Against the mean over the hold by quadrature, for every way of crossing, resting and missing the edge.
    law = HalfSampleWall(axes="z", lower=1e-3, stiffness=3000.0, damping=20.0, period=T)
    for place, speed in itertools.product(np.linspace(-2e-3, 4e-3, 25), (-0.4, -0.1, 0.0, 0.1, 0.4)):
        wrench: list[Any] = [0.0] * 6
        law([0.0, 0.0, place, 0.0, 0.0, 0.0], [0.0, 0.0, speed, 0.0, 0.0, 0.0], law.start(), wrench)
        time = T * (np.arange(20000) + 0.5) / 20000
        line = place - 1e-3 + speed * time
        mean = np.where(line <= 0.0, -3000.0 * line - 20.0 * speed, 0.0).mean()
        assert wrench[2] == pytest.approx(mean, abs=2e-3)


@pytest.mark.parametrize(("stiffness", "delay"), sweep([500.0, 2000.0, 4000.0], [0.0, 0.0015, 0.005], every=4))
def test_passivity_control_takes_away_what_the_wall_makes(stiffness: float, delay: float) -> None:
    control = PassivityController(axes="z", period=T, delay=delay, most=60.0)
    made, watch, _ = bounce([plain(stiffness)], delay)
    kept, controlled, _ = bounce([plain(stiffness), control], delay)
    assert made.min() > 1.2 and (watch.energy[:, 2] < 0.0).all()
    assert kept.max() < 1.0 + 1e-9 and controlled.energy[:, 2].min() > -1e-12


def test_passivity_control_of_2002_sees_no_energy_made_by_the_hold() -> None:
    # A force times the backward difference at its own sample counts K dx²/2 too much.
    watch = PassivityController(axes="z", period=T, most=60.0, paired=False)
    made, kept = bounce([plain(4000.0)], 0.0)[0], bounce([plain(4000.0), watch], 0.0)[0]
    np.testing.assert_array_equal(kept, made)
    assert (kept.min(), kept.max()) == pytest.approx((1.73, 1.85), abs=0.01)
    pushing = Controller([lambda x, v: [0.0, 0.0, 10.0 * v[2], 0.0, 0.0, 0.0], watch], period=T)
    forces = [pushing.step(Sample(tick, tick * T, [0.0, 0.0, 1e-3 * tick, 0.0, 0.0, 0.0])) for tick in range(3)]
    assert [command.force[2] for command in forces] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)  # its deficit at once
    assert pushing.signals["energy"] == pytest.approx([0.0], abs=1e-12)


def test_passivity_control_of_2002_is_the_recursion_of_its_source() -> None:
    # In the source's order, with the force on the environment: E += T f v + T alpha[k-1] v[k-1]², alpha = -E/(T v²)
    # where E < 0, and f + alpha v.
    random = np.random.default_rng(6)
    places = np.cumsum(random.normal(scale=1e-3, size=200))
    given = random.normal(size=200) + 10.0 * np.diff(places, prepend=places[0]) / T  # pushes along
    watch = PassivityController(axes="z", period=T, most=1e9, slow=1e-9, paired=False)
    rendered = iter(given)
    controller = Controller([lambda x, v: [0.0, 0.0, next(rendered), 0.0, 0.0, 0.0], watch], period=T)
    energy = alpha = before = 0.0
    acted = 0
    for tick, place in enumerate(places.tolist()):
        command = controller.step(Sample(tick, tick * T, [0.0, 0.0, place, 0.0, 0.0, 0.0])).force[2]
        speed = (place - places[tick - 1]) / T if tick else 0.0
        energy += T * -given[tick] * speed + T * alpha * before * before
        alpha = -energy / (T * speed * speed) if energy < 0.0 and speed else 0.0
        before = speed
        acted += alpha > 0.0
        assert command == pytest.approx(given[tick] - alpha * speed, rel=1e-6, abs=1e-6)
    assert acted > 20


@pytest.mark.parametrize(
    ("stiffness", "most", "after"),
    [(500.0, 1.11, 1.002), (2000.0, 1.33, 1.002), (4000.0, 1.58, 1.002), (20000.0, 3.41, 1.15)],
)
def test_passivity_control_balances_the_energy_from_the_third_sample_outside(
    stiffness: float, most: float, after: float
) -> None:
    # At every sample and phase: returned over absorbed energy.
    _, _, trace = bounce([plain(stiffness), PassivityController(axes="z", period=T, most=60.0)], 0.0)
    returned = (trace.twist[..., 2] / 0.2) ** 2
    outside = np.cumsum((trace.pose[..., 2] > 0.0) & (trace.twist[..., 2] > 0.0), axis=0)
    assert returned.max() == pytest.approx(most, abs=0.01)
    assert 1.0 + 1e-3 < returned[outside == 1].max() <= most and returned[outside >= 3].max() < after


def test_passivity_observer_without_inertia_is_exact_for_one_force_a_period() -> None:
    timing = Timing(period=T, delay=0.0)
    plant = ExactPlant(timing, pose=[0.0, 0.0, 3e-3, 0.0, 0.0, 0.0], record=True)
    watch = PassivityObserver(timing)
    drive(plant, Controller([plain(2000.0)], period=T), 100, observe=watch)
    # the trace goes on to the sample after the last one observed
    trace = plant.trace().until(99 * T)
    np.testing.assert_allclose(watch.energy[2], -actuator_work(trace)[:, 2].sum(), rtol=0.0, atol=1e-15)


def test_hardness_of_an_analog_wall_is_stiffness_and_damping_over_the_window() -> None:
    # Sampled so fast that it is analog: the force rises by some K v w + B v within a short window w.
    fast, window = 1e-5, 4e-3
    plant = ExactPlant(
        Timing(period=fast, delay=0.0),
        pose=[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0],
        twist=[0.0, 0.0, -0.2, 0.0, 0.0, 0.0],
        gravity=0.0,
        record=True,
    )
    wall = Wall(axes="z", lower=0.0, stiffness=3000.0, damping=10.0)
    drive(plant, Controller([wall], period=fast), 1500)
    hard = perceived_hardness(plant.trace(), window)
    place, speed = exponential(np.array([[0.0, 1.0], [-3000.0 / M, -10.0 / M]]) * window) @ [0.0, -1.0]
    assert hard.rate == pytest.approx((-3000.0 * place - 10.0 * speed) / window, rel=0.02)
    assert hard.rate == pytest.approx(3000.0 + 10.0 / window, rel=0.1)
    assert hard.extended >= hard.rate
