"""What is written, read, saved and exported is the same: values, units, events, attachments, what it was made from."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from inspect import isfunction
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.errors import MissingPackageError, ParameterError
from maglev_mj.lazy import loaded
from maglev_mj.recording import Recording, check_name, load_samples
from maglev_mj.recording.export import export
from maglev_mj.recording.formats import Format
from maglev_mj.recording.sample import ARRAYS, ROW, TOTALS
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.session.replay import record_run
from tests.all_of import FORMATS
from tests.processes import run_here
from tests.recorded import load, made, messages_in

DOCS = Path(__file__).resolve().parents[2] / "docs"


class Content(NamedTuple):
    """Content of a file, as its reader finds it; None for what its format does not hold."""

    columns: Mapping[str, Any]
    units: Mapping[str, str]
    events: list[str]
    setups: list[Any]
    about: Mapping[str, Any]
    attachments: Mapping[str, bytes]
    damage: str | None


def _of_json(columns: Mapping[str, Any], told: Mapping[str, Any], attachments: Mapping[str, bytes]) -> Content:
    units, events, setups, about = (told[name] for name in ("units", "events", "setups", "about"))
    return Content(columns, units, events, setups, about, attachments, told["damage"])


def _decoded(told: Mapping[str, Any]) -> dict[str, bytes]:
    return {name: base64.b64decode(data) for name, data in told["attachments"].items()}


def _csv(path: Path) -> Content:
    import pandas

    told = json.loads(path.with_name(f"{path.name}.json").read_text())
    return _of_json(pandas.read_csv(path), told, _decoded(told))


def _parquet(path: Path) -> Content:
    from pyarrow import parquet

    table = parquet.read_table(path)
    names = [name.decode().partition(".")[2] for name in table.schema.metadata if name.startswith(b"maglev_mj.")]
    told = {name: json.loads(table.schema.metadata[f"maglev_mj.{name}".encode()]) for name in names}
    for field in table.schema:  # the unit of a column is with it, too
        assert (field.metadata or {}).get(b"unit", b"").decode() == told["units"].get(field.name, "")
    return _of_json({name: table[name].to_numpy() for name in table.column_names}, told, _decoded(told))


def _npz(path: Path) -> Content:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    told, columns = json.loads(str(arrays["header"])), dict[str, list[Any]]()
    for index in range(len(told["setups"])):
        columns.setdefault("segment", []).append(np.full(len(arrays[f"{index}/tick"]), index))
        for array, fields in {**ARRAYS, **{one.name: [one] for one in TOTALS}}.items():
            names = [name for field in fields for name, _ in field.units]
            if f"{index}/{array}" in arrays:
                values = arrays[f"{index}/{array}"].reshape(len(columns["segment"][-1]), -1).T
                for name, column in zip(names, values, strict=True):
                    columns.setdefault(name, []).append(column)
    assert told["axes"] == ["x", "y", "z", "rx", "ry", "rz"] and len(told["gaps"]) == len(told["setups"])
    assert len(told["event_samples"]) == len(told["events"])
    attachments = {name: arrays[f"attachment/{index}"].tobytes() for index, name in enumerate(told["attachments"])}
    return _of_json({name: np.concatenate(parts) for name, parts in columns.items()}, told, attachments)


def _mcap(path: Path) -> Content:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        reader = make_reader(file)
        summary, about = reader.get_summary(), {one.name: one.metadata for one in reader.iter_metadata()}
        attachments = {one.name: one.data for one in reader.iter_attachments()}
    assert summary is not None and summary.statistics is not None
    shown = {"/tf", "/maglev/shapes", "/maglev/arrows", "/log"}
    assert {channel.topic for channel in summary.channels.values()} >= shown
    columns, events, setups = dict[str, list[Any]](), list[str](), list[Any]()
    for topic, message in messages_in(path.read_bytes()):
        if topic == "/maglev/segment":
            run = {name: part for name, part in message.items() if name not in ("segment", "setup")}
            setups.append({**message["setup"], "run": run})
        elif topic == "/maglev/event":
            events.append(f"{message['kind']}: {message['text']}")
        else:
            for name, value in message.items():
                parts = (
                    {f"{name}.{axis}": part for axis, part in value.items()}
                    if isinstance(value, dict)
                    else {name: value}
                )
                for column, part in parts.items():
                    columns.setdefault(column, []).append(np.nan if part is None else part)
    told = dict(about["maglev_mj"])
    units = json.loads(told.pop("units"))
    return Content(
        {name: np.array(column) for name, column in columns.items()}, units, events, setups, told, attachments, None
    )


READERS: Mapping[str, Callable[[Path], Content]] = {"csv": _csv, "parquet": _parquet, "npz": _npz, "mcap": _mcap}
"""Plain readers of other programs; a sound holds one force alone, and is heard in `test_sound`."""


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_has_a_plain_reader_and_is_named_where_recordings_are_converted(kind: str) -> None:
    assert kind in READERS or kind == "wav", f"give {kind} a reader in READERS of {__name__}"
    for page in ("howto/record.md", "reference/recording.md"):
        (line,) = re.findall(r"convert run\.maglev run\..*# or .*", (DOCS / page).read_text(encoding="utf-8"))
        assert re.search(rf"\.{kind}\b", line), f"name .{kind} in docs/{page}: {line}"


@pytest.fixture(params=["scene", "stick-slip", "press, cut"])
def whole(request: pytest.FixtureRequest, tmp_path: Path) -> Recording:
    """Return a recording with an attachment of its own: several segments and an event, friction, a missing end."""
    kind, _, cut = request.param.partition(", ")
    recording = load(made(kind)[: -700 if cut else None], tmp_path)
    assert recording.damage.startswith("incomplete (not closed): readable up to 0." if cut else "") and bool(
        recording.damage
    ) == bool(cut)
    return replace(recording, attachments={**recording.attachments, "own.py": b"# mine\xff"})


@pytest.mark.parametrize("kind", READERS)
def test_what_is_recorded_is_found_in_an_export_by_name_with_its_units(
    kind: str, whole: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "run.maglev"
    whole.save(path)
    status, output, errors = run_here("convert", str(path), str(tmp_path / f"run.{kind}"))
    assert (status, errors) == (0, "") and f"  wrote {tmp_path / f'run.{kind}'}: {whole.ticks} samples\n" in output
    assert whole.damage in output
    samples, found = load_samples(path), READERS[kind](tmp_path / f"run.{kind}")
    wanted = {name: column for name, column in samples.columns().items() if name != "arrival"}  # it is not known
    assert {*found.columns} == {*wanted}
    for name, column in wanted.items():
        exact = 0.0 if kind != "csv" else 1e-15
        np.testing.assert_allclose(found.columns[name], column, rtol=exact, atol=0.0, err_msg=name)
    for units in (found.units, samples.to_pandas().attrs["units"]):
        assert {name: unit for name, unit in units.items() if name in wanted} == {
            name: unit for name, unit in samples.units.items() if name in wanted
        }
    assert [found.units[f"{name}.{axis}"] for name in ("position", "hand") for axis in ("z", "rx")] == [
        "m",
        "rad",
        "N",
        "N m",
    ]
    assert (found.events, found.about) == (list(whole.events), whole.about)
    assert found.setups == json.loads(json.dumps([segment.setup for segment in whole.segments]))
    assert found.attachments == whole.attachments and found.damage in (None, whole.damage)


def test_a_recording_that_is_saved_holds_the_same(whole: Recording, tmp_path: Path) -> None:
    whole.save(tmp_path / "run.maglev")
    again = Recording.load(tmp_path / "run.maglev")
    assert same(whole, again) and again.about == whole.about and again.damage == whole.damage
    assert (again.events, again.event_samples, again.attachments) == (
        whole.events,
        whole.event_samples,
        whole.attachments,
    )
    assert [(one.gaps, one.began, repr(one.sticks)) for one in again.segments] == [
        (one.gaps, one.began, repr(one.sticks)) for one in whole.segments
    ]
    with pytest.raises(ParameterError, match=r"path must end in \.maglev [(]got 'run\.npz'"):
        whole.save(tmp_path / "run.npz")


def same(one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same, to the last bit."""
    return len(one.segments) == len(other.segments) and all(
        a.setup == b.setup and all(b.arrays[name].tobytes() == a.arrays[name].tobytes() for name in ROW.names or ())
        for a, b in zip(one.segments, other.segments, strict=True)
    )


