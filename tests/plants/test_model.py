"""Device model: Table 1, symmetry, all scenes, no excess."""

from __future__ import annotations

import itertools
import math
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj import Controller, Hold, MuJoCoPlant, Timing, Wall, drive
from maglev_mj.device import COILS, Device, Knob
from maglev_mj.errors import ModelError, ParameterError
from maglev_mj.frames import Array, quaternion
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.hand import Hand, get_hand
from maglev_mj.plants.model import CompiledModel, load_model, scenes
from maglev_mj.plants.shapes import (
    device_report,
    envelope,
    position_bandwidth,
    shapes,
    wall_box,
)
from maglev_mj.spec import DRIVER_TIME_CONSTANT, GRAVITY, INERTIA, Spec
from maglev_mj.terminal import WIDTH
from tests.sweeps import sweep

SPEC = Spec()


@pytest.fixture(scope="module")
def device() -> CompiledModel:
    return load_model("maglev", lean=False)


def coil_map(device: CompiledModel) -> CoilMap:
    assert device.coils is not None
    return device.coils


# -- the drawn handle and walls --------------------------------------------------------------------------


@pytest.mark.parametrize("knob", [Knob(), Device.load("stage").knob], ids=["ubc", "stage"])
@pytest.mark.parametrize("count", range(7))
def test_walls_are_one_box_of_plates_that_the_knob_touches(count: int, knob: Knob) -> None:
    six = [(axis, normal, -2e-3 * normal) for axis in range(3) for normal in (1.0, -1.0)]
    for faces in itertools.combinations(six, count):
        plates, edges = wall_box([*faces, (3, 1.0, -0.05)], knob)  # the wall of a rotation has none
        assert tuple(plates) == faces
        for (axis, normal, edge), (centre, half) in plates.items():
            height = knob.half[axis] if axis < 2 or normal < 0.0 else knob.height - knob.bottom
            touching = knob.centre[axis] + edge - normal * height  # the side of the knob towards the wall
            assert centre[axis] + normal * half[axis] == pytest.approx(touching, abs=1e-12)
            assert 0.0 < half[axis] < 1e-3 and (np.delete(half, axis) > 0.7 * knob.radius).all()
            assert sum((axis, normal, edge) in walls for _, walls in edges) == 4
        corners = [frozenset(tuple(end) for end in ends.round(9)) for ends, _ in edges]
        assert len(corners) == len({*corners}) <= 12 and len(frozenset().union(*corners)) <= 8  # each once, of one box


def test_a_device_of_a_file_is_drawn_with_its_own_coils_and_knob() -> None:
    stage = Device.load("stage")
    assert stage.coils is not None
    drawn = shapes("scenes/box", stage)
    points = np.array(stage.coils.points) - stage.body.centre_of_mass
    assert all(shape.moves for shape in drawn)  # none of the published stator
    assert {shape.coil: shape.position.tolist() for shape in drawn if shape.coil} == {
        f"coil{index}": pytest.approx(point.tolist(), abs=1e-12) for index, point in enumerate(points)
    }
    assert any(np.allclose(part.half, stage.knob.half) and np.allclose(part.position, [0, 0, 0.04]) for part in drawn)
    arm = shapes("scenes/box", Device.load("arm"))
    assert not any(part.coil for part in arm) and any(np.allclose(part.half, Knob().half) for part in arm)
    published = shapes("scenes/box", Device.load("ubc"))
    assert len(published) > 100 and not all(part.moves for part in published)


# -- Table 1, row by row ---------------------------------------------------------------------------------


def test_the_model_is_that_of_table_1(device: CompiledModel) -> None:
    compiled, coils = device.model, coil_map(device)
    assert envelope(device) == pytest.approx((SPEC.radius.value, SPEC.height.value), abs=1e-9)
    assert compiled.body("stator").mass[0] == SPEC.stator_mass.value
    assert compiled.body("flotor").mass[0] == SPEC.flotor_mass.value
    assert load_model("drop").mass == device.mass == pytest.approx(SPEC.moving_mass.value, rel=1e-15)
    for axis in "xyz":
        assert compiled.joint(axis).range.tolist() == [-SPEC.translation_range.value, SPEC.translation_range.value]
    assert math.degrees(compiled.joint("rotation").range[1]) == pytest.approx(SPEC.rotation_range.value, rel=1e-15)
    # 2 kHz (section 2), where Table 1 says more than 3 kHz
    assert device.driver_time_constant == DRIVER_TIME_CONSTANT
    assert 2.0 * math.pi * SPEC.driver_bandwidth.value * DRIVER_TIME_CONSTANT == pytest.approx(1.0, rel=1e-12)
    assert (compiled.actuator_gainprm[:6, 0] == SPEC.force_constant.value).all()
    assert (compiled.actuator_ctrlrange[:6] == [-SPEC.peak_current.value, SPEC.peak_current.value]).all()
    data = mujoco.MjData(compiled)
    data.ctrl[:] = 25.0
    mujoco.mj_forward(compiled, data)
    assert (data.actuator_force == SPEC.force_constant.value * SPEC.peak_current.value).all()
    np.testing.assert_allclose(np.hypot(*coils.points[:3, :2].T), SPEC.coil_radius.value, rtol=1e-15)
    assert coils.largest_wrench(10.0)[2] == pytest.approx(SPEC.largest_vertical_force.value)
    for index, largest in enumerate(coils.largest_wrench(10.0)):
        wrench = np.zeros(6)
        wrench[index] = largest
        assert np.abs(coils.currents(wrench)).max() == pytest.approx(10.0)
    hover = coils.currents(np.array([0, 0, device.mass * GRAVITY, 0, 0, 0]))
    np.testing.assert_allclose(hover, [1.14, 1.14, 1.14, 0, 0, 0], atol=5e-3)


