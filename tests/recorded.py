"""Small recordings of every kind, valid and damaged, for tests."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from copy import deepcopy
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.frames import AXES, ZERO, Command
from maglev_mj.plants.hand import SpringHand
from maglev_mj.recording import Recording
from maglev_mj.recording.export import export
from maglev_mj.recording.journal import (
    SAMPLE,
    TEXT,
    Seal,
    byte_records,
    header,
    open_journal,
    sample_records,
)
from maglev_mj.recording.sample import FIELDS, ROW
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.stick_slip import Pull
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
    write_run(path, Pull(duration=0.06), plant="exact")


def _scene(path: Path) -> None:
    hand = SpringHand(target=[1e-3, 0.0, -2e-3, 0.0, 0.01, 0.0])
    session = Session(hand_force=hand, record=path, pacer=Pacer(budget=60.0, patience=3600.0))
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
def made(kind: str) -> bytes:
    """Return a file of one kind of run."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.maglev"
        KINDS[kind](path)
        return path.read_bytes()


OURS = ("/maglev/segment", "/maglev/sample", "/maglev/event")


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
    """Return topic and content of each message of an MCAP file."""
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


Part = Message | Any
"""A message, or a sample: a structured array (1,)."""


def parts_in(data: bytes) -> list[Part]:
    """Return the messages and samples of a journal, in order."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "run.maglev")
        path.write_bytes(data)
        journal = open_journal(path)
        found: list[Part] = []
        for index, kind in enumerate(journal.kinds.tolist()):
            if kind == TEXT:
                found.append(journal.message(index))
            elif kind == SAMPLE:
                sample = np.empty(1, ROW)
                for name in ROW.names or ():
                    sample[name] = journal.records[name][index]
                found.append(sample)
        del journal  # its memory is the file's
    return found


def journal_of(parts: Iterable[Part]) -> bytes:
    """Return a journal of messages and samples, in one block.

    Numbers outside JSON are written as Python does.
    """
    records = [
        byte_records(json.dumps(part).encode()) if isinstance(part, dict) else sample_records(part) for part in parts
    ]
    block = b"".join(records)
    return (head := header()) + block + Seal(head)(block)


def with_value(data: bytes, row: int, column: str, value: float) -> bytes:
    """Return a journal with another number in one sample."""
    parts = parts_in(data)
    samples = [index for index, part in enumerate(parts) if not isinstance(part, dict)]
    sample = parts[samples[row]] = parts[samples[row]].copy()
    name, _, axis = column.partition(".")
    if axis:
        sample[name][0, AXES.index(axis)] = value
    else:
        sample[name] = value
    return journal_of(parts)


COLUMNS = [name for field in FIELDS for name, _ in field.units]
"""Columns of a sample."""


def exported(data: bytes, kind: str) -> bytes:
    """Return an export of a journal."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"run.{kind}")
        export(load(data, Path(folder)), kind, path)
        return path.read_bytes()


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


def load(data: bytes, folder: Path) -> Recording:
    """Return the recording in a journal of these bytes."""
    path = folder / "changed.maglev"
    path.write_bytes(data)
    return Recording.load(path)
