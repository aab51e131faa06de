"""Devices with more than six coils: currents of least norm, plants, limits, models, sessions and replays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Command, Controller, Device, MuJoCoPlant, Recording, Session, Timing, drive
from maglev_mj.control import Bias, Hold
from maglev_mj.device import devices, lag_of
from maglev_mj.errors import ModelError, ParameterError
from maglev_mj.frames import Array, rotation_matrix
from maglev_mj.plants import MuJoCoBatchPlant
from maglev_mj.plants.coils import CoilMap, wrench_of
from maglev_mj.plants.exact_coils import ExactCoilPlant
from maglev_mj.plants.model import check_model, load_model
from maglev_mj.plants.shapes import shapes
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session.replay import Replay, write_run
from tests.published import EIGHT

POSE = [3e-4, -2e-4, 5e-4, 0.02, -0.015, 0.03]
LIFT = (0.0, 0.0, 0.3 * 9.81, 0.0, 0.0, 0.0)
TIMING = Timing(period=0.001, delay=0.0009)


def first(count: int) -> Device:
    """Return the device with the first coils, or with further ones in other directions, above eight."""
    random, coils = np.random.default_rng(count), EIGHT.coils
    assert coils is not None
    points, more = [*coils.points], max(count - 8, 0)
    vectors = random.normal(size=(more, 3))
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return EIGHT.change(
        "coils",
        points=(points + random.uniform(-0.03, 0.03, (more, 3)).tolist())[:count],
        directions=[*coils.directions, *unit.tolist()][:count],
        force_constants=([*coils.force_constants] + [1.0] * more)[:count],
    )


def wrenches(coils: CoilMap, angle: Array) -> Array:
    """Return the map from currents to the wrench at an angle, (6, N), by its definition."""
    forces = coils.directions * coils.force_constants[:, None]
    return np.concatenate([forces.T, np.cross(coils.points @ rotation_matrix(angle).T, forces).T])


@pytest.mark.parametrize("count", [7, 8, 9, 12])
def test_currents_are_those_of_least_norm_at_any_angle(count: int) -> None:
    coils, random = CoilMap.of(first(count)), np.random.default_rng(1)
    assert len(coils) == count
    for size in (0.0, 1e-3, 0.07, 1.0):
        angle, wrench = size * random.normal(size=3), random.normal(size=6) * [20.0, 20.0, 20.0, 0.5, 0.5, 0.5]
        there, inverse = wrenches(coils, angle), coils.inverse_at_angle(*angle.tolist())
        currents = inverse @ wrench
        np.testing.assert_allclose(there @ currents, wrench, atol=1e-12)
        np.testing.assert_allclose(currents, np.linalg.lstsq(there, wrench)[0], atol=1e-11)
        many = coils.inverse_at(np.stack([rotation_matrix(angle).ravel()] * 2))
        np.testing.assert_allclose(many, np.stack([inverse] * 2), atol=1e-12)
        moved = currents + random.normal(size=count)  # not of least norm
        np.testing.assert_allclose(wrench_of(inverse, moved), there @ moved, atol=1e-11)
        np.testing.assert_allclose(wrench_of(many, np.stack([moved] * 2))[1], there @ moved, atol=1e-11)
    upright = wrenches(coils, np.zeros(3))
    np.testing.assert_allclose(coils.wrench(coils.currents(np.arange(6.0))), np.arange(6.0), atol=1e-12)
    np.testing.assert_allclose(coils.wrench_per_current, upright, atol=1e-15)
    assert coils.condition_number(0.02) == pytest.approx(np.linalg.cond(upright / ([[1.0]] * 3 + [[0.02]] * 3)))


def motion(plant: Any, ticks: int = 40) -> tuple[Array, Array]:
    """Return pose and twist after a hold on all axes has acted on the plant."""
    hold = Hold.critically_damped(inertia=EIGHT.inertia, period=TIMING.period, delay=TIMING.delay)
    with plant:
        drive(plant, Controller([hold, Bias(LIFT)], period=TIMING.period), ticks)
        pose, twist = plant.state()
        return np.asarray(pose), np.asarray(twist)


@pytest.mark.parametrize("pose", [[0.0, 0.0, 5e-4, 0.0, 0.0, 0.0], POSE])
@pytest.mark.parametrize("options", [{}, {"integrator": "corrected"}, {"current_limit": 10.0}, {"stops": True}])
def test_a_plant_moves_as_the_body_under_the_wrench(options: dict[str, Any], pose: list[float]) -> None:
    options = options | {"driver_lag": False}
    driven = motion(MuJoCoPlant(TIMING, model=EIGHT, pose=pose, **options))
    ideal = motion(MuJoCoPlant(TIMING, model=EIGHT, pose=pose, coils=False, **options))
    # coils turn with the flotor between two samples, an ideal wrench does not
    tolerance = 1e-15 if not any(pose[3:]) else 1e-5
    np.testing.assert_allclose(driven[0], ideal[0], atol=tolerance)
    six = Device.load("stage")
    other = motion(MuJoCoPlant(TIMING, model=six, pose=pose, **options))
    np.testing.assert_allclose(driven[0], other[0], atol=tolerance)


def test_a_batch_moves_as_single_plants_and_lagging_currents_are_recorded_as_their_wrench() -> None:
    for options in ({"driver_lag": False}, {}):
        single = MuJoCoPlant(TIMING, model=EIGHT, pose=POSE, record=True, **options)  # type: ignore[arg-type]
        batch = MuJoCoBatchPlant(TIMING, model=EIGHT, pose=[POSE] * 2, record=True, **options)  # type: ignore[arg-type]
        hold = Hold.critically_damped(inertia=EIGHT.inertia, period=TIMING.period, delay=TIMING.delay)
        for plant in (single, batch):
            drive(plant, Controller([hold, Bias(LIFT)], period=TIMING.period), 20)
        for one, many in zip(single.trace().at(np.arange(20) * 1e-3), batch.trace().at(np.arange(20) * 1e-3)):
            # the coil map between two samples of a lagging wrench, as with six coils
            np.testing.assert_allclose(many[:, 1], one, atol=1e-12 if options else 1e-5)


def test_the_closed_form_with_currents_moves_as_the_engine() -> None:
    assert EIGHT.coils is not None
    own: dict[str, Any] = {"mass": 0.3, "inertia": EIGHT.inertia[3:], "reach": EIGHT.reach}
    exact = ExactCoilPlant(TIMING, coils=CoilMap.of(EIGHT), gravity=9.81, pose=POSE, lag=lag_of(EIGHT), **own)
    found = motion(exact)
    np.testing.assert_allclose(found[0], motion(MuJoCoPlant(TIMING, model=EIGHT, pose=POSE))[0], atol=1e-5)
    assert len(exact.currents) == len(exact.intervals[0][1]) == 8


@pytest.mark.parametrize("pose", [[0.0] * 6, POSE])
def test_the_largest_current_is_the_limit_and_the_wrench_keeps_its_direction(pose: list[float]) -> None:
    with MuJoCoPlant(TIMING, model=EIGHT, pose=pose, current_limit=2.0) as plant:
        position = plant.read().position
        for wrench in ([40.0, -3.0, 8.0, 0.1, 0.0, 0.05], [0.0, 0.0, 2.9, 0.0, 0.0, 0.0]):
            applied = np.array(plant.write(Command(wrench)).force)
            needed = CoilMap.of(EIGHT).inverse_at_angle(*position[3:]) @ wrench
            share = min(1.0, 2.0 / np.abs(needed).max())
            np.testing.assert_allclose(applied, share * np.array(wrench), atol=1e-12)
            plant.read()
            np.testing.assert_allclose(plant.currents, share * needed, rtol=1e-3, atol=1e-3)
            assert np.abs(plant.currents).max() <= 2.0 + 1e-12


def test_the_force_limit_is_where_the_first_coil_reaches_its_limit() -> None:
    coils, limit = CoilMap.of(EIGHT), EIGHT.force_limit
    np.testing.assert_allclose(np.abs(coils.currents(np.diag(limit))).max(axis=1), 10.0, atol=1e-9)
    np.testing.assert_allclose(coils.largest_wrench(10.0), limit, atol=1e-9)
    assert Drop(device=EIGHT.toml()).body.force_limit == limit[2]


@pytest.mark.parametrize("falloff", [0.0, 0.3])
def test_an_open_coil_is_missing_in_the_wrench(falloff: float) -> None:
    with MuJoCoPlant(TIMING, model=EIGHT, gravity=0.0, force_falloff=falloff) as plant:
        plant.open_coil(7)
        with pytest.raises(ParameterError, match="coil must be"):
            plant.open_coil(8)
        for _ in range(2):
            plant.read()
            plant.drive([0.0] * 7 + [1.0])
        assert not np.any(plant.state()[1])
        plant.restart([0.0] * 6)  # as new: the coil is whole
        for _ in range(2):
            plant.read()
            plant.drive([0.0] * 7 + [1.0])
        assert np.any(plant.state()[1])


@pytest.mark.parametrize("coil", [4, 7])
def test_each_coil_loses_force_towards_the_end_of_the_range(coil: int) -> None:
    coils, speeds = CoilMap.of(EIGHT), list[float]()
    along = coils.directions[coil]
    for falloff in (0.0, 0.5):
        pose, timing = [*(0.002 * along), 0.0, 0.0, 0.0], Timing(period=1e-3, delay=0.0)
        with MuJoCoPlant(timing, model=EIGHT, gravity=0.0, pose=pose, force_falloff=falloff) as plant:
            plant.read()
            plant.drive(np.eye(8)[coil].tolist())
            plant.read()
            speeds.append(float(plant.state()[1][:3] @ along))
    assert speeds[1] / speeds[0] == pytest.approx(0.5, abs=2e-3)


@pytest.mark.parametrize("name", devices())
def test_a_batch_of_any_device_moves_as_single_plants(name: str) -> None:
    device, pose = Device.load(name), [1e-4, 0.0, 2e-4, 0.0, 0.0, 0.0]
    single, batch = MuJoCoPlant(TIMING, model=device, pose=pose), MuJoCoBatchPlant(TIMING, model=device, pose=[pose])
    for plant in (single, batch):
        drive(plant, Controller([Bias((0.1, 0.0, 1.0, 0.0, 0.0, 0.0))], period=TIMING.period), 10)
    np.testing.assert_allclose(batch.state()[0][0], single.state()[0], atol=1e-15)


def test_a_model_is_checked_coil_by_coil(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text(EIGHT.mjcf())
    check_model(path, EIGHT)
    assert EIGHT.coils is not None
    loaded = load_model(path)
    assert loaded.coils is not None and len(loaded.coils) == 8 and loaded.current_limit == 10.0
    weaker = [*EIGHT.coils.force_constants[:7], 1.2]
    with pytest.raises(ModelError, match=r"^force constant of coil coil7 must be that of the device, 1\.2 N/A"):
        check_model(path, EIGHT.change("coils", force_constants=weaker))
    for device, count in ((first(7), 7), (Device.load("stage"), 6)):
        with pytest.raises(ModelError, match=rf"^number of coils must be that of the device, {count} \(got 8\)$"):
            check_model(path, device)
    with pytest.raises(ParameterError, match=r"^coil_map must have the model's 8 coils \(got 6\)$"):
        load_model(path, coil_map=CoilMap.of(Device.load("stage")))
    half = CoilMap(loaded.coils.points, loaded.coils.directions, 0.5 * loaded.coils.force_constants)
    changed = load_model(path, coil_map=half).model
    np.testing.assert_array_equal(changed.actuator_gainprm[:, 0], half.force_constants)


def test_each_coil_is_drawn_in_the_colour_of_its_own_current() -> None:
    drawn = [shape.coil for shape in shapes("scenes/box", EIGHT) if shape.coil]
    assert drawn == [f"coil{index}" for index in range(8)]


def test_a_session_and_a_replay_show_the_currents_of_all_coils(tmp_path: Path) -> None:
    session = Session(Joystick(device=EIGHT.toml()))
    for _ in range(20):
        session.tick(0.001)
    lift = CoilMap.of(EIGHT).currents(np.array(LIFT))
    np.testing.assert_allclose(session.snapshot().currents, lift, atol=1e-6)
    write_run(path := tmp_path / "run.maglev", Drop(device=EIGHT.toml(), duration=0.05), plant="exact")
    replay = Replay(Recording.load(path))
    assert replay.snapshot().currents.shape == (8,)
