"""Recordings in memory: load, save, samples as arrays."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.errors import ParameterError, check_instance, check_one_of, file_path, refuse_mask
from maglev_mj.files import atomic_path
from maglev_mj.frames import Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import store, whole
from maglev_mj.recording.journal import (
    BLOCK,
    SUFFIX,
    InvalidRecordingError,
    journal_bytes,
    sample_records,
    text_records,
)
from maglev_mj.recording.reading import Content
from maglev_mj.recording.sample import FIELDS, ROW, TOTALS, Field, Rows, RunMetadata, Setup, units, value_in
from maglev_mj.result import Result, Table, conditions_text

_RECORDED = [entry.name for entry in FIELDS]

RECORDING_TYPE = "a Recording, as returned by Recording.load(FILE)"
SEGMENT_TYPE = "a Segment, such as Recording.load(FILE).segments[0]"
"""Expected types, for error messages."""


class _Fields:
    """Fields of samples as attributes."""

    def __getattr__(self, name: str) -> Array:
        arrays = self.__dict__.get("arrays", {})
        if name not in arrays:
            raise AttributeError(f"samples have no {name!r}: not a field, or not loaded")
        return np.asarray(arrays[name])


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment(_Fields):
    """N samples under one controller.

    Fields are attributes: `segment.position` is `segment.arrays["position"]`, (N, 6). Slicing, `segment[100:200]`,
    returns a part without totals and gaps.

    Attributes:
        setup: Setup of plant and controller, with the metadata as `run`.
        arrays: Fields by name, (N,) or (N, 6) each, read-only. A command that is not finite was rejected by the
            plant. Totals since the segment's start, if loaded: `taken`, energy absorbed by the control laws [J],
            `hand_work` [J], `missed` samples, and `device_force`, the largest so far [N].
        gaps: (row, count) of samples missed before a row without a gap in the tick numbers.
        before: Preceding samples of the same run, if it resumes from them after a rewind; else None.
        began: Start time since 1970 [µs]; 0 if unknown.
        sticks: (row, position) of the stick position from a row on [m, rad], six components, NaN for sliding axes;
            None without friction.
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
        for name, values in self.arrays.items():
            refuse_mask(name, values)
        store(self, metadata=RunMetadata.from_json(value_in(self.setup, "run", dict)))

    def __len__(self) -> int:
        return len(next(iter(self.arrays.values())))

    def __getitem__(self, rows: slice | NDArray[Any]) -> Segment:
        totals = {total.name for total in TOTALS}
        arrays = {name: self.arrays[name][rows] for name in self.arrays if name not in totals}
        return replace(self, arrays=arrays, gaps=(), sticks=())

    @property
    def whole(self) -> Segment:
        """The run from its start, including the samples in `before`."""
        if self.before is None:
            return self
        parts = [self]
        while (part := parts[0].before) is not None:
            parts.insert(0, part)
        arrays = {name: np.concatenate([part.arrays[name] for part in parts]) for name in _RECORDED}
        return Segment(setup={**parts[0].setup, "run": self.setup["run"]}, arrays=arrays)

    @property
    def recorded_hand_wrench(self) -> Array:
        """Recorded wrench of the hand [N, N m], (N, 6); zero where unknown or estimated."""
        return np.nan_to_num(self.hand * self.metadata.hand_recorded)

    def replace(self, **values: ArrayLike) -> Segment:
        """Return a copy with new values of some fields, broadcast to their shapes."""
        for name, part in values.items():
            refuse_mask(name, part)
        new = {name: np.array(np.broadcast_to(part, self.arrays[name].shape), float) for name, part in values.items()}
        return replace(self, arrays={**self.arrays, **new})


