"""Stability at any delay: known answers, and agreement with matrices that grow with the delay."""

from __future__ import annotations

import json
import math
import pickle
from typing import Any

import numpy as np
import pytest

from maglev_mj import ParameterError, critical_delay, diagnose
from maglev_mj.control import Controller, Law, LinearController, LowPass
from maglev_mj.frames import Array
from maglev_mj.plants.hand import Mode, get_hand
from maglev_mj.theory.boundary import boundary_of, rigid_note, spans, stiffest_of
from maglev_mj.theory.delay import AnyDelay, Cut, dominant_poles, first_delays
from maglev_mj.theory.linearise import StateSpace
from maglev_mj.theory.loop import Bound, Loop, StableDelays, delay_bound, stable_delays
from maglev_mj.theory.loop_array import LoopArray, spectral_radius
from maglev_mj.theory.two_rates import DeviceLaw
from maglev_mj.theory.verdict import judge
from tests.sweeps import further

ARM = "arm"


def loop_of(**values: Any) -> LoopArray:
    """Return a loop without delay."""
    return LoopArray(**{"delay": 0.0, "hand": get_hand(values.pop("hand", None))} | values)


def period_of(loop: LoopArray) -> float:
    return float(np.asarray(loop.period))


def grown(cut: Cut, row: int, whole: int) -> Array:
    """Return the closed loop with a state for each delayed command."""
    a, b, c = (part[row] for part in cut)
    size = len(b)
    if not whole:
        return np.asarray(a - np.outer(b, c))
    result = np.zeros((size + whole, size + whole))
    result[:size, :size], result[:size, -1], result[size, :size] = a, b, -c
    result[size + 1 :, size : size + whole - 1] = np.eye(whole - 1)
    return result


@pytest.mark.parametrize(
    ("stiffness", "damping", "period", "mass", "own", "critical"),
    [
        (6000, 80, 5e-3, 0.7, 0.0, 3.257217),
        (6000, 80, 0.5e-3, 0.7, 0.0, 7.510110),
        (5000, 50, 0.25e-3, 0.4, 0.1, 6.324197),
        (1000, 40, 1e-3, 0.7, 0.0, 18.175239),
        (200, 5, 0.5e-3, 0.15, 0.0, 18.387946),
        (300, 20, 1e-3, 0.7, 0.0, 34.639257),
        (40, 10, 0.1e-3, 0.7, 0.0, 88.198254),
        (100, 30, 50e-6, 0.5, 1.0, 25.733289),
        (20, 8, 50e-6, 0.7, 0.5, 121.736511),
        (2, 1.6, 50e-6, 0.2, 0.3, 201.164145),
        (5, 2, 50e-6, 0.7, 0.5, 332.380637),
    ],
)
def test_critical_delays_known_to_seven_digits(
    stiffness: float, damping: float, period: float, mass: float, own: float, critical: float
) -> None:
    around: Any = {"period": period, "mass": mass, "own_damping": own}
    assert 1e3 * critical_delay(stiffness, damping, **around) == pytest.approx(critical, abs=6e-7)
    bound = delay_bound(loop_of(**around), stiffness, damping)
    assert 1e3 * bound == pytest.approx(critical, abs=6e-7) and not bound.beyond and not bound.proved


@pytest.mark.parametrize(
    ("around", "gains", "intervals"),
    [
        (
            {"mass": 0.5, "own_damping": 0.02, "hand": "0,0,800", "period": 1e-3},
            (120.0, 0.0),
            [(84.52115, 146.14517), (254.89679, 292.62366), (425.27244, 439.10215)],
        ),
        ({"hand": ARM, "period": 50e-6}, (200.0, 2.0), [(0.0, 43.26033)]),
        ({"hand": ARM, "period": 50e-6}, (100.0, 2.0), [(0.0, 91.56706), (500.94187, 590.82998)]),
        ({"device": DeviceLaw(0.0, 100.0, 1e-3, 2e-4), "period": 5e-3}, (20000.0, 20.0), [(0.0, 3.634383)]),
        ({"device": DeviceLaw(0.0, 200.0, 1e-3, 2e-4), "period": 5e-3}, (20000.0, 20.0), [(0.0, 11.885000)]),
        ({"mass": 0.15, "device": DeviceLaw(0.0, 10.0, 1e-3, 2e-4), "period": 5e-3}, (500.0, 1.0), [(0.0, 23.192421)]),
    ],
)
def test_all_stable_intervals_are_found(
    around: Any, gains: tuple[float, float], intervals: list[tuple[float, float]]
) -> None:
    found = stable_delays(loop_of(**{"mass": 0.7} | around), *gains)
    np.testing.assert_allclose(1e3 * np.array(found.intervals), intervals, atol=6e-6)
    assert found.searched_to == pytest.approx(1.0) and found.largest_gain is None


