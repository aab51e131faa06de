"""Invalid recordings: numbers, ends, sizes and texts."""

import io
import json
import math
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.control.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, ZERO, Command, Sample
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import InvalidRecordingError, Recording, RecordingError, Verdict
from maglev_mj.recording.sample import check_rows
from maglev_mj.recording.verify import verify
from maglev_mj.session.replay import rebuild
from maglev_mj.terminal import printable
from tests.recorded import (
    FIELD,
    KINDS,
    Message,
    Place,
    arrays_in,
    changed,
    load,
    made,
    mcap_of,
    messages_in,
    npz_of,
    numbers_in,
    some_of,
    with_messages,
    with_value,
)

BAD: tuple[Any, ...] = (math.nan, math.inf, -math.inf, 1e308, -1e308, None, True, "1", [], {}, -1, 1.5, 10**400)
NONE: tuple[Any, ...] = (math.nan, math.inf, -math.inf, 10**400, "1", [], {})
SAMPLE = "/maglev/sample"
Case = tuple[str, Callable[[], bytes]]
"""Changed position, and maker of the file."""


def check(data: bytes, folder: Path, suffix: str) -> Verdict:
    """Return the result of `replay --check`."""
    return verify(load(data, folder, suffix), rebuild)


def with_number(kind: str, suffix: str) -> Iterator[Case]:
    """Yield files with one changed number of a setup, a sample or an event."""
    if suffix == ".mcap":
        yield from with_number_in_a_row(kind)
        messages = messages_in(made(kind, suffix))
        for row in (row for row, (topic, _) in enumerate(messages) if topic != SAMPLE):
            for place in numbers_in(messages[row][1]):
                for bad in BAD:
                    yield f"{row} {place} {str(bad)[:9]}", partial(with_message, messages, row, place, bad)
        return
    header, arrays = arrays_in(made(kind, suffix))
    for place in numbers_in(header["setups"]):
        for bad in BAD:
            yield f"{place} {str(bad)[:9]}", partial(with_setup, header, arrays, place, bad)
    for name, values in arrays.items():
        for column in np.ndindex(values.shape[1:]):
            for row in (0, len(values) // 2, len(values) - 1):
                for bad in (math.nan, math.inf, -math.inf, 1e308, -1e308, -1.0, 1.5):
                    yield (
                        f"{name} {row} {column} {bad}",
                        partial(with_element, header, arrays, name, (row, *column), bad),
                    )


def with_message(messages: list[tuple[str, Message]], row: int, place: Place, value: Any) -> bytes:
    """Return a file with another value somewhere in a message."""
    topic, message = messages[row]
    return mcap_of([*messages[:row], (topic, changed(message, place, value)), *messages[row + 1 :]])


def with_setup(header: Message, arrays: Mapping[str, Any], place: Place, value: Any) -> bytes:
    """Return an array file with another value in its setups."""
    return npz_of({**header, "setups": changed(header["setups"], place, value)}, arrays)


def with_element(header: Message, arrays: Mapping[str, Any], name: str, place: tuple[int, ...], value: float) -> bytes:
    """Return an array file with another number in one array."""
    other = arrays[name].copy()
    other[place] = value
    return npz_of(header, {**arrays, name: other})


def with_number_in_a_row(kind: str) -> Iterator[Case]:
    """Yield files with one changed number in a sample."""
    data = made(kind, ".mcap")
    last = sum(topic == SAMPLE for topic, _ in messages_in(data)) - 1
    for name, field in FIELD.items():
        bad: tuple[Any, ...] = (
            (math.nan, math.inf, -math.inf, 1e308, -1e308, -1.0) if field.unit else (2**53, 2**64 - 1)
        )
        for column, _ in field.units:
            for row in (0, last // 2, last):
                for value in bad:
                    yield f"{name} {row} {value}", partial(with_value, data, row, column, value)


def answers(path: Path, capsys: Any) -> list[int]:
    """Return each command's status on a file: 2 with one line, or a finite result."""
    found = []
    commands = (["replay", str(path), "--check"], ["analyse", str(path)])
    for command in (*commands, ["export", str(path), "--to", "csv", "--out", str(path.with_suffix(".csv"))]):
        status = main(command)  # a warning is an error here
        said = capsys.readouterr()
        assert status in (0, 1, 2)
        if status == 2:
            assert len(said.err.splitlines()) == 1 and said.err.startswith(f"maglev-mj {command[0]}: ")
        else:
            words = said.out.replace(",", " ").split()
            assert not said.err and not {"nan", "inf", "-inf"} & set(words)
        found.append(status)
    return found


EVERY = {"scene": 1099, "drop": 389, "press": 389, "stick-slip": 389}
"""Which files of the sweep are tried in the gate: those of a scene are most and dearest."""


def sweep(kind: str, suffix: str, folder: Path, capsys: Any, every: int = 1) -> list[list[int]]:
    """Return the commands' results on every n-th file."""
    found = []
    for what, file in islice(with_number(kind, suffix), 0, None, every):
        path = folder / f"run{suffix}"
        path.write_bytes(file())
        try:
            found.append(answers(path, capsys))
        except BaseException as error:
            raise AssertionError(f"{what}: {error!r}") from error
    return found


@pytest.mark.parametrize("suffix", [".mcap", ".npz"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_number_that_is_none_is_refused_or_answered(kind: str, suffix: str, tmp_path: Path, capsys: Any) -> None:
    """Some of the sweep below, spread over all of it."""
    found = sweep(kind, suffix, tmp_path, capsys, every=EVERY[kind])
    assert [2, 2, 2] in found and len(found) > 4


@pytest.mark.study
@pytest.mark.parametrize("suffix", [".mcap", ".npz"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_number_that_is_none_is_refused_or_answered(kind: str, suffix: str, tmp_path: Path, capsys: Any) -> None:
    found = sweep(kind, suffix, tmp_path, capsys)
    assert found.count([2, 2, 2]) > 0.5 * len(found)


@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.study)])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_finite_number_is_no_number_of_a_file(kind: str, every: int, tmp_path: Path) -> None:
    # In turn for each n-th number of the messages in JSON: of each stretch, and of each event.
    messages, turn = messages_in(made(kind, ".mcap")), 0
    for row, (topic, message) in enumerate(messages):
        if topic == SAMPLE:
            continue
        for place in numbers_in(message):
            shown = place[:2] == ("setup", "parameters")  # not what it is made from: only numbers are looked at
            bad, turn = NONE[turn % (4 if shown else len(NONE))], turn + 1
            if turn % every or (place[-1] == "walls" and bad == []):
                continue  # a scene may have no walls
            try:
                check(with_message(messages, row, place, bad), tmp_path, ".mcap")
            except InvalidRecordingError as refused:
                assert "\n" not in str(refused), (row, place, bad)
            else:
                raise AssertionError(f"{topic} {place} {bad} is taken")


@pytest.mark.parametrize(
    ("row", "place", "bad", "words"),
    [
        (0, ("stretch",), -1, "stretch must be 0, not -1"),
        (0, ("stretch",), False, "stretch must be 0, not False"),
        (0, ("period",), "1", "period must be a finite number above 0 and at most 1000, not '1'"),
        (0, ("delay",), math.nan, "numbers must be finite, not NaN"),
        (0, ("inertia", "rx"), None, "inertia.rx must be a finite number at least 1e-12 and at most 1e+12, not None"),
        (0, ("hand_recorded",), 1, "hand_recorded must be true or false, not 1"),
        (0, ("setup", "kind"), [], "kind must be a text, not a list"),
        (0, ("setup", "plant", "mass"), 10**400, "setup plant.mass must be a finite number, not 1000"),
        (-1, ("tick",), 0, "tick must be 19, not 0"),
        (-1, ("missed",), -1, "missed must be a finite number at least 0"),
        (-1, ("missed",), 1.5, "missed must be a whole number, not 1.5"),
        (-1, ("kind",), {}, "kind must be a text, not an object"),
    ],
)
def test_a_refusal_names_the_number_and_what_is_allowed(
    row: int, place: Place, bad: Any, words: str, tmp_path: Path, capsys: Any
) -> None:
    messages, path = messages_in(made("scene", ".mcap")), tmp_path / "run.mcap"
    told = [index for index, (topic, _) in enumerate(messages) if topic != SAMPLE][row]
    path.write_bytes(with_message(messages, told, place, bad))
    assert main(["replay", str(path), "--check"]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and f"{str(path)!r} is not a whole recording: {words}" in said


def bits(value: Any) -> Any:
    """Return the next value of the same type."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else float(np.nextafter(value, math.inf))


def field(place: Place) -> str:
    """Return the field of a number in a message."""
    return str(place[0])


ALL_OF_THEM = pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.study)])
"""Every number of a field, or one of them."""


UNKNOWN = {"device": (), "scene": ("hand",)}
"""Values known to a recording alone."""


@pytest.mark.parametrize(
    ("column", "bad", "words"),
    [
        ("tick", 2**60, "tick must be whole numbers of at least 0, not 1.15292e+18"),
        ("tick", 0, "tick must go up, not from 5 to 0"),
        ("stretch", 3, "stretch must be 0, not 3"),
        ("time", math.nan, "time must be finite and at most 1e+09, not nan in row 6"),
        ("time", 1e308, "time must be finite and at most 1e+09, not 1e+308 in row 6"),
        ("time", -1.0, "time must go up from sample to sample"),
        ("position.z", 1e4, "position must be finite and at most 1000, not 10000 in row 6"),
        ("command.z", math.inf, "command must be finite and at most 1e+12, not inf in row 6"),
        ("applied.z", math.nan, "applied must be finite and at most 1e+12, not nan in row 6"),
        ("hand.rz", math.nan, "hand must be finite and at most 1e+12, not nan in row 6"),
        ("pulse_width", -0.003, "pulse_width must be at least 0 everywhere, not -0.003"),
        ("taken", math.nan, "taken must be finite and at most 1e+15, not nan in row 6"),
        ("missed", 2**53, "missed must be whole numbers of at least 0, not 9.0072e+15"),
    ],
)
def test_a_refusal_names_the_number_of_a_sample(
    column: str, bad: float, words: str, tmp_path: Path, capsys: Any
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(with_value(made("drop", ".mcap"), 6, column, bad))
    assert main(["replay", str(path), "--check"]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and f"{str(path)!r} is not a whole recording: {words}" in said


def cut_short(topic: str, place: int, message: bytes) -> bytes | None:
    return message[:-9] if topic == SAMPLE and place == 5 else message


def longer(topic: str, place: int, message: bytes) -> bytes | None:
    return message + b"\x79" + bytes(8) if topic == SAMPLE and place == 5 else message


def other_fields(topic: str, place: int, message: bytes) -> bytes | None:
    return message[9:18] + message[:9] + message[18:] if topic == SAMPLE and place == 5 else message


def no_fields(topic: str, place: int, message: bytes) -> bytes | None:
    return b"" if topic == SAMPLE else message


def no_stretch(topic: str, place: int, message: bytes) -> bytes | None:
    return None if topic == "/maglev/stretch" else message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (cut_short, "the samples of a file must all have the same fields"),
        (longer, "the samples of a file must all have the same fields"),
        (other_fields, "the samples of a file must all have the same fields"),
        (no_fields, "a sample must have stretch, tick, time, position"),
        (no_stretch, "a sample must be in a stretch"),
    ],
)
def test_samples_that_are_laid_out_otherwise_are_refused(change: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidRecordingError, match=words):
        load(with_messages(made("drop", ".mcap"), change), tmp_path, ".mcap")


@pytest.mark.parametrize("beside", [True, False], ids=["with frames", "samples in a row"])
@pytest.mark.parametrize(("topic", "place"), [(SAMPLE, 10), ("/tf", 3), ("/maglev/arrows", 3), (SAMPLE, 16)])
def test_a_message_that_is_missing_is_noticed_on_any_topic(
    topic: str, place: int, beside: bool, tmp_path: Path
) -> None:
    """By its number, or at the end by their count."""
    from mcap.writer import Writer

    add, skipped = Writer.add_message, []

    def adding(self: Any, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        if self._Writer__channels[channel_id].topic == topic and sequence == place + 1:
            skipped.append(sequence)
            self._Writer__statistics.message_count += 1
            counts = self._Writer__statistics.channel_message_counts
            counts[channel_id] = counts.get(channel_id, 0) + 1
        else:
            add(self, channel_id, log_time, data, publish_time, sequence)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Writer, "add_message", adding)
        kept = {SAMPLE, "/maglev/stretch", topic}
        data = with_messages(made("drop", ".mcap"), lambda on, _, message: message if beside or on in kept else None)
    recording = load(data, tmp_path, ".mcap")
    assert skipped and "messages are missing" in recording.damage
    if place < 16:  # by its number alone: the count at the end is not there
        (summary,) = struct.unpack_from("<Q", data, len(data) - 28)
        assert "messages are missing" in load(data[:summary], tmp_path, ".mcap").damage
    assert recording.ticks == (place if topic == SAMPLE else recording.ticks)


@ALL_OF_THEM
@pytest.mark.parametrize("kind", KINDS)
def test_a_bit_that_differs_in_any_field_is_found_and_named(kind: str, every: bool, tmp_path: Path) -> None:
    # In each number of a message about the run, and of its first and last sample.
    messages = messages_in(made(kind, ".mcap"))
    samples = [row for row, (topic, _) in enumerate(messages) if topic == SAMPLE]
    starts = [row for row, (topic, _) in enumerate(messages) if topic == "/maglev/stretch"]
    whole, tried = check(made(kind, ".mcap"), tmp_path, ".mcap"), set()
    assert whole.same and not whole.damage
    for row, turn in ((starts[-1], slice(None)), (samples[0], slice(0, None, 2)), (samples[-1], slice(1, None, 2))):
        message = messages[row][1]
        places = [*numbers_in({name: part for name, part in message.items() if name != "setup"})]
        some = some_of(places, lambda place: field(place) + "normal" * ("normal" in place), row)
        for place in places if every else some[turn]:  # a field in the first sample, the next in the last
            value = message
            for key in place:
                value = value[key]
            try:
                verdict = check(with_message(messages, row, place, bits(value)), tmp_path, ".mcap")
            except InvalidRecordingError:
                assert field(place) in ("stretch", "tick", "missed") or place[-1] == "normal"
                continue
            name = field(place)
            tried.add(name)
            if whole.fields[name].compared:
                assert verdict.fields[name].first is not None, (row, place)
                assert not verdict.same
    named = {name for _, message in messages for name in message} - {"setup", "versions", "stretch", "kind", "text"}
    texts_and_no_walls = {"name", "axis"} | ({"faces"} if kind == "stick-slip" else set())
    assert tried >= named - {"tick", "missed"} - texts_and_no_walls
    given = {name for name, one in whole.fields.items() if not one.compared}
    assert given == set(UNKNOWN.get(kind, ()))


@ALL_OF_THEM
@pytest.mark.parametrize("kind", KINDS)
def test_a_bit_that_differs_in_any_array_is_found_and_named(kind: str, every: bool, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    header, arrays = arrays_in(made(kind, ".npz"))
    names = {
        "command": ("command", "pulse", "pulse_width"),
        "applied": ("applied", "applied_pulse", "applied_pulse_width"),
    }
    for key, values in arrays.items():
        name = key.partition("/")[2]

        def part(column: tuple[int, ...], name: str = name) -> str:
            return names[name][column[0] // 6] if name in names else name

        columns = [*np.ndindex(values.shape[1:])]
        for column in columns if every else some_of(columns, part, len(name)):
            row = int(random.integers(len(values)))
            value = np.nextafter(values[(row, *column)], math.inf)
            try:
                verdict = check(with_element(header, arrays, key, (row, *column), value), tmp_path, ".npz")
            except InvalidRecordingError:
                assert name == "tick"
                continue
            if part(column) not in UNKNOWN.get(kind, ()):
                assert verdict.fields[part(column)].first is not None, (key, row, column)


def test_ticks_and_missed_samples_that_are_not_so_are_found(tmp_path: Path) -> None:
    # Shifted as a whole, which by itself would do for a device.
    for kind in KINDS:
        messages = messages_in(made(kind, ".mcap"))
        for name in ("tick", "missed"):
            last = max(message["stretch"] for _, message in messages)
            new = [
                (topic, {**message, name: message[name] + 1})
                if message["stretch"] == last and (topic == SAMPLE or (name == "tick" and "kind" in message))
                else (topic, message)
                for topic, message in messages
            ]
            verdict = check(mcap_of(new), tmp_path, ".mcap")
            assert verdict.fields[name].first is not None and not verdict.same


def test_more_samples_cannot_be_missing_than_anybody_can_wait_for(tmp_path: Path) -> None:
    header, arrays = arrays_in(made("drop", ".npz"))
    arrays["0/tick"][5:] += 1e6 + 1.0
    with pytest.raises(InvalidRecordingError, match="at most 1000000 samples may be missing, not 1000001"):
        load(npz_of(header, arrays), tmp_path, ".npz")


def test_samples_that_are_missing_at_the_end_are_noticed(tmp_path: Path) -> None:
    """In a file that is whole otherwise."""
    header, arrays = arrays_in(made("drop", ".npz"))
    short = npz_of(header, {name: values[:-3] for name, values in arrays.items()})
    verdict = check(short, tmp_path, ".npz")
    assert not verdict.same
    assert [name for name, one in verdict.fields.items() if one.first is not None] == ["samples"]


def refusing(answer: float) -> type[Controller]:
    """Return a controller with a NaN in its eighth answer."""

    class Mad(Controller):
        def step(self, sample: Sample) -> Command:
            command = super().step(sample)
            return command if sample.tick < 7 else Command([answer, *ZERO[1:]])

    return Mad


@pytest.mark.parametrize(
    ("recorded", "answered", "same"),
    [
        (math.nan, math.nan, True),
        (math.nan, math.inf, True),  # JSON has no word for either
        (math.inf, math.inf, True),
        (math.inf, math.nan, False),
        (math.inf, -math.inf, False),
        (math.nan, 1.0, False),
        (math.inf, 1.0, False),
        (1.0, math.nan, False),
        (0.0, -0.0, False),
        (1.0, 1.0, True),
    ],
)
def test_no_number_is_the_same_as_one(recorded: float, answered: float, same: bool) -> None:
    from maglev_mj.control.loop import ControlLoop
    from maglev_mj.recording import ArrayFile

    file, plant = ArrayFile(), ExactPlant(Timing())
    controller = refusing(recorded)([], period=0.005)
    loop = ControlLoop(plant, controller, record=file.begin(plant, controller, {"kind": "test"}))
    try:
        loop.cycle(8)
    except RecordingError:
        raise
    except Exception:
        assert not math.isfinite(recorded)
    verdict = verify(
        file.recording,
        lambda setup, hand: (ExactPlant(Timing(), hand_force=hand), refusing(answered)([], period=0.005)),
    )
    assert (verdict.fields["command"].first is None) == same


def test_a_command_that_is_no_number_is_the_last_and_applied_as_zero(tmp_path: Path) -> None:
    header, arrays = arrays_in(made("drop", ".npz"))
    for row, applied, good in ((-1, 0.0, True), (-1, 1.0, False), (-2, 0.0, False)):
        command, given = arrays["0/command"].copy(), arrays["0/applied"].copy()
        command[row, 2], given[row] = math.inf, 0.0
        given[row, 0] = applied
        data = npz_of(header, {**arrays, "0/command": command, "0/applied": given})
        if good:
            assert not check(data, tmp_path, ".npz").same
        else:
            with pytest.raises(InvalidRecordingError):
                load(data, tmp_path, ".npz")


@pytest.mark.parametrize("step", [7919, pytest.param(997, marks=pytest.mark.study)])
def test_a_file_that_ends_anywhere_is_not_passed(step: int, tmp_path: Path, capsys: Any) -> None:
    # Only the whole one is; what is there is run again all the same.
    data, path = made("scene", ".mcap"), tmp_path / "run.mcap"
    statuses = {}
    for length in [*range(0, len(data), step), *range(len(data) - 12, len(data) + 1)]:
        path.write_bytes(data[:length])
        statuses[length] = main(["replay", str(path), "--check"])
        said = capsys.readouterr()
        if statuses[length] == 1:
            assert "its end is missing" in said.out and "samples, run again and compared" in said.out
        elif statuses[length] == 2:
            assert len(said.err.splitlines()) == 1
    assert {length for length, status in statuses.items() if status == 0} == {len(data)}
    assert set(statuses.values()) == {0, 1, 2}
    for more in (b"\x00", data):
        path.write_bytes(data + more)
        assert main(["replay", str(path), "--check"]) == 1
        assert "there is more behind its end" in capsys.readouterr().out


def test_missed_samples_of_an_event_are_counted(tmp_path: Path) -> None:
    messages = messages_in(made("scene", ".mcap"))
    (row,) = (row for row, (topic, _) in enumerate(messages) if topic == "/maglev/event")
    told = messages[row][1]
    assert (told["kind"], told["text"], told["missed"]) == ("missed", "3 ticks were given up: too slow", 3)
    assert max(message["missed"] for topic, message in messages if topic == SAMPLE) == 3
    assert check(mcap_of(messages), tmp_path, ".mcap").same
    verdict = check(with_message(messages, row, ("missed",), 2), tmp_path, ".mcap")
    assert verdict.fields["missed"].first is not None


PEAK = """
import json, sys
from pathlib import Path
from maglev_mj.cli import main
found = [main(["replay", path, "--check"]) for path in sys.argv[1:]]
(peak,) = (line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line)
print(json.dumps([found, int(peak) * 1024]))
"""

MIB = 1 << 20
LARGE = 1024 * MIB


def zeros(size: int) -> bytes:
    """Return so many zeros, packed."""
    import zstandard

    packer, block = zstandard.ZstdCompressor().compressobj(size=size), bytes(16 * MIB)
    packed = [packer.compress(block) for _ in range(size // len(block))]
    return b"".join((*packed, packer.flush()))


def chunks(*parts: tuple[bytes, int], packed: str = "zstd") -> bytes:
    """Return a file of chunks with declared sizes."""
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, Header, Metadata

    builder = RecordBuilder()
    Header("", "").write(builder)
    Metadata("maglev_mj", {"format": "2"}).write(builder)
    for data, size in parts:
        Chunk(packed, data, 0, 0, 0, size).write(builder)
    return b"".join((b"\x89MCAP0\r\n", builder.end()))


def array_file(shape: int, *, compressed: int) -> bytes:
    """Return a file with a long first array of zeros."""
    empty: dict[str, Any] = {"events": [], "damage": "", "attachments": [], "about": {}}
    header = {"format": "maglev_mj recording 1", "setups": [{"kind": "drop"}], "gaps": [[]], **empty}
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compressed, compresslevel=1) as archive:
        text = io.BytesIO()
        np.save(text, np.array(json.dumps(header)))
        archive.writestr("header.npy", text.getvalue())
        with archive.open("0/tick.npy", "w", force_zip64=True) as member:
            about = {"descr": "<f8", "fortran_order": False, "shape": (shape,)}
            np.lib.format.write_array_header_1_0(member, about)
            for _ in range(shape * 8 // (16 * MIB) if compressed else 0):
                member.write(bytes(16 * MIB))
    return file.getvalue()


def setups_file() -> bytes:
    """Return a file with setups small when packed, large unpacked."""
    six, ones = (
        dict.fromkeys(("x", "y", "z", "rx", "ry", "rz"), 0.0),
        dict.fromkeys(("x", "y", "z", "rx", "ry", "rz"), 1.0),
    )
    about = {"period": 0.005, "delay": 0.0, "carried": six, "inertia": ones, "load": six, "before": six}
    junk: list[Any] = [[] for _ in range(200_000)]
    return mcap_of([("/maglev/stretch", {"stretch": n, "setup": {"kind": "a", "x": junk}, **about}) for n in range(30)])


def large_files(slow: int) -> Mapping[str, tuple[str, Callable[[], bytes]]]:
    """Return makers of small files that unpack to a gigabyte, those dear to pack to `slow` bytes."""
    import zstandard
    from lz4.frame import compress  # type: ignore[import-untyped]

    record = struct.pack("<BQHIQQ", 5, 60 * MIB + 22, 1, 0, 0, 0) + bytes(60 * MIB)
    part = zeros(64 * MIB)
    inner = chunks(*[(part, 64 * MIB)] * 4)[8:]
    return {
        "a chunk of a gigabyte": (".mcap", lambda: chunks((zeros(LARGE), LARGE))),
        "a chunk that says it is small": (".mcap", lambda: chunks((zeros(LARGE), 1000))),
        "many chunks as large as may be": (".mcap", lambda: chunks(*[(part, 64 * MIB)] * 16)),
        "many large messages": (".mcap", lambda: chunks(*[(zstandard.compress(record), len(record))] * 16)),
        "lz4": (".mcap", lambda: chunks((compress(bytes(slow)), slow), packed="lz4")),
        "lz4 that says it is small": (".mcap", lambda: chunks((compress(bytes(slow)), 1000), packed="lz4")),
        "chunks in a chunk": (".mcap", lambda: chunks((zstandard.compress(inner), len(inner)))),
        "large setups": (".mcap", setups_file),
        "a large array": (".npz", lambda: array_file(slow // 8, compressed=zipfile.ZIP_DEFLATED)),
        "an array that is not there": (".npz", lambda: array_file(LARGE, compressed=zipfile.ZIP_STORED)),
    }


SOME = (
    "a chunk that says it is small",
    "many chunks as large as may be",
    "lz4 that says it is small",
    "chunks in a chunk",
)


@pytest.mark.parametrize("what", SOME)
def test_what_unpacks_to_a_gigabyte_is_refused_before_it_is_unpacked(what: str, tmp_path: Path) -> None:
    suffix, make = large_files(LARGE // 4)[what]
    data = make()
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError):
            load(data, tmp_path, suffix)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 150e6


@pytest.mark.machine
@pytest.mark.needs("linux")
@pytest.mark.parametrize("slow", [LARGE // 4, pytest.param(LARGE, marks=pytest.mark.study)], ids=["quarter", "whole"])
def test_what_unpacks_to_a_gigabyte_is_one_line_and_little_memory(slow: int, tmp_path: Path) -> None:
    # The first is the one that took 1.1 GB.
    files = large_files(slow)
    paths = [tmp_path / f"run{place}{suffix}" for place, (suffix, _) in enumerate(files.values())]
    for path, (_, make) in zip(paths, files.values(), strict=True):
        data = make()
        assert len(data) < (1.2e6 if slow < LARGE else 4.8e6)
        path.write_bytes(data)
    command = [sys.executable, "-c", PEAK, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    found, peak = json.loads(done.stdout)
    assert peak < 200e6
    assert len(done.stderr.splitlines()) == len(files)
    assert dict(zip(files, found, strict=True)) == dict.fromkeys(files, 2)


def test_a_recording_of_many_samples_is_within_what_may_be_unpacked(tmp_path: Path) -> None:
    """A flotor at rest packs best of all."""
    from maglev_mj.control.loop import drive
    from maglev_mj.recording import open_recording

    path = tmp_path / "run.mcap"
    file, plant = open_recording(path, wait=True), ExactPlant(Timing(), gravity=0.0)
    controller = Controller([], period=0.005)
    drive(plant, controller, 3000, record=file.begin(plant, controller, {"kind": "test"}))
    file.close()
    recording = Recording.load(path)
    assert recording.ticks == 3000 and not recording.damage
    header, arrays = arrays_in(made("drop", ".npz"))
    assert check(npz_of(header, arrays, compressed=True), tmp_path, ".npz").same


ESCAPES = "\x1b[2J\x1b]0;title\x07\x9b31m\r\n\b\u202e\ud800 81 of 81"


def test_what_steers_a_terminal_is_escaped(tmp_path: Path, capsys: Any) -> None:
    # In texts of events, in names of settings and kinds, whatever command shows them.
    messages = messages_in(made("scene", ".mcap"))
    (row,) = (row for row, (topic, _) in enumerate(messages) if topic == "/maglev/event")
    event: Message = {**messages[row][1], "kind": ESCAPES, "text": ESCAPES, "missed": 3}
    header, arrays = arrays_in(made("scene", ".npz"))
    setup = messages[0][1]["setup"]
    wrong = [
        {**setup, "controller": {**setup["controller"], ESCAPES: 1.0}},
        {**setup, "controller": {**setup["controller"], "velocity": {"class": ESCAPES}}},
        {**setup, "controller": {**setup["controller"], "laws": [{"class": ESCAPES}]}},
        {**setup, "plant": {**setup["plant"], "class": ESCAPES}},
    ]
    files = [(".mcap", mcap_of([*messages[:row], (messages[row][0], event), *messages[row + 1 :]]))]
    files += [(".npz", npz_of({**header, "events": [ESCAPES]}, arrays))]
    begun = messages[0][1]
    files += [(".mcap", mcap_of([(messages[0][0], {**begun, "setup": one}), *messages[1:]])) for one in wrong]
    files += [(".npz", npz_of({**header, "format": ESCAPES}, arrays))]
    for suffix, data in files:
        path = tmp_path / f"run{suffix}"
        path.write_bytes(data)
        for command in (["replay", str(path), "--check"], ["analyse", str(path)]):
            main(command)
            said = capsys.readouterr()
            for text in (said.out, said.err):
                assert all(one.isprintable() for one in text.replace("\n", "")), ascii(text)
            assert "\\x1b[2J" in said.out + said.err
            assert "\n 81 of 81" not in said.out + said.err


def test_the_name_of_a_run_cannot_steer_a_terminal(tmp_path: Path, capsys: Any) -> None:
    messages, path = messages_in(made("drop", ".mcap")), tmp_path / "run.mcap"
    path.write_bytes(mcap_of([(messages[0][0], {**messages[0][1], "name": ESCAPES}), *messages[1:]]))
    assert main(["analyse", str(path)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("\\x1b[2J") and all(one.isprintable() for one in said.replace("\n", ""))


def test_printable_texts_stay_as_they_are() -> None:
    assert printable("42 µm, 3 N m², ±1°") == "42 µm, 3 N m², ±1°"
    assert printable("a\x1bb\nc") == "a\\x1bb\\nc"


def test_a_stretch_that_is_loaded_says_so_with_the_error_of_parameters(tmp_path: Path) -> None:
    # So that whoever catches either finds it.
    (tmp_path / "run.npz").write_bytes(b"nothing")
    for kind in (RecordingError, ParameterError, ValueError):
        with pytest.raises(kind):
            Recording.load(tmp_path / "run.npz")


def test_a_part_of_a_stretch_has_no_totals_of_the_whole(tmp_path: Path) -> None:
    (stretch,) = load(made("drop", ".mcap"), tmp_path, ".mcap").stretches
    part = stretch[2:6]
    assert "taken" not in part.arrays and part.setup is stretch.setup and len(part) == 4
    assert "taken" in stretch.replace(hand=stretch.hand).arrays


def in_blocks(samples: list[Message], folder: Path, monkeypatch: pytest.MonkeyPatch) -> Recording:
    """Return a recording of changed samples of a drop, read in blocks of four."""
    sizes = list[int]()

    def counted(rows: Mapping[str, Any], *row: int) -> None:
        sizes.append(len(rows["tick"]))
        check_rows(rows, *row)

    monkeypatch.setattr("maglev_mj.recording.mcap._BLOCK", 4)
    monkeypatch.setattr("maglev_mj.recording.mcap.check_rows", counted)
    begins, (_, sample), *_ = messages_in(made("drop", ".mcap"))
    changes = [{"time": 0.005 * one["tick"], **one} for one in samples]
    data = mcap_of([begins, *((SAMPLE, {**sample, **change}) for change in changes)], chunk_size=1)
    try:
        return load(data, folder, ".mcap")
    finally:
        assert sizes == [4, *[5] * (len(sizes) - 1)] and len(sizes) > 1  # with the last of the block before


def test_a_field_that_is_another_one_for_some_blocks_is_itself_in_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = [(2.0, 2.0), (3.0, 3.0), (5.0, 4.0), (6.0, 6.0)]
    samples: list[Message] = [
        {"tick": tick, "command": dict.fromkeys(AXES, command), "applied": dict.fromkeys(AXES, applied)}
        for tick, (command, applied) in enumerate(one for one in values for _ in range(4))
    ]
    (stretch,) = in_blocks(samples, tmp_path, monkeypatch).stretches
    assert stretch.command[:, 1].tolist() == [2.0] * 4 + [3.0] * 4 + [5.0] * 4 + [6.0] * 4
    assert stretch.applied[:, 1].tolist() == [2.0] * 4 + [3.0] * 4 + [4.0] * 4 + [6.0] * 4
    assert stretch.tick.tolist() == [*range(16)] and (stretch.position == stretch.position[0]).all()


@pytest.mark.parametrize(
    ("first", "begins", "says"),
    [
        (4, 0.02, ""),
        (3, 0.02, "tick must go up, not from 3 to 3"),
        (1, 0.02, "tick must go up, not from 3 to 1"),
        (4, 0.015, "time must go up from sample to sample"),
        (4, 0.001, "time must go up from sample to sample"),
    ],
)
def test_ticks_and_times_go_up_from_block_to_block(
    first: int, begins: float, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples: list[Message] = [{"tick": tick} for tick in range(4)]
    samples += [{"tick": first + count, "time": begins + 0.005 * count} for count in range(4)]
    if not says:
        assert in_blocks(samples, tmp_path, monkeypatch).ticks == 8
        return
    with pytest.raises(InvalidRecordingError, match=rf"changed\.mcap' is not a whole recording: {says}$"):
        in_blocks(samples, tmp_path, monkeypatch)
