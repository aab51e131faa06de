"""What the plots of a snapshot show: position, speed and force on one axis over the last seconds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.frames import AXES, Array
from maglev_mj.session import SHOWN, Snapshot

__all__ = ["SHOWN", "Curves", "curves", "round_up"]


class Curves(NamedTuple):
    """Curves of one axis.

    Attributes:
        axis: Name of the axis.
        unit: Of the position: mm or mrad; the speed's is that per second.
        torque: Of the force: N, or N m.
        time: Before the last sample [s], (N,).
        position: In `unit`, (N,).
        speed: In `unit` per second, (N,).
        device: Force of the device, (N,).
        hand: Force of the hand, (N,).
        edges: Walls on the axis, in `unit`.
    """

    axis: str
    unit: str
    torque: str
    time: Array
    position: Array
    speed: Array
    device: Array
    hand: Array
    edges: Sequence[float]


def curves(snapshot: Snapshot, axis: int, most: int) -> Curves:
    """Return the curves of one axis of a snapshot.

    Args:
        snapshot: The snapshot.
        axis: Index into AXES.
        most: Largest number of points.
    """
    turning = axis > 2
    rows = snapshot.history
    if len(rows) > most:
        rows = rows[:: -(-len(rows) // most)]
    time = rows[:, 0] - (rows[-1, 0] if len(rows) else 0.0)
    return Curves(
        axis=AXES[axis],
        unit="mrad" if turning else "mm",
        torque="N m" if turning else "N",
        time=time,
        position=1e3 * rows[:, 1 + axis],
        speed=1e3 * rows[:, 7 + axis],
        device=rows[:, 13 + axis],
        hand=rows[:, 19 + axis],
        edges=[edge * 1e3 for index, _, edge in snapshot.faces if index == axis],
    )


def round_up(value: float) -> float:
    """Return the next of 1, 2, 5 times a power of ten."""
    step = 10.0 ** np.floor(np.log10(value))
    return float(next(step * size for size in (1.0, 2.0, 5.0, 10.0) if step * size >= 0.999 * value))
