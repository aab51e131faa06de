"""Recordings as MCAP, which other programs open, written as they happen.

The format is at https://mcap.dev, the package is the extra `record`. Messages are JSON with a schema. Python writes a
float in as many digits as give the same float when it is read, so nothing is lost.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import IO, Any

import numpy as np

import maglev_mj
from maglev_mj.frames import AXES
from maglev_mj.recording.recorder import Mechanics
from maglev_mj.recording.ring import Row
from maglev_mj.recording.schemas import CHANNELS, as_sample
from maglev_mj.recording.stretch import Basis, Setup
from maglev_mj.recording.totals import Totals

__all__ = ["About", "Scribe", "about"]

About = Mapping[str, Any]
"""What a stretch is, ready for JSON: see `about`."""

_CHUNK = 8 * 1024  # about a dozen samples: at 50 Hz a quarter of a second
_STRETCH, _SAMPLE, _EVENT = CHANNELS
_SIX = ("carried", "inertia", "load", "before")


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
        self._stretch, self._tick = -1, 0
        self._began = self._now = 0
        self._first: float | None = None
        self._totals: Totals | None = None
        self._said = 0  # messages, so that a reader knows whether some are missing

    def begin(self, what: About) -> None:
        """Begin a stretch."""
        self._stretch += 1
        self._first = None
        # a run that is faster than real time must not lie over the next
        self._began = self._now = max(int(what["began"]), self._now + 1)
        self._totals = Totals(Basis(**{name: what[name] for name in ("period", "delay", *_SIX)}))
        named = {
            "stretch": self._stretch,
            "setup": what["setup"],
            "period": what["period"],
            "delay": what["delay"],
            **{name: dict(zip(AXES, what[name], strict=True)) for name in _SIX},
            "versions": {**what["setup"]["versions"], "mcap": version("mcap")},
        }
        self._say(_STRETCH, named)

    def row(self, row: Row) -> None:
        """Write a sample of the stretch that was begun."""
        assert self._totals is not None
        sample = as_sample(row)
        if self._first is None:
            self._first = row[1]
        self._tick = sample["tick"]
        self._now = max(self._now, self._began + round((row[1] - self._first) * 1e9))
        taken, hand_work, missed = self._totals.add(row)
        more = {"taken": taken, "hand_work": hand_work, "missed": missed}
        self._say(_SAMPLE, {"stretch": self._stretch, **sample, **more})

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


def _finite(value: Any) -> Any:
    """Return what is to be said with None for what is no finite number."""
    if isinstance(value, Mapping):
        return {name: _finite(part) for name, part in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
