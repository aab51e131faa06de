"""Invalid recordings: numbers, ends, sizes and texts."""

import json
import math
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import AXES, ZERO, Command, Sample
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import (
    InvalidRecordingError,
    MemoryFile,
    Recording,
    RecordingError,
    ReplayCheck,
    journal,
    load_samples,
)
from maglev_mj.recording.reading import Content
from maglev_mj.recording.verify import verify
from maglev_mj.session.replay import rebuild
from tests.processes import run_here
from tests.recorded import (
    COLUMNS,
    KINDS,
    Message,
    Part,
    Place,
    changed,
    journal_of,
    load,
    made,
    numbers_in,
    parts_in,
    some_of,
    with_value,
)

SIZE = journal.RECORD.itemsize
BAD: tuple[Any, ...] = (math.nan, math.inf, -math.inf, 1e308, -1e308, None, True, "1", [], {}, -1, 1.5, 10**400)
NONE: tuple[Any, ...] = (math.nan, math.inf, -math.inf, 10**400, "1", [], {})
Case = tuple[str, Callable[[], bytes]]
"""Changed position, and maker of the file."""


SOME_KINDS = pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind in ("stick-slip", "scene") else pytest.mark.study) for kind in KINDS]
)
"""A run of a scripted hand and friction, and a session with an event; the others are studies."""


def check(data: bytes, folder: Path) -> ReplayCheck:
    """Return the result of `replay --check`."""
    return verify(load(data, folder), rebuild)


def texts_in(parts: list[Part]) -> list[int]:
    """Return the positions of messages."""
    return [index for index, part in enumerate(parts) if isinstance(part, dict)]


def with_number(kind: str) -> Iterator[Case]:
    """Yield files with one changed number of a sample or of a message: a setup, an event, a stick position."""
    data = made(kind)
    parts = parts_in(data)
    last = len(parts) - len(texts_in(parts)) - 1
    for column in COLUMNS:
        for row in (0, last // 2, last):
            for value in (math.nan, math.inf, -math.inf, 1e308, -1e308, -1.0, 1.5):
                yield f"{column} {row} {value}", partial(with_value, data, row, column, value)
    for index in texts_in(parts):
        for place in numbers_in(parts[index]):
            for bad in BAD:
                yield f"{index} {place} {str(bad)[:9]}", partial(with_message, parts, index, place, bad)


def with_message(parts: list[Part], index: int, place: Place, value: Any) -> bytes:
    """Return a file with another value somewhere in a message."""
    return journal_of([*parts[:index], changed(parts[index], place, value), *parts[index + 1 :]])


def answers(path: Path, capsys: Any) -> list[int]:
    """Return each command's status on a file: 2 with one line, or a finite result."""
    found = []
    commands = (["replay", str(path), "--check"], ["analyse", str(path)])
    for command in (*commands, ["convert", str(path), str(path.with_suffix(".csv"))]):
        status = main(command)  # a warning is an error here
        said = capsys.readouterr()
        assert status in (0, 1, 2)
        if status == 2:
            assert len(said.err.splitlines()) == 1 and said.err.startswith(f"maglev-mj {command[0]}: ")
            assert list(path.parent.iterdir()) == [path]
        else:
            words = said.out.replace(",", " ").split()
            assert not said.err and not {"nan", "inf", "-inf"} & set(words)
        found.append(status)
    for written in path.parent.glob("*.csv*"):
        written.unlink()
    return found


@pytest.mark.parametrize(
    ("kind", "every"),
    [("scene", 1099), ("stick-slip", 389), *(pytest.param(kind, 1, marks=pytest.mark.study) for kind in KINDS)],
)
def test_a_number_that_is_none_is_refused_or_answered(kind: str, every: int, tmp_path: Path, capsys: Any) -> None:
    path, found = tmp_path / "run.maglev", list[list[int]]()
    for what, file in islice(with_number(kind), 0, None, every):
        path.write_bytes(file())
        try:
            found.append(answers(path, capsys))
        except BaseException as error:
            raise AssertionError(f"{what}: {error!r}") from error
    assert found.count([2, 2, 2]) > (0.5 * len(found) if every == 1 else 0) and len(found) > 4


@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.study)])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_finite_number_is_no_number_of_a_file(kind: str, every: int, tmp_path: Path) -> None:
    # In turn for each n-th number of the messages: of each segment, of each event, of a stick position.
    parts, turn = parts_in(made(kind)), 0
    for index in texts_in(parts):
        for place in numbers_in(parts[index]):
            shown = place[:2] == ("begin", "parameters")  # not what it is made from: only numbers are looked at
            bad, turn = NONE[turn % (4 if shown else len(NONE))], turn + 1
            if turn % every or (place[-1] == "walls" and bad == []) or place[0] in ("end", "stick"):
                continue  # a scene may have no walls; a stick position may be null
            try:
                check(with_message(parts, index, place, bad), tmp_path)
            except InvalidRecordingError as refused:
                assert "\n" not in str(refused), (index, place, bad)
            else:
                raise AssertionError(f"{place} {bad} is taken")


