"""Effects of damage, by the table in docs/reference/recording.md."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.control import Wall
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.files import atomic_path
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import Recording, RecordingError, journal, load_samples, open_recording
from maglev_mj.recording.journal import CHECKSUM, RECORD, SAMPLE
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


def kinds_of(data: bytes) -> tuple[int, Any]:
    """Return the size of the header and the kind of each record."""
    first = data.index(b"\n") + 1
    return first, np.frombuffer(data, RECORD, (len(data) - first) // RECORD.itemsize, first)["kind"]


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
    full, (first, kinds) = read(whole, tmp_path), kinds_of(whole)
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
    full, found = read(whole, tmp_path), 0
    assert full is not None
    random = np.random.default_rng(1)
    for place in np.linspace(8, len(whole) - 1, count).astype(int).tolist():
        data = bytearray(whole)
        data[place] ^= 1 << int(random.integers(8))
        part = read(bytes(data), tmp_path)
        found += part is None or bool(part.damage)
        if part is not None:
            same_so_far(part, full)
    assert found >= count - 2  # the last checksum may look like a newer kind of record, after the end


def blocks_of(data: bytes) -> list[tuple[int, int]]:
    """Return the first byte and the one after the last of each block, with its checksum."""
    first, kinds = kinds_of(data)
    ends = [first + int(index + 1) * RECORD.itemsize for index in np.flatnonzero(kinds == CHECKSUM)]
    return list(zip([first, *ends], ends, strict=False))


def older(data: bytes) -> bytes:
    """Return a journal as earlier versions wrote it, with checksums of each block alone."""
    first, _ = kinds_of(data)
    head = data[:first].replace(b'"checksums": "chained", ', b"")
    old = head[:-1].ljust(first - 1) + b"\n"
    assert old != data[:first]
    for start, end in blocks_of(data):
        seal = end - RECORD.itemsize
        old += data[start:seal] + data[seal : seal + 12].ljust(RECORD.itemsize, b"\0")
    return old


def zeroed(data: bytes, first: int, last: int) -> bytes:
    return data[:first] + bytes(min(last, len(data)) - first) + data[last:]


def cut(data: bytes, random: np.random.Generator) -> bytes:
    return data[: random.integers(len(data))]


def sector_lost(data: bytes, random: np.random.Generator) -> bytes:
    size = int(random.choice([512, 4096]))
    first = size * int(random.integers(len(data) // size))
    return zeroed(data, first, first + size)


def zeros_at_the_end(data: bytes, random: np.random.Generator) -> bytes:
    return zeroed(data, 4096 * int(random.integers(len(data) // 4096 + 1)), len(data))


def zeros_behind(data: bytes, random: np.random.Generator) -> bytes:
    return cut(data, random) + bytes(int(random.integers(1, 9000)))


def bits_changed(data: bytes, random: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for place in random.integers(len(data), size=random.integers(1, 4)):
        changed[place] ^= 1 << int(random.integers(8))
    return bytes(changed)


def blocks_moved(data: bytes, random: np.random.Generator) -> bytes:
    blocks = blocks_of(data)
    order = list(range(len(blocks)))
    chosen, other = random.choice(len(blocks), 2, replace=False)
    match random.integers(3):
        case 0:
            order[chosen], order[other] = order[other], order[chosen]
        case 1:
            order.insert(chosen, order[other])
        case _:
            del order[chosen]
    return data[: blocks[0][0]] + b"".join(data[slice(*blocks[index])] for index in order)


def sector_of_before(data: bytes, random: np.random.Generator, before: bytes = b"") -> bytes:
    first = 4096 * int(random.integers(len(data) // 4096))
    other = random.bytes(4096) if not before else before[first : first + 4096]
    return data[:first] + other[: len(data) - first] + data[first + 4096 :]


DAMAGES = cut, sector_lost, zeros_at_the_end, zeros_behind, bits_changed, blocks_moved, sector_of_before


def readable(data: bytes, changed: bytes) -> int:
    """Return the number of samples in the blocks that stand before the first change; -1 if that is in the header."""
    both = np.frombuffer(data, np.uint8, min(len(data), len(changed))), np.frombuffer(changed, np.uint8)
    differs = np.flatnonzero(both[0] != both[1][: len(both[0])])
    place = int(differs[0]) if len(differs) else len(both[0])
    first, kinds = kinds_of(data)
    ends = [first, *(end for _, end in blocks_of(data) if end <= place)]
    return int((kinds[: (ends[-1] - first) // RECORD.itemsize] == SAMPLE).sum()) if place >= first else -1


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.study)])
def test_of_damaged_files_all_blocks_before_the_damage_are_read_and_no_sample_is_wrong(
    whole: bytes, count: int, tmp_path: Path
) -> None:
    full, random, damaged = read(whole, tmp_path), np.random.default_rng(7), 0
    assert full is not None
    for index in range(count):
        changed = DAMAGES[index % len(DAMAGES)](whole, random)
        part, least = read(changed, tmp_path), readable(whole, changed)
        assert part is not None or least < 0
        if part is not None:
            same_so_far(part, full)
            assert part.ticks >= least and (part.damage or part.ticks == full.ticks)
            damaged += bool(part.damage)
    assert damaged > 0.9 * count


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.study)])
def test_files_of_earlier_versions_are_read_up_to_their_damage(whole: bytes, count: int, tmp_path: Path) -> None:
    # Their checksums do not tell that a block is missing or in another place: its samples are right, and others missed.
    full, random, old = read(older(whole), tmp_path), np.random.default_rng(8), older(whole)
    assert full is not None and not full.damage and full.ticks == TICKS
    for index in range(count):
        changed = DAMAGES[index % (len(DAMAGES) - 2)](old, random)
        part, least = read(changed, tmp_path), readable(old, changed)
        assert part is not None or least < 0
        if part is not None:
            same_so_far(part, full)
            assert part.ticks >= least
    for _ in range(count // 5):
        part = read(changed := blocks_moved(old, random), tmp_path)
        assert part is not None and part.ticks >= readable(old, changed)


def test_blocks_of_another_recording_are_not_taken(whole: bytes, tmp_path: Path) -> None:
    # As when a copy over an older file of the same name is broken off, or sectors were not written.
    plant, controller = parts()
    file = open_recording(tmp_path / "other.maglev", wait=True)
    drive(plant, controller, TICKS, record=file.begin(plant, controller))
    file.close()
    other, full = (tmp_path / "other.maglev").read_bytes(), read(whole, tmp_path)
    assert full is not None
    for place in (4096, blocks_of(whole)[1][0], blocks_of(whole)[3][0], 40 * 4096):
        changed = whole[:place] + other[place:]
        part = read(changed, tmp_path)
        assert part is not None and part.ticks >= readable(whole, changed) and part.damage
        same_so_far(part, full)


def test_line_endings_of_a_transfer_as_text_are_undone(whole: bytes, tmp_path: Path) -> None:
    full, converted = read(whole, tmp_path), whole.replace(b"\n", b"\r\n")
    assert full is not None
    part = read(converted, tmp_path)
    assert part is not None and part.damage == "line endings converted to CRLF, undone: copy it as binary"
    assert part.ticks == full.ticks
    same_so_far(part, full)
    part = read(zeroed(converted, 200_000, 204_096), tmp_path)
    assert part is not None and part.ticks < full.ticks  # where the zeros lie in a record depends on its size
    assert re.match(r"line endings .*undone.*; .*(wrong checksum|zeros from record)", part.damage), part.damage
    same_so_far(part, full)


def test_damage_is_told_with_its_records(whole: bytes, tmp_path: Path) -> None:
    data = bytearray(whole)
    data[-3 * RECORD.itemsize] ^= 1
    part = read(bytes(data), tmp_path)
    assert part is not None
    assert re.fullmatch(r"wrong checksum of records \d+ to \d+ \(damaged\): readable up to \d\.\d s", part.damage)
    part = read(whole[:-4096] + bytes(4096), tmp_path)
    assert part is not None
    assert re.fullmatch(r"zeros from record \d+ on \(power failure\?\): readable up to \d\.\d s", part.damage)
    assert part.ticks > TICKS - 16


@pytest.mark.parametrize("lost", [4096, 300_000, 10**6])
def test_every_command_reads_to_the_damage_and_names_it(lost: int, whole: bytes, tmp_path: Path, capsys: Any) -> None:
    # Zeros in place of the last 4 or 300 kB, or of all records.
    path = tmp_path / "run.maglev"
    path.write_bytes(zeroed(whole, max(len(whole) - lost, 4096), len(whole)))
    recording = Recording.load(path)
    assert recording.damage.startswith("zeros from record ") and load_samples(path).recording.damage == recording.damage
    table = tmp_path / "run.csv"
    for command in (
        ["replay", "--check"],
        ["analyse", "--no-compare"],
        ["convert", str(table)],
        ["run", "joystick", "--hand-path", str(path)],
        ["diagnose"],
        ["analyse", "--cycles"],
    ):
        words = command if str(path) in command else [command[0], str(path), *command[1:]]
        status, said = main(words), capsys.readouterr()
        assert status in ((0, 1, 2) if recording.ticks else (0, 2)), said
        assert "zeros from record" in said.out + said.err and "Traceback" not in said.err, (words, said)
    assert recording.damage in Path(f"{table}.json").read_text()


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


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> Callable[[], AbstractContextManager[None]]:
    """Return a context in which the program is another process, as after a fork."""

    @contextmanager
    def other() -> Iterator[None]:
        with monkeypatch.context() as patch:
            patch.setattr(os, "getpid", lambda: -1)
            yield

    return other


def recording_of(path: Path) -> Any:
    file: Any = open_recording(path)
    return file, lambda: drive(*(made := parts()), 600, record=file.begin(*made)), file.close


def session_of(path: Path) -> Any:
    session = Session(record=path, pacer=Pacer(budget=60.0, patience=3600.0))
    return session, lambda: session.tick(0.6), session.close


@pytest.mark.parametrize("opened", [recording_of, session_of])
@pytest.mark.parametrize("early", [False, True])
def test_a_forked_process_leaves_the_recording_of_its_parent_alone(
    opened: Any, early: bool, tmp_path: Path, elsewhere: Any
) -> None:
    # Before the first sample, when the file has a name for the time being, and after it.
    path = tmp_path / "run.maglev"
    _, run, close = opened(path)
    if not early:
        run()
    before = [kept.name for kept in tmp_path.iterdir()]
    with elsewhere():
        close()
    assert early is False or [kept.name for kept in tmp_path.iterdir()] == before
    if opened is recording_of:
        run()
        close()
        recording = Recording.load(path)
        assert recording.ticks == 600 * (2 - early) and not recording.damage


def test_a_forked_process_leaves_a_file_that_its_parent_writes_alone(tmp_path: Path, elsewhere: Any) -> None:
    with atomic_path(tmp_path / "run.csv") as partial:
        partial.write_text("half of it")
        with elsewhere(), suppress(KeyError), atomic_path(tmp_path / "other.csv"):
            raise KeyError
    assert (tmp_path / "run.csv").read_text() == "half of it"


@pytest.mark.machine
@pytest.mark.needs("linux")
@pytest.mark.parametrize("early", [False, True])
def test_a_child_that_waits_for_a_full_queue_or_leaves_ends_by_itself(early: bool, tmp_path: Path) -> None:
    words = [sys.executable, "-c", FORK, str(early), str(Path(__file__).parents[2])]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "400 samples\n", "")


FORK = """
import os, sys, warnings
sys.path.insert(0, sys.argv[2])
warnings.simplefilter("ignore")
from maglev_mj.recording import Recording
from tests.recording.test_recording_damage import drive, open_recording, parts
file = open_recording("a.maglev", wait=True)
record = file.begin(*(made := parts()))
if sys.argv[1] == "False":
    drive(*made, 200, record=record)
if not (child := os.fork()):
    file._journal._limit = 10
    drive(*parts(), 100, record=record)  # no thread empties its queue
    file.close()
    sys.exit(7)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
drive(*made, 200 if sys.argv[1] == "False" else 400, record=record)
file.close()
print(Recording.load("a.maglev").ticks, "samples")
"""
