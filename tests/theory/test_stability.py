"""Exact closed loop against published figures, derivations and three plants."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from maglev_mj import Controller, ExactPlant, Hold, MuJoCoPlant, Timing, drive
from maglev_mj.control import AdaptiveWindow, FiniteDifference, LowPass, VelocityEstimator, Window
from maglev_mj.errors import KeywordError, ParameterError
from maglev_mj.plants import MuJoCoBatchPlant
from maglev_mj.plants.hand import Hand, exponential, get_hand
from maglev_mj.spec import Spec
from maglev_mj.theory import (
    critical_delay,
    is_stable,
    largest_stable_stiffness,
    least_dynamic_stiffness,
    loop_array,
    spectral_radius,
    stiffest_wall,
)
from maglev_mj.theory.boundary import boundary_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import LoopArray, LoopKeywords, pd
from tests.sweeps import sweep

T, M = 0.005, 0.7
LAG = 1.0 / (2.0 * math.pi * Spec.driver_bandwidth.value)


@pytest.mark.parametrize(
    ("delay", "stiffness", "damping"),
    [(0.0, 19216.0, 116.0), (0.0015, 10173.0, 87.6), (0.003, 6516.9, 73.1), (0.005, 4045.0, 59.4)],
)
def test_stiffest_walls_of_the_device(delay: float, stiffness: float, damping: float) -> None:
    found = largest_stable_stiffness(period=T, delay=delay, mass=M)
    assert found.stiffness == pytest.approx(stiffness, rel=1e-3)
    assert found.damping == pytest.approx(damping, rel=1e-3)


def test_critical_delay_of_the_papers_wall() -> None:
    assert critical_delay(6000.0, 80.0, period=T, mass=M) == pytest.approx(3.257e-3, rel=1e-3)
    at = float(critical_delay(6000.0, 80.0, period=T))
    assert spectral_radius(6000.0, 80.0, period=T, delay=at) == pytest.approx(1.0, abs=1e-9)
    assert critical_delay([30000.0, 1e-3, 0.0], [80.0, 1.0, 0.0], period=T).tolist() == [
        0.0,
        pytest.approx(1.094069, rel=1e-6),  # also above 1 s
        math.inf,
    ]
    free, soft = critical_delay([0.0, 1e-3], 80.0, period=T)  # a damper alone is a wall in the limit of no stiffness
    assert free == pytest.approx(soft, rel=1e-5) and 0.009 < free < 0.0092


def test_equation_6_is_the_case_of_a_full_period() -> None:
    random = np.random.default_rng(0)
    k, b = random.uniform(100.0, 9000.0, 50), random.uniform(1.0, 150.0, 50)
    cp, cv = T**2 * k / (2.0 * M), T * b / (2.0 * M)
    rows = np.stack([np.ones(50), np.full(50, -2.0), 1.0 + cp + cv, cp, -cv], axis=-1)
    roots = [np.abs(np.roots(row)).max() for row in rows]
    np.testing.assert_allclose(spectral_radius(k, b, period=T, delay=T, mass=M), roots, rtol=1e-10)


def test_gains_and_loop_broadcast() -> None:
    hand = Hand(mass=np.array([0.1, 0.2, 0.3]), damping=5.0)
    delays = np.array([[0.0], [0.0015], [0.005], [0.0125]])
    together = spectral_radius(3000.0, 40.0, period=T, delay=delays, hand=hand)
    assert together.shape == (4, 3)
    for row, column in itertools.product(range(4), range(3)):
        one = Hand(mass=np.asarray(hand.mass)[column], damping=5.0)
        alone = spectral_radius(3000.0, 40.0, period=T, delay=delays[row, 0], hand=one)
        assert together[row, column] == pytest.approx(float(alone), rel=1e-12)
    # as arrays of two dimensions, where a transposed axis would show
    pairs = np.array([[0.0, 0.006, 0.002], [0.001, 0.0015, 0.012]])
    for function in (spectral_radius, least_dynamic_stiffness):
        whole = function(1500.0, 40.0, period=T, delay=pairs)
        single = [[float(function(1500.0, 40.0, period=T, delay=delay)) for delay in row] for row in pairs]
        np.testing.assert_allclose(whole, single, rtol=1e-9)
    ahead = spectral_radius(3000.0, 40.0, period=T, delay=0.0, prediction=[0.0, 0.001])
    assert ahead.shape == (2,) and ahead[0] != ahead[1]
    best = stiffest_wall(period=T, delay=delays[:, 0])
    assert best.stiffness.shape == (4,) and (np.diff(best.stiffness) < 0.0).all()


def test_half_sample_prediction_is_a_shift_of_the_damping() -> None:
    """So it reaches the same largest stiffness, at less damping."""
    plain, ahead = (stiffest_wall(period=T, delay=0.0015, prediction=p) for p in (0.0, 0.5 * T))
    assert ahead.stiffness == pytest.approx(float(plain.stiffness), rel=1e-9)
    assert ahead.damping + 0.5 * T * ahead.stiffness == pytest.approx(float(plain.damping), rel=1e-4)


def test_exponential_against_its_eigenvalues() -> None:
    random = np.random.default_rng(3)
    matrices = random.normal(size=(50, 5, 5)) * random.choice([0.01, 1.0, 30.0], (50, 1, 1))
    values, vectors = np.linalg.eig(matrices)
    expected = np.matmul(vectors * np.exp(values)[:, None, :], np.linalg.inv(vectors)).real
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    assert (np.abs(exponential(matrices) - expected) <= 1e-11 * size).all()
    nilpotent = np.array([[0.0, T], [0.0, 0.0]])
    np.testing.assert_array_equal(exponential(nilpotent), [[1.0, T], [0.0, 1.0]])


GRIP = Hand(mass=0.1, damping=5.0, stiffness=500.0, grip_damping=4.0, grip_stiffness=3000.0)
TICKS = 24
RIGID = Hand(mass=0.1, damping=5.0, stiffness=500.0)


def simulated(plant_type: Any, delay: float, gains: tuple[float, float], **options: Any) -> NDArray[np.float64]:
    """Return the simulated heights of a flotor released 1 mm off, held by spring and damper."""
    pose: Any = [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]
    velocity = options.pop("velocity")
    plant = plant_type(
        Timing(period=T, delay=delay), pose=[pose] if plant_type is MuJoCoBatchPlant else pose, gravity=0.0, **options
    )
    heights: list[float] = []
    hold = Hold(axes="z", stiffness=gains[0], damping=gains[1])
    drive(
        plant,
        Controller([hold], period=T, velocity=velocity),
        TICKS,
        observe=lambda sample, _: heights.append(float(np.ravel(sample.position[2])[0])),
    )
    return np.array(heights)


def foretold(delay: float, gains: tuple[float, float], hand: Hand | None, lag: bool, velocity: Any) -> Any:
    """Return the same by powers of the closed-loop matrix."""
    loop = LoopArray(period=T, delay=delay, hand=hand, driver_lag=LAG * lag, velocity=velocity)
    matrix = loop.matrix(*gains)
    state = np.zeros(len(matrix))
    state[0] = 1e-3
    if hand is not None and hand.soft:
        state[2] = 1e-3 * 3000.0 / 3500.0  # in balance between grip and arm
    if isinstance(velocity, LowPass):
        state[-2] = 1e-3
    else:
        state[len(matrix) - velocity.samples if isinstance(velocity, Window) else -1 :] = 1e-3
    heights = []
    for _ in range(TICKS):
        heights.append(state[0])
        state = matrix @ state
    return np.array(heights)


DRIVEN = list(itertools.product((0.0, 0.0015, 0.005, 0.0125), (False, True)))
"""Delays, with the drivers' lag and without."""


