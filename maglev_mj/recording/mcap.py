"""Reading of MCAP recordings, incomplete ones included.

The format is at https://mcap.dev.

Samples are protobuf messages of equal length, read in thousands at once; in older files they are JSON.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from typing import IO, Any

import numpy as np

from maglev_mj.errors import ParameterError, require
from maglev_mj.frames import Array
from maglev_mj.recording.before import sample_row
from maglev_mj.recording.checks import (
    LARGEST_PART,
    Allowance,
    UnpackingError,
    check_setup,
    object_in,
    parsed,
    text_in,
    unpacked,
    whole,
)
from maglev_mj.recording.columns import BLOCK, Columns
from maglev_mj.recording.metadata import RunMetadata, Setup
from maglev_mj.recording.protobuf import STRETCH as NUMBER
from maglev_mj.recording.protobuf import Layout, layout_of
from maglev_mj.recording.row import FIELDS, TOTALS

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""

METADATA, FORMAT = "maglev_mj", "2"
"""Name and format entry of a recording's metadata record."""

STRETCH, SAMPLE, EVENT = "/maglev/stretch", "/maglev/sample", "/maglev/event"

_MOST_MESSAGE = 1 << 20
_MOST_RECORD = LARGEST_PART + (1 << 20)
_RECORD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_NUMBERED, _COUNT = struct.Struct("<HI"), struct.Struct("<I")
_FRONT, _SAME = _RECORD.size + _MESSAGE.size, _RECORD.size + 2  # bytes before a message; those alike in each of a topic
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _SAID, _CHUNK = 1, 2, 3, 4, 5, 6
_ATTACHED, _STATISTICS, _ABOUT, _DATA_END = 9, 11, 12, 15
_OURS = frozenset((STRETCH, SAMPLE, EVENT))

_NEEDED = "record", "recordings as MCAP need mcap and foxglove-sdk"


def require_mcap() -> None:
    """Check that MCAP can be written and read.

    Raises:
        MissingPackageError: If a package is not installed.
    """
    require(("mcap", "foxglove"), *_NEEDED)


class _Ended(Exception):
    """Unexpected end of the file."""


def read_mcap(file: IO[bytes], size: int, names: frozenset[str] | None = None) -> Found:
    """Read a recording up to its last complete chunk.

    The writer may have been killed.

    Args:
        file: File to read.
        size: Size of the file [bytes].
        names: Fields to keep; None for all.

    Raises:
        MissingPackageError: If a package is not installed.
        ParameterError: If it holds no recording or an invalid one.
    """
    require(("mcap",), *_NEEDED)
    found = Found(Allowance(size), names)
    try:
        try:
            for kind, data in _records(file):
                found.take(kind, data)
        finally:
            found.join()
        if not found.counted:
            found.damage = "its count of messages is missing"
        elif file.read(1):
            found.damage = "there is more behind its end"
    except ParameterError:
        raise
    except _Ended:
        found.damage = "its end is missing"
    except Exception as error:  # errors of unpacking and of the content: data before them is good
        found.damage = f"it is damaged: {error or type(error).__name__}"
    if not found.parts:
        raise ParameterError(found.damage or "nothing of a recording is in it")
    for part in found.parts:
        part.columns.sort()
    return found