@pytest.mark.parametrize(
    ("around", "gains", "gain"),
    [
        ({"hand": "0.554,20,135", "period": 50e-6}, (20.0, 0.2), 0.148),
        ({"device": DeviceLaw(6000.0, 80.0, 1e-3, 2e-4), "period": 5e-3}, (2000.0, 20.0), 0.434),
    ],
)
def test_any_delay_is_proved_by_the_loop_gain(around: Any, gains: tuple[float, float], gain: float) -> None:
    loop = loop_of(mass=0.7, **around)
    bound = delay_bound(loop, *gains)
    assert bound.largest_gain is not None and bound.proved and bound.largest_gain == pytest.approx(gain, abs=6e-4)
    assert json.loads(json.dumps(bound.as_json(), allow_nan=False)) == {"any": True, "largest_gain": bound.largest_gain}
    assert bound.text("ms", 1e3) == f"any (proved: largest loop gain {gain:.3g})" and math.isfinite(bound)
    assert np.isinf(critical_delay(*gains, **{"mass": 0.7, **around}))
    cut = loop.cut(np.full(41, gains[0]), np.full(41, gains[1]), np.arange(41) / 40)
    for angle in np.geomspace(1e-5, np.pi, 300):
        assert (
            np.abs(cut.response(np.arange(41), np.full(41, np.exp(1j * angle)))[0]).max() <= bound.largest_gain * 1.001
        )


def random_loop(random: np.random.Generator) -> tuple[LoopArray, float, float]:
    """Return a random loop with its gains: 60 Hz to 20 kHz, all that a loop may have."""
    period, mass = 10 ** random.uniform(-4.3, -1.78), 10 ** random.uniform(-1.5, 0.5)
    angle = 10 ** random.uniform(-2.5, 0.3)
    stiffness, damping = mass * (angle / period) ** 2, 2.0 * random.uniform(0.0, 1.5) * mass * angle / period
    values: dict[str, Any] = {"hand": random.choice(["none", ARM, "stylus", "fingertip"])}
    if random.random() < 0.3:
        values["driver_lag"] = min(period * 10 ** random.uniform(-1.0, 1.0), 0.01)
    if random.random() < 0.3:
        place = random.uniform(0.05, 1.0) / period, 10 ** random.uniform(-3.0, -1.0), random.choice([-1.0, 0.3])
        values["mode"] = Mode(*map(float, place))
    if random.random() < 0.3:
        values["velocity"] = LowPass(cutoff=10 ** random.uniform(-2.0, -0.3) / period)
    if random.random() < 0.3:
        values["device"] = DeviceLaw(
            stiffness * random.choice([0.0, 0.5]),
            mass / period * 10 ** random.uniform(-2.0, -0.5),
            period / int(random.integers(1, 6)),
            random.uniform(0.0, 0.15) * period,
        )
    if random.random() < 0.2:
        advance, take = random.normal(0.0, 0.4, (3, 3)), random.normal(size=3)
        give, direct = stiffness * random.normal(0.0, 0.1, 3), -stiffness - damping / period
        values["design"] = lambda k, *_: LinearController(
            advance, take, np.broadcast_to(give, (*np.shape(k), 3)), np.broadcast_to(direct, np.shape(k))
        )
    own = random.choice([0.0, 1.0]) * 10 ** random.uniform(-1.0, 1.0)
    return loop_of(period=period, mass=mass, own_damping=own, **values), stiffness, damping