@checked(own="segments")
@dataclass(frozen=True, eq=False)
class Recording(Result):
    """Recording of one run.

    Attributes:
        segments: Segments in order of time.
        events: Texts of events for the user, such as faults.
        event_samples: Number of samples before each event; empty if not recorded.
        damage: Description of damage to the file, such as a missing end; empty if intact.
        attachments: Attached files by name.
        about: File format, and versions of the code that wrote it.

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
        check_instance(
            "segments", self.segments, list | tuple, "a list of Segment, as returned by Recording.load(FILE)"
        )
        store(self, segments=_joined(self.segments))

    def samples(self, fields: Sequence[str] = _RECORDED) -> Samples:
        """Return fields of all samples as arrays; NaN for totals that were not loaded."""
        for name in fields:
            check_one_of("field", _FIELDS, name)

        def joined(name: str) -> Array:
            parts = [part.arrays.get(name, np.full(len(part), np.nan)) for part in self.segments]
            if len(parts) == 1:
                return parts[0]
            return np.concatenate(parts) if parts else np.empty((0, 6) if _FIELDS[name].six else 0)

        sizes = [len(part) for part in self.segments]
        indices = np.repeat(np.arange(len(sizes)), sizes)
        return Samples(arrays={name: joined(name) for name in fields}, segment=indices, recording=self)

    def _headline(self) -> str:
        events = f", {len(self.events)} events" if self.events else ""
        duration = sum(float(np.ptp(part.time)) for part in self.segments)
        return f"Recording of {self.ticks} samples in {duration:.4g} s{events}"

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of all samples, (N,) each; see `Samples.columns`."""
        return self.samples().columns()

    def table(self) -> Table:
        """Return a row for each segment."""
        head = "segment", "kind", "samples", "from [s]", "to [s]"
        rows = [
            (index, part.setup["kind"], len(part), *map(float, part.time[[0, -1]]))
            for index, part in enumerate(self.segments)
        ]
        return Table("", head, rows)

    @property
    def conditions(self) -> str:
        """See `Result`."""
        runs = [part.metadata for part in self.segments]
        if not runs:
            return ""
        names = " and ".join(dict.fromkeys(run.name for run in runs))
        periods, delays = [run.period for run in runs], [run.delay for run in runs]
        return conditions_text(names or "recording", [run.axis for run in runs], periods, delays)

    pictures: ClassVar = {"recording": "maglev_mj.plants.pictures:samples"}

    def _draw(self, function: Callable[..., Any]) -> Any:
        return function(self.samples())

    def parts(self) -> Iterator[tuple[str, Any]]:
        """Yield kind and value of each part of the content, in the order of a journal.

        Kinds: "begin" (a segment), "rows" (samples, a structured array (N,)), "stick" (position, six components or
        None), "event" (kind, text, number of missed samples).
        """
        events = list(zip(self.event_samples, self.events))
        first = 0
        for segment in self.segments:
            yield "begin", segment
            rows, gaps, start = _rows(segment), list(segment.gaps), 0
            marks: list[tuple[int, tuple[str, Any]]] = [(row, ("stick", stuck)) for row, stuck in segment.sticks]
            while events and events[0][0] <= first + len(rows):  # an event between segments belongs to the first
                position, text = events.pop(0)
                kind, _, words = text.partition(": ")
                row = position - first
                match = next((gap for gap in gaps if gap[0] == row), None) if kind == "missed" else None
                if match is not None:
                    gaps.remove(match)
                marks.append((row, ("event", (kind, words, 0 if match is None else match[1]))))
            for row, part in sorted(marks, key=lambda mark: mark[0]):
                if row > start:
                    yield "rows", rows[start:row]
                    start = row
                yield part
            if start < len(rows):
                yield "rows", rows[start:]
            first += len(rows)

    def save(self, path: Path | str) -> None:
        """Write a journal atomically.

        Args:
            path: Path with the suffix .maglev.

        Raises:
            ParameterError: If the suffix is different.
            OSError: If the file cannot be written.
        """
        path = file_path(path)
        if path.suffix != SUFFIX:
            raise ParameterError(f"path must end in {SUFFIX} (got {path.name!r}): for other formats use export")
        with atomic_path(path) as partial, partial.open("wb") as file:
            file.writelines(journal_bytes(self._records()))

    def _records(self) -> Iterator[bytes]:
        """Yield the records of a journal."""
        for name, data in self.attachments.items():
            yield text_records({"attach": name, "data": base64.b64encode(data).decode()})
        for kind, part in self.parts():
            if kind == "rows":
                yield from (sample_records(part[start : start + BLOCK]) for start in range(0, len(part), BLOCK))
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
        """Read a journal up to its end, its last complete record or its first damaged block, see `damage`.

        Raises:
            InvalidRecordingError: If the file is missing, not a recording, or invalid: for example a value that is not
                finite, of another type or out of range.
        """
        return _read(path)

    def require_samples(self, path: Path | str) -> None:
        """Check that there are samples, for a message with the path.

        Raises:
            InvalidRecordingError: If there are none; the message names the damage.
        """
        if not self.ticks:
            raise InvalidRecordingError(f"{str(path)!r} contains no samples" + f" ({self.damage})" * bool(self.damage))

    @property
    def ticks(self) -> int:
        """Total number of samples."""
        return sum(len(segment) for segment in self.segments)


