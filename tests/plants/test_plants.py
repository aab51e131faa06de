"""One contract, two plants: timing, limits, sensors, lag, and errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj import Command, ExactPlant, MuJoCoPlant, Timing, drive
from maglev_mj.control import Hold, Wall
from maglev_mj.control.controller import Controller
from maglev_mj.errors import DivergenceError, ModelError, ParameterError, PlantError
from maglev_mj.frames import Array, quaternion
from maglev_mj.plants import SampledPlant, Sensor
from maglev_mj.plants.coils import limited_wrench
from maglev_mj.plants.hand import Hand
from maglev_mj.plants.sensor import Measure
from tests.sweeps import sweep

PLANTS: list[type[Any]] = [ExactPlant, MuJoCoPlant]
both = pytest.mark.parametrize("plant_type", PLANTS)
M, G, T = 0.7, 9.81, 0.005
LAG = 1.0 / (2.0 * math.pi * 2000.0)


def push(force: float, pulse: float | None = None, width: float = 0.0) -> Command:
    """Return a command along z."""
    extra = None if pulse is None else [0.0, 0.0, pulse, 0.0, 0.0, 0.0]
    return Command([0.0, 0.0, force, 0.0, 0.0, 0.0], extra, width)


def forces(plant: SampledPlant, times: list[float]) -> list[float]:
    return plant.trace().at(times)[2][:, 2].tolist()  # type: ignore[no-any-return]


@both
@pytest.mark.parametrize("delay", [0.0, 0.0015, 0.005, 0.0065, 0.0125])
def test_a_command_takes_effect_exactly_one_delay_after_its_sample(
    plant_type: Callable[..., SampledPlant], delay: float
) -> None:
    plant = plant_type(Timing(period=T, delay=delay, phase=0.4), gravity=0.0, record=True)
    for tick in range(6):
        plant.read()
        plant.write(push(float(tick + 1)))
    plant.read()
    tiny = 1e-7
    for tick in range(3):
        at = (tick + 0.4) * T + delay
        assert forces(plant, [at - tiny, at, at + T - tiny]) == [float(tick), tick + 1.0, tick + 1.0]


@both
@pytest.mark.parametrize(("delay", "width"), sweep([0.0, 0.0015, 0.004, 0.005], [0.0005, 0.003, 0.005, 0.02], every=2))
def test_a_pulse_lasts_its_width_or_until_the_next_command(
    plant_type: Callable[..., SampledPlant], delay: float, width: float
) -> None:
    plant = plant_type(Timing(period=T, delay=delay), gravity=0.0, record=True)
    for tick in range(4):
        plant.read()
        plant.write(push(1.0, 5.0, width) if tick == 0 else push(2.0))
    plant.read()
    lasts, tiny = min(width, T), 1e-7
    assert forces(plant, [delay + tiny, delay + lasts - tiny]) == [6.0, 6.0]
    after = forces(plant, [delay + lasts + tiny, delay + T + tiny])
    assert after == [1.0 if width < T else 2.0, 2.0]
    momentum = M * plant.trace().at(delay + T)[1][0, 2]
    assert momentum == pytest.approx(1.0 * T + 5.0 * lasts, rel=1e-12)


@both
def test_instants_are_counted_never_summed(plant_type: Callable[..., SampledPlant]) -> None:
    # 0.1 ms summed 4000 times is off by far more than one rounding.
    period = 1e-4
    plant = plant_type(Timing(period=period, delay=0.0, phase=0.7), gravity=0.0)
    for tick in range(4000):
        sample = plant.read()
        assert sample.time == (tick + 0.7) * period


@both
def test_without_an_answer_the_last_command_holds(plant_type: Callable[..., SampledPlant]) -> None:
    plant = plant_type(Timing(period=T, delay=0.001), gravity=0.0, record=True)
    plant.read()
    plant.write(push(1.0))
    for _ in range(4):
        plant.read()
    plant.write(push(7.0))
    plant.write(push(3.0))  # a second answer to the same sample replaces the first
    plant.read()
    assert forces(plant, [0.0005, 0.0035, 0.0195, 0.0215]) == [0.0, 1.0, 1.0, 3.0]


@both
def test_write_returns_what_was_applied(plant_type: Callable[..., SampledPlant]) -> None:
    plant = plant_type(Timing(period=T, delay=0.0), wrench_limit=[math.inf] * 2 + [60.0] + [1.0] * 3, record=True)
    plant.read()
    applied = plant.write(push(50.0, 30.0, 0.002))
    assert applied.force[2] == 50.0
    assert applied.extra is not None
    assert applied.extra[2] == 10.0
    plant.read()
    assert forces(plant, [0.0, 0.001, 0.0025]) == [60.0, 60.0, 50.0]
    plant.write(Command([100.0, 0.0, -70.0, -2.0, 0.5, 0.0]))
    assert plant.write(Command([100.0, 0.0, -70.0, -2.0, 0.5, 0.0])).wrench.tolist() == [100, 0, -60, -1, 0.5, 0]


@both
@pytest.mark.parametrize("bad", [math.nan, -math.inf])
def test_a_command_that_is_not_finite_is_refused(plant_type: Callable[..., SampledPlant], bad: float) -> None:
    plant = plant_type()
    plant.read()
    with pytest.raises(PlantError, match=f"command at tick 0 must be finite [(]got z = {bad}"):
        plant.write(push(bad))
    limited = plant_type(wrench_limit=60.0)
    limited.read()
    with pytest.raises(PlantError, match="must be finite"):
        limited.write(push(bad))
    with pytest.raises(PlantError, match=r"must have 6 components [(]got 3"):
        plant.write(Command([0.0] * 3))
    with pytest.raises(PlantError, match=r"batch shape \(\) of the plant [(]got \(2,\)"):
        plant.write(Command([np.zeros(2)] * 6))
    with pytest.raises(PlantError, match="must be finite"):
        plant.write(push(1.0, bad, 0.001))
    with pytest.raises(PlantError, match=r"pulse_width must be finite and above 0 [(]got 0"):
        plant.write(push(1.0, 1.0))


@both
def test_a_flotor_far_outside_its_range_has_diverged(plant_type: Callable[..., SampledPlant]) -> None:
    plant = plant_type(twist=[0.0, 0.0, 2.0, 0.0, 0.0, 0.0], gravity=0.0)
    with pytest.raises(DivergenceError, match=r"at 0.025 s: the flotor is 0.05 m and 0 rad from its centre"):
        for _ in range(20):
            plant.read()
    plant = plant_type(twist=[0.0, 0.0, 0.0, 50.0, 0.0, 0.0], gravity=0.0)
    with pytest.raises(DivergenceError, match=r"is 0 m and 1[.\d]* rad"):
        for _ in range(20):
            plant.read()


def test_the_diverged_device_of_a_batch_is_named() -> None:
    twist = np.zeros((5, 6))
    twist[3, 2] = 20.0
    plant = ExactPlant(twist=twist, pose=np.zeros((5, 6)), gravity=0.0)
    plant.read()
    with pytest.raises(DivergenceError, match=r"at 0.005 s \(device 3 of \(5,\)\): the flotor is 0.1 m"):
        plant.read()
    commanded = ExactPlant(pose=np.zeros((5, 6)))
    commanded.read()
    force = np.zeros(5)
    force[4] = math.nan
    with pytest.raises(PlantError, match=r"got z = nan, device \(.*4.*\)"):
        commanded.write(Command([0.0, 0.0, force, 0.0, 0.0, 0.0]))


def test_angular_velocity_is_in_stator_axes_in_and_out() -> None:
    # A small turn about stator axes adds to the pose as the twist says, at any tilt.
    tilt, spin = np.array([0.1, -0.08, 0.05]), np.array([1.0, 2.0, -1.5])
    plant = MuJoCoPlant(
        Timing(period=1e-6, delay=0.0), pose=[0, 0, 0, *tilt], twist=[0, 0, 0, *spin], gravity=0.0, record=True
    )
    plant.read()
    plant.read()
    before, after = (_matrix(pose[3:]) for pose in plant.trace().pose[[0, -1]])
    turned = after @ before.T
    rate = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2e-6
    np.testing.assert_allclose(rate, spin, rtol=1e-5)
    np.testing.assert_allclose(plant.trace().twist[0, 3:], spin, rtol=1e-12)


def _matrix(vector: Array) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(quaternion(vector)))
    return matrix.reshape(3, 3)


def test_a_new_engine_warning_or_nan_is_an_error_and_nothing_resets() -> None:
    plant = MuJoCoPlant(escape=(1e12, 1e12), gravity=0.0)
    plant.read()
    plant._qvel[2] = 1e11  # beyond the engine's own bound: it warns, and would reset by default
    with pytest.raises(PlantError, match=r"MuJoCo warns at 0.005 s: mjWARN_BADQVEL"):
        plant.read()
    assert abs(plant._qvel[2]) > 1e10
    for value in (math.nan, math.inf):
        plant = MuJoCoPlant()
        plant.read()
        plant._qvel[2] = value
        with pytest.raises(PlantError):
            plant.read()


@both
def test_closed_plants_stay_closed(plant_type: Callable[..., SampledPlant]) -> None:
    with plant_type() as plant:
        with pytest.raises(PlantError, match="call read"):
            plant.write(push(0.0))
        plant.read()
    plant.close()
    with pytest.raises(PlantError, match="closed"):
        plant.read()
    with pytest.raises(PlantError, match="closed"):
        plant.write(push(0.0))
    with pytest.raises(PlantError, match="record=True"):
        plant.trace()


def test_bad_parameters_are_refused_with_the_value() -> None:
    refused: list[tuple[Callable[..., Any], dict[str, Any], str]] = [
        (Timing, {"period": 0.0}, r"period must be between 1e-6 and 0.1 s \(got 0.0"),
        (Timing, {"delay": -0.001}, r"delay must be at least 0.* \(got -0.001"),
        (Timing, {"delay": 1e12}, r"delay must be at most 0.05 s, 10 periods in a simulation [(]got 1"),
        (Timing, {"delay": [0.001, 0.006]}, "delay must have the same number of whole periods"),
        (Timing, {"phase": 1.0}, "phase must be at least 0 and below 1 [(]got 1"),
        (ExactPlant, {"mass": 0.0}, "mass must be above 0"),
        (ExactPlant, {"pose": np.zeros((3, 6)), "twist": np.zeros((2, 6))}, "must have one batch shape"),
        (ExactPlant, {"wrench": math.inf}, r"wrench must be a finite number \(got inf"),
        (
            ExactPlant,
            {"timing": Timing(delay=[0.001, 0.002]), "pose": np.zeros((3, 6))},
            r"delay must be a number or have shape \(3,\)",
        ),
        (MuJoCoPlant, {"timing": Timing(delay=[0.001, 0.002])}, "delay must be a number .got"),
        (MuJoCoPlant, {"longest_step": 0.0}, r"longest_step must be above 0.* \(got 0"),
        (MuJoCoPlant, {"coils": False, "force_falloff": 0.1}, "force_falloff needs coils=True"),
        (MuJoCoPlant, {"force_falloff": 2.0}, r"force_falloff must be between 0 and 1.* \(got 2"),
        (MuJoCoPlant, {"model": "moon"}, r"model must be one of drop, .* \(got 'moon'\)"),
        (Sensor, {"quantum": np.ones((3, 6))}, "quantum must be"),
        (Sensor, {"noise": -1e-6}, r"noise must be at least 0 \(got -1e-06"),
    ]
    for make, options, words in refused:
        with pytest.raises((ParameterError, ModelError), match=words):
            make(**options)


def test_a_command_that_the_engine_refuses_is_an_error() -> None:
    plant = MuJoCoPlant()
    with pytest.raises(PlantError, match="mjWARN_BADCTRL"):
        for _ in range(4):
            plant.read()
            plant.write(Command([0.0, 0.0, 1e13, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("whole", "lag", "grip"),
    sweep([0, 2], [False, True], [{}, {"grip_damping": 0.8, "grip_stiffness": 700.0}], every=3),
)
def test_devices_of_one_batch_may_differ_in_mass_delay_and_hand(whole: int, lag: bool, grip: dict[str, Any]) -> None:
    # Each moves as it would alone, with pulses longer than what is left of the period, and lost answers.
    random, count = np.random.default_rng(5), 6
    mass, hand_mass, damping = (random.uniform(0.1, most, count) for most in (1.5, 0.6, 20.0))
    rest, phase, height = (random.uniform(0.0, most, count) for most in (1.0, 0.9, 2e-3))
    rest[0] = 0.0
    pose = height[:, None] * np.eye(6)[2]

    def heights(one: slice | int) -> Array:
        plant = ExactPlant(
            Timing(delay=0.005 * (whole + rest[one]), phase=phase[one]),
            mass=mass[one],
            pose=pose[one],
            hand=Hand(mass=hand_mass[one], damping=damping[one], stiffness=100.0, **grip),
            driver_lag=lag,
            escape=(1e3, 1.0),
        )
        wall = Wall(axes="z", lower=0.0, stiffness=900.0, damping=20.0, pulse=100.0, pulse_width=0.0045)
        controller, seen = Controller([wall], period=0.005), []
        for sample in islice(plant, 60):
            seen.append(np.array(sample.position[2]))
            command = controller.step(sample)
            if sample.tick % 7 != 3:
                plant.write(command)
        return np.array(seen)

    together = heights(slice(None))
    for device in range(count):
        np.testing.assert_allclose(together[:, device], heights(device), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("device", [0, 1])
def test_a_batch_escapes_by_the_angle_of_any_device(device: int) -> None:
    twist = np.zeros((2, 6))
    twist[device, 4] = 150.0
    plant = ExactPlant(twist=twist, gravity=0.0)
    plant.read()
    plant.write(push(0.0))
    assert plant.read().pose[device, 4] == pytest.approx(0.75)
    plant.write(push(0.0))
    with pytest.raises(DivergenceError, match=r"1\.5 rad"):
        plant.read()


class Tilted:
    """A sensor that reads an angle of its own."""

    def __init__(self, angle: Sequence[float]) -> None:
        self.angle = list(angle)

    def start(self) -> Measure:
        """Return the measurement."""
        return lambda position: [*position[:3], *self.angle]


@pytest.mark.parametrize("seen", [None, (0.03, -0.02, 0.01)])
def test_current_limit_is_that_of_the_measured_angle(seen: Sequence[float] | None) -> None:
    angle = (0.08, -0.05, 0.06)
    sensor = None if seen is None else Tilted(seen)
    plant = MuJoCoPlant(current_limit=10.0, gravity=0.0, pose=[0.0] * 3 + [*angle], sensor=sensor)
    plant.read()
    asked = [20.0, -10.0, 70.0, 0.3, -0.2, 0.4]
    given, known = plant.write(Command(asked)).wrench, plant.device.coils
    assert known is not None
    expected, currents = limited_wrench(known.inverse_at_angle(*(seen or angle)), asked, 10.0)
    np.testing.assert_allclose(given, expected, rtol=1e-12)
    assert np.abs(currents).max() == pytest.approx(10.0)
    upright, _ = limited_wrench(known.current_per_wrench, asked, 10.0)
    assert np.abs(given - upright).max() > 0.1


@pytest.mark.parametrize("delay", [0.0, 0.0015])
def test_recorded_force_under_driver_lag_is_the_actual_one(delay: float) -> None:
    # First order from the command's arrival on, also between the knots.
    plant = ExactPlant(Timing(period=T, delay=delay), gravity=0.0, driver_lag=True, record=True)
    for force in (10.0, -5.0):
        plant.read()
        plant.write(push(force))
    plant.read()
    trace = plant.trace()
    inside = trace.time < delay + T - 1e-12
    since = np.maximum(trace.time[inside] - delay, 0.0)
    np.testing.assert_allclose(trace.wrench[inside, 2], -10.0 * np.expm1(-since / LAG), rtol=1e-12, atol=1e-12)
    # the curve between knots takes the force for constant
    times = np.linspace(delay, T, 500)
    t, most = times - delay, 10.0 / plant.inertia[2]
    curve = most * (0.5 * t * t - LAG * t - LAG * LAG * np.expm1(-t / LAG))
    np.testing.assert_allclose(trace.at(times)[0][:, 2], curve, rtol=0.0, atol=0.02 * most * LAG**2)


@pytest.mark.parametrize("options", [{}, {"integrator": "corrected"}])
def test_recording_changes_nothing(options: dict[str, Any]) -> None:
    hold = Hold(axes=("rx", "ry", "rz"), stiffness=[1.0] * 3, damping=[0.05] * 3)
    tumbling: dict[str, Any] = {"pose": [0, 0, 1e-3, 0.02, -0.01, 0.03], "twist": [0, 0, 0, 4, -3, 5], **options}
    last = []
    for record in (False, True):
        with MuJoCoPlant(gravity=0.0, record=record, **tumbling) as plant:
            last.append(drive(plant, Controller([hold], period=0.005), 20).pose)
    np.testing.assert_allclose(last[1], last[0], atol=1e-15)
