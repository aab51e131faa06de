"""Recordings as tables for other programs: NumPy arrays, comma-separated values, Parquet."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array
from maglev_mj.recording.schemas import COLUMNS, flat
from maglev_mj.recording.stretch import Recording, aside

__all__ = ["EXPORTS", "ParquetMissingError", "export"]


class ParquetMissingError(MaglevError):
    """The package that writes Parquet is not installed."""


def export(recording: Recording, kind: str, path: Path) -> None:
    """Write a recording as a table, a row for each sample.

    Args:
        recording: The recording.
        kind: One of EXPORTS.
        path: Where to.

    Raises:
        ParameterError: If the kind is not known.
        ParquetMissingError: If Parquet is asked for, and the package for it is not installed.
        OSError: If it cannot be written; then what was there stays.
    """
    if kind not in EXPORTS:
        raise ParameterError(f"to must be one of {', '.join(EXPORTS)}, not {kind!r}")
    with aside(path) as partial:
        EXPORTS[kind](recording, partial)


def _rows(recording: Recording) -> Iterator[list[float]]:
    for number, stretch in enumerate(recording.stretches):
        head = np.column_stack([stretch.tick, stretch.time])
        parts = np.hstack([head, stretch.position, stretch.command, stretch.applied, stretch.hand])
        for row in parts.tolist():
            yield flat(number, row)


def _as_csv(recording: Recording, path: Path) -> None:
    whole = sum(not unit for _, unit in COLUMNS)  # stretch and tick, which come first
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([f"{name} [{unit}]" if unit else name for name, unit in COLUMNS])
        for row in _rows(recording):
            table.writerow([*(int(value) for value in row[:whole]), *row[whole:]])


def _as_parquet(recording: Recording, path: Path) -> None:
    if find_spec("pyarrow") is None:
        raise ParquetMissingError("Parquet needs pyarrow: pip install 'maglev-mj[parquet]'")
    import pyarrow
    from pyarrow import parquet

    values: Array = np.array(list(_rows(recording)), dtype=np.float64).reshape(-1, len(COLUMNS))
    fields, columns = [], []
    for (name, unit), column in zip(COLUMNS, values.T, strict=True):
        kind = pyarrow.float64() if unit else pyarrow.int64()
        fields.append(pyarrow.field(name, kind, metadata={"unit": unit} if unit else None))
        columns.append(pyarrow.array(column if unit else column.astype(np.int64), type=kind))
    about = {"maglev_mj.setups": json.dumps([dict(stretch.setup) for stretch in recording.stretches])}
    parquet.write_table(pyarrow.table(columns, schema=pyarrow.schema(fields, metadata=about)), path)


def _as_arrays(recording: Recording, path: Path) -> None:
    recording.save(path)


EXPORTS: Mapping[str, Callable[[Recording, Path], Any]] = {
    "npz": _as_arrays,
    "csv": _as_csv,
    "parquet": _as_parquet,
}
"""What a recording is exported to; each function writes a recording to a path."""
