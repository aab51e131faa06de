"""Magnified motion of the handle in window and page; the physics stays as it is."""

from __future__ import annotations

from dataclasses import replace

from maglev_mj.frames import Array
from maglev_mj.session import Snapshot

MAGNIFICATIONS = 1, 3, 5
"""Factors of the handle's drawn motion that a viewer offers; the first is the true motion."""

_TRAVEL = 0.0042


def magnified(snapshot: Snapshot, factor: float) -> Snapshot:
    """Return a snapshot with handle, stick position and walls drawn further from the centre.

    For the handle's drawing alone: flotor and coils stay between their magnets, and words and plots say the truth.
    A wall that the handle touches is touched in the drawing, too.

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
    """Return how much a drawn wall is wider on each side, for the handle's travel [m]."""
    return _TRAVEL * (factor - 1.0)


def true_pose(drawn: Array, factor: float) -> Array:
    """Return the true pose, or move, of a magnified one [m, rad].

    A drag on the drawing asks for it.
    """
    return drawn / factor


def motion_words(factor: float) -> str:
    """Return the label of a magnified drawing; empty for the true motion."""
    return "" if factor == 1 else f"motion x{factor:g}"
