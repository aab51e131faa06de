"""Export of recordings: NumPy arrays, tables, MCAP, sound."""

from __future__ import annotations

import base64
import csv
import json
import math
import time
import wave
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import check_instance, check_one_of, file_path, require
from maglev_mj.files import atomic_path
from maglev_mj.frames import AXES, Array
from maglev_mj.keywords import checked
from maglev_mj.lazy import loaded
from maglev_mj.recording.formats import FORMATS
from maglev_mj.recording.journal import InvalidRecordingError
from maglev_mj.recording.recording import RECORDING_TYPE, Recording
from maglev_mj.recording.sample import ARRAYS, FIELDS, TOTALS, is_recorded, units
from maglev_mj.versions import versions

_BLOCK = 1 << 14


@checked(own="recording")
def export(recording: Recording, kind: str, path: Path | str) -> None:
    """Export a recording as arrays, a table with one row per sample, MCAP or sound.

    A table has the columns of `Recording.columns`; units and all other content are exported with it.

    Args:
        recording: The recording.
        kind: One of FORMATS; csv writes all content besides the table to PATH.json.
        path: Path of the new file.

    Raises:
        ParameterError: If the kind is unknown, or a sound is requested of a recording without samples.
        MissingPackageError: If a package for the kind is not installed.
        OSError: If the file cannot be written; an existing file is then unchanged.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import export, find_scene, record_run
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     export(record_run(find_scene("drop")(duration=0.1), plant="exact"), "csv", Path(folder, "run.csv"))
        ...     lines = Path(folder, "run.csv").read_text().splitlines()
        >>> [line.split(",")[:2] for line in lines if not line.startswith("#")][:2]
        [['segment', 'tick'], ['0', '0']]
    """
    check_one_of("to", FORMATS, kind)
    check_instance("recording", recording, Recording, RECORDING_TYPE)
    path = file_path(path)
    with atomic_path(path) as partial:
        loaded(FORMATS[kind].writer)(recording, partial, path)


def as_npz(recording: Recording, partial: Path, _path: Path) -> None:
    """Write arrays, one per value and segment; see `Format.writer`."""
    arrays: dict[str, Any] = {
        f"attachment/{index}": np.frombuffer(data, np.uint8)
        for index, data in enumerate(recording.attachments.values())
    }
    stored = {**ARRAYS, **{field.name: [field] for field in TOTALS}}
    for index, segment in enumerate(recording.segments):
        for name, fields in stored.items():
            columns = [segment.arrays[field.name] for field in fields if field.name in segment.arrays]
            if any(is_recorded(field, values) for field, values in zip(fields, columns)):
                arrays[f"{index}/{name}"] = columns[0] if len(columns) == 1 else np.column_stack(columns)
    header = _context(recording, list(recording.attachments)) | {
        "format": "maglev_mj recording 1",
        "axes": AXES,
        "gaps": [list(segment.gaps) for segment in recording.segments],
        "event_samples": list(recording.event_samples),
    }
    with partial.open("wb") as file:
        np.savez(file, header=np.array(json.dumps(header)), **arrays)


_METADATA = "maglev_mj"  # name of the metadata record
_CHUNK = 1 << 16


class _DeferredErrorFile:
    """File that stores its first error and ignores later writes: foxglove-sdk prints errors and continues.

    Args:
        file: Open binary file.

    Attributes:
        error: The first error, or None.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.error: OSError | None = None

    def write(self, data: bytes | bytearray) -> int:
        """Write data."""
        self._call(self._file.write, data)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Set the position and return it."""
        position = self._call(self._file.seek, offset, whence)
        return offset if position is None else int(position)

    def flush(self) -> None:
        """Flush the buffer."""
        self._call(self._file.flush)

    def _call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return function(*arguments) if self.error is None else None
        except OSError as error:
            self.error = error
            return None


def as_mcap(recording: Recording, partial: Path, _path: Path) -> None:
    """Write messages with time; see `Format.writer`."""
    require(("foxglove", "google.protobuf"), "mcap", "MCAP needs foxglove-sdk and protobuf")
    from foxglove import Context, open_mcap
    from foxglove.mcap import MCAPWriteOptions

    from maglev_mj.recording.messages import Messages

    context = Context()  # channels close when it is garbage-collected
    options = MCAPWriteOptions(profile="", chunk_size=_CHUNK, compression_threads=0, disable_seeking=True)
    metadata = {"units": json.dumps(units()), **(recording.about or versions())}
    with partial.open("wb") as opened:
        file = _DeferredErrorFile(opened)
        writer = open_mcap(file, context=context, writer_options=options)
        writer.write_metadata(_METADATA, metadata)
        now = time.time_ns()
        for name, data in recording.attachments.items():
            media_type = "application/xml" if name.endswith(".xml") else "text/x-python"
            writer.attach(log_time=now, create_time=now, name=name, media_type=media_type, data=data)
        messages = Messages(context)
        for kind, part in recording.parts():
            if kind == "begin":
                messages.begin(part.setup, 1000 * part.began)
            elif kind == "rows":
                messages.rows(part)
            elif kind == "stick":
                messages.stick(part)
            else:
                messages.event(*part)
        writer.close()
        file.flush()
        if file.error is not None:
            raise file.error


