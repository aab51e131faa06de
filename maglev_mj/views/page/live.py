"""Data of the page's own script: knob and hand for the spring to the pointer, and the strip at the contact."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BAD, on_page
from maglev_mj.frames import rotation_matrix, unit_of
from maglev_mj.session import Snapshot
from maglev_mj.views.forces import forces, hand_at_limit, state_words, strip
from maglev_mj.views.page.panel import ticks
from maglev_mj.views.readings import Chart, Charts, law_status

_SWING_TIME, _SWING = 0.1, 0.02
"""Time in which a motion counts as a swing [s], and the smallest one that is named [mm, mrad]."""


def knob(snapshot: Snapshot) -> dict[str, Any]:
    """Return the place of the knob [m], (3,), and the words at the hand's spring: its force, or its limit."""
    pose, hand = snapshot.pose, forces(snapshot)["hand"]
    place = pose[:3] + rotation_matrix(pose[3:]) @ snapshot.scene.hardware.knob.centre
    words = state_words(snapshot).split("; ")[0] if hand_at_limit(snapshot) else f"{hand.size:.1f} N"
    return {"place": np.round(place, 6).tolist(), "words": words}


def contact(snapshot: Snapshot, charts: Charts) -> dict[str, Any]:
    """Return the strip that the page draws; words alone without samples, or while no laws act on the device.

    A scene that has stopped keeps it, as it shows what happened.

    Args:
        snapshot: The snapshot.
        charts: Charts of the session, which keep the scales steady.
    """
    made = None if snapshot.idle else strip(snapshot)
    if made is None:
        return {"state": snapshot.idle}
    place, pulls = charts.of_strip(made)
    moved = 1e3 * (made.position - made.edge)
    swing, deepest = float(np.ptp(moved[made.time > -_SWING_TIME])), float((-made.normal * moved).max())
    swings = swing >= _SWING and deepest >= 0.0
    words = f"swings {swing:.2g} {unit_of('mm', made.axis)}" if swings else "outside" if deepest < 0.0 else "still"
    return {
        "now": round(snapshot.time, 6),
        "pace": snapshot.time_scale,
        "normal": made.normal,
        "state": words,
        "bad": swings and law_status(snapshot).colour == BAD,
        "charts": [_drawn(place), _drawn(pulls)],
        "device": _points(made.switches, made.force),
    }


def _drawn(chart: Chart) -> dict[str, Any]:
    """Return a chart for the page's script."""
    lines = [
        {"colour": on_page(line.colour, 3.0), "dashed": line.dashed, "points": _points(line.x, line.y)}
        for line in chart.lines
    ]
    title = [[words, "" if colour is None else on_page(colour)] for words, colour in chart.title]
    up = [float(end) for end in chart.up]
    return {"title": title, "lines": lines, "across": [*chart.across], "up": up, "ticks": ticks(*chart.up)}


def _points(x: ArrayLike, y: ArrayLike) -> list[list[float]]:
    """Return the finite points of a line."""
    return [[round(a, 5), round(b, 4)] for a, b in zip(np.ravel(x).tolist(), np.ravel(y).tolist()) if np.isfinite(b)]