def _joined(segments: Sequence[Segment]) -> list[Segment]:
    """Return the segments with `before` set where one resumes from an earlier sample."""
    joined: list[Segment] = []
    begun: list[tuple[int, Segment]] = []
    for segment in segments:
        if (session := segment.setup.get("session")) is not None:
            after = value_in(session, "after")
            if after is not None and (earlier := [part for part in begun if part[0] <= whole("after", after)]):
                part = earlier[-1][1]
                if count := int(np.searchsorted(part.tick, segment.tick[0])):
                    segment = replace(segment, before=part[:count])
            begun.append((whole("first", value_in(session, "first")), segment))
        joined.append(segment)
    return joined


def _rows(segment: Segment) -> Rows:
    """Return the samples of a segment as a structured array (N,)."""
    rows = np.empty(len(segment), ROW)
    for name in _RECORDED:
        rows[name] = segment.arrays[name]
    return rows


def stick_as_json(position: Sequence[float] | None) -> list[float | None] | None:
    """Return a stick position as JSON values, None for NaN."""
    return None if position is None else [None if value != value else value for value in position]


def _read(path: Path | str, names: frozenset[str] | None = None) -> Recording:
    """Read some fields of a journal, or all; see `Recording.load`."""
    path = file_path(path)
    with refused(path):
        content = Content(path, names)
        return Recording(
            [
                Segment(setup=part.setup, arrays=part.arrays(), gaps=part.gaps, began=part.began, sticks=part.sticks)
                for part in content.segments
            ],
            events=content.events,
            event_samples=content.event_samples,
            damage=content.damage,
            attachments=content.attachments,
            about=content.about,
        )


@contextmanager
def refused(path: Path) -> Iterator[None]:
    """Raise InvalidRecordingError with the file's name if it cannot be read or is invalid."""
    try:
        yield
    except OSError as error:
        raise InvalidRecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
    except ParameterError as error:
        raise InvalidRecordingError(f"{str(path)!r} is not a valid recording: {error}") from None


_FIELDS: Mapping[str, Field] = {entry.name: entry for entry in (*FIELDS, *TOTALS)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples(_Fields, Result):
    """All N samples of a recording; fields are attributes, such as `samples.position`.

    Attributes:
        arrays: Fields by name, (N,) or (N, 6), read-only; NaN for values missing in the file.
        units: Unit of each column, such as `position.z`; empty for integers.
        segment: Segment index of each sample, from 0, (N,).
        recording: The recording, with setups, metadata, events, attachments and damage.
    """

    arrays: Mapping[str, Array]
    segment: NDArray[np.int64]
    recording: Recording

    def __len__(self) -> int:
        return len(self.segment)

    def _headline(self) -> str:
        return self.recording.headline

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        return dict(unit for name in self.arrays for unit in _FIELDS[name].units)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns by name, (N,) each.

        `segment` is the first, then those of `units`. Columns without a unit are integers.
        """
        columns: dict[str, NDArray[Any]] = {"segment": self.segment}
        for name, values in self.arrays.items():
            field = _FIELDS[name]
            for index, (column, unit) in enumerate(field.units):
                part = values[:, index] if field.six else values
                columns[column] = part if unit or np.isnan(part).any() else part.astype(np.int64)
        return columns

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return self.recording.conditions

    pictures: ClassVar = {"samples": "maglev_mj.plants.pictures:samples"}

    def to_pandas(self) -> Any:
        """Return a data frame with one row per sample, units and events in `attrs`.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        frame = super().to_pandas()
        frame.attrs["events"] = list(self.recording.events)
        return frame


@checked
def load_samples(path: Path | str, fields: Sequence[str] | None = None) -> Samples:
    """Read a recording as arrays.

    One hour at 1 kHz takes some seconds and less than 1 GB: constant and duplicate fields are stored once.

    Args:
        path: Path of a journal; a damaged one is read up to the damage, see `recording.damage`.
        fields: Names of the fields to load, such as "time" and "position"; None for all.

    Raises:
        InvalidRecordingError: If the file is missing, not a recording, or invalid.
        ParameterError: If a field name is unknown.

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
        raise ParameterError(f"fields must be among {', '.join(_FIELDS)} (got {unknown[0]!r})")
    return _read(path, frozenset({"tick", *names})).samples(names)
