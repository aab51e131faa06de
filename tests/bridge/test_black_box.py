"""Last cycles of a device: written after faults and by recorded flights, and read back."""

from __future__ import annotations

import errno
import json
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest.mock import Mock

import numpy as np
import pytest

from maglev_mj import recording
from maglev_mj.bridge import fault
from maglev_mj.bridge.fault import DeviceFault, FaultRecord, LastCycles, load_fault
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.links import LinkError
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.errors import PlantError
from maglev_mj.recording import InvalidRecordingError, Recording, journal, open_recording
from maglev_mj.scenes import find_scene
from tests.bridge.test_bridge import CENTRE, Rig
from tests.sweeps import sweep

ROOT = Path(__file__).parents[2]
HOST_DOWN = OSError(errno.EHOSTDOWN, "Host is down")


class Failed(NamedTuple):
    """Flight with a failed coil: both ends, the fault, and folder, path and record of its file."""

    rig: Rig
    error: DeviceFault
    folder: Path
    path: Path
    record: FaultRecord


def flown(folder: Path, at: float = 0.1) -> tuple[Rig, DeviceFault]:
    """Hover until a coil fails; return the fault."""
    rig = Rig(faults=[InjectedFault(kind="dead-coil", which=2, at=at)], pose=CENTRE, host={"folder": folder})
    rig.plant.arm()
    with pytest.raises(DeviceFault) as caught:
        rig.fly(2.0)
    return rig, caught.value


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Failed:
    """Fly until a coil fails."""
    folder = tmp_path_factory.mktemp("failed")
    rig, error = flown(folder, 1.2)
    assert error.path is not None
    return Failed(rig, error, folder, error.path, load_fault(error.path))


def test_a_file_of_last_cycles_holds_what_was_measured_and_when_it_was_answered(failed: Failed) -> None:
    rig, record = failed.rig, failed.record
    assert record.faults == record.first == "COIL_NOT_FOLLOWING" and record.message == "reported by the device"
    assert record.fault_time == pytest.approx(record.tick * 0.005) and record.period == 0.005
    assert (record.lost, record.skipped) == (0, 0) and rig.twin.tick - 20 <= record.tick <= rig.twin.tick
    measured, held = record.six("measured"), record.six("held")
    assert measured.shape == (200, 6) and (measured[-3:, 2] == 0.0).all() and (np.abs(held[-3:, 2]) > 1.0).all()
    assert measured[1:-4] == pytest.approx(held[:-5], abs=1e-6)  # each sample measures the previous answer
    assert (np.diff(record.six("temperature")[:, 0]) > 0.0).all()
    assert record.values["delay"][5:-3] == pytest.approx(0.0015) and (record.values["latency"] >= 0.0).all()
    assert np.isfinite(record.six("pose")[:-1]).all() and np.diff(record.time) == pytest.approx(0.005)


def test_the_first_fault_and_its_time_are_kept_when_others_follow(tmp_path: Path) -> None:
    rig = Rig(pose=CENTRE, host={"folder": tmp_path})
    rig.plant.arm()
    rig.fly(0.5)
    rig.plant.estop()
    at = rig.plant.fault_time
    rig.plant.trip(Fault.CLOCK)
    with pytest.raises(DeviceFault) as caught:
        rig.plant.read()
    assert (rig.plant.first, rig.plant.fault_time) == (Fault.ESTOP, at) and at >= 0.5e9
    assert caught.value.path is not None
    record = load_fault(caught.value.path)
    assert (record.first, record.faults) == ("ESTOP", "ESTOP CLOCK") and record.fault_time == pytest.approx(at * 1e-9)


ABOUT: dict[str, Any] = {"first": "CLOCK", "tick": 1, "lost": 0, "skipped": 0, "period_ns": 5, "fault_time_ns": 0}


def boxed(folder: Path, message: str = "a test", **about: Any) -> Path:
    """Write a journal of no cycle and a fault."""
    kept = LastCycles(folder)
    path = kept.write(kept.mark(Fault.CLOCK, message, ABOUT | about))
    assert path is not None
    return path