def _columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """Return the recorded columns of all samples, (N,) each."""
    segments = recording.segments
    fields = [*FIELDS, *(total for total in TOTALS if segments and all(total.name in part.arrays for part in segments))]
    samples = recording.samples([field.name for field in fields])
    recorded = {field.name: values for field in fields if is_recorded(field, values := samples.arrays[field.name])}
    return replace(samples, arrays=recorded).columns()


def _context(recording: Recording, attachments: Any) -> dict[str, Any]:
    """Return all content besides samples as JSON values."""
    return {
        "units": units(),
        "setups": [segment.setup for segment in recording.segments],
        "events": list(recording.events),
        "about": dict(recording.about),
        "damage": recording.damage,
        "attachments": attachments,
    }


def _encoded(recording: Recording) -> dict[str, Any]:
    """Return all content besides samples, attachments in base64."""
    return _context(recording, {name: base64.b64encode(data).decode() for name, data in recording.attachments.items()})


def as_csv(recording: Recording, partial: Path, path: Path) -> None:
    """Write a text table, and everything else beside it; see `Format.writer`."""
    columns = _columns(recording)
    with atomic_path(path.with_name(f"{path.name}.json")) as context:
        context.write_text(json.dumps(_encoded(recording), indent=1), encoding="utf-8")
        with partial.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(columns)
            for first in range(0, recording.ticks, _BLOCK):
                table.writerows(zip(*(column[first : first + _BLOCK].tolist() for column in columns.values())))


def as_parquet(recording: Recording, partial: Path, _path: Path) -> None:
    """Write a table, and everything else as its metadata; see `Format.writer`."""
    require(("pyarrow",), "parquet", "Parquet needs pyarrow")
    import pyarrow
    from pyarrow import parquet

    columns, unit_of = {name: pyarrow.array(column) for name, column in _columns(recording).items()}, units()
    fields = [
        pyarrow.field(name, column.type, metadata={"unit": unit_of[name]} if unit_of.get(name) else None)
        for name, column in columns.items()
    ]
    context = {f"maglev_mj.{name}": json.dumps(part) for name, part in _encoded(recording).items()}
    parquet.write_table(pyarrow.table([*columns.values()], schema=pyarrow.schema(fields, metadata=context)), partial)


_SOUND_RATE, _CUTOFF, _FULL_SCALE = 48_000, 20.0, (50.0, 1.0)
"""Sample rate [Hz], high-pass cutoff [Hz] and full scale [N, N m] of a sound."""

_STEP = 0.005  # longest step of the high-pass filter [s]


def as_wav(recording: Recording, partial: Path, _path: Path) -> None:
    """Write the held force as sound; see `Format.writer`."""
    if not recording.ticks:
        raise InvalidRecordingError("nothing to export to wav: the recording has no samples")
    parts = [(segment.applied, segment.metadata.period) for segment in recording.segments]
    with partial.open("wb") as file:
        write_sound(file, parts, turns=AXES.index(recording.segments[0].metadata.axis) > 2)


def write_sound(file: IO[bytes], parts: Sequence[tuple[Array, float]], *, turns: bool) -> None:
    """Write held forces as WAV, on the axis with the largest changes.

    Args:
        file: Open file.
        parts: Consecutive wrenches [N, N m], (N, 6), with the duration of each sample [s].
        turns: True for torque, False for force.
    """
    forces = [np.nan_to_num(wrench[:, 3:] if turns else wrench[:, :3]) for wrench, _ in parts]
    axis = int(np.argmax(sum(np.square(np.diff(force, axis=0)).sum(axis=0) for force in forces)))
    with wave.open(file, "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(_SOUND_RATE)
        for (_, period), force in zip(parts, forces, strict=True):
            count = math.ceil(period / _STEP)  # the filter decays within a longer sample
            signal = _high_pass(np.repeat(force[:, axis], count), period / count) / _FULL_SCALE[turns]
            frames = np.round(np.clip(signal, -1.0, 1.0) * 32767).astype("<i2")
            edges = np.round(np.arange(len(frames) + 1) * (period / count * _SOUND_RATE)).astype(np.int64)
            for first in range(0, len(frames), _BLOCK):  # an hour is 350 MB
                held = np.diff(edges[first : first + _BLOCK + 1])
                sound.writeframes(np.repeat(frames[first : first + _BLOCK], held).tobytes())


def _high_pass(values: Array, period: float) -> Array:
    """Return values (N,) filtered by a first-order high-pass with initial state 0."""
    decay, state = float(np.exp(-2.0 * np.pi * _CUTOFF * period)), 0.0
    out = []
    for change in np.diff(values, prepend=values[:1]).tolist():
        state = decay * (state + change)
        out.append(state)
    return np.array(out)
