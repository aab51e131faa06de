"""Recordings in memory and as files of arrays."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from dataclasses import replace as replaced
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, ClassVar
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import MaglevError, ParameterError, check_instance, file_path
from maglev_mj.frames import AXES, Array
from maglev_mj.recording.checks import (
    Allowance,
    UnpackingError,
    check_rows,
    check_setup,
    list_in,
    object_in,
    parsed,
    text_in,
    whole,
)
from maglev_mj.recording.metadata import RunMetadata, Setup
from maglev_mj.recording.row import ARRAYS, FIELDS, ROW, TOTALS, Rows, as_rows, told, units
from maglev_mj.result import Result, Table

if TYPE_CHECKING:
    from maglev_mj.recording.mcap import Found
    from maglev_mj.recording.samples import Samples

_ZIP = b"PK"
_FORMAT = "maglev_mj recording 1"

READ = "a Recording, as Recording.load(FILE) returns"
"""Allowed values of a recording, for messages."""


class RecordingError(MaglevError):
    """Error of a recording: it cannot be written or replayed."""


class InvalidRecordingError(RecordingError, ParameterError):
    """A file is not a recording, or has invalid content."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """N samples under one controller.

    Each field of a sample is an attribute too: `stretch.position` is `stretch.rows["position"]`, (N, 6).

    Attributes:
        setup: Setup of plant and controller, without the metadata.
        rows: The samples, (N,), a structured array of `maglev_mj.recording.ROW`; a command is not finite if the plant
            refused it for that reason.
        totals: Energy absorbed by the rendered world [J], work of the hand [J] and missed samples, each from the
            beginning on, (N,); None if not recorded.
        metadata: Metadata; None in older files without them.
        gaps: Samples missed without a gap in the ticks: row that follows, and number.
    """

    setup: Setup
    rows: Rows
    totals: Rows | None = None
    metadata: RunMetadata | None = None
    gaps: Sequence[tuple[int, int]] = ()

    def __getattr__(self, name: str) -> Array:
        rows = self.__dict__.get("rows")
        if rows is None or name not in rows.dtype.names:
            raise AttributeError(f"a stretch has no {name!r}")
        return np.asarray(rows[name])

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def whole_setup(self) -> dict[str, Any]:
        """Setup including the metadata, as stored in a file."""
        return {**self.setup, **({} if self.metadata is None else {"run": self.metadata.as_json()})}

    @property
    def known_hand(self) -> Array:
        """Hand's wrench [N, N m], (N, 6); zero if unknown."""
        return np.nan_to_num(self.hand)

    def part(self, first: int, last: int) -> Stretch:
        """Return the samples from one row to another, both included.

        Totals and gaps are left out.
        """
        return replaced(self, rows=self.rows[first : last + 1], totals=None, gaps=())

    def replace(self, **values: Any) -> Stretch:
        """Return a copy with other values of some fields.

        Arrays of the stretch's length by field name.
        """
        rows = self.rows.copy()
        for name, value in values.items():
            rows[name] = value
        return replaced(self, rows=rows)


