"""Small recordings of every kind, valid and damaged, for tests."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from copy import deepcopy
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.frames import ZERO, Command
from maglev_mj.plants.hand import SpringHand
from maglev_mj.recording import Recording
from maglev_mj.recording.mcap import STRETCH_NUMBER as NUMBER
from maglev_mj.recording.mcap import layout_of, packed
from maglev_mj.recording.sample import FIELDS, TOTALS, as_rows
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.stick_slip import StickSlip
from maglev_mj.session import Pacer, Session
from maglev_mj.session.replay import write_run

Message = dict[str, Any]
Place = tuple[Any, ...]
"""Position of a value: names and indices from outside in."""


def _drop(path: Path) -> None:
    write_run(path, Drop(duration=0.08, force_limit=60.0), plant="exact")


def _press(path: Path) -> None:
    write_run(path, Press(hits=1, interval=0.08, duration=0.16), plant="exact")


def _stick_slip(path: Path) -> None:
    write_run(path, StickSlip(duration=0.06), plant="exact")


def _scene(path: Path) -> None:
    hand = SpringHand(target=[1e-3, 0.0, -2e-3, 0.0, 0.01, 0.0])
    session = Session(hand=hand, record=path, pacer=Pacer(budget=60.0, patience=3600.0))
    session.tick(0.05)
    session.act("friction")
    session.tick(0.05)
    session._pacer.missed += 3
    session.tick(0.05)  # after which it is told of
    session.tick(0.05)
    session.close()


KINDS: Mapping[str, Callable[[Path], None]] = {
    "drop": _drop,
    "press": _press,
    "stick-slip": _stick_slip,
    "scene": _scene,
}


@cache
def made(kind: str, suffix: str) -> bytes:
    """Return a file of one kind of run."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        KINDS[kind](path)
        return path.read_bytes()


FIELD = {field.name: field for field in (NUMBER, *FIELDS, *TOTALS)}
OURS = ("/maglev/stretch", "/maglev/sample", "/maglev/event")


