"""MCAP recordings: the message of a sample, and reading, of incomplete files too.

The format is at https://mcap.dev. A sample is a protobuf message in which every value has its full width, so that all
messages of a file have the same layout: a writer packs them at once, and a reader takes thousands of them as one
array. Any decoder of protobuf reads them by name.
"""

from __future__ import annotations

import json
import operator
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError, require
from maglev_mj.frames import AXES, Array
from maglev_mj.parameters import whole
from maglev_mj.recording.sample import (
    FIELDS,
    TOTALS,
    Field,
    Rows,
    RunMetadata,
    Setup,
    check_rows,
    check_setup,
    parsed,
    shown,
    value_in,
)

if TYPE_CHECKING:
    from mcap.records import Chunk

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""

METADATA, FORMAT = "maglev_mj", "2"
"""Name and format entry of a recording's metadata record."""

STRETCH, SAMPLE, EVENT = "/maglev/stretch", "/maglev/sample", "/maglev/event"

LARGEST_PART = 64 << 20
"""Largest unpacked size of a compressed part [bytes].

A part is a chunk or an array.
"""

_TIMES = 1000
_KEPT_TIMES = 100
_KEPT = 1 << 20
_MOST_MESSAGE = 1 << 20
_MOST_RECORD = LARGEST_PART + (1 << 20)
_BLOCK = 1 << 13  # samples that are checked and stored together
_RECORD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_NUMBERED, _COUNT = struct.Struct("<HI"), struct.Struct("<I")
_FRONT, _SAME = _RECORD.size + _MESSAGE.size, _RECORD.size + 2  # bytes before a message; those alike in each of a topic
_FOOTER, _SCHEMA, _CHANNEL, _SAID, _CHUNK = 2, 3, 4, 5, 6
_ATTACHMENT, _STATISTICS, _METADATA, _DATA_END = 9, 11, 12, 15
_RECORDS = {
    _CHUNK: "Chunk",
    _CHANNEL: "Channel",
    _ATTACHMENT: "Attachment",
    _METADATA: "Metadata",
    _STATISTICS: "Statistics",
}
_OURS = frozenset((STRETCH, SAMPLE, EVENT))
_NEEDED = "record", "recordings as MCAP need mcap and foxglove-sdk"
_TWINS = {"applied": "command", "applied_pulse": "pulse", "applied_pulse_width": "pulse_width"}
"""Fields that equal another bitwise unless a limit acts."""

NAME = "maglev_mj.Sample"
"""Full name of the message type."""

STRETCH_NUMBER = Field("stretch", "", "number of the stretch, from 0")
"""Number of the stretch, first field of a sample's message."""

_ORDERED: Sequence[Field] = (
    STRETCH_NUMBER,
    *(field for field in FIELDS if not field.optional),
    *TOTALS,
    *(field for field in FIELDS if field.optional),
)
"""Fields in the order of their numbers, from 1.

New fields are optional and come last.
"""

_SIX = "SixAxes"
_VARINT, _FIXED64, _BYTES = 0, 1, 2
_DOUBLE_TYPE, _MESSAGE_TYPE, _FIXED64_TYPE, _OPTIONAL = 1, 11, 6, 1
_NUMBER_SIZE, _SIX_SIZE = 8, 6 * 9
_SIX_KIND = np.dtype(([("head", "u1"), ("value", "<f8")], 6))


def _varint(value: int) -> bytes:
    encoded = b""
    while value > 0x7F:
        encoded, value = encoded + bytes([value & 0x7F | 0x80]), value >> 7
    return encoded + bytes([value])


def _part(number: int, value: int | str | bytes) -> bytes:
    """Return one field of a descriptor."""
    if isinstance(value, int):
        return _varint(number << 3 | _VARINT) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | _BYTES) + _varint(len(data)) + data


def _message(name: str, fields: Sequence[tuple[str, int, str]]) -> bytes:
    """Return the descriptor of a message.

    Each field has a name, a type and the type's name.
    """
    parts = [_part(1, name)]
    for number, (field, kind, of) in enumerate(fields, 1):
        about = _part(1, field) + _part(3, number) + _part(4, _OPTIONAL) + _part(5, kind)
        parts.append(_part(2, about + (_part(6, of) if of else b"")))
    return b"".join(parts)


