"""Recordings written during a run: content, survival, other readers."""

import json
import math
import os
import subprocess
import sys
import time
import tracemalloc
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.analysis import analyse
from maglev_mj.cli import main
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import Recording, RecordingError, open_recording, setup_of
from maglev_mj.recording.verify import verify
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run as run_scene
from maglev_mj.session import Pacer, Session
from maglev_mj.session.replay import Replay, rebuild, write_run
from maglev_mj.spec import INERTIA
from maglev_mj.versions import hash_of
from tests.elsewhere import START
from tests.processes import PATIENCE
from tests.recorded import exported, messages_in
from tests.sweeps import sweep

ROOT = Path(__file__).parents[2]


def messages(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Return the run's messages in its export as MCAP, by a plain reader."""
    return messages_in(exported(path.read_bytes(), "mcap"))


@pytest.mark.parametrize(("phase", "delay"), sweep([0.0, 0.3, 0.7], [0.0015, 0.007], every=3))
def test_energy_taken_is_what_the_actuators_took_from_a_fall(phase: float, delay: float, tmp_path: Path) -> None:
    # Against the work of the exact motion up to the last sample.
    path = tmp_path / "run.maglev"
    drop = Drop(delay=delay, stiffness=2000.0)
    write_run(path, drop, plant="exact", phase=phase)
    (segment,) = Recording.load(path).segments
    result, end = run_scene(drop, plant="exact", phase=phase), segment.time[-1]
    z, speed = (float(part[0, 2]) for part in result.trace.at(np.array([end]))[:2])
    fallen = 0.7 * 9.81 * (drop.height - z) - 0.5 * 0.7 * speed**2
    assert messages(path)[-1][1]["taken"] == pytest.approx(fallen, rel=1e-9)
    assert fallen > 0.01


def test_energy_of_a_session_goes_on_with_what_acted_before(tmp_path: Path) -> None:
    path = tmp_path / "run.maglev"
    session = Session(Drop(), record=path, pacer=Pacer(budget=60.0, patience=3600.0))
    for frame in range(24):
        session.tick(1.0 / 60.0)
        if frame in (3, 11, 19):
            session.act("damping up")
    session.close()
    recording = Recording.load(path)
    assert len(recording.segments) == 4
    for place, segment in enumerate(recording.segments):
        last = [m for topic, m in messages(path) if topic == "/maglev/sample" and m["segment"] == place][-1]
        found = analyse(segment, rebuild, simulated=False).recorded.figures.energy
        assert last["taken"] == pytest.approx(sum(found.taken), rel=1e-6, abs=1e-9)


class Still:
    """Plant without a hand."""

    hand_wrench: Any = ZERO
    delay = 0.0


def test_missed_samples_and_faults_are_in_it(tmp_path: Path) -> None:
    # A device counts on from segment to segment: where one begins, nothing is missing yet.
    from mcap.reader import make_reader

    path = tmp_path / "run.maglev"

    file, none = open_recording(path), Command(list(ZERO))
    for ticks in ((0, 1, 4), (2, 3)):
        record = file.begin(Still(), Controller([], period=0.001), {"kind": "test"})
        for tick in ticks:
            record(Sample(tick, tick * 0.001, list(ZERO)), none, none)
    file.event("missed", "too slow", 5)
    file.event("fault", "it fell")
    for tick in (4, 5):
        record(Sample(tick, tick * 0.001, list(ZERO)), none, none)
    assert file.close() == path
    assert [(m["segment"], m["missed"]) for topic, m in messages(path) if topic == "/maglev/sample"] == [
        *[(0, 0), (0, 0), (0, 2)],
        *[(1, 0), (1, 0), (1, 5), (1, 5)],
    ]
    recording = Recording.load(path)
    read = make_reader(BytesIO(exported(path.read_bytes(), "mcap"))).iter_messages(topics=["/maglev/sample"])
    logged = [message.log_time for _, _, message in read][-4:]
    assert [round((after - logged[0]) * 1e-6) for after in logged] == [0, 1, 2, 3]  # its ticks are 2 to 5
    assert list(recording.events) == ["missed: too slow", "fault: it fell"]
    assert [len(segment.tick) for segment in recording.segments] == [3, 4]


RUN = """
import sys, time
from pathlib import Path
from maglev_mj.session import Session, Pacer
from maglev_mj.plants.hand import SpringHand
session = Session(hand_force=SpringHand(), folder=Path(sys.argv[1]))
session.act("friction"); session.act("record")
session.hand.target = [0.012, 0.003, 0.0, 0.0, 0.1, 0.0]
last = time.perf_counter()
while True:
    time.sleep(0.004)
    now = time.perf_counter(); session.tick(now - last); last = now
    print(session._ticks, flush=True)
"""


def readable(folder: Path) -> int:
    """Return the samples that can be read of a recording that is written."""
    with suppress(RecordingError, ValueError):
        (path,) = folder.glob("*.maglev")
        return Recording.load(path).ticks
    return 0


@pytest.mark.machine
@pytest.mark.needs("linux")
@pytest.mark.parametrize("after", [400, *(pytest.param(one, marks=pytest.mark.study) for one in range(300, 1300, 50))])
def test_a_recording_that_is_killed_opens_and_replays_to_its_last_row(after: int, tmp_path: Path) -> None:
    # SIGKILL to the program; what was in the file stays.
    program = subprocess.Popen([sys.executable, "-c", RUN, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    made = 0
    while made < after:
        made = int(program.stdout.readline())
    wanted, deadline = made, time.monotonic() + PATIENCE
    while readable(tmp_path) < wanted:  # all until now
        assert time.monotonic() < deadline
        time.sleep(0.02)
    program.kill()
    program.communicate()
    (path,) = tmp_path.glob("*.maglev")
    recording = Recording.load(path)
    assert recording.damage.startswith("incomplete (not closed): readable up to ") and recording.ticks >= wanted
    assert verify(recording, rebuild).first is None
    assert main(["replay", str(path), "--check"]) == 1


def drifting(path: Path, ticks: int) -> Any:
    """Record some ticks without forces; return the open file."""
    file, plant, controller = open_recording(path), ExactPlant(Timing(), gravity=0.0), Controller([], period=0.005)
    drive(plant, controller, ticks, record=file.begin(plant, controller))
    return file


def test_a_file_that_is_written_can_be_read_after_the_interval(tmp_path: Path) -> None:
    path = tmp_path / "run.maglev"
    file = drifting(path, 30)
    deadline = time.monotonic() + PATIENCE
    while readable(tmp_path) < 30:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert Recording.load(path).damage == "incomplete (not closed): readable up to 0.1 s"
    file.close()
    assert not Recording.load(path).damage


def test_where_no_open_file_is_renamed_it_gets_its_name_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As on Windows. A name that is taken at the end loses nothing.
    from maglev_mj.recording import journal

    monkeypatch.setattr(journal, "_RENAMES_OPEN", False)
    path = tmp_path / "run.maglev"
    path.write_bytes(b"that of before")
    file = drifting(path, 30)
    assert path.read_bytes() == b"that of before"
    assert file.close() == path and Recording.load(path).ticks == 30 and list(tmp_path.iterdir()) == [path]
    os.utime(path, (1e9, 1e9))
    file = drifting(path, 20)
    path.unlink()
    path.mkdir()
    with pytest.raises(RecordingError, match=r"is incomplete: Is a directory; the data is in .*\.partial") as told:
        file.close()
    assert Recording.load(Path(str(told.value).partition("the data is in ")[2])).ticks == 20


WRITE = """
import sys
from pathlib import Path
from maglev_mj.recording import Recording
from maglev_mj.scenes.drop import Drop
from maglev_mj.session.replay import write_run
for _ in range(2):
    write_run(Path(sys.argv[1]), Drop(), plant="exact", phase=0.3)
    Recording.load(Path(sys.argv[1]))
"""


@pytest.mark.machine
@pytest.mark.needs("linux")
def test_a_file_is_whole_where_none_in_use_is_renamed_or_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    path = tmp_path / "run.maglev"
    done = subprocess.run([sys.executable, "-c", START + WRITE, str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert Recording.load(path).ticks == 80 and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("odd", [np.inf, np.nan])
def test_an_answer_that_the_plant_refuses_is_the_last_row(odd: float, tmp_path: Path) -> None:
    class Mad(Controller):
        def step(self, sample: Sample) -> Command:
            command = super().step(sample)
            return command if sample.tick < 7 else Command([odd, *ZERO[1:]])

    path = tmp_path / "run.maglev"
    file, plant, controller = open_recording(path), ExactPlant(Timing()), Mad([], period=0.005)
    record = file.begin(plant, controller, {"kind": "test"})
    with pytest.raises(PlantError):
        drive(plant, controller, 20, record=record)
    assert file.close() == path
    recording = Recording.load(path)
    (segment,) = recording.segments
    assert segment.tick.tolist() == list(range(8))
    assert not np.isfinite(segment.command[-1, 0]) and not segment.applied[-1].any()
    assert np.isfinite(segment.command[:-1]).all() and not recording.damage
    verdict = verify(recording, lambda setup, hand: (ExactPlant(Timing(), hand_force=hand), Mad([], period=0.005)))
    assert verdict.same


def test_what_was_there_stays_without_a_sample_and_is_replaced_by_samples(tmp_path: Path) -> None:
    path, before = tmp_path / "run.maglev", b"that of before"
    path.write_bytes(before)
    file = open_recording(path)
    file.begin(Still(), Controller([], period=0.005), {"kind": "test"})
    assert file.close() is None and file.close() is None
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
    write_run(path, Drop(duration=0.2), plant="exact")
    assert Recording.load(path).ticks == 41 and list(tmp_path.iterdir()) == [path]


def test_many_samples_take_little_memory_to_read(tmp_path: Path) -> None:
    path = tmp_path / "run.maglev"
    write_run(path, Drop(period=0.0001, delay=0.001, duration=0.5), plant="exact")
    tracemalloc.start()
    ticks = Recording.load(path).ticks
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert ticks == 5001
    assert peak < 1500 * ticks


OWN = """
from maglev_mj.plants.hand import Hand
from maglev_mj.control import Bias, Wall
from maglev_mj.parameters import param
from maglev_mj.scenes.scene import Scene, Start

class Tap(Scene):
    "A wall of one's own."
    stiffness: float = param("stiffness", "N/m", default=4000.0, at_least=0.0)
    duration: float = param("how long", "s", default=0.1, above=0.0)

    def laws(self):
        return [Wall(axes="z", upper=0.001, stiffness=self.stiffness, damping=40.0)]

    def start(self):
        return Start(pose=(0.0, 0.0, 0.0, 0.01, 0.0, 0.0), twist=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0), gravity=1.0)
"""


def test_a_recording_of_ones_own_is_shown_and_analysed_without_its_scene_and_checked_with_it(
    tmp_path: Path, capsys: Any
) -> None:
    from maglev_mj.scenes.find import find_scene, reference_of, source_of

    script, path = tmp_path / "own.py", tmp_path / "run.maglev"
    script.write_text(OWN)
    cls = find_scene(str(script))
    scene = cls(stiffness=3000.0)  # type: ignore[call-arg]
    plant, controller = scene.plant("mujoco", phase=0.3), scene.controller()
    file = open_recording(path, wait=True)
    setup = setup_of(
        plant, controller, scene=reference_of(cls), source=source_of(cls), parameters=scene.as_json(), name="tap"
    )
    drive(plant, controller, 20, record=file.begin(plant, controller, setup))
    file.close()
    write_run(tmp_path / "whole.maglev", cls(), plant="exact")  # attaches its source
    script.rename(tmp_path / "elsewhere.py")  # what a recording names is never executed
    (segment,) = Recording.load(path).segments
    known = segment.metadata
    assert known is not None and known.faces == [(2, -1.0, 0.001)]
    assert (known.name, known.axis, known.delay, known.hand_recorded) == ("tap", "z", scene.delay, False)
    assert known.inertia.tolist() == list(INERTIA) and known.load.tolist() == [0.0, 0.0, -0.7, 0.0, 0.0, 0.0]
    assert segment.setup["kind"] == "run" and segment.setup["plant"]["pose"][3] == 0.01
    replay = Replay(Recording([segment]))
    assert replay.tick(0.05) == 10 and (replay.snapshot().pose == segment.position[10]).all()
    assert replay.snapshot().faces == ((2, -1.0, 0.001),)
    assert main(["analyse", str(path), "--json", str(tmp_path / "own.json")]) == 0
    (found,) = json.loads((tmp_path / "own.json").read_text())["segments"]
    (face,) = found["recorded"]["faces"]
    assert face["edge"] == 0.001 and face["penetration"] > 1e-4 and found["comparison"]["same"]
    assert abs(found["recorded"]["unexplained_force"]["z"]) < 1e-9  # gravity and mass are those of the run
    assert main(["convert", str(path), str(path.with_suffix(".csv"))]) == 0
    capsys.readouterr()
    assert main(["replay", str(path), "--check"]) == 0  # its laws are this package's
    assert f"source/{hash_of(OWN)}/own.py" in Recording.load(tmp_path / "whole.maglev").attachments
    for given in ([], ["--scene", "attached"]):
        assert main(["replay", str(tmp_path / "whole.maglev"), "--check", *given]) == 0
    again = ["--scene", str(tmp_path / "elsewhere.py")]
    assert main(["replay", str(path), "--check", *again]) == 0
    assert not capsys.readouterr().err
    assert main(["analyse", str(path), *again]) == 0
    assert "bit-identical" in capsys.readouterr().out
    (tmp_path / "elsewhere.py").write_text(OWN.replace("damping=40.0", "damping=41.0"))
    assert main(["replay", str(path), "--check", *again]) == 1
    assert "differs from the recorded file" in capsys.readouterr().err


def test_a_plant_that_does_not_tell_its_delay_is_refused_without_it() -> None:
    class Bare:
        hand_wrench = ZERO

    controller = Controller([], period=0.001)
    with pytest.raises(ParameterError, match="delay is required: the plant has neither timing nor delay"):
        setup_of(Bare(), controller)
    with pytest.raises(ParameterError, match=r"setup parameters\.gain must be a finite number \(got nan"):
        setup_of(Bare(), controller, delay=0.001, parameters={"gain": math.nan})
    run_metadata = setup_of(Bare(), controller, delay=0.001, name="bare", axis="x")["run"]
    assert (run_metadata["delay"], run_metadata["axis"], run_metadata["name"]) == (0.001, "x", "bare")
    assert run_metadata["inertia"]["z"] == INERTIA[2]
