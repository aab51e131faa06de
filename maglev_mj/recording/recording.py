"""Recordings in memory, as files of arrays, and as tables for other programs."""

from __future__ import annotations

import base64
import csv
import json
import math
import os
import wave
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any, ClassVar
from zipfile import ZIP_STORED

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.errors import MaglevError, ParameterError, check_instance, check_one_of, file_path, require
from maglev_mj.frames import AXES, Array
from maglev_mj.parameters import whole
from maglev_mj.recording.mcap import MAGIC, Allowance, UnpackingError, read_mcap
from maglev_mj.recording.sample import (
    ARRAYS,
    FIELDS,
    TOTALS,
    Field,
    RunMetadata,
    Setup,
    check_rows,
    check_setup,
    is_recorded,
    parsed,
    units,
    value_in,
)
from maglev_mj.result import Result, Table

_ZIP = b"PK"
_FORMAT = "maglev_mj recording 1"
_RECORDED = [one.name for one in FIELDS]

READ = "a Recording, as Recording.load(FILE) returns"
READ_STRETCH = "a Stretch, such as Recording.load(FILE).stretches[0]"
"""Allowed values of a recording and a stretch, for messages."""


class RecordingError(MaglevError):
    """Error of a recording: it cannot be written or replayed."""


class InvalidRecordingError(RecordingError, ParameterError):
    """A file is not a recording, or has invalid content."""


class _Fields:
    """Fields of samples as attributes."""

    def __getattr__(self, name: str) -> Array:
        arrays = self.__dict__.get("arrays", {})
        if name not in arrays:
            raise AttributeError(f"these samples have no {name!r}: it was not loaded, or is no field")
        return np.asarray(arrays[name])


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch(_Fields):
    """N samples under one controller.

    Each field of a sample is an attribute: `stretch.position` is `stretch.arrays["position"]`, (N, 6). An index gives
    some of the samples, without totals and gaps: `stretch[100:200]`.

    Attributes:
        setup: Setup of plant and controller, with the metadata as `run`.
        arrays: Fields by name, (N,) or (N, 6) each, not to be changed; a command is not finite if the plant refused
            it for that reason. The totals, if recorded, are energy absorbed by the rendered world, `taken` [J], work
            of the hand, `hand_work` [J], and samples `missed`, each from the beginning on.
        gaps: Samples missed without a gap in the ticks: row that follows, and number.
        before: Samples of earlier stretches of the same run, if it goes on from them after a rewind; else None.
        metadata: Metadata of the setup.

    Raises:
        ParameterError: If a value of the metadata is missing or out of range.
    """

    setup: Setup
    arrays: Mapping[str, Array]
    gaps: Sequence[tuple[int, int]] = ()
    before: Stretch | None = None
    metadata: RunMetadata = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "metadata", RunMetadata.from_json(value_in(self.setup, "run", dict)))

    def __len__(self) -> int:
        return len(next(iter(self.arrays.values())))

    def __getitem__(self, rows: slice | NDArray[Any]) -> Stretch:
        totals = {one.name for one in TOTALS}
        arrays = {name: values[rows] for name, values in self.arrays.items() if name not in totals}
        return replace(self, arrays=arrays, gaps=())

    @property
    def whole(self) -> Stretch:
        """The run since its plant and controller were made: with the samples before it."""
        if self.before is None:
            return self
        parts = [self]
        while (part := parts[0].before) is not None:
            parts.insert(0, part)
        arrays = {name: np.concatenate([part.arrays[name] for part in parts]) for name in _RECORDED}
        return Stretch(setup={**parts[0].setup, "run": self.setup["run"]}, arrays=arrays)

    @property
    def known_hand(self) -> Array:
        """Hand's wrench [N, N m], (N, 6); zero where it is unknown or estimated."""
        return np.nan_to_num(self.hand * self.metadata.hand_recorded)

    def replace(self, **values: ArrayLike) -> Stretch:
        """Return a copy with other values of some fields, one for each sample or for all."""
        new = {name: np.array(np.broadcast_to(one, self.arrays[name].shape), float) for name, one in values.items()}
        return replace(self, arrays={**self.arrays, **new})


