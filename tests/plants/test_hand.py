"""Hands: forces, effect on the plants, and replay."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from maglev_mj import Controller, ExactPlant, Hold, MuJoCoPlant, Timing, Wall, drive
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array, Component, rotation_matrix
from maglev_mj.plants import SampledPlant
from maglev_mj.plants.hand import (
    HANDS,
    GuidedHand,
    Hand,
    RecordedHand,
    SpringHand,
    Trajectory,
    get_hand,
)
from maglev_mj.spec import INERTIA
from tests.sweeps import sweep

MASS, TILT = INERTIA[0], INERTIA[3]
TIMING = Timing(period=0.004, delay=0.0013)


def idle() -> Controller:
    return Controller([], period=TIMING.period)


def poses(plant: SampledPlant, controller: Controller, ticks: int) -> Array:
    """Return the true poses, (ticks + 1, ..., 6)."""
    seen: list[Array] = []
    drive(plant, controller, ticks, observe=lambda *_: seen.append(plant.state()[0]))
    return np.array([*seen, plant.state()[0]])


def test_a_torque_is_about_stator_axes() -> None:
    # A flotor turned by a quarter about z, twisted about the stator's x.
    start = [0.0, 0.0, 0.0, 0.0, 0.0, 0.5 * math.pi]
    plant = MuJoCoPlant(
        TIMING, gravity=0.0, pose=start, escape=(0.045, 3.0), hand_force=lambda *_: [0.0, 0.0, 0.0, 1e-3, 0.0, 0.0]
    )
    drive(plant, idle(), 10)
    pose, twist = plant.state()
    assert_allclose(twist[3:], [1e-3 / TILT * 0.04, 0.0, 0.0], atol=1e-6)
    turn = rotation_matrix(pose[3:]) @ rotation_matrix(np.array(start[3:])).T
    assert turn[2, 1] == pytest.approx(0.5 * 1e-3 / TILT * 0.04**2, rel=1e-3)


@pytest.mark.parametrize(("name", "lag"), sweep([name for name in HANDS if name != "none"], [False, True], every=4))
def test_both_plants_agree_on_a_guided_hand(name: str, lag: bool) -> None:
    """Hit and press a wall, the grip rigid or soft."""
    hand = get_hand(name)
    assert hand is not None
    down, up = [0.002, 0.0, -0.015, 0.0, 0.0, 0.0], [0.0, -0.001, 0.003, 0.0, 0.0, 0.0]
    guided = GuidedHand(hand=hand, path=Trajectory([0.0, 0.1, 0.2, 0.35], [up, down, up, down]))
    walls = Wall(axes="z", lower=0.0, stiffness=3000.0, damping=60.0)
    hold = Hold(axes=("rx", "ry", "rz"), stiffness=0.6, damping=0.03)
    paths = [
        poses(
            kind(TIMING, gravity=0.0, pose=up, hand=hand, hand_force=guided, driver_lag=lag),
            Controller([walls, hold], period=TIMING.period),
            120,
        )
        for kind in (ExactPlant, MuJoCoPlant)
    ]
    assert np.abs(paths[0] - paths[1]).max() < (2e-7 if lag else 2e-8)
    assert paths[0][:, 2].min() < -1e-4


def test_a_guided_hand_comes_to_rest_where_springs_balance() -> None:
    hand, target = Hand(mass=0.3, damping=20.0, stiffness=500.0, grip_damping=3.0, grip_stiffness=2000.0), 0.004
    guided = GuidedHand(hand=hand, path=Trajectory([0.0], [[target, 0, 0, 0, 0, 0]]))
    plant = ExactPlant(TIMING, gravity=0.0, hand=hand, hand_force=guided)
    rest = poses(plant, Controller([Hold(axes="x", stiffness=800.0, damping=30.0)], period=TIMING.period), 1200)[-1]
    pull = 1.0 / (1.0 / 500.0 + 1.0 / 2000.0)  # the two springs in a row
    assert rest[0] == pytest.approx(target * pull / (pull + 800.0), rel=1e-9)


def test_a_hand_without_any_stiffness_stays_where_the_flotor_is() -> None:
    # Without a division of 0 by 0, whose warning is an error here.
    assert Hand(mass=0.3, damping=1.0).position_at_rest(2e-3) == 2e-3
    assert np.asarray(Hand(stiffness=np.zeros(2)).position_at_rest(2e-3)).tolist() == [2e-3, 2e-3]
    assert Hand(mass=0.3, stiffness=300.0, grip_stiffness=100.0).position_at_rest(4e-3) == pytest.approx(1e-3)


def test_a_path_is_of_minimum_jerk() -> None:
    path = Trajectory([0.5, 1.5], [[0.0] * 6, [1.0, 2.0, 0.0, 0.0, 0.0, -1.0]])
    assert path.at(0.1) == [0.0] * 6
    assert path.at(2.0) == [1.0, 2.0, 0.0, 0.0, 0.0, -1.0]
    assert path.at(1.0)[:2] == pytest.approx([0.5, 1.0])
    time = np.linspace(0.5, 1.5, 2001)
    x = np.array([path.at(t)[0] for t in time])
    speed = np.gradient(x, time)
    assert speed.max() == pytest.approx(1.875, rel=1e-5)  # 15/8 of the mean speed
    assert np.abs(np.gradient(speed, time)).max() == pytest.approx(10.0 / math.sqrt(3.0), rel=1e-3)
    assert path.end == 1.5


@pytest.mark.parametrize(("name", "order"), [("linear", 2), ("cubic", 3)])
@pytest.mark.parametrize("step", [0.001, 0.005, 0.02])
def test_a_recorded_motion_is_followed_between_its_samples(name: str, order: int, step: float) -> None:
    time, rate, amplitude = np.arange(0.0, 1.0, step), 2.0 * math.pi, 3e-3
    path = Trajectory(time, np.outer(np.sin(rate * time), [amplitude] * 6), name)
    fine = np.arange(0.0, time[-1], 2.5e-4)
    positions = np.array([path.at(instant) for instant in fine.tolist()])[:, 0]
    assert_allclose(positions, amplitude * np.sin(rate * fine), atol=amplitude * (rate * step) ** order / 8.0)
    assert np.abs(np.diff(positions)).max() / 2.5e-4 <= amplitude * rate * (1.0 + (rate * step) ** (order - 1))


def played(time: Any, values: Any, fine: Any) -> Any:
    path = Trajectory(time, np.outer(values, [1.0] * 6), "cubic")
    return np.array([path.at(instant) for instant in fine.tolist()])[:, 0]


def test_a_recorded_motion_keeps_its_speed_its_rests_and_its_amplitude() -> None:
    time = 0.01 * np.arange(50)
    fine = np.linspace(0.0, time[-1], 5000)
    assert_allclose(np.gradient(played(time, 0.1 * time, fine), fine), 0.1, atol=2e-12)
    for samples, most in ((20, 5.1e-4), (10, 4.35e-3)):
        turn = 2.0 * math.pi / (0.01 * samples)
        inner = fine[(fine > 0.02) & (fine < time[-1] - 0.02)]
        assert_allclose(played(time, np.sin(turn * time), inner), np.sin(turn * inner), atol=most)
    for values in map(np.array, ([0, 0, 1, 1], [0, 1, 1, 1, 0], [0, 0, 1, 1, 2, 2, 2, 1, 1, 1, 0])):
        between = played(np.arange(len(values)), values, np.linspace(0.0, len(values) - 1.0, 997))
        assert between.min() >= 0.0 and between.max() <= values.max() + 1e-15
    assert Trajectory(range(3), np.eye(3, 6), "cubic").interpolation == "linear"


def test_the_springs_hand_pulls_as_its_stiffness_says() -> None:
    hand = SpringHand(stiffness=300.0, damping=15.0, turning_stiffness=0.5, turning_damping=0.02)
    plant = MuJoCoPlant(TIMING, gravity=0.0, hand_force=hand)
    controller = Controller(
        [Hold(stiffness=[700.0] * 3 + [1.5] * 3, damping=[30.0] * 3 + [0.05] * 3)], period=TIMING.period
    )
    hand.target = [0.006, -0.003, 0.002, 0.1, 0.0, -0.05]
    assert_allclose(poses(plant, controller, 800)[-1, :3], 0.3 * np.array(hand.target[:3]), rtol=1e-9)
    assert_allclose(plant.state()[0][3:], 0.25 * np.array(hand.target[3:]), rtol=2e-3, atol=1e-12)
    hand.target = None
    assert np.abs(poses(plant, controller, 800)[-1]).max() < 1e-12


def test_the_springs_hand_pulls_no_harder_than_its_limits() -> None:
    hand = SpringHand(stiffness=1e4, force_limit=5.0, turning_stiffness=1e3, torque_limit=0.2, target=[1.0] * 6)
    wrench = np.array(hand(0, 0.0, lambda: (np.zeros(6), np.zeros(6))))
    assert np.linalg.norm(wrench[:3]) == pytest.approx(5.0)
    assert np.linalg.norm(wrench[3:]) == pytest.approx(0.2)


def test_the_mouses_hand_pulls_gently_from_the_first_sample_on() -> None:
    for name, angle in (("stage", 0.97 * np.radians(4.0)), ("arm", np.pi)):
        assert SpringHand.of_mouse(device=name).largest_angle == pytest.approx(angle)
    heavy = Device.load("ubc").change("body", mass=3.0).toml()
    assert SpringHand.of_mouse(device=heavy).force_limit > 3.0 * 9.81
    hand, still = SpringHand.of_mouse(), lambda: (np.zeros(6), np.zeros(6))
    hand.target = [1.0] + [0.0] * 5
    forces = [hand(tick, 5.0 + 0.005 * tick, still)[0] for tick in range(50)]
    assert forces == pytest.approx([min(7.0 * 0.005 / 0.2 * tick, 7.0) for tick in range(50)])


def test_a_recorded_hand_gives_the_same_motion_bit_for_bit() -> None:
    hand, wrenches = SpringHand(), []
    laws = [Wall(axes=("x", "y", "z"), lower=-0.003, upper=0.003, stiffness=3000.0, damping=50.0)]
    random = np.random.default_rng(3)

    def wandering(tick: int, time: Component, state: Any) -> Any:
        if tick % 25 == 0:
            hand.target = [*random.uniform(-0.01, 0.01, 3), *random.uniform(-0.2, 0.2, 3)]
        wrenches.append(hand(tick, time, state))
        return wrenches[-1]

    def motion(force: Any) -> Array:
        plant = MuJoCoPlant(TIMING, gravity=0.0, hand_force=force)
        return poses(plant, Controller(laws, period=TIMING.period), 150)

    first = motion(wandering)
    assert np.abs(first).max() > 0.003
    assert (motion(RecordedHand(wrenches)) == first).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Trajectory([0.0, 0.0], [[0.0] * 6] * 2), "times must increase"),
        (lambda: GuidedHand(hand=Hand(mass=0.1), path=Trajectory([0.0], [[0.0] * 6])), "stiffness above 0"),
        (lambda: SpringHand(stiffness=-1.0), r"hand stiffness must be at least 0 \(got -1.0"),
    ],
)
def test_a_hand_that_cannot_be_is_refused(make: Any, words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        make()


def test_a_hand_that_gives_nonsense_stops_the_run() -> None:
    plant = MuJoCoPlant(TIMING, hand_force=lambda tick, time, state: [0.0] * 5 + [math.inf])
    with pytest.raises(PlantError, match=r"hand's wrench at tick 0 must be finite [(]got rz = inf"):
        plant.read()
