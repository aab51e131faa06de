"""Effects of damage, by the table in docs/reference/recording.md."""

import os
import threading
import time
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.control import Wall
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import Recording, RecordingError, journal, open_recording
from maglev_mj.recording.journal import CHECKSUM, RECORD, SAMPLE, open_journal
from maglev_mj.recording.sample import FIELDS, TOTALS
from maglev_mj.session import Pacer, Session
from maglev_mj.views import viewer_process
from maglev_mj.views.viewer_process import ShowReport

PERIOD = 0.001
TICKS = 1500


def parts() -> tuple[ExactPlant, Controller]:
    plant = ExactPlant(Timing(period=PERIOD, delay=0.0015), pose=[0.0, 0.0, 0.0045, 0.01, 0.0, 0.0])
    return plant, Controller([Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)], period=PERIOD)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a recording of two segments with an attachment and events."""
    path = tmp_path_factory.mktemp("whole") / "run.maglev"
    file = open_recording(path, wait=True)
    file.attach("device.xml", "text/xml", b"<mujoco/>" * 50)
    for _ in range(2):
        plant, controller = parts()
        drive(plant, controller, TICKS // 2, record=file.begin(plant, controller))
        file.event("fault", "for a test")
    file.close()
    return path.read_bytes()


def read(data: bytes, folder: Path) -> Recording | None:
    """Return the content of a file; None if refused."""
    path = folder / "run.maglev"
    path.write_bytes(data)
    try:
        return Recording.load(path)
    except RecordingError as error:
        assert "\n" not in str(error)
        return None


def same_so_far(part: Recording, full: Recording) -> None:
    """Check that the readable part is unchanged, the rest reported."""
    for one, other in zip(part.segments, full.segments, strict=False):
        assert one.arrays.keys() == other.arrays.keys() == {field.name for field in (*FIELDS, *TOTALS)}
        for name, values in one.arrays.items():
            assert values.tobytes() == other.arrays[name][: len(one)].tobytes()
        assert one.setup == other.setup
    assert list(part.events) == list(full.events)[: len(part.events)]
    assert set(part.attachments.items()) <= set(full.attachments.items())
    if not part.damage:
        assert part.ticks == full.ticks and len(part.events) == len(full.events)
        assert part.attachments == full.attachments and part.about == full.about


@pytest.mark.parametrize("all_of_them", [False, pytest.param(True, marks=pytest.mark.study)])
def test_cut_off_anywhere_it_is_read_up_to_its_last_whole_record(
    whole: bytes, all_of_them: bool, tmp_path: Path
) -> None:
    # At every end of a block and some bytes around, and all over.
    full, kinds = read(whole, tmp_path), open_journal(tmp_path / "run.maglev").kinds
    first = whole.index(b"\n") + 1
    edges = [first + int(index + 1) * RECORD.itemsize for index in np.flatnonzero(kinds == CHECKSUM)]
    samples = np.cumsum(kinds == SAMPLE)
    assert full is not None and not full.damage and full.ticks == 2 * (TICKS // 2) and edges[-1] == len(whole)
    offsets, step, last = ((-9, -1, 0, 1, 9), 997, 1) if all_of_them else ((-1, 0), 19973, 17)
    near = {edge + off for edge in edges for off in offsets}
    ends, ticks = {*near, *range(0, len(whole), step), *range(len(whole) - 400, len(whole), last)}, list[int]()
    for end in sorted(one for one in ends if one <= len(whole)):
        part, count = read(whole[:end], tmp_path), (end - first) // RECORD.itemsize
        wanted = int(samples[count - 1]) if count > 0 else 0
        if end < first:
            assert part is None
            continue
        assert part is not None and part.ticks == wanted
        closed = end >= len(whole) - RECORD.itemsize
        assert part.damage == "" if closed else part.damage.startswith("incomplete")
        same_so_far(part, full)
        ticks.append(part.ticks)
    assert len(set(ticks)) > 5


@pytest.mark.parametrize("count", [120, pytest.param(600, marks=pytest.mark.study)])
def test_no_number_of_a_file_with_one_bit_changed_is_taken_for_true(whole: bytes, count: int, tmp_path: Path) -> None:
    full, refused = read(whole, tmp_path), 0
    assert full is not None
    random = np.random.default_rng(1)
    for place in np.linspace(8, len(whole) - 1, count).astype(int).tolist():
        data = bytearray(whole)
        data[place] ^= 1 << int(random.integers(8))
        part = read(bytes(data), tmp_path)
        if part is None:
            refused += 1
        else:
            same_so_far(part, full)
    assert refused > 0.91 * count


def test_a_changed_bit_is_told_with_its_records(whole: bytes, tmp_path: Path) -> None:
    data = bytearray(whole)
    data[-3 * RECORD.itemsize] ^= 1
    path = tmp_path / "run.maglev"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"wrong checksum of records \d+ to \d+: the file is damaged$"):
        Recording.load(path)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return a disk whose room can be set, and which can hold up or fail otherwise."""
    write = os.write
    state: dict[str, Any] = {"room": 1 << 40, "gate": None, "error": None}

    def limited(file: int, data: Any) -> int:
        if threading.current_thread().name != "journal":
            return write(file, data)
        if state["gate"] is not None:
            assert state["gate"].wait(30.0)
        if state["error"] is not None:
            raise state["error"]
        if state["room"] <= 0:
            raise OSError(28, "No space left on device")
        written = write(file, memoryview(data)[: state["room"]])
        state["room"] -= written
        return written

    monkeypatch.setattr(os, "write", limited)
    return state


