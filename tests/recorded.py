"""Small recordings of every kind for tests, and files of both kinds written as nobody's writer would."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.frames import ZERO, Command
from maglev_mj.hand import SpringHand
from maglev_mj.recording import Recording
from maglev_mj.replay import write_run
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.stick_slip import StickSlip
from maglev_mj.session import Pacer, Session

Message = dict[str, Any]
Place = tuple[Any, ...]
"""Where a value is: names and indices from the outside in."""


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


def messages_in(data: bytes) -> list[tuple[str, Message]]:
    """Return topic and content of each message of a file."""
    from mcap.reader import make_reader

    found = make_reader(BytesIO(data)).iter_messages(log_time_order=False)
    return [(channel.topic, json.loads(message.data)) for _, channel, message in found]


def mcap_of(messages: list[tuple[str, Message]], *, compressed: bool = True) -> bytes:
    """Return a whole file of messages, in which numbers that JSON does not know are written as Python does."""
    from mcap.writer import CompressionType, Writer

    file = BytesIO()
    writer = Writer(file, compression=CompressionType.ZSTD if compressed else CompressionType.NONE)
    writer.start()
    schema = writer.register_schema(name="any", encoding="jsonschema", data=b"{}")
    topics = dict.fromkeys(topic for topic, _ in messages)
    channels = {topic: writer.register_channel(topic, "json", schema) for topic in topics}
    for number, (topic, message) in enumerate(messages):
        data = json.dumps(message).encode()
        writer.add_message(channels[topic], log_time=number, publish_time=number, data=data, sequence=number)
    writer.finish()
    return file.getvalue()


def arrays_in(data: bytes) -> tuple[Message, dict[str, Any]]:
    """Return header and arrays of a file."""
    with np.load(BytesIO(data)) as file:
        return json.loads(str(file["header"])), {name: file[name].copy() for name in file.files if name != "header"}


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
    """Yield where there are numbers, switches and nothings, but for those of the code that made it."""
    if isinstance(value, dict | list):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            if key != "versions":
                yield from numbers_in(part, (*place, key))
    elif not isinstance(value, str):
        yield place


def changed(value: Any, place: Place, new: Any) -> Any:
    """Return a copy with another value somewhere."""
    copy = deepcopy(value)
    inner = copy
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = new
    return copy


def load(data: bytes, folder: Path, suffix: str) -> Recording:
    """Return what is in a file of these bytes."""
    path = folder / f"changed{suffix}"
    path.write_bytes(data)
    return Recording.load(path)
