"""Ways to other programs: snapshots for them, and parameters that they ask for."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Protocol

from maglev_mj.scenes import Scene
from maglev_mj.session.pacing import Due
from maglev_mj.session.snapshot import Snapshot

__all__ = ["Publisher", "Publishers"]


class Publisher(Protocol):
    """A way to other programs. It never waits, for it is called where the samples are answered."""

    def take(self) -> Scene | None:
        """Return the scene that a program asks for and may have, once."""

    def show(self, snapshot: Snapshot) -> None:
        """Publish a snapshot."""

    def close(self) -> None:
        """Close every connection; a second time does nothing."""


class Publishers:
    """Publish snapshots 60 times a second.

    Args:
        publishers: Some, or none.
        clock: Returns real time [s].
    """

    def __init__(self, publishers: Sequence[Publisher] = (), clock: Callable[[], float] = time.monotonic) -> None:
        self._publishers, self._due = tuple(publishers), Due(clock=clock)

    def __bool__(self) -> bool:
        return bool(self._publishers)

    def show(self, snapshot: Callable[[], Snapshot]) -> None:
        """Publish a snapshot, if one is due; only then is it made."""
        if not self._publishers or not self._due():
            return
        made = snapshot()
        for publisher in self._publishers:
            publisher.show(made)

    def wanted(self) -> Scene | None:
        """Return the scene that a program asks for, once."""
        for publisher in self._publishers:
            if (scene := publisher.take()) is not None:
                return scene
        return None

    def close(self) -> None:
        """Close all."""
        for publisher in self._publishers:
            publisher.close()
