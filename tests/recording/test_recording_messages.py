"""Contents of recordings for other programs: topics by their schemas, frames, scene, log."""

import json
import subprocess
import sys
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from maglev_mj import colours
from maglev_mj.cli.output import LAYOUT
from maglev_mj.device import Device, Knob
from maglev_mj.frames import ZERO, quaternion
from maglev_mj.plants.shapes import ARROW, arrow_start, shapes
from maglev_mj.recording import open_recording
from maglev_mj.recording.mcap import SAMPLE
from maglev_mj.recording.sample import FIELDS, ROW, RunMetadata, Totals
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.session.replay import write_run
from tests.recorded import decoder, exported, load, messages_in

TOPICS = ("/maglev/segment", "/maglev/sample", "/maglev/event", "/tf", "/maglev/shapes", "/maglev/arrows", "/log")


RUNS: dict[str, Scene] = {
    "press": Press(hits=1),
    "stick-slip turned": Pull(axis="ry"),
    "stage": Press(hits=1, interval=0.1, device="stage"),
    "arm": Press(hits=1, interval=0.1, device="arm"),
}
together = pytest.mark.xdist_group("recorded messages")


@cache
def run_of(name: str) -> bytes:
    """Return the recording of a run."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.maglev"
        write_run(path, RUNS[name], plant="exact")
        return path.read_bytes()


@cache
def file_of(name: str) -> bytes:
    """Return the recording of a run as MCAP."""
    return exported(run_of(name), "mcap")


def found_in(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Return all messages by topic, decoded by their schemas."""
    found: dict[str, list[dict[str, Any]]] = {topic: [] for topic in TOPICS}
    for topic, message in messages_in(path.read_bytes(), TOPICS):
        found[topic].append(message)
    return found


def numbers(message: dict[str, float]) -> list[float]:
    return list(message.values())


@together
@pytest.mark.parametrize("name", ["press", "stick-slip turned"])
def test_frames_are_where_the_flotor_is_and_the_stick_position_where_it_sticks(name: str, tmp_path: Path) -> None:
    from maglev_mj.session.replay import rebuild, stick_positions_of

    path = tmp_path / "run.mcap"
    path.write_bytes(file_of(name))
    (segment,) = load(run_of(name), tmp_path).segments
    sticks, found = stick_positions_of(segment, rebuild), found_in(path)
    turns = np.floor((segment.time - segment.time[0]) * 60.0 + 1e-6)
    shown = [row for row in range(len(segment)) if row == 0 or turns[row] > turns[row - 1]]
    assert len(found["/tf"]) == len(shown) > 10
    for message, row in zip(found["/tf"], shown, strict=True):
        frames = {frame["child_frame_id"]: frame for frame in message["transforms"]}
        wanted = {"flotor": segment.position[row]}
        if sticks is not None:
            wanted["stick position"] = np.where(np.isnan(sticks[row]), segment.position[row], sticks[row])
        assert set(frames) == {*wanted, "hand"}
        for frame, pose in wanted.items():
            assert frames[frame]["parent_frame_id"] == "stator"
            assert numbers(frames[frame]["translation"]) == pose[:3].tolist()
            assert [frames[frame]["rotation"][part] for part in "wxyz"] == list(quaternion(pose[3:]))
        assert frames["hand"]["parent_frame_id"] == "flotor"
        assert numbers(frames["hand"]["translation"]) == Knob().centre.tolist()