@dataclass(frozen=True, eq=False)
class Recording(Result):
    """Recording of one run.

    Attributes:
        stretches: Stretches in order of time.
        events: Texts of events for the user, such as faults.
        event_samples: Number of samples before each event; empty in files without it.
        damage: Description of damage to the file, such as a missing end; empty for none.
        attachments: Attached files by name.
        about: Format of the file and versions of the code that made it; empty in older files.

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
    drawn_by: ClassVar = "maglev_mj.plots.recorded:recording"

    def __post_init__(self) -> None:
        check_instance("stretches", self.stretches, list | tuple, "a list of Stretch, as Recording.load(FILE) reads")

    def samples(self) -> Samples:
        """Return all samples of all stretches as arrays."""
        from maglev_mj.recording.samples import samples_of  # which needs what is defined here

        return samples_of(self, [one.name for one in FIELDS])

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of all samples, (N,) each; see `Samples.columns`."""
        return self.samples().columns()

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        return units()

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
        arrays: dict[str, Any] = {
            f"{index}/{name}": _array_of(stretch.rows, name)
            for index, stretch in enumerate(self.stretches)
            for name, fields in ARRAYS.items()
            if any(told(one, stretch.rows[one.name]) for one in fields)
        }
        for index, stretch in enumerate(self.stretches):
            if stretch.totals is not None:
                arrays |= {f"{index}/{one.name}": stretch.totals[one.name] for one in TOTALS}
        setups = [stretch.whole_setup for stretch in self.stretches]
        arrays |= {f"attachment/{place}": _bytes(data) for place, data in enumerate(self.attachments.values())}
        header: dict[str, Any] = {
            "format": _FORMAT,
            "axes": AXES,
            "units": units(),
            "gaps": [list(stretch.gaps) for stretch in self.stretches],
            "setups": setups,
            "events": list(self.events),
            "damage": self.damage,
            "attachments": list(self.attachments),
            "about": dict(self.about),
        }
        if self.event_samples:
            header["event_samples"] = list(self.event_samples)
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
        found = read_file(path)
        return found if isinstance(found, Recording) else _recording(found)

    @property
    def ticks(self) -> int:
        """Total number of samples."""
        return sum(len(stretch) for stretch in self.stretches)


def read_file(path: Path | str, names: frozenset[str] | None = None) -> Recording | Found:
    """Read a file of either format.

    Args:
        path: The file.
        names: Fields of an MCAP file to keep; None for all.

    Raises:
        MissingPackageError: If an MCAP file needs a package that is not installed.
        InvalidRecordingError: See `Recording.load`.
    """
    from maglev_mj.recording.mcap import MAGIC, read_mcap  # it imports this module

    path = file_path(path)
    try:
        with path.open("rb", buffering=1 << 20) as file:
            size, first = os.fstat(file.fileno()).st_size, file.read(len(MAGIC))
            file.seek(0)
            if first[:2] not in (MAGIC[:2], _ZIP):
                raise ParameterError("it is neither MCAP nor .npz")
            return read_mcap(file, size, names) if first == MAGIC else _read_arrays(file, size)
    except OSError as error:
        raise InvalidRecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
    except ParameterError as error:
        raise InvalidRecordingError(f"{str(path)!r} is not a whole recording: {error}") from None


