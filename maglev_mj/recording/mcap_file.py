"""Recordings as MCAP, which other programs open: written as they happen, read as far as they go.

The format is at https://mcap.dev, the package is the extra `record`. Messages are JSON with a schema. Python writes a
float in as many digits as give the same float when it is read, so nothing is lost.
"""

from __future__ import annotations

import json
import math
import struct
from array import array
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from typing import IO, Any

import numpy as np

import maglev_mj
from maglev_mj.errors import MaglevError
from maglev_mj.frames import AXES, Array, Command, Sample
from maglev_mj.metrics import PassivityObserver
from maglev_mj.plants import Timing
from maglev_mj.recording.recorder import Mechanics
from maglev_mj.recording.ring import Row
from maglev_mj.recording.schemas import CHANNELS, as_row, as_sample
from maglev_mj.recording.stretch import Recording, RecordingError, Setup, Stretch

__all__ = ["MAGIC", "About", "McapMissingError", "Scribe", "about", "read_mcap", "require_mcap"]

MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of a file."""

About = Mapping[str, Any]
"""What a stretch is, ready for JSON: see `about`."""

_CHUNK = 8 * 1024  # about a dozen samples: at 50 Hz a quarter of a second
_STRETCH, _SAMPLE, _EVENT = CHANNELS


class McapMissingError(MaglevError):
    """The package that writes and reads MCAP is not installed."""


def require_mcap() -> None:
    """Check that MCAP can be written and read.

    Raises:
        McapMissingError: If the package is not installed.
    """
    if find_spec("mcap") is None:
        raise McapMissingError("recordings as MCAP need mcap: pip install 'maglev-mj[record]'")


def about(
    setup: Setup, *, period: float, delay: float, carried: Sequence[float], began: int, mechanics: Mechanics
) -> About:
    """Return what a stretch is.

    Args:
        setup: What plant and controller are made from, and the `versions` of the code.
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        carried: Wrench that carries the flotor [N, N m], six.
        began: When, since 1970 [ns].
        mechanics: What the actuators push at.
    """
    six = {name: np.broadcast_to(getattr(mechanics, name), 6).tolist() for name in ("inertia", "load", "before")}
    return {"setup": dict(setup), "period": period, "delay": delay, "carried": list(carried), "began": began, **six}


class Scribe:
    """Writes a recording as it happens.

    Args:
        file: A file to write to; it is left open.
    """

    def __init__(self, file: IO[bytes]) -> None:
        from mcap.writer import Writer

        self._file, self._writer = file, Writer(file, chunk_size=_CHUNK)
        self._writer.start(profile="", library=f"maglev_mj {maglev_mj.__version__}")
        self._channels = {topic: self._channel(topic, schema) for topic, schema in CHANNELS.items()}
        self._stretch, self._tick, self._missed = -1, 0, 0
        self._began = self._now = 0
        self._first: float | None = None
        self._said = 0  # messages, so that a reader knows whether some are missing

    def begin(self, what: About) -> None:
        """Begin a stretch."""
        self._stretch += 1
        self._missed, self._first = 0, None
        # a run that is faster than real time must not lie over the next
        self._began = self._now = max(int(what["began"]), self._now + 1)
        self._energy = _Energy(what)
        named = {
            "stretch": self._stretch,
            "setup": what["setup"],
            "period": what["period"],
            "delay": what["delay"],
            **{name: dict(zip(AXES, what[name], strict=True)) for name in ("carried", "inertia", "load", "before")},
            "versions": {**what["setup"]["versions"], "mcap": version("mcap")},
        }
        self._say(_STRETCH, named)

    def row(self, row: Row) -> None:
        """Write a sample."""
        sample = as_sample(row)
        tick = sample["tick"]
        if self._first is None:  # a device counts on from stretch to stretch
            self._first, self._tick = row[1], tick - 1
        self._missed += max(tick - self._tick - 1, 0)
        self._tick = tick
        self._now = max(self._now, self._began + round((row[1] - self._first) * 1e9))
        self._energy.add(row)
        more = {"taken": self._energy.taken, "hand_work": self._energy.hand, "missed": self._missed}
        self._say(_SAMPLE, {"stretch": self._stretch, **sample, **more})

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Write what happened.

        Args:
            kind: What sort of thing.
            text: For a person.
            missed: Samples that were missed with it.
        """
        self._missed += missed
        self._say(_EVENT, {"stretch": self._stretch, "tick": self._tick, "kind": kind, "text": text})

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


