"""The six numbers that programs are told: deflections, or the rates of a slave.

spacenav has y up and z away from the person, the device z up and y away: the two are exchanged, of translations and
rotations alike, and no sign changes. Turns are right-handed about those directions in both.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from maglev_mj.frames import AXES, Array
from maglev_mj.session import Snapshot
from maglev_mj.spacenav.navigation import Navigation, Navigator
from maglev_mj.spec import RANGE

__all__ = ["FULL", "FULL_POSE", "FULL_RATE", "REST", "Axes", "PoseAxes", "RateAxes"]

FULL = 500
"""What is said of a full deflection or rate; what programs divide by."""

FULL_POSE: Array = np.array(RANGE)
"""Deflections that are FULL, the stops of the device [m, rad], (6,)."""

FULL_RATE: Array = np.array([0.020] * 3 + [math.radians(30.0)] * 3)
"""Rates that are FULL [m/s, rad/s], (6,): those of a navigator by default at the stops."""

REST = (0,) * len(AXES)
"""What is said where nothing moves."""

Axes: TypeAlias = Callable[[Snapshot], tuple[int, ...]]
"""Returns the six numbers for a snapshot, in spacenav's order."""

_ORDER = [0, 2, 1, 3, 5, 4]
_MOST = 32767.0
_RUNS = ("running", "flying")


def told(shares: Array) -> Array:
    """Return shares of full deflection as whole numbers, (6,), in the device's order; what is no number as 0."""
    counts: Array = np.rint(np.clip(np.nan_to_num(FULL * shares), -_MOST, _MOST))
    return counts


class PoseAxes:
    """Deflections from the centre, as a 3D mouse has them."""

    def __call__(self, snapshot: Snapshot) -> tuple[int, ...]:
        """Return the six numbers for a snapshot; see `Axes`."""
        if snapshot.state not in _RUNS:
            return REST
        return _exchanged(told(np.asarray(snapshot.pose) / FULL_POSE))


class RateAxes:
    """Rates of the slave that a `Navigator` moves.

    What rounding leaves over is said with the next snapshot: a program that adds up rates over time stays within half
    a unit of one snapshot of the slave's way.

    Args:
        navigation: What the navigator goes by.

    Attributes:
        navigator: It.
    """

    def __init__(self, navigation: Navigation | None = None) -> None:
        self.navigator = Navigator(navigation)
        self._time: float | None = None
        self._owed: Array = np.zeros(len(AXES))

    def __call__(self, snapshot: Snapshot) -> tuple[int, ...]:
        """Return the six numbers for a snapshot; see `Axes`."""
        runs = snapshot.state in _RUNS and bool(np.isfinite([*snapshot.pose, *snapshot.force]).all())
        before, self._time = self._time, snapshot.time if runs else None
        if not runs or before is None or snapshot.time < before:
            self.navigator.restart()  # the scene stood still or began anew: that is no motion
        if not runs:
            return REST
        elapsed = 0.0 if before is None else max(snapshot.time - before, 0.0)
        self._owed += self.navigator.move(snapshot.pose, snapshot.anchors, elapsed, snapshot.force)
        if elapsed == 0.0:
            return REST
        counts = told(self._owed / (FULL_RATE * elapsed))
        self._owed -= counts * (FULL_RATE * elapsed / FULL)
        return _exchanged(counts)


def _exchanged(counts: Array) -> tuple[int, ...]:
    return tuple(int(counts[place]) for place in _ORDER)
