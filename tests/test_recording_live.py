"""Recordings written during a run: content, survival, other readers."""

import base64
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from maglev_mj.analysis import analyse
from maglev_mj.cli import main
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.errors import MissingPackageError, ParameterError, PlantError
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import ArrayFile, Recording, RecordingError, load_samples, open_recording, setup_of
from maglev_mj.recording.ring import ROWS, Ring, RowReader
from maglev_mj.recording.sample import ROW, TOTALS
from maglev_mj.recording.verify import verify
from maglev_mj.recording.writer import _Orders, _write
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run as run_scene
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stick_slip import StickSlip
from maglev_mj.session import Pacer, Session
from maglev_mj.session.replay import Replay, rebuild, record_run, write_run
from maglev_mj.spec import INERTIA
from maglev_mj.studies.stability_map import RestingWall
from maglev_mj.versions import versions
from tests.elsewhere import START
from tests.processes import PATIENCE, run
from tests.recorded import messages_in
from tests.sweeps import sweep

ROOT = Path(__file__).parents[1]
TOTAL_NAMES = [field.name for field in TOTALS]


def messages(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Return the run's messages by a plain MCAP reader."""
    return messages_in(path.read_bytes())


def same(one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same, to the last bit."""
    return len(one.stretches) == len(other.stretches) and all(
        a.setup == b.setup and all(b.arrays[name].tobytes() == a.arrays[name].tobytes() for name in ROW.names or ())
        for a, b in zip(one.stretches, other.stretches, strict=True)
    )


@pytest.fixture(scope="module")
def drop_run(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the file of a drop."""
    path = tmp_path_factory.mktemp("drop") / "run.mcap"
    write_run(path, Drop(), plant="exact")
    return path.read_bytes()


@pytest.mark.parametrize(
    ("scene", "plant", "phase"),
    [
        (StickSlip(), "exact", 0.0),
        pytest.param(Drop(), "mujoco", 0.3, marks=pytest.mark.study),
        pytest.param(RestingWall(), "mujoco", 0.0, marks=pytest.mark.study),
    ],
)
def test_a_file_holds_what_memory_does_to_the_last_bit(scene: Scene, plant: str, phase: float, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_run(path, scene, plant=plant, phase=phase)
    written, kept = Recording.load(path), record_run(scene, plant=plant, phase=phase)
    assert not written.damage and same(written, kept)
    assert verify(written, rebuild).same


def test_any_reader_finds_fields_by_name_with_units_and_what_it_was_made_from(drop_run: bytes, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    path = tmp_path / "run.mcap"
    path.write_bytes(drop_run)
    with path.open("rb") as file:
        reader = make_reader(file)
        summary, about = reader.get_summary(), {one.name: one.metadata for one in reader.iter_metadata()}
    assert summary is not None and summary.statistics is not None
    topics = {"/maglev/stretch", "/maglev/sample", "/tf", "/maglev/shapes", "/maglev/arrows", "/log"}
    assert {channel.topic for channel in summary.channels.values()} == topics
    units = json.loads(about["maglev_mj"]["units"])
    assert [units[f"{name}.{axis}"] for name in ("position", "hand") for axis in ("z", "rx")] == [
        "m",
        "rad",
        "N",
        "N m",
    ]
    assert units["taken"] == "J" and about["maglev_mj"]["sources"] == versions()["sources"]
    (_, begun), *samples = messages(path)
    assert begun["setup"]["parameters"]["stiffness"] == 6000.0 and begun["setup"]["versions"]["mujoco"]
    assert (begun["period"], begun["delay"]) == (0.005, 0.0015)
    (stretch,) = Recording.load(path).stretches
    assert len(samples) == len(stretch) == 81
    for row, (topic, message) in enumerate(samples):
        assert topic == "/maglev/sample" and message["stretch"] == 0
        assert {"stretch", *stretch.arrays} == {*message, "arrival"}
        for name, value in message.items():
            if name != "stretch":
                kept = stretch.arrays[name][row]
                assert (list(value.values()) == kept).all() if isinstance(value, dict) else value == kept


@pytest.mark.parametrize(("phase", "delay"), sweep([0.0, 0.3, 0.7], [0.0015, 0.007], every=3))
def test_energy_taken_is_what_the_actuators_took_from_a_fall(phase: float, delay: float, tmp_path: Path) -> None:
    # Against the work of the exact motion up to the last sample.
    path = tmp_path / "run.mcap"
    drop = Drop(delay=delay, stiffness=2000.0)
    write_run(path, drop, plant="exact", phase=phase)
    (stretch,) = Recording.load(path).stretches
    result, end = run_scene(drop, plant="exact", phase=phase), stretch.time[-1]
    z, speed = (float(part[0, 2]) for part in result.trace.at(np.array([end]))[:2])
    fallen = 0.7 * 9.81 * (drop.height - z) - 0.5 * 0.7 * speed**2
    assert messages(path)[-1][1]["taken"] == pytest.approx(fallen, rel=1e-9)
    assert fallen > 0.01


def test_energy_of_a_session_goes_on_with_what_acted_before(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    session = Session(Drop(), record=path, pacer=Pacer(budget=60.0, patience=3600.0))
    for frame in range(24):
        session.tick(1.0 / 60.0)
        if frame in (3, 11, 19):
            session.act("damping up")
    session.close()
    recording = Recording.load(path)
    assert len(recording.stretches) == 4
    for place, stretch in enumerate(recording.stretches):
        last = [m for topic, m in messages(path) if topic == "/maglev/sample" and m["stretch"] == place][-1]
        found = analyse(stretch, rebuild, simulated=False).recorded.figures.energy
        assert last["taken"] == pytest.approx(sum(found.taken), rel=1e-6, abs=1e-9)


class Still:
    """Plant without a hand."""

    hand_wrench: Any = ZERO
    delay = 0.0


def test_missed_samples_and_faults_are_in_it(tmp_path: Path) -> None:
    # A device counts on from stretch to stretch: where one begins, nothing is missing yet.
    from mcap.reader import make_reader

    path = tmp_path / "run.mcap"

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
    assert [(m["stretch"], m["missed"]) for topic, m in messages(path) if topic == "/maglev/sample"] == [
        *[(0, 0), (0, 0), (0, 2)],
        *[(1, 0), (1, 0), (1, 5), (1, 5)],
    ]
    recording = Recording.load(path)
    with path.open("rb") as opened:
        read = make_reader(opened).iter_messages(topics=["/maglev/sample"])
        logged = [message.log_time for _, _, message in read][-4:]
    assert [round((after - logged[0]) * 1e-6) for after in logged] == [0, 1, 2, 3]  # its ticks are 2 to 5
    assert list(recording.events) == ["missed: too slow", "fault: it fell"]
    assert [len(stretch.tick) for stretch in recording.stretches] == [3, 4]


RUN = """
import sys, time
from pathlib import Path
from maglev_mj.session import Session, Pacer
from maglev_mj.plants.hand import SpringHand
session = Session(hand=SpringHand(), folder=Path(sys.argv[1]))
session.act("friction"); session.act("record")
session.hand.target = [0.012, 0.003, 0.0, 0.0, 0.1, 0.0]
last = time.perf_counter()
while True:
    time.sleep(0.004)
    now = time.perf_counter(); session.tick(now - last); last = now
    print(session._ticks, flush=True)
"""


def writers_to(folder: Path) -> list[int]:
    """Return the processes that write to a folder."""
    found = []
    for line in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # it has ended meanwhile; one that nobody has waited for yet has no command line
            said = line.read_bytes().decode(errors="replace")
            found += [int(line.parent.name)] if "maglev_mj.recording.writer" in said and f"{folder}/" in said else []
    return found


@pytest.mark.machine
@pytest.mark.needs("linux")
@pytest.mark.parametrize("writer_too", [False, True])
def test_a_recording_that_is_killed_opens_and_replays_to_its_last_row(writer_too: bool, tmp_path: Path) -> None:
    # SIGKILL to the program, and to its writer at the same time; what was in the file stays.
    killed(400, writer_too, tmp_path)


@pytest.mark.study
@pytest.mark.machine
@pytest.mark.needs("linux")
@pytest.mark.parametrize("writer_too", [False, True])
@pytest.mark.parametrize("after", range(300, 1300, 100))
def test_a_recording_that_is_killed_at_any_time_opens(after: int, writer_too: bool, tmp_path: Path) -> None:
    lost = killed(after, writer_too, tmp_path)
    print("lost:", lost, "samples")
    assert lost <= (60 if writer_too else 0)  # 0.3 s at 200 Hz


def readable(folder: Path, begun: str) -> int:
    """Return the samples that can be read of a recording that is written."""
    (path,) = folder.glob(begun)
    with suppress(RecordingError):
        return Recording.load(path).ticks
    return 0


def killed(after: int, writer_too: bool, tmp_path: Path, begun: str = "*.mcap", rules: str = "") -> int:
    """Return the samples lost by a program that is killed after recording some."""
    program = subprocess.Popen([sys.executable, "-c", rules + RUN, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    made = 0
    while made < after:
        made = int(program.stdout.readline())
        if not any(path.stat().st_size for path in tmp_path.glob(begun)):  # a busy machine is long about the writer
            after = made + 200
    wanted, deadline = made, time.monotonic() + PATIENCE
    while readable(tmp_path, begun) < wanted:  # all until now
        assert time.monotonic() < deadline
        time.sleep(0.02)
    (writer,) = writers_to(tmp_path)
    program.kill()
    if writer_too:
        os.kill(writer, signal.SIGKILL)
    rest = program.communicate()[0].splitlines()
    made = int(rest[-1]) if rest else made
    deadline = time.monotonic() + PATIENCE
    while writers_to(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.02)
    (path,) = tmp_path.glob("*.mcap")
    recording = Recording.load(path)
    assert recording.damage == ("its end is missing" if writer_too else "")
    assert recording.ticks >= (wanted if writer_too else made)
    assert verify(recording, rebuild).first is None
    assert main(["replay", str(path), "--check"]) == int(writer_too)
    return made - recording.ticks


def test_rows_that_come_faster_than_they_are_written_are_counted_or_waited_for() -> None:
    # The ring of a run in real time overwrites; that of another waits for its reader.
    sample, command = Sample(0, 0.0, list(ZERO)), Command(list(ZERO))

    def put(into: Ring, times: int) -> None:
        record = into.record(Still())
        for _ in range(times):
            record(sample, command, command)

    ring = Ring()
    reader = RowReader(ring.path)
    put(ring, ROWS + 100)
    assert len(list(reader.rows())) == ROWS and reader.lost == 100
    ring.close()
    reader.close()
    waited = []
    patient = Ring(wait=lambda: waited.append(len(list(slow.rows()))))
    slow = RowReader(patient.path)
    put(patient, 2 * ROWS)
    assert waited and sum(waited) + len(list(slow.rows())) == 2 * ROWS and slow.lost == 0
    patient.close()
    slow.close()


def test_a_message_is_waited_for_before_the_rows_that_it_was_sent_ahead_of() -> None:
    ends = os.pipe()
    with open(ends[1], "wb", buffering=0) as there, open(ends[0], "rb") as here:
        orders = _Orders(here)
        orders.listen(0)
        assert not orders.waiting
        threading.Timer(0.02, there.write, [b'[5, "event"]\n[7, "stick"]\n[9, "cut sho']).start()
        orders.listen(2)
        assert list(orders.waiting) == [[5, "event"], [7, "stick"]] and not orders.over
        threading.Timer(0.02, there.close).start()
        orders.listen(3)  # of a process that was killed: what it told of never comes
        assert len(orders.waiting) == 2 and orders.over


class Log:
    """Log that keeps the order of what it gets."""

    def __init__(self) -> None:
        self.order = list[Any]()

    def rows(self, rows: list[Any]) -> None:
        """Log rows."""
        self.order.append(len(rows))

    def event(self, text: str) -> None:
        """Log an event."""
        self.order.append(text)

    def flush(self) -> None:
        """Do nothing."""


def test_a_message_that_is_late_is_logged_before_its_row() -> None:
    command, log, ends = Command(list(ZERO)), Log(), os.pipe()
    ring = Ring()
    record, reader = ring.record(Still()), RowReader(ring.path)
    ring.tell(1)
    for tick in range(3):
        record(Sample(tick, tick * 0.001, list(ZERO)), command, command)
    with open(ends[1], "wb", buffering=0) as there, open(ends[0], "rb") as here:

        def tell() -> None:
            there.write(b'[2, "event", "late"]\n')
            there.close()

        threading.Timer(0.02, tell).start()
        _write(reader, _Orders(here), log, lambda: None)  # type: ignore[arg-type]
    assert log.order == [2, "late", 1]
    reader.close()
    ring.close()


def test_what_is_sent_is_told_of(tmp_path: Path) -> None:
    file, told = open_recording(tmp_path / "run.mcap"), list[int]()
    cast(Any, file)._ring.tell = told.append
    for _ in range(3):
        file.event("fault", "it fell")
    assert file.close() is None and told == [1, 2, 3]


@pytest.mark.parametrize("read", [False, True])
def test_the_file_of_the_memory_is_gone_at_the_latest_with_the_ring(read: bool) -> None:
    ring = Ring()
    if read:
        reader = RowReader(ring.path)
        assert not ring.path.exists()
        reader.close()
    ring.close()
    assert not ring.path.exists()


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a temporary folder of this test's programs."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TEMP", str(folder))
    return folder


WRITE = """
import sys
from pathlib import Path
from maglev_mj.scenes.drop import Drop
from maglev_mj.session.replay import write_run
write_run(Path(sys.argv[1]), Drop(), plant="exact", phase=0.3)
"""


@pytest.mark.machine
@pytest.mark.needs("linux")
def test_a_file_is_whole_where_none_in_use_is_renamed_or_removed(temporary: Path) -> None:
    # As on Windows: the memory's file goes with the ring, and the recording gets its name at the end.
    path, same_run = temporary / "run.mcap", temporary / "same.mcap"
    path.write_bytes(b"that of before")
    done = run(sys.executable, "-c", START + WRITE, str(path), cwd=ROOT)
    assert done.status == 0 and not done.errors, done
    write_run(same_run, Drop(), plant="exact", phase=0.3)
    assert same(Recording.load(path), Recording.load(same_run))
    assert sorted(temporary.iterdir()) == [path, same_run]


@pytest.mark.machine
@pytest.mark.needs("linux")
@pytest.mark.parametrize(
    "words", ["drop --plant exact --record run.npz", "sweep drop --vary height=1e-3:2e-3:2 --record cells --workers 0"]
)
def test_what_else_is_written_is_renamed_when_it_is_closed(words: str, temporary: Path) -> None:
    code = f"{START}import sys; from maglev_mj.cli import main; sys.exit(main(sys.argv[1:]))"
    for _ in range(2):
        done = run(sys.executable, "-c", code, *words.split(), cwd=temporary, env={"PYTHONPATH": str(ROOT)})
        assert done.status == 0 and not done.errors, done


@pytest.mark.machine
@pytest.mark.needs("linux")
def test_a_name_that_is_taken_at_the_end_loses_nothing(temporary: Path) -> None:
    path = temporary / "run.mcap"
    path.write_bytes(b"that of before")
    with path.open("rb"):  # by a program that reads it
        done = run(sys.executable, "-c", START + WRITE, str(path), cwd=ROOT)
    assert done.status == 1 and "is not whole: The process cannot access the file" in done.errors
    (kept,) = {*temporary.iterdir()} - {path}
    assert f"; it is in {kept}" in done.errors and path.read_bytes() == b"that of before"
    assert Recording.load(kept).ticks == 80


@pytest.mark.machine
@pytest.mark.needs("linux")
def test_a_recording_that_is_killed_gets_its_name_where_none_in_use_is_renamed(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    killed(400, False, temporary, "*.partial", START)
    assert not list(temporary.glob("maglev-mj-*")) and len(list(temporary.iterdir())) == 1


def test_a_writer_that_dies_is_told_of(tmp_path: Path) -> None:
    file: Any = open_recording(tmp_path / "run.mcap")
    file.check()
    file._process.kill()
    file._process.wait()
    with pytest.raises(RecordingError, match="is not written any more"):
        file.check()
    with pytest.raises(RecordingError, match="is not whole: its writer ended"):
        file.close()


def test_arrays_go_elsewhere_where_their_folder_is_gone(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    file = ArrayFile(folder / "run-of-a-test.npz")
    plant = ExactPlant(Timing())
    controller = Controller([], period=0.005)
    drive(plant, controller, 1, record=file.begin(plant, controller, {"kind": "test"}))
    folder.rmdir()
    with pytest.raises(RecordingError, match="cannot be written: No such file or directory; it is in ") as told:
        file.close()
    path = Path(str(told.value).partition("; it is in ")[2])
    assert path.parent != folder and Recording.load(path).ticks == 1
    path.unlink()


@pytest.mark.parametrize("name", ["run.csv", "run"])
def test_a_kind_of_file_that_is_not_known_is_refused(name: str, tmp_path: Path, capsys: Any) -> None:
    with pytest.raises(ParameterError, match=r"must be a file that ends in \.mcap or \.npz"):
        open_recording(tmp_path / name)
    assert main(["drop", "--plant", "exact", "--record", str(tmp_path / name)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("suffix", [".mcap", ".npz"])
def test_a_recording_is_exported_with_every_field_unit_event_and_attachment(
    suffix: str, tmp_path: Path, capsys: Any
) -> None:
    # Of two stretches, as pandas and numpy read it without an option.
    import pandas
    from pyarrow import parquet

    path, other = tmp_path / f"run{suffix}", tmp_path / "other.npz"
    file = open_recording(path, wait=True)
    file.attach("own.py", "text/x-python", b"# mine\xff")
    for scene in (Drop(), StickSlip()):
        plant, controller = scene.plant("exact"), scene.controller()
        with plant:
            drive(plant, controller, 40, record=file.begin(plant, controller, {"kind": "test"}))
        file.event("missed", "too slow", 5)
    file.close()
    recording, samples = Recording.load(path), load_samples(path)
    for kind in ("csv", "parquet"):
        assert main(["export", str(path), "--to", kind]) == 0
        assert capsys.readouterr().out == f"  wrote {tmp_path / f'run.{kind}'}: 80 samples\n"
    totals = () if suffix == ".npz" else ("taken", "hand_work", "missed")
    left_out = {"arrival", *TOTAL_NAMES} - {*totals}  # which the file does not tell
    wanted = {name: column for name, column in samples.columns().items() if name not in left_out}
    units = {name: unit for name, unit in samples.units.items() if name in wanted}
    table, frame = parquet.read_table(tmp_path / "run.parquet"), pandas.read_csv(tmp_path / "run.csv")
    assert list(frame.columns) == table.column_names == list(samples.to_pandas()[[*wanted]].columns) == list(wanted)
    for name, column in wanted.items():
        np.testing.assert_allclose(frame[name].to_numpy(), column, rtol=1e-15)
        np.testing.assert_array_equal(table[name].to_numpy(), column)
        assert (table.schema.field(name).metadata or {}) == ({b"unit": units[name].encode()} if units.get(name) else {})
    beside = json.loads((tmp_path / "run.csv.json").read_text())
    inside = {name: json.loads(table.schema.metadata[f"maglev_mj.{name}".encode()]) for name in beside}
    assert beside == inside and beside["events"] == ["missed: too slow"] * 2
    assert beside["setups"] == json.loads(json.dumps([stretch.setup for stretch in recording.stretches]))
    assert base64.b64decode(beside["attachments"]["own.py"]) == b"# mine\xff" and beside["about"] == recording.about
    for told in (beside["units"], samples.to_pandas().attrs["units"]):
        assert {name: told[name] for name in units} == units
    assert main(["export", str(path), "--to", "npz", "--out", str(other)]) == 0
    again = Recording.load(other)
    assert same(again, recording) and list(again.events) == list(recording.events) and again.about == recording.about
    assert again.attachments == recording.attachments
    for one, two in zip(again.stretches, recording.stretches, strict=True):
        assert one.setup == two.setup and list(one.gaps) == list(two.gaps)
        assert one.arrays.keys() == two.arrays.keys() and ("taken" in one.arrays) == (suffix == ".mcap")
        assert all(values.tobytes() == two.arrays[name].tobytes() for name, values in one.arrays.items())
    assert [len(stretch.gaps) for stretch in recording.stretches] == [1, 1]


def test_a_recording_is_loaded_as_arrays_and_as_a_data_frame(
    drop_run: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.mcap").write_bytes(drop_run)
    write_run(tmp_path / "run.npz", Drop(), plant="exact")
    for suffix in (".mcap", ".npz"):
        path = tmp_path / f"run{suffix}"
        samples, (stretch,) = load_samples(path), Recording.load(path).stretches
        assert len(samples) == 81 and samples.position.shape == (81, 6) and not samples.recording.damage
        for name in ROW.names or ():
            np.testing.assert_array_equal(samples.arrays[name], stretch.arrays[name])
        for name in TOTAL_NAMES:
            totals = stretch.arrays.get(name, np.full(81, np.nan))
            np.testing.assert_array_equal(samples.arrays[name], totals)
        assert samples.recording.stretches[0].metadata.faces and samples.recording.stretches[0].setup["kind"]
        some = load_samples(path, fields=("time", "hand"))
        assert list(some.arrays) == ["time", "hand"] and (some.time == samples.time).all()
        with pytest.raises(AttributeError, match="these samples have no 'position'"):
            _ = some.position
        frame = samples.to_pandas()
        assert (frame["position.z"] == stretch.position[:, 2]).all() and frame["tick"].dtype == np.int64
        assert frame.attrs["units"]["hand.rx"] == "N m"
        with pytest.raises(ParameterError, match=r"fields must be of tick, time, position, .* not 'positions'"):
            load_samples(path, fields=["positions"])
    monkeypatch.setattr("maglev_mj.errors.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"-m pip install 'pandas>="):
        samples.to_pandas()
    with pytest.raises(RecordingError, match="cannot be read: No such file"):
        load_samples(tmp_path / "none.mcap")


def test_a_recording_is_not_exported_over_itself(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "run.npz"
    write_run(path, Drop(), plant="exact")
    assert main(["export", str(path), "--to", "npz"]) == 2
    assert "out must be another file than the recording" in capsys.readouterr().err
    assert main(["export", str(path), "--to", "csv", "--out", str(tmp_path)]) == 2
    with pytest.raises(SystemExit, match="2"):
        main(["export", str(path), "--to", "xlsx"])
    assert len(capsys.readouterr().err.splitlines()) == 2
    assert main(["export", str(tmp_path / "none.mcap"), "--to", "csv"]) == 2


@pytest.mark.parametrize(("name", "odd"), sweep(["run.npz", "run.mcap"], [np.inf, np.nan], every=2))
def test_an_answer_that_the_plant_refuses_is_the_last_row(name: str, odd: float, tmp_path: Path) -> None:
    class Mad(Controller):
        def step(self, sample: Sample) -> Command:
            command = super().step(sample)
            return command if sample.tick < 7 else Command([odd, *ZERO[1:]])

    file, plant, controller = open_recording(tmp_path / name), ExactPlant(Timing()), Mad([], period=0.005)
    record = file.begin(plant, controller, {"kind": "test"})
    with pytest.raises(PlantError):
        drive(plant, controller, 20, record=record)
    assert file.close() == tmp_path / name
    recording = Recording.load(tmp_path / name)
    (stretch,) = recording.stretches
    assert stretch.tick.tolist() == list(range(8))
    assert not np.isfinite(stretch.command[-1, 0]) and not stretch.applied[-1].any()
    assert np.isfinite(stretch.command[:-1]).all() and not recording.damage
    verdict = verify(recording, lambda setup, hand: (ExactPlant(Timing(), hand_force=hand), Mad([], period=0.005)))
    assert verdict.same


@pytest.mark.parametrize("name", ["run.mcap", "run.npz"])
def test_what_was_there_stays_without_a_sample(name: str, tmp_path: Path) -> None:
    path, before = tmp_path / name, b"that of before"
    path.write_bytes(before)
    file = open_recording(path)
    file.begin(Still(), Controller([], period=0.005), {"kind": "test"})
    assert file.close() is None
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["run.mcap", "run.npz"])
def test_what_was_there_is_replaced_by_samples(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"that of before")
    write_run(path, Drop(duration=0.2), plant="exact")
    assert Recording.load(path).ticks == 41 and list(tmp_path.iterdir()) == [path]


def test_no_memory_to_share_is_one_line_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    monkeypatch.setattr("maglev_mj.recording.ring._MEMORY", tmp_path)
    assert main(["drop", "--plant", "exact", "--record", str(tmp_path / "run.mcap")]) == 1
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and "no memory to share" in said
    assert list(tmp_path.iterdir()) == []


def test_a_reader_removes_the_memory_of_a_program_that_was_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    # On Windows, where nobody could before.
    ring, unlink = Ring(), Path.unlink

    def in_use(path: Path, missing_ok: bool = False) -> None:
        monkeypatch.setattr(Path, "unlink", unlink)
        raise PermissionError(13, "it is used by another process")

    monkeypatch.setattr(Path, "unlink", in_use)
    reader = RowReader(ring.path)
    assert ring.path.exists()
    reader.close()
    assert not ring.path.exists()
    ring.close()


def test_the_writer_takes_no_modules_from_the_folder_that_it_is_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "calendar.py").write_text("raise RuntimeError('not this one')\n")
    monkeypatch.chdir(tmp_path)
    assert main(["drop", "--plant", "exact", "--record", "run.mcap"]) == 0
    assert not capfd.readouterr().err
    assert Recording.load(tmp_path / "run.mcap").ticks == 81


def test_many_samples_take_little_memory_to_read(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_run(path, Drop(period=0.0001, duration=0.5), plant="exact")
    tracemalloc.start()
    ticks = Recording.load(path).ticks
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert ticks == 5001
    assert peak < 1500 * ticks  # as messages they took 5000 bytes a sample


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


@pytest.mark.parametrize("suffix", [".mcap", ".npz"])
def test_a_recording_of_ones_own_is_shown_and_analysed_without_its_scene_and_checked_with_it(
    suffix: str, tmp_path: Path, capsys: Any
) -> None:
    from maglev_mj.scenes.find import find_scene, reference_of, source_of

    script, path = tmp_path / "own.py", tmp_path / f"run{suffix}"
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
    script.rename(tmp_path / "elsewhere.py")  # what a recording names is never executed
    (stretch,) = Recording.load(path).stretches
    known = stretch.metadata
    assert known is not None and known.faces == [(2, -1.0, 0.001)]
    assert (known.name, known.axis, known.delay, known.hand_recorded) == ("tap", "z", scene.delay, False)
    assert known.inertia.tolist() == list(INERTIA) and known.load.tolist() == [0.0, 0.0, -0.7, 0.0, 0.0, 0.0]
    assert stretch.setup["kind"] == "run" and stretch.setup["plant"]["pose"][3] == 0.01
    replay = Replay(Recording([stretch]))
    assert replay.tick(0.05) == 10 and (replay.snapshot().pose == stretch.position[10]).all()
    assert replay.snapshot().faces == ((2, -1.0, 0.001),)
    assert main(["analyse", str(path), "--json", str(tmp_path / "own.json")]) == 0
    (found,) = json.loads((tmp_path / "own.json").read_text())["stretches"]
    (face,) = found["recorded"]["faces"]
    assert face["edge"] == 0.001 and face["penetration"] > 1e-4 and found["comparison"]["same"]
    assert abs(found["recorded"]["unexplained_force"]["z"]) < 1e-9  # gravity and mass are those of the run
    assert main(["export", str(path), "--to", "csv"]) == 0
    capsys.readouterr()
    assert main(["replay", str(path), "--check"]) == 0  # its laws are this package's
    again = ["--scene", str(tmp_path / "elsewhere.py")]
    assert main(["replay", str(path), "--check", *again]) == 0
    assert not capsys.readouterr().err
    assert main(["analyse", str(path), *again]) == 0
    assert "the same to the last bit" in capsys.readouterr().out
    (tmp_path / "elsewhere.py").write_text(OWN.replace("damping=40.0", "damping=41.0"))
    assert main(["replay", str(path), "--check", *again]) == 1
    assert "has changed since, or is another" in capsys.readouterr().err


def test_a_plant_that_does_not_tell_its_delay_is_refused_without_it() -> None:
    class Bare:
        hand_wrench = ZERO

    controller = Controller([], period=0.001)
    with pytest.raises(ParameterError, match="delay must be given for a plant that has neither timing nor delay"):
        setup_of(Bare(), controller)
    with pytest.raises(ParameterError, match=r"setup parameters\.gain must be a finite number, not nan"):
        setup_of(Bare(), controller, delay=0.001, parameters={"gain": math.nan})
    run_metadata = setup_of(Bare(), controller, delay=0.001, name="bare", axis="x")["run"]
    assert (run_metadata["delay"], run_metadata["axis"], run_metadata["name"]) == (0.001, "x", "bare")
    assert run_metadata["inertia"]["z"] == INERTIA[2]
