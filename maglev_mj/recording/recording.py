"""Recordings in memory, read from journals and written to them."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.errors import ParameterError, check_instance, file_path
from maglev_mj.frames import Array
from maglev_mj.parameters import store, whole
from maglev_mj.pictures import save
from maglev_mj.recording.journal import (
    SUFFIX,
    InvalidRecordingError,
    checksum_record,
    header,
    sample_records,
    text_records,
)
from maglev_mj.recording.reading import Content
from maglev_mj.recording.sample import FIELDS, ROW, TOTALS, Field, Rows, RunMetadata, Setup, units, value_in
from maglev_mj.result import Result, Table

_RECORDED = [one.name for one in FIELDS]

READ = "a Recording, as Recording.load(FILE) returns"
READ_SEGMENT = "a Segment, such as Recording.load(FILE).segments[0]"
"""Allowed values of a recording and a segment, for messages."""


class _Fields:
    """Fields of samples as attributes."""

    def __getattr__(self, name: str) -> Array:
        arrays = self.__dict__.get("arrays", {})
        if name not in arrays:
            raise AttributeError(f"these samples have no {name!r}: it was not loaded, or is no field")
        return np.asarray(arrays[name])


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment(_Fields):
    """N samples under one controller.

    Each field of a sample is an attribute: `segment.position` is `segment.arrays["position"]`, (N, 6). An index gives
    some of the samples, without totals and gaps: `segment[100:200]`.

    Attributes:
        setup: Setup of plant and controller, with the metadata as `run`.
        arrays: Fields by name, (N,) or (N, 6) each, not to be changed; a command is not finite if the plant refused
            it for that reason. The totals, if recorded, are energy absorbed by the rendered world, `taken` [J], work
            of the hand, `hand_work` [J], and samples `missed`, each from the beginning on.
        gaps: Samples missed without a gap in the ticks: row that follows, and number.
        before: Samples of earlier segments of the same run, if it goes on from them after a rewind; else None.
        began: Time of the beginning since 1970 [µs]; 0 if not known.
        sticks: Row that follows and stick position from there on [m, rad], six, NaN for sliding axes; None without
            friction.
        metadata: Metadata of the setup.

    Raises:
        ParameterError: If a value of the metadata is missing or out of range.
    """

    setup: Setup
    arrays: Mapping[str, Array]
    gaps: Sequence[tuple[int, int]] = ()
    before: Segment | None = None
    began: int = 0
    sticks: Sequence[tuple[int, Sequence[float] | None]] = ()
    metadata: RunMetadata = field(init=False)

    def __post_init__(self) -> None:
        store(self, metadata=RunMetadata.from_json(value_in(self.setup, "run", dict)))

    def __len__(self) -> int:
        return len(next(iter(self.arrays.values())))

    def __getitem__(self, rows: slice | NDArray[Any]) -> Segment:
        totals = {one.name for one in TOTALS}
        arrays = {name: self.arrays[name][rows] for name in self.arrays if name not in totals}
        return replace(self, arrays=arrays, gaps=(), sticks=())

    @property
    def whole(self) -> Segment:
        """The run since its plant and controller were made: with the samples before it."""
        if self.before is None:
            return self
        parts = [self]
        while (part := parts[0].before) is not None:
            parts.insert(0, part)
        arrays = {name: np.concatenate([part.arrays[name] for part in parts]) for name in _RECORDED}
        return Segment(setup={**parts[0].setup, "run": self.setup["run"]}, arrays=arrays)

    @property
    def known_hand(self) -> Array:
        """Hand's wrench [N, N m], (N, 6); zero where it is unknown or estimated."""
        return np.nan_to_num(self.hand * self.metadata.hand_recorded)

    def replace(self, **values: ArrayLike) -> Segment:
        """Return a copy with other values of some fields, one for each sample or for all."""
        new = {name: np.array(np.broadcast_to(one, self.arrays[name].shape), float) for name, one in values.items()}
        return replace(self, arrays={**self.arrays, **new})


