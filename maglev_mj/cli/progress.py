"""Progress bar of long runs, only on a terminal.

It appears after two seconds.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self, TextIO

_WIDTH, _SLIDER = 30, 6
_ERASED = "\r\x1b[K"


class Progress:
    """Context manager that draws a progress bar.

    Call it with the finished and the total work.

    Args:
        label: Name of the work.
        stream: Output stream; standard error by default.
        quiet: Time before the first drawing [s].
        every: Time between two drawings [s].
    """

    def __init__(self, label: str, stream: TextIO | None = None, *, quiet: float = 2.0, every: float = 0.2) -> None:
        self._label, self._stream = label, stream or sys.stderr
        self._quiet, self._every = quiet, every
        self._began = self._start = time.monotonic()
        self._first = self._done = self._total = 0
        self._shown = False
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._draw, name="progress", daemon=True)

    def __enter__(self) -> Self:
        if self._stream.isatty():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join()
        with self.aside():
            pass

    def __call__(self, done: int, total: int) -> None:
        """Update the finished work.

        Less than before begins a second part.
        """
        with self._lock:
            if not self._total or done < self._done:
                self._start, self._first = time.monotonic(), done
            self._done, self._total = done, total

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Remove the bar while something else is printed."""
        with self._lock:
            if self._shown:
                self._stream.write(_ERASED)
                self._stream.flush()
                self._shown = False
            yield

    def _draw(self) -> None:
        wait = self._quiet
        while not self._over.wait(wait):
            wait = self._every
            with self._lock:
                self._stream.write(_ERASED + self._bar())
                self._stream.flush()
                self._shown = True

    def _bar(self) -> str:
        now = time.monotonic()
        if not self._total:
            place = int((now - self._began) / self._every) % (_WIDTH - _SLIDER + 1)
            bar = f"{'.' * place}{'#' * _SLIDER}".ljust(_WIDTH, ".")
            return f"[{bar}] {self._label}: {now - self._began:.0f} s"
        bar = ("#" * (_WIDTH * self._done // self._total)).ljust(_WIDTH, ".")
        fresh = self._done - self._first
        left = f", {(now - self._start) * (self._total - self._done) / fresh:.0f} s left" if fresh else ""
        return f"[{bar}] {self._label}: {self._done} of {self._total}{left}"