@together
def test_the_scene_has_the_device_its_walls_and_forces_from_the_knob_on(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(file_of("press"))
    (segment,) = load(run_of("press"), tmp_path).segments
    found = found_in(path)
    (first,), updates = found["/maglev/shapes"], found["/maglev/arrows"]
    entities = {entity["id"]: entity for entity in first["entities"]}
    drawn, counts = shapes("maglev"), {"box": "cubes", "cylinder": "cylinders", "ellipsoid": "spheres"}
    for frame, moves in (("stator", False), ("flotor", True)):
        assert entities[frame]["frame_id"] == frame
        for kind, name in counts.items():
            of_it = [shape for shape in drawn if (shape.moves, shape.kind) == (moves, kind)]
            assert len(entities[frame][name]) == len(of_it)
            for shape, made in zip(of_it, entities[frame][name], strict=True):
                assert numbers(made["size"]) == (2.0 * shape.half).tolist()
                assert numbers(made["pose"]["position"]) == shape.position.tolist()
    assert len(entities["flotor"]["cubes"]) > 20 and len(entities["stator"]["cubes"]) > 50
    (wall,) = entities["walls"]["cubes"]
    assert wall["size"]["z"] < 1e-3 < wall["size"]["x"] and 0.0 < wall["color"]["a"] < 0.5
    assert [wall["color"][part] for part in "rgb"] == pytest.approx(colours.WALL)
    most = 0
    for update in updates:
        for entity in update["entities"]:
            assert entity["frame_id"] == "stator" and entity["id"] in ("force of the hand", "force of the device")
            for arrow in entity["arrows"]:
                turn = arrow["pose"]["orientation"]
                x, y, z, w = (turn[name] for name in "xyzw")
                along = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
                force = np.array(along) * (arrow["shaft_length"] + arrow["head_length"]) / ARROW
                name, colour = ("hand", colours.HAND) if "hand" in entity["id"] else ("applied", colours.DEVICE)
                assert [arrow["color"][part] for part in "rgb"] == pytest.approx(colour)
                near = np.abs(getattr(segment, name)[:, :3] - force).max(axis=1).min()
                assert near < 1e-9
                most += 1
    assert most > 20


@together
@pytest.mark.parametrize("name", ["stage", "arm"])
def test_the_scene_has_the_device_in_use(name: str, tmp_path: Path) -> None:
    path, device = tmp_path / "run.mcap", Device.load(name)
    path.write_bytes(file_of(name))
    found = found_in(path)
    entities = {entity["id"]: entity for entity in found["/maglev/shapes"][0]["entities"]}
    sizes = [numbers(part["size"]) for kind in ("cylinders", "spheres") for part in entities["flotor"][kind]]
    own = [(2.0 * shape.half).tolist() for shape in shapes("maglev", device) if shape.moves]
    assert sorted(sizes) == sorted(own) and (2.0 * device.knob.half).tolist() in own
    assert not entities["stator"]["cubes"] and not entities["flotor"]["cubes"]  # parts of the published joystick
    (wall,) = entities["walls"]["cubes"]
    assert wall["size"]["x"] == pytest.approx(device.knob.radius * 32.0 / 11.0)
    hand = next(frame for frame in found["/tf"][0]["transforms"] if frame["child_frame_id"] == "hand")
    assert numbers(hand["translation"]) == device.knob.centre.tolist()
    drawn = [entity["arrows"] for update in found["/maglev/arrows"] for entity in update["entities"]]
    sides = [abs(arrow["pose"]["position"]["x"]) for arrows in drawn for arrow in arrows]
    assert sides and max(sides) <= device.knob.radius + 1e-3


def test_the_device_is_that_of_the_scene_or_of_a_plant_recorded_without_one() -> None:
    from maglev_mj.recording.messages import device_of

    stage = Device.load("stage")
    setups: list[dict[str, Any]] = [
        {"parameters": {"device": "stage"}, "plant": {"model": "drop"}},
        {"parameters": {"device": stage.toml()}},
        {"plant": {"model": {"device": stage.toml()}}},
    ]
    assert [device_of(setup) for setup in setups] == [stage] * 3
    published: list[dict[str, Any]] = [{}, {"plant": {"model": "maglev"}}, {"plant": {}}]
    assert all(device_of(setup).published for setup in published)


def test_events_are_in_the_log_each_with_its_level(tmp_path: Path) -> None:
    from maglev_mj.control.controller import Controller
    from maglev_mj.control.loop import drive
    from maglev_mj.plants import ExactPlant, Timing

    path, kinds = tmp_path / "run.maglev", {"fault": 4, "lost": 4, "missed": 3, "timing": 2, "landing": 2}
    file, plant = open_recording(path, wait=True), ExactPlant(Timing())
    controller = Controller([], period=plant.timing.period)
    drive(plant, controller, 3, record=file.begin(plant, controller))
    for kind in kinds:
        file.event(kind, "for a test")
    file.close()
    path.write_bytes(exported(path.read_bytes(), "mcap"))
    begun, *told = found_in(path)["/log"]
    assert begun["level"] == 2 and begun["message"] == "segment 1: own run"
    assert [(one["level"], one["message"]) for one in told] == [
        (level, f"{kind}: for a test") for kind, level in kinds.items()
    ]
    assert [event["kind"] for event in found_in(path)["/maglev/event"]] == list(kinds)


FORCES = [(0.0, 0.0, 1.0), (-2.0, 0.0, 0.0), (3.0, 0.0, 0.0), (-1.0, 1e-12, 0.0), (1.0, -2.0, 3.0)]


def test_an_arrow_points_along_its_force_and_none_is_drawn_of_a_force_too_small_to_see() -> None:
    from foxglove.messages import SceneEntity

    from maglev_mj.recording.messages import _arrow

    knob = Knob(radius=0.01, height=0.03)
    for force in FORCES:
        entity = SceneEntity(arrows=_arrow(knob.centre, force, (1.0, 1.0, 1.0, 1.0), knob))
        (arrow,) = decoder(entity.get_schema())(entity.encode())["arrows"]
        x, y, z, w = (arrow["pose"]["orientation"][name] for name in "xyzw")
        along = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
        assert np.abs(along - np.array(force) / np.linalg.norm(force)).max() < 1e-9
        assert numbers(arrow["pose"]["position"]) == arrow_start(knob.centre, np.array(force), knob).tolist()
    for force in (ZERO[:3], (0.01, 0.0, 0.0), (np.nan, 0.0, 0.0), (np.inf, 0.0, 0.0)):
        assert _arrow(knob.centre, force, (1.0, 1.0, 1.0, 1.0), knob) == []


def test_each_topic_and_field_of_the_foxglove_layout_is_in_a_recording() -> None:
    summary = make_reader(BytesIO(file_of("press"))).get_summary()
    assert summary is not None
    schemas = {one.topic: summary.schemas[one.schema_id].name for one in summary.channels.values()}
    panels = json.loads(LAYOUT.read_text())["configById"]
    assert sorted(panels["3D!device"]["topics"]) == sorted(topic for topic, name in schemas.items() if "Scene" in name)
    assert schemas[panels["RosOut!log"]["topicToRender"]] == "foxglove.Log"
    plotted = [one["value"] for name in ("Plot!position", "Plot!force") for one in panels[name]["paths"]]
    assert len(plotted) == 6 and {*plotted} <= {f"{SAMPLE}.{name}" for field in FIELDS for name, _ in field.units}


@pytest.mark.needs("rerun")
def test_rerun_finds_the_flotors_transform_and_fields_by_name(tmp_path: Path) -> None:
    path, script = tmp_path / "run.mcap", Path(__file__).parents[2] / "scripts" / "examples" / "rerun_recording.py"
    path.write_bytes(file_of("press"))
    (segment,) = load(run_of("press"), tmp_path).segments
    done = subprocess.run([sys.executable, str(script), str(path), "position.z"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    least = float(segment.position[:, 2].min())
    assert "Transform3D of the flotor: " in done.stdout
    assert f"Scalars of position.z: {len(segment)} rows, least {least!r}" in done.stdout


def test_totals_of_many_samples_are_those_of_one_by_one_to_the_last_bit() -> None:
    period, delay = 5e-5, 1e-4
    random, count = np.random.default_rng(0), 200
    rows = np.zeros(count, ROW)
    rows["tick"] = np.cumsum(1 + random.integers(0, 20, count) // 19)  # some are missing
    rows["time"] = rows["tick"] * period
    for name in ("position", "applied", "hand"):
        rows[name] = random.normal(size=(count, 6))
    pulsed = random.random(count) < 0.2
    rows["applied_pulse"] = random.normal(size=(count, 6))
    rows["applied_pulse_width"] = np.where(pulsed, period * random.choice([0.2, 0.7, 1.0, 2.5], count), 0.0)
    carried: dict[str, Any] = dict.fromkeys(("load", "before", "carried"), np.array([0.1, 0.0, -6.9, 0.0, 0.0, 0.01]))
    metadata = RunMetadata(period=period, delay=delay, inertia=np.array([0.7, 0.7, 0.7, 9e-4, 9e-4, 8e-4]), **carried)
    alone, together = Totals(metadata), Totals(metadata)
    alone.miss(3)
    together.miss(3)
    expected = np.concatenate([alone.take(rows[row : row + 1]) for row in range(count)])
    blocks = np.split(rows, [1, 2, 150, 153, 190])
    assert np.concatenate([together.take(block) for block in blocks]).tobytes() == expected.tobytes()
    assert expected[-1, 2] > 3 and (expected[-1, :2] != 0.0).all()
