"""Orders of the integrators, and exactness of the corrected one."""

from __future__ import annotations

from functools import partial
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, MuJoCoPlant, Timing, drive
from maglev_mj.control import Hold
from maglev_mj.device import published_device
from maglev_mj.frames import Array, quaternions, rotation_matrix, rotation_vector
from maglev_mj.plants import INTEGRATORS, MuJoCoBatchPlant
from maglev_mj.plants.hand import Hand
from maglev_mj.scenes.free import Twist
from maglev_mj.scenes.wall_scene import wall_controller
from maglev_mj.spec import INERTIA
from maglev_mj.studies.levels import apart, level_parts, motion_of

SEMI_IMPLICIT = [name for name in INTEGRATORS if name not in ("rk4", "corrected")]
CORRECTED: Any = partial(MuJoCoPlant, integrator="corrected")
ORDERS = [*((name, 1.0) for name in SEMI_IMPLICIT), ("rk4", 4.0)]


def slope(steps: list[float], errors: list[float]) -> float:
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def drop_controller(**gains: Any) -> Controller:
    gains = {"stiffness": 6000.0, "damping": 80.0, "pulse": 220.0, "pulse_width": 0.003} | gains
    return wall_controller(period=0.005, delay=0.0015, mass=0.7, **gains)


def free_top(time: Any, attitude: Array, spin: Array) -> Array:
    """Return the attitude of a free symmetric top, (K, 3).

    A rotation vector in closed form.

    It turns about its angular momentum at |L| / A and, the other way, about its own axis at (C - A) / A w_z:
    R(t) = exp(L/A t) R(0) exp(-(C - A)/A w_z t e_z).
    """
    a, _, c = INERTIA[3:]
    start = rotation_matrix(attitude)
    body = start.T @ spin
    momentum = start @ (np.array([a, a, c]) * body)
    around = rotation_matrix(time[:, None] * momentum / a)
    own = rotation_matrix(time[:, None] * np.array([0.0, 0.0, -(c - a) / a * body[2]]))
    turns = around @ start @ own
    w = 0.5 * np.sqrt(1.0 + np.trace(turns, axis1=1, axis2=2))
    x, y, z = ((turns[:, i, j] - turns[:, j, i]) / (4.0 * w) for i, j in ((2, 1), (0, 2), (1, 0)))
    return np.stack(rotation_vector(w, x, y, z, np.sqrt, np.arctan2), axis=-1)


def test_every_integrator_of_the_engine_has_a_name() -> None:
    assert set(INTEGRATORS.values()) == set(mujoco.mjtIntegrator.__members__)


@pytest.mark.parametrize(("integrator", "order"), ORDERS)
def test_a_free_twist_converges_to_the_symmetric_top(integrator: str, order: float) -> None:
    scene = Twist(delay=0.0)  # one step a stretch at most, the delay on the grid
    *_, ticks = level_parts(scene, "body")
    time = np.arange(ticks + 1) * 0.005
    truth = free_top(time, np.array([-0.04, 0.03, -0.02]), np.array([2.0, -1.5, 2.7]))
    steps, errors = [5e-3, 2.5e-3, 1.25e-3], []
    for step in steps:
        motion = motion_of(*level_parts(scene, "body", integrator=integrator, longest_step=step))
        errors.append(float(np.abs(motion.pose[:, 3:] - truth).max()))
    assert slope(steps, errors) == pytest.approx(order, abs=0.12)
    assert errors[-1] < (1e-9 if integrator == "rk4" else 1e-4)


@pytest.mark.parametrize(("integrator", "order"), [*ORDERS, ("corrected", 1.0)])
def test_a_flotor_in_a_hand_converges_to_its_closed_form(integrator: str, order: float) -> None:
    hand, pose = Hand(mass=0.2, damping=2.0, stiffness=400.0), [1e-3, 0.0, 3e-3, 0.0, 0.0, 0.0]
    steps, errors = [2.5e-3, 1.25e-3, 6.25e-4, 3.125e-4], []
    timing = Timing(period=0.005, delay=0.0)

    def places(plant: Any) -> Array:
        seen: list[Array] = []
        drive(plant, Controller([], period=0.005), 40, observe=lambda sample, _: seen.append(sample.pose))
        return np.array(seen)

    truth = places(ExactPlant(timing, pose=pose, hand=hand))
    kind = partial(MuJoCoPlant, integrator=integrator)
    for step in steps:
        moved = places(kind(timing, pose=pose, hand=hand, coils=False, longest_step=step))
        errors.append(float(np.abs(moved - truth).max()))
    assert slope(steps, errors) == pytest.approx(order, abs=0.12)


