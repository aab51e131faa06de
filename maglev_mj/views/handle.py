"""Displayed handle: magnified motion, and arrows of the forces at the knob; the same on page and in the window."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from maglev_mj.colours import DEVICE, HAND, STOP
from maglev_mj.frames import Array, rotation_matrix
from maglev_mj.plants.shapes import ARROW, GRIP, MIN_ARROW_FORCE, arrow_start
from maglev_mj.session import Snapshot

MAGNIFICATIONS = 1, 3, 5
"""Magnifications of the handle's displayed motion; the first is the true motion."""

_TRAVEL = 0.0042


def magnified(snapshot: Snapshot, factor: float) -> Snapshot:
    """Return a snapshot with magnified displacements of handle, stick position and walls.

    Use it to draw the handle only: flotor, coils, texts and plots keep the true values. Contact with a wall is
    preserved.

    Args:
        snapshot: The true snapshot.
        factor: One of MAGNIFICATIONS.
    """
    if factor == 1:
        return snapshot
    return replace(
        snapshot,
        pose=factor * snapshot.pose,
        first=snapshot.first * (1.0, *(factor,) * 6),
        anchors=None if snapshot.anchors is None else factor * snapshot.anchors,
        faces=[(axis, normal, factor * edge) for axis, normal, edge in snapshot.faces],
    )


def widening(factor: float) -> float:
    """Return the margin added to each side of a drawn wall for the magnified travel [m]."""
    return _TRAVEL * (factor - 1.0)


def stretched(ends: Array, pose: Array, factor: float) -> tuple[Array, Array, float]:
    """Return foot, orientation and length of the stem between the flotor's true pose and the knob's magnified one.

    Args:
        ends: Foot and top in flotor axes [m], (2, 3).
        pose: True pose [m, rad], (6,).
        factor: One of MAGNIFICATIONS.

    Returns:
        Foot [m], (3,); unit quaternion (w, x, y, z) that turns z along the stem; length [m].
    """
    foot, top = (each[:3] + rotation_matrix(each[3:]) @ end for each, end in zip((pose, factor * pose), ends))
    length = float(np.linalg.norm(top - foot))
    x, y, z = (top - foot) / length
    turn = np.array([1.0 + z, -y, x, 0.0])
    return foot, turn / np.linalg.norm(turn), length


def motion_words(factor: float) -> str:
    """Return the label of a magnification; empty for the true motion."""
    return "" if factor == 1 else f"motion x{factor:g}"


def dragged_pose(start: Array, moved: Array, factor: float, *, tilts: bool) -> Array:
    """Return the target pose of a hand that drags the knob [m, rad], (6,).

    Args:
        start: Pose at the start of the drag [m, rad], (6,).
        moved: Displayed displacement of the knob [m], (3,).
        factor: Magnification of the displayed motion.
        tilts: True to rotate about the horizontal axes, False to translate.
    """
    moved = moved / factor
    pose: Array = start + np.concatenate(
        [np.zeros(3), np.cross(GRIP, moved) / (GRIP @ GRIP)] if tilts else [moved, np.zeros(3)]
    )
    return pose


FORCES = {"hand": HAND, "device": DEVICE, "stops": STOP}
"""Forces with an arrow, and their colours."""

_MAX_LENGTH, _FULL_SIZE, _MIN_SIZE = 0.12, 0.014, 0.3
_MIN_NUMBER, _GAP = 0.2, 0.009
"""Smallest force with a number [N]; distance from a tip to its number [m]."""


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
    knob = snapshot.pose[:3] + rotation_matrix(snapshot.pose[3:]) @ GRIP
    arrows: dict[str, ForceArrow] = {}
    for name, wrench in zip(FORCES, (snapshot.hand, snapshot.force, snapshot.stops), strict=True):
        force, size = wrench[:3], float(np.linalg.norm(wrench[:3]))
        if not MIN_ARROW_FORCE <= size < math.inf:
            continue
        start, along, device = arrow_start(knob, force), force / size, arrows.get("device")
        if name == "stops" and device is not None:
            # stacked on the device's, so that balanced forces have equal lengths
            start = start + max(float((device.end - device.start) @ along), 0.0) * along
        length = min(ARROW * size, _MAX_LENGTH)
        text = f"{size:.1f} N" if size >= _MIN_NUMBER else ""
        end, head = start + length * along, round(min(max(length / _FULL_SIZE, _MIN_SIZE), 1.0), 1)
        arrows[name] = ForceArrow(start, end, head, end + _GAP * along, text)
    return arrows
