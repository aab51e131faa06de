"""Validated content of a journal: segments by column, events, attachments."""

from __future__ import annotations

import base64
import operator
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.parameters import number, whole
from maglev_mj.recording.journal import FORMAT, SAMPLE, TEXT, VERSION, JournalContent, open_journal
from maglev_mj.recording.sample import (
    FIELDS,
    TOTALS,
    Rows,
    RunMetadata,
    Setup,
    Totals,
    check_rows,
    check_setup,
    value_in,
)
from maglev_mj.versions import validated_versions

_TWINS = {"applied": "command", "applied_pulse": "pulse", "applied_pulse_width": "pulse_width"}
"""Fields bitwise equal to another unless a limit acts."""

_TOTAL_NAMES = [field.name for field in TOTALS]
_BLOCK = 1 << 11  # samples validated and stored at a time


class SegmentContent:
    """Samples of a segment, by column; constant and duplicate columns are stored once.

    Args:
        message: Message at the start of the segment.
        names: Fields to load; None for all.

    Attributes:
        setup: Setup of plant and controller.
        began: Start time since 1970 [µs].
        gaps: (row, count) of samples missed before a row without a gap in the tick numbers.
        sticks: (row, position) of the stick position from a row on, six components or None.
    """

    def __init__(self, message: Mapping[str, Any], names: frozenset[str] | None) -> None:
        self.setup: Setup = check_setup(value_in(message, "begin", dict))
        self.began = whole("time", value_in(message, "time"))
        self.gaps: list[tuple[int, int]] = []
        self.sticks: list[tuple[int, Sequence[float] | None]] = []
        metadata = RunMetadata.from_json(value_in(self.setup, "run", dict))
        loaded = [field.name for field in (*FIELDS, *TOTALS) if names is None or field.name in names]
        self._totals = None if set(_TOTAL_NAMES).isdisjoint(loaded) else Totals(metadata)
        self._blocks: dict[str, list[Array]] = {name: [] for name in loaded}
        self._last: dict[str, Array] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, samples: Rows) -> None:
        """Validate and store samples, a structured array (N,) with the fields of the file.

        Raises:
            ParameterError: If a sample is invalid.
        """
        present = samples.dtype.names or ()
        values = {
            field.name: np.ascontiguousarray(samples[field.name])
            if field.name in present
            else np.full((len(samples), 6) if field.six else len(samples), np.nan)
            for field in FIELDS
        }
        # include the previous row, for checks between rows
        rows = {name: np.concatenate([self._last.get(name, part[:0]), part]) for name, part in values.items()}
        check_rows(rows, max(self._count - 1, 0))
        self._count += len(samples)
        self._last = {field.name: values[field.name][-1:].copy() for field in FIELDS}
        if self._totals is not None:
            values |= zip(_TOTAL_NAMES, self._totals.take(values).T)
        stored = {name: _collapse_constant(values[name]) for name in values}
        stored |= {name: stored[twin] for name, twin in _TWINS.items() if _same(values[name], values[twin])}
        for name, blocks in self._blocks.items():
            blocks.append(stored[name])

    def miss(self, count: int) -> None:
        """Add missed samples that leave no gap in the tick numbers."""
        self.gaps.append((self._count, count))
        if self._totals is not None:
            self._totals.miss(count)

    def arrays(self) -> Mapping[str, Array]:
        """Return the fields of all samples, (N,) or (N, 6) each, read-only."""
        blocks = self._blocks
        twins = {name: twin for name, twin in _TWINS.items() if {name, twin} <= blocks.keys()}
        copies = {name: twin for name, twin in twins.items() if all(map(operator.is_, blocks[name], blocks[twin]))}
        arrays = {name: _joined(blocks.pop(name)) for name in list(blocks) if name not in copies}
        return arrays | {name: arrays[twin] for name, twin in copies.items()}


def _same(first: Array, other: Array) -> bool:
    """Return True if two arrays are bitwise equal."""
    return bool((np.ascontiguousarray(first).view(np.int64) == np.ascontiguousarray(other).view(np.int64)).all())


def _collapse_constant(block: Array) -> Array:
    constant = np.broadcast_to(block[:1], block.shape)
    return np.broadcast_to(block[:1].copy(), block.shape) if _same(block, constant) else block


def _joined(blocks: Sequence[Array]) -> Array:
    first, count = blocks[0][:1], sum(map(len, blocks))
    if all(block.strides[0] == 0 and _same(block[:1], first) for block in blocks):
        return np.broadcast_to(first, (count, *first.shape[1:]))
    return np.concatenate(blocks)


