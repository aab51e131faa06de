"""What other programs are told while a scene runs, and what they may ask for."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from maglev_mj.frames import Array
from maglev_mj.scenes import Scene, Settings

__all__ = ["Moment", "Outlet", "Outlets"]

_FRAME = 1.0 / 60.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """What there is to tell of a sample.

    Attributes:
        scene: The scene.
        settings: What it runs under.
        since: Tick from which on it does.
        delay: From a sample to its command taking effect [s]: where it is measured, the median of the last 100.
        tick: Samples answered so far.
        time: Since the start [s].
        pose: Of the flotor [m, rad], six.
        force: Wrench that the device holds beyond what carries the flotor [N, N m], six.
        hand: Wrench of the hand [N, N m], six; zeros where nobody measures it.
        anchors: Where the flotor sticks [m, rad], (6,), NaN where it does not; None without friction.
        state: "running", "paused", "stopped" or "flying".
        reason: Why it has stopped; empty otherwise.
        missed: Ticks that were not kept up with, or samples that did not arrive.
    """

    scene: Scene
    settings: Settings
    since: int
    delay: float
    tick: int
    time: float
    pose: Sequence[float]
    force: Sequence[float]
    hand: Sequence[float]
    anchors: Array | None
    state: str
    reason: str = ""
    missed: int = 0


class Outlet(Protocol):
    """A way to other programs. It never waits, for it is called where the samples are answered."""

    def take(self) -> Settings | None:
        """Return settings that a program asks for and may have, once."""

    def show(self, moment: Moment) -> None:
        """Tell of a moment."""

    def close(self) -> None:
        """Let everybody go; a second time does nothing."""


class Outlets:
    """Every way to other programs, told 60 times a second.

    Args:
        outlets: Some, or none.
        clock: Returns real time [s].
    """

    def __init__(self, outlets: Sequence[Outlet] = (), clock: Callable[[], float] = time.monotonic) -> None:
        self._outlets, self._clock, self._due = tuple(outlets), clock, -1.0

    def __bool__(self) -> bool:
        return bool(self._outlets)

    def show(self, moment: Callable[[], Moment]) -> None:
        """Tell of a moment, if it is time to; only then is it made."""
        if not self._outlets or (now := self._clock()) < self._due:
            return
        # to a grid of frames, from which a late call does not drift away
        self._due = self._due + _FRAME if now < self._due + _FRAME else now + _FRAME
        told = moment()
        for outlet in self._outlets:
            outlet.show(told)

    def wanted(self) -> Settings | None:
        """Return what a program asks for, once."""
        for outlet in self._outlets:
            if (settings := outlet.take()) is not None:
                return settings
        return None

    def close(self) -> None:
        """Let everybody go."""
        for outlet in self._outlets:
            outlet.close()
