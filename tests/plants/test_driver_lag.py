"""The drivers' lag of a device file is simulated by every plant, as it enters the verdicts."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from maglev_mj import Controller, Device, ExactPlant, Hold, MuJoCoPlant, Timing
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.control.loop import drive
from maglev_mj.frames import Array
from maglev_mj.plants import MuJoCoBatchPlant
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run
from maglev_mj.theory.loop import Loop

STAGE = Device.load("stage")
KINDS: dict[str, Callable[..., Any]] = {
    "exact": ExactPlant,
    "coils": MuJoCoPlant,
    "ideal wrench": partial(MuJoCoPlant, coils=False),
    "corrected": partial(MuJoCoPlant, integrator="corrected"),
    "batch": MuJoCoBatchPlant,
    "batch, ideal wrench": partial(MuJoCoBatchPlant, coils=False),
}


def lagging(lag: float, device: Device = STAGE) -> Device:
    return device.change("driver", time_constant=lag)


def heights(kind: str, device: Device, stiffness: float, damping: float, ticks: int, **options: Any) -> Array:
    """Return the heights of a flotor held along z, released 1 mm above its setpoint [m], (ticks,)."""
    pose: Any = [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]
    options = {"gravity": 0.0, "escape": (1e30, 1.0), "pose": [pose] * 2 if "batch" in kind else pose} | options
    plant = KINDS[kind](Timing(period=device.period, delay=device.delay), model=device, **options)
    seen: list[float] = []
    hold = Controller([Hold(axes="z", stiffness=stiffness, damping=damping)], period=device.period)
    with plant:
        drive(plant, hold, ticks, observe=lambda sample, _: seen.append(float(np.ravel(sample.position[2])[-1])))
    return np.array(seen)


def growth(heights: Array) -> float:
    """Return the growth per sample of the last oscillation: two poles explain three samples in a row."""
    last = heights[-60:] / np.abs(heights[-60:]).max()
    terms = np.linalg.lstsq(np.column_stack([last[1:-1], last[:-2]]), last[2:])[0]
    return float(np.abs(np.roots([1.0, *-terms])).max())


@pytest.mark.parametrize("kind", KINDS)
def test_a_small_oscillation_grows_by_the_spectral_radius(kind: str) -> None:
    random, tried = np.random.default_rng(7), 0
    while tried < 6:
        period = 10.0 ** random.uniform(-3.5, -2.3)
        device = lagging(period * random.uniform(0.02, 1.0), STAGE.change("body", mass=random.uniform(0.1, 1.0)))
        device = device.change("loop", rate=1.0 / period, delay=period * random.uniform(0.0, 0.7))
        device = device.change("sensor", latency=period * random.uniform(0.0, 0.3))
        gains = device.mass / period**2 * random.uniform(0.03, 0.3), device.mass / period * random.uniform(0.1, 0.6)
        loop = Loop.of(device, stiffness=gains[0], damping=gains[1])[0]
        poles = np.sort(np.abs(np.linalg.eigvals(loop.array().matrix(*gains))))[::-1]
        if not 0.94 < poles[0] < 1.01 or poles[2] > 0.93 * poles[0]:
            continue
        tried += 1
        assert growth(heights(kind, device, *gains, 300)) == pytest.approx(loop.spectral_radius, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_all_plants_move_alike_with_pulses_records_and_steps(kind: str) -> None:
    device, gains = lagging(1e-3), (9000.0, 100.0, 60)
    truth = heights("exact", device, *gains)
    assert np.abs(truth - heights("exact", device, *gains, driver_lag=False)).max() > 1e-5
    for options in ({}, {"record": True}, {"longest_step": 3e-4}, {"driver_lag": True}):
        np.testing.assert_allclose(heights(kind, device, *gains, **options), truth, atol=1e-15)


@pytest.mark.parametrize("kind", KINDS)
def test_the_published_joysticks_lag_is_part_of_its_delay(kind: str) -> None:
    ubc = Device.load("ubc")
    assert ubc.driver.time_constant > 0.0
    for device in (ubc, ubc.change("body", mass=0.8)):  # as published, and as commissioned
        assert Loop.of(device, stiffness=6000.0, damping=80.0)[0].driver_lag == 0.0
        plain, other = (heights(kind, device, 6000.0, 80.0, 40, **own) for own in ({}, {"driver_lag": False}))
        assert np.array_equal(plain, other)


@pytest.mark.parametrize("plant", ["exact", "mujoco"])
def test_a_wall_that_is_unstable_by_its_drivers_diverges(plant: str, tmp_path: Any) -> None:
    swings = []
    for lag, radius in ((0.0, 0.967352), (1e-3, 1.075932)):
        device = lagging(lag)
        assert Loop.of(device, stiffness=4e4, damping=140.9)[0].spectral_radius == pytest.approx(radius, abs=1e-6)
        file = tmp_path / "stage.toml"
        file.write_text(device.toml())
        drop = Drop(device=str(file), stiffness=4e4, damping=140.9, pulse=0.0, height=1e-4, duration=0.3)
        pose = run(drop, plant=plant).trace.pose[:, 2]
        swings.append(np.ptp(pose[-len(pose) // 4 :]))
    assert swings[0] < 1e-6 and swings[1] > 1e-3


@pytest.mark.parametrize("plant", ["exact", "mujoco"])
def test_a_twin_lags_as_its_device_file_says(plant: str) -> None:
    moved = []
    for lag in (0.0, 1e-3):
        own = lagging(lag)
        truth = Calibration.of(own)
        body = Twin(TwinParameters(calibration=truth, plant=plant, pose=[0.0] * 6)).plant
        for _ in range(2):
            body.read()
            body.drive(truth.coils.currents(np.array([0.0, 0.0, 6.0, 0.0, 0.0, 0.0])).tolist(), after=0.0)
        moved.append((float(body.state()[1][2]) + 9.81 * own.period) * own.mass)
    # behind a lag tau the momentum after a time t is f (t - tau (1 - exp(-t / tau)))
    assert moved == pytest.approx([6e-3, 6.0 * (1e-3 - 1e-3 * (1.0 - np.exp(-1.0)))], rel=1e-6)