def descriptor() -> bytes:
    """Return the schema of a sample, a FileDescriptorSet; comments give descriptions and units."""
    package, name = NAME.split(".")
    fields = [
        (field.name, _MESSAGE_TYPE, f".{package}.{_SIX}")
        if field.six
        else (field.name, _DOUBLE_TYPE if field.unit else _FIXED64_TYPE, "")
        for field in _ORDERED
    ]
    six = _message(_SIX, [(axis, _DOUBLE_TYPE, "") for axis in AXES])
    messages = _part(4, six) + _part(4, _message(name, fields))
    # source information: the path to a field of the second message, no span, and its comment
    notes = b"".join(
        _part(1, _part(1, bytes([4, 1, 2, index])) + _part(2, bytes(3)) + _part(3, f" {field.text}\n"))
        for index, field in enumerate(_ORDERED)
    )
    return _part(1, _part(1, f"{package}.proto") + _part(2, package) + messages + _part(9, notes) + _part(12, "proto3"))


def _head(field: Field) -> bytes:
    """Return the bytes in front of a field's value."""
    number = _ORDERED.index(field) + 1
    if field.six:
        return _varint(number << 3 | _BYTES) + bytes([_SIX_SIZE])
    return _varint(number << 3 | _FIXED64)


MessageArray: TypeAlias = "np.ndarray[tuple[int, int], np.dtype[np.uint8]]"
"""Messages of one layout, (N, size) bytes."""


class Layout:
    """Layout of a sample's message: byte position of each number.

    Args:
        fields: Fields in their order; a number stands for that many unknown bytes.

    Attributes:
        size: Size of a message [bytes].
    """

    def __init__(self, fields: Sequence[Field | int]) -> None:
        template, heads = b"", list[int]()
        self._places: dict[str, int] = {}
        for field in fields:
            if isinstance(field, int):
                template += bytes(field)
                continue
            head = _head(field)
            for number in range(1, len(field.units) + 1):
                head += bytes([number << 3 | _FIXED64]) if field.six else b""
                heads += range(len(template), len(template) + len(head))
                self._places.setdefault(field.name, len(template) + len(head))
                template, head = template + head + bytes(_NUMBER_SIZE), b""
        self.size, self._heads, self._template = len(template), np.array(heads), np.frombuffer(template, np.uint8)
        numbered = [field for field in fields if not isinstance(field, int)]
        kinds = [_SIX_KIND if field.six else "<f8" if field.unit else "<u8" for field in numbered]
        starts = [self._places[field.name] - field.six for field in numbered]
        names = list(self._places)
        self._kind = np.dtype({"names": names, "formats": kinds, "offsets": starts, "itemsize": self.size})

    def check(self, messages: MessageArray) -> None:
        """Check that messages have this layout.

        Raises:
            ParameterError: If one has another layout.
        """
        if not (messages[:, self._heads] == self._template[self._heads]).all():
            raise ParameterError("the samples of a file must all have the same fields")

    def values(self, messages: MessageArray, field: Field) -> Array:
        """Return a field of messages, NaN if missing.

        The shape is (N,) or (N, 6).
        """
        if field.name not in self._places:
            return np.full((len(messages), 6) if field.six else len(messages), np.nan)
        return self._view(messages, field).astype(np.float64)

    def packed(self, values: Mapping[str, Array | float], count: int) -> list[bytes]:
        """Return samples as messages, of the values of each field."""
        messages = self._template[None].repeat(count, axis=0)
        for field in _ORDERED:
            self._view(messages, field)[:] = values[field.name]
        return [message.tobytes() for message in messages]

    def _view(self, messages: MessageArray, field: Field) -> NDArray[Any]:
        values = messages.view(self._kind)[:, 0][field.name]
        return values["value"] if field.six else values


_WRITTEN = Layout((STRETCH_NUMBER, *FIELDS, *TOTALS))


