"""Detection of slow frames, to switch shadows off.

A software renderer spends most of its time on shadows.
"""

from __future__ import annotations

import time
from collections.abc import Callable

_SLOW, _LONG = 0.05, 1.0


class SlowFrames:
    """Detector of a second of slow frames.

    It reports once, when every frame of a second has taken more than 50 ms.

    Args:
        clock: Function that returns real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._since, self._told = clock, -1.0, False

    def add(self, cost: float) -> bool:
        """Return True once to switch shadows off.

        `cost` is the time of the last frame [s].
        """
        now = self._clock()
        if self._told or cost <= _SLOW:
            self._since = -1.0
            return False
        if self._since < 0.0:
            self._since = now
        self._told = now - self._since >= _LONG
        return self._told