@dataclass(frozen=True, eq=False)
class Recording(Result):
    """Recording of one run.

    Attributes:
        stretches: Stretches in order of time.
        events: Texts of events for the user, such as faults.
        event_samples: Number of samples before each event; empty in files without it.
        damage: Description of damage to the file, such as a missing end; empty for none.
        attachments: Attached files by name.
        about: Format of the file and versions of the code that made it.

    Example:
        >>> from maglev_mj import find_scene, record_run
        >>> recording = record_run(find_scene("drop")(duration=0.1), plant="exact")
        >>> stretch = recording.stretches[0]
        >>> len(stretch), stretch.position.shape
        (21, (21, 6))
    """

    stretches: Sequence[Stretch]
    events: Sequence[str] = ()
    event_samples: Sequence[int] = ()
    damage: str = ""
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    about: Mapping[str, str] = field(default_factory=dict)
    units: ClassVar = units()
    drawn_by: ClassVar = "maglev_mj.analysis.pictures:recording"

    def __post_init__(self) -> None:
        check_instance("stretches", self.stretches, list | tuple, "a list of Stretch, as Recording.load(FILE) reads")
        object.__setattr__(self, "stretches", _joined(self.stretches))

    def samples(self, fields: Sequence[str] = _RECORDED) -> Samples:
        """Return fields of all samples as arrays; NaN for totals that were not recorded."""

        def joined(name: str) -> Array:
            parts = [one.arrays.get(name, np.full(len(one), np.nan)) for one in self.stretches]
            if len(parts) == 1:
                return parts[0]
            return np.concatenate(parts) if parts else np.empty((0, 6) if _FIELDS[name].six else 0)

        sizes = [len(one) for one in self.stretches]
        numbers = np.repeat(np.arange(len(sizes)), sizes)
        return Samples(arrays={name: joined(name) for name in fields}, stretch=numbers, recording=self)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of all samples, (N,) each; see `Samples.columns`."""
        return self.samples().columns()

    def table(self) -> Table:
        """Return a row for each stretch."""
        head = "stretch", "kind", "samples", "from [s]", "to [s]"
        rows = [
            (index, one.setup["kind"], len(one), *map(float, one.time[[0, -1]]))
            for index, one in enumerate(self.stretches)
        ]
        events = f", {len(self.events)} events" if self.events else ""
        return Table(f"recording of {self.ticks} samples{events}", head, rows)

    def save(self, path: Path | str) -> None:
        """Write to a file atomically.

        Raises:
            OSError: If it cannot be written.
        """
        attached = enumerate(self.attachments.values())
        arrays: dict[str, Any] = {f"attachment/{place}": np.frombuffer(data, np.uint8) for place, data in attached}
        for index, stretch in enumerate(self.stretches):
            for name, fields in _STORED.items():
                columns = [stretch.arrays[one.name] for one in fields if one.name in stretch.arrays]
                if any(is_recorded(one, values) for one, values in zip(fields, columns)):
                    arrays[f"{index}/{name}"] = columns[0] if len(columns) == 1 else np.column_stack(columns)
        header = _about(self, list(self.attachments)) | {
            "format": _FORMAT,
            "axes": AXES,
            "gaps": [list(stretch.gaps) for stretch in self.stretches],
            "event_samples": list(self.event_samples),
        }
        with aside(Path(path)) as partial, partial.open("wb") as file:
            np.savez(file, header=np.array(json.dumps(header)), **arrays)

    @classmethod
    def load(cls, path: Path | str) -> Recording:
        """Read a file of either format.

        An MCAP file that was not closed is read up to its last complete chunk.

        The unpacked size is limited, for example to 64 MiB for each part.

        Raises:
            MissingPackageError: If an MCAP file needs a package that is not installed.
            InvalidRecordingError: If it is missing, no recording, or invalid, for example by a number that is
                not finite, of another type or out of range.
        """
        return _read(path)

    @property
    def ticks(self) -> int:
        """Total number of samples."""
        return sum(len(stretch) for stretch in self.stretches)


def _joined(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Return the stretches of a session, each with the samples that it goes on from."""
    joined: list[Stretch] = []
    begun: list[tuple[int, Stretch]] = []
    for one in stretches:
        if (session := one.setup.get("session")) is not None:
            after = value_in(session, "after")
            if after is not None and (known := [part for part in begun if part[0] <= whole("after", after)]):
                part = known[-1][1]
                if count := int(np.searchsorted(part.tick, one.tick[0])):
                    one = replace(one, before=part[:count])
            begun.append((whole("first", value_in(session, "first")), one))
        joined.append(one)
    return joined


