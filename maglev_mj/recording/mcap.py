"""Recordings as MCAP, which other programs open, written as they happen and read as far as they go.

The format is at https://mcap.dev, the package is the extra `record`. Messages are JSON with a schema. Python writes a
float in as many digits as give the same float when it is read, so nothing is lost.
"""

from __future__ import annotations

import json
import math
import re
import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any

import numpy as np

import maglev_mj
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES
from maglev_mj.recording.checks import (
    LARGEST_PART,
    Allowance,
    UnpackingError,
    check_rows,
    check_setup,
    object_in,
    parsed,
    sample_row,
    text_in,
    unpacked,
    whole,
)
from maglev_mj.recording.metadata import RunMetadata, Setup, Totals
from maglev_mj.recording.recording import Recording, Stretch
from maglev_mj.recording.row import FIELDS, TOTALS, Field, Row, as_rows, named, schema

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

__all__ = ["CHANNELS", "MAGIC", "McapMissingError", "McapWriter", "read_mcap", "require_mcap"]

MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of a file."""

_CHUNK = 8 * 1024  # about a dozen samples: at 50 Hz a quarter of a second
_MOST_MESSAGE = 1 << 20
_MOST_RECORD = LARGEST_PART + (1 << 20)
_WRENCH = "N", "N m"

_NUMBER = schema(Field("stretch", "", "number of the stretch, from 0"))
_SAMPLE_FIELDS = {"stretch": _NUMBER, **{field.name: schema(field) for field in (*FIELDS, *TOTALS)}}

_STRETCH_FIELDS = {
    "stretch": _NUMBER,
    "setup": {
        "type": "object",
        "description": "what plant and controller are made from: kind, parameters, calibration, versions",
    },
    "period": schema(Field("period", "s", "sample period")),
    "delay": schema(Field("delay", "s", "from a sample to its command taking effect")),
    "carried": schema(Field("carried", _WRENCH, "what carries the flotor")),
    "inertia": schema(Field("inertia", ("kg", "kg m²"), "what the actuators push at, for `taken`")),
    "load": schema(Field("load", _WRENCH, "what acts besides, its weight, for `taken`")),
    "before": schema(Field("before", _WRENCH, "what the actuators give until the first command takes effect")),
    "faces": {
        "type": "array",
        "description": "planes of walls: axis, normal (1 where the axis is free above), edge [m, rad]",
        "items": {"type": "object"},
    },
    "name": {"type": "string", "description": "what to call the run"},
    "axis": {"type": "string", "description": "the axis that matters most"},
    "hand_recorded": {"type": "boolean", "description": "whether `hand` is what the hand exerts"},
    "hand_acts_on_flotor": {"type": "boolean", "description": "whether it acts there, not on a hand in a soft grip"},
    "versions": {
        "type": "object",
        "description": "of maglev_mj, python, mujoco, numpy, mcap; git revision, if changed, and digest of the sources",
    },
}

_EVENT_FIELDS = {
    "stretch": _NUMBER,
    "tick": _SAMPLE_FIELDS["tick"],
    "kind": {"type": "string", "description": "fault, missed, lost or timing"},
    "text": {"type": "string", "description": "what happened"},
    "missed": schema(Field("missed", "", "samples that were missed with it, besides gaps in the ticks")),
}


def _schema(name: str, fields: Mapping[str, Any], says: str) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"maglev_mj.{name}",
        "description": says,
        "type": "object",
        "properties": dict(fields),
        "required": list(fields),
    }


CHANNELS: Mapping[str, Mapping[str, Any]] = {
    "/maglev/stretch": _schema(
        "Stretch", _STRETCH_FIELDS, "a controller and a plant begin; axes are those of the stator"
    ),
    "/maglev/sample": _schema("Sample", _SAMPLE_FIELDS, "one sample and its answer"),
    "/maglev/event": _schema("Event", _EVENT_FIELDS, "something that a person should know of"),
}
"""JSON schema of the messages of each topic."""

_STRETCH, _SAMPLE, _EVENT = CHANNELS


_TOTALS = tuple(field.name for field in TOTALS)


class McapMissingError(MaglevError):
    """The package that writes and reads MCAP is not installed."""


def require_mcap() -> None:
    """Check that MCAP can be written and read.

    Raises:
        McapMissingError: If the package is not installed.
    """
    if find_spec("mcap") is None:
        raise McapMissingError("recordings as MCAP need mcap: pip install 'maglev-mj[record]'")


class McapWriter:
    """Writes a recording as it happens.

    Args:
        file: A file to write to; it is left open.
    """

    def __init__(self, file: IO[bytes]) -> None:
        from mcap.writer import Writer

        self._file, self._writer = file, Writer(file, chunk_size=_CHUNK)
        self._writer.start(profile="", library=f"maglev_mj {maglev_mj.__version__}")
        self._channels = {topic: self._channel(topic, schema) for topic, schema in CHANNELS.items()}
        self._stretch, self._tick = -1, 0
        self._began = self._now = 0
        self._first: float | None = None
        self._totals: Totals | None = None
        self._said = 0  # messages, so that a reader knows whether some are missing

    def begin(self, setup: Setup, began: int) -> None:
        """Begin a stretch.

        Args:
            setup: What plant and controller are made from, with the `versions` of the code and the metadata as `run`.
            began: When, since 1970 [ns].
        """
        self._stretch += 1
        self._first = None
        # a run that is faster than real time must not lie over the next
        self._began = self._now = max(began, self._now + 1)
        run = setup["run"]
        self._totals = Totals(RunMetadata.from_json(run))
        told = {
            "stretch": self._stretch,
            "setup": {name: part for name, part in setup.items() if name != "run"},
            **run,
            "versions": {**setup["versions"], "mcap": version("mcap")},
        }
        self._say(_STRETCH, told)

    def row(self, row: Row) -> None:
        """Write a sample of the stretch that was begun."""
        assert self._totals is not None
        values = named(row)
        if self._first is None:
            self._first = values["time"]
        self._tick = int(values["tick"])
        self._now = max(self._now, self._began + round((values["time"] - self._first) * 1e9))
        values |= zip(_TOTALS, self._totals.add(values), strict=True)
        sample = {field.name: _as_json(field, values[field.name]) for field in (*FIELDS, *TOTALS)}
        self._say(_SAMPLE, {"stretch": self._stretch, **sample})

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Write what happened.

        Args:
            kind: What sort of thing.
            text: For a person.
            missed: Samples that were missed with it.
        """
        if self._totals is not None:
            self._totals.miss(missed)
        told = {"kind": kind, "text": text, "missed": missed}
        self._say(_EVENT, {"stretch": self._stretch, "tick": self._tick, **told})

    def flush(self) -> None:
        """Hand what is written over to the system, but for the last samples that make no whole chunk yet."""
        self._file.flush()

    def close(self) -> None:
        """Write the rest, and the index."""
        self._writer.finish()
        self._file.flush()

    def _channel(self, topic: str, schema: Mapping[str, Any]) -> int:
        text = json.dumps(schema, ensure_ascii=False).encode()
        number = self._writer.register_schema(name=schema["title"], encoding="jsonschema", data=text)
        return self._writer.register_channel(topic=topic, message_encoding="json", schema_id=number)

    def _say(self, topic: str, message: Mapping[str, Any]) -> None:
        try:
            text = json.dumps(message, allow_nan=False, separators=(",", ":"))
        except ValueError:  # a command that is not finite, which the plant refused: JSON has no word for it
            text = json.dumps(_finite(message), allow_nan=False, separators=(",", ":"))
        data = text.encode()
        now, place = self._now, self._said
        self._writer.add_message(self._channels[topic], log_time=now, publish_time=now, data=data, sequence=place)
        self._said = (place + 1) & 0xFFFFFFFF


