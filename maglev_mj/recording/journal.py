"""Journal: an append-only file of fixed-size records behind a JSON header, written by a thread.

The format is specified in docs/reference/recording.md. A record is two whole numbers, its kind and a size, and one
sample's values as float64. NumPy reads all of them as one array.
"""

from __future__ import annotations

import json
import os
import re
import struct
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.recording.sample import FIELDS, ROW, Field, Rows, parsed, units, value_in
from maglev_mj.versions import versions

SUFFIX = ".maglev"
"""Suffix of a journal's name."""

FORMAT, VERSION = "maglev_mj journal", 1
"""Entries `format` and `version` of the header."""

FLUSH = 0.1
"""Interval at which the thread writes [s]: what a killed process loses at most."""

SAMPLE, TEXT, CONTINUED, CHECKSUM, CYCLE = range(5)
"""Kinds of records. Readers skip others."""

_SYNC = 1.0  # interval at which a run in real time asks the system to write to the disk [s]
_IN_USE = 1.0  # age of an unclosed file's last change below which another program still writes it [s]
_LIMIT = 1 << 16  # records that wait, 22 MB
_NAP = 0.001
_GRANULE = 4096  # bytes that a header is a multiple of
_MOST_HEADER = 1 << 20
_RENAMES_OPEN = os.name != "nt"  # where a file that is written can get its name before it is closed
_HEAD = struct.Struct("<II")
_COUNT = struct.Struct("<I")
PACK_SAMPLE = struct.Struct(f"<{_HEAD.size}x{ROW.itemsize // 8}d").pack
"""Packs the record of a sample, whose kind and size are 0, from its values."""

_FORMATS = {
    "kind": "<u4",
    "size": "<u4",
    **{field.name: "6<f8" if field.six else "<f8" for field in FIELDS},
}
RECORD = np.dtype({"names": list(_FORMATS), "formats": list(_FORMATS.values())})
"""Structured dtype of a record."""

_SIXES = "spots", "pose", "held", "pulsed", "measured", "temperatures"
_CYCLE_FORMATS = {
    **dict.fromkeys(("kind", "tick", "state", "faults"), "<u4"),
    **{"time": "<f8", **dict.fromkeys(_SIXES, "6<f8"), **dict.fromkeys(("width", "delay", "latency"), "<f8")},
}
CYCLE_RECORD = np.dtype({"names": list(_CYCLE_FORMATS), "formats": list(_CYCLE_FORMATS.values())})
"""Structured dtype of a record of kind CYCLE, a cycle of a device; as long as one of a sample."""

PACK_CYCLE = struct.Struct("<4I40d").pack
"""Packs a cycle from its values in the order of its dtype."""

_PAYLOAD = RECORD.itemsize - _HEAD.size


class RecordingError(MaglevError):
    """Error of a recording: it cannot be written or replayed."""


class InvalidRecordingError(RecordingError, ParameterError):
    """A file is not a recording, or has invalid content."""


def microseconds() -> int:
    """Return the time since 1970 [µs]."""
    return time.time_ns() // 1000


def text_records(message: Mapping[str, Any]) -> bytes:
    """Return the records of a message, ready for JSON."""
    return byte_records(json.dumps(message, allow_nan=False).encode())


def byte_records(data: bytes) -> bytes:
    """Return the records of a message's bytes."""
    parts = [data[start : start + _PAYLOAD].ljust(_PAYLOAD) for start in range(0, len(data), _PAYLOAD)]
    heads = [_HEAD.pack(CONTINUED if index else TEXT, len(data)) for index in range(len(parts))]
    return b"".join(head + part for head, part in zip(heads, parts))


def sample_records(rows: Rows) -> bytes:
    """Return the records of samples, a structured array (N,)."""
    records = np.zeros(len(rows), RECORD)
    for name in ROW.names or ():
        records[name] = rows[name]
    return records.tobytes()


