"""What the pose stream says of a snapshot, and what it makes of a host's request."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import maglev_mj
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICES_OWN, Refusal, Snapshot, settable
from maglev_mj.stream.datagrams import MOST_INTEGER, Message, is_integer

__all__ = [
    "accepted",
    "asked_scene",
    "description",
    "identifier",
    "mistaken",
    "pose_message",
    "posed_snapshot",
    "refused",
]

_UNITS = {"length": "m", "angle": "rad", "force": "N", "torque": "N m", "time": "s"}
_MOST_REASON = 300


def pose_message(snapshot: Snapshot, session: int) -> Message:
    """Return the message to subscribers."""
    return {
        "type": "pose",
        "session": session,
        "tick": snapshot.tick,
        "time": snapshot.time,
        "pose": _by_axis(snapshot.pose),
        "force": _by_axis(snapshot.force),
        "hand": _by_axis(snapshot.hand),
        "stuck": None if snapshot.anchors is None else _by_axis(snapshot.anchors),
        "state": snapshot.state,
        "reason": _short(snapshot.reason),
        "missed": snapshot.missed,
        "settings_since": snapshot.since,
    }


def posed_snapshot(pose: Message, blank: Snapshot) -> Snapshot:
    """Return a snapshot with the values of a pose message; it says nothing of settings."""
    stuck = pose["stuck"]

    def six(values: Mapping[str, float | None]) -> Array:
        found = (values[axis] for axis in AXES)
        return np.array([math.nan if value is None else value for value in found])

    return replace(
        blank,
        since=pose["settings_since"],
        pose=six(pose["pose"]),
        force=six(pose["force"]),
        hand=six(pose["hand"]),
        anchors=None if stuck is None else six(stuck),
        **{name: pose[name] for name in ("tick", "time", "state", "reason", "missed")},
    )


def description(
    snapshot: Snapshot, session: int, asked: int | None, dropped: Mapping[str, int] | None = None
) -> Message:
    """Return all that a host needs to draw a scene and to set it."""
    scene = snapshot.scene
    return {
        "type": "description",
        "id": asked,
        "session": session,
        "version": maglev_mj.__version__,
        "scene": scene.name,
        "says": scene.describe(),
        "tick": snapshot.tick,
        "state": snapshot.state,
        "settings": scene.as_json(),
        "settings_since": snapshot.since,
        "delay": snapshot.delay,
        "settable": settable(scene),
        "faces": [(AXES[index], int(normal), edge) for index, normal, edge in snapshot.faces],
        "axes": AXES,
        "units": _UNITS,
        "dropped": dict(dropped or {}),
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


def accepted(asked: int | None, tick: int, session: int) -> Message:
    """Return what a host is told whose settings are in force from a sample on."""
    return {"type": "accepted", "id": asked, "session": session, "tick": tick}


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


def asked_scene(present: Scene, given: object) -> Scene:
    """Return the present scene with the parameters that a host asks for.

    Raises:
        ParameterError: If it asks for what is not there, not a host's to set, or outside its bounds.
    """
    if not isinstance(given, dict):
        raise ParameterError(f"settings must be an object of names and values, not {given!r}")
    if fixed := [name for name in DEVICES_OWN if name in given]:
        raise ParameterError(f"{fixed[0]} is the device's, or the person's at the machine; a host cannot set it")
    if unknown := sorted(set(given) - set(known := settable(present))):
        raise ParameterError(f"settings must be of {', '.join(known)}, not {', '.join(unknown)}")
    return present.replace(**given)


def _by_axis(values: Iterable[Any]) -> dict[str, float | None]:
    """Return values by the names of their axes; what is no number is null in JSON."""
    numbers = (float(value) for value in values)
    return {axis: number if math.isfinite(number) else None for axis, number in zip(AXES, numbers, strict=True)}


def _short(reason: str) -> str:
    # it may repeat what the host sent
    return reason if len(reason) <= _MOST_REASON else reason[: _MOST_REASON - 3] + "..."
