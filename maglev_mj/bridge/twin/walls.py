"""Device side of walls: their checks, their currents at the device's own rate, and the guard of their energy."""

from __future__ import annotations

import math
from collections.abc import Sequence

from maglev_mj.bridge.safety import Profile
from maglev_mj.bridge.wire import MOST_WALLS, Fault, Wall
from maglev_mj.frames import ZERO

ENERGY = 4e-3
"""Limit of the energy that the walls return beyond what they took [J]: that of 0.7 kg at 0.11 m/s."""
_MEMORY = 1.0
"""Time constant with which generated energy is forgotten [s]: sensor noise in a wall generates a little."""
RECEDE = 0.03
"""Speed at which the edges recede in a controlled stop [m/s]."""
_ROUNDING = 1e-9


class Walls:
    """Walls in effect on a device, and those of the newest command.

    Args:
        profile: Properties of the device, with its `wall_maps`.

    Attributes:
        active: True while walls are in effect or pending, or their currents are to be taken back.
    """

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self.clear()

    def clear(self) -> None:
        """Remove all walls at once: the currents are cut."""
        self.active = False
        self._walls: Sequence[Wall] = ()
        self._pending: Sequence[Wall] | None = None
        self._due = self._sampled_at = 0  # [ns]
        self._pose: Sequence[float] | None = None  # at the last sample
        self._speeds, self._forces = [0.0] * MOST_WALLS, [0.0] * MOST_WALLS
        self._peaks: tuple[Sequence[float], Sequence[float]] = ZERO, ZERO
        self._energy = self._stored = 0.0

    @property
    def unstable(self) -> bool:
        """True if the walls have returned more energy than they took, by more than allowed."""
        return self._energy - self._stored > ENERGY

    def fault(self, walls: Sequence[Wall], spots: Sequence[float] | None, periods: int) -> Fault:
        """Return the fault of a command's walls, if any.

        An edge moves at most at `edge_speed`, and a new wall contains the flotor by at most one period of that.

        Args:
            walls: All walls of the command.
            spots: Last spots [m], six; None without.
            periods: Sample periods since the last command.
        """
        profile, latest = self._profile, self._walls if self._pending is None else self._pending
        if not walls:
            return Fault(0)
        if spots is None or profile.wall_maps is None or any(map(profile.wall_problem, walls)):
            return Fault.INVALID_COMMAND
        pose = profile.wall_maps.pose(spots)
        for index, wall in enumerate(walls):
            step = profile.limits.edge_speed * (profile.period * 1e-9) * (1.0 + _ROUNDING) / wall.lever
            depth = wall.edge - pose[wall.axis]
            moved = wall.side * depth if wall.side else abs(depth)
            if index < len(latest) and wall[:2] == latest[index][:2]:
                moved, step = abs(wall.edge - latest[index].edge), step * periods
            if not moved <= step:
                return Fault.INVALID_COMMAND
        return Fault(0)

    def command(self, walls: Sequence[Wall], due: int, currents: Sequence[Sequence[float]]) -> None:
        """Replace the walls at a time [ns].

        A replacement that is still pending is made now, but replaced by that of the same answer, repeated.
        `currents` are those that the host's part may have from then on [A], six each.
        """
        if not (walls or self.active):
            return
        if self._pending is not None and due > self._due:
            self._switch()
        peak = [max(map(abs, coil)) for coil in zip(*currents)]
        self._peaks = self._peaks[self._pending is None] if self.active else peak, peak
        self._pending, self._due, self.active = walls, due, True

    def _switch(self) -> None:
        """Let the pending walls take effect; a wall on the same axis and side continues."""
        pending: Sequence[Wall] = self._pending or ()
        for index, wall in enumerate(pending):
            if index >= len(self._walls) or wall[:2] != self._walls[index][:2]:
                self._speeds[index] = self._forces[index] = 0.0
        self._walls, self._pending = pending, None

    def render(self, now: int, spots: Sequence[float], silent: bool, stopping: float) -> Sequence[float]:
        """Return the currents of the walls at a sample [A], six.

        Inside f = -K (x - edge) - B v. While commands are missing a wall on both sides has no stiffness: it would pull
        to where its edge was.

        Args:
            now: Time of the sample [ns].
            spots: Measured spots [m], six.
            silent: True while commands are missing, and in a controlled stop.
            stopping: Time since the start of the controlled stop [s]; 0 without.
        """
        maps, limit = self._profile.wall_maps, self._profile.limits.current_limit
        assert maps is not None
        if self._pending is not None and now >= self._due:
            self._switch()
        pose, forces = maps.pose(spots), [0.0] * 6
        before = pose if self._pose is None else self._pose
        elapsed = (now - self._sampled_at if self._pose is not None else self._profile.wall_period) * 1e-9
        surplus, stored = max(self._energy - self._stored, 0.0), 0.0
        energy = self._energy - surplus * elapsed / _MEMORY
        for index, (axis, side, edge, stiffness, damping, cutoff) in enumerate(self._walls):
            edge -= side * (RECEDE * stopping / self._walls[index].lever)
            stiffness = 0.0 if silent and not side else stiffness
            moved, first, offset = pose[axis] - before[axis], before[axis] - edge, pose[axis] - edge
            speed, last = moved / elapsed, self._speeds[index]
            if cutoff:
                speed = last - math.expm1(-2.0 * math.pi * cutoff * elapsed) * (speed - last)
            inside = side * offset <= 0.0
            within = 0.5 * stiffness * offset * offset if inside else 0.0
            stored += within
            energy += self._forces[index] * moved + within
            energy -= 0.5 * stiffness * first * first if side * first <= 0.0 else 0.0
            self._speeds[index], force = speed, -(stiffness * offset + damping * speed) if inside else 0.0
            self._forces[index] = force
            forces[axis] += force
        a, b, c, d, e, f = forces
        currents = [p * a + q * b + r * c + s * d + t * e + u * f for p, q, r, s, t, u in maps.current_per_wrench]
        share = 1.0
        for current, peak, other in zip(currents, *self._peaks):
            room = max(limit - max(peak, other), 0.0)
            if abs(current) > room:
                share = min(share, room / abs(current))
        if share < 1.0:  # reduced together, so that the direction stays
            currents, self._forces = [share * x for x in currents], [share * x for x in self._forces]
        self._pose, self._sampled_at, self._energy, self._stored = pose, now, max(energy, 0.0), stored
        if not self._walls and self._pending is None:
            self.clear()
        return currents
