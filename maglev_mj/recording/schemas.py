"""What a recording says in JSON: its channels, their fields and units, so that any program can plot them by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from maglev_mj.frames import AXES
from maglev_mj.recording.ring import Row

__all__ = ["CHANNELS", "COLUMNS", "as_sample", "flat"]

_UNITS = {
    "pose": ("m", "rad"),
    "wrench": ("N", "N m"),
    "inertia": ("kg", "kg m²"),
}

_SIX: Mapping[str, tuple[str, str]] = {
    "position": ("pose", "what the controller saw"),
    "command": ("wrench", "what it answered, held"),
    "pulse": ("wrench", "what it answered, for as long as a pulse"),
    "applied": ("wrench", "the command after the plant's limits"),
    "applied_pulse": ("wrench", "the pulse after the plant's limits"),
    "hand": ("wrench", "what the hand exerts from the sample on"),
}


def _number(unit: str, says: str) -> dict[str, str]:
    return {"type": "number", "unit": unit, "description": f"{says} [{unit}]"}


def _six(kind: str, says: str) -> dict[str, Any]:
    units = _UNITS[kind]
    parts = {axis: _number(units[index > 2], f"{says}, {axis}") for index, axis in enumerate(AXES)}
    return {"type": "object", "description": says, "properties": parts}


def _whole(says: str) -> dict[str, str]:
    return {"type": "integer", "description": says}


_WHICH = {"stretch": _whole("number of the stretch, from 0"), "tick": _whole("sample number, as the plant counts")}

_SAMPLE = {
    **_WHICH,
    "time": _number("s", "of the sample, as the plant counts: a device counts on from stretch to stretch"),
    **{name: _six(kind, says) for name, (kind, says) in _SIX.items()},
    "pulse_width": _number("s", "how long the pulse is asked for"),
    "applied_pulse_width": _number("s", "how long the pulse lasts"),
    "taken": _number("J", "energy that the rendered world has taken in, in the stretch; below 0 it has made some"),
    "hand_work": _number("J", "work of the hand in the stretch"),
    "missed": _whole("samples that did not arrive, or that were not kept up with, in the stretch so far"),
}

_STRETCH = {
    "stretch": _WHICH["stretch"],
    "setup": {
        "type": "object",
        "description": "what plant and controller are made from: kind, parameters, calibration, versions",
    },
    "period": _number("s", "sample period"),
    "delay": _number("s", "from a sample to its command taking effect"),
    "carried": _six("wrench", "what carries the flotor"),
    "inertia": _six("inertia", "what the actuators push at, for `taken`"),
    "load": _six("wrench", "what acts besides, its weight, for `taken`"),
    "before": _six("wrench", "what the actuators give until the first command takes effect"),
    "versions": {
        "type": "object",
        "description": "of maglev_mj, python, mujoco, numpy, mcap; git revision, if changed, and digest of the sources",
    },
}

_EVENT = {
    **_WHICH,
    "kind": {"type": "string", "description": "fault, missed or lost"},
    "text": {"type": "string", "description": "what happened"},
    "missed": _whole("samples that were missed with it, besides gaps in the ticks"),
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
    "/maglev/stretch": _schema("Stretch", _STRETCH, "a controller and a plant begin; axes are those of the stator"),
    "/maglev/sample": _schema("Sample", _SAMPLE, "one sample and its answer"),
    "/maglev/event": _schema("Event", _EVENT, "something that a person should know of"),
}
"""JSON schema of the messages of each topic."""


def as_sample(row: Row) -> dict[str, Any]:
    """Return a row by names, without what is computed from several."""

    def six(start: int) -> dict[str, float]:
        return dict(zip(AXES, row[start : start + 6], strict=True))

    return {
        "tick": int(row[0]),
        "time": row[1],
        "position": six(2),
        "command": six(8),
        "pulse": six(14),
        "applied": six(21),
        "applied_pulse": six(27),
        "hand": six(34),
        "pulse_width": row[20],
        "applied_pulse_width": row[33],
    }


def _columns() -> Sequence[tuple[str, str]]:
    found = [("stretch", ""), ("tick", ""), ("time", "s")]
    for name, (kind, _) in _SIX.items():
        found += [(f"{name}.{axis}", _UNITS[kind][index > 2]) for index, axis in enumerate(AXES)]
    return [*found, ("pulse_width", "s"), ("applied_pulse_width", "s")]


COLUMNS = tuple(_columns())
"""Name and unit of each column of a table of samples."""


def flat(stretch: int, row: Sequence[float]) -> list[float]:
    """Return a row in the order of COLUMNS."""
    head = [float(stretch), row[0], row[1]]
    return [*head, *row[2:20], *row[21:33], *row[34:40], row[20], row[33]]