def checksum_record(data: bytes) -> bytes:
    """Return the record that closes a block of records."""
    head = _HEAD.pack(CHECKSUM, len(data) // RECORD.itemsize)
    return (head + _COUNT.pack(zlib.crc32(data))).ljust(RECORD.itemsize, b"\0")


def header() -> bytes:
    """Return the header of a new journal: one line of JSON, padded with spaces."""
    entries = {
        "format": FORMAT,
        "version": VERSION,
        "dtype": _dtype_entries(_FORMATS),
        "cycle": _dtype_entries(_CYCLE_FORMATS),
        "units": units(),
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="milliseconds"),
    }
    data = json.dumps(entries).encode()
    size = -(-(len(data) + 24) // _GRANULE) * _GRANULE
    return (b'{"offset": %-8d, ' % size + data[1:]).ljust(size - 1) + b"\n"


def _dtype_entries(formats: Mapping[str, str]) -> Mapping[str, Sequence[str]]:
    return {"names": list(formats), "formats": list(formats.values())}


class Journal:
    """Journal file of a run, written by a thread every 0.1 s.

    It is written under a temporary name until the first sample; an existing file of its name stays until then. After
    an error the thread discards what follows: a run is never disturbed.

    Args:
        path: Path of the file.
        wait: True if a run faster than the disk waits for it; in real time samples are lost instead, and counted.

    Attributes:
        lost: Samples that were lost because 65 536 records waited.

    Raises:
        RecordingError: If another program writes a file of this name.
        OSError: If the file cannot be written.
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        if _is_in_use(path):
            raise RecordingError(f"{path} is being written by another program: give another name")
        self._path, self._wait, self.lost = path, wait, 0
        self._error, self._limit = "", _LIMIT
        self._queue = deque[bytes]()
        self._has_samples = self._named = False
        self._synced, self._urgent = time.monotonic(), False
        self._partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self._file = os.open(self._partial, flags, 0o666)
        try:
            self._write(header())
        except OSError:
            os.close(self._file)
            self._partial.unlink()
            raise
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)
        self._thread.start()

    @property
    def append(self) -> Callable[[bytes], None]:
        """Append a record that PACK_SAMPLE has packed: the queue's own method, which is quick and needs no lock."""
        return self._queue.append

    def has_room(self) -> bool:
        """Return whether a sample may be appended; in a run that may wait, wait until it is so."""
        queue = self._queue
        if len(queue) < self._limit:
            return True
        while self._wait and not self._error:
            time.sleep(_NAP)
            if len(queue) < self._limit:
                return True
        self.lost += 1
        return False

    def text(self, message: Mapping[str, Any], *, urgent: bool = False) -> None:
        """Append a message, ready for JSON; an urgent one is on the disk with the next flush."""
        if not self._error:
            self._urgent |= urgent
            self._queue.append(text_records(message))

    def check(self) -> None:
        """Check that the file is being written.

        Raises:
            RecordingError: If it is not.
        """
        if self._error:
            raise RecordingError(f"{self._path} is not written any more: {self._error}")

    def close(self) -> Path | None:
        """Write what waits and the end; return the file, or None without samples.

        A second call does nothing.

        Raises:
            RecordingError: If the file is incomplete.
        """
        if not self._closing.is_set():
            if self.lost:
                self.text({"event": "lost", "text": self._lost_text, "missed": 0})
            self.text({"end": {"lost": self.lost}})
            self._closing.set()
            self._thread.join()
            os.close(self._file)
            self._finish()
        if self._error:
            raise RecordingError(f"{self._path} is not whole: {self._error}")
        if self.lost:
            raise RecordingError(f"{self._path} is not whole: {self._lost_text}")
        return self._path if self._has_samples else None

    @property
    def _lost_text(self) -> str:
        return f"{self.lost} samples came too fast to be written"

    def _finish(self) -> None:
        """Give the closed file its name, or remove it if it has no samples."""
        try:
            if self._has_samples and not self._named and not (self._error and self._path.exists()):
                self._partial.replace(self._path)
                self._named = True
            elif not self._has_samples:
                self._partial.unlink(missing_ok=True)
        except OSError as error:
            self._error = self._error or _reason(error)
        if self._error and self._has_samples and not self._named:
            self._error += f"; it is in {self._partial}"

    def _run(self) -> None:
        try:
            while not self._closing.wait(FLUSH):
                self._flush()
            self._flush()
        except Exception as error:  # an exception of a thread would vanish
            self._error = _reason(error)
            self._limit = 0
            self._queue.clear()

    def _flush(self) -> None:
        """Write the records that wait, and their checksum."""
        queue, urgent = self._queue, self._urgent
        parts = [queue.popleft() for _ in range(len(queue))]
        if parts:
            self._urgent = False
            if self._named and not os.path.samestat(os.stat(self._path), os.fstat(self._file)):
                raise RecordingError("another program replaced it")
            data = b"".join(parts)
            self._has_samples |= any(part[0] == SAMPLE for part in parts)  # a full disk takes some of them
            self._write(data + checksum_record(data))
            if self._has_samples and not self._named and _RENAMES_OPEN:
                self._partial.replace(self._path)
                self._named = True
        if not self._wait and (urgent or time.monotonic() - self._synced > _SYNC):
            getattr(os, "fdatasync", os.fsync)(self._file)
            self._synced = time.monotonic()

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[os.write(self._file, view) :]


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _is_in_use(path: Path) -> bool:
    """Return whether another program seems to write a journal: it has no end, and changed a moment ago."""
    try:
        if not path.is_file() or abs(time.time() - path.stat().st_mtime) > _IN_USE:
            return False
        content = open_journal(path)
    except (OSError, ParameterError):
        return False
    return not content.ends(0, len(content.records))


class JournalContent(NamedTuple):
    """Content of a journal.

    Attributes:
        header: Entries of the header.
        records: All whole records, a read-only structured array (N,) on the disk.
        kinds: Kind of each, (N,).
        rest: Bytes of an incomplete record at the end.
    """

    header: Mapping[str, Any]
    records: NDArray[Any]
    kinds: NDArray[np.uint32]
    rest: int

    def ends(self, first: int, last: int) -> bool:
        """Return whether the last message of these records is that of the end."""
        texts = first + np.flatnonzero(self.kinds[first:last] == TEXT)
        return bool(len(texts)) and "end" in self.message(int(texts[-1]))

    def message(self, index: int) -> Mapping[str, Any]:
        """Return the message that begins with a record; an empty one if the file ends within it.

        Args:
            index: Number of the record, from 0.

        Raises:
            ParameterError: If other records follow within it, or it is not a JSON object.
        """
        size, payload = int(self.records["size"][index]), self.records.dtype.itemsize - _HEAD.size
        count = -(-size // payload)
        if index + count > len(self.records):
            return {}
        if (self.kinds[index + 1 : index + count] != CONTINUED).any():
            raise ParameterError("a message must have all its records")
        raw = np.ascontiguousarray(self.records[index : index + count]).view(np.uint8).reshape(count, -1)
        message = parsed(raw[:, _HEAD.size :].tobytes()[:size])
        if not isinstance(message, Mapping):
            raise ParameterError("a message must be an object")
        return message

    def cycles(self, last: int, most: int) -> NDArray[Any]:
        """Return the newest cycles of a device before a record, at most so many, a structured array (N,).

        Raises:
            ParameterError: If their dtype is another.
        """
        indices = np.flatnonzero(self.kinds[:last] == CYCLE)[-most:]
        if len(indices) and self.header.get("cycle") != _dtype_entries(_CYCLE_FORMATS):
            raise ParameterError(f"cycle must be the dtype {CYCLE_RECORD.names}")
        return np.asarray(self.records[indices]).view(CYCLE_RECORD) if len(indices) else np.empty(0, CYCLE_RECORD)

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Check the checksums; yield first and last record of each block, and of the rest without one.

        Raises:
            ParameterError: If a checksum is wrong.
        """
        start = 0
        for place in np.flatnonzero(self.kinds == CHECKSUM).tolist():
            data = self.records[start:place].tobytes()
            stated = self.records[place : place + 1].tobytes()
            if stated[4:12] != _HEAD.pack(place - start, zlib.crc32(data)):
                raise ParameterError(f"the checksum of records {start} to {place} is wrong: the file is damaged")
            yield start, place
            start = place + 1
        if start < len(self.records):
            yield start, len(self.records)


def open_journal(path: Path) -> JournalContent:
    """Return the content of a journal.

    Raises:
        ParameterError: If it is not a journal.
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        line = file.readline(_MOST_HEADER)
        size = os.fstat(file.fileno()).st_size
    if not line.startswith(b'{"offset"'):
        raise ParameterError(_what_it_is(line))
    if not line.endswith(b"\n"):
        raise ParameterError("it ends within its header")
    entries = parsed(line)
    name, version, offset = (value_in(entries, key) for key in ("format", "version", "offset"))
    if (name, version) != (FORMAT, VERSION):
        raise ParameterError(f"format and version must be {FORMAT} {VERSION}, not {str(name)[:40]} {str(version)[:40]}")
    if offset != len(line):
        raise ParameterError("the header must be as long as it says")
    kind = _dtype(value_in(entries, "dtype", dict))
    count, rest = divmod(size - offset, kind.itemsize)
    records = np.memmap(path, kind, "r", offset, (count,)) if count else np.empty(0, kind)
    return JournalContent(entries, records, np.array(records["kind"]), rest)


def _what_it_is(start: bytes) -> str:
    """Return why a file is not a journal."""
    if start.startswith((b"\x89MCAP", b"PK")):
        return "it is not a journal, but MCAP or .npz: maglev_mj 0.2 and older read these recordings"
    if start.startswith(b'{"format": "maglev_mj fault'):
        return "it is not a journal, but a black box: only the version of maglev_mj that wrote it reads it"
    return "it is not a journal"


_DTYPES = {"<u4", "<f8", "6<f8"}


def _dtype(entries: Mapping[str, Any]) -> np.dtype[Any]:
    """Return the dtype of the records from the header.

    Raises:
        ParameterError: If it is not a list of known formats, or lacks a value that every sample has.
    """
    names, formats = value_in(entries, "names", list), value_in(entries, "formats", list)
    good = all(isinstance(name, str) and re.fullmatch(r"\w{1,40}", name) for name in names)
    if not good or not all(one in _DTYPES for one in formats) or not len({*names}) == len(formats) == len(names) < 256:
        raise ParameterError(f"dtype must have names, and formats of {', '.join(sorted(_DTYPES))}")
    given = dict(zip(names, formats))
    needed: Sequence[Field] = [field for field in FIELDS if not field.optional]
    missing = [name for name in ("kind", "size", *(one.name for one in needed)) if given.get(name) != _FORMATS[name]]
    if missing or names[:2] != ["kind", "size"]:
        raise ParameterError(f"dtype must have {', '.join(missing) or 'kind and size first'} as {RECORD[0]}")
    return np.dtype({"names": names, "formats": formats})
