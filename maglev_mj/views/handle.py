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
_PARALLEL, _ASIDE = 0.9, np.array([0.0136, 0.0085, 0.0])
"""Cosine between forces above which their arrows are stacked; to the right in the home view [m], (3,)."""


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
    """Return the arrows of a snapshot by name; a force too small to see, or NaN, has none."""
    knob = snapshot.scene.hardware.knob
    place = snapshot.pose[:3] + rotation_matrix(snapshot.pose[3:]) @ knob.centre
    arrows: dict[str, ForceArrow] = {}
    for name, wrench in zip(FORCES, (snapshot.hand, snapshot.force, snapshot.stops), strict=True):
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