BROKEN: list[tuple[str, Any]] = [
    (
        "old format: only the version of maglev_mj that wrote it can read it",
        b'{"format": "maglev_mj fault 2"}',
    ),
    ("first must be a string [(]got None", {"first": None}),
    ("period_ns must be between 1 and .*got 0", {"period_ns": 0}),
]


@pytest.mark.parametrize(("says", "wrong"), BROKEN)
def test_a_file_without_last_cycles_is_an_error_of_one_line(says: str, wrong: Any, tmp_path: Path) -> None:
    path = tmp_path / "wrong.maglev"
    if isinstance(wrong, bytes):
        path.write_bytes(wrong)
    else:
        boxed(tmp_path, **wrong).rename(path)
    with pytest.raises(InvalidRecordingError, match=says) as caught:
        load_fault(path)
    assert "wrong.maglev" in str(caught.value) and "\n" not in str(caught.value)


def test_a_recording_without_cycles_and_a_changed_bit_are_refused(failed: Failed, tmp_path: Path) -> None:
    with pytest.raises(InvalidRecordingError, match=r"no device cycles \(only recordings of flights contain them\)"):
        load_fault(ROOT / "tests/golden/recordings/drop-exact.maglev")
    data, path = bytearray(failed.path.read_bytes()), tmp_path / "changed.maglev"
    data[4096 + 100 * journal.RECORD.itemsize + 50] ^= 1
    path.write_bytes(data)
    with pytest.raises(InvalidRecordingError, match="wrong checksum of records 0 to "):
        load_fault(path)


def test_a_file_without_a_cycle_is_read_and_drawn(tmp_path: Path) -> None:
    record = load_fault(boxed(tmp_path, "at\x1b[2J once"))
    assert record.time.shape == (0,) and record.six("pose").shape == (0, 6)
    said = str(record.table())
    assert "\x1b" not in said and said.startswith("CLOCK: at\\x1b[2J once (") and not record.table().rows
    record.plot(tmp_path / "empty.png")


def test_numpy_alone_reads_the_cycles(failed: Failed) -> None:
    path, record = failed.path, failed.record
    with path.open("rb") as file:
        header = json.loads(file.readline())
    records = np.fromfile(path, np.dtype(header["dtype"]), offset=header["offset"])
    cycles = records[records["kind"] == 4].view(np.dtype(header["cycle"]))
    assert (cycles["measured"] == record.six("measured")).all() and len(cycles) == 200
    assert (cycles["state"] == record.values["state"]).all() and cycles["time"][-1] == record.values["time"][-1]
    assert cycles.dtype.itemsize == journal.RECORD.itemsize


END = ')\n"""Values of a device cycle'
STORED = Path(__file__).with_name("fault.maglev")
"""Last eight cycles of a flight, written before values could be added to a cycle."""


def changed(module: ModuleType, *changes: tuple[str, str]) -> Any:
    """Return a module made again of its source, with texts replaced."""
    source = Path(str(module.__file__)).read_text(encoding="utf-8")
    for old, new in changes:
        source = source.replace(old, new)
    again = ModuleType(module.__name__)
    exec(compile(source, str(module.__file__), "exec"), vars(again))
    return again


def original(*changes: tuple[str, str]) -> Any:
    """Return the journal without the values of STATE in a cycle, none of which `STORED` has, changed."""
    source = Path(str(journal.__file__)).read_text(encoding="utf-8")
    since = source.partition('CyclePart("latency"')[2].partition("\n")[2].partition(END)[0]
    return changed(journal, (since + END, END), *changes)


