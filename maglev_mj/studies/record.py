"""Results of a study in columns: packed by workers, stored in a folder, resumed from it.

A record is a folder of `plan.json`, which names study and code, and of shards: tables with a row for each cell, in
Parquet where pyarrow is installed, otherwise `.npz`. Shards are written to a temporary file and renamed, so that a
crash leaves a complete shard or none.
"""

from __future__ import annotations

import json
import math
import os
import struct
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, SupportsIndex, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import MissingPackageError, ParameterError, require
from maglev_mj.files import atomic_path, parse_json, read_text
from maglev_mj.frames import Array
from maglev_mj.result import plain
from maglev_mj.versions import differences, hash_of, validated_versions, versions

Cell: TypeAlias = dict[str, Any]
"""Values of a cell by the parameter's name."""

Columns: TypeAlias = Mapping[str, NDArray[Any]]
"""Results by name, (N,) each, as numbers or as texts of JSON.

Among numbers NaN is None, and ABSENT no value; among texts None is no value.
"""

_ABSENT = struct.pack("<Q", 0x7FF8_0000_0000_0AB5)
ABSENT: float = struct.unpack("<d", _ABSENT)[0]
"""NaN with a distinct bit pattern, preserved in files."""

_INDEX, _BARE, _CHECKSUM, _ERROR = "#", "=", "~", "error"
_PLAN, _PARTIAL = "plan.json", ".partial"
_ROWS = 65_536  # per shard
_PAUSE, _SHARE = 1.0, 10.0  # minimum pause between writes: in seconds, and in durations of the last write


def pack(results: Sequence[Any]) -> Columns:
    """Return results as columns.

    Raises:
        ParameterError: If a result holds anything but values of JSON.
    """
    named = [isinstance(result, dict) and not {_INDEX, _BARE, _CHECKSUM} & result.keys() for result in results]
    rows = [result if row else {_BARE: result} for result, row in zip(results, named, strict=True)]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: _column([row.get(name, ...) for row in rows]) for name in names}


def _column(values: Sequence[Any], *, texts: bool = False) -> NDArray[Any]:
    """Return values as a column; `...` marks a missing value."""
    if not texts and all(value is None or value is ... or isinstance(value, float) for value in values):
        return np.array([ABSENT if value is ... else np.nan if value is None else value for value in values])
    return np.array([None if value is ... else json_text("a result", value) for value in values], dtype=object)


def _value(entry: Any) -> Any:
    """Return the value of a column's entry; `...` if missing."""
    if isinstance(entry, str):
        return json.loads(entry)
    if entry is None or struct.pack("<d", entry) == _ABSENT:
        return ...
    return None if math.isnan(entry) else entry


def json_text(what: str, value: Any, **keywords: Any) -> str:
    """Return a value as text of JSON, with keywords of `json.dumps`.

    Raises:
        ParameterError: If it is not JSON.
    """
    try:
        return json.dumps(value, default=plain, **keywords)
    except RecursionError:
        raise ParameterError(f"{what} must hold values of JSON, which are nested less deeply") from None
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{what} must hold values of JSON (got {value!r}): {error}") from None