VELOCITIES, HELD = [FiniteDifference(), LowPass(50.0), Window(3)], [None, RIGID, GRIP]


@pytest.mark.parametrize(
    ("plant", "velocity", "hand"),
    [
        *sweep(
            [(ExactPlant, DRIVEN[2::3]), (MuJoCoPlant, DRIVEN[::3]), (MuJoCoBatchPlant, DRIVEN[1::3])],
            VELOCITIES,
            HELD,
            every=3,
        ),
    ],
)
def test_plants_move_as_the_matrix_says(
    plant: tuple[Any, list[tuple[float, bool]]], velocity: VelocityEstimator, hand: Hand | None
) -> None:
    plant_type, driven = plant
    for delay, lag in driven:
        gains = (2000.0, 30.0) if delay < 0.01 else (300.0, 10.0)
        seen = simulated(plant_type, delay, gains, hand=hand, driver_lag=lag, velocity=velocity)
        np.testing.assert_allclose(seen, foretold(delay, gains, hand, lag, velocity), rtol=0.0, atol=1e-10)


def test_least_dynamic_stiffness_has_its_limits() -> None:
    # At rest it is the stiffness, far above the resonance it is that of the mass.
    for frequency in (0.0, 1.0, 10.0, 50.0):
        turn = 2.0 * math.pi * frequency
        expected = abs(1000.0 + 100.0j * turn - M * turn**2)
        errors = []
        for period in (1e-4, 1e-5):
            loop: Any = {"period": period, "delay": 0.0, "mass": M}
            found = least_dynamic_stiffness(1000.0, 100.0, frequencies=[frequency], **loop)
            errors.append(abs(float(found) / expected - 1.0))
        assert errors[1] < max(0.2 * errors[0], 1e-6)
    assert least_dynamic_stiffness(6000.0, 80.0, period=T, delay=T) == 0.0


