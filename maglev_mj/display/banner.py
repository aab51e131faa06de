"""The banner of a snapshot: stopped, paused, too slow; and notes that go away."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from maglev_mj.session import Snapshot

__all__ = ["Banner", "Note", "banner"]

_SHOWN = 6.0


class Banner(NamedTuple):
    """Words over everything else.

    Attributes:
        text: What is the matter.
        way_on: Action that goes on; empty where there is none.
        bad: Whether something is wrong, and not only asked for.
        remedy: Way on where it is no action; empty otherwise.
    """

    text: str
    way_on: str
    bad: bool
    remedy: str = ""


def banner(snapshot: Snapshot) -> Banner | None:
    """Return the banner of a snapshot; None where all goes on."""
    if snapshot.state == "stopped":
        return Banner(f"STOPPED: {snapshot.reason}", _known("centre", snapshot), True, snapshot.remedy)
    if snapshot.state == "paused":
        return Banner("PAUSED", _known("pause", snapshot), False)
    if snapshot.late:
        text = "TOO SLOW: this machine cannot keep up, simulated time slows down"
        return Banner(text, _known("slower", snapshot), True)
    return None


def _known(action: str, snapshot: Snapshot) -> str:
    """Return an action if it does something, empty if it does not."""
    return action if action in snapshot.actions else ""


class Note:
    """Hold one line for the person, for some seconds.

    Args:
        clock: Returns real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._text, self._until = clock, "", 0.0

    def say(self, text: str) -> None:
        """Show a line in place of the last."""
        self._text, self._until = text, self._clock() + _SHOWN

    @property
    def lines(self) -> list[str]:
        """The line, while it is to be shown."""
        return [self._text] if self._text and self._clock() < self._until else []
