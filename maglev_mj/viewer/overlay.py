"""Status text on the screen.

Scene, gains, rate, delay, computing time, and energy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from maglev_mj.display.banner import pace
from maglev_mj.display.stops import met_stops
from maglev_mj.frames import unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.plants.shapes import ARROW
from maglev_mj.session import DEVICES_OWN, Snapshot
from maglev_mj.viewer.keys import HAND, key_of
from maglev_mj.viewer.layout import Row

_NOTHING = 5e-5


def status_rows(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Row]:
    """Return the status rows of a session.

    Names and values, the most important first.

    Args:
        snapshot: The present snapshot.
        notes: Further notes, such as the last screenshot.
    """
    scene = snapshot.scene
    live = [one for one in scene.parameters() if one.live and one.live.has_keys and one.name not in DEVICES_OWN]
    on = [one.name for one in live if one.kind is bool and getattr(scene, one.name)]
    gains = [_shown(one, getattr(scene, one.name), scene.axis) for one in live if one.kind in (float, int)]
    time, early = ("time", _time(snapshot)), snapshot.duration is not None or snapshot.time_scale != 1.0
    rows = [
        *_tour(snapshot),
        ("scene", f"{scene.name}: {scene.describe()}"),
        *((time,) if early else ()),
        *(("", note) for note in (met_stops(snapshot).words, *snapshot.notes, *notes) if note),
        ("gains", "  ".join(gains)),
        ("on", ", ".join(on)),
        ("rate", f"{1.0 / scene.period:.0f} Hz, delay {scene.delay * 1e3:.1f} ms"),
        *(() if early else (time,)),
        ("energy", _energy(snapshot)),
        ("arrows", f"blue hand, orange device, black stop, {5e3 * ARROW:.0f} mm for 5 N"),
        ("tick", f"{snapshot.cost * 1e6:.0f} us, {snapshot.missed} missed" if snapshot.cost else ""),
    ]
    return [(name, value) for name, value in rows if value]


def _tour(snapshot: Snapshot) -> list[Row]:
    """Return the step and task of the guided tour."""
    if (line := snapshot.tour) is None:
        return []
    text, deed = line.words(lambda action: HAND if action == "hand" else key_of(action, snapshot.actions))
    return [(f"{line.number} of {line.total}", text), ("" if line.done else "do", deed)]


def _time(snapshot: Snapshot) -> str:
    """Return the time and its pace."""
    whole = "" if snapshot.duration is None else f" of {snapshot.duration:.1f}"
    return ", ".join(filter(None, (f"{snapshot.time:.1f}{whole} s", pace(snapshot))))


def _energy(snapshot: Snapshot) -> str:
    """Return the hand's and the environment's energy, if known."""
    made = "MADE" if snapshot.taken < -_NOTHING else "took"
    parts = {"hand gave": snapshot.work, f"world {made}": abs(snapshot.taken)}
    return ", ".join(f"{name} {value * 1e3:.1f} mJ" for name, value in parts.items() if not math.isnan(value))


def _shown(one: Parameter, value: float | None, axis: str) -> str:
    """Return a gain as text, with its name if needed.

    Gains of a wall have no name.
    """
    if value is None:
        return f"{one.name} none"
    number = f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.3g}"
    text = f"{number} {unit_of(one.unit, axis, one.along)}".strip()
    return text if one.name in ("stiffness", "damping") else f"{one.name} {text}"
