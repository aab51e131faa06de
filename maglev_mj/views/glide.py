"""Smooth motion of a hand's target that arrives in steps.

The target is released if the line is silent.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from maglev_mj.plants.hand import SpringHand

SILENCE = 0.5
"""Silence after which the hand is released [s].

A held target is sent again and again.
"""

_LONGEST = 0.05
"""Longest time to reach a target [s].

A browser sends 20 a second, a window 60; each is reached when the next may come.
"""


class Glide:
    """Move a hand's target smoothly to the wanted pose.

    Args:
        clock: Returns real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._start: Sequence[float] = ()
        self._goal: Sequence[float] | None = None
        self._came, self._lasts, self._held = 0.0, 0.0, False

    def aim(self, target: Sequence[float] | None) -> None:
        """Take a new target pose [m, rad], (6,).

        None releases the hand, as does one that is not finite.
        """
        if target is not None and not all(map(math.isfinite, target)):
            target = None  # a browser may say anything, and a plant refuses such a hand for good
        now = self._clock()
        self._start = (self._now(now) or target) if self._held and target is not None else target or ()
        self._goal, self._came, self._lasts = target, now, min(now - self._came, _LONGEST)

    def move(self, hand: SpringHand) -> None:
        """Move a hand's target, if the hand is held here."""
        if not self._held and self._goal is None:
            return
        hand.target = self._now(self._clock())
        self._held = hand.target is not None

    def _now(self, now: float) -> Sequence[float] | None:
        """Return the target of an instant."""
        passed = now - self._came
        if self._goal is None or passed > SILENCE:
            self._goal = None
            return None
        share = min(passed / self._lasts, 1.0) if self._lasts > 0.0 else 1.0
        return [start + share * (goal - start) for start, goal in zip(self._start, self._goal)]