def test_a_stored_file_is_read_and_would_be_written_the_same() -> None:
    stored, then = journal.open_journal(STORED), original()
    fixed = {name: stored.header[name] for name in ("dtype", "cycle", "format", "version", "units", "checksums")}
    assert fixed.items() <= json.loads(then.header()).items()
    cycles = stored.records[stored.kinds == journal.CYCLE].view(np.dtype(stored.header["cycle"]))
    flat = [[value for part in cycle.tolist() for value in np.ravel(part).tolist()] for cycle in cycles]
    assert b"".join(then.PACK_CYCLE(*values) for values in flat) == cycles.tobytes() and len(flat) == 8
    run = journal.open_journal(ROOT / "tests/golden/recordings/drop-exact.maglev")
    samples = run.records[run.kinds == journal.SAMPLE]
    flat = [[value for part in sample.tolist()[2:] for value in np.ravel(part).tolist()] for sample in samples]
    assert b"".join(then.PACK_SAMPLE(*values) for values in flat) == samples.tobytes()

    record = load_fault(STORED)
    assert record.faults == "COIL_NOT_FOLLOWING" and record.tick == 22 and record.period == 0.005
    assert record.values["state"].tolist() == [1.0] * 7 + [2.0] and np.isnan(record.six("pose")[-1]).all()
    assert all((cycles[name] == record.values[name]).all() for name in ("time", "width", "delay", "latency"))
    assert (cycles["held"] == record.six("held")).all()


