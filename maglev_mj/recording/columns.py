"""Samples kept column by column, each no larger than what is in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.recording.checks import check_rows
from maglev_mj.recording.row import Field, as_rows

__all__ = ["Columns"]

_BLOCK = 1 << 13
_TWINS = {"applied": "command", "applied_pulse": "pulse", "applied_pulse_width": "pulse_width"}
"""Fields that are another to the last bit until the plant meets a limit."""


class Columns:
    """Samples of a stretch, checked block by block.

    A block of a field that is constant is kept as one row, and one that is its twin's not at all.

    Args:
        fields: What a sample has.
        names: Which of them to keep; None for all.
    """

    def __init__(self, fields: Sequence[Field], names: frozenset[str] | None) -> None:
        self._fields, self._count = fields, 0
        kept = [field.name for field in fields if names is None or field.name in names]
        self._blocks: dict[str, list[Array | None]] = {name: [] for name in kept}
        self._sizes: list[int] = []
        self._arrays: dict[str, Array] = {}
        self._waiting: list[Mapping[str, Array]] = []
        self._rows: list[Sequence[float]] = []
        self._sorted = 0
        self._last: dict[str, Array] = {}

    def __len__(self) -> int:
        return self._count

    def add(self, values: Mapping[str, Array]) -> None:
        """Take some samples as arrays of all fields, (N,) or (N, 6)."""
        self._waiting.append(values)
        self._count += len(values["tick"])
        self.sort(_BLOCK)

    def add_row(self, row: Sequence[float]) -> None:
        """Take one sample as the values of its fields."""
        self._rows.append(row)
        self._count += 1
        self.sort(_BLOCK)

    def array(self, name: str) -> Array:
        """Return a field of all samples, (N,) or (N, 6); it is not to be changed."""
        found = self._arrays.get(name)
        if found is None:
            found = self._arrays[name] = self._whole(name)
        return found

    def sort(self, least: int = 1) -> None:
        """Check what waits, and keep it by columns, if it is at least so many samples.

        Raises:
            ParameterError: If a sample is not one that a recording has.
        """
        waiting = self._count - self._sorted
        if waiting < least:
            return
        if self._rows:
            rows = as_rows(self._rows, self._fields)
            self._waiting, self._rows = [{field.name: rows[field.name] for field in self._fields}], []
        names = [field.name for field in self._fields]
        values = {name: np.concatenate([part[name] for part in self._waiting]) for name in names}
        self._waiting, self._sorted = [], self._count
        first = self._count - waiting
        if self._last:  # with the row before, for what goes from row to row
            check = {name: np.concatenate([self._last[name], part]) for name, part in values.items()}
            check_rows(check, first - 1)
        else:
            check_rows(values, first)
        self._last = {name: part[-1:].copy() for name, part in values.items()}
        self._sizes.append(waiting)
        for name, blocks in self._blocks.items():
            blocks.append(_smallest(values, name, _TWINS.get(name) if _TWINS.get(name) in self._blocks else None))

    def _whole(self, name: str) -> Array:
        blocks = self._blocks[name]
        if blocks and all(block is None for block in blocks):
            return self.array(_TWINS[name])
        first = blocks[0] if blocks else None
        if first is not None and all(block is not None and len(block) == 1 and _same(block, first) for block in blocks):
            return np.broadcast_to(first, (self._count, *first.shape[1:]))
        (field,) = (field for field in self._fields if field.name == name)
        found, start = np.empty((self._count, 6) if field.six else self._count), 0
        for place, size in enumerate(self._sizes):
            block, blocks[place] = blocks[place], None  # so that not all of it is there twice
            twin = slice(start, start + size)
            found[twin] = self.array(_TWINS[name])[twin] if block is None else block
            start += size
        return found


def _same(one: Array | None, other: Array | None) -> bool:
    """Whether two arrays are the same to the last bit."""
    return one is not None and other is not None and bool((one.view(np.int64) == other.view(np.int64)).all())


def _smallest(values: Mapping[str, Array], name: str, twin: str | None) -> Array | None:
    """Return a block of a field, one row of it if it is constant, None if it is its twin's."""
    block = values[name]
    if twin is not None and _same(block, values[twin]):
        return None
    return block[:1].copy() if _same(block, np.broadcast_to(block[:1], block.shape)) else block
