"""Recording as arrays, of any length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.recording.mcap import Found, Part
from maglev_mj.recording.metadata import RunMetadata, Setup
from maglev_mj.recording.recording import Recording, Stretch, read_file
from maglev_mj.recording.row import FIELDS, TOTALS, Field
from maglev_mj.result import Result

_FIELDS: Mapping[str, Field] = {field.name: field for field in (*FIELDS, *TOTALS)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples(Result):
    """All N samples of a recording, fields as attributes.

    For example `samples.position`.

    Attributes:
        arrays: Fields by name, (N,) or (N, 6), not to be changed; NaN for values missing in the file.
        units: Unit of each column, such as `position.z`; empty for a whole number.
        stretch: Number of the stretch of each sample, from 0, (N,).
        setups: Setup of each stretch.
        metadata: Metadata of each stretch; None in older files without them.
        events: Texts of events for the user, such as faults.
        about: Format of the file and versions of the code that made it; empty in older files.
        attachments: Attached files by name.
        damage: Description of damage to the file; empty for none.
    """

    arrays: Mapping[str, Array]
    stretch: NDArray[np.int64]
    setups: Sequence[Setup]
    metadata: Sequence[RunMetadata | None]
    events: Sequence[str]
    about: Mapping[str, str]
    attachments: Mapping[str, bytes]
    damage: str
    drawn_by: ClassVar = "maglev_mj.plots.recorded:samples"

    def __getattr__(self, name: str) -> Array:
        arrays = self.__dict__.get("arrays", {})
        if name not in arrays:
            raise AttributeError(f"the samples have no {name!r}: it was not loaded, or is no field")
        return np.asarray(arrays[name])

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
        found: dict[str, NDArray[Any]] = {"stretch": self.stretch}
        for name, values in self.arrays.items():
            field = _FIELDS[name]
            for place, (column, unit) in enumerate(field.units):
                part = values[:, place] if field.six else values
                found[column] = part if unit or np.isnan(part).any() else part.astype(np.int64)
        return found

    def to_pandas(self) -> Any:
        """Return a data frame with one row per sample.

        Its `attrs` hold units and events.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        frame = super().to_pandas()
        frame.attrs["events"] = list(self.events)
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
    return samples_of(read_file(path, frozenset(names)), names)


def samples_of(found: Recording | Found, names: Sequence[str]) -> Samples:
    """Return fields of a read recording as arrays."""
    parts: Sequence[Stretch | Part]
    if isinstance(found, Recording):
        parts = found.stretches
    else:
        parts = [part for part in found.parts if len(part)]
    arrays = {name: _joined([_array(part, name) for part in parts], name) for name in names}
    sizes = [len(part) for part in parts]
    return Samples(
        arrays=arrays,
        stretch=np.repeat(np.arange(len(sizes)), sizes),
        setups=[part.setup for part in parts],
        metadata=[part.metadata for part in parts],
        events=found.events,
        about=found.about,
        attachments=found.attachments,
        damage=found.damage,
    )


def _array(part: Stretch | Part, name: str) -> Array:
    """Return a field of a stretch; NaN for missing totals."""
    if isinstance(part, Part):
        return part.array(name)
    rows = part.totals if any(name == field.name for field in TOTALS) else part.rows
    return np.full(len(part), np.nan) if rows is None else np.ascontiguousarray(rows[name])


def _joined(parts: Sequence[Array], name: str) -> Array:
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if parts else np.empty((0, 6) if _FIELDS[name].six else 0)
