"""How far a long run is: a bar on a terminal, now and then a line elsewhere, nothing for a short run."""

from __future__ import annotations

import sys
import time
from typing import TextIO

__all__ = ["Progress"]

_WIDTH = 30


class Progress:
    """Call it with what is done and the total; it keeps quiet for the first two seconds.

    Args:
        label: What is under way.
        stream: Where to; standard error by default.
        quiet: How long to keep quiet [s].
        every: Least time between two lines where there is no terminal [s].
    """

    def __init__(self, label: str, stream: TextIO | None = None, *, quiet: float = 2.0, every: float = 10.0) -> None:
        self._label, self._stream = label, stream or sys.stderr
        self._start = time.monotonic()
        self._next = self._start + quiet
        self._terminal = self._stream.isatty()
        self._every = 0.1 if self._terminal else every
        self._first: int | None = None
        self._last = 0
        self._shown = False

    def __call__(self, done: int, total: int) -> None:
        """Say how far it is, if it is time to."""
        now = time.monotonic()
        if self._first is None or done < self._last:  # a second part of the work begins
            self._start, self._first = now, done
        self._last = done
        if now < self._next and not (self._shown and self._terminal and done >= total):
            return
        self._next, self._shown = now + self._every, True
        fresh = done - self._first
        left = "" if not fresh else f", {(now - self._start) * (total - done) / fresh:.0f} s left"
        text = f"{self._label}: {done} of {total}{left}"
        if self._terminal:
            filled = _WIDTH * done // max(total, 1)
            self._stream.write(f"\r\x1b[K[{'#' * filled}{'.' * (_WIDTH - filled)}] {text}")
        else:
            self._stream.write(text + "\n")
        self._stream.flush()

    def close(self) -> None:
        """Take the bar away."""
        if self._shown and self._terminal:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
        self._shown = False