@dataclass(frozen=True, eq=False)
class Recording(Result):
    """Recording of one run.

    Attributes:
        segments: Segments in order of time.
        events: Texts of events for the user, such as faults.
        event_samples: Number of samples before each event; empty in files without it.
        damage: Description of damage to the file, such as a missing end; empty for none.
        attachments: Attached files by name.
        about: Format of the file and versions of the code that made it.

    Example:
        >>> from maglev_mj import find_scene, record_run
        >>> recording = record_run(find_scene("drop")(duration=0.1), plant="exact")
        >>> segment = recording.segments[0]
        >>> len(segment), segment.position.shape
        (21, (21, 6))
    """

    segments: Sequence[Segment]
    events: Sequence[str] = ()
    event_samples: Sequence[int] = ()
    damage: str = ""
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    about: Mapping[str, str] = field(default_factory=dict)
    units: ClassVar = units()

    def __post_init__(self) -> None:
        check_instance("segments", self.segments, list | tuple, "a list of Segment, as Recording.load(FILE) reads")
        store(self, segments=_joined(self.segments))

    def samples(self, fields: Sequence[str] = _RECORDED) -> Samples:
        """Return fields of all samples as arrays; NaN for totals that were not recorded."""

        def joined(name: str) -> Array:
            parts = [one.arrays.get(name, np.full(len(one), np.nan)) for one in self.segments]
            if len(parts) == 1:
                return parts[0]
            return np.concatenate(parts) if parts else np.empty((0, 6) if _FIELDS[name].six else 0)

        sizes = [len(one) for one in self.segments]
        numbers = np.repeat(np.arange(len(sizes)), sizes)
        return Samples(arrays={name: joined(name) for name in fields}, segment=numbers, recording=self)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of all samples, (N,) each; see `Samples.columns`."""
        return self.samples().columns()

    def table(self) -> Table:
        """Return a row for each segment."""
        head = "segment", "kind", "samples", "from [s]", "to [s]"
        rows = [
            (index, one.setup["kind"], len(one), *map(float, one.time[[0, -1]]))
            for index, one in enumerate(self.segments)
        ]
        events = f", {len(self.events)} events" if self.events else ""
        return Table(f"recording of {self.ticks} samples{events}", head, rows)

    def plot(self, path: Path | None = None) -> Any:
        """Draw position and command of the moving axes over time; see `Result.plot`."""
        return self.samples().plot(path)

    def parts(self) -> Iterator[tuple[str, Any]]:
        """Yield the content in order of time, as a journal has it: a kind and its value.

        Kinds are "begin" (a segment), "rows" (samples of it, a structured array (N,)), "stick" (position, six or None)
        and "event" (kind, text and number of samples missed with it).
        """
        events = list(zip(self.event_samples, self.events))
        first = 0
        for segment in self.segments:
            yield "begin", segment
            rows, gaps, start = _rows(segment), list(segment.gaps), 0
            beside: list[tuple[int, tuple[str, Any]]] = [(row, ("stick", stuck)) for row, stuck in segment.sticks]
            while events and events[0][0] <= first + len(rows):  # one between two segments is of the first
                place, text = events.pop(0)
                kind, _, words = text.partition(": ")
                at = next((gap for gap in gaps if gap[0] == place - first), None) if kind == "missed" else None
                if at is not None:
                    gaps.remove(at)
                beside.append((place - first, ("event", (kind, words, 0 if at is None else at[1]))))
            for row, part in sorted(beside, key=lambda one: one[0]):
                if row > start:
                    yield "rows", rows[start:row]
                    start = row
                yield part
            if start < len(rows):
                yield "rows", rows[start:]
            first += len(rows)

    def save(self, path: Path | str) -> None:
        """Write a journal, atomically.

        Args:
            path: Path of the file, with the suffix .maglev.

        Raises:
            ParameterError: If it has another suffix.
            OSError: If it cannot be written.
        """
        path = file_path(path)
        if path.suffix != SUFFIX:
            raise ParameterError(f"path must end in {SUFFIX}, not {path.name!r}: export writes other formats")
        with aside(path) as partial, partial.open("wb") as file:
            file.write(header())
            for block in self._blocks():
                file.write(block + checksum_record(block))

    def _blocks(self) -> Iterator[bytes]:
        """Yield the records of a journal."""
        for name, data in self.attachments.items():
            yield text_records({"attach": name, "data": base64.b64encode(data).decode()})
        for kind, part in self.parts():
            if kind == "rows":
                yield sample_records(part)
            elif kind == "begin":
                yield text_records({"begin": part.setup, "time": part.began})
            elif kind == "stick":
                yield text_records({"stick": stick_as_json(part)})
            else:
                yield text_records(dict(zip(("event", "text", "missed"), part)))
        if not self.damage:
            yield text_records({"end": {"lost": 0}})

    @classmethod
    def load(cls, path: Path | str) -> Recording:
        """Read a journal; one that was not closed up to its last whole record.

        Raises:
            InvalidRecordingError: If it is missing, no recording, or invalid, for example by a wrong checksum, or a
                number that is not finite, of another type or out of range.
        """
        return _read(path)

    @property
    def ticks(self) -> int:
        """Total number of samples."""
        return sum(len(segment) for segment in self.segments)


def _joined(segments: Sequence[Segment]) -> list[Segment]:
    """Return the segments of a session, each with the samples that it goes on from."""
    joined: list[Segment] = []
    begun: list[tuple[int, Segment]] = []
    for one in segments:
        if (session := one.setup.get("session")) is not None:
            after = value_in(session, "after")
            if after is not None and (known := [part for part in begun if part[0] <= whole("after", after)]):
                part = known[-1][1]
                if count := int(np.searchsorted(part.tick, one.tick[0])):
                    one = replace(one, before=part[:count])
            begun.append((whole("first", value_in(session, "first")), one))
        joined.append(one)
    return joined


def _rows(segment: Segment) -> Rows:
    """Return the samples of a segment as a structured array (N,)."""
    rows = np.empty(len(segment), ROW)
    for name in _RECORDED:
        rows[name] = segment.arrays[name]
    return rows


def stick_as_json(position: Sequence[float] | None) -> list[float | None] | None:
    """Return a stick position for JSON, which has no NaN."""
    return None if position is None else [None if value != value else value for value in position]


def _read(path: Path | str, names: frozenset[str] | None = None) -> Recording:
    """Read some fields of a journal, or all; see `Recording.load`."""
    path = file_path(path)
    with refused(path):
        content = Content(path, names)
        return Recording(
            [
                Segment(setup=one.setup, arrays=one.arrays(), gaps=one.gaps, began=one.began, sticks=one.sticks)
                for one in content.segments
            ],
            events=content.events,
            event_samples=content.event_samples,
            damage=content.damage,
            attachments=content.attachments,
            about=content.about,
        )


@contextmanager
def refused(path: Path) -> Iterator[None]:
    """Raise InvalidRecordingError, which names the file, for one that cannot be read or is invalid."""
    try:
        yield
    except OSError as error:
        raise InvalidRecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
    except ParameterError as error:
        raise InvalidRecordingError(f"{str(path)!r} is not a whole recording: {error}") from None


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples(_Fields, Result):
    """All N samples of a recording, fields as attributes.

    For example `samples.position`.

    Attributes:
        arrays: Fields by name, (N,) or (N, 6), not to be changed; NaN for values missing in the file.
        units: Unit of each column, such as `position.z`; empty for a whole number.
        segment: Number of the segment of each sample, from 0, (N,).
        recording: The recording, with setups, metadata, events, attachments and damage.
    """

    arrays: Mapping[str, Array]
    segment: NDArray[np.int64]
    recording: Recording

    def __len__(self) -> int:
        return len(self.segment)

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        return dict(unit for name in self.arrays for unit in _FIELDS[name].units)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns by name, (N,) each.

        `segment` comes first, then those of `units`. Columns without unit are whole numbers.
        """
        columns: dict[str, NDArray[Any]] = {"segment": self.segment}
        for name, values in self.arrays.items():
            field = _FIELDS[name]
            for place, (column, unit) in enumerate(field.units):
                part = values[:, place] if field.six else values
                columns[column] = part if unit or np.isnan(part).any() else part.astype(np.int64)
        return columns

    def plot(self, path: Path | None = None) -> Any:
        """Draw position and command of the moving axes over time; see `Result.plot`.

        Raises:
            AttributeError: If time, position or command were not loaded.
        """
        from maglev_mj.plants.pictures import moving_axes

        return save(moving_axes(self.time, self.position, self.command), path)

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
        path: A journal; one that was not closed is read up to its last whole record.
        fields: Names of the fields to keep, such as "time" and "position"; None for all.

    Raises:
        InvalidRecordingError: If it is missing, no recording, or invalid.
        ParameterError: If a field is not known.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import find_scene, load_samples, write_run
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = write_run(Path(folder, "run.maglev"), find_scene("drop")(duration=0.1), plant="exact")[0]
        ...     samples = load_samples(file, ["time", "position"])
        >>> samples.position.shape
        (21, 6)
    """
    names = list(_FIELDS) if fields is None else list(fields)
    unknown = [name for name in names if name not in _FIELDS]
    if unknown:
        raise ParameterError(f"fields must be of {', '.join(_FIELDS)}, not {unknown[0]!r}")
    return _read(path, frozenset({"tick", *names})).samples(names)
