"""What the pose stream says of a moment, and what it makes of a host's request."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import maglev_mj
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.recording import wall_faces
from maglev_mj.scenes import Scene, Settings
from maglev_mj.session import Moment, Refusal
from maglev_mj.stream.datagrams import MOST_INTEGER, Message, is_integer

__all__ = [
    "FIXED",
    "SETTABLE",
    "asked_settings",
    "description",
    "identifier",
    "mistaken",
    "moment_told",
    "pose_message",
    "refused",
    "same_rules",
]

SETTABLE = ("wall", "pulse", "friction", "weightless", "stiffness", "damping", "breakaway", "walls")
"""Settings that a host may ask for."""

FIXED = ("period", "delay")
"""Settings that are the device's, or the person's at the machine."""

_UNITS = {"length": "m", "angle": "rad", "force": "N", "torque": "N m", "time": "s"}
_MOST_REASON = 300


def pose_message(moment: Moment, session: int) -> Message:
    """Return what subscribers are told of a moment."""
    return {
        "type": "pose",
        "session": session,
        "tick": moment.tick,
        "time": moment.time,
        "pose": _by_axis(moment.pose),
        "force": _by_axis(moment.force),
        "hand": _by_axis(moment.hand),
        "stuck": None if moment.anchors is None else _by_axis(moment.anchors.tolist()),
        "state": moment.state,
        "reason": _short(moment.reason),
        "missed": moment.missed,
        "settings_since": moment.since,
    }


def moment_told(pose: Message, scene: Scene, settings: Settings) -> Moment:
    """Return the moment that a pose tells of; it says nothing of settings."""
    stuck = pose["stuck"]

    def six(values: Mapping[str, float | None]) -> list[float]:
        found = (values[axis] for axis in AXES)
        return [math.nan if value is None else value for value in found]

    return Moment(
        scene=scene,
        settings=settings,
        since=pose["settings_since"],
        delay=settings.delay,
        tick=pose["tick"],
        time=pose["time"],
        pose=six(pose["pose"]),
        force=six(pose["force"]),
        hand=six(pose["hand"]),
        anchors=None if stuck is None else np.array(six(stuck)),
        state=pose["state"],
        reason=pose["reason"],
        missed=pose["missed"],
    )


def description(moment: Moment, session: int, asked: int | None) -> Message:
    """Return all that a host needs to draw a scene and to set it."""
    settings, scene = moment.settings, moment.scene
    return {
        "type": "description",
        "id": asked,
        "session": session,
        "version": maglev_mj.__version__,
        "scene": scene.name,
        "says": scene.says,
        "tick": moment.tick,
        "state": moment.state,
        "settings": settings.as_json(),
        "settings_since": moment.since,
        "delay": moment.delay,
        "settable": SETTABLE,
        "faces": [(AXES[index], int(normal), edge) for index, normal, edge in wall_faces(scene.laws(settings))],
        "axes": AXES,
        "units": _UNITS,
    }


def refused(asked: int | None, reason: str, session: int, figures: Refusal | None = None) -> Message:
    """Return what a host is told that may not have what it asks for."""
    return {
        "type": "refused",
        "id": asked,
        "session": session,
        "reason": _short(reason),
        "figures": None if figures is None else figures._asdict(),
    }


def mistaken(asked: int | None, reason: str, session: int) -> Message:
    """Return what a host is told whose request is none."""
    return {"type": "error", "id": asked, "session": session, "reason": _short(reason)}


def identifier(message: Message) -> int | None:
    """Return the number by which a host knows its request again; None for none.

    Raises:
        ParameterError: If it is no such number.
    """
    asked: int | None = message.get("id")
    if asked is not None and not is_integer(asked):
        raise ParameterError(f"id must be an integer of 0 to {MOST_INTEGER}, not {asked!r}")
    return asked


def asked_settings(present: Settings, given: object) -> Settings:
    """Return the present settings with what a host asks for in place of theirs.

    Raises:
        ParameterError: If it asks for what is not there, not a host's to set, or outside its bounds.
    """
    if not isinstance(given, dict):
        raise ParameterError(f"settings must be an object of names and values, not {given!r}")
    if fixed := [name for name in FIXED if name in given]:
        raise ParameterError(f"{fixed[0]} is the device's, or the person's at the machine; a host cannot set it")
    if unknown := sorted(set(given) - set(SETTABLE)):
        raise ParameterError(f"settings must be of {', '.join(SETTABLE)}, not {', '.join(unknown)}")
    if not isinstance(given.get("walls"), list | None):
        raise ParameterError(f"walls must be a list of walls or null, not {given['walls']!r}")
    return Settings.from_json({**present.as_json(), **given})


def same_rules(one: Settings, other: Settings) -> bool:
    """Return whether settings differ in period and delay at most."""
    return replace(one, period=other.period, delay=other.delay) == other


def _by_axis(values: Iterable[Any]) -> dict[str, float | None]:
    """Return values by the names of their axes; what is no number is null in JSON."""
    numbers = (float(value) for value in values)
    return {axis: number if math.isfinite(number) else None for axis, number in zip(AXES, numbers, strict=True)}


def _short(reason: str) -> str:
    # it may repeat what the host sent
    return reason if len(reason) <= _MOST_REASON else reason[: _MOST_REASON - 3] + "..."
