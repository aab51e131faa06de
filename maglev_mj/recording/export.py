"""Export of recordings as tables, one row per sample."""

from __future__ import annotations

import base64
import csv
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from maglev_mj.errors import check_instance, check_one_of, file_path, require
from maglev_mj.recording.recording import READ, Recording, aside
from maglev_mj.recording.sample import FIELDS, TOTALS, is_recorded, units

_BLOCK = 1 << 14


def export(recording: Recording, kind: str, path: Path | str) -> None:
    """Write a recording as a table, one row per sample.

    All other content goes with it.

    Args:
        recording: The recording.
        kind: One of EXPORTS; with csv, content other than the table goes to a .json file of the same name beside it.
        path: Path of the new file.

    Raises:
        ParameterError: If the kind is not known.
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
    known = {one.name: values for one in fields if is_recorded(one, values := samples.arrays[one.name])}
    return replace(samples, arrays=known).columns()


def _about(recording: Recording) -> dict[str, Any]:
    """Return the content besides samples, ready for JSON.

    Attachments are in base64.
    """
    attached = {name: base64.b64encode(data).decode() for name, data in recording.attachments.items()}
    return {
        "units": units(),
        "setups": [stretch.setup for stretch in recording.stretches],
        "events": list(recording.events),
        "about": dict(recording.about),
        "damage": recording.damage,
        "attachments": attached,
    }


def _as_csv(recording: Recording, partial: Path, path: Path) -> None:
    named, known = _columns(recording), units()
    with aside(path.with_name(f"{path.name}.json")) as beside:
        beside.write_text(json.dumps(_about(recording), indent=1), encoding="utf-8")
        with partial.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow([f"{name} [{known[name]}]" if known.get(name) else name for name in named])
            for first in range(0, recording.ticks, _BLOCK):
                table.writerows(zip(*(column[first : first + _BLOCK].tolist() for column in named.values())))


def _as_parquet(recording: Recording, partial: Path, _path: Path) -> None:
    require(("pyarrow",), "parquet", "Parquet needs pyarrow")
    import pyarrow
    from pyarrow import parquet

    named, known = {name: pyarrow.array(column) for name, column in _columns(recording).items()}, units()
    fields = [
        pyarrow.field(name, column.type, metadata={"unit": known[name]} if known.get(name) else None)
        for name, column in named.items()
    ]
    about = {f"maglev_mj.{name}": json.dumps(part) for name, part in _about(recording).items()}
    parquet.write_table(pyarrow.table([*named.values()], schema=pyarrow.schema(fields, metadata=about)), partial)


def _as_arrays(recording: Recording, partial: Path, _path: Path) -> None:
    recording.save(partial)


EXPORTS: Mapping[str, Callable[[Recording, Path, Path], Any]] = {
    "npz": _as_arrays,
    "csv": _as_csv,
    "parquet": _as_parquet,
}
"""Export functions by format name.

Each writes a recording to a temporary path; the second path is the final one.
"""