def test_range_is_a_stop_in_the_device() -> None:
    # Pushed with 60 N against its range the flotor stays inside it but for the stop's own softness.
    device = load_model("maglev")
    data = mujoco.MjData(device.model)
    data.ctrl[:3] = 10.0
    for _ in range(2000):
        mujoco.mj_step(device.model, data)
    assert data.qpos[2] == pytest.approx(SPEC.translation_range.value, abs=5e-5)


def test_payload_of_table_1_contradicts_its_current(device: CompiledModel) -> None:
    # 2 kg beside the 0.65 kg flotor takes 4.33 A a coil, not 3 A.
    coils = coil_map(device)
    lifted = coils.largest_wrench(SPEC.continuous_current.value)[2] / GRAVITY - SPEC.flotor_mass.value
    assert lifted == pytest.approx(1.185, abs=1e-3) and lifted < SPEC.payload.value
    weight = (SPEC.payload.value + SPEC.flotor_mass.value) * GRAVITY
    assert np.abs(coils.currents(np.array([0, 0, weight, 0, 0, 0]))).max() == pytest.approx(4.33, abs=5e-3)


def test_closed_loop_position_response() -> None:
    # Above 30 Hz in translation and 15 Hz in rotation, with the paper's own gains, rate and delay.
    loop = {"period": 1.0 / SPEC.control_rate.value, "delay": SPEC.transport_delay.value}
    for axis in ("z",):
        assert position_bandwidth(axis, stiffness=6000.0, damping=80.0, **loop) > SPEC.translation_bandwidth.value
    for axis in ("rx", "rz"):
        assert position_bandwidth(axis, stiffness=8.0, damping=0.1, **loop) > SPEC.rotation_bandwidth.value


def test_measured_bandwidth_is_that_of_the_sampled_loop() -> None:
    # Against the closed-loop frequency response by z-transform, at T_d = 0: B/(A) of the PD on a double integrator.
    k, b, period, mass = 3000.0, 60.0, 0.002, 0.7
    frequencies = np.linspace(1.0, 200.0, 40_000)
    z = np.exp(2j * np.pi * frequencies * period)
    plant = period**2 / (2.0 * mass) * (z + 1.0) / (z - 1.0) ** 2
    feedback = k + b / period * (1.0 - 1.0 / z)
    response = np.abs(k * plant / (1.0 + plant * feedback))
    expected = frequencies[np.argmax(response < math.sqrt(0.5))]
    measured = position_bandwidth("z", stiffness=k, damping=b, period=period, delay=0.0)
    assert measured == pytest.approx(expected, rel=0.01)


# -- geometry and map ------------------------------------------------------------------------------------


def test_device_has_threefold_symmetry(device: CompiledModel) -> None:
    turn = np.array([[-0.5, -math.sqrt(0.75), 0.0], [math.sqrt(0.75), -0.5, 0.0], [0.0, 0.0, 1.0]])
    coils = coil_map(device)
    for kind in (0, 3):
        for arm in range(3):
            one, following = kind + arm, kind + (arm + 1) % 3
            np.testing.assert_allclose(coils.points[following], turn @ coils.points[one], atol=1e-15)
            np.testing.assert_allclose(coils.directions[following], turn @ coils.directions[one], atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 0.02, 0.1, 1.0])
