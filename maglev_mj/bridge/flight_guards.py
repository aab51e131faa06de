"""Guards of a flight: late answers, and laws that vibrate or give out energy."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from maglev_mj.frames import ZERO
from maglev_mj.spec import INERTIA
from maglev_mj.theory.closed_loop import MOST_PERIODS

_BORNE = 0.8
"""Share of what laws bear from which answers are late.

Near what it bears, a loop swings long after a tap.
"""
_SURE = 0.005
"""Delay up to which laws are taken to bear the whole [s].

Usual delays leave no room for a share.
"""
_LONGEST = 0.03
"""Longest delay to which margins are known [s]."""
_RULES = (3, 5, 3.0), (8, 16, 1.25), (48, 64, 1.0)
"""Late answers, of how many, beyond how much of the delay from which they are late.

A busy machine has answers a little late for a tenth of a second; a loop swings up slowly there.
"""
_MEMORY = 0.2
"""Time constant in which reversals are forgotten [s]."""
_SWING = 10.0
"""Largest part of a swing in the second sum of reversals [N].

A blow is a few hard swings, which weak vibrations exceed by their number.
"""
_REVERSALS, _SMALL = 380.0, 190.0
"""Most reversals of a law's force in both sums [N].

Twice the largest of good flights: 184 and 86 N, taps of 20 N on the stiffest published wall at 200 Hz.
"""
_SPAN = 1.0
_ENERGY = 0.045
"""Most energy that laws may give out in a second [J].

More than twice the largest of good flights, 18 mJ: 20 N let go after a second against a wall.
"""
_HEAVY = 1e9
_SIZES = tuple(math.sqrt(own / INERTIA[0]) for own in INERTIA)
"""Radius of gyration of each rotation, 1 for translations [m].

A torque over it is a force, an angle times it a path.
"""


def late_delay(bears: float, period: float) -> float:
    """Return the delay from which answers are late [s].

    Args:
        bears: Longest delay that the laws bear [s], as `delay_margins` returns it: NaN or infinity if it is not known.
        period: Sample period [s].
    """
    longest = min(_LONGEST, MOST_PERIODS * period)
    known = bears if bears < longest else longest  # which NaN is not
    return max(_BORNE * known, min(known, _SURE))


class DelayGuard:
    """Detector of answers later than the rendered laws bear.

    A single late answer makes no loop unstable, nor do some that are a little late: it takes 48 of the last 64 samples
    beyond what the laws bear, 8 of 16 beyond 1.25 times that, or 3 of 5 beyond three times.

    Args:
        bears: Longest delay from a sample to its answer's effect that the laws bear [s]; see `late_delay`.

    Attributes:
        bears: As given; it may be changed.
    """

    def __init__(self, bears: float) -> None:
        self.bears = bears
        most = max(last for _, last, _ in _RULES)
        self._delays = deque([0.0] * most, maxlen=most)

    def check(self, delay: float) -> str:
        """Add the delay of one sample [s]; return what is wrong, or ""."""
        delays, bears = self._delays, self.bears
        delays.append(delay)
        if delay <= bears:
            return ""
        recent = list(delays)
        for most, last, share in _RULES:
            bound = share * bears
            if delay > bound and (late := sum(one > bound for one in recent[-last:])) >= most:
                return (
                    f"the line is slower than the scene bears: {late} of the last {last} delays are above "
                    f"{bound * 1e3:.2f} ms, the newest {delay * 1e3:.2f} ms"
                )
        return ""


class PowerGuard:
    """Detector of laws that vibrate, or give out energy.

    Torques count as the forces, and angles as the paths, of a body with the axis' moment of inertia at the moving mass.
    Reversals are the smaller of two swings of a force to and fro, summed and forgotten in 0.2 s: whole, and up to 10 N
    of each. Energy is force times path over the last second. All are of the laws alone, without the weight carried.

    Args:
        period: Sample period [s].
    """

    def __init__(self, period: float) -> None:
        self._growth = math.exp(period / _MEMORY)
        self._weight = 1.0  # of a reversal now: it grows where the older ones would shrink
        self._reversals, self._small = [0.0] * 6, [0.0] * 6
        self._turns, self._swings, self._rises = [0.0] * 6, [0.0] * 6, [False] * 6
        self._place: Sequence[float] = ZERO
        self._last: Sequence[float] = ZERO
        span = max(round(_SPAN / period), 1) + 1
        self._sums = deque([0.0] * span, maxlen=span)

    def check(self, position: Sequence[float], force: Sequence[float]) -> str:
        """Add one sample's pose and the laws' answer to it; return what is wrong, or ""."""
        given, rises, swings, most, capped = self._sums[-1], self._rises, self._swings, 0.0, 0.0
        self._weight = weight = self._weight * self._growth
        parts = zip(self._last, force, self._place, position, rises)
        for axis, (before, part, start, end, rose) in enumerate(parts):
            given += before * (end - start)
            if part != before and (part > before) is not rose:
                rises[axis] = not rose
                swing = abs(before - self._turns[axis]) / _SIZES[axis]
                less = swing if swing < swings[axis] else swings[axis]
                self._turns[axis], swings[axis] = before, swing
                self._reversals[axis] = whole = self._reversals[axis] + weight * less
                self._small[axis] = small = self._small[axis] + weight * (less if less < _SWING else _SWING)
                if whole > most:
                    most = whole
                if small > capped:
                    capped = small
        most, capped = most / weight, capped / weight
        self._sums.append(given)
        self._place, self._last = position, force
        if weight > _HEAVY:
            self._reversals, self._small = ([one / weight for one in six] for six in (self._reversals, self._small))
            self._weight = 1.0
        if most > _REVERSALS:
            return f"the laws vibrate: {most:.0f} N of reversals in {_MEMORY:g} s, {_REVERSALS:g} N allowed"
        if capped > _SMALL:
            return (
                f"the laws vibrate: {capped:.0f} N of reversals of at most {_SWING:g} N each in {_MEMORY:g} s, "
                f"{_SMALL:g} N allowed"
            )
        if (out := given - self._sums[0]) > _ENERGY:
            return f"the laws give out energy: {out * 1e3:.0f} mJ in {_SPAN:g} s, {_ENERGY * 1e3:g} mJ allowed"
        return ""
