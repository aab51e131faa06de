"""Black boxes: written after faults, and read back."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge import fault as fault_module
from maglev_mj.bridge.fault import BlackBox, BlackBoxError, DeviceFault, FaultRecord, load_black_box
from maglev_mj.bridge.links import LinkError
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.bridge.wire import Fault, Operation, State
from maglev_mj.errors import PlantError
from maglev_mj.frames import Command
from tests.test_bridge import CENTRE, Rig

HOST_DOWN = OSError(errno.EHOSTDOWN, "Host is down")


def flown(folder: Path, kind: str = "dead-coil") -> tuple[Rig, DeviceFault]:
    """Fly until a coil fails; return the fault."""
    rig = Rig(faults=[InjectedFault(kind=kind, which=2, at=1.2)], host={"folder": folder})
    rig.plant.takeoff()
    with pytest.raises(DeviceFault) as caught:
        rig.fly(2.0)
    return rig, caught.value


def test_a_black_box_holds_what_was_measured_and_when_it_was_answered(tmp_path: Path) -> None:
    rig, error = flown(tmp_path)
    assert error.path is not None
    record = load_black_box(error.path)
    assert record.faults == record.first == "COIL_NOT_FOLLOWING" and record.message == "said by the device"
    assert record.fault_time == pytest.approx(rig.twin.tick * 0.005) and record.period == 0.005
    assert (record.tick, record.lost, record.skipped) == (rig.plant.samples.tick, 0, 0)
    measured, held = record.six("measured"), record.six("held")
    assert measured.shape == (200, 6) and (measured[-3:, 2] == 0.0).all() and (np.abs(held[-3:, 2]) > 1.0).all()
    assert measured[1:-4] == pytest.approx(held[:-5], abs=1e-6)  # each sample measures the answer before
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
    record = load_black_box(caught.value.path)
    assert (record.first, record.faults) == ("ESTOP", "ESTOP CLOCK") and record.fault_time == pytest.approx(at * 1e-9)


def test_latency_is_from_the_samples_arrival_to_its_answer(tmp_path: Path) -> None:
    rig = Rig(pose=CENTRE, host={"folder": tmp_path})
    rig.plant.arm()
    for _ in range(3):
        rig.plant.read()
        rig.link.time += 1_250_000  # the program's own time
        rig.plant.write(Command([0.0] * 6))
    assert rig.plant.answer_latency == pytest.approx(1.25e-3)


BROKEN: list[tuple[str, Any]] = [
    ("is not JSON", "{"),
    ("is not JSON", "[" * 100_000),
    ("is not JSON", b"\xff\xfe"),
    ("format must be 'maglev_mj fault 2', not 'list'", []),
    ("format must be .*, not 'calibration'", {"format": "calibration"}),
    ("columns must be those of", {"columns": ["sample"]}),
    ("columns must be those of", {"columns": None}),
    ("cycles must be rows of 43 values", {"cycles": None}),
    ("cycles must be rows of 43 values", {"cycles": [[1.0]]}),
    ("cycles must be rows of 43 values", {"cycles": [None]}),
    ("a value is missing or no number", {"cycles": [["x"] * 43]}),
    ("a value is missing or no number", {"tick": None}),
    ("a value is missing or no number", {"period_ns": "fast"}),
    ("a value is missing or no number", {"fault_time_ns": []}),
    ("period_ns must be above 0", {"period_ns": 0}),
    ("cannot be read: No such file", None),
]


@pytest.mark.parametrize(("says", "wrong"), BROKEN)
def test_what_is_no_black_box_is_one_line(says: str, wrong: Any, tmp_path: Path) -> None:
    good = BlackBox(tmp_path).write(Fault.CLOCK, "a test", {"tick": 1, "lost": 0, "skipped": 0, "period_ns": 5_000_000})
    assert good is not None
    path = tmp_path / "wrong.json"
    if isinstance(wrong, bytes):
        path.write_bytes(wrong)
    elif isinstance(wrong, dict):
        path.write_text(json.dumps({**json.loads(good.read_text()), **wrong}))
    elif wrong is not None:
        path.write_text(wrong if isinstance(wrong, str) else json.dumps(wrong))
    with pytest.raises(BlackBoxError, match=says) as caught:
        load_black_box(path)
    assert "wrong.json" in str(caught.value) and "\n" not in str(caught.value)


def test_a_box_without_a_cycle_is_read_and_drawn(tmp_path: Path) -> None:
    path = BlackBox(tmp_path).write(Fault.CLOCK, "at\x1b[2J once", {"tick": 1, "lost": 0, "skipped": 0, "period_ns": 5})
    assert path is not None
    record = load_black_box(path)
    assert record.time.shape == (0,) and record.six("pose").shape == (0, 6)
    said = str(record.table())
    assert "\x1b" not in said and said.startswith("at\\x1b[2J once\n") and not record.table().rows
    record.plot(tmp_path / "empty.png")


def test_the_table_says_what_when_and_the_last_cycles(tmp_path: Path) -> None:
    rig, error = flown(tmp_path)
    assert error.path is not None
    record = load_black_box(error.path)
    table = record.table(whole=True)
    first = f"first COIL_NOT_FOLLOWING at {record.fault_time:.4f} s of the device's clock"
    assert f"faults COIL_NOT_FOLLOWING; {first}" in table.note.splitlines()
    assert table.title == record.message and "COIL_NOT_FOLLOWING: a measured current" in table.note
    assert f", fault from sample {rig.plant.samples.tick} on" in table.note and "active from sample " in table.note
    assert [row[0] for row in (table.rows[-2], table.rows[-1])] == ["-5.0", "0.0"] and len(table.rows) == 200
    assert "the last 20 of 200 cycles" in record.table().note and len(record.table().rows) == 20
    lines = str(table).splitlines()
    assert max(map(len, lines)) <= 80 and sum(line.split()[:2] == ["time", "x"] for line in lines) == 1
    picture = record.plot(tmp_path / "fault.png")
    assert picture.stat().st_size > 20_000


def test_a_pulse_is_commanded_too_while_it_has_a_width(tmp_path: Path) -> None:
    record = load_black_box(flown(tmp_path)[1].path or "")
    values = {name: column.copy() for name, column in record.values.items()}
    values["pulsed3"][-3:], values["width"][-3:] = [-7.5, 0.25, -7.5], [0.003, 0.003, 0.0]
    shown = [row[7] for row in replace(record, values=values).table().rows]
    held = [f"{value:.2f}" for value in np.abs(record.six("held")).max(axis=-1)[-3:]]
    assert shown[-3:] == ["7.50", *held[1:]]


class Full:
    """Folder on a full disk: files begin, and end early."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, only: Path | None = None) -> None:
        real = Path.open

        def opened(path: Path, mode: str = "r", **keywords: Any) -> Any:
            file = real(path, mode, **keywords)
            if mode == "x" and (only is None or path.parent == only):

                def fails(text: str) -> int:
                    raise OSError(errno.ENOSPC, "No space left on device")

                file.write = fails  # type: ignore[method-assign, assignment]
            return file

        monkeypatch.setattr(Path, "open", opened)


