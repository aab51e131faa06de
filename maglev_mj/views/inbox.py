"""Requests of a person to a control loop, which no flood of them delays."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from maglev_mj.session import EMERGENCY_STOP, Due

Request: TypeAlias = tuple[str, Any]
"""A kind and its value: "hand" (target), "act" (action), "change" (parameters by name)."""

_PERIOD = 0.05
_MOST = 64
_STILL = 0.5


class Inbox:
    """Bounded queue of a person's requests, filled from any thread.

    The emergency stop goes ahead of everything, and what waits before it is dropped, as are parameters after it that
    follow one another within half a second: a slider still moving starts nothing again. The newest target of the hand
    goes ahead of the rest. Of each parameter between two actions the newest value is kept; beyond 64 requests that
    wait, further ones are dropped.

    Args:
        period: Shortest time from one handing over of actions and parameters to the next [s].
        clock: Clock of real time [s].
    """

    def __init__(self, period: float = _PERIOD, clock: Callable[[], float] = time.monotonic) -> None:
        self._due, self._clock, self._lock = Due(period, clock), clock, threading.Lock()
        self._stop, self._moved = False, -math.inf
        self._hand: list[Request] = []
        self._waiting: list[Request] = []

    def put(self, kind: str, value: Any) -> None:
        """Add a request."""
        with self._lock:
            if kind == "hand":
                self._hand = [(kind, value)]
            elif value == EMERGENCY_STOP:
                self._stop, self._waiting, self._moved = True, [], self._clock()
            elif kind == "change" and self._clock() - self._moved < _STILL:
                self._moved = self._clock()
            elif kind == "change" and self._waiting and self._waiting[-1][0] == "change":
                self._waiting[-1] = kind, {**self._waiting[-1][1], **value}
            elif len(self._waiting) < _MOST:
                self._waiting.append((kind, value))

    def take(self) -> Sequence[Request]:
        """Return the requests that are due, the most urgent first; each is returned once."""
        with self._lock:
            requests: list[Request] = [("act", EMERGENCY_STOP)] if self._stop else []
            requests += self._hand
            self._stop, self._hand = False, []
            if self._waiting and self._due():
                requests += self._waiting
                self._waiting = []
        return requests