def _recording(found: Found) -> Recording:
    """Return the content of an MCAP file as a recording."""
    stretches = []
    for part in found.parts:
        if not len(part):
            continue
        tables = []
        for fields in (FIELDS, TOTALS):
            rows = as_rows(np.empty((len(part), sum(len(one.units) for one in fields))), fields)
            for one in fields:
                rows[one.name] = part.array(one.name)
            tables.append(rows)
        rows, totals = tables
        stretches.append(Stretch(setup=part.setup, rows=rows, totals=totals, metadata=part.metadata, gaps=part.gaps))
    return Recording(
        stretches,
        events=found.events,
        event_samples=found.event_samples,
        damage=found.damage,
        attachments=found.attachments,
        about=found.about,
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


def split_setup(value: Any) -> tuple[Setup, RunMetadata | None]:
    """Return setup and metadata of a file's setup entry.

    Raises:
        ParameterError: If it is not a setup, or a value is missing or out of range.
    """
    setup = dict(check_setup(value))
    run = setup.pop("run", None)
    return setup, None if run is None else RunMetadata.from_json(object_in({"run": run}, "run"))


def _bytes(data: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8)


def _array_of(rows: Rows, name: str) -> Array:
    """Return one array of a file: one or several fields."""
    values: list[Array] = [rows[field.name] for field in ARRAYS[name]]
    return np.ascontiguousarray(values[0] if len(values) == 1 else np.column_stack(values))


def _read_arrays(file: IO[bytes], size: int) -> Recording:
    """Read an .npz file of `size` bytes.

    Raises:
        ParameterError: If it holds no recording or an invalid one.
        OSError: If it cannot be read.
    """
    allowance = Allowance(size)
    try:
        with ZipFile(file) as archive:
            header = _header(archive, allowance)
            setups = header["setups"]
            if not isinstance(setups, list):
                raise ParameterError("setups must be a list")
            gaps = list_in(header, "gaps") if "gaps" in header else [[] for _ in setups]
            stretches = [
                _stretch(archive, allowance, *one) for one in zip(range(len(setups)), setups, gaps, strict=True)
            ]
            attachments = {
                text_in({"attachment": name}, "attachment"): bytes(_array(archive, allowance, f"attachment/{place}"))
                for place, name in enumerate(header.get("attachments", ()))
            }
            about = {name: text_in(header["about"], name) for name in header.get("about", ())}
            damage = text_in(header, "damage") if "damage" in header else ""
    except (OSError, ParameterError):
        raise
    except UnpackingError as error:
        raise ParameterError(str(error)) from None
    except Exception:  # errors of zip files, unpacking and headers: a damaged file fails in many ways
        raise ParameterError("it is damaged") from None
    events = header.get("events", [])
    if not isinstance(events, list):
        raise ParameterError("events must be a list")
    texts = tuple(text_in({"event": event}, "event") for event in events)
    counts = list_in(header, "event_samples") if "event_samples" in header else ()
    samples = tuple(whole({"event_samples": count}, "event_samples") for count in counts)
    return Recording(
        stretches, events=texts, event_samples=samples, damage=damage, attachments=attachments, about=about
    )


def _header(archive: ZipFile, allowance: Allowance) -> Mapping[str, Any]:
    text = str(_array(archive, allowance, "header"))
    allowance.text(len(text))
    header = parsed(text)
    if text_in(header, "format") != _FORMAT:
        raise ParameterError(f"format must be {_FORMAT!r}, not {header['format']!r}")
    return dict(header)


def _stretch(archive: ZipFile, allowance: Allowance, index: int, setup: Any, gaps: Any) -> Stretch:
    names = set(archive.namelist())
    found = {
        name: _column(_array(archive, allowance, f"{index}/{name}"), sum(len(field.units) for field in fields), name)
        for name, fields in _STORED.items()
        if f"{index}/{name}.npy" in names or not all(field.optional or field in TOTALS for field in fields)
    }
    lengths = {len(values) for values in found.values()}
    if len(lengths) > 1:
        raise ParameterError(f"the arrays of stretch {index} must be of one length")
    size, whole_totals = lengths.pop(), all(field.name in found for field in TOTALS)
    rows, totals = np.full(size, np.nan, dtype=ROW), as_rows(np.full((size, len(TOTALS)), np.nan), TOTALS)
    for name, values in found.items():
        start, columns = 0, values.reshape(size, -1)
        for one in _STORED[name]:
            part = columns[:, start : start + len(one.units)]
            (totals if one in TOTALS else rows)[one.name] = part if one.six else part[:, 0]
            start += len(one.units)
    tables = (rows, totals) if whole_totals else (rows,)
    check_rows({name: table[name] for table in tables for name in table.dtype.names or ()})
    missed = [(whole({"a gap": row}, "a gap", at_most=size), whole({"a gap": count}, "a gap")) for row, count in gaps]
    made_from, metadata = split_setup(setup)
    known = totals if whole_totals else None
    return Stretch(setup=made_from, rows=rows, totals=known, metadata=metadata, gaps=missed)


_STORED = {**ARRAYS, **{field.name: [field] for field in TOTALS}}
"""Fields in each array of a stretch."""


def _array(archive: ZipFile, allowance: Allowance, name: str) -> Any:
    """Return an array after checking its size."""
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type != ZIP_STORED:
        allowance.part(info.file_size)
    elif info.file_size != info.compress_size:
        raise UnpackingError(f"{name} must have one size, not {info.file_size} and {info.compress_size}")
    with archive.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _column(array: Any, count: int, name: str) -> Array:
    if array.dtype != np.float64 or array.ndim != (1 if count == 1 else 2) or (count > 1 and array.shape[1] != count):
        shape = "(N,)" if count == 1 else f"(N, {count})"
        raise ParameterError(f"{name} must be numbers {shape}, not {array.dtype} {array.shape}")
    return np.asarray(array)
