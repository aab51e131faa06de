"""Recordings as MCAP, read as far as they go."""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array
from maglev_mj.parameters import number
from maglev_mj.recording.fields import check_setup, checked, object_in, parsed, sample_row, six, text_in, whole
from maglev_mj.recording.schemas import CHANNELS
from maglev_mj.recording.stretch import Basis, Recording, Stretch
from maglev_mj.recording.unpacking import LARGEST_PART, Allowance, UnpackingError, unpacked

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

__all__ = ["MAGIC", "McapMissingError", "read_mcap", "require_mcap"]

MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of a file."""

_STRETCH, _SAMPLE, _EVENT = CHANNELS
_MOST_MESSAGE = 1 << 20
_MOST_RECORD = LARGEST_PART + (1 << 20)


class McapMissingError(MaglevError):
    """The package that writes and reads MCAP is not installed."""


def require_mcap() -> None:
    """Check that MCAP can be written and read.

    Raises:
        McapMissingError: If the package is not installed.
    """
    if find_spec("mcap") is None:
        raise McapMissingError("recordings as MCAP need mcap: pip install 'maglev-mj[record]'")


def read_mcap(file: IO[bytes], size: int) -> Recording:
    """Read a recording as far as it goes: one whose writer was killed, up to its last whole chunk.

    Args:
        file: What to read.
        size: Of the file [bytes].

    Raises:
        McapMissingError: If the package is not installed.
        ParameterError: If there is no recording in it, or it holds what none can.
    """
    require_mcap()
    from mcap.exceptions import EndOfFile
    from mcap.records import Channel, Message, Statistics

    topics: dict[int, str] = {}
    allowance = Allowance(size)
    found, counted, damage = _Found(allowance), False, ""
    try:
        for record in _records(file, allowance):
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message) and _topic(topics, record.channel_id) in CHANNELS:
                if record.sequence != found.count & 0xFFFFFFFF:
                    raise ValueError("messages are missing")
                found.take(topics[record.channel_id], record.data)
            elif isinstance(record, Statistics):
                counts = record.channel_message_counts.items()
                said = sum(count for channel, count in counts if _topic(topics, channel) in CHANNELS)
                if said != found.count:
                    raise ValueError(f"{said - found.count} messages are missing")
                counted = True
        if not counted:
            damage = "its count of messages is missing"
        elif file.read(1):
            damage = "there is more behind its end"
    except ParameterError:
        raise
    except (EndOfFile, struct.error):
        damage = "its end is missing"
    except Exception as error:  # of the reader, of what unpacks: what came before it is good
        damage = f"it is damaged: {error or type(error).__name__}"
    if not found.parts:
        raise ParameterError(damage or "nothing of a recording is in it")
    return found.recording(damage)


def _topic(topics: Mapping[int, str], channel: int) -> str:
    if channel not in topics:
        raise ValueError("a message is on no channel")
    return topics[channel]


def _records(file: IO[bytes], allowance: Allowance) -> Iterator[McapRecord]:
    """Yield what is in a file, chunks unpacked."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=_MOST_RECORD)
    for record in reader.records:
        if isinstance(record, Chunk):
            allowance.part(record.uncompressed_size)
            yield from _inside(record)
        else:
            yield record


def _inside(chunk: Chunk) -> Iterator[McapRecord]:
    """Yield what is in a chunk, one by one: as objects, all of it would take many times its size."""
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message, Schema

    data = unpacked(chunk)
    stream = ReadDataStream(BytesIO(data))
    while stream.count < len(data):
        kind, length = stream.read1(), stream.read8()
        if length > _MOST_MESSAGE:
            raise UnpackingError(f"a message must have at most {_MOST_MESSAGE} bytes, not {length}")
        if kind == Opcode.MESSAGE:
            yield Message.read(stream, length)
        elif kind in (Opcode.CHANNEL, Opcode.SCHEMA):
            yield Channel.read(stream) if kind == Opcode.CHANNEL else Schema.read(stream)
        else:
            raise UnpackingError(f"a chunk must hold schemas, channels and messages alone, not records of kind {kind}")


class _Part:
    """A stretch as far as it is read; a sample is 43 numbers, for there may be many."""

    def __init__(self, message: Any) -> None:
        self.setup = check_setup(object_in(message, "setup"))
        self.basis = Basis(
            period=number("period", message.get("period"), above=0.0, at_most=1e3),
            delay=number("delay", message.get("delay"), at_least=0.0, at_most=1e3),
            carried=six(message, "carried"),
            inertia=six(message, "inertia", at_least=1e-12),
            load=six(message, "load"),
            before=six(message, "before"),
        )
        self.numbers = array("d")
        self.gaps: list[tuple[int, int]] = []

    def stretch(self) -> Stretch:
        rows: Array = np.array(self.numbers).reshape(-1, 43)
        return checked(
            Stretch(
                setup=self.setup,
                tick=rows[:, 0],
                time=rows[:, 1],
                position=rows[:, 2:8],
                command=rows[:, 8:21],
                applied=rows[:, 21:34],
                hand=rows[:, 34:40],
                totals=rows[:, 40:43],
                basis=self.basis,
                gaps=self.gaps,
            )
        )


class _Found:
    """What has been read so far.

    Args:
        allowance: How much text may be kept.
    """

    def __init__(self, allowance: Allowance) -> None:
        self.parts: list[_Part] = []
        self.count = 0
        self._allowance, self._tick = allowance, 0
        self._events: list[str] = []

    def take(self, topic: str, data: bytes) -> None:
        """Take one message.

        Raises:
            ParameterError: If it is not one that a recording has.
        """
        if len(data) > _MOST_MESSAGE:
            raise UnpackingError(f"a message must have at most {_MOST_MESSAGE} bytes, not {len(data)}")
        if topic != _SAMPLE:
            self._allowance.text(len(data))
        message, last = parsed(data), len(self.parts) - 1
        self.count += 1
        if topic == _STRETCH:
            whole(message, "stretch", at_least=last + 1, at_most=last + 1)
            self.parts.append(_Part(message))
        elif topic == _SAMPLE:
            whole(message, "stretch", at_least=max(last, 0), at_most=last)
            self.parts[last].numbers.extend(sample_row(message))
            self._tick = message["tick"]
        else:
            self._event(message, last)

    def _event(self, message: Any, last: int) -> None:
        whole(message, "stretch", at_least=last, at_most=last)
        whole(message, "tick", at_least=self._tick, at_most=self._tick)
        kind, text = text_in(message, "kind"), text_in(message, "text")
        self._events.append(f"{kind}: {text}")
        if "missed" in message:
            missed = whole(message, "missed")
        else:  # of version 0.1.0: how many is in the text alone
            said = re.match(r"([0-9]{1,9}) ticks ", text) if kind == "missed" else None
            missed = int(said[1]) if said else 0
        if missed and last >= 0:
            part = self.parts[last]
            part.gaps.append((len(part.numbers) // 43, missed))

    def recording(self, damage: str) -> Recording:
        """Return it."""
        stretches = [part.stretch() for part in self.parts if part.numbers]
        return Recording(stretches, events=self._events, damage=damage)