Damage = Callable[[], bytes]


def told(*place: Any, value: Any) -> Damage:
    """Return a maker of a session's file with another value in the first message that has it."""

    def damaged() -> bytes:
        parts = parts_in(made("scene"))
        return with_message(parts, next(index for index in texts_in(parts) if place[0] in parts[index]), place, value)

    return damaged


def sixth(column: str, value: float) -> Damage:
    """Return a maker of a drop's file with another number in its seventh sample."""
    return lambda: with_value(made("drop"), 6, column, value)


def entry(name: str, change: Callable[[Any], Any]) -> Damage:
    """Return a maker of a drop's file with another entry of its header."""

    def damaged() -> bytes:
        data = made("drop")
        entries = json.loads(data[: data.index(b"\n")])
        size = entries["offset"]
        line = json.dumps({**entries, name: change(entries[name])}).encode()
        return line.ljust(size - 1) + b"\n" + data[size:]

    return damaged


def of_parts(change: Callable[[list[Part]], list[Part]]) -> Damage:
    """Return a maker of a drop's file with other messages and samples."""
    return lambda: journal_of(change(parts_in(made("drop"))))


def late(parts: list[Part]) -> list[Part]:
    """Return parts whose samples from the sixth on are a million ticks later."""
    for part in [part for part in parts if not isinstance(part, dict)][5:]:
        part["tick"] += 1e6 + 1.0
    return parts


