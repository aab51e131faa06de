"""Function in a separate process.

It does not delay the control loop.
"""

from __future__ import annotations

import atexit
import multiprocessing
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from select import select
from typing import Any

from maglev_mj.interrupts import interrupts_held

__all__ = ["SideProcess"]

_PATIENCE = 10.0


class SideProcess:
    """Function in a separate process, with a message pipe.

    Args:
        function: Function called there with its end of the pipe and the arguments; it returns when the pipe is closed.
        arguments: Arguments that can be pickled.

    Attributes:
        line: This end of the pipe.
        ended: True if either end has been closed.
    """

    def __init__(self, function: Callable[..., object], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self.line, far = context.Pipe()
        self.ended = False
        self._process = context.Process(target=function, args=(far, *arguments))
        resource_tracker.ensure_running()  # its start would let interrupts through
        try:
            with interrupts_held():  # its parent closes it
                self._process.start()
                atexit.register(self.close)  # otherwise a program that ends would wait for it forever
        except KeyboardInterrupt:
            self.close(0.0)
            raise
        finally:
            far.close()

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
        """Close the pipe, and end the process.

        The process is killed if it does not end by itself. A second call does nothing.

        Args:
            patience: Time to wait for its end [s].
        """
        atexit.unregister(self.close)
        self.ended = True
        self.line.close()
        self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_PATIENCE)
