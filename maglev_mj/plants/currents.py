"""Coil currents of commands, with a current limit."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import partial

import numpy as np

from maglev_mj.coils import CoilMap, limited_wrench
from maglev_mj.frames import Array, Command


class CoilDrive:
    """Map from a wrench to six limited coil currents.

    The map is that of the flotor's present angle.

    Args:
        coils: Coil model of the commanding side.
        limit: Largest current in any coil [A]; None for no limit.

    Attributes:
        inverse_map: Currents per wrench at the last angle of `follow` [A/N, A/(N m)], (6, 6).
    """

    def __init__(self, coils: CoilMap, limit: float | None) -> None:
        self._coils, self._limit = coils, limit
        self.inverse_map = self._upright = coils.current_per_wrench
        self._wrench, self._currents = np.zeros(6), np.zeros(6)
        # as `self._wrench[:] = force`, in half the time
        self._fill = partial(struct.pack_into, "6d", self._wrench.data, 0)
        self._known: tuple[Sequence[float] | None, list[float]] = None, []

    @property
    def turned(self) -> bool:
        """True if the map is not the upright one."""
        return self.inverse_map is not self._upright

    def follow(self, rotation: Array | None, angle: Sequence[float] | None = None) -> bool:
        """Update the map to another angle.

        Returns True if the flotor was upright and still is.

        Args:
            rotation: Rotation matrix of the flotor, (9,); None for upright.
            angle: Measured rotation vector in place of the matrix [rad], three.
        """
        before = self.inverse_map
        if angle is not None:
            self.inverse_map = self._coils.inverse_turned(*angle)
        else:
            self.inverse_map = self._upright if rotation is None else self._coils.inverse_at(rotation)
        return before is self._upright is self.inverse_map

    def currents(self, force: Sequence[float]) -> list[float]:
        """Return the currents [A] for a wrench [N, N m].

        Six each.
        """
        known, currents = self._known
        if force is known:  # computed by the limiter already
            return currents
        return self._mapped(force)

    def _mapped(self, force: Sequence[float]) -> list[float]:
        self._fill(*force)
        listed: list[float] = self.inverse_map.dot(self._wrench, out=self._currents).tolist()
        return listed

    def limited(self, command: Command) -> Command:
        """Return a command with clipped currents.

        The currents of the pulse are clipped separately.
        """
        force, extra = command.force, command.extra
        if extra is None:
            left = self._clipped(force)
            return command if left is force else Command(left)
        total = self._clipped([one + other for one, other in zip(force, extra)])
        left = self._clipped(force)
        return Command(left, [one - other for one, other in zip(total, left)], command.pulse_width)

    def _clipped(self, force: Sequence[float]) -> Sequence[float]:
        limit = self._limit
        assert limit is not None
        currents = self._mapped(force)
        within = max(currents) <= limit and min(currents) >= -limit  # as nearly always
        self._known = (force, currents) if within else limited_wrench(self.inverse_map, force, limit)
        return self._known[0]