@pytest.mark.parametrize("seed", range(20))
def test_the_number_of_unstable_poles_is_that_of_the_matrix(seed: int) -> None:
    random, count = np.random.default_rng(seed), 3
    for _ in range(4):
        loop, k, b = random_loop(random)
        fractions, whole = random.integers(0, 40, count) / 40, (10 ** random.uniform(0.0, 1.8, count)).astype(int)
        cut = loop.cut(np.full(count, k), np.full(count, b), fractions)
        unstable = AnyDelay(cut, np.zeros(count, dtype=bool)).unstable(whole)
        for row in range(count):
            sizes = np.abs(np.linalg.eigvals(grown(cut, row, int(whole[row]))))
            if (np.abs(sizes - 1.0) > 3e-7).all():
                assert unstable[row] == (sizes > 1.0).sum()
        # the loop that is cut is the loop: state of the matrix by the switch of the command, not by Nyquist
        delay = float(min(whole[0], 9) + fractions[0]) * period_of(loop)
        values: Any = {name: getattr(loop, name) for name in ("mass", "hand", "driver_lag", "velocity", "design")}
        values |= {name: getattr(loop, name) for name in ("own_damping", "mode", "device", "period")}
        first = np.abs(np.linalg.eigvals(grown(cut, 0, min(int(whole[0]), 9)))).max()
        assert spectral_radius(k, b, delay=delay, **values) == pytest.approx(first, rel=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_stability_changes_at_each_end_of_an_interval(seed: int) -> None:
    random = np.random.default_rng(100 + seed)
    for _ in range(3):
        loop, k, b = random_loop(random)
        found = stable_delays(loop, k, b)
        assert found.bound == pytest.approx(min(float(critical_delay_of(loop, k, b)), 1.0), rel=1e-9)
        for low, high in found.intervals:
            for end, side in ((low, 1.0), (high, -1.0)):
                if 0.0 < end < found.searched_to * (1.0 - 1e-6) and end / period_of(loop) < 80.0:
                    cuts = [loop_at(loop, end * (1.0 + share), k, b) for share in (side * 1e-6, -side * 1e-6)]
                    assert cuts[0] < 1.0 < cuts[1]


def test_a_gain_above_one_at_half_the_rate_adds_a_pole_with_each_period() -> None:
    loop = loop_of(period=5e-3, mass=0.7)
    cut = loop.cut(np.full(3, 3e4), np.full(3, 700.0), np.full(3, 0.5))
    whole = np.array([1, 2, 7])
    counts = [(np.abs(np.linalg.eigvals(grown(cut, row, int(whole[row])))) > 1.0).sum() for row in range(3)]
    found = AnyDelay(cut, np.zeros(3, dtype=bool))
    assert found.flipped.all() and found.unstable(whole).tolist() == counts


def critical_delay_of(loop: LoopArray, k: float, b: float) -> Array:
    names = "period", "mass", "hand", "driver_lag", "velocity", "design", "own_damping", "mode", "device"
    return critical_delay(k, b, **{name: getattr(loop, name) for name in names})


def loop_at(loop: LoopArray, delay: float, k: float, b: float) -> float:
    """Return the spectral radius at a delay, by a matrix."""
    whole = math.floor(delay / period_of(loop))
    cut = loop.cut(np.array([k]), np.array([b]), np.array([delay / period_of(loop) - whole]))
    return float(np.abs(np.linalg.eigvals(grown(cut, 0, whole))).max())


@pytest.mark.parametrize("seed", range(10))
def test_the_dominant_pole_is_that_of_the_matrix(seed: int) -> None:
    random = np.random.default_rng(200 + seed)
    for _ in range(3):
        loop, k, b = random_loop(random)
        whole = random.integers(31, 90, 2).astype(float)
        cut = loop.cut(np.full(2, k), np.full(2, b), random.uniform(0.0, 1.0, 2))
        for row, pole in enumerate(dominant_poles(cut, whole, np.zeros(2))):
            poles = np.linalg.eigvals(grown(cut, row, int(whole[row])))
            assert abs(pole) == pytest.approx(np.abs(poles).max(), rel=2e-8)


def test_a_crossing_at_a_tiny_angle_is_not_lost() -> None:
    mass, k, b, period = 0.7, 1000.0, 40.0, 1e-6
    square = b * b + k * b * period  # of a free mass, with hold and difference to first order in the period
    w = math.sqrt((square + math.sqrt(square**2 + 4.0 * (mass * k) ** 2)) / 2.0) / mass
    by_hand = math.atan2(w * b, k + w * w * b * period / 2.0) / w - period / 2.0
    assert critical_delay(k, b, period=period, mass=mass) == pytest.approx(by_hand, abs=0.003 * period)
    assert diagnose(stiffness=1000.0, damping=40.0, period=1e-6, delay=1e-3, mass=0.7).stable


def test_crossings_that_the_eigenvalues_lose_are_found_on_a_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    around: list[dict[str, Any]] = [{}, {"driver_lag": 1e-3, "own_damping": 2.0}, {"velocity": LowPass(cutoff=60.0)}]
    found = [float(critical_delay(1000.0, 40.0, period=1e-3, mass=0.7, **values)) for values in around]
    monkeypatch.setattr("maglev_mj.theory.delay._angles", lambda cut: (np.zeros(0, dtype=int), np.zeros(0)))
    again = [float(critical_delay(1000.0, 40.0, period=1e-3, mass=0.7, **values)) for values in around]
    assert again == pytest.approx(found, rel=1e-12)


@pytest.mark.parametrize("delay", [10.5e-3, 31.4e-3, 60e-3])
def test_the_boundary_at_a_long_delay_is_that_of_the_matrices(delay: float) -> None:
    for values in ({}, {"hand": ARM}, {"mode": Mode(60.0, 0.02, -1.0)}, {"device": DeviceLaw(100.0, 20.0, 5e-4, 2e-4)}):
        loop = loop_of(**{"period": 1e-3, "delay": delay, "mass": 0.7} | values)
        damping = np.array([0.1, 0.4, 0.8]) * 0.7 / delay
        critical = boundary_of(loop, damping)
        for k, b in zip(critical, damping):
            if k:
                radii = np.abs(np.linalg.eigvals(loop.matrix(k * np.array([0.3, 1.0 - 1e-6, 1.0 + 1e-6]), b))).max(
                    axis=-1
                )
                assert radii[0] < 1.0 and radii[1] < 1.0 < radii[2]
            else:
                assert np.abs(np.linalg.eigvals(loop.matrix(1e-3, b))).max() > 1.0
        best = stiffest_of(loop)
        assert best.stiffness >= critical.max() * (1.0 - 1e-9)
        edges, good = spans(loop, damping, 0.995)
        wide = edges[:, 1:] > edges[:, :-1]
        for share in (0.02, 0.5, 0.98):
            inside = share * edges[:, 1:7] + (1.0 - share) * edges[:, :6]
            radii = np.abs(np.linalg.eigvals(loop.matrix(inside, damping[:, None]))).max(axis=-1)
            assert ((radii < 0.995) == good[:, :6])[wide[:, :6]].all()


def test_a_second_is_the_longest_delay_and_a_matrix_has_a_thousand_periods() -> None:
    with pytest.raises(ParameterError, match=r"delay must be between 0 and 1 s .got 20.0.; did you mean 0.02 s"):
        diagnose(stiffness=100.0, damping=10.0, rate=1000.0, delay=20.0, mass=0.7)
    with pytest.raises(ParameterError, match="1000 periods, for the matrix"):
        loop_of(period=5e-5, delay=0.2).matrix(1.0, 1.0)
    edge = 0.121736511  # thousands of periods
    radii = [spectral_radius(20.0, 8.0, period=5e-5, delay=x * edge, mass=0.7, own_damping=0.5) for x in (0.999, 1.001)]
    assert radii[0] < 1.0 < radii[1]
    growth = np.log(np.array(radii)) / 5e-5
    np.testing.assert_allclose(growth, [-0.006, 0.006], atol=6e-4)  # by events


@pytest.mark.parametrize(
    ("delays", "text"),
    [
        (StableDelays(((0.0, 0.09157), (0.5009, 0.5908)), 1.0), "up to 91.57 ms and from 500.9 to 590.8 ms"),
        (StableDelays(((0.0, 1.0),), 1.0), "more than 1000 ms"),
        (StableDelays((), 1.0), "unstable without delay"),
        (StableDelays(((0.1, 0.2),), 1.0), "unstable without delay, stable from 100 to 200 ms"),
        (StableDelays(((0.0, 0.1), (0.5, 1.0)), 1.0), "up to 100 ms and from 500 ms (searched to 1000 ms)"),
        (StableDelays(((0.0, 1.0),), 1.0, 0.5), "any (proved: largest loop gain 0.5)"),
    ],
)
def test_intervals_in_words(delays: StableDelays, text: str) -> None:
    assert delays.text == text
    bound = pickle.loads(pickle.dumps(delays.bound))
    assert bound == delays.bound and bound.as_json() == delays.bound.as_json()


def test_the_least_bound_is_a_number_before_a_search_before_a_proof() -> None:
    number, search, proof, weaker = Bound(1.0), Bound(1.0, True), Bound(1.0, True, 0.2), Bound(1.0, True, 0.7)
    assert Bound.least([proof, search, number]) is number and Bound.least([proof, search]) is search
    assert Bound.least([proof, weaker]) is weaker and Bound.least([Bound(0.5, True), number]).beyond
    assert math.isnan(Bound.least([number, Bound(math.nan)]))


@pytest.mark.parametrize(
    ("gains", "mass", "delay", "lowest"),
    [
        ((6000.0, 80.0), 0.7, 1.5e-3, 144.814),
        ((6000.0, 80.0), 0.7, 5e-3, 322.121),
        ((500.0, 3.0), 0.15, 2e-3, 153.692),
        ((300.0, 20.0), 0.7, 0.03, 179.825),
    ],
)
def test_stable_rates_at_a_delay(gains: tuple[float, float], mass: float, delay: float, lowest: float) -> None:
    found = diagnose(stiffness=gains[0], damping=gains[1], rate=1000.0, delay=delay, mass=mass)
    assert found.rate_range is not None
    assert found.rate_range.lower == pytest.approx(lowest, abs=6e-4) and found.rate_range.upper.beyond


@pytest.mark.parametrize(("gains", "delay"), [((6000.0, 80.0), 9e-3), ((300.0, 20.0), 0.04)])
def test_no_rate_is_stable_at_a_delay(gains: tuple[float, float], delay: float) -> None:
    found = diagnose(stiffness=gains[0], damping=gains[1], rate=1000.0, delay=delay, mass=0.7)
    assert found.rate_range is None


def test_a_narrow_range_of_rates_beside_a_mode_is_found() -> None:
    mode = Mode(1100.0, 0.01, -1.0)
    note = rigid_note(loop_of(period=0.005, delay=0.0015, mass=0.7, mode=mode))
    assert "unstable with this mode above 2149 Hz" in note  # unstable from 2149 to 2205 Hz alone
    around: Any = {"mass": 0.7, "delay": 0.0015, "mode": "1100,0.01,-1"}
    found = diagnose(stiffness=46000.0, damping=250.0, rate=1300.0, **around)
    assert found.rate_range is not None
    edge = found.rate_range[1]
    assert 2100.0 < edge < 2200.0
    for share, stable in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        radius = spectral_radius(46000.0, 250.0, rate=share * edge, delay=0.0015, mass=0.7, mode=mode)
        assert (radius < 1.0) == stable


def coupled_loop(random: np.random.Generator, most: int = 4) -> tuple[StateSpace, dict[str, Any]]:
    """Return a random law of coupled axes with a filtered velocity, and the keywords of its loop.

    Its modes are distinct, equal in pairs, or mixed by a force across the motion.
    """
    n, period = int(random.integers(2, most + 1)), 10 ** random.uniform(-4.0, -2.0)
    inertia, angle, kind = 10 ** random.uniform(-2.0, 0.5, n), 10 ** random.uniform(-2.0, 0.2), random.integers(3)
    turn, w = np.linalg.qr(random.normal(size=(n, n)))[0], angle * random.uniform(0.3, 1.0, n)
    damped = np.full(n, 0.4)
    if kind == 1:
        w = angle * np.where(np.arange(n) < n // 2 + 1, 1.0, 0.5)
    elif kind == 2:
        damped = random.uniform(0.05, 1.2, n)
    across = random.normal(size=(n, n)) * 0.1 * angle**2 * (kind == 2)
    stiffness, damping = turn @ np.diag(w**2) @ turn.T + across - across.T, turn @ np.diag(2.0 * damped * w) @ turn.T
    old = float(random.choice([0.0, random.uniform(0.0, 0.8)]))
    one, zero = np.eye(n), np.zeros((n, n))
    advance = np.block([[zero, zero], [(old - 1.0) * one, old * one]])
    take, give = np.vstack([one, (1.0 - old) * one]), np.hstack([(1.0 - old) * damping, -old * damping])
    law = StateSpace(advance, take, give, -stiffness - (1.0 - old) * damping).with_units(period, inertia)
    hand, lag = get_hand(str(random.choice(["none", ARM, "stylus"]))), period * random.uniform(0.1, 3.0)
    return law, {
        "period": period,
        "inertia": inertia,
        "hand": hand,
        "driver_lag": min(lag, 0.01) * (random.random() < 0.4),
    }


@pytest.mark.parametrize("seed", [*range(8), *further(*range(8, 200))])
def test_unstable_poles_of_coupled_axes_are_those_of_the_matrix(seed: int) -> None:
    random = np.random.default_rng(300 + seed)
    law, around = coupled_loop(random, 4 if seed < 8 else 6)
    shares, whole = random.uniform(0.0, 1.0, 3), (10 ** random.uniform(0.0, 1.5, 3)).astype(int)
    unstable = AnyDelay(law.cuts(**around)(np.arange(3), shares), np.zeros(3, dtype=bool)).unstable(whole)
    for row, delay in enumerate((whole + shares) * around["period"]):
        sizes = np.abs(np.linalg.eigvals(law.closed_loop(delay=float(delay), **around)))
        if (np.abs(sizes - 1.0) > 3e-7).all():
            assert unstable[row] == (sizes > 1.0).sum()


@pytest.mark.parametrize("seed", [*range(6), *further(*range(6, 200))])
def test_stability_of_coupled_axes_changes_at_the_critical_delay(seed: int) -> None:
    law, around = coupled_loop(np.random.default_rng(600 + seed), 3 if seed < 6 else 6)
    critical = float(first_delays(law.cuts(**around), np.zeros(1, dtype=bool))[0])

    def radius(periods: float) -> float:
        matrix = law.closed_loop(delay=periods * around["period"], **around)
        return float(np.abs(np.linalg.eigvals(matrix)).max())

    if critical > 60.0:
        critical, edge = 60.0, False
    else:
        edge = True
    assert max(map(radius, critical * np.linspace(0.0, 1.0 - 1e-6, 12)), default=0.0) < 1.0 or critical == 0.0
    assert not edge or radius(critical * (1.0 + 1e-6)) > 1.0


class Diagonals(Law):
    """Spring and damper on each diagonal of x and y: coupled axes."""

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: list[Any]) -> Any:
        for side, (stiffness, damping) in zip((1.0, -1.0), ((150.0, 15.0), (60.0, 10.0))):
            x, v = (0.5 * (part[0] + side * part[1]) for part in (position, velocity))
            force = -(stiffness * x + damping * v)
            wrench[0], wrench[1] = wrench[0] + force, wrench[1] + side * force
        return state, None


def test_the_critical_delay_of_coupled_axes_is_that_of_their_diagonals() -> None:
    """It is above 30 ms and 10 periods, and with a hand at its number, or proved."""
    period = 1e-3
    for hand in ("none", ARM):
        loops = [loop for loop in Loop.of(Controller([Diagonals()], period=period), delay=0.0) if loop.axis == "x, y"]
        found = judge(loops[0], hand=hand).critical_delay
        each = [
            delay_bound(loop_of(period=period, mass=0.7, hand=hand), *gains) for gains in ((150.0, 15.0), (60.0, 10.0))
        ]
        least = Bound.least(each)
        assert found == pytest.approx(float(least), rel=1e-6) and found.beyond == least.beyond and found > 0.03
        assert found.largest_gain == pytest.approx(least.largest_gain, rel=1e-4)
