"""Journal: an append-only file of a JSON header and fixed-size records, written by a thread.

The format is specified in docs/reference/recording.md. A record is two integers, kind and size, and the values of one
sample as float64. NumPy reads all records as one array.
"""

from __future__ import annotations

import json
import os
import re
import stat
import struct
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.files import LFS_POINTER, destination, errors_named, parse_json
from maglev_mj.recording.sample import FIELDS, ROW, Rows, units, value_in
from maglev_mj.versions import versions

SUFFIX = ".maglev"
"""File name suffix of a journal."""

FORMAT, VERSION = "maglev_mj journal", 1
_START = b'{"offset"'
"""Entries `format` and `version` of the header."""

_CHAINED = "chained"  # entry `checksums` of the header; journals of earlier versions have none

FLUSH = 0.1
"""Write interval of the thread [s]; a killed process loses at most this much."""

BLOCK = 256
"""Records after which a block ends; damage costs its whole block."""

SAMPLE, TEXT, CONTINUED, CHECKSUM, CYCLE = range(5)
"""Kinds of records; readers ignore unknown ones."""

_SYNC = 1.0  # interval of fdatasync in real time [s]
_IN_USE = 1.0  # an unclosed file changed within this time is being written by another program [s]
_LIMIT = 1 << 16  # longest queue, 22 MB of records
_NAP = 0.001
_GRANULE = 4096  # alignment of the header's size [bytes]
_MAX_HEADER = 1 << 20
_RENAMES_OPEN = os.name != "nt"  # Windows cannot rename an open file
_HEAD = struct.Struct("<II")
_SUMS = struct.Struct("<II")


class CyclePart(NamedTuple):
    """Declaration of a value of a device cycle; `make protocol` copies it to docs/reference/recording.md."""

    name: str
    format: str
    unit: str
    text: str


CYCLE_PARTS = (
    CyclePart("kind", "<u4", "", "4"),
    CyclePart("tick", "<u4", "", "sample number of the device"),
    CyclePart("state", "<u4", "", "its state, as [on the wire](protocol.md)"),
    CyclePart("faults", "<u4", "", "its faults, as [on the wire](protocol.md)"),
    CyclePart("time", "<f8", "s", "time of the sample, device clock"),
    CyclePart("spots", "6<f8", "m", "measured spots"),
    CyclePart("pose", "6<f8", "m, rad", "pose computed by the host, NaN if unknown"),
    CyclePart("held", "6<f8", "A", "commanded currents"),
    CyclePart("pulsed", "6<f8", "A", "commanded currents of a pulse"),
    CyclePart("measured", "6<f8", "A", "currents measured with the sample"),
    CyclePart("temperatures", "6<f8", "", "temperature rise of the coils; the device trips at 1"),
    CyclePart("width", "<f8", "s", "pulse duration"),
    CyclePart("delay", "<f8", "s", "from the previous sample to its command's effect at the device"),
    CyclePart("latency", "<f8", "s", "from the sample's arrival to its answer"),
)
"""Values of a device cycle. Any after `latency` is that of STATE with its name: to record one, add a line."""

_NAMES = [part.name for part in CYCLE_PARTS]
REPORTED = _NAMES[_NAMES.index("latency") + 1 :]
"""Values of a cycle copied from STATE by name; NaN in files that lack them."""


def _dtype_entries(formats: Mapping[str, str]) -> Mapping[str, Sequence[str]]:
    return {"names": list(formats), "formats": list(formats.values())}


def _layout(formats: Mapping[str, str]) -> np.dtype[Any]:
    return np.dtype([(name, item) for name, item in formats.items()])