class Record(Sequence[Any]):
    """Results of one study by cell, in columns in memory, and optionally in a folder.

    A result is decoded on access.

    Args:
        path: Folder, created with the first result; None for memory only.

    Attributes:
        name: Name of this run, part of its file names.
        columns: Results of all cells, (N,) each.
        done: True for cells with a result, (N,).
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path, self.name = path, os.urandom(4).hex()
        self.begin(())

    def begin(self, cells: Sequence[Cell]) -> None:
        """Begin a study with the results already in the folder.

        Raises:
            ParameterError: If the folder is not a record, or is one of another study or code.
            MissingPackageError: If its shards need pyarrow, which is not installed.
        """
        self.columns: dict[str, NDArray[Any]] = {}
        self.done = np.zeros(len(cells), dtype=bool)
        self._open: list[NDArray[np.int64]] = []  # cells of the last, unfinished shard
        self._full, self._dirty, self._next = 0, False, 0.0
        plan = getattr(cells, "plan", None)
        if plan is None:
            plan = {"cells": hash_of("\n".join(json_text("a cell", cell, sort_keys=True) for cell in cells))}
        self._plan = json.loads(json_text("a cell", {**plan, "versions": versions()}))  # as read back
        if not cells or self.path is None or _is_new(self.path):
            return
        _check(self.path, self._plan)
        for path in sorted(self.path.glob("cells-*")):
            try:
                columns = _read_table(path)
                self.put(columns.pop(_INDEX), columns)
            except MissingPackageError:
                raise
            except Exception:  # a truncated or changed table fails in many ways
                continue  # its cells are computed again

    def __len__(self) -> int:
        return self.done.size

    def __getitem__(self, index: SupportsIndex | slice) -> Any:
        """Return a result, or a list of them."""
        rows = range(len(self))[index]
        if isinstance(rows, range):
            return [self[row] for row in rows]
        entries = {name: _value(column.item(rows)) for name, column in self.columns.items()}
        row = {name: value for name, value in entries.items() if value is not ...}
        return row.get(_BARE, row)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    @property
    def failed(self) -> list[int]:
        """Indices of the cells with an error."""
        texts = self.columns.get(_ERROR, np.zeros(0)).tolist()
        return [index for index, text in enumerate(texts) if text is not None]

    def numbers(self, name: str) -> Array | None:
        """Return a column as numbers, NaN for none; None if it has other values."""
        column: NDArray[Any] = self.columns.get(name, np.full(len(self), np.nan))
        if column.dtype != object:
            return column.copy()
        values = [np.nan if (value := _value(text)) is None or value is ... else value for text in column.tolist()]
        return None if any(isinstance(value, Sequence) for value in values) else np.array(values, dtype=np.float64)

    def put(self, indices: NDArray[np.int64], columns: Columns) -> None:
        """Store results in memory only."""
        for name, part in columns.items():
            have = self.columns.get(name)
            if have is None:
                have = np.full(self.done.size, None if part.dtype == object else ABSENT, dtype=part.dtype)
            elif have.dtype != part.dtype:
                have, part = (
                    one if one.dtype == object else _column([*map(_value, one.tolist())], texts=True)
                    for one in (have, part)
                )
            have[indices] = part
            self.columns[name] = have
        self.done[indices] = True

    def add(self, indices: range, columns: Columns) -> None:
        """Store results for the next write."""
        self._open.append(np.array(indices))
        self.put(self._open[-1], columns)
        self._dirty = True

    def flush(self, *, due: bool = False) -> None:
        """Write results missing in the folder; with `due`, not too soon after the last write."""
        start = time.monotonic()
        if self.path is None or not self._dirty or (due and start < self._next):
            return
        self.path.mkdir(parents=True, exist_ok=True)
        if not (self.path / _PLAN).exists():
            with atomic_path(self.path / _PLAN) as partial:
                partial.write_text(json.dumps(self._plan, indent=1), encoding="utf-8")
        indices = np.concatenate(self._open)
        table = {_INDEX: indices, **{name: column[indices] for name, column in self.columns.items()}}
        kind = ".parquet" if find_spec("pyarrow") else ".npz"
        shard = self.path / f"cells-{self.name}-{self._full:05}{kind}"
        with atomic_path(shard) as partial, partial.open("wb") as file:
            _write_table(kind, table, file)
        self._open, self._dirty = [indices], False
        if indices.size >= _ROWS:
            self._open, self._full = [], self._full + 1
        self._next = time.monotonic() + max(_PAUSE, _SHARE * (time.monotonic() - start))

    def missing(self, most: int) -> Iterator[range]:
        """Yield ranges of at most `most` indices of missing cells."""
        edges = np.flatnonzero(np.diff(self.done, prepend=True, append=True)).tolist()
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            yield from (range(first, min(first + most, stop)) for first in range(start, stop, most))


def _is_new(path: Path) -> bool:
    """Return True if the path holds no record: missing, empty, or partial files only."""
    return not path.exists() or (path.is_dir() and all(_PARTIAL in one.suffixes for one in path.iterdir()))


def _check(path: Path, plan: Mapping[str, Any]) -> None:
    """Raise if the path is not a record of this study and code."""
    try:
        stored = dict(parse_json(read_text(path / _PLAN)))
    except (OSError, ValueError, TypeError):
        old = "; maglev_mj 0.2.0 reads a file of JSON lines" if path.is_file() else ""
        raise ParameterError(
            f"record must be a new or empty folder, or one with {_PLAN} (got {str(path)!r}{old})"
        ) from None
    code = validated_versions(stored.pop("versions", None)) or {}
    others = [name for name in {**plan, **stored} if name != "versions" and stored.get(name) != plan.get(name)]
    if others:
        raise ParameterError(f"record must be of this study (got {str(path)!r}, which differs in {', '.join(others)})")
    if other := differences(code, plan["versions"]):
        raise ParameterError(f"record must be of this code (got {str(path)!r}): {other}; use another, or delete it")


def _checksum(table: Columns) -> int:
    """Return a checksum of names and values; those of the formats do not cover the names."""
    checksum = 0
    for name, column in sorted(table.items()):
        data = json.dumps(column.tolist()).encode() if column.dtype == object else column.tobytes()
        checksum = zlib.crc32(data, zlib.crc32(name.encode(), checksum))
    return checksum


def _write_table(kind: str, table: Columns, file: Any) -> None:
    if kind == ".parquet":
        import pyarrow
        from pyarrow import parquet

        checked = pyarrow.table(table, metadata={_CHECKSUM: str(_checksum(table))})
        parquet.write_table(checked, file, write_page_checksum=True)
        return
    texts = {name: np.bytes_(json.dumps(one.tolist()).encode()) for name, one in table.items() if one.dtype == object}
    columns: dict[str, Any] = {**table, **texts, _CHECKSUM: _checksum(table)}
    np.savez_compressed(file, **columns)


def _read_table(path: Path) -> dict[str, NDArray[Any]]:
    if path.suffix == ".parquet":
        require(("pyarrow",), "parquet", f"{path} needs pyarrow")
        from pyarrow import parquet

        columns = parquet.ParquetFile(path, page_checksum_verification=True).read()
        table = {name: columns[name].to_numpy() for name in columns.column_names}
        checksum = int(columns.schema.metadata[_CHECKSUM.encode()])
    else:
        with path.open("rb") as file, np.load(file) as arrays:  # a truncated archive would leave it open
            table = {name: arrays[name] for name in arrays.files}
        checksum = table.pop(_CHECKSUM).item()
        texts = {name: json.loads(one.item()) for name, one in table.items() if one.dtype.kind == "S"}
        table |= {name: np.array(text, dtype=object) for name, text in texts.items()}
    if checksum != _checksum(table):
        raise ValueError(f"{path} has a wrong checksum")
    return table