DAMAGED: list[tuple[Damage, str]] = [
    (lambda: b"a text", "not a journal"),
    (lambda: b"\x89MCAP0\r\n", "MCAP or .npz file, not a journal: maglev_mj 0.2"),
    (lambda: made("drop").replace(b'"format": ', b'"offset": ', 1), "'offset' must be given once (got 2 times)"),
    (lambda: made("drop")[:4000], "incomplete header"),
    (entry("version", lambda _: 9), "format and version must be maglev_mj journal 1 (got maglev_mj journal 9"),
    (entry("offset", lambda _: 0), "offset must be the header's length, 4096 bytes"),
    (entry("offset", lambda _: 8192), "offset must be the header's length, 4096 bytes"),
    (entry("dtype", lambda _: None), "dtype must be an object"),
    (
        entry("dtype", lambda old: {**old, "formats": ["O", *old["formats"][1:]]}),
        "dtype must have unique names, and",
    ),
    (entry("dtype", lambda old: {**old, "names": ["kind", *old["names"][:-1]]}), "dtype must have unique names, and"),
    (
        entry("dtype", lambda old: {name: part[: old["names"].index("applied_pulse")] for name, part in old.items()}),
        "dtype must have applied_pulse",
    ),
    (
        entry("dtype", lambda old: {**old, "formats": [*old["formats"][:4], "<f8", *old["formats"][5:]]}),
        "dtype must have position",
    ),
    (told("begin", "run", "period", value="1"), "period must be a finite number above 0 and at most 1000 (got '1'"),
    (told("begin", "run", "delay", value=math.nan), "numbers must be finite (got NaN"),
    (
        told("begin", "run", "inertia", "rx", value=None),
        "inertia.rx must be a finite number between 1e-12 and 1e12",
    ),
    (told("begin", "run", "hand_recorded", value=1), "hand_recorded must be true or false (got 1"),
    (told("begin", "kind", value=[]), "kind must be a string (got a list"),
    (told("begin", "plant", "mass", value=10**400), "setup plant.mass must be a finite number (got 1000"),
    (told("time", value=-1), "time must be between 0 and"),
    (told("missed", value=-1), "missed must be between 0 and"),
    (told("missed", value=1.5), "missed must be an integer (got 1.5)"),
    (told("event", value={}), "event must be a string (got an object"),
    (sixth("tick", 2**60), "tick must be integers of at least 0 (got 1.15292e+18"),
    (sixth("tick", 0), "tick must increase, not go from 5 to 0"),
    (sixth("time", math.nan), "time must be finite and at most 1e+09 (got nan in row 6"),
    (sixth("time", -1.0), "time must increase from sample to sample"),
    (sixth("position.z", 1e4), "position must be finite and at most 1000 (got 10000 in row 6"),
    (sixth("command.z", math.inf), "command must be finite and at most 1e+12 (got inf in row 6"),
    (sixth("applied.z", math.nan), "applied must be finite and at most 1e+12 (got nan in row 6"),
    (sixth("hand.rz", math.nan), "hand must be finite and at most 1e+12 (got nan in row 6"),
    (sixth("pulse_width", -0.003), "pulse_width must be at least 0 in all rows (got -0.003"),
    (
        of_parts(lambda parts: [part for part in parts if not (isinstance(part, dict) and "begin" in part)]),
        "sample before the first segment",
    ),
    (of_parts(late), "at most 1000000 samples may be missing (got 1000001"),
]
"""Files that are no whole recording, and why."""


def test_a_file_that_is_no_whole_recording_is_refused_by_every_reader_with_the_reason(tmp_path: Path) -> None:
    # With an error that is both of recordings and of parameters, so that whoever catches either finds it.
    path = tmp_path / "run.maglev"
    for damaged, words in DAMAGED:
        path.write_bytes(damaged())
        for read in (Recording.load, load_samples, Content):
            with pytest.raises(ParameterError) as refused:
                read(path)
            wanted = words if read is Content else f"{str(path)!r} is not a valid recording: {words}"
            assert wanted in str(refused.value) and "\n" not in str(refused.value), words
            assert isinstance(refused.value, RecordingError | ValueError) and (
                read is Content or isinstance(refused.value, RecordingError)
            )


def test_a_file_is_passed_only_as_a_whole_and_run_again_all_the_same(tmp_path: Path) -> None:
    path, data = tmp_path / "run.maglev", made("scene")
    for changed_data, status, words in (
        (data, 0, "equal: tick"),
        (data[:-5000], 1, "incomplete (not closed): readable up to 0."),
        (
            data[: -SIZE - 1],
            1,
            "incomplete (not closed): readable up to 0.",
        ),  # the last checksum is of a file that is closed
        (data + b"\x00", 1, "data after the end record"),
        (data + data, 1, "data after the end record"),
    ):
        path.write_bytes(changed_data)
        found, output, errors = run_here("replay", str(path), "--check")
        assert (found, errors) == (status, "") and words in output and "Replay of " in output