def _as_json(field: Field, value: Any) -> Any:
    if field.six:
        return dict(zip(AXES, value, strict=True))
    return value if field.unit else int(value)


def _finite(value: Any) -> Any:
    """Return what is to be said with None for what is no finite number."""
    if isinstance(value, Mapping):
        return {name: _finite(part) for name, part in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
    """A stretch as far as it is read; a sample is a row of numbers, for there may be many."""

    def __init__(self, message: Any) -> None:
        self.setup = check_setup(object_in(message, "setup"))
        self.metadata = RunMetadata.from_json(message)
        self.numbers = array("d")
        self.count = 0
        self.gaps: list[tuple[int, int]] = []

    def add(self, row: Sequence[float]) -> None:
        """Take one sample."""
        self.numbers.extend(row)
        self.count += 1

    def stretch(self) -> Stretch:
        """Return it."""
        table = np.array(self.numbers).reshape(self.count, -1)
        rows, totals = as_rows(table[:, : -len(TOTALS)]), as_rows(table[:, -len(TOTALS) :], TOTALS)
        check_rows(rows, totals)
        return Stretch(setup=self.setup, rows=rows, totals=totals, metadata=self.metadata, gaps=self.gaps)


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
            self.parts[last].add(sample_row(message))
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
            part.gaps.append((part.count, missed))

    def recording(self, damage: str) -> Recording:
        """Return it."""
        stretches = [part.stretch() for part in self.parts if part.count]
        return Recording(stretches, events=self._events, damage=damage)