def test_coil_map_is_the_engine_s_at_any_angle(device: CompiledModel, angle: float) -> None:
    compiled, data = device.model, mujoco.MjData(device.model)
    vector = angle * np.array([0.6, -0.48, 0.64])
    data.qpos[3:7] = quaternion(vector)
    data.qpos[:3] = [1e-3, -2e-3, 3e-3]
    mujoco.mj_forward(compiled, data)
    moment = np.zeros((6, 6))
    mujoco.mju_sparse2dense(moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
    engine = moment.T * SPEC.force_constant.value
    engine[3:] = rotation.reshape(3, 3) @ engine[3:]  # the engine's torque is in flotor axes
    np.testing.assert_allclose(coil_map(device).inverse_at(rotation) @ engine, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(coil_map(device).inverse_at_angle(*vector.tolist()) @ engine, np.eye(6), atol=1e-12)


def test_coils_that_cannot_give_every_wrench_are_refused(device: CompiledModel) -> None:
    coils = coil_map(device)
    with pytest.raises(ModelError, match="singular"):
        CoilMap(coils.points, np.tile([0.0, 0.0, 1.0], (6, 1)), coils.force_constants)
    with pytest.raises(ParameterError, match="current must be at least 0"):
        coils.largest_wrench(-1.0)


@pytest.mark.parametrize(
    ("scene", "mass", "flexible", "held"),
    sweep(
        scenes(),
        [None, 0.35, 2.7],
        [False, True],
        [None, get_hand("arm"), Hand(mass=0.2, grip_damping=3.0, grip_stiffness=2000.0)],
        every=4,
    ),
)
def test_every_compiled_model_is_the_one_device(
    scene: str, mass: float | None, flexible: bool, held: Hand | None
) -> None:
    # Mass, moments, and the centre of mass at the origin: by mass matrix and weight, upright and turned.
    one = load_model(scene, mass=mass, hand=held, flexible=flexible)
    body = np.array([*[mass or INERTIA[0]] * 3, *INERTIA[3:]])
    data, full = mujoco.MjData(one.model), np.zeros((one.model.nv, one.model.nv))
    one.model.opt.gravity[:] = 0.0, 0.0, -GRAVITY
    flotor = slice(one.velocity_address, one.velocity_address + 6)
    for turn in ([0.0, 0.0, 0.0], [0.05, -0.08, 0.03]):
        data.qpos[one.position_address + 3 :][:4] = quaternion(turn)
        mujoco.mj_forward(one.model, data)
        mujoco.mj_fullM(one.model, data, full)
        # a hand in a rigid grip is so much more mass along its axes, and no weight
        carried = np.array([held.values[0] * (not held.soft)] * 3 + [0.0] * 3) if held else np.zeros(6)
        np.testing.assert_allclose(full[flotor, flotor], np.diag(body + carried), rtol=1e-14, atol=1e-17)
        weight = [0.0, 0.0, body[0] * GRAVITY, 0.0, 0.0, 0.0]
        np.testing.assert_allclose(data.qfrc_bias[flotor], weight, rtol=1e-14, atol=1e-16)


# -- every model file ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", scenes())
def test_every_scene_runs_with_noise_and_without_a_warning(name: str) -> None:
    compiled = load_model(name, lean=False).model
    data = mujoco.MjData(compiled)
    random = np.random.default_rng(5)
    for _ in range(500):
        data.ctrl[:] = random.normal(scale=1.0, size=compiled.nu)
        mujoco.mj_step(compiled, data)
    assert not data.warning.number.any()
    assert np.isfinite(data.qpos).all()


# -- no more than a scene needs --------------------------------------------------------------------------


def drop_bits(scene: str = "drop", **options: Any) -> tuple[Array, ...]:
    """Return every switch of a drop: times, poses, velocities, wrenches."""
    plant = MuJoCoPlant(Timing(phase=0.3), model=scene, pose=[0, 0, 4e-3, 0, 0, 0], record=True, **options)
    wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0, pulse=220.0, pulse_width=0.003)
    others = ("x", "y", "rx", "ry", "rz")
    hold = Hold.critically_damped(others, inertia=np.delete(INERTIA, 2), period=0.005, delay=0.0015)
    drive(plant, Controller([wall, hold], period=0.005), 80)
    trace = plant.trace()
    return trace.time, trace.pose, trace.twist, trace.wrench


def test_what_the_drop_leaves_out_would_not_change_one_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    bits = drop_bits()
    monkeypatch.setattr("maglev_mj.plants.engine.load_model", lambda *a, **k: load_model(*a, **k, lean=False))
    assert all(one.tobytes() == other.tobytes() for one, other in zip(bits, drop_bits(), strict=True))
    # with the handle as a body of its own, mass and inertia are summed in another order: equal to rounding only
    for one, other in zip(bits, drop_bits("maglev"), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("scene", ["drop", "maglev"])
def test_the_engine_neither_resets_nor_clamps(scene: str) -> None:
    option, off = MuJoCoPlant(model=scene).device.model.opt, mujoco.mjtDisableBit
    assert option.integrator == mujoco.mjtIntegrator.mjINT_RK4
    assert option.disableflags & off.mjDSBL_AUTORESET and option.disableflags & off.mjDSBL_CLAMPCTRL


# -- the report ------------------------------------------------------------------------------------------


def test_report_prints_table_1_beside_the_model() -> None:
    report = device_report()
    text = str(report.table())
    for words in ("wrench per ampere", "condition number", "hover current", "at 3 A", "at 10 A", "4.33 A", *COILS):
        assert words in text
    assert all(len(line) <= WIDTH for line in text.splitlines())
    rows = {row[0]: row[1:3] for row in report.table().rows}
    assert len(rows) == len(report.table().rows) == 17
    assert report.figures["condition_number"] == pytest.approx(2.02, abs=0.01)
    assert rows["continuous payload"] == (2.0, pytest.approx(1.185, abs=5e-4))
    echoed = {name for name, (_, model) in rows.items() if math.isnan(model)}
    assert echoed == {"sensor resolution, translation", "sensor resolution, rotation", "continuous current per coil"}
