"""Compact storage of samples by column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.recording.checks import check_rows
from maglev_mj.recording.row import Field, as_rows

BLOCK = 1 << 13
"""Number of samples that are checked together."""

_TWINS = {"applied": "command", "applied_pulse": "pulse", "applied_pulse_width": "pulse_width"}
"""Fields that equal another bitwise unless a limit acts."""


class _Column:
    """Values of one field: one row while constant, else array.

    The array grows in place.
    """

    def __init__(self) -> None:
        self._row: Array | None = None
        self._array: Array | None = None
        self._count = 0

    def add(self, block: Array) -> None:
        """Append values, (N,) or (N, 6)."""
        if self._row is None:
            self._row = block[:1].copy()
        start, stop = self._count, self._count + len(block)
        if self._array is None and not _same(block, np.broadcast_to(self._row, block.shape)):
            self._array = np.empty((start, *block.shape[1:]))
            self._array[:] = self._row
        if self._array is not None:
            if stop > len(self._array):  # by the system, which moves pages and copies nothing
                self._array.resize((stop + max(stop >> 5, BLOCK), *block.shape[1:]), refcheck=False)
            self._array[start:stop] = block
        self._count = stop

    def whole(self) -> Array:
        """Return all values."""
        if self._array is None:
            row = np.empty(1) if self._row is None else self._row
            return np.broadcast_to(row, (self._count, *row.shape[1:]))
        if len(self._array) > self._count:
            self._array.resize((self._count, *self._array.shape[1:]), refcheck=False)
        return self._array


class Columns:
    """Samples of a stretch, checked in blocks, stored by column.

    A constant column, and a copy of another, is stored once.

    Args:
        fields: Fields of a sample.
        names: Names of the fields to keep; None for all.
    """

    def __init__(self, fields: Sequence[Field], names: frozenset[str] | None) -> None:
        self._names, self._fields = [field.name for field in fields], fields
        self._columns = {name: _Column() for name in self._names if names is None or name in names}
        self._twins = {name: twin for name, twin in _TWINS.items() if {name, twin} <= set(self._columns)}
        self._waiting: list[Mapping[str, Array]] = []
        self._rows: list[Sequence[float]] = []
        self._last: dict[str, Array] = {}
        self._count = self._sorted = 0

    def __len__(self) -> int:
        return self._count

    def add(self, values: Mapping[str, Array]) -> None:
        """Add samples as arrays of all fields.

        Each is (N,) or (N, 6).
        """
        self._waiting.append(values)
        self._count += len(values["tick"])
        self.sort(BLOCK)

    def add_row(self, row: Sequence[float]) -> None:
        """Add one sample as the values of its fields."""
        self._rows.append(row)
        self._count += 1
        self.sort(BLOCK)

    def array(self, name: str) -> Array:
        """Return a field of all samples, read-only.

        The shape is (N,) or (N, 6).
        """
        return self._columns[self._twins.get(name, name)].whole()

    def sort(self, least: int = 1) -> None:
        """Check and store waiting samples, if at least `least`.

        Raises:
            ParameterError: If a sample is invalid.
        """
        start = self._sorted
        if self._count - start < least:
            return
        if self._rows:
            rows = as_rows(self._rows, self._fields)
            self._waiting, self._rows = [{name: rows[name] for name in self._names}], []
        values, *more = self._waiting
        if more:
            values = {name: np.concatenate([part[name] for part in self._waiting]) for name in self._names}
        self._waiting, self._sorted = [], self._count
        if self._last:  # with the row before, for checks between rows
            check_rows({name: np.concatenate([self._last[name], values[name]]) for name in self._names}, start - 1)
        else:
            check_rows(values, start)
        self._last = {name: part[-1:].copy() for name, part in values.items()}
        for name, twin in list(self._twins.items()):
            if not _same(values[name], values[twin]):
                self._columns[name].add(self._columns[twin].whole()) if start else None
                del self._twins[name]
        for name, column in self._columns.items():
            if name not in self._twins:
                column.add(values[name])


def _same(one: Array, other: Array) -> bool:
    """Return True if two arrays are bitwise equal."""
    return bool((one.view(np.int64) == other.view(np.int64)).all())
