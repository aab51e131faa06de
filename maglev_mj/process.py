"""A function in a process of its own: what must not hold up a control loop."""

from __future__ import annotations

import atexit
import multiprocessing
from collections.abc import Callable, Iterator
from select import select
from typing import Any

from maglev_mj.workers import interrupts_held

__all__ = ["SideProcess"]

_PATIENCE = 10.0


class SideProcess:
    """A function in a process of its own, at the other end of a line.

    Args:
        function: Called there with its end of the line and the arguments; it returns when the line has ended.
        arguments: Whatever can be pickled.

    Attributes:
        line: The end of the line that is here.
        ended: Whether either end has been closed.
    """

    def __init__(self, function: Callable[..., object], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self.line, far = context.Pipe()
        self.ended = False
        self._process = context.Process(target=function, args=(far, *arguments))
        with interrupts_held():  # it is closed by who opened it
            self._process.start()
        far.close()
        atexit.register(self.close)  # a program that ends would wait for it without end

    @property
    def ready(self) -> bool:
        """True if a message can be sent without waiting."""
        return not self.ended and bool(select((), (self.line,), (), 0.0)[1])

    def send(self, message: object) -> None:
        """Send a message."""
        try:
            if not self.ended:
                self.line.send(message)
        except OSError:
            self.ended = True

    def received(self) -> Iterator[Any]:
        """Yield the messages that have arrived."""
        try:
            while not self.ended and select((self.line,), (), (), 0.0)[0]:  # poll() takes four times as long
                yield self.line.recv()
        except (EOFError, OSError):
            self.ended = True

    def close(self, patience: float = _PATIENCE) -> None:
        """Close the line, and end the process if it does not end by itself; a second time does nothing.

        Args:
            patience: How long it may take [s].
        """
        atexit.unregister(self.close)
        self.ended = True
        self.line.close()
        self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_PATIENCE)
