"""Guards of a flight: late answers, and laws that vibrate or give out energy."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from maglev_mj.frames import ZERO
from maglev_mj.spec import INERTIA

_RECENT, _LATE = 16, 8
_NEWEST, _FAR, _BEYOND = 5, 3, 3.0
_MEMORY = 0.2
"""Time constant in which reversals are forgotten [s]."""
_REVERSALS = 260.0
"""Most reversals of a law's force [N].

Twice the largest of good flights: 130 N, taps of 20 N on the stiffest published wall at 200 Hz.
"""
_SPAN = 1.0
_ENERGY = 0.045
"""Most energy that laws may give out in a second [J].

More than twice the largest of good flights, 18 mJ: 20 N let go after a second against a wall.
"""
_HEAVY = 1e9
_AXES = range(6)
_SIZES = tuple(math.sqrt(own / INERTIA[0]) for own in INERTIA)
"""Radius of gyration of each rotation, 1 for translations [m].

A torque over it is a force, an angle times it a path.
"""


class DelayGuard:
    """Detector of answers later than the rendered laws bear.

    A single late answer makes no loop unstable: it takes 8 of the last 16 samples beyond what the laws bear, or 3 of
    the last 5 beyond three times that.

    Args:
        bears: Longest delay from a sample to its answer's effect that the laws bear [s].

    Attributes:
        bears: As given; it may be changed.
    """

    def __init__(self, bears: float) -> None:
        self.bears = bears
        self._delays = deque([0.0] * _RECENT, maxlen=_RECENT)

    def check(self, delay: float) -> str:
        """Add the delay of one sample [s]; return what is wrong, or ""."""
        delays, bears = self._delays, self.bears
        delays.append(delay)
        if delay <= bears:
            return ""
        recent = list(delays)
        for newest, most, bound in ((recent[-_NEWEST:], _FAR, _BEYOND * bears), (recent, _LATE, bears)):
            if (late := sum(one > bound for one in newest)) >= most:
                return (
                    f"the line is slower than the scene bears: {late} of the last {len(newest)} delays are above "
                    f"{bound * 1e3:.2f} ms, the newest {delay * 1e3:.2f} ms"
                )
        return ""


class PowerGuard:
    """Detector of laws that vibrate, or give out energy.

    Torques count as the forces, and angles as the paths, of a body with the axis' moment of inertia at the moving mass.
    Reversals are the smaller of two swings of a force to and fro, summed and forgotten in 0.2 s; energy is force times
    path over the last second. Both are of the laws alone, without the weight carried.

    Args:
        period: Sample period [s].
    """

    def __init__(self, period: float) -> None:
        self._growth = math.exp(period / _MEMORY)
        self._weight = 1.0  # of a reversal now: it grows where the older ones would shrink
        self._reversals, self._turns, self._swings, self._ways = [0.0] * 6, [0.0] * 6, [0.0] * 6, [0] * 6
        self._place: Sequence[float] = ZERO
        self._last: Sequence[float] = ZERO
        span = max(round(_SPAN / period), 1) + 1
        self._sums = deque([0.0] * span, maxlen=span)
        self._begun = False

    def check(self, position: Sequence[float], force: Sequence[float]) -> str:
        """Add one sample's pose and the laws' answer to it; return what is wrong, or ""."""
        last, place, given = self._last, self._place, self._sums[-1]
        self._weight = weight = self._weight * self._growth
        most = 0.0
        for axis in _AXES:
            before, part = last[axis], force[axis]
            if before and self._begun:
                given += before * (position[axis] - place[axis])
            if part == before:
                continue
            way = 1 if part > before else -1
            if way != self._ways[axis]:
                self._ways[axis] = way
                most = max(most, self._turned(axis, before, weight))
        self._sums.append(given)
        self._place, self._last, self._begun = position, force, True
        if weight > _HEAVY:
            self._reversals, self._weight = [one / weight for one in self._reversals], 1.0
        if most > _REVERSALS:
            return f"the laws vibrate: {most:.0f} N of reversals in {_MEMORY:g} s, {_REVERSALS:g} N allowed"
        if (out := given - self._sums[0]) > _ENERGY:
            return f"the laws give out energy: {out * 1e3:.0f} mJ in {_SPAN:g} s, {_ENERGY * 1e3:g} mJ allowed"
        return ""

    def _turned(self, axis: int, force: float, weight: float) -> float:
        """Add a turning point of a force; return the axis' reversals [N]."""
        swing = abs(force - self._turns[axis])
        self._reversals[axis] += weight * min(swing, self._swings[axis])
        self._turns[axis], self._swings[axis] = force, swing
        return self._reversals[axis] / weight / _SIZES[axis]
