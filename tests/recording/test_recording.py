"""Recordings written, read, replayed bitwise and shown; pictures of scenes without a window."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.errors import DivergenceError
from maglev_mj.frames import Command, Sample
from maglev_mj.recording import MemoryFile, Recording, RecordingError
from maglev_mj.recording.sample import as_rows, row_of
from maglev_mj.recording.verify import verify
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run_variants
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.session import Pacer, Session
from maglev_mj.session.replay import Replay, rebuild, record_run, recorded
from maglev_mj.session.snapshot import COLUMNS
from maglev_mj.views.window.offscreen import slow_motion, write_clip


def test_a_run_that_diverges_is_recorded_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "run.maglev"
    assert main(["drop", "--plant", "exact", "--stiffness", "4e4", "--delay", "0.005", "--record", str(path)]) == 1
    recording = Recording.load(path)
    assert recording.ticks > 5
    assert verify(recording, rebuild).same


def test_a_fault_of_another_run_is_no_event_of_a_recording() -> None:
    file = MemoryFile()
    runs = {"recorded": Drop(duration=0.1), "diverges": Drop(stiffness=4e4, delay=0.005)}
    with pytest.raises(DivergenceError):
        run_variants(runs, plant="exact", recording=recorded(file))
    assert file.recording.events == () and file.recording.ticks == 21
    with pytest.raises(DivergenceError):
        run_variants({"diverges": runs["diverges"]}, plant="exact", recording=recorded(file))
    assert len(file.recording.events) == 1 and file.recording.events[0].startswith("fault: ")


def test_a_setup_that_is_not_known_is_refused() -> None:
    (segment,) = record_run(Drop(), plant="exact").segments
    unknown = Recording([replace(segment, setup={"kind": "pinball", "run": segment.setup["run"]})])
    for refuse in (lambda: verify(unknown, rebuild), lambda: Replay(unknown)):
        with pytest.raises(RecordingError, match="cannot rebuild the recorded setup"):
            refuse()
    with pytest.raises(RecordingError, match="the recording has no samples"):
        Replay(Recording([]))


def test_a_replay_shows_what_was_recorded_in_real_time() -> None:
    recording = record_run(Pull(), plant="exact")
    replay = Replay(recording)
    shown = sum(replay.tick(0.0125) for _ in range(10))
    view = replay.snapshot()
    assert shown == 25
    assert (view.pose == recording.segments[0].position[25]).all()
    assert view.history.shape == (26, COLUMNS)
    assert view.anchors is not None
    replay.act("pause")
    assert replay.tick(1.0) == 0
    replay.act("start")
    assert (replay.snapshot().pose == recording.segments[0].position[0]).all()


@pytest.mark.needs("drawing")
def test_a_scene_is_drawn_without_a_window(tmp_path: Path) -> None:
    # In a process of its own, as a program draws with one library only.
    import imageio.v2
    import imageio_ffmpeg

    paths = {ending: tmp_path / f"scene.{ending}" for ending in ("png", "gif", "mp4")}
    options = ["--seconds", "0.4", "--fps", "5", "--time-scale", "0.5", "--size", "320x200"]
    program = "import sys; from maglev_mj.cli import main\n"
    program += f"for path in sys.argv[1:]: assert main(['render', 'drop', '--out', path, *{options}]) == 0"
    command = [sys.executable, "-c", program, *map(str, paths.values())]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "silent" not in done.stdout
    assert imageio_ffmpeg.count_frames_and_secs(str(paths["mp4"]))[0] == 4
    picture, frames = imageio.v2.imread(paths["png"]), imageio.v2.mimread(paths["gif"])
    assert len(frames) == 4 and (frames[0] != frames[-1]).any()
    for one in (picture, frames[0]):
        assert one.shape[:2] == (200, 320)
        assert float(np.asarray(one, dtype=float).std()) > 10.0


def test_a_clip_of_a_short_run_is_slowed_to_last_four_seconds() -> None:
    scales = {2e-3: 0.001, 0.04: 0.01, 0.08: 0.02, 0.3: 0.05, 0.4: 0.1, 0.99: 0.2, 1.0: 1.0, 4.6: 1.0}
    assert {seconds: slow_motion(seconds) for seconds in scales} == scales


def test_a_clip_keeps_the_colour_of_a_small_mark(tmp_path: Path) -> None:
    from PIL import Image as image

    rows, columns = np.mgrid[0:200, 0:320]
    shades = np.stack([(rows + columns) / 2.6, rows / 1.3, columns / 1.6], axis=-1).astype(np.uint8)
    frames = np.stack([shades, shades])
    frames[:, 100, 150:170] = green = np.array([0, 158, 115], dtype=np.uint8)
    write_clip(frames, tmp_path / "a.gif", 10)
    with image.open(tmp_path / "a.gif") as clip:
        assert (clip.info["duration"], clip.size) == (200, (320, 200))  # two of one kind
        assert not getattr(clip, "is_animated", True)
        seen = np.array(clip.convert("RGB"), dtype=int)[100, 155:165]
    assert np.abs(seen - green).max() < 20


def test_each_gap_of_a_slow_session_is_its_own_ticks(tmp_path: Path) -> None:
    # One tick a frame is all that the budget allows, of ten, of six, of ten: the others are given up.
    session = Session(record=tmp_path / "run.maglev", pacer=Pacer(budget=1e-9, patience=0.0))
    for frame in (0.05, 0.03, 0.05):
        session.tick(frame)
    session.close()
    recording = Recording.load(tmp_path / "run.maglev")
    (segment,) = recording.segments
    assert list(segment.gaps) == [(1, 9), (2, 5), (3, 9)]
    assert list(recording.events) == [f"missed: {count} ticks skipped: slower than real time" for count in (9, 5, 9)]


def test_a_recorded_run_is_the_run_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = list[Any]()
    whole = Drop.plant

    def plant_of(scene: Drop, *arguments: Any, **options: Any) -> Any:
        made.append(whole(scene, *arguments, **options))
        return made[-1]

    monkeypatch.setattr(Drop, "plant", plant_of)
    words = f"drop --plant exact --phase 0.3 --duration 0.1 --record {tmp_path}/run.maglev".split()
    assert main([*words, "--json", "-"]) == 0
    assert len(made) == 2  # one run, recorded and told, and one that shows whether it is chaotic
    said = json.loads(capsys.readouterr().out)
    (segment,) = Recording.load(tmp_path / "run.maglev").segments
    trace = made[0].trace()
    pose, _, _ = trace.at(segment.time)
    assert segment.position.tolist() == pose.tolist() and said["parameters"]["phase"] == 0.3


def test_the_values_of_a_cycle_are_in_the_order_of_the_fields() -> None:
    sixes = np.arange(36.0).reshape(6, 6).tolist()
    position, force, pulse, applied, extra, effort = sixes
    plant = SimpleNamespace(hand_wrench=effort, arrival=7.5)
    cycle = Sample(3, 0.5, position), Command(force, pulse, 0.1), Command(applied, extra, 0.2)
    (row,) = as_rows([row_of(*cycle, plant)])
    names = "position", "command", "pulse", "applied", "applied_pulse", "hand"
    assert [row[name].tolist() for name in names] == sixes
    assert [row[name] for name in ("tick", "time", "pulse_width", "applied_pulse_width")] == [3.0, 0.5, 0.1, 0.2]
    assert row["arrival"] == 7.5 and len(row.dtype) == len(names) + 5
    without = Command(force, None, 0.1)  # whose width is of no pulse
    (row,) = as_rows([row_of(cycle[0], without, without, SimpleNamespace(hand_wrench=effort))])
    assert not (row["pulse"].any() or row["applied_pulse"].any() or row["pulse_width"] or row["applied_pulse_width"])
    assert np.isnan(row["arrival"])
