"""Magnified display of the handle's motion; the physics is unaffected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from maglev_mj.frames import Array
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