def _records(file: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each record outside chunks.

    Checksums are checked on the way.
    """
    if file.read(len(MAGIC)) != MAGIC:
        raise ParameterError("it is no MCAP file")
    checksum = zlib.crc32(MAGIC)
    while True:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            raise _Ended
        kind, length = _RECORD.unpack(head)
        if length > _MOST_RECORD:
            raise UnpackingError(f"a record must have at most {_MOST_RECORD} bytes, not {length}")
        data = file.read(length)
        if len(data) < length:
            raise _Ended
        if kind in (_DATA_END, _FOOTER):
            (said,) = struct.unpack("<I", data[-4:])
            checksum = zlib.crc32(head + data[:-4], checksum) if kind == _FOOTER else checksum
            if said not in (0, checksum):
                raise ValueError("its checksum must be the one that it says")
            checksum = 0
        else:
            checksum = zlib.crc32(data, zlib.crc32(head, checksum))
        yield kind, data
        if kind == _FOOTER:
            if (end := file.read(len(MAGIC))) != MAGIC:
                raise _Ended if MAGIC.startswith(end) else ValueError("its last bytes must be those of MCAP")
            return


class Part:
    """Samples of a stretch read so far.

    Args:
        message: Message at the beginning of the stretch.
        names: Fields to keep; None for all.
    """

    def __init__(self, message: Any, names: frozenset[str] | None) -> None:
        self.setup: Setup = check_setup(object_in(message, "setup"))
        self.metadata = RunMetadata.from_json(message)
        self.columns = Columns((*FIELDS, *TOTALS), names)
        self.gaps: list[tuple[int, int]] = []

    def __len__(self) -> int:
        return len(self.columns)

    def array(self, name: str) -> Array:
        """Return a field of its samples, (N,) or (N, 6)."""
        return self.columns.array(name)


class Found:
    """Content of a recording read so far.

    Args:
        allowance: Memory budget for unpacked data.
        names: Fields to keep; None for all.

    Attributes:
        parts: Stretches in their order.
        events: Texts of the events.
        event_samples: Number of samples before each event.
        attachments: Files in the file.
        about: Metadata record at the beginning; empty in older files.
        damage: Description of damage to the file; empty for none.
        counted: True if the file's message count was read and right.
    """

    def __init__(self, allowance: Allowance, names: frozenset[str] | None) -> None:
        self.parts: list[Part] = []
        self.events: list[str] = []
        self.event_samples: list[int] = []
        self.attachments: dict[str, bytes] = {}
        self.about: Mapping[str, str] = {}
        self.damage, self.counted = "", False
        self._allowance, self._names = allowance, names
        self._topics: dict[int, str] = {}
        self._counts: dict[int, int] = {}
        self._layout: Layout | None = None
        self._runs: list[bytes] = []
        self._waiting = 0
        self._tick = 0
        self._takers: Mapping[int, Callable[[bytes], None]] = {
            _CHUNK: self._chunk,
            _CHANNEL: self._channel,
            _SAID: lambda data: self._walk(_RECORD.pack(_SAID, len(data)) + data),
            _ATTACHED: self._attachment,
            _ABOUT: self._metadata,
            _STATISTICS: self._statistics,
        }

    def take(self, kind: int, data: bytes) -> None:
        """Take one record.

        Raises:
            ParameterError: If the record is invalid in a recording.
            Exception: Any error, if the record is damaged.
        """
        taker = self._takers.get(kind)
        if taker is not None:
            taker(data)

    def _chunk(self, data: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk

        chunk = Chunk.read(ReadDataStream(BytesIO(data)))
        self._allowance.part(chunk.uncompressed_size)
        self._walk(unpacked(chunk))

    def _walk(self, data: bytes) -> None:
        """Take the records of a chunk."""
        at, end = 0, len(data)
        while at < end:
            if end - at < _RECORD.size:
                raise UnpackingError("a record must end where its chunk does")
            kind, length = _RECORD.unpack_from(data, at)
            after = at + _RECORD.size + length
            if after > end:
                raise UnpackingError("a record must end where its chunk does")
            if kind == _SAID:
                if not _MESSAGE.size <= length <= _MOST_MESSAGE:
                    raise UnpackingError(f"a message must have at most {_MOST_MESSAGE} bytes, not {length}")
                channel, number = _NUMBERED.unpack_from(data, at + _RECORD.size)
                topic = self._topic(channel)
                if topic == SAMPLE and self.about:
                    after = self._run(data, at, after, channel)
                else:
                    self._count(channel, topic, number)
                    if topic in _OURS:
                        self._message(topic, data[at + _FRONT : after])
            elif kind == _CHANNEL:
                self._channel(data[at + _RECORD.size : after])
            elif kind != _SCHEMA:
                raise UnpackingError(
                    f"a chunk must hold schemas, channels and messages alone, not records of kind {kind}"
                )
            at = after
        if self._waiting >= BLOCK:
            self.join()

    def _topic(self, channel: int) -> str:
        if channel not in self._topics:
            raise ValueError("a message is on no channel")
        return self._topics[channel]

    def _channel(self, data: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel

        channel = Channel.read(ReadDataStream(BytesIO(data)))
        if self._topics.setdefault(channel.id, channel.topic) != channel.topic:
            raise ParameterError(f"channel {channel.id} must be of one topic")

    def _count(self, channel: int, topic: str, number: int, count: int = 1) -> None:
        """Count messages of a channel; raise if some are missing.

        In older files all messages of this package are numbered together, from 0.
        """
        if not self.about:
            if topic not in _OURS:
                return
            channel, number = -1, number + 1
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
        (first,), found = _COUNT.unpack_from(data, at + _SAME), (end - at) // size
        self._count(channel, SAMPLE, first, found)
        self._runs.append(data[at:end])
        self._waiting += found
        return end

    def join(self) -> None:
        """Add the taken samples to their stretch.

        Raises:
            ParameterError: If a sample is invalid.
            ValueError: If samples are missing; those before the gap are added.
        """
        if not self._runs:
            return
        assert self._layout is not None
        if not self.parts:
            raise ParameterError("a sample must be in a stretch")
        messages = b"".join(self._runs)
        self._runs, self._waiting = [], 0
        records = np.frombuffer(messages, np.uint8).reshape(-1, _FRONT + self._layout.size)
        numbers = np.ascontiguousarray(records[:, _SAME : _SAME + 4]).view("<u4")[:, 0]
        good = 1 + int(np.argmin(np.append(np.diff(numbers) == 1, False)))
        rows = records[:good, _FRONT:]
        self._layout.check(rows)
        stretch = self._layout.values(rows, NUMBER)
        if (stretch != len(self.parts) - 1).any():
            wrong = stretch[stretch != len(self.parts) - 1][0]
            raise ParameterError(f"stretch must be {len(self.parts) - 1}, not {wrong:g}")
        values = {field.name: self._layout.values(rows, field) for field in (*FIELDS, *TOTALS)}
        self.parts[-1].columns.add(values)
        self._tick = int(values["tick"][-1])
        if good < len(records):
            raise ValueError("messages are missing")

    def _message(self, topic: str, data: bytes) -> None:
        self.join()
        if topic != SAMPLE:
            self._allowance.text(len(data))
        message, last = parsed(data), len(self.parts) - 1
        if topic == STRETCH:
            whole(message, "stretch", at_least=last + 1, at_most=last + 1)
            self.parts.append(Part(message, self._names))
        elif topic == EVENT:
            self._event(message, last)
        else:
            whole(message, "stretch", at_least=max(last, 0), at_most=last)
            self.parts[last].columns.add_row(sample_row(message))
            self._tick = message["tick"]

    def _event(self, message: Any, last: int) -> None:
        whole(message, "stretch", at_least=last, at_most=last)
        whole(message, "tick", at_least=self._tick, at_most=self._tick)
        kind, text = text_in(message, "kind"), text_in(message, "text")
        self.events.append(f"{kind}: {text}")
        self.event_samples.append(sum(map(len, self.parts)))
        if "missed" in message:
            missed = whole(message, "missed")
        else:  # of version 0.1.0: how many is in the text alone
            said = re.match(r"([0-9]{1,9}) ticks ", text) if kind == "missed" else None
            missed = int(said[1]) if said else 0
        if missed and last >= 0:
            part = self.parts[last]
            part.gaps.append((len(part), missed))

    def _attachment(self, data: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Attachment

        (said,) = struct.unpack("<I", data[-4:])
        if said not in (0, zlib.crc32(data[:-4])):
            raise ValueError("an attachment must have the checksum that it says")
        attached = Attachment.read(ReadDataStream(BytesIO(data)))
        self.attachments[attached.name] = attached.data

    def _metadata(self, data: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Metadata

        record = Metadata.read(ReadDataStream(BytesIO(data)))
        if record.name == METADATA and not self.parts:
            self.about = record.metadata
            if text_in(self.about, "format") != FORMAT:
                raise ParameterError(f"format must be {FORMAT}, not {json.dumps(self.about['format'])[:40]}")

    def _statistics(self, data: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Statistics

        said: Mapping[int, int] = Statistics.read(ReadDataStream(BytesIO(data))).channel_message_counts
        if not self.about:
            said = {-1: sum(count for channel, count in said.items() if self._topic(channel) in _OURS)}
        missing = sum(said.values()) - sum(self._counts.values())
        if missing or any(self._counts.get(channel, 0) != count for channel, count in said.items()):
            raise ValueError(f"{missing} messages are missing")
        self.counted = True