def packed(stretch: int, rows: Rows, totals: Array) -> list[bytes]:
    """Return N samples as messages.

    Args:
        stretch: Number of the stretch.
        rows: Their values, (N,).
        totals: Running totals in the order of TOTALS, (N, 3).
    """
    values = {STRETCH_NUMBER.name: stretch} | {field.name: rows[field.name] for field in FIELDS}
    return _WRITTEN.packed(values | {field.name: one for field, one in zip(TOTALS, totals.T)}, len(rows))


def layout_of(message: bytes) -> Layout:
    """Return the layout of a message; unknown fields are skipped.

    Raises:
        ParameterError: If it is no message of a sample.
    """
    heads = {_head(field): field for field in _ORDERED}
    fields: list[Field | int] = []
    at, stop = 0, len(message)
    while at < stop:
        start, (tag, at) = at, _number_at(message, at)
        size, after = _number_at(message, at) if tag & 7 == _BYTES else (_NUMBER_SIZE, at)
        field, at = heads.pop(message[start:after], None), after + size
        if tag & 7 not in (_BYTES, _FIXED64) or (field is None and tag >> 3 <= len(_ORDERED)):
            raise ParameterError("a sample must have the fields that its schema says, each once")
        fields.append(at - start if field is None else field)
    missing = [field.name for field in _ORDERED if field not in fields and not field.optional]
    if missing or at != stop:
        raise ParameterError(f"a sample must have {', '.join(missing) or 'all its bytes'}")
    layout = Layout(fields)
    layout.check(np.frombuffer(message, np.uint8)[None])
    return layout


