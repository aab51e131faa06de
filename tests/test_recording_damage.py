"""Effects of damage, by the table in docs/reference/recording.md."""

import io
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from maglev_mj.cli import main, scenes
from maglev_mj.control import Wall
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import Recording, RecordingError, open_recording, setup_of
from maglev_mj.recording.sample import FIELDS, TOTALS
from maglev_mj.recording.writer import McapWriter, row_of
from maglev_mj.session import Pacer, Session
from maglev_mj.views.remote import ShowReport

PERIOD = 0.001
TICKS = 1500


def parts() -> tuple[ExactPlant, Controller]:
    plant = ExactPlant(Timing(period=PERIOD, delay=0.0015), pose=[0.0, 0.0, 0.0045, 0.01, 0.0, 0.0])
    return plant, Controller([Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)], period=PERIOD)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a recording of two stretches with an attachment and events."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
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
    path = folder / "run.mcap"
    path.write_bytes(data)
    try:
        return Recording.load(path)
    except RecordingError as error:
        assert "\n" not in str(error)
        return None


def same_so_far(part: Recording, full: Recording) -> None:
    """Check that the readable part is unchanged, the rest reported."""
    for one, other in zip(part.stretches, full.stretches, strict=False):
        assert one.arrays.keys() == other.arrays.keys() == {field.name for field in (*FIELDS, *TOTALS)}
        for name, values in one.arrays.items():
            assert values.tobytes() == other.arrays[name][: len(one)].tobytes()
        assert one.setup == other.setup
    assert list(part.events) == list(full.events)[: len(part.events)]
    assert set(part.attachments.items()) <= set(full.attachments.items())
    if not part.damage:
        assert part.ticks == full.ticks and len(part.events) == len(full.events)
        assert part.attachments == full.attachments and part.about == full.about


def boundaries(data: bytes) -> list[int]:
    """Return the boundaries of a file's chunks."""
    from mcap.reader import make_reader

    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    return sorted(
        edge
        for chunk in summary.chunk_indexes
        for edge in (chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length)
    )