class Content:
    """Content of a recording.

    Args:
        path: Path of the journal.
        names: Fields to load; None for all.

    Attributes:
        segments: Segments with samples, in order of time.
        events: Texts of the events.
        event_samples: Number of samples before each event.
        attachments: Attached files by name.
        about: File format, and versions of the code that wrote it.
        damage: Description of the damage at which the content ends; empty if intact.

    Raises:
        ParameterError: If it is not a journal, or its content is invalid.
        OSError: If it cannot be read.
    """

    def __init__(self, path: Path, names: frozenset[str] | None = None) -> None:
        journal = open_journal(path)
        self.segments: list[SegmentContent] = []
        self.events: list[str] = []
        self.event_samples: list[int] = []
        self.attachments: dict[str, bytes] = {}
        self.about = {"format": f"{FORMAT} {VERSION}", **(validated_versions(journal.header.get("versions")) or {})}
        self._names, self._time, self._proven = names, 0.0, True
        self._end: int | None = None  # index after the end record
        damage = journal.damage or "incomplete (not closed)"
        for first, last in _runs(journal):
            self._proven = last <= journal.proven
            try:
                self._take(journal, first, last)
            except ParameterError as error:
                if self._proven:
                    raise  # it was written so
                damage = f"{error} (damaged)"
                break
            if self._end is not None:
                break
        self.segments = [segment for segment in self.segments if len(segment)]
        if self._end is None:
            end = f"readable up to {self._time:.1f} s" if self.segments else "no samples"
            damage = f"{damage}: {end}"
        else:
            least = 0 if self._proven else journal.records.dtype.itemsize - 1  # its checksum may be truncated
            damage = "data after the end record" * (journal.rest > least or len(journal.records) > self._end)
        self.damage = "; ".join(filter(None, (journal.repaired, damage)))

    def _take(self, journal: JournalContent, first: int, last: int) -> None:
        """Process the records of some blocks up to the end record."""
        kinds = journal.kinds[first:last]
        samples = first + np.flatnonzero(kinds == SAMPLE)
        start = 0
        for text in (first + np.flatnonzero(kinds == TEXT)).tolist():
            end = int(np.searchsorted(samples, text))
            self._add(journal, samples[start:end])
            if "end" in (message := journal.message(text)):
                self._end = text + 1
                return
            self._message(message)
            start = end
        self._add(journal, samples[start:])

    def _add(self, journal: JournalContent, indices: Any) -> None:
        if not len(indices):
            return
        if not self.segments:
            raise ParameterError("sample before the first segment")
        for start in range(0, len(indices), _BLOCK):
            self._add_rows(journal.records[indices[start : start + _BLOCK]])

    def _add_rows(self, rows: Rows) -> None:
        """Add samples; if a checksum does not prove them, all before the first invalid one."""
        try:
            self.segments[-1].add(rows)
            self._time = float(rows["time"][-1])
        except ParameterError:
            if self._proven or len(rows) == 1:
                raise
            half = len(rows) // 2
            self._add_rows(rows[:half])
            self._add_rows(rows[half:])

    def _message(self, message: Mapping[str, Any]) -> None:
        """Process a message; unknown ones are ignored."""
        if "begin" in message:
            self.segments.append(SegmentContent(message, self._names))
        elif "event" in message:
            self.events.append(f"{value_in(message, 'event', str)}: {value_in(message, 'text', str)}")
            self.event_samples.append(sum(map(len, self.segments)))
            if (missed := whole("missed", value_in(message, "missed"))) and self.segments:
                self.segments[-1].miss(missed)
        elif "stick" in message and self.segments:
            self.segments[-1].sticks.append((len(self.segments[-1]), _stick(message["stick"])))
        elif "attach" in message:
            try:
                data = base64.b64decode(value_in(message, "data", str), validate=True)
            except ValueError:
                raise ParameterError("data of an attachment must be base64") from None
            self.attachments.setdefault(value_in(message, "attach", str), data)


def _runs(journal: JournalContent) -> Iterator[tuple[int, int]]:
    """Yield record ranges [first, last) of several blocks each, as blocks are short; one without a checksum alone."""
    start = end = 0
    for last in journal.ends:
        if (last - start > _BLOCK or last > journal.proven) and end > start:
            yield start, end
            start = end
        end = last
    yield start, end


def _stick(values: Any) -> Sequence[float] | None:
    """Return a stick position, NaN for null; None without friction."""
    if values is None:
        return None
    if not isinstance(values, list) or len(values) != 6:
        raise ParameterError("stick must be a list of six numbers, or null")
    return [np.nan if value is None else number("stick", value) for value in values]