def test_a_full_disk_leaves_no_half_file_and_the_fault_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own, temporary = tmp_path / "own", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    Full(monkeypatch, own)
    _, error = flown(own)
    assert error.path is not None and error.path.parent == temporary and not list(own.iterdir())
    Full(monkeypatch)
    _, error = flown(own)
    assert error.path is None and error.faults == Fault.COIL_NOT_FOLLOWING and not list(own.iterdir())


def test_whatever_fails_in_writing_the_fault_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any, **__: Any) -> Any:
        raise ValueError("oh")

    monkeypatch.setattr(fault_module, "_flat", fails)
    rig, error = flown(tmp_path)
    assert error.path is None and rig.twin.firmware.state == State.FAULT


@pytest.mark.parametrize("kind", [LinkError("the line is gone"), HOST_DOWN, RuntimeError("oh")])
@pytest.mark.parametrize("where", ["send", "receive"])
def test_a_line_that_fails_in_any_way_leaves_a_black_box_and_is_closed(
    where: str, kind: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(pose=CENTRE, host={"folder": tmp_path})
    closed: list[int] = []
    monkeypatch.setattr(rig.link, "close", lambda: closed.append(1))

    def fails(_: Any) -> Any:
        raise kind

    with pytest.raises(DeviceFault, match="HOST: "), rig.plant:
        rig.plant.arm()
        rig.fly(0.5)
        monkeypatch.setattr(rig.link, where, fails)
        rig.fly(0.5)
    assert closed == [1] and len(list(tmp_path.glob("maglev-fault-*.json"))) == 1
    assert isinstance(load_black_box(next(tmp_path.iterdir())), FaultRecord)
    for _ in range(15):
        rig.twin.sample()
    assert rig.currents() == [0.0] * 6
    rig.plant.close()
    assert closed == [1]


@pytest.mark.parametrize("kind", [LinkError("gone"), OSError("gone"), KeyboardInterrupt()])
def test_an_error_within_close_still_closes_the_line_once(kind: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, closed = Rig(), []

    def fails(operation: Operation) -> Any:
        raise kind

    monkeypatch.setattr(rig.plant._line, "control", fails)
    monkeypatch.setattr(rig.link, "close", lambda: closed.append(1))
    if isinstance(kind, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            rig.plant.close()
    else:
        rig.plant.close()
    rig.plant.close()
    assert closed == [1]
    with pytest.raises(PlantError, match="the plant is closed"):
        rig.plant.read()
