"""The handle on page and in the window: drags of the knob, and arrows of the forces there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from maglev_mj.colours import DEVICE, HAND, STOP
from maglev_mj.device import Knob
from maglev_mj.frames import Array, rotation_matrix
from maglev_mj.plants.shapes import ARROW, MIN_ARROW_FORCE, arrow_start
from maglev_mj.session import Snapshot
from maglev_mj.views.forces import forces


def dragged_pose(start: Array, moved: Array, knob: Knob, *, tilts: bool) -> Array:
    """Return the target pose of a hand that drags the knob [m, rad], (6,).

    Args:
        start: Pose at the start of the drag [m, rad], (6,).
        moved: Displacement of the knob [m], (3,).
        knob: The knob.
        tilts: True to rotate about the horizontal axes, False to translate.
    """
    grip = knob.centre
    square = max(float(grip @ grip), knob.radius**2)  # a knob at the centre of mass is turned by its surface
    pose: Array = start + np.concatenate(
        [np.zeros(3), np.cross(grip, moved) / square] if tilts else [moved, np.zeros(3)]
    )
    return pose


FORCES = {"hand": HAND, "device": DEVICE, "stops": STOP}
"""Forces with an arrow, and their colours."""

_MAX_LENGTH, _FULL_SIZE, _MIN_SIZE = 0.06, 0.014, 0.3
_MIN_NUMBER, _GAP = 0.2, 0.009
"""Smallest force with a number [N]; distance from a tip to its number [m]."""
_TURNS, _COIL, _LEAST_SPRING = 9, 0.0026, 0.001
"""Turns of the drawn spring, its radius, and its least length [m]."""
_PARALLEL, _ASIDE = 0.9, np.array([0.0136, 0.0085, 0.0])
"""Cosine between forces above which their arrows are stacked; to the right in the home view [m], (3,)."""


def hand_spring(snapshot: Snapshot) -> Array:
    """Return the points of a coil from the knob to the target of the hand [m], (N, 3); empty without one."""
    if snapshot.target is None:
        return np.empty((0, 3))
    knob, target = snapshot.scene.hardware.knob, np.asarray(snapshot.target, dtype=np.float64)
    start, end = (pose[:3] + rotation_matrix(pose[3:]) @ knob.centre for pose in (snapshot.pose, target))
    length = float(np.linalg.norm(end - start))
    if not _LEAST_SPRING <= length < math.inf:
        return np.empty((0, 3))
    along = (end - start) / length
    across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    across /= np.linalg.norm(across)
    share = np.linspace(0.0, 1.0, 8 * _TURNS + 1)[:, None]
    angle, width = 2.0 * np.pi * _TURNS * share, _COIL * np.minimum(1.0, 8.0 * np.minimum(share, 1.0 - share))
    coil = width * (np.cos(angle) * across + np.sin(angle) * np.cross(along, across))
    return np.asarray(start + share * (end - start) + coil)


class ForceArrow(NamedTuple):
    """Arrow of a force.

    Attributes:
        start: Start, on the surface of the knob [m], (3,).
        end: Tip [m], (3,).
        size: Size of the head, 1 for a long arrow, so that the lengths of short arrows differ visibly.
        place: Position of the number [m], (3,).
        text: Number with its unit; empty for a small force.
    """

    start: Array
    end: Array
    size: float
    place: Array
    text: str


def force_arrows(snapshot: Snapshot) -> dict[str, ForceArrow]:
    """Return the arrows of a snapshot by name; a force too small to see, or NaN, has none.

    Those of hand and device are the means over `averaging_time`, whose numbers the bars and readings show.
    """
    knob = snapshot.scene.hardware.knob
    place = snapshot.pose[:3] + rotation_matrix(snapshot.pose[3:]) @ knob.centre
    arrows: dict[str, ForceArrow] = {}
    means = {name: force.mean for name, force in forces(snapshot).items()} | {"stops": snapshot.stops}
    for name in FORCES:
        wrench = means[name]
        force, size = wrench[:3], float(np.linalg.norm(wrench[:3]))
        if not MIN_ARROW_FORCE <= size < math.inf:
            continue
        start, along = arrow_start(place, force, knob), force / size
        for under, arrow in arrows.items():
            shaft = arrow.end - arrow.start
            if (reach := float(shaft @ along)) > _PARALLEL * np.linalg.norm(shaft):
                # stacked, so that balanced forces have equal lengths; the number of the lower one moves aside
                start = start + reach * along
                arrows[under] = arrow._replace(place=0.5 * (arrow.start + arrow.end) + _ASIDE)
        length = min(ARROW * size, _MAX_LENGTH)
        text = f"{size:.1f} N" if size >= _MIN_NUMBER else ""
        end, head = start + length * along, round(min(max(length / _FULL_SIZE, _MIN_SIZE), 1.0), 1)
        arrows[name] = ForceArrow(start, end, head, end + _GAP * along, text)
    return arrows