def driven(path: Path, ticks: int = 600, **options: Any) -> Any:
    """Record some ticks; return the open file."""
    file: Any = open_recording(path, wait=True, **options)
    plant, controller = parts()
    drive(plant, controller, ticks, record=file.begin(plant, controller))
    return file


@pytest.mark.parametrize("room", [0, 5_000, 150_001])
def test_a_disk_that_is_full_is_told_of_and_what_was_written_is_read(
    room: int, tmp_path: Path, disk: dict[str, Any]
) -> None:
    # The run goes on; what is written is its beginning, up to the last whole record.
    path = tmp_path / "run.maglev"
    disk["room"] = room
    file = driven(path)
    with pytest.raises(RecordingError, match="is incomplete: No space left on device"):
        file.close()
    kept = [path for path in tmp_path.iterdir()]
    assert len(kept) <= 1
    if room > 10_000:
        assert Recording.load(kept[0]).damage.startswith("incomplete")
    assert len(file._journal._queue) == 0


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), ValueError("anything"), MemoryError()])
def test_any_error_of_the_thread_is_told_and_the_queue_stays_empty(
    error: Exception, tmp_path: Path, disk: dict[str, Any]
) -> None:
    disk["error"] = error
    file = driven(tmp_path / "run.maglev", 10)
    file._journal._thread.join(30.0)
    record = file.begin(*parts())
    drive(*parts(), 1000, record=record)
    words = getattr(error, "strerror", None) or str(error) or "MemoryError"
    with pytest.raises(RecordingError, match=f"writing .* has stopped: {words}"):
        file.check()
    assert not file._journal._queue
    with pytest.raises(RecordingError, match=f"is incomplete: {words}"):
        file.close()