def _read(path: Path | str, names: frozenset[str] | None = None) -> Recording:
    """Read a file of either format, some fields of MCAP or all; see `Recording.load`."""
    path = file_path(path)
    try:
        with path.open("rb", buffering=1 << 20) as file:
            size, first = os.fstat(file.fileno()).st_size, file.read(len(MAGIC))
            file.seek(0)
            if first == MAGIC:
                return _read_mcap(file, size, names)
            if first[:2] not in (MAGIC[:2], _ZIP):
                raise ParameterError("it is neither MCAP nor .npz")
            return _read_arrays(file, size)
    except OSError as error:
        raise InvalidRecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
    except ParameterError as error:
        raise InvalidRecordingError(f"{str(path)!r} is not a whole recording: {error}") from None


def _read_mcap(file: IO[bytes], size: int, names: frozenset[str] | None) -> Recording:
    content = read_mcap(file, size, names)
    return Recording(
        [Stretch(setup=one.setup, arrays=one.arrays(), gaps=one.gaps) for one in content.stretches if len(one)],
        events=content.events,
        event_samples=content.event_samples,
        damage="; ".join(content.damage),
        attachments=content.attachments,
        about=content.about,
    )


@contextmanager
def aside(path: Path) -> Iterator[Path]:
    """Yield a temporary name that replaces `path` on success.

    After a failure the temporary file is removed.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


_FIELDS: Mapping[str, Field] = {one.name: one for one in (*FIELDS, *TOTALS)}

_STORED: Mapping[str, Sequence[Field]] = {**ARRAYS, **{one.name: [one] for one in TOTALS}}
"""Fields in each array of a stretch."""


def _read_arrays(file: IO[bytes], size: int) -> Recording:
    """Read an .npz file of `size` bytes.

    Raises:
        ParameterError: If it holds no recording or an invalid one.
        OSError: If it cannot be read.
    """
    allowance = Allowance(size)
    try:
        with np.load(file, allow_pickle=False) as arrays:
            for member in arrays.zip.infolist():
                if member.compress_type != ZIP_STORED:
                    allowance.part(member.file_size)
                elif member.file_size != member.compress_size:
                    raise UnpackingError(f"{member.filename} must have one size")
            text = str(arrays["header"])
            allowance.text(len(text))
            header = parsed(text)
            if value_in(header, "format", str) != _FORMAT:
                raise ParameterError(f"format must be {_FORMAT!r}, not {header['format']!r}")
            setups, gaps = value_in(header, "setups", list), value_in(header, "gaps", list)
            names = value_in(header, "attachments", list)
            return Recording(
                [_read_stretch(arrays, *one) for one in zip(range(len(setups)), setups, gaps, strict=True)],
                events=_texts(value_in(header, "events", list)),
                event_samples=[whole("event_samples", one) for one in header.get("event_samples", ())],
                damage=value_in(header, "damage", str),
                attachments={name: arrays[f"attachment/{place}"].tobytes() for place, name in enumerate(_texts(names))},
                about=dict(zip(header["about"], _texts(header["about"].values()), strict=True)),
            )
    except (OSError, ParameterError):
        raise
    except UnpackingError as error:
        raise ParameterError(str(error)) from None
    except Exception:  # errors of zip files, unpacking and headers: a damaged file fails in many ways
        raise ParameterError("it is damaged") from None


def _texts(values: Iterable[Any]) -> list[str]:
    return [value_in({"a text": value}, "a text", str) for value in values]


def _read_stretch(stored: Any, index: int, setup: Any, gaps: Any) -> Stretch:
    arrays: dict[str, Array] = {}
    size = len(stored[f"{index}/tick"])
    for name, fields in _STORED.items():
        columns = np.cumsum([len(one.units) for one in fields])
        shape = (size,) if columns[-1] == 1 else (size, columns[-1])
        if f"{index}/{name}" in stored:
            values = stored[f"{index}/{name}"]
            if values.dtype != np.float64 or values.shape != shape:
                raise ParameterError(f"{name} must be float64 {shape}, not {values.dtype} {values.shape}")
        elif all(one.optional for one in fields):
            values = np.full(shape, np.nan)
        elif fields[0] in TOTALS:
            continue
        else:
            raise ParameterError(f"a stretch must have {name}")
        parts = np.split(values.reshape(size, -1), columns[:-1], axis=1)
        arrays |= {one.name: part if one.six else part[:, 0] for one, part in zip(fields, parts, strict=True)}
    check_rows(arrays)
    missed = [(whole("a gap", row, at_most=size), whole("a gap", count)) for row, count in gaps]
    return Stretch(setup=check_setup(setup), arrays=arrays, gaps=missed)


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples(_Fields, Result):
    """All N samples of a recording, fields as attributes.

    For example `samples.position`.

    Attributes:
        arrays: Fields by name, (N,) or (N, 6), not to be changed; NaN for values missing in the file.
        units: Unit of each column, such as `position.z`; empty for a whole number.
        stretch: Number of the stretch of each sample, from 0, (N,).
        recording: The recording, with setups, metadata, events, attachments and damage.
    """

    arrays: Mapping[str, Array]
    stretch: NDArray[np.int64]
    recording: Recording
    drawn_by: ClassVar = "maglev_mj.analysis.pictures:samples"

    def __len__(self) -> int:
        return len(self.stretch)

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        return dict(unit for name in self.arrays for unit in _FIELDS[name].units)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns by name, (N,) each.

        `stretch` comes first, then those of `units`. Columns without unit are whole numbers.
        """
        columns: dict[str, NDArray[Any]] = {"stretch": self.stretch}
        for name, values in self.arrays.items():
            field = _FIELDS[name]
            for place, (column, unit) in enumerate(field.units):
                part = values[:, place] if field.six else values
                columns[column] = part if unit or np.isnan(part).any() else part.astype(np.int64)
        return columns

    def to_pandas(self) -> Any:
        """Return a data frame with one row per sample.

        Its `attrs` hold units and events.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        frame = super().to_pandas()
        frame.attrs["events"] = list(self.recording.events)
        return frame


def load_samples(path: Path | str, fields: Sequence[str] | None = None) -> Samples:
    """Read a recording as arrays.

    An hour at 1 kHz takes some seconds and below 1 GB: a field that is constant or equals another is stored once.

    Args:
        path: A file of either format; an MCAP file that was not closed is read up to its last complete chunk.
        fields: Names of the fields to keep, such as "time" and "position"; None for all.

    Raises:
        MissingPackageError: If an MCAP file needs a package that is not installed.
        InvalidRecordingError: If it is missing, no recording, or invalid.
        ParameterError: If a field is not known.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import find_scene, load_samples, write_run
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = write_run(Path(folder, "run.npz"), find_scene("drop")(duration=0.1), plant="exact")[0]
        ...     samples = load_samples(file, ["time", "position"])
        >>> samples.position.shape
        (21, 6)
    """
    names = list(_FIELDS) if fields is None else list(fields)
    unknown = [name for name in names if name not in _FIELDS]
    if unknown:
        raise ParameterError(f"fields must be of {', '.join(_FIELDS)}, not {unknown[0]!r}")
    return _read(path, frozenset({"tick", *names})).samples(names)


_BLOCK = 1 << 14


def export(recording: Recording, kind: str, path: Path | str) -> None:
    """Write a recording as a table, one row per sample, or as sound.

    A table has the columns of `Recording.columns`, and all other content and the units go with it.

    Args:
        recording: The recording.
        kind: One of EXPORTS; with csv, content other than the table goes to a .json file of the same name beside it.
        path: Path of the new file.

    Raises:
        ParameterError: If the kind is not known, or there are no samples for a sound.
        MissingPackageError: If the package for Parquet is needed and not installed.
        OSError: If it cannot be written; an existing file then stays.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import export, find_scene, record_run
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     export(record_run(find_scene("drop")(duration=0.1), plant="exact"), "csv", Path(folder, "run.csv"))
        ...     lines = Path(folder, "run.csv").read_text().splitlines()
        >>> [line.split(",")[:2] for line in lines if not line.startswith("#")][:2]
        [['stretch', 'tick'], ['0', '0']]
    """
    check_one_of("to", EXPORTS, kind)
    check_instance("recording", recording, Recording, READ)
    path = file_path(path)
    with aside(path) as partial:
        EXPORTS[kind](recording, partial, path)


def _columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """Return each known column of all samples, (N,)."""
    stretches = recording.stretches
    fields = [*FIELDS, *(one for one in TOTALS if stretches and all(one.name in part.arrays for part in stretches))]
    samples = recording.samples([field.name for field in fields])
    recorded = {one.name: values for one in fields if is_recorded(one, values := samples.arrays[one.name])}
    return replace(samples, arrays=recorded).columns()


def _about(recording: Recording, attachments: Any) -> dict[str, Any]:
    """Return the content besides samples, ready for JSON."""
    return {
        "units": units(),
        "setups": [stretch.setup for stretch in recording.stretches],
        "events": list(recording.events),
        "about": dict(recording.about),
        "damage": recording.damage,
        "attachments": attachments,
    }


def _encoded(recording: Recording) -> dict[str, Any]:
    """Return the content besides samples, with attachments in base64."""
    return _about(recording, {name: base64.b64encode(data).decode() for name, data in recording.attachments.items()})


def _as_csv(recording: Recording, partial: Path, path: Path) -> None:
    columns = _columns(recording)
    with aside(path.with_name(f"{path.name}.json")) as beside:
        beside.write_text(json.dumps(_encoded(recording), indent=1), encoding="utf-8")
        with partial.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(columns)
            for first in range(0, recording.ticks, _BLOCK):
                table.writerows(zip(*(column[first : first + _BLOCK].tolist() for column in columns.values())))


def _as_parquet(recording: Recording, partial: Path, _path: Path) -> None:
    require(("pyarrow",), "parquet", "Parquet needs pyarrow")
    import pyarrow
    from pyarrow import parquet

    columns, unit_of = {name: pyarrow.array(column) for name, column in _columns(recording).items()}, units()
    fields = [
        pyarrow.field(name, column.type, metadata={"unit": unit_of[name]} if unit_of.get(name) else None)
        for name, column in columns.items()
    ]
    about = {f"maglev_mj.{name}": json.dumps(part) for name, part in _encoded(recording).items()}
    parquet.write_table(pyarrow.table([*columns.values()], schema=pyarrow.schema(fields, metadata=about)), partial)


_SOUND_RATE, _LOWEST, _LOUDEST = 48_000, 20.0, (50.0, 1.0)
"""Frames a second, lowest frequency [Hz] and full scale [N, N m] of a sound."""

_STEP = 0.005  # at which a sound is filtered, at least [s]


def _as_wav(recording: Recording, partial: Path, _path: Path) -> None:
    if not recording.ticks:
        raise InvalidRecordingError("there is nothing to hear: the recording has no samples")
    parts = [(one.applied, one.metadata.period) for one in recording.stretches]
    with partial.open("wb") as file:
        write_sound(file, parts, turns=AXES.index(recording.stretches[0].metadata.axis) > 2)


def write_sound(file: IO[bytes], parts: Sequence[tuple[Array, float]], *, turns: bool) -> None:
    """Write held forces as WAV, on the axis where they change most.

    Args:
        file: Open file.
        parts: One after the other, wrenches at the samples [N, N m], (N, 6), and the time that each is heard [s].
        turns: True for a torque, False for a force.
    """
    forces = [np.nan_to_num(wrench[:, 3:] if turns else wrench[:, :3]) for wrench, _ in parts]
    axis = int(np.argmax(sum(np.square(np.diff(force, axis=0)).sum(axis=0) for force in forces)))
    with wave.open(file, "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(_SOUND_RATE)
        for (_, period), force in zip(parts, forces, strict=True):
            count = math.ceil(period / _STEP)  # a step fades within a longer sample
            heard = _without_slow(np.repeat(force[:, axis], count), period / count) / _LOUDEST[turns]
            frames = np.round(np.clip(heard, -1.0, 1.0) * 32767).astype("<i2")
            edges = np.round(np.arange(len(frames) + 1) * (period / count * _SOUND_RATE)).astype(np.int64)
            for first in range(0, len(frames), _BLOCK):  # an hour is 350 MB
                held = np.diff(edges[first : first + _BLOCK + 1])
                sound.writeframes(np.repeat(frames[first : first + _BLOCK], held).tobytes())


def _without_slow(values: Array, period: float) -> Array:
    """Return values (N,) through a high-pass of first order, which starts at rest."""
    kept, state = float(np.exp(-2.0 * np.pi * _LOWEST * period)), 0.0
    out = []
    for change in np.diff(values, prepend=values[:1]).tolist():
        state = kept * (state + change)
        out.append(state)
    return np.array(out)


EXPORTS: Mapping[str, Callable[[Recording, Path, Path], Any]] = {
    "npz": lambda recording, partial, _: recording.save(partial),
    "csv": _as_csv,
    "parquet": _as_parquet,
    "wav": _as_wav,
}
"""Export functions by format name.

Each writes a recording to a temporary path; the second path is the final one.
"""