def test_a_file_holds_what_memory_does_and_is_read_without_the_package_in_three_lines(tmp_path: Path) -> None:
    (tmp_path / "run.maglev").write_bytes(made("stick-slip"))
    with (tmp_path / "run.maglev").open("rb") as file:
        header = json.loads(file.readline())
    records = np.fromfile(tmp_path / "run.maglev", np.dtype(header["dtype"]), offset=header["offset"])
    written = Recording.load(tmp_path / "run.maglev")
    assert same(written, record_run(Pull(duration=0.06), plant="exact"))
    (segment,) = written.segments
    for name in ROW.names or ():
        assert records[records["kind"] == 0][name].tobytes() == segment.arrays[name].tobytes()
    assert segment.sticks and any(one.gaps for one in load(made("scene"), tmp_path).segments)


def test_fields_are_loaded_as_arrays_and_as_a_data_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.maglev"
    path.write_bytes(made("drop"))
    samples, (segment,) = load_samples(path), Recording.load(path).segments
    for name in (*(ROW.names or ()), *(field.name for field in TOTALS)):
        np.testing.assert_array_equal(samples.arrays[name], segment.arrays[name])
    assert samples.position.shape == (len(samples), 6) and not samples.recording.damage
    some = load_samples(path, fields=("time", "hand"))
    assert list(some.arrays) == ["time", "hand"] and (some.time == samples.time).all()
    with pytest.raises(AttributeError, match="samples have no 'position'"):
        _ = some.position
    frame: Any = samples.to_pandas()
    assert frame["tick"].dtype == np.int64
    with pytest.raises(ParameterError, match=r"fields must be among tick, time, position, .* .got 'positions'"):
        load_samples(path, fields=["positions"])
    monkeypatch.setattr("maglev_mj.errors.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"-m pip install 'pandas>="):
        samples.to_pandas()
    with pytest.raises(MissingPackageError, match=r"MCAP needs foxglove-sdk and protobuf"):
        export(samples.recording, "mcap", tmp_path / "run.mcap")


def test_a_format_is_added_by_one_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, row in FORMATS.items():
        assert isfunction(loaded(row.writer)) and row.text and name.isalnum()
    monkeypatch.setitem(cast(dict[str, Format], FORMATS), "txt", Format(f"{__name__}:as_text", "ticks"))
    recording = load(made("drop"), tmp_path)
    export(recording, "txt", tmp_path / "run.txt")
    assert int((tmp_path / "run.txt").read_text()) == recording.ticks
    with pytest.raises(ParameterError, match=r"record must end in \.maglev \(got \.txt.*convert run.maglev run.txt"):
        check_name(Path("run.txt"))
    with pytest.raises(ParameterError, match=f"to must be one of {', '.join(FORMATS)} "):
        export(recording, "tex", tmp_path / "run.tex")
    monkeypatch.undo()
    assert main(["convert", "run.maglev", "run.tex"]) == 2
    assert capsys.readouterr().err.endswith(f"format of out must be one of maglev, {', '.join(FORMATS)} (got 'tex')\n")


def as_text(recording: Recording, partial: Path, _path: Path) -> None:
    """Write the number of samples."""
    partial.write_text(str(recording.ticks))


@pytest.mark.parametrize("kind", FORMATS)
def test_an_export_that_cannot_be_is_one_line_and_an_older_file_stays(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, other = tmp_path / "run.maglev", tmp_path / f"run.{kind}"
    assert main(["drop", "--plant", "exact", "--record", str(other)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"record to {path}, then run `maglev-mj convert {path} {other}`")
    path.write_bytes(made("drop"))
    other.write_bytes(b"that of before")
    limit: Any = pytest.importorskip("resource")
    before = limit.getrlimit(limit.RLIMIT_FSIZE)
    for room in (100, 1_000):
        limit.setrlimit(limit.RLIMIT_FSIZE, (room, before[1]))
        try:
            status = main(["convert", str(path), str(other)])
        finally:
            limit.setrlimit(limit.RLIMIT_FSIZE, before)
        (line,) = capsys.readouterr().err.splitlines()
        assert status == 1 and "File too large" in line and other.read_bytes() == b"that of before"
    assert {one.name for one in tmp_path.iterdir()} == {path.name, other.name}