def _finite(value: Any) -> Any:
    """Return what is to be said with None for what is no finite number."""
    if isinstance(value, Mapping):
        return {name: _finite(part) for name, part in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Energy:
    """Adds up what the rendered world takes in and what the hand does, from the samples."""

    def __init__(self, what: About) -> None:
        timing = Timing(period=what["period"], delay=what["delay"])
        self._carried = np.array(what["carried"])
        load, before = self._carried + what["load"], np.array(what["before"]) - self._carried
        self._observer = PassivityObserver(timing, what["inertia"], load, before)
        self._pose: Array | None = None
        self._effort = np.zeros(6)
        self.hand = 0.0

    @property
    def taken(self) -> float:
        return float(self._observer.energy.sum())

    def add(self, row: Row) -> None:
        pose, force = np.array(row[2:8]), np.array(row[21:27]) - self._carried
        command = Command(force.tolist(), row[27:33], row[33]) if row[33] else Command(force.tolist())
        self._observer(Sample(int(row[0]), row[1], row[2:8]), command)
        if self._pose is not None:
            self.hand += float(self._effort @ (pose - self._pose))
        self._pose, self._effort = pose, np.array(row[34:40])


def read_mcap(file: IO[bytes], name: str) -> Recording:
    """Read a recording as far as it goes: one whose writer was killed, up to its last whole chunk.

    Args:
        file: What to read.
        name: What to call it.

    Raises:
        McapMissingError: If the package is not installed.
        RecordingError: If there is no recording in it.
    """
    require_mcap()
    from mcap.exceptions import EndOfFile
    from mcap.records import Channel, Footer, Message, Statistics
    from mcap.stream_reader import StreamReader

    topics: dict[int, str] = {}
    found, damage = _Found(), "its end is missing"
    try:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message) and topics[record.channel_id] in CHANNELS:
                if record.sequence != found.count & 0xFFFFFFFF:
                    raise ValueError("messages are missing")
                found.take(topics[record.channel_id], json.loads(record.data))
            elif isinstance(record, Statistics):
                counted = sum(n for channel, n in record.channel_message_counts.items() if topics[channel] in CHANNELS)
                if counted != found.count:
                    raise ValueError(f"{counted - found.count} messages are missing")
            elif isinstance(record, Footer):
                damage = ""
    except (EndOfFile, struct.error):
        pass
    except Exception as error:  # of the reader, of what decompresses, of JSON: what came before it is good
        damage = f"it is damaged: {error}"
    if not found.setups:
        raise RecordingError(f"{name!r} is not a whole recording{damage and f': {damage}'}")
    return found.recording(damage)


class _Found:
    """What has been read so far; a sample is 40 numbers, for there may be many."""

    def __init__(self) -> None:
        self.setups: list[Setup] = []
        self.count = 0
        self._rows: list[array[float]] = []
        self._events: list[str] = []

    def take(self, topic: str, message: Mapping[str, Any]) -> None:
        """Take one message."""
        self.count += 1
        if topic == _STRETCH:
            self.setups.append(message["setup"])
            self._rows.append(array("d"))
        elif topic == _SAMPLE:
            self._rows[message["stretch"]].extend(as_row(message))
        elif topic == _EVENT:
            self._events.append(f"{message['kind']}: {message['text']}")

    def recording(self, damage: str) -> Recording:
        """Return it."""
        rows = [np.array(part).reshape(-1, 40) for part in self._rows]
        stretches = [_stretch(setup, part) for setup, part in zip(self.setups, rows, strict=True) if len(part)]
        return Recording(stretches, events=self._events, damage=damage)


def _stretch(setup: Setup, rows: Array) -> Stretch:
    return Stretch(
        setup=setup,
        tick=rows[:, 0],
        time=rows[:, 1],
        position=rows[:, 2:8],
        command=rows[:, 8:21],
        applied=rows[:, 21:34],
        hand=rows[:, 34:40],
    )
