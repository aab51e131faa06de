"""Whether frames are so slow that shadows should go, on which a processor that draws spends most of its time."""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["SlowFrames"]

_SLOW, _LONG = 0.05, 1.0


class SlowFrames:
    """Tells once when every frame of a second has taken more than 50 ms.

    Args:
        clock: Returns real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._since, self._told = clock, -1.0, False

    def add(self, cost: float) -> bool:
        """Return whether it is time to go without shadows, after a frame of such a cost [s]."""
        now = self._clock()
        if self._told or cost <= _SLOW:
            self._since = -1.0
            return False
        if self._since < 0.0:
            self._since = now
        self._told = now - self._since >= _LONG
        return self._told
