"""Published bounds, derived again and compared with the exact boundary."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import Hand
from maglev_mj.studies.designed_wall import hum
from maglev_mj.theory import boundary as bounds
from maglev_mj.theory import largest_stable_stiffness, stiffest_wall
from tests.sweeps import further

T, M = 0.005, 0.7


def least_passive_damping(stiffness: float, damping: float) -> float:
    """Return the least damping of a passive wall.

    b above T/2 / (1 - cos wT) Re[(1 - e^-jwT) H(e^jwT)] over all frequencies.
    """
    w = np.linspace(1e-6, np.pi, 200_001)  # times T
    z = np.exp(1j * w)
    wall = stiffness + damping * (z - 1.0) / (T * z)
    return float((0.5 * T / (1.0 - np.cos(w)) * ((1.0 - 1.0 / z) * wall).real).max())


@pytest.mark.parametrize("damping", [-20.0, 0.0, 5.0, 80.0])
def test_colgate_from_the_general_condition(damping: float) -> None:
    stiffness = 6000.0
    least = least_passive_damping(stiffness, damping)
    assert least == pytest.approx(0.5 * stiffness * T + abs(damping), rel=1e-4)
    assert bounds.colgate(damping, period=T, physical_damping=least) == pytest.approx(stiffness, rel=1e-3)


def test_no_wall_on_a_bare_flotor_is_passive_and_many_are_stable() -> None:
    assert bounds.colgate([0.0, 20.0, 80.0], period=T).tolist() == [0.0, 0.0, 0.0]
    assert (largest_stable_stiffness([20.0, 80.0], period=T, delay=0.0015) > 4000.0).all()


def test_colgate_is_conservative_wherever_it_holds() -> None:
    # With a device that has damping of its own, and no delay.
    for b in (5.0, 20.0, 60.0):
        virtual = np.linspace(0.0, 0.95 * b, 8)
        passive = bounds.colgate(virtual, period=T, physical_damping=b)
        exact = largest_stable_stiffness(virtual, period=T, delay=0.0, hand=Hand(damping=b))
        assert (passive < exact).all()


def test_gil_is_the_first_order_of_the_exact_boundary() -> None:
    # The ratio of the two goes to 1 as B T/m does to 0, in proportion to it; at any delay.
    for delay in (0.0, 0.0015, 0.005, 0.01):
        b = np.array([0.1, 0.2, 0.4])
        exact = largest_stable_stiffness(b, period=T, delay=delay)
        error = bounds.gil(b, period=T, delay=delay) / exact - 1.0
        assert (error > 0.0).all()  # optimistic, on a flotor without damping of its own
        assert np.polyfit(np.log(b), np.log(error), 1)[0] == pytest.approx(1.0, abs=0.05)


def test_how_optimistic_in_figures() -> None:
    # Gil et al. twofold at the optimum, 4 % at a damping of 5 N s/m; Minsky et al. sixfold under a full period.
    best = stiffest_wall(period=T, delay=T)
    assert bounds.gil(best.damping, period=T, delay=T) / best.stiffness == pytest.approx(1.96, abs=0.01)
    assert bounds.minsky(best.damping, period=T) / best.stiffness == pytest.approx(5.88, abs=0.01)
    exact = largest_stable_stiffness(5.0, period=T, delay=T)
    assert exact == pytest.approx(640.1, abs=0.1)
    assert bounds.gil(5.0, period=T, delay=T) / exact == pytest.approx(1.0415, abs=1e-3)


@pytest.mark.parametrize(("stiffness", "damping"), [(4000.0, 60.0), *further((6000.0, 80.0), (2000.0, 30.0))])
def test_friction_by_abbott_and_okamura_silences_the_hum_of_a_coarse_sensor(stiffness: float, damping: float) -> None:
    # Without friction the flotor hums over two steps of the sensor; with the bound's it never does, from any start.
    step = 5e-6
    friction = 0.5 * stiffness * step
    bound = bounds.abbott_okamura(period=T, physical_damping=1e9, dry_friction=friction, quantum=step)
    assert bound == pytest.approx(stiffness)
    shares = friction * np.array([1.0, 0.1, 0.5])
    quiet, tenth, half = hum(shares, stiffness=stiffness, damping=damping, quantum=step).swing
    assert quiet == 0.0
    assert tenth > 0.2 * step
    assert half < step
    assert hum(0.0, stiffness=stiffness, damping=damping, quantum=step).swing[0] > 0.4 * step
    # the weaker of its two: of friction, and of damping
    weak = bounds.abbott_okamura(period=T, physical_damping=1.0, dry_friction=1.0, quantum=step)
    assert weak == pytest.approx(2.0 / T)


@pytest.mark.parametrize(
    ("bound", "value", "words"),
    [
        (partial(bounds.gil, 5.0, delay=0.0), {"period": 0.0}, "period must be above 0"),
        (partial(bounds.colgate, 5.0), {"physical_damping": -1.0}, "physical_damping must be"),
        (bounds.abbott_okamura, {"quantum": 0.0}, "quantum must be above 0"),
        (
            bounds.abbott_okamura,
            {"physical_damping": -1.0},
            "physical_damping must be finite and at least 0",
        ),
        (
            bounds.abbott_okamura,
            {"dry_friction": -1.0},
            r"dry_friction must be finite and at least 0 \(got -1",
        ),
    ],
)
def test_bad_bounds_are_refused(bound: Any, value: dict[str, float], words: str) -> None:
    rest = {"physical_damping": 1.0, "dry_friction": 0.1, "quantum": 1e-6} if bound is bounds.abbott_okamura else {}
    with pytest.raises(ParameterError, match=words):
        bound(**({"period": T} | rest | value))