def decoder(schema: Any) -> Callable[[bytes], Message]:
    """Return a decoder of messages by a file's schema, from the package of protobuf."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    if schema.encoding == "jsonschema":
        return json.loads
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return lambda data: plain(kind.FromString(data))


def plain(message: Any) -> Message:
    """Return a protobuf message as names and values, with None for NaN, as in JSON."""
    found: Message = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.is_repeated:
            found[field.name] = [plain(part) if field.message_type else part for part in value]
        elif field.message_type:
            found[field.name] = plain(value)
        else:
            found[field.name] = None if isinstance(value, float) and not np.isfinite(value) else value
    return found


def messages_in(data: bytes, topics: Collection[str] = OURS) -> list[tuple[str, Message]]:
    """Return topic and content of each message about the run."""
    from mcap.reader import make_reader

    reader, decoders = make_reader(BytesIO(data)), {}
    for schema in reader.get_summary().schemas.values():  # type: ignore[union-attr]
        decoders[schema.id] = decoder(schema)
    messages = reader.iter_messages(topics=list(topics), log_time_order=False)
    found = [(channel.topic, decoders[channel.schema_id](message.data)) for _, channel, message in messages]
    for topic, message in found:
        if topic == "/maglev/sample" and message.get("arrival", 0.0) is None:
            del message["arrival"]  # of a simulated plant; JSON has no word for it
    return found


def with_messages(data: bytes, change: Callable[[str, int, bytes], bytes | None]) -> bytes:
    """Return a file with other messages, numbered and packed anew.

    Args:
        data: A file.
        change: Returns the bytes of a message of some topic, and of which in that; None to leave it out.
    """
    from mcap.reader import make_reader
    from mcap.writer import Writer

    file, reader = BytesIO(), make_reader(BytesIO(data))
    writer = Writer(file)
    writer.start()
    for about in reader.iter_metadata():
        writer.add_metadata(about.name, about.metadata)
    for attached in reader.iter_attachments():
        writer.add_attachment(
            attached.create_time, attached.log_time, attached.name, attached.media_type, attached.data
        )
    ids: dict[str, int] = {}
    counts: dict[str, int] = {}
    places: dict[str, int] = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        topic = channel.topic
        if topic not in ids:
            made_from = writer.register_schema(schema.name, schema.encoding, schema.data)  # type: ignore[union-attr]
            ids[topic] = writer.register_channel(topic, channel.message_encoding, made_from)
        places[topic] = places.get(topic, -1) + 1
        new = change(topic, places[topic], message.data)
        if new is not None:
            counts[topic] = counts.get(topic, 0) + 1
            writer.add_message(ids[topic], message.log_time, new, message.publish_time, counts[topic])
    writer.finish()
    return file.getvalue()


def with_value(data: bytes, row: int, column: str, value: float) -> bytes:
    """Return a file with another number in one sample."""

    def new(topic: str, place: int, message: bytes) -> bytes:
        if topic != "/maglev/sample" or place != row:
            return message
        found = bytearray(message)
        for name, first in layout_of(message)._places.items():
            for axis, (unit, _) in enumerate(FIELD[name].units):
                if unit == column:
                    struct.pack_into("<d" if FIELD[name].unit else "<Q", found, first + 9 * axis, value)
        return bytes(found)

    return with_messages(data, new)


def mcap_of(messages: list[tuple[str, Message]], *, compressed: bool = True, chunk_size: int = 1 << 20) -> bytes:
    """Return a complete file of messages about a run.

    Its chunks have at least `chunk_size` bytes. Numbers outside JSON are written as Python does.
    """
    from mcap.writer import CompressionType, Writer

    file = BytesIO()
    compression = CompressionType.ZSTD if compressed else CompressionType.NONE
    writer = Writer(file, chunk_size, compression=compression)
    writer.start()
    writer.add_metadata("maglev_mj", {"format": "2"})
    schema = writer.register_schema(name="any", encoding="jsonschema", data=b"{}")
    topics = dict.fromkeys(topic for topic, _ in messages)
    channels = {topic: writer.register_channel(topic, "json", schema) for topic in topics}
    counts = dict.fromkeys(topics, 0)
    for number, (topic, message) in enumerate(messages):
        counts[topic] += 1
        data = packed_sample(message) if topic == "/maglev/sample" else json.dumps(message).encode()
        writer.add_message(channels[topic], log_time=number, publish_time=number, data=data, sequence=counts[topic])
    writer.finish()
    return file.getvalue()


def packed_sample(message: Message) -> bytes:
    """Return a sample, given by names and values, as a protobuf message; None stands for NaN."""
    values = []
    for fields in (FIELDS, TOTALS):
        parts = [message.get(field.name) for field in fields]
        flat = [one for part in parts for one in (part.values() if isinstance(part, dict) else [part])]
        values.append([np.nan if one is None else one for one in flat])
    return packed(message["stretch"], as_rows(values[0]), np.array([values[1]]))[0]


def arrays_in(data: bytes) -> tuple[Message, dict[str, Any]]:
    """Return header and arrays of a file, without attachments."""
    with np.load(BytesIO(data)) as file:
        header = json.loads(str(file["header"]))
        names = [name for name in file.files if name != "header" and not name.startswith("attachment/")]
        return {**header, "attachments": []}, {name: file[name].copy() for name in names}


def npz_of(header: Message, arrays: Mapping[str, Any], *, compressed: bool = False) -> bytes:
    """Return a file of arrays."""
    file = BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(file, header=np.array(json.dumps(header)), **arrays)
    return file.getvalue()


def command_row(command: Command) -> list[float]:
    """Return a command as 13 numbers: held wrench, pulse, pulse width."""
    return [*command.force, *(command.extra or ZERO), command.pulse_width if command.extra else 0.0]


def numbers_in(value: Any, place: Place = ()) -> Iterator[Place]:
    """Yield the positions of numbers, switches and nulls, but those of the code's versions."""
    if isinstance(value, dict | list):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            if key != "versions":
                yield from numbers_in(part, (*place, key))
    elif not isinstance(value, str):
        yield place


def some_of(places: Iterable[Any], named: Callable[[Any], str], seed: int) -> list[Any]:
    """Return one random position of each field."""
    found: dict[str, list[Any]] = {}
    for place in places:
        found.setdefault(named(place), []).append(place)
    random = np.random.default_rng(seed)
    return [places[random.integers(len(places))] for places in found.values()]


def changed(value: Any, place: Place, new: Any) -> Any:
    """Return a copy with another value somewhere."""
    copy = deepcopy(value)
    inner = copy
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = new
    return copy


def load(data: bytes, folder: Path, suffix: str) -> Recording:
    """Return the recording in a file of these bytes."""
    path = folder / f"changed{suffix}"
    path.write_bytes(data)
    return Recording.load(path)