@pytest.mark.parametrize(
    ("loop", "words"),
    [
        ({"period": 0.0}, "period must be between 1e-6 and 0.1 s .got 0.0"),
        ({"delay": 1.0001}, "delay must be between 0 and 1 s .got 1.0001"),
        ({"mass": -0.7}, r"mass must be above 0 \(got -0.7"),
        ({"velocity": AdaptiveWindow()}, "velocity must be a linear estimator"),
        ({"driver_lag": -1.0}, "driver_lag must be"),
        ({"delay": [0.0, 0.001], "period": [T] * 3}, "period and delay must share a shape"),
        ({"stiffness": -1.0}, "stiffness must be"),
    ],
)
def test_bad_loops_are_refused_with_the_value(loop: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        spectral_radius(**{"stiffness": 6000.0, "damping": 80.0, "period": T, "delay": 0.0015, **loop})
    with pytest.raises(ParameterError, match="critical_delay accepts no delay"):
        critical_delay(6000.0, 80.0, period=T, delay=0.0)


@pytest.mark.parametrize(
    ("hand", "words"),
    [
        ({"mass": -1.0}, "hand mass must be"),
        ({"grip_stiffness": 100.0}, "hand mass must be at least 0.001"),
        ({"mass": "a"}, "hand mass must be a number"),
        ({"grip_damping": 1.0}, "hand grip_damping must be 0"),
        ({"mass": [1.0, 2.0], "damping": [1.0, 2.0, 3.0]}, "must share a shape"),
    ],
)
def test_bad_hands_are_refused(hand: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        Hand(**hand)


def test_a_hands_force_is_not_filtered_by_the_drivers() -> None:
    # Compliance is the steady swing of a plant whose drivers lag, under a hand's force held from sample to sample.
    lag, frequency, ticks = 20.0 * LAG, 17.0, 2000
    turns = np.exp(2j * math.pi * frequency * T * np.arange(ticks))
    plant = ExactPlant(
        Timing(period=T, delay=0.0015),
        mass=M,
        gravity=0.0,
        driver_lag=True,
        driver_time_constant=lag,
        hand_force=lambda tick, time, state: (0.0, 0.0, turns[min(tick, ticks - 1)].real, 0.0, 0.0, 0.0),
    )
    seen: list[float] = []
    hold = Hold(axes="z", stiffness=2000.0, damping=30.0)
    drive(plant, Controller([hold], period=T), ticks, observe=lambda sample, _: seen.append(sample.position[2]))
    loop = LoopArray(period=T, delay=0.0015, mass=M, driver_lag=lag)
    (compliance,) = loop.compliances(2000.0, 30.0, [frequency])
    settled = slice(ticks // 2, None)  # whole turns: 85 of them
    swing = 2.0 * (np.array(seen) / turns)[settled].mean()
    assert swing == pytest.approx(complex(compliance), rel=1e-9)


def test_more_gains_than_are_taken_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_array, "_CHUNK", 16)
    stiffness, masses = np.linspace(1000.0, 6000.0, 19), np.linspace(0.5, 1.0, 19)
    found = spectral_radius(stiffness, 40.0, period=T, delay=0.0, mass=masses)
    alone = [float(spectral_radius(k, 40.0, period=T, delay=0.0, mass=m)) for k, m in zip(stiffness, masses)]
    assert found == pytest.approx(alone, rel=1e-12)


def test_critical_delays_of_more_than_three_periods() -> None:
    stiffness, damping = [3000.0, 5000.0, 6000.0, 30000.0], [60.0, 100.0, 80.0, 80.0]
    found = critical_delay(stiffness, damping, period=1e-3)
    np.testing.assert_allclose(found, [10.31616e-3, 7.23914e-3, 7.02080e-3, 1.74846e-3], rtol=1e-5)
    stable = is_stable(spectral_radius(6000.0, 80.0, period=1e-3, delay=np.linspace(0.0, 0.01, 500)))
    assert np.argmin(stable) == np.searchsorted(np.linspace(0.0, 0.01, 500), found[2])
    assert is_stable(spectral_radius(3000.0, 60.0, period=1e-3, delay=np.linspace(0.0, 0.01, 500))).all()
    rates = critical_delay(6000.0, 80.0, period=[[1e-3], [T]], mass=[0.7, 0.7])
    np.testing.assert_allclose(rates, [[7.02080e-3] * 2, [3.25722e-3] * 2], rtol=1e-5)


GAINS = [1000.0, 2000.0, 4000.0, 6000.0, 8000.0], [20.0, 40.0, 60.0, 80.0, 100.0]


@pytest.mark.parametrize(
    "gains", [([1000.0, 8000.0], [20.0, 40.0, 100.0]), pytest.param(GAINS, marks=pytest.mark.study)]
)
def test_published_hands_shift_the_critical_delay(gains: tuple[list[float], list[float]]) -> None:
    stiffness, damping = np.meshgrid(*gains)
    for period in (1e-3, T):
        alone = critical_delay(stiffness, damping, period=period)
        for hand, least, most in (("arm", 1.2, 1.6), ("fingertip", 1.01, 1.04), ("stylus", 0.90, 0.96)):
            held = critical_delay(stiffness, damping, period=period, hand=get_hand(hand))
            known = np.isfinite(alone) & np.isfinite(held) & (alone > 0.0)
            assert least < (held / np.where(known, alone, 1.0))[known].min() < most


def test_the_stability_functions_accept_the_fields_of_a_loop_by_its_names() -> None:
    fields = {item.name for item in dataclasses.fields(LoopArray) if item.init} | {"rate"}
    assert set(LoopKeywords.__annotations__) == fields | {"inertia", "law"}
    loop: Any = {"period": 1e-3, "delay": 5e-4, "inertia": 0.3, "law": pd(LowPass(100.0)), "hand": "arm"}
    array = Loop(stiffness=0.0, damping=0.0, **loop | {"hand": get_hand("arm")}).array()
    assert largest_stable_stiffness(80.0, **loop) == boundary_of(array, np.array(80.0))
    assert spectral_radius(6e3, [40.0, 80.0], **loop).tolist() == array.spectral_radius(6e3, [40.0, 80.0]).tolist()
    with pytest.raises(KeywordError, match="mass and inertia must not both be given"):
        spectral_radius(6e3, 80.0, mass=0.7, inertia=0.3)