def _number_at(message: bytes, at: int) -> tuple[int, int]:
    """Return a variable-length number and the offset behind it."""
    value = shift = 0
    while at < len(message) and shift < 63:
        value |= (message[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if message[at - 1] < 0x80:
            return value, at
    raise ParameterError("a sample must have all its bytes")


def require_mcap() -> None:
    """Check that MCAP can be written and read.

    Raises:
        MissingPackageError: If a package is not installed.
    """
    require(("mcap", "foxglove"), *_NEEDED)


class UnpackingError(ValueError):
    """Unpacked part of a file is too large, or invalid."""


class Allowance:
    """Memory budget for unpacking a file.

    It exceeds the needs of any recording, and is too small to exhaust the memory.

    Args:
        size: Size of the file [bytes].
    """

    def __init__(self, size: int) -> None:
        self._left, self._kept = LARGEST_PART + _TIMES * size, _KEPT + _KEPT_TIMES * size

    def part(self, size: int) -> None:
        """Count a part's size [bytes] before it is unpacked.

        Raises:
            UnpackingError: If the part or the sum of all parts is too large.
        """
        if size > LARGEST_PART:
            raise UnpackingError(f"a part of it must unpack to at most {LARGEST_PART} bytes, not {size}")
        self._left -= size
        if self._left < 0:
            raise UnpackingError(f"it must unpack to at most {_TIMES} times its size")

    def text(self, size: int) -> None:
        """Count the size of a text [bytes], which takes many times that memory as objects.

        Raises:
            UnpackingError: If the sum of all texts is too large.
        """
        self._kept -= size
        if self._kept < 0:
            raise UnpackingError(f"its texts must be at most {_KEPT_TIMES} times its size")


class _EndMissingError(Exception):
    """The file ends within a record."""


def read_mcap(file: IO[bytes], size: int, names: frozenset[str] | None = None) -> McapContent:
    """Read a recording up to its last complete chunk, as its writer may have been killed.

    Args:
        file: File to read.
        size: Size of the file [bytes].
        names: Fields to keep; None for all.

    Raises:
        MissingPackageError: If a package is not installed.
        ParameterError: If it holds no recording or an invalid one.
    """
    require(("mcap",), *_NEEDED)
    content = McapContent(Allowance(size), names)
    try:
        try:
            for kind, data in _records(file):
                content.take(kind, data)
        finally:
            content.store_samples()
        if not content.counted:
            content.damage.append("its count of messages is missing")
        elif file.read(1):
            content.damage.append("there is more behind its end")
    except ParameterError:
        raise
    except _EndMissingError:
        content.damage.append("its end is missing")
    except Exception as error:  # errors of unpacking and of the content: data before them is good
        content.damage.append(f"it is damaged: {error or type(error).__name__}")
    if not content.stretches:
        raise ParameterError("; ".join(content.damage) or "nothing of a recording is in it")
    return content


def _records(file: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each record outside chunks.

    A wrong checksum is an error at the end. mcap's own reader unpacks the index of every chunk, checks no attachment,
    and does not tell a file that was cut off from a damaged one.
    """
    if file.read(len(MAGIC)) != MAGIC:
        raise ParameterError("it is no MCAP file")
    checksum, right, kind = zlib.crc32(MAGIC), True, 0
    while kind != _FOOTER:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            raise _EndMissingError
        kind, length = _RECORD.unpack(head)
        if length > _MOST_RECORD:
            raise UnpackingError(f"a record must have at most {_MOST_RECORD} bytes, not {length}")
        data = file.read(length)
        if len(data) < length:
            raise _EndMissingError
        if kind in (_DATA_END, _FOOTER):
            (stated,) = _COUNT.unpack(data[-4:])
            checksum = zlib.crc32(head + data[:-4], checksum) if kind == _FOOTER else checksum
            right &= stated in (0, checksum)
            checksum = 0
        else:
            checksum = zlib.crc32(data, zlib.crc32(head, checksum))
        yield kind, data
    if (end := file.read(len(MAGIC))) != MAGIC:
        raise _EndMissingError if MAGIC.startswith(end) else ValueError("its last bytes must be those of MCAP")
    if not right:
        raise ValueError("its checksum must be the one that it says")


def _unpacked(chunk: Chunk) -> bytes:
    """Return the content of a chunk, never more than its stated size.

    mcap's own function has no such bound.

    Raises:
        UnpackingError: If the size or the checksum is not as stated, or the compression is not known.
        Exception: Error of the unpacking package, if the chunk is damaged.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        import zstandard

        data = zstandard.ZstdDecompressor(max_window_size=LARGEST_PART).stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise UnpackingError(f"a chunk must be packed by zstd or lz4, not {chunk.compression[:20]!r}")
    if len(data) != size:
        raise UnpackingError(f"a chunk must unpack to {size} bytes, as it says")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise UnpackingError("a chunk must have the checksum that it says")
    return data


class McapStretch:
    """Samples of a stretch read so far, by column.

    A constant column, and a copy of another, is stored once.

    Args:
        message: Message at the beginning of the stretch.
        names: Fields to keep; None for all.
    """

    def __init__(self, message: Any, names: frozenset[str] | None) -> None:
        made_from = value_in(message, "setup", dict)
        run = {name: value for name, value in message.items() if name not in ("stretch", "setup")}
        RunMetadata.from_json(run)
        self.setup: Setup = check_setup({**made_from, "run": run})
        self.gaps: list[tuple[int, int]] = []
        self._blocks: dict[str, list[Array]] = {
            field.name: [] for field in (*FIELDS, *TOTALS) if names is None or field.name in names
        }
        self._last: dict[str, Array] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, values: Mapping[str, Array]) -> None:
        """Check and store samples as arrays of all fields, (N,) or (N, 6) each.

        Raises:
            ParameterError: If a sample is invalid.
        """
        # with the row before, for checks between rows
        rows = {name: np.concatenate([self._last.get(name, part[:0]), part]) for name, part in values.items()}
        check_rows(rows, max(self._count - 1, 0))
        self._count += len(values["tick"])
        self._last = {name: part[-1:].copy() for name, part in values.items()}
        kept = {name: _constant_once(part) for name, part in values.items()}
        kept |= {name: kept[twin] for name, twin in _TWINS.items() if _same(values[name], values[twin])}
        for name, blocks in self._blocks.items():
            blocks.append(kept[name])

    def arrays(self) -> dict[str, Array]:
        """Return the fields of all samples, (N,) or (N, 6) each, not to be changed."""
        blocks = self._blocks
        twins = {name: twin for name, twin in _TWINS.items() if {name, twin} <= blocks.keys()}
        copies = {name: twin for name, twin in twins.items() if all(map(operator.is_, blocks[name], blocks[twin]))}
        arrays = {name: _joined(blocks.pop(name)) for name in list(blocks) if name not in copies}
        return arrays | {name: arrays[twin] for name, twin in copies.items()}


def _check_same(message: Any, name: str, number: int) -> None:
    """Check that a message has the number that the messages before it imply."""
    value = value_in(message, name)
    if type(value) is not int or value != number:
        raise ParameterError(f"{name} must be {number}, not {shown(value)}")


def _same(one: Array, other: Array) -> bool:
    """Return True if two arrays are bitwise equal."""
    return bool((one.view(np.int64) == other.view(np.int64)).all())


def _constant_once(block: Array) -> Array:
    constant = np.broadcast_to(block[:1], block.shape)
    return np.broadcast_to(block[:1].copy(), block.shape) if _same(block, constant) else block


def _joined(blocks: Sequence[Array]) -> Array:
    first, count = blocks[0][:1], sum(map(len, blocks))
    if all(block.strides[0] == 0 and _same(block[:1], first) for block in blocks):
        return np.broadcast_to(first, (count, *first.shape[1:]))
    return np.concatenate(blocks)


class McapContent:
    """Content of a recording read so far.

    Args:
        allowance: Memory budget for unpacked data.
        names: Fields to keep; None for all.

    Attributes:
        stretches: Stretches in their order.
        events: Texts of the events.
        event_samples: Number of samples before each event.
        attachments: Files in the file.
        about: Metadata record at the beginning.
        damage: Descriptions of damage to the file.
        counted: True if the file's message count was read and right.
    """

    def __init__(self, allowance: Allowance, names: frozenset[str] | None) -> None:
        self.stretches: list[McapStretch] = []
        self.events: list[str] = []
        self.event_samples: list[int] = []
        self.attachments: dict[str, bytes] = {}
        self.about: Mapping[str, str] = {}
        self.damage: list[str] = []
        self.counted = False
        self._allowance, self._names = allowance, names
        self._topics: dict[int, str] = {}
        self._counts: dict[int, int] = {}
        self._layout: Layout | None = None
        self._runs: list[bytes] = []
        self._waiting = 0
        self._tick = 0

    def take(self, kind: int, data: bytes) -> None:
        """Take one record.

        Raises:
            ParameterError: If the record is invalid in a recording.
            Exception: Any error, if the record is damaged.
        """
        from mcap import records
        from mcap.data_stream import ReadDataStream

        if kind == _ATTACHMENT and _COUNT.unpack(data[-4:])[0] not in (0, zlib.crc32(data[:-4])):
            self.damage.append("an attachment is damaged, and left out")
        elif kind == _SAID:
            self._walk(_RECORD.pack(kind, len(data)) + data)
        elif name := _RECORDS.get(kind):
            getattr(self, f"_{name.lower()}")(getattr(records, name).read(ReadDataStream(BytesIO(data))))

    def _chunk(self, chunk: Chunk) -> None:
        self._allowance.part(chunk.uncompressed_size)
        self._walk(_unpacked(chunk))

    def _walk(self, data: bytes) -> None:
        """Take the records of a chunk."""
        at, end = 0, len(data)
        while at < end:
            kind, length = _RECORD.unpack_from(data, at) if end - at >= _RECORD.size else (0, end)
            after = at + _RECORD.size + length
            if after > end:
                raise UnpackingError("a record must end where its chunk does")
            if kind == _SAID:
                after = self._message(data, at, after)
            elif kind == _CHANNEL:
                self.take(kind, data[at + _RECORD.size : after])
            elif kind != _SCHEMA:
                allowed = "schemas, channels and messages alone"
                raise UnpackingError(f"a chunk must hold {allowed}, not records of kind {kind}")
            at = after
        if self._waiting >= _BLOCK:
            self.store_samples()

    def _message(self, data: bytes, at: int, after: int) -> int:
        """Take a message at an offset, or a run of samples; return its end."""
        if not _MESSAGE.size <= (length := after - at - _RECORD.size) <= _MOST_MESSAGE:
            raise UnpackingError(f"a message must have at most {_MOST_MESSAGE} bytes, not {length}")
        channel, number = _NUMBERED.unpack_from(data, at + _RECORD.size)
        topic = self._topics.get(channel)
        if topic is None:
            raise ValueError("a message is on no channel")
        if topic == SAMPLE:
            return self._run(data, at, after, channel)
        self._count(channel, number)
        if topic in _OURS:
            self.store_samples()
            self._allowance.text(length)
            (self._begin if topic == STRETCH else self._event)(parsed(data[at + _FRONT : after]))
        return after

    def _channel(self, channel: Any) -> None:
        if self._topics.setdefault(channel.id, channel.topic) != channel.topic:
            raise ParameterError(f"channel {channel.id} must be of one topic")

    def _count(self, channel: int, number: int, count: int = 1) -> None:
        """Count messages of a channel; raise if some are missing."""
        before = self._counts.get(channel, 0)
        if number != (before + 1) & 0xFFFFFFFF:
            raise ValueError("messages are missing")
        self._counts[channel] = before + count

    def _run(self, data: bytes, at: int, after: int, channel: int) -> int:
        """Take consecutive samples at an offset; return their end."""
        size = after - at
        if self._layout is None:
            self._layout = layout_of(data[at + _FRONT : after])
        if size != _FRONT + self._layout.size:
            raise ParameterError("the samples of a file must all have the same fields")
        head, end, last = data[at : at + _SAME], after, len(data) - size
        while end <= last and data.startswith(head, end):
            end += size
        (first,), number = _COUNT.unpack_from(data, at + _SAME), (end - at) // size
        self._count(channel, first, number)
        self._runs.append(data[at:end])
        self._waiting += number
        return end

    def store_samples(self) -> None:
        """Add the waiting samples to their stretch.

        Raises:
            ParameterError: If a sample is invalid.
            ValueError: If samples are missing; those before the gap are added.
        """
        if not self._runs:
            return
        assert self._layout is not None
        if not self.stretches:
            raise ParameterError("a sample must be in a stretch")
        messages = b"".join(self._runs)
        self._runs, self._waiting = [], 0
        records = np.frombuffer(messages, np.uint8).reshape(-1, _FRONT + self._layout.size)
        numbers = np.ascontiguousarray(records[:, _SAME : _SAME + 4]).view("<u4")[:, 0]
        good = 1 + int(np.argmin(np.append(np.diff(numbers) == 1, False)))
        rows = records[:good, _FRONT:]
        self._layout.check(rows)
        stretch, last = self._layout.values(rows, STRETCH_NUMBER), len(self.stretches) - 1
        if (stretch != last).any():
            raise ParameterError(f"stretch must be {last}, not {stretch[stretch != last][0]:g}")
        values = {field.name: self._layout.values(rows, field) for field in (*FIELDS, *TOTALS)}
        self.stretches[-1].add(values)
        self._tick = int(values["tick"][-1])
        if good < len(records):
            raise ValueError("messages are missing")

    def _begin(self, message: Any) -> None:
        if not self.about:
            raise ParameterError(f"format must be {FORMAT}, not missing")
        _check_same(message, "stretch", len(self.stretches))
        self.stretches.append(McapStretch(message, self._names))

    def _event(self, message: Any) -> None:
        _check_same(message, "stretch", len(self.stretches) - 1)
        _check_same(message, "tick", self._tick)
        missed = whole("missed", value_in(message, "missed"))
        self.events.append(f"{value_in(message, 'kind', str)}: {value_in(message, 'text', str)}")
        self.event_samples.append(sum(map(len, self.stretches)))
        if missed and self.stretches:
            self.stretches[-1].gaps.append((len(self.stretches[-1]), missed))

    def _attachment(self, attachment: Any) -> None:
        self.attachments[attachment.name] = attachment.data

    def _metadata(self, metadata: Any) -> None:
        if metadata.name == METADATA and not self.stretches:
            self.about = metadata.metadata
            if value_in(self.about, "format") != FORMAT:
                raise ParameterError(f"format must be {FORMAT}, not {json.dumps(self.about['format'])[:40]}")

    def _statistics(self, statistics: Any) -> None:
        stated: Mapping[int, int] = statistics.channel_message_counts
        missing = sum(stated.values()) - sum(self._counts.values())
        if missing or any(self._counts.get(channel, 0) != count for channel, count in stated.items()):
            raise ValueError(f"{missing} messages are missing")
        self.counted = True
