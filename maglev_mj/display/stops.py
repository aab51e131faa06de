"""Mechanical stops in contact: positions, and a line naming them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.plants.shapes import LEAST_FORCE
from maglev_mj.session import Snapshot

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
