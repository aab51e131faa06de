"""Six numbers sent to programs: deflections, or a slave's rates.

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
from maglev_mj.spacenav.mapping import AxisMapping
from maglev_mj.spacenav.navigation import Navigation, Navigator
from maglev_mj.spacenav.protocol import MOST
from maglev_mj.spec import RANGE

EXCHANGED = [0, 2, 1, 3, 5, 4]
"""Index permutation between device and spacenav axes, both ways."""

FULL = 500
"""Number sent for a full deflection or rate."""

FULL_POSE: Array = np.array(RANGE)
"""Deflections sent as FULL, the device's stops [m, rad], (6,)."""

FULL_RATE: Array = np.array([0.020] * 3 + [math.radians(30.0)] * 3)
"""Rates sent as FULL [m/s, rad/s], (6,).

Those of a default navigator at the stops.
"""

REST = (0,) * len(AXES)
"""Numbers sent at rest."""

Axes: TypeAlias = Callable[[Snapshot], tuple[int, ...]]
"""Returns the six numbers for a snapshot, in spacenav's order."""

RUNS = ("running", "flying")
"""States of a scene that moves."""


def told(shares: Array) -> Array:
    """Return deflection or rate shares as whole numbers, (6,)."""
    counts: Array = np.rint(np.clip(FULL * shares, -MOST, MOST))
    return counts


class PoseAxes:
    """Deflections from the centre, as a 3D mouse has them.

    Args:
        mapping: Settings of the axes; the defaults where it is None.
    """

    def __init__(self, mapping: AxisMapping | None = None) -> None:
        self._mapping = mapping or AxisMapping()

    def __call__(self, snapshot: Snapshot) -> tuple[int, ...]:
        """Return the six numbers for a snapshot; see `Axes`."""
        if snapshot.state not in RUNS:
            return REST
        deflection = self._mapping.outside(np.asarray(snapshot.pose), FULL_POSE)
        return _whole(told(self._mapping((deflection / FULL_POSE)[EXCHANGED])))


class RateAxes:
    """Rates of the slave that a `Navigator` moves.

    What rounding leaves over is said with the next snapshot: a program that adds up rates over time stays within half
    a unit of one snapshot of the slave's way.

    Args:
        navigation: What the navigator goes by.
        mapping: Settings of the axes; the dead zone is one of the flotor's deflection.

    Attributes:
        navigator: It.
    """

    def __init__(self, navigation: Navigation | None = None, mapping: AxisMapping | None = None) -> None:
        self.navigator, self._mapping = Navigator(navigation), mapping or AxisMapping()
        self._time: float | None = None
        self._owed: Array = np.zeros(len(AXES))

    def __call__(self, snapshot: Snapshot) -> tuple[int, ...]:
        """Return the six numbers for a snapshot; see `Axes`."""
        runs = snapshot.state in RUNS and bool(np.isfinite([*snapshot.pose, *snapshot.force]).all())
        before, self._time = self._time, snapshot.time if runs else None
        if not runs or before is None or snapshot.time < before:
            self.navigator.restart()  # the scene stood still or began anew: that is no motion
        if not runs:
            return REST
        elapsed = 0.0 if before is None else max(snapshot.time - before, 0.0)
        pose = self._mapping.outside(np.asarray(snapshot.pose), FULL_POSE)
        way = self.navigator.move(pose, snapshot.anchors, elapsed, snapshot.force) / FULL_RATE
        moved = self._mapping(way[EXCHANGED])
        self._owed = moved + (self._owed * (moved != 0.0) if self._mapping.dominant else self._owed)
        if elapsed == 0.0:
            return REST
        counts = told(self._owed / elapsed)
        self._owed -= counts * (elapsed / FULL)
        return _whole(counts)


def _whole(counts: Array) -> tuple[int, ...]:
    return tuple(int(count) for count in counts)