def _padded(formats: Mapping[str, str], other: Mapping[str, str]) -> Mapping[str, str]:
    """Return formats with spare values at the end, so that a record is as long as one of the other formats."""
    missing = max(_layout(other).itemsize - _layout(formats).itemsize, 0)
    spare = ["<f8"] * (missing // 8) + ["<u4"] * (missing % 8 // 4)
    return {**formats, **{f"spare{index}": item for index, item in enumerate(spare)}}


_SAMPLE_VALUES = {
    "kind": "<u4",
    "size": "<u4",
    **{field.name: "6<f8" if field.six else "<f8" for field in FIELDS},
}
_CYCLE_VALUES = {part.name: part.format for part in CYCLE_PARTS}
_FORMATS, _CYCLE_FORMATS = _padded(_SAMPLE_VALUES, _CYCLE_VALUES), _padded(_CYCLE_VALUES, _SAMPLE_VALUES)
RECORD = _layout(_FORMATS)
"""Structured dtype of a record."""


def _packer(values: str) -> Callable[..., bytes]:
    return struct.Struct(f"<{values}{RECORD.itemsize - struct.calcsize(f'<{values}')}x").pack


_CODES = {"<u4": "I", "<f8": "d", "6<f8": "6d"}
PACK_SAMPLE = _packer(f"{_HEAD.size}x{ROW.itemsize // 8}d")
"""Pack the values of a sample into its record (kind and size 0)."""

PACK_CYCLE = _packer("".join(_CODES[part.format] for part in CYCLE_PARTS))
"""Pack the values of a device cycle, in the order of `CYCLE_PARTS`."""

_PAYLOAD = RECORD.itemsize - _HEAD.size


class RecordingError(MaglevError):
    """A recording cannot be written or replayed."""


class InvalidRecordingError(RecordingError, ParameterError):
    """A file is not a recording, or has invalid content."""


def microseconds() -> int:
    """Return the time since 1970 [µs]."""
    return time.time_ns() // 1000


def text_records(message: Mapping[str, Any]) -> bytes:
    """Return the records of a message of JSON values."""
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


class Seal:
    """Checksum records of the blocks of a journal, in order.

    Each has two sums: of its block, and of the header and all blocks up to its own. A block in the wrong place, or of
    another file, has a wrong second sum. Journals of earlier versions have the first alone.

    Args:
        head: Header of the journal.
        size: Size of a record [bytes].
        chained: False for a journal of an earlier version.
    """

    def __init__(self, head: bytes, size: int = RECORD.itemsize, *, chained: bool = True) -> None:
        self._sum, self._size, self._chained = zlib.crc32(head), size, chained

    def __call__(self, block: bytes) -> bytes:
        """Return the checksum record of the next block."""
        self._sum = zlib.crc32(block, self._sum) if self._chained else 0
        sums = _SUMS.pack(zlib.crc32(block), self._sum)
        return (_HEAD.pack(CHECKSUM, len(block) // self._size) + sums).ljust(self._size, b"\0")


def sealed(parts: Iterable[bytes], seal: Seal) -> Iterator[bytes]:
    """Yield blocks of records, each with its checksum; a part, such as a message, is in one block."""
    block, size = list[bytes](), 0
    for part in chain(parts, [b""]):  # the empty one ends the last block
        block.append(part)
        size += len(part)
        if size and (size >= BLOCK * RECORD.itemsize or not part):
            data, block, size = b"".join(block), [], 0
            yield data + seal(data)


def journal_bytes(parts: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the bytes of a journal of records: the header, then block by block."""
    head = header()
    yield head
    yield from sealed(parts, Seal(head))


def header() -> bytes:
    """Return the header of a new journal, one line of JSON padded with spaces."""
    entries = {
        "format": FORMAT,
        "version": VERSION,
        "dtype": _dtype_entries(_FORMATS),
        "cycle": _dtype_entries(_CYCLE_FORMATS),
        "checksums": _CHAINED,
        "units": units(),
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="milliseconds"),
    }
    data = json.dumps(entries).encode()
    size = -(-(len(data) + 24) // _GRANULE) * _GRANULE
    return (b'{"offset": %-8d, ' % size + data[1:]).ljust(size - 1) + b"\n"


class Journal:
    """Journal file of a run, written by a thread every 0.1 s.

    It has a temporary name until the first sample; an existing file is replaced then. After an error the thread
    discards all further records, so that the run continues undisturbed.

    Args:
        path: Path of the file.
        wait: True if the run waits while the queue is full; if False, samples are then lost and counted.

    Attributes:
        lost: Samples lost because the queue of 65 536 records was full.

    Raises:
        RecordingError: If another program is writing this file.
        OSError: If the file cannot be written.
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        if _is_in_use(path):
            raise RecordingError(f"{path} is being written by another program: use another file name")
        self._path, self._wait, self.lost = path, wait, 0
        self._target, mode = destination(path)
        self._error, self._limit = "", _LIMIT
        self._queue = deque[bytes]()
        self._has_samples = self._named = False
        self._synced, self._urgent = time.monotonic(), False
        self._partial = self._target.with_name(f"{path.name}.{os.getpid()}.partial")
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self._file = os.open(self._partial, flags, 0o666)
        try:
            with errors_named(path):
                if mode is not None:
                    self._partial.chmod(stat.S_IMODE(mode))
                self._write(head := header())
        except OSError:
            os.close(self._file)
            self._partial.unlink()
            raise
        self._seal, self._process = Seal(head), os.getpid()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="journal", daemon=True)
        self._thread.start()

    @property
    def append(self) -> Callable[[bytes], None]:
        """Function that appends a packed record: `deque.append`, atomic without a lock."""
        return self._queue.append

    def has_room(self) -> bool:
        """Return True if a sample can be appended, after waiting if `wait`; otherwise count it as lost."""
        queue = self._queue
        if len(queue) < self._limit:
            return True
        while self._wait and self._thread.is_alive():  # not in a forked process
            time.sleep(_NAP)
            if len(queue) < self._limit:
                return True
        self.lost += 1
        return False

    def text(self, message: Mapping[str, Any], *, urgent: bool = False) -> None:
        """Append a message of JSON values; an urgent one is synced to disk at the next flush."""
        if not self._error:
            self._urgent |= urgent
            self._queue.append(text_records(message))

    def check(self) -> None:
        """Check that the file is being written.

        Raises:
            RecordingError: If writing has failed.
        """
        if self._error:
            raise RecordingError(f"writing {self._path} has stopped: {self._error}")

    def close(self) -> Path | None:
        """Write the queue and the end record; return the path, or None without samples; idempotent.

        It does nothing in a forked process: the file and its thread are its parent's.

        Raises:
            RecordingError: If the file is incomplete.
        """
        if self._process != os.getpid():
            return None
        if not self._closing.is_set():
            if self.lost:
                self.text({"event": "lost", "text": self._lost_text, "missed": 0})
            self.text({"end": {"lost": self.lost}})
            self._closing.set()
            self._thread.join()
            os.close(self._file)
            self._finish()
        if self._error:
            raise RecordingError(f"{self._path} is incomplete: {self._error}")
        if self.lost:
            raise RecordingError(f"{self._path} is incomplete: {self._lost_text}")
        return self._path if self._has_samples else None

    @property
    def _lost_text(self) -> str:
        return f"{self.lost} samples lost (write queue full)"

    def _finish(self) -> None:
        """Rename the closed file to its final name, or remove it if it has no samples."""
        try:
            if self._has_samples and not self._named and not (self._error and self._path.exists()):
                self._partial.replace(self._target)
                self._named = True
            elif not self._has_samples:
                self._partial.unlink(missing_ok=True)
        except OSError as error:
            self._error = self._error or _reason(error)
        if self._error and self._has_samples and not self._named:
            self._error += f"; the data is in {self._partial}"

    def _run(self) -> None:
        try:
            while not self._closing.wait(FLUSH):
                self._flush()
            self._flush()
        except Exception as error:  # stored for the main thread, or it would be lost
            self._error = _reason(error)
            self._limit = 0
            self._queue.clear()

    def _flush(self) -> None:
        """Write the queued records and their checksum."""
        queue, urgent = self._queue, self._urgent
        parts = [queue.popleft() for _ in range(len(queue))]
        if parts:
            self._urgent = False
            if self._named and not os.path.samestat(os.stat(self._path), os.fstat(self._file)):
                raise RecordingError("file replaced by another program")
            self._has_samples |= any(part[0] == SAMPLE for part in parts)  # a full disk may accept some of them
            for block in sealed(parts, self._seal):
                self._write(block)
            if self._has_samples and not self._named and _RENAMES_OPEN:
                self._partial.replace(self._target)
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
    """Return True if a journal has no end record and changed less than `_IN_USE` ago."""
    try:
        if not path.is_file() or abs(time.time() - path.stat().st_mtime) > _IN_USE:
            return False
        content = open_journal(path)
    except (OSError, ParameterError):
        return False
    return not content.is_closed()


class JournalContent(NamedTuple):
    """Content of a journal up to its first bad block.

    Attributes:
        header: Entries of the header.
        records: The records, read-only, (N,).
        kinds: Kind of each record, (N,).
        ends: Index after the last record of each block; the last block may have no checksum.
        proven: Number of records that are intact and in their place, by their checksums.
        rest: Bytes of the file after these records and their checksum.
        damage: Damage at which the records end; empty for none, or a record that is cut off.
        repaired: Damage that is undone in the records; empty for none.
    """

    header: Mapping[str, Any]
    records: NDArray[Any]
    kinds: NDArray[np.uint32]
    ends: Sequence[int]
    proven: int
    rest: int
    damage: str
    repaired: str

    def is_closed(self) -> bool:
        """Return True if the last message is the end record."""
        texts = np.flatnonzero(self.kinds == TEXT)
        return bool(len(texts)) and "end" in self.message(int(texts[-1]))

    def message(self, index: int) -> Mapping[str, Any]:
        """Return the message that starts at a record; empty if the file ends within it.

        Args:
            index: Index of the record.

        Raises:
            ParameterError: If its continuation records are missing, or it is not a JSON object.
        """
        size, payload = int(self.records["size"][index]), self.records.dtype.itemsize - _HEAD.size
        count = -(-size // payload)
        if index + count > len(self.records):
            return {}
        if (self.kinds[index + 1 : index + count] != CONTINUED).any():
            raise ParameterError("incomplete message: continuation records are missing")
        raw = np.ascontiguousarray(self.records[index : index + count]).view(np.uint8).reshape(count, -1)
        message = parse_json(raw[:, _HEAD.size :].tobytes()[:size])
        if not isinstance(message, Mapping):
            raise ParameterError("a message must be a JSON object")
        return message

    def cycles(self, last: int, most: int) -> NDArray[Any]:
        """Return the newest device cycles before a record, at most `most`, a structured array (N,).

        Values that the file lacks are NaN; others than those of `CYCLE_PARTS` are left out.

        Raises:
            ParameterError: If their dtype is invalid, or lacks a value that all versions record.
        """
        indices = np.flatnonzero(self.kinds[:last] == CYCLE)[-most:]
        if not len(indices):
            return np.empty(0, _layout(_CYCLE_VALUES))
        stored, formats = _stored(self.header, "cycle")
        needed = {name: item for name, item in _CYCLE_VALUES.items() if name in formats or name not in REPORTED}
        _check_formats("cycle", formats, needed)
        if stored.itemsize != self.records.dtype.itemsize:
            size = f"{self.records.dtype.itemsize} bytes, as the records have"
            raise ParameterError(f"cycle must have {size} (got {stored.itemsize})")
        read = np.asarray(self.records[indices]).view(stored)
        nan = {name: item.replace("<u4", "<f8") for name, item in _CYCLE_VALUES.items()}
        cycles = np.empty(len(read), _layout(nan | needed))
        for name in nan:
            cycles[name] = read[name] if name in needed else np.nan
        return cycles


def is_journal(path: Path) -> bool:
    """Return True if a file starts as a journal does; False if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(len(_START)) == _START
    except OSError:
        return False


def open_journal(path: Path) -> JournalContent:
    """Return the content of a journal up to its first bad block.

    Raises:
        ParameterError: If it is not a journal, or its header is damaged.
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        line = file.readline(_MAX_HEADER)
        if not line.startswith(_START):
            raise ParameterError(_reason_no_journal(line + file.read(64)))
        size = os.fstat(file.fileno()).st_size
    if not line.endswith(b"\n"):
        raise ParameterError("incomplete header")
    entries = parse_json(line)
    name, version, offset = (value_in(entries, key) for key in ("format", "version", "offset"))
    if (name, version) != (FORMAT, VERSION):
        actual = f"{str(name)[:40]} {str(version)[:40]}"
        raise ParameterError(f"format and version must be {FORMAT} {VERSION} (got {actual})")
    data = repaired = None
    if line.endswith(b"\r\n") and offset == len(line) - 1:
        data = path.read_bytes().replace(b"\r\n", b"\n")  # if it had such pairs before, the checksums show it
        line, size, repaired = data[:offset], len(data), "line endings converted to CRLF, undone: copy it as binary"
    if offset != len(line):
        raise ParameterError(f"offset must be the header's length, {len(line)} bytes")
    kind = _record_dtype(entries)
    count, remainder = divmod(size - offset, kind.itemsize)
    records: NDArray[Any] = np.empty(0, kind)
    if count:
        mapped = np.memmap(path, kind, "r", offset, (count,)) if data is None else None
        records = np.frombuffer(data or b"", kind, count, offset) if mapped is None else mapped
    kinds, chained = np.array(records["kind"]), entries.get("checksums") == _CHAINED
    ends, sealed_up_to, damage = _verified(records, kinds, Seal(line, kind.itemsize, chained=chained))
    last = ends[-1] if ends else 0
    return JournalContent(
        entries,
        records[:last],
        kinds[:last],
        ends,
        proven=min(sealed_up_to, last) if chained else 0,
        rest=(count - max(last, sealed_up_to)) * kind.itemsize + remainder,
        damage=damage,
        repaired=repaired or "",
    )


def _verified(records: NDArray[Any], kinds: NDArray[np.uint32], seal: Seal) -> tuple[list[int], int, str]:
    """Return the end of each good block, the index after the last right checksum, and what is wrong behind them."""
    ends, start = list[int](), 0
    for index in np.flatnonzero(kinds == CHECKSUM).tolist():
        right, stored = seal(records[start:index].tobytes()), records[index : index + 1].tobytes()
        if stored != right:
            own = _HEAD.size + _SUMS.size // 2
            what = "damaged" if stored[:own] != right[:own] else "from elsewhere, or the header was changed"
            return ends, start, f"wrong checksum of records {start} to {index} ({what})"
        ends.append(index)
        start = index + 1
    # the last records are written before their checksum, and after a power failure they may be zeros
    zeros = records[start:].tobytes().find(bytes(records.dtype.itemsize))  # no record has as many
    if zeros < 0:
        return [*ends, *[len(records)] * (len(records) > start)], start, ""
    last = start + zeros // records.dtype.itemsize
    return [*ends, *[last] * (last > start)], start, f"zeros from record {last} on (power failure?)"


def _reason_no_journal(start: bytes) -> str:
    if start.startswith((b"\x89MCAP", b"PK")):
        profile = start[21 : 21 + int.from_bytes(start[17:21], "little")]  # after magic, opcode and size
        if start[0] == 0x89 and profile:
            return f"a recording of another program (MCAP profile {profile.decode(errors='replace')})"
        return "MCAP or .npz file, not a journal: maglev_mj 0.2 and earlier read these recordings"
    if start.startswith(LFS_POINTER.encode()):
        return "a Git LFS pointer: run git lfs pull"
    if start.startswith(b'{"format": "maglev_mj fault'):
        return "fault file in an old format: only the version of maglev_mj that wrote it can read it"
    return "not a journal"


def _record_dtype(header: Mapping[str, Any]) -> np.dtype[Any]:
    """Return the dtype of the records.

    Raises:
        ParameterError: If a name or format is invalid, or a required field is missing.
    """
    kind, formats = _stored(header, "dtype")
    optional = [field.name for field in FIELDS if field.optional]
    _check_formats("dtype", formats, {name: item for name, item in _SAMPLE_VALUES.items() if name not in optional})
    if [*formats][:2] != ["kind", "size"]:
        raise ParameterError("dtype must have kind and size first")
    return kind


def _stored(header: Mapping[str, Any], entry: str) -> tuple[np.dtype[Any], Mapping[str, str]]:
    """Return a dtype from an entry of the header, and its formats by name.

    Raises:
        ParameterError: If a name or format is invalid.
    """
    entries = value_in(header, entry, dict)
    names, formats = value_in(entries, "names", list), value_in(entries, "formats", list)
    valid = all(isinstance(name, str) and re.fullmatch(r"\w{1,40}", name) for name in names)
    if (
        not valid
        or not all(item in _CODES for item in formats)
        or not len({*names}) == len(formats) == len(names) < 256
    ):
        raise ParameterError(f"{entry} must have unique names, and formats among {', '.join(sorted(_CODES))}")
    return np.dtype({"names": names, "formats": formats}), dict(zip(names, formats))


def _check_formats(entry: str, stored: Mapping[str, str], needed: Mapping[str, str]) -> None:
    wrong = [f"{name} as {item}" for name, item in needed.items() if stored.get(name) != item]
    if wrong:
        raise ParameterError(f"{entry} must have {', '.join(wrong)}")
