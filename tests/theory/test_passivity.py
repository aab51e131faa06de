"""Passivity of a wall, and friction that silences it."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from maglev_mj.control import LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import Hand
from maglev_mj.studies.designed_wall import hum
from maglev_mj.theory import least_passive_damping
from maglev_mj.theory.loop_array import pd, spectral_radius
from tests.sweeps import further

T, M = 0.005, 0.7


def test_least_passive_damping_has_its_known_values() -> None:
    shares = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 1.0, 1.3, 2.0])
    known = [0.5, 0.635410, 0.860977, 1.059017, 1.242262, 1.5, 1.828709, 2.5]
    for period in (0.005, 0.001):
        least = least_passive_damping(1000.0, period=period, delay=shares * period) / (1000.0 * period)
        np.testing.assert_allclose(least, known, rtol=0.0, atol=6e-7)
    late = partial(least_passive_damping, [1000.0, 1000.0, 6000.0], [5.0, 20.0, 80.0], period=T, delay=0.0015)
    np.testing.assert_allclose(late(), [5.8274, 16.7919, 71.3357], atol=5e-5)
    assert late(design=pd(LowPass(40.0)))[2] == pytest.approx(53.5350, abs=5e-5)
    fast = least_passive_damping(1000.0, 20.0, period=[T, 0.001], delay=[0.0, 0.0015])
    np.testing.assert_allclose(fast, [22.5, 18.6416], atol=5e-5)


def power_form(stiffness: float, damping: float, period: float, delay: float) -> float:
    """Return minus the least eigenvalue of the absorbed power over velocities at 300 frequencies and 801 aliases."""
    angle = np.geomspace(1e-3, np.pi - 1e-9, 300)
    w = (angle + 2.0 * np.pi * np.arange(-400, 401)[:, None]) / period
    wall = stiffness + damping * (1.0 - np.exp(-1j * angle)) / period
    force = np.exp(-1j * w * delay) * (1.0 - np.exp(-1j * w * period)) / (1j * w * period) * wall
    cross, sizes = (force / (1j * w)).sum(axis=0), (np.abs(force) ** 2).sum(axis=0) * (1.0 / w**2).sum(axis=0)
    return float((0.5 * (np.sqrt(sizes - cross.imag**2) - cross.real)).max())


@pytest.mark.parametrize("seed", range(20))
def test_least_passive_damping_is_that_of_the_power_over_aliases_and_stabilises(seed: int) -> None:
    random = np.random.default_rng(seed)
    stiffness, damping, period = 10.0 ** random.uniform([2.0, -1.0, -4.0], [5.0, 2.5, -2.0])
    delay = random.uniform(0.0, 2.5) * period
    least = float(least_passive_damping(stiffness, damping, period=period, delay=delay))
    assert 0.998 < power_form(stiffness, damping, period, delay) / least < 1.0 + 1e-6
    # so no wall is passive on a device without damping; passive walls are stable in any passive hand
    for hand in (Hand(damping=least), Hand(mass=0.3, damping=least + 2.0, stiffness=500.0)):
        assert spectral_radius(stiffness, damping, period=period, delay=delay, hand=hand) < 1.0 + 1e-9


@pytest.mark.parametrize(("stiffness", "damping"), [(4000.0, 60.0), *further((6000.0, 80.0), (2000.0, 30.0))])
def test_friction_by_abbott_and_okamura_silences_the_hum_of_a_coarse_sensor(stiffness: float, damping: float) -> None:
    # Without friction the flotor hums over two steps of the sensor; with the bound's it never does, from any start.
    step = 5e-6
    friction = 0.5 * stiffness * step
    shares = friction * np.array([1.0, 0.1, 0.5])
    quiet, tenth, half = hum(shares, stiffness=stiffness, damping=damping, quantum=step).swing
    assert quiet == 0.0
    assert tenth > 0.2 * step
    assert half < step
    assert hum(0.0, stiffness=stiffness, damping=damping, quantum=step).swing[0] > 0.4 * step


@pytest.mark.parametrize("name", ["period", "delay"])
def test_bad_times_are_refused(name: str) -> None:
    times: Any = {"period": T, "delay": 0.0, name: -1.0}
    with pytest.raises(ParameterError, match=f"{name} must be"):
        least_passive_damping(5.0, **times)
