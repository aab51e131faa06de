"""The recorded motion between samples."""

import numpy as np
import pytest

from maglev_mj import Command, Controller, ExactPlant, MuJoCoPlant, Timing, Wall, drive
from maglev_mj.errors import ParameterError
from maglev_mj.plants.trace import Trace


def bounce(**options: object) -> Trace:
    plant = MuJoCoPlant(Timing(phase=0.3), pose=[0, 0, 3e-3, 0, 0, 0], record=True, **options)  # type: ignore[arg-type]
    wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0, pulse=220.0, pulse_width=0.003)
    drive(plant, Controller([wall], period=0.005), 40)
    return plant.trace()


def test_curve_between_switches_is_what_smaller_steps_give() -> None:
    # Evaluating between the engine's steps adds no error: steps of 0.5 ms pass through the same curve.
    coarse, fine = bounce(), bounce(longest_step=5e-4)
    assert len(fine.time) > 4 * len(coarse.time)
    pose, twist, _ = coarse.at(fine.time)
    np.testing.assert_allclose(pose, fine.pose, atol=1e-15)
    np.testing.assert_allclose(twist, fine.twist, atol=1e-13)


def test_wrench_at_a_switch_is_the_one_that_begins_there() -> None:
    trace = bounce()
    assert np.array_equal(trace.at(trace.time)[2], trace.wrench)


def test_wrench_at_the_very_end_is_the_last_one() -> None:
    plant = ExactPlant(Timing(period=0.005, delay=0.005), gravity=0.0, record=True)
    for tick in range(3):
        plant.read()
        plant.write(Command([0.0, 0.0, float(tick + 1), 0.0, 0.0, 0.0]))
    plant.read()
    trace = plant.trace().until(0.01)  # ends on the instant at which the second command takes effect
    assert trace.wrench[-1, 2] == 2.0
    assert trace.at(0.01)[2][0, 2] == 2.0


def test_cut_and_bounds() -> None:
    trace = bounce()
    cut = trace.until(0.1234)
    assert cut.time[-1] == 0.1234
    assert (np.diff(cut.time) >= 0.0).all()
    np.testing.assert_array_equal(cut.pose[-1], trace.at(0.1234)[0][0])
    for bad in (-0.001, 1.0):
        with pytest.raises(ParameterError, match=r"time must be from 0 to 0.2015"):
            trace.at(bad)
    with pytest.raises(ParameterError):
        trace.until(5.0)


def test_positions_are_the_first_part_of_the_motion() -> None:
    """To the last bit, of one device and a batch, at knots and between them; also refused alike."""
    one, times = bounce(), np.linspace(0.0, 0.2, 300)
    parts = ((one.time, one.time), (one.pose, -one.pose), (one.twist, -one.twist), (one.wrench, -one.wrench))
    batch = Trace(*(np.stack(pair, axis=1) for pair in parts))
    for trace in (one, batch):
        for at in (times, one.time[1:-1], 0.1234):
            assert np.array_equal(trace.positions(at), trace.at(at)[0])
        with pytest.raises(ParameterError, match=r"time must be from 0 to 0.2015"):
            trace.positions(1.0)


def test_cut_of_a_batch_with_different_phases() -> None:
    pose = np.zeros((3, 6))
    pose[:, 2] = 3e-3
    plant = ExactPlant(Timing(phase=np.array([0.0, 0.4, 0.9])), pose=pose, record=True)
    drive(plant, Controller([Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)], period=0.005), 40)
    cut = plant.trace().until(0.1)
    assert (cut.time[-1] == 0.1).all()
    np.testing.assert_allclose(cut.pose[-1], plant.trace().at(0.1)[0][0], rtol=1e-15)


def test_turning_points_are_extremes_of_the_curve() -> None:
    trace = bounce()
    time, place = (part[..., 2] for part in trace.turning_points())
    z = trace.at(np.linspace(0.0, 0.2, 20_001))[0][:, 2]
    assert place.min() <= z.min()
    assert place.min() == pytest.approx(z.min(), abs=1e-8)
    for at, value in zip(time, place, strict=True):
        assert trace.at(at)[0][0, 2] == pytest.approx(value, abs=1e-15)
