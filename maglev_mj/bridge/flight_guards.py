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
        self._keep = math.exp(-period / _MEMORY)
        self._reversals, self._turns = [0.0] * 6, [0.0] * 6
        self._last, self._before, self._ways = list(ZERO), [0.0] * 6, [0] * 6
        self._place: Sequence[float] | None = None
        self._sums = deque([0.0] * (max(round(_SPAN / period), 1) + 1), maxlen=max(round(_SPAN / period), 1) + 1)

    def check(self, position: Sequence[float], force: Sequence[float]) -> str:
        """Add one sample's pose and the laws' answer to it; return what is wrong, or ""."""
        given = self._sums[-1]
        if self._place is not None:
            for size, one, other, acted in zip(_SIZES, position, self._place, self._last):
                given += size * (one - other) * acted
        self._sums.append(given)
        self._place = position
        worst = 0.0
        for axis, (part, size) in enumerate(zip(force, _SIZES)):
            self._reversals[axis] *= self._keep
            part /= size
            step = part - self._last[axis]
            way = 1 if step > 0.0 else -1 if step < 0.0 else 0  # of numpy numbers too
            if way and way != self._ways[axis]:
                swing = abs(self._last[axis] - self._turns[axis])
                self._reversals[axis] += min(swing, self._before[axis])
                self._turns[axis], self._before[axis], self._ways[axis] = self._last[axis], swing, way
            self._last[axis] = part
            worst = max(worst, self._reversals[axis])
        if worst > _REVERSALS:
            return f"the laws vibrate: {worst:.0f} N of reversals in {_MEMORY:g} s, {_REVERSALS:g} N allowed"
        if (out := given - self._sums[0]) > _ENERGY:
            return f"the laws give out energy: {out * 1e3:.0f} mJ in {_SPAN:g} s, {_ENERGY * 1e3:g} mJ allowed"
        return ""
