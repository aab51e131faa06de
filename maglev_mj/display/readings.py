"""Readings of a session: what window and page say of it in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.colours import BAD, DEVICE, HAND, STOP, Colour
from maglev_mj.display.banner import pace
from maglev_mj.display.stops import met_stops
from maglev_mj.frames import Array, unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.session import DEVICES_OWN, Snapshot

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
        Reading("on", ", ".join(on)),
        Reading("rate", f"{1.0 / scene.period:.0f} Hz, delay {scene.delay * 1e3:.1f} ms"),
        *(() if early else (time,)),
        Reading("position", ", ".join(f"{name} {value:.2f}" for name, value in zip("xyz", place)) + " mm"),
        *map(_force, FORCES, (snapshot.hand, snapshot.force, snapshot.stops), (HAND, DEVICE, STOP)),
        Reading("energy", _energy(snapshot), BAD if _makes_energy(snapshot) else None),
        Reading("tick", f"{snapshot.cost * 1e6:.0f} us, {snapshot.missed} missed" if snapshot.cost else ""),
    ]
    return [row for row in rows if row.value]


def _time(snapshot: Snapshot) -> str:
    """Return the time and its pace."""
    whole = "" if snapshot.duration is None else f" of {snapshot.duration:.1f}"
    return ", ".join(filter(None, (f"{snapshot.time:.1f}{whole} s", pace(snapshot))))


def _force(name: str, wrench: Array, colour: Colour) -> Reading:
    """Return a force's size, if known."""
    known = np.isfinite(wrench).all()
    return Reading(name, f"{np.linalg.norm(wrench[:3]):.1f} N" if known else "", colour)


def _makes_energy(snapshot: Snapshot) -> bool:
    return snapshot.taken < -_NOTHING


def _energy(snapshot: Snapshot) -> str:
    """Return the hand's and the environment's energy, if known."""
    made = "MADE" if _makes_energy(snapshot) else "took"
    parts = {"hand gave": snapshot.work, f"world {made}": abs(snapshot.taken)}
    return ", ".join(f"{name} {value * 1e3:.1f} mJ" for name, value in parts.items() if not math.isnan(value))


def _gain(one: Parameter, value: float | None, axis: str) -> str:
    """Return a gain as text, with its name if needed.

    Gains of a wall have no name.
    """
    if value is None:
        return f"{one.name} none"
    number = f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.3g}"
    text = f"{number} {unit_of(one.unit, axis, one.along)}".strip()
    return text if one.name in ("stiffness", "damping") else f"{one.name} {text}"