@pytest.mark.parametrize(
    ("parts", "size", "spare", "columns"),
    [
        (['"conversions", "<u4", "", "counter"'], 340, {"spare0": "<u4"}, {"conversions"}),
        (['"age", "<f8", "us", "age"'], 344, {"spare0": "<f8"}, {"age"}),
        (
            ['"currents", "6<f8", "A", "currents"', '"valid", "<u4", "", "bits"'],
            388,
            {"spare6": "<u4"},
            {"valid", *(f"current{index}" for index in range(6))},
        ),
    ],
)
def test_a_value_of_state_is_recorded_by_one_line(
    parts: list[str],
    size: int,
    spare: dict[str, str],
    columns: set[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lines = "".join(f"    CyclePart({part}),\n" for part in parts)
    newer = original((END, lines + END))
    stored = load_fault(STORED)
    monkeypatch.setattr(fault, "journal", newer)
    monkeypatch.setattr(recording, "journal", newer)
    load_newer = changed(fault).load_fault
    rig, error = flown(tmp_path)
    assert error.path is not None
    content = newer.open_journal(error.path)
    assert newer.RECORD.itemsize == size and spare.items() <= dict(zip(*content.header["dtype"].values())).items()
    cycles, names = content.cycles(len(content.records), 200), [part.split('"')[1] for part in parts]
    assert cycles.dtype.names[-len(names) :] == tuple(names) == tuple(newer.REPORTED)
    states = [frame.body for frame, *_ in [*rig.plant.cycles._rows][: len(cycles)]]  # one more follows the fault
    assert all((cycles[name] == [getattr(state, name) for state in states]).all() for name in names)
    assert {*load_newer(error.path).values} - stored.values.keys() == columns

    old = newer.open_journal(STORED)
    cycles = old.cycles(len(old.records), 200)
    assert all(np.isnan(cycles[name]).all() for name in names) and cycles["tick"].tolist() == [*range(15, 23)]
    assert all(np.isnan(load_newer(STORED).values[name]).all() for name in columns)
    monkeypatch.undo()
    record = load_fault(error.path)  # values of newer versions are left out
    assert record.values.keys() == stored.values.keys() and record.tick == record.values["sample"][-1]


def test_a_cycle_shorter_than_a_sample_is_padded() -> None:
    width = next(part for part in journal.CYCLE_PARTS if part.name == "width")
    shorter, then = original((f'    CyclePart("width", "<f8", "s", "{width.text}"),\n', "")), original()
    header = json.loads(shorter.header())
    assert header["dtype"] == json.loads(then.header())["dtype"] and shorter.RECORD == then.RECORD
    assert dict(zip(*header["cycle"].values())).popitem() == ("spare0", "<f8")
    assert np.dtype(header["cycle"]).itemsize == len(shorter.PACK_CYCLE(4, *range(42))) == then.RECORD.itemsize
    content = shorter.open_journal(STORED)
    assert content.cycles(len(content.records), 8)["latency"].tolist() == load_fault(STORED).values["latency"].tolist()


CYCLE = json.loads(STORED.read_bytes().splitlines()[0])["cycle"]


@pytest.mark.parametrize(
    ("names", "formats", "says"),
    [
        (CYCLE["names"][:-1], CYCLE["formats"][:-1], "cycle must have latency as <f8"),
        (CYCLE["names"], ["<u4", *CYCLE["formats"][:-1]], "cycle must have time as <f8, spots as 6<f8"),
        (
            [*CYCLE["names"], "more"],
            [*CYCLE["formats"], "<u4"],
            "cycle must have 336 bytes, as the records have .got 340",
        ),
        (CYCLE["names"], ["O", *CYCLE["formats"][1:]], "cycle must have unique names, and formats among"),
    ],
)
def test_a_cycle_that_cannot_be_read_is_named(names: list[str], formats: list[str], says: str, tmp_path: Path) -> None:
    line, rest = STORED.read_bytes().split(b"\n", 1)
    header = json.loads(line) | {"cycle": {"names": names, "formats": formats}}
    head = json.dumps(header).encode().ljust(len(line)) + b"\n"
    path = tmp_path / "changed.maglev"
    block = rest[: rest.rindex((journal.CHECKSUM).to_bytes(4, "little"))]
    path.write_bytes(head + block + original().Seal(head)(block))
    with pytest.raises(InvalidRecordingError, match=says):
        load_fault(path)


def recorded(folder: Path, law: Any = None, hurt: bool = False) -> tuple[Path, Path | None]:
    """Fly with a recording; return it, and the file of a fault."""
    rig = Rig(faults=[InjectedFault(kind="dead-coil", which=2, at=1.7)] if hurt else [], host={"folder": folder})
    scene = find_scene("joystick")().replace(period=rig.plant.period, delay=rig.plant.delay)
    file = open_recording(folder / "run.maglev")
    flight = Flight(rig.plant, scene, file=file)
    if law is not None:
        flight._power_guard = law
    try:
        path = flight.run(0.4).landing.path
    except DeviceFault as error:
        path = error.path
    assert rig.plant.cycles.record is None
    file.close()
    return folder / "run.maglev", path


def test_the_recording_of_a_flight_holds_what_the_file_of_its_fault_does(tmp_path: Path) -> None:
    run, path = recorded(tmp_path, hurt=True)
    assert path is not None
    one, other = load_fault(run), load_fault(path)
    assert str(one.table(whole=True)) == str(other.table(whole=True)) and len(one.time) == 200
    assert one.message == "reported by the device" and one.faults == "COIL_NOT_FOLLOWING"
    assert all(np.array_equal(one.values[name], other.values[name], equal_nan=True) for name in other.values)
    run_recorded = Recording.load(run)  # skips the cycles
    assert run_recorded.ticks and not run_recorded.damage


def test_an_early_landing_stores_the_cycles_before_it(tmp_path: Path) -> None:
    alarm = Mock()
    alarm.check.side_effect = [*[""] * 60, *["for a test"] * 1000]
    run, path = recorded(tmp_path, alarm)
    assert path is not None
    one, other = load_fault(run), load_fault(path)
    assert str(one.table(whole=True)) == str(other.table(whole=True))
    assert one.message == "for a test" and one.tick == one.values["sample"][-1]
    content = journal.open_journal(run)
    later = content.cycles(len(content.records), 1)["tick"][0]
    assert later > one.tick  # the landing is in the recording too


def test_a_flight_without_a_fault_shows_its_last_cycles(tmp_path: Path) -> None:
    run, path = recorded(tmp_path)
    record = load_fault(run)
    assert path is None and record.faults == record.first == "none" and np.isnan(record.fault_time)
    assert record.message == "no fault recorded; last cycles" and record.period == pytest.approx(0.005)
    assert record.lost == 0 and record.tick == record.values["sample"][-1] and len(record.time) == 200
    assert not list(tmp_path.glob("fault-*"))


def test_the_table_says_what_when_and_the_last_cycles(failed: Failed) -> None:
    record = failed.record
    table = record.table(whole=True)
    first = f"first COIL_NOT_FOLLOWING at {record.fault_time:.4f} s (device clock)"
    assert f"faults COIL_NOT_FOLLOWING; {first}" in table.note.splitlines()
    assert (
        table.headline == record.headline
        and record.message in table.headline
        and "COIL_NOT_FOLLOWING: a measured current" in table.note
    )
    number = record.tick
    assert f", fault from {number}, last {number}" in table.note and "device's sample numbers: active at " in table.note
    assert "200 Hz; since the handshake, with the preflight check: 0 samples lost, 0 skipped" in table.note
    assert [row[0] for row in (table.rows[-2], table.rows[-1])] == ["-5.0", "0.0"] and len(table.rows) == 200
    assert "last 20 of 200 cycles" in record.table().note and len(record.table().rows) == 20
    lines = str(table).splitlines()
    assert max(map(len, lines)) <= 80 and sum(line.split()[:2] == ["time", "x"] for line in lines) == 1


def test_a_full_disk_leaves_no_partial_file_and_the_fault_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, temporary = tmp_path / "own", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    opened, full = Path.open, {own}

    def limited(path: Path, mode: str = "r", **keywords: Any) -> Any:
        file = opened(path, mode, **keywords)
        if mode == "xb" and path.parent in full:
            file.write = Mock(side_effect=OSError(errno.ENOSPC, "No space left on device"))  # type: ignore[method-assign]
        return file

    monkeypatch.setattr(Path, "open", limited)
    _, error = flown(own)
    assert error.path is not None and error.path.parent == temporary and not list(own.iterdir())
    full.add(temporary)
    _, error = flown(own)
    assert error.path is None and error.faults == Fault.COIL_NOT_FOLLOWING and not list(own.iterdir())


@pytest.mark.parametrize("name", ["text_records", "header"])
def test_the_fault_is_reported_whatever_fails_in_writing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"maglev_mj.bridge.fault.journal.{name}", Mock(side_effect=ValueError("oh")))
    rig, error = flown(tmp_path)
    assert error.path is None and error.faults == Fault.COIL_NOT_FOLLOWING and rig.twin.firmware.state == State.FAULT
    assert rig.plant.cycles.write(b"") is None  # as for an early landing


def test_without_a_writable_folder_the_file_goes_to_the_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken, found = tmp_path / "taken", []
    taken.write_text("a file, not a folder")
    for temporary in (tmp_path / "elsewhere", tmp_path / "elsewhere", taken / "nowhere"):
        monkeypatch.setattr("tempfile.tempdir", str(temporary))
        found.append(flown(taken / "faults")[1])
    first, second, third = (error.path for error in found)
    assert first is not None and second is not None and first.parent == second.parent == tmp_path / "elsewhere"
    assert first != second and third is None and "last cycles" not in str(found[2])


@pytest.mark.parametrize("kind", [LinkError("gone"), OSError("gone"), KeyboardInterrupt()])
def test_an_error_within_close_still_closes_the_link_once(kind: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, closed = Rig(), Mock()
    monkeypatch.setattr(rig.plant._connection, "control", Mock(side_effect=kind))
    monkeypatch.setattr(rig.link, "close", closed)
    with pytest.raises(KeyboardInterrupt) if isinstance(kind, KeyboardInterrupt) else nullcontext():
        rig.plant.close()
    rig.plant.close()
    assert closed.call_count == 1
    with pytest.raises(PlantError, match="the plant is closed"):
        rig.plant.read()


@pytest.mark.parametrize(
    ("kind", "where"),
    sweep([LinkError("the line is gone"), HOST_DOWN, RuntimeError("oh")], ["send", "receive"], every=2),
)
def test_a_failing_link_leaves_the_last_cycles_and_is_closed(
    kind: Exception, where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(pose=CENTRE, host={"folder": tmp_path})
    closed: list[int] = []
    monkeypatch.setattr(rig.link, "close", lambda: closed.append(1))

    with pytest.raises(DeviceFault, match="HOST: "), rig.plant:
        rig.plant.arm()
        rig.fly(0.5)
        monkeypatch.setattr(rig.link, where, Mock(side_effect=kind))
        rig.fly(0.5)
    assert closed == [1] and len(list(tmp_path.glob("fault-*.maglev"))) == 1
    assert isinstance(load_fault(next(tmp_path.iterdir())), FaultRecord)
    for _ in range(15):
        rig.twin.sample()
    assert rig.currents() == [0.0] * 6
    rig.plant.close()
    assert closed == [1]