@pytest.mark.parametrize("all_of_them", [False, pytest.param(True, marks=pytest.mark.study)])
def test_cut_off_anywhere_it_is_read_up_to_its_last_whole_chunk(
    whole: bytes, all_of_them: bool, tmp_path: Path
) -> None:
    # At every end of a chunk and some bytes around, and all over.
    full, edges = read(whole, tmp_path), boundaries(whole)
    assert full is not None and not full.damage and full.ticks == 2 * (TICKS // 2) and len(edges) > 8
    offsets, step, last = ((-9, -1, 0, 1, 9), 997, 1) if all_of_them else ((-1, 0), 9973, 7)
    near = {edge + off for edge in edges for off in offsets}
    ends, ticks = {*near, *range(0, len(whole), step), *range(len(whole) - 40, len(whole), last)}, dict[int, int]()
    for end in sorted(ends):
        part = read(whole[:end], tmp_path)
        if part is not None:
            assert part.damage in ("its end is missing", "its count of messages is missing")
            same_so_far(part, full)
            ticks[end] = part.ticks
    assert len(set(ticks.values())) > 5
    for first, last in zip(edges[2::2], edges[3::2], strict=True):  # a chunk that is whole counts
        assert ticks[last] > ticks[first] or last == edges[-1]


def flips(whole: bytes, folder: Path, count: int) -> tuple[int, int, int]:
    """Return how many single-bit changes were refused, reported as damage, or without effect."""
    full = read(whole, folder)
    assert full is not None
    random, found = np.random.default_rng(1), [0, 0, 0]
    for place in np.linspace(8, len(whole) - 1, count).astype(int).tolist():
        data = bytearray(whole)
        data[place] ^= 1 << int(random.integers(8))
        part = read(bytes(data), folder)
        if part is not None:
            same_so_far(part, full)
        found[0 if part is None else 1 if part.damage else 2] += 1
    return found[0], found[1], found[2]


def test_no_number_of_a_file_with_one_bit_changed_is_taken_for_true(whole: bytes, tmp_path: Path) -> None:
    refused, damaged, same = flips(whole, tmp_path, 120)
    assert damaged > refused > 0 and same < 6


@pytest.mark.study
def test_no_number_of_a_file_with_one_bit_changed_is_taken_for_true_anywhere(whole: bytes, tmp_path: Path) -> None:
    found = flips(whole, tmp_path, 600)
    print("refused, damaged, the same:", found)
    assert found[1] > found[0] > 0 and found[2] < 30


@pytest.mark.parametrize("step", [31, pytest.param(5, marks=pytest.mark.study)])
def test_one_bit_changed_in_an_attachment_loses_that_attachment_alone(step: int, tmp_path: Path, capsys: Any) -> None:
    # In its times, its name, its content, or its checksum; not the size of its record.
    from mcap.reader import make_reader

    path = tmp_path / "run.mcap"
    file = open_recording(path, wait=True)
    file.attach("kept.xml", "text/xml", b"<mujoco/>" * 50)
    file.attach("lost.py", "text/x-python", b"# mine\n" * 100)
    plant, controller = parts()
    drive(plant, controller, 300, record=file.begin(plant, controller))
    file.close()
    whole = path.read_bytes()
    full, summary = read(whole, tmp_path), make_reader(io.BytesIO(whole)).get_summary()
    assert full is not None and summary is not None
    (index,) = (one for one in summary.attachment_indexes if one.name == "lost.py")
    begin, end = index.offset + 9, index.offset + index.length
    for place in (*range(begin, begin + 60, 5), *range(begin + 60, end, step), end - 1):  # in each of its fields
        data = bytearray(whole)
        data[place] ^= 1 << place % 8
        part = read(bytes(data), tmp_path)
        assert part is not None and list(part.attachments) == ["kept.xml"] and part.ticks == 300
        assert part.damage.startswith("an attachment is damaged, and left out")
        same_so_far(part, full)
    assert main(["replay", str(path), "--check"]) == 1
    said = capsys.readouterr().out
    assert "an attachment is damaged" in said and "300 of 300 the same: tick, time, position" in said


class FullDisk(io.BytesIO):
    """File on a disk of limited size."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self._room = room

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > self._room:
            raise OSError(28, "No space left on device")
        return super().write(data)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.95, 0.999])
def test_a_disk_that_is_full_is_told_of_and_what_was_written_is_read(
    share: float, whole: bytes, tmp_path: Path
) -> None:
    # Wherever it is: in the header, in samples, in the index at the end.
    def write(file: Any) -> None:
        writer = McapWriter(file)
        plant, controller = parts()
        writer.begin(setup_of(plant, controller), 1)
        drive(plant, controller, 600, record=lambda *cycle: writer.rows([row_of(*cycle, plant)]))  # type: ignore[call-arg]
        writer.flush()
        writer.close()

    room = io.BytesIO()
    write(room)
    disk = FullDisk(int(share * len(room.getvalue())))
    with pytest.raises(OSError, match="No space left on device"):
        write(disk)
    part, full = read(disk.getvalue(), tmp_path), read(room.getvalue(), tmp_path)
    assert full is not None and (part is not None or share < 0.5)
    if part is not None:
        assert part.damage and (part.ticks > 200 or share < 0.5)
        same_so_far(part, full)


@pytest.mark.needs("linux")
@pytest.mark.parametrize("suffix", [pytest.param(".mcap", marks=pytest.mark.machine), ".npz"])
@pytest.mark.parametrize("by_key", [False, True])
def test_a_disk_that_is_full_ends_a_session_with_one_line(
    by_key: bool, suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    # The recording of the option, or two that a key began; every sample that was written can be read.
    import resource

    spare, save = tmp_path / "spare", Recording.save
    spare.mkdir()
    (spare / f"run{suffix}").write_text("of another run")
    monkeypatch.setattr("tempfile.tempdir", str(spare))
    monkeypatch.setattr("maglev_mj.session.session.best_suffix", lambda: suffix)
    monkeypatch.setattr("maglev_mj.cli.peripherals.PageOptions.open", lambda _: Mock())

    def full(recording: Recording, path: Path) -> None:
        if spare not in Path(path).parents:
            raise OSError(28, "No space left on device")
        save(recording, path)

    def shown(session: Session, *_rest: Any) -> ShowReport:
        session._pacer = Pacer(budget=60.0, patience=3600.0)
        for _ in range(1 + by_key):
            if by_key:
                session.act("record")
            file: Any = session._recorder.file
            if suffix == ".mcap":
                resource.prlimit(file._process.pid, resource.RLIMIT_FSIZE, (60_000, 60_000))
            for _ in range(50):
                session.tick(0.1)
            if by_key:
                session.act("record")
        session.close()
        return ShowReport(0, 0.0, 0.0, 0.0, 0, 0)

    monkeypatch.setattr(Recording, "save", full)
    monkeypatch.setattr(scenes, "show_session", shown)
    option = [] if by_key else ["--record", str(tmp_path / f"run{suffix}")]
    assert main(["view", "--out", str(tmp_path), *option]) == 1
    said = capfd.readouterr()
    (line,) = said.err.splitlines()
    assert not said.out and line.startswith(f"maglev-mj view: {tmp_path}")
    if suffix == ".mcap":
        assert line.count("is not whole: File too large") == 1 + by_key
        kept = list(tmp_path.glob("*.mcap"))
    else:
        assert line.count("cannot be written: No space left on device; it is in ") == 1 + by_key
        kept = [path for path in spare.rglob("*.npz") if path.parent != spare]
        assert all(str(path) in line for path in kept)
    ticks = [Recording.load(path).ticks for path in kept]
    assert len(ticks) == 1 + by_key and all(one == 1000 if suffix == ".npz" else one > 100 for one in ticks)
    assert (spare / f"run{suffix}").read_text() == "of another run"
