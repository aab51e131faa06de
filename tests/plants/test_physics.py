"""Closed forms: restitution, momentum, analog wall."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES, Controller, ExactPlant, MuJoCoPlant, Timing, Wall, drive
from maglev_mj.errors import ParameterError
from maglev_mj.spec import INERTIA
from maglev_mj.theory import analog_wall
from tests.sweeps import sweep

M, G, T = 0.7, 9.81, 0.005


def restitution(ratio: float) -> float:
    """Return the energy restitution of an ideal wall by damping ratio (section 3 of the paper)."""
    return math.exp(-2.0 * math.pi * ratio / math.sqrt(1.0 - ratio**2))


def test_the_analog_wall_refuses_times_that_do_not_ascend() -> None:
    with pytest.raises(ParameterError, match=r"time must be .* ascending"):
        drop_analog(np.array([0.4, 0.1]))


@pytest.mark.parametrize("ratio", sweep([0.1, 0.248, 0.4], every=3))
def test_sampled_wall_approaches_restitution_at_first_order(ratio: float) -> None:
    # Energy kept in one bounce on the sampled wall, mean over phases, against the formula as T falls.
    k = 6000.0
    b = 2.0 * ratio * math.sqrt(k * M)
    periods = np.array([1e-4, 5e-5, 2.5e-5])
    errors = []
    for period in periods:
        phases = np.arange(16) / 16
        pose, twist = np.zeros((16, 6)), np.zeros((16, 6))
        pose[:, 2], twist[:, 2] = 1e-3, -0.2
        plant = ExactPlant(Timing(period=period, delay=0.0, phase=phases), pose=pose, twist=twist, gravity=0.0)
        wall = Wall(axes="z", lower=0.0, stiffness=k, damping=b)
        swing = math.pi / math.sqrt(k / M * (1.0 - ratio**2))
        ticks = int((1e-3 / 0.2 + 1.1 * swing) / period)
        last = drive(plant, Controller([wall], period=period), ticks)
        assert (np.asarray(last.position[2]) > 0.0).all()
        kept = (np.asarray(plant._velocity[2]) / 0.2) ** 2
        errors.append(abs(kept.mean() / restitution(ratio) - 1.0))
    slopes = np.diff(np.log(errors)) / np.diff(np.log(periods))
    assert errors[-1] < 0.01
    assert slopes == pytest.approx([1.0, 1.0], abs=0.1)


@pytest.mark.parametrize(("axis", "side", "plant_type"), sweep(AXES, [1, -1], [ExactPlant, MuJoCoPlant], every=3))
def test_pulse_with_the_stopping_gain_stops_the_flotor(axis: str, side: int, plant_type: Any) -> None:
    # Eq. (8): without gravity and with no PD wall behind it, exactly m v goes in one pulse.
    index, width = AXES.index(axis), 0.003
    inertia = INERTIA[index]
    edge: Any = {"lower": 0.0} if side > 0 else {"upper": 0.0}
    gain = inertia / width
    damping = 0.3 * gain  # the pulse takes damping + pulse; the PD damping after it sees the old speed: none here
    pose, twist = np.zeros(6), np.zeros(6)
    pose[index], twist[index] = side * 1e-3, -side * 0.15
    plant = plant_type(Timing(period=T, phase=0.5), pose=pose, twist=twist, gravity=0.0, record=True)
    wall = Wall(axes=axis, stiffness=0.0, damping=damping, pulse=gain - damping, pulse_width=width, **edge)
    drive(plant, Controller([wall], period=T), 3)
    trace = plant.trace()
    force = trace.wrench[:, index]
    start = int(np.argmax(np.abs(force)))
    speed = trace.twist[start + 1, index]
    # the coils turn with the flotor after their map was taken: about a millionth of the torque here
    tolerance = 1e-15 if index < 3 or plant_type is ExactPlant else 5e-7
    assert trace.time[start + 1] - trace.time[start] == pytest.approx(width)
    assert abs(speed) < tolerance
    impulse = force[start] * width
    assert impulse == pytest.approx(side * inertia * 0.15, rel=1e-6)


def drop_analog(time: np.ndarray[Any, np.dtype[np.float64]], **changes: float) -> Any:
    options = {"height": 3e-3, "stiffness": 6000.0, "damping": 80.0, "mass": M} | changes
    return analog_wall(time, **options)


def test_analog_wall_satisfies_its_differential_equations() -> None:
    # Z' = v and m v' = f - m g by central differences of second order; f' = rate (wall(z, v) - f).
    step = 1e-7
    time = np.linspace(0.0, 0.4, 4001)[1:-1]
    before, now, after = (drop_analog(np.sort(time + shift)) for shift in (-step, 0.0, step))
    z, v, f = now
    rate = 2.0 * math.pi * 10e3
    wall = np.where(z <= 0.0, -6000.0 * z - 80.0 * v, 0.0)
    away = np.abs(z) > 1e-6  # off the edge, where the wall's force jumps
    np.testing.assert_allclose(((after[0] - before[0]) / (2 * step))[away], v[away], atol=1e-8)
    np.testing.assert_allclose((M * (after[1] - before[1]) / (2 * step))[away], (f - M * G)[away], atol=1e-5)
    np.testing.assert_allclose(
        ((after[2] - before[2]) / (2 * step))[away], rate * (wall - f)[away], rtol=1e-3, atol=0.1
    )
