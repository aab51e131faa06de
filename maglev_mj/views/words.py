"""Words of a snapshot that every viewer shows: banner, met stops, readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.colours import BAD, DEVICE, HAND, STOP, Colour
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.plants.shapes import LEAST_FORCE
from maglev_mj.session import DEVICES_OWN, Snapshot
from maglev_mj.views.charts import STABILITY


class Banner(NamedTuple):
    """Words over everything else.

    Attributes:
        text: What is the matter.
        way_on: Action that goes on; empty where there is none.
        bad: Whether something is wrong, and not only asked for.
        remedy: Way on where it is no action; empty otherwise.
    """

    text: str
    way_on: str
    bad: bool
    remedy: str = ""


def banner(snapshot: Snapshot) -> Banner | None:
    """Return the banner of a snapshot; None while running normally."""
    if snapshot.state == "stopped":
        return Banner(f"STOPPED: {snapshot.reason}", _known("centre", snapshot), True, snapshot.remedy)
    if snapshot.state == "paused":
        where = f", {snapshot.rewound:.1f} s back" if snapshot.rewound else ""
        where += "" if snapshot.duration is None else f": {snapshot.time:.3f} of {snapshot.duration:.3f} s"
        return Banner(f"PAUSED{where}", _known("pause", snapshot), False)
    if (line := snapshot.tour) is not None and line.done and line.number < line.total:
        return Banner("DONE", "next", False)
    if snapshot.late:
        text = "TOO SLOW: this machine cannot keep up, simulated time slows down"
        return Banner(text, _known("slower", snapshot), True)
    return None


def _known(action: str, snapshot: Snapshot) -> str:
    """Return an action if it has effect; else empty."""
    return action if action in snapshot.actions else ""


def pace(snapshot: Snapshot) -> str:
    """Return the pace of time; empty for real time."""
    if (scale := snapshot.time_scale) == 1.0:
        return ""
    return f"1/{1.0 / scale:.3g} of real time" if scale < 1.0 else f"{scale:.3g} times real time"


_LEAST_TORQUE = 1e-3
"""Below this no stop is met [N m]."""


class MetStops(NamedTuple):
    """Metal stops that push.

    Attributes:
        faces: Those along the axes: index into AXES, normal, edge [m].
        turning: Whether that of the rotation is one.
        words: Names them; empty where there is none.
    """

    faces: tuple[tuple[int, float, float], ...]
    turning: bool
    words: str


def met_stops(snapshot: Snapshot) -> MetStops:
    """Return the metal stops that the flotor is at."""
    pose, wrench = snapshot.pose, snapshot.stops
    faces, words = [], []
    for index in range(3):
        force = float(wrench[index])
        if abs(force) >= LEAST_FORCE:
            faces.append((index, float(np.sign(force)), float(pose[index])))
            words.append(
                f"{'-' if force > 0.0 else '+'}{AXES[index]} {abs(pose[index]) * 1e3:.1f} mm, {abs(force):.1f} N"
            )
    torque = float(np.linalg.norm(wrench[3:]))
    turning = torque >= _LEAST_TORQUE
    if turning:
        words.append(f"turned {np.degrees(np.linalg.norm(pose[3:])):.1f} deg, {torque:.2f} N m")
    return MetStops(tuple(faces), turning, f"metal stop: {'; '.join(words)}" if words else "")


_NOTHING = 5e-5
FORCES = "hand", "device", "stops"
"""Names of the readings of forces."""


class Reading(NamedTuple):
    """One reading.

    Attributes:
        name: Its name; empty for a note.
        value: Its value in words, with the unit.
        colour: Colour of what it is about; None for none.
    """

    name: str
    value: str
    colour: Colour | None = None


def readings(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Reading]:
    """Return the readings of a session that say something, the most important first.

    Args:
        snapshot: The present snapshot.
        notes: Further notes, such as the last screenshot.
    """
    scene = snapshot.scene
    live = [one for one in scene.parameters() if one.live and one.live.has_keys and one.name not in DEVICES_OWN]
    on = [one.name for one in live if one.kind is bool and getattr(scene, one.name)]
    gains = [_gain(one, getattr(scene, one.name), scene.axis) for one in live if one.kind in (float, int)]
    time, early = Reading("time", _time(snapshot)), snapshot.duration is not None or snapshot.time_scale != 1.0
    place = 1e3 * snapshot.pose[:3].round(5) + 0.0
    rows = [
        Reading("scene", f"{scene.name}: {scene.describe()}"),
        *((time,) if early else ()),
        *(Reading("", note) for note in (met_stops(snapshot).words, *snapshot.notes, *notes)),
        Reading("gains", "  ".join(gains)),
        _wall(snapshot),
        Reading("on", ", ".join(on)),
        Reading("rate", f"{1.0 / scene.period:.0f} Hz, delay {scene.delay * 1e3:.1f} ms"),
        *(() if early else (time,)),
        Reading("position", ", ".join(f"{name} {value:.2f}" for name, value in zip("xyz", place)) + " mm"),
        _force("hand", snapshot.hand, HAND, " (estimated)" * snapshot.hand_estimated),
        _force("device", snapshot.force, DEVICE),
        _force("stops", snapshot.stops, STOP),
        Reading("energy", _energy(snapshot), BAD if _makes_energy(snapshot) else None),
        Reading("tick", f"{snapshot.cost * 1e6:.0f} us, {snapshot.missed} missed" if snapshot.cost else ""),
    ]
    return [row for row in rows if row.value]


def _time(snapshot: Snapshot) -> str:
    """Return the time and its pace."""
    whole = "" if snapshot.duration is None else f" of {snapshot.duration:.1f}"
    digits = 3 if snapshot.time_scale < 1.0 else 1
    return ", ".join(filter(None, (f"{snapshot.time:.{digits}f}{whole} s", pace(snapshot))))


def _force(name: str, wrench: Array, colour: Colour, note: str = "") -> Reading:
    """Return a force's size, if known."""
    known = np.isfinite(wrench).all()
    return Reading(name, f"{np.linalg.norm(wrench[:3]):.1f} N{note}" if known else "", colour)


def _wall(snapshot: Snapshot) -> Reading:
    """Return the stability of the wall alone, if there is one."""
    wall = STABILITY.of(snapshot).wall
    if STABILITY.scene != snapshot.scene:
        return Reading("wall", "..." if snapshot.faces else "")
    return Reading("wall", str(wall or ""), BAD if wall and wall.modulus >= 1.0 else None)


def _makes_energy(snapshot: Snapshot) -> bool:
    return snapshot.taken < -_NOTHING


def _energy(snapshot: Snapshot) -> str:
    """Return the energy of the hand and of the computed forces, if known."""
    added = _makes_energy(snapshot)
    parts = {"hand gave": snapshot.work, f"device {'added' if added else 'took'}": abs(snapshot.taken)}
    words = ", ".join(f"{name} {value * 1e3:.1f} mJ" for name, value in parts.items() if not math.isnan(value))
    return f"{words}: its forces come late" if added else words


def _gain(one: Parameter, value: float | None, axis: str) -> str:
    """Return a gain as text, with its name if needed.

    Gains of a wall have no name.
    """
    if value is None:
        return f"{one.name} none"
    number = f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.3g}"
    text = f"{number} {unit_of(one.unit, axis, one.along)}".strip()
    return text if one.name in ("stiffness", "damping") else f"{one.name} {text}"