@pytest.mark.parametrize("longest", [None, 5e-4])
def test_corrected_steps_are_exact_in_translation_at_every_phase(longest: float | None) -> None:
    worst, start = 0.0, [5e-4, -3e-4, 4.5e-3, 0.0, 0.0, 0.0]
    for phase in np.arange(8) / 8.0:
        timing = Timing(phase=phase)
        traces = []
        exact = ExactPlant(timing, pose=start, record=True)
        for plant in (exact, CORRECTED(timing, pose=start, record=True, longest_step=longest)):
            drive(plant, drop_controller(), 60)
            traces.append(plant.trace())
        times = np.linspace(0.0, 0.3, 400)
        (pose, twist, force), (other, moved, same) = (trace.at(times) for trace in traces)
        worst = max(worst, float(np.abs(pose - other)[:, :3].max()))
        np.testing.assert_allclose(moved[:, :3], twist[:, :3], atol=1e-13)
        np.testing.assert_allclose(same, force, atol=1e-9)
    assert worst < 1e-14


@pytest.mark.parametrize("seed", range(12))
def test_corrected_steps_turn_within_the_figure_of_the_page(seed: int) -> None:
    random, traces = np.random.default_rng(seed), []
    way, stiffness, ratio = random.normal(size=3), random.uniform(0.5, 8.0), random.uniform(0.3, 1.0)
    pose = [0.0] * 3 + list(np.deg2rad(random.uniform(0.5, 5.0)) * way / np.linalg.norm(way))
    damping = 2.0 * ratio * np.sqrt(stiffness * np.array(INERTIA[3:]))
    laws = [Hold(axes=["rx", "ry", "rz"], stiffness=stiffness, damping=damping)]
    for options in ({"integrator": "corrected"}, {"longest_step": 5e-4}):
        plant: Any = MuJoCoPlant(Timing(), pose=pose, gravity=0.0, coils=False, record=True, **options)
        drive(plant, Controller(laws, period=0.005), 60)
        traces.append(plant.trace().at(np.arange(60) * 0.005))
    (pose_c, _, _), (pose_r, twist, _) = traces
    assert apart(pose_c, pose_r, published_device()) < 0.2e-6 * (np.linalg.norm(twist[:, 3:], axis=1) ** 2).max()


@pytest.mark.parametrize(
    ("options", "turning"),
    [
        ({"coils": False}, 1e-13),
        ({"integrator": "corrected"}, 1e-7),
        ({"coils": False, "driver_lag": True, "driver_time_constant": 1e-3}, 1e-7),
    ],
    ids=["raw", "corrected", "lag"],
)
def test_a_batch_moves_as_its_devices_do(options: dict[str, Any], turning: float) -> None:
    # where one device has a pulse all end a step, and the error of rotations depends on the steps
    random = np.random.default_rng(3)
    pose = random.uniform(-1.0, 1.0, (4, 6)) * [1e-3, 1e-3, 2e-3, 0.02, 0.02, 0.02] + [0, 0, 3e-3, 0, 0, 0]
    spin = random.uniform(-0.1, 0.1, (4, 6))
    last = drive(MuJoCoBatchPlant(Timing(), pose=pose, twist=spin, **options), drop_controller(), 40).pose
    for device in range(4):
        single = MuJoCoPlant(Timing(), pose=pose[device], twist=spin[device], **options)
        alone = drive(single, drop_controller(), 40).pose
        np.testing.assert_allclose(last[device, :3], alone[:3], atol=1e-15 if turning > 1e-8 else 1e-13)
        np.testing.assert_allclose(last[device, 3:], alone[3:], atol=turning)


def test_rotation_matrices_are_the_engine_s() -> None:
    vectors = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))
    vectors[0] = 0.0
    for vector, matrix, turn in zip(
        vectors, rotation_matrix(vectors), np.stack(quaternions(vectors), axis=-1), strict=True
    ):
        known, wanted = np.zeros(4), np.zeros(9)
        angle = float(np.linalg.norm(vector))
        mujoco.mju_axisAngle2Quat(known, vector / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
        mujoco.mju_quat2Mat(wanted, known)
        np.testing.assert_allclose(turn, known, atol=1e-15)
        np.testing.assert_allclose(matrix.ravel(), wanted, atol=1e-15)