def bits(value: Any) -> Any:
    """Return the next value of the same type."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else float(np.nextafter(value, math.inf))


ALL_OF_THEM = pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.study)])
"""Every number of a field, or one of them."""


UNKNOWN = {"device": (), "scene": ("hand",)}
"""Values known to a recording alone."""


def test_a_newer_kind_of_record_and_a_further_value_are_skipped(tmp_path: Path) -> None:
    data = made("drop")
    line, offset = data[: data.index(b"\n") + 1], data.index(b"\n") + 1
    entries = json.loads(line)
    entries["dtype"]["names"].append("more")
    entries["dtype"]["formats"].append("<f8")
    records = [data[at : at + SIZE] + bytes(8) for at in range(offset, len(data), SIZE)]
    kinds = [int.from_bytes(record[:4], "little") for record in records]
    block = b"".join(one for one, kind in zip(records, kinds) if kind == 0)
    newer = (99).to_bytes(4, "little") + bytes(SIZE + 4)
    texts = [part for part in parts_in(data) if isinstance(part, dict)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(journal, "_PAYLOAD", SIZE)
        begun, ended = (journal.text_records(one) for one in (texts[-2], texts[-1]))
    whole = begun + newer + block + newer + ended
    head = json.dumps(entries).encode().ljust(offset - 1) + b"\n"
    new = head + whole + journal.Seal(head, SIZE + 8)(whole)
    (one,), (other,) = load(new, tmp_path).segments, load(data, tmp_path).segments
    assert all(values.tobytes() == other.arrays[name].tobytes() for name, values in one.arrays.items())


@ALL_OF_THEM
@SOME_KINDS
def test_a_bit_that_differs_in_the_metadata_is_found_and_named(kind: str, every: bool, tmp_path: Path) -> None:
    parts = parts_in(made(kind))
    whole, tried = check(made(kind), tmp_path), set()
    assert whole.same and not whole.damage
    begun = [index for index in texts_in(parts) if "begin" in parts[index]][-1]
    run = parts[begun]["begin"]["run"]
    places = [*numbers_in(run)]
    for place in places if every else some_of(places, lambda place: str(place[0]) + "normal" * ("normal" in place), 1):
        value = run
        for key in place:
            value = value[key]
        try:
            verdict = check(with_message(parts, begun, ("begin", "run", *place), bits(value)), tmp_path)
        except InvalidRecordingError:
            assert place[-1] == "normal"
            continue
        name = str(place[0])
        tried.add(name)
        if whole.fields[name].compared:
            assert verdict.fields[name].first is not None, place
            assert not verdict.same
    texts_and_no_walls = {"name", "axis"} | ({"faces"} if kind == "stick-slip" else set())
    assert tried >= {*run} - texts_and_no_walls
    given = {name for name, one in whole.fields.items() if not one.compared}
    assert given == set(UNKNOWN.get(kind, ()))


@ALL_OF_THEM
@SOME_KINDS
def test_a_bit_that_differs_in_any_value_of_a_sample_is_found_and_named(kind: str, every: bool, tmp_path: Path) -> None:
    random, data = np.random.default_rng(1), made(kind)
    parts = parts_in(data)
    samples = [part for part in parts if not isinstance(part, dict)]
    columns = [name for name in COLUMNS if name != "arrival"]
    for column in columns if every else some_of(columns, lambda name: name.partition(".")[0], len(kind)):
        row, (name, _, axis) = int(random.integers(len(samples))), column.partition(".")
        value = samples[row][name][0]
        value = value[AXES.index(axis)] if axis else value
        try:
            verdict = check(with_value(data, row, column, np.nextafter(value, math.inf)), tmp_path)
        except InvalidRecordingError:
            assert name == "tick"
            continue
        if name not in UNKNOWN.get(kind, ()):
            assert verdict.fields[name].first is not None, (row, column)


def test_ticks_that_are_not_so_are_found(tmp_path: Path) -> None:
    # Shifted as a whole, which by itself would do for a device.
    for kind in KINDS:
        parts = parts_in(made(kind))
        first = [index for index in texts_in(parts) if "begin" in parts[index]][-1]
        for part in parts[first:]:
            if not isinstance(part, dict):
                part["tick"] += 1.0
        verdict = check(journal_of(parts), tmp_path)
        assert verdict.fields["tick"].first is not None and not verdict.same


def test_samples_that_are_missing_at_the_end_are_noticed(tmp_path: Path) -> None:
    """In a file that is whole otherwise."""
    parts = parts_in(made("drop"))
    verdict = check(journal_of([*parts[:-4], parts[-1]]), tmp_path)
    assert not verdict.same
    assert [name for name, one in verdict.fields.items() if one.first is not None] == ["samples"]


def refusing(answer: float) -> type[Controller]:
    """Return a controller with a NaN in its eighth answer."""

    class Mad(Controller):
        def step(self, sample: Sample) -> Command:
            command = super().step(sample)
            return command if sample.tick < 7 else Command([answer, *ZERO[1:]])

    return Mad


def test_no_number_is_the_same_as_one() -> None:
    for recorded, answered, same in (
        (math.nan, math.nan, True),
        (math.nan, math.inf, True),  # JSON has no word for either
        (math.inf, math.nan, False),
        (math.inf, -math.inf, False),
        (math.nan, 1.0, False),
        (1.0, math.nan, False),
        (0.0, -0.0, False),
        (1.0, 1.0, True),
    ):
        file, plant = MemoryFile(), ExactPlant(Timing())
        controller = refusing(recorded)([], period=0.005)
        loop = ControlLoop(plant, controller, record=file.begin(plant, controller, {"kind": "test"}))
        with nullcontext() if math.isfinite(recorded) else pytest.raises(PlantError):
            loop.cycle(8)

        def again(_: Any, hand: Any, answer: float = answered) -> Any:
            return ExactPlant(Timing(), hand_force=hand), refusing(answer)([], period=0.005)

        verdict = verify(file.recording, again)
        assert (verdict.fields["command"].first is None) == same, (recorded, answered)


def test_a_command_that_is_no_number_is_the_last_and_applied_as_zero(tmp_path: Path) -> None:
    for row, applied, good in ((-1, 0.0, True), (-1, 1.0, False), (-2, 0.0, False)):
        parts = parts_in(made("drop"))
        sample = [part for part in parts if not isinstance(part, dict)][row]
        sample["command"][0, 2] = math.inf
        for name in ("applied", "applied_pulse", "applied_pulse_width"):
            sample[name] = 0.0
        sample["applied"][0, 0] = applied
        if good:
            assert not check(journal_of(parts), tmp_path).same
        else:
            with pytest.raises(InvalidRecordingError):
                load(journal_of(parts), tmp_path)


def test_a_file_of_any_header_takes_no_more_memory_than_its_size(tmp_path: Path) -> None:
    # A header that says little and one that has no end; a message that says it is longer than the file.
    data = made("drop")
    offset = data.index(b"\n") + 1
    endless = b'{"offset": 8, "x": "' + bytes(30 << 20)
    at = next(at for at in range(offset, len(data), SIZE) if data[at] == 1)
    long = bytearray(data)
    long[at + 4 : at + 8] = (0xFFFFFFFF).to_bytes(4, "little")
    for one in (endless, bytes(long)):
        tracemalloc.start()
        try:
            with pytest.raises(RecordingError):
                load(one, tmp_path).require_samples("run.maglev")
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 5e6


ESCAPES = "\x1b[2J\x1b]0;title\x07\x9b31m\r\n\b\u202e\ud800 81 of 81"


def test_what_steers_a_terminal_is_escaped(tmp_path: Path, capsys: Any) -> None:
    # In texts of events, in names of runs, settings and kinds, whatever command shows them.
    parts = parts_in(made("scene"))
    (row,) = (index for index in texts_in(parts) if "event" in parts[index])
    event: Message = {"event": ESCAPES, "text": ESCAPES, "missed": 3}
    (first, *_) = (index for index in texts_in(parts) if "begin" in parts[index])
    setup = parts[first]["begin"]
    wrong = [
        {**setup, "controller": {**setup["controller"], ESCAPES: 1.0}},
        {**setup, "controller": {**setup["controller"], "velocity": {"class": ESCAPES}}},
        {**setup, "controller": {**setup["controller"], "laws": [{"class": ESCAPES}]}},
        {**setup, "plant": {**setup["plant"], "class": ESCAPES}},
    ]
    wrong += [{**setup, "run": {**setup["run"], "name": ESCAPES}}]
    files = [journal_of([*parts[:row], event, *parts[row + 1 :]])]
    files += [with_message(parts, first, ("begin",), one) for one in wrong]
    whole = made("scene")
    entries = json.loads(whole[: whole.index(b"\n")])
    files += [json.dumps({**entries, "format": ESCAPES}).encode().ljust(entries["offset"] - 1) + b"\n"]
    path = tmp_path / "run.maglev"
    for data in files:
        path.write_bytes(data)
        text = ""
        for command in (["replay", str(path), "--check"], ["analyse", str(path)]):
            main(command)
            text += "".join(capsys.readouterr())
        assert all(one.isprintable() for one in text.replace("\n", "")), ascii(text)
        assert "\\x1b[2J" in text and "\n 81 of 81" not in text


def test_a_part_of_a_segment_has_no_totals_of_the_whole(tmp_path: Path) -> None:
    (segment,) = load(made("drop"), tmp_path).segments
    part = segment[2:6]
    assert "taken" not in part.arrays and part.setup is segment.setup and len(part) == 4
    assert "taken" in segment.replace(hand=segment.hand).arrays


def in_blocks(samples: list[Message], folder: Path, monkeypatch: pytest.MonkeyPatch) -> Recording:
    """Return a recording of changed samples of a drop, read in blocks of four."""
    monkeypatch.setattr("maglev_mj.recording.reading._BLOCK", 4)
    parts = parts_in(made("drop"))
    sample = next(part for part in parts if not isinstance(part, dict))
    rows = []
    for change in samples:
        row = sample.copy()
        for name, value in {"time": 0.005 * change["tick"], **change}.items():
            row[name] = value
        rows.append(row)
    data = journal_of([*(part for part in parts[:-1] if isinstance(part, dict)), *rows, parts[-1]])
    return load(data, folder)


def test_a_field_that_is_another_one_for_some_blocks_is_itself_in_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = [(2.0, 2.0), (3.0, 3.0), (5.0, 4.0), (6.0, 6.0)]
    samples: list[Message] = [
        {"tick": tick, "command": command, "applied": applied}
        for tick, (command, applied) in enumerate(one for one in values for _ in range(4))
    ]
    (segment,) = in_blocks(samples, tmp_path, monkeypatch).segments
    assert segment.command[:, 1].tolist() == [2.0] * 4 + [3.0] * 4 + [5.0] * 4 + [6.0] * 4
    assert segment.applied[:, 1].tolist() == [2.0] * 4 + [3.0] * 4 + [4.0] * 4 + [6.0] * 4
    assert segment.tick.tolist() == [*range(16)] and (segment.position == segment.position[0]).all()


def test_ticks_and_times_go_up_from_block_to_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for first, begins, says in (
        (4, 0.02, ""),
        (3, 0.02, "tick must increase, not go from 3 to 3"),
        (1, 0.02, "tick must increase, not go from 3 to 1"),
        (4, 0.015, "time must increase from sample to sample"),
    ):
        samples: list[Message] = [{"tick": tick} for tick in range(4)]
        samples += [{"tick": first + count, "time": begins + 0.005 * count} for count in range(4)]
        refused = pytest.raises(InvalidRecordingError, match=rf"is not a valid recording: {says}$")
        with refused if says else nullcontext():
            assert in_blocks(samples, tmp_path, monkeypatch).ticks == 8