def test_a_disk_that_holds_up_delays_a_run_in_virtual_time_and_no_other(
    tmp_path: Path, disk: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal, "_LIMIT", 100)
    disk["gate"] = gate = threading.Event()
    plant, controller = parts()
    file: Any = open_recording(tmp_path / "real.maglev")  # in real time
    drive(plant, controller, 300, record=file.begin(plant, controller))
    lost = file._journal.lost
    assert 200 <= lost < 210 and len(file._journal._queue) == 100
    gate.set()
    with pytest.raises(RecordingError, match=f"is incomplete: {lost} samples lost"):
        file.close()
    recording = Recording.load(tmp_path / "real.maglev")
    assert recording.ticks == 300 - lost and recording.events == [f"lost: {lost} samples lost (write queue full)"]
    gate.clear()
    threading.Timer(0.3, gate.set).start()
    driven(tmp_path / "virtual.maglev", 600).close()
    assert Recording.load(tmp_path / "virtual.maglev").ticks == 600


def test_a_run_in_real_time_is_on_the_disk_at_intervals_and_at_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = list[int]()
    for name in ("fdatasync", "fsync"):
        monkeypatch.setattr(os, name, calls.append, raising=False)
    for wait, interval, kind, synced in (
        (False, 1e9, "fault", True),
        (False, 1e9, "timing", False),
        (False, -1.0, "timing", True),
        (True, -1.0, "fault", False),
    ):
        calls.clear()
        monkeypatch.setattr(journal, "_SYNC", interval)
        file, (plant, controller) = open_recording(tmp_path / "run.maglev", wait=wait), parts()
        drive(plant, controller, 10, record=file.begin(plant, controller))
        file.event(kind, "for a test")
        file.close()
        assert bool(calls) == synced


def test_a_name_that_another_program_writes_is_refused_before_the_run(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "run.maglev"
    file = driven(path)
    while not path.exists():
        time.sleep(0.01)
    assert main(["drop", "--plant", "exact", "--record", str(path)]) == 1
    said = capsys.readouterr()
    assert "is being written by another program" in said.err and "fell" not in said.out
    assert file.close() == path and Recording.load(path).ticks == 600
    assert main(["drop", "--plant", "exact", "--record", str(path)]) == 0  # it is closed now
    assert Recording.load(path).ticks == 81


def test_a_file_replaced_by_another_program_is_told_of(tmp_path: Path) -> None:
    path = tmp_path / "run.maglev"
    file = driven(path, 10)
    while not path.exists():
        time.sleep(0.01)
    os.utime(path, (1e9, 1e9))  # it has not been written for long
    driven(path, 20).close()
    file.event("fault", "for a test")
    with pytest.raises(RecordingError, match="is incomplete: file replaced by another program"):
        file.close()
    assert Recording.load(path).ticks == 20 and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("by_key", [False, True])
def test_a_disk_that_is_full_ends_a_session_with_one_line(
    by_key: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any, disk: dict[str, Any]
) -> None:
    # The recording of the option, or two that a key began; every sample that was written can be read.
    monkeypatch.setattr("maglev_mj.cli.peripherals.PageOptions.open", lambda _: Mock())

    def shown(session: Session, *_rest: Any) -> ShowReport:
        session._pacer = Pacer(budget=60.0, patience=3600.0)
        for _ in range(1 + by_key):
            disk["room"] = 60_000
            if by_key:
                session.act("record")
            for _ in range(20):
                session.tick(0.1)
            file: Any = session._recorder.file
            file._journal._thread.join(30.0)
            notes = session.snapshot().notes
            assert any("NOT RECORDING" in note and "No space left on device" in note for note in notes)
            if by_key:
                session.act("record")
        session.close()
        return ShowReport(0, 0.0, 0.0, 0, 0)

    monkeypatch.setattr(viewer_process, "show_remotely", shown)
    option = [] if by_key else ["--record", str(tmp_path / "run.maglev")]
    assert main(["view", "--out", str(tmp_path), *option]) == 1
    said = capfd.readouterr()
    (line,) = said.err.splitlines()
    assert not said.out and line.startswith(f"maglev-mj view: {tmp_path}")
    assert line.count("is incomplete: No space left on device") == 1 + by_key
    ticks = [Recording.load(path).ticks for path in tmp_path.iterdir()]
    assert len(ticks) == 1 + by_key and all(one > 100 for one in ticks)
