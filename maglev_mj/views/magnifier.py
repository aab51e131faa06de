"""Magnified display of the handle's motion; the physics is unaffected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from maglev_mj.frames import Array, rotation_matrix
from maglev_mj.plants.shapes import GRIP
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


def true_pose(drawn: Array, factor: float) -> Array:
    """Return the true pose or displacement of a magnified one [m, rad]."""
    return drawn / factor


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
    moved = true_pose(moved, factor)
    pose: Array = start + np.concatenate(
        [np.zeros(3), np.cross(GRIP, moved) / (GRIP @ GRIP)] if tilts else [moved, np.zeros(3)]
    )
    return pose
