"""Side processes, and deferral of Ctrl-C."""

from __future__ import annotations

import atexit
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from select import select
from typing import Any

from maglev_mj.errors import MaglevError

NICE = 5
"""Niceness of processes without deadlines."""

_TIMEOUT = 10.0


def be_nice() -> None:
    """Lower the priority of this process, where the system supports niceness."""
    if hasattr(os, "nice"):
        os.nice(NICE)


@contextmanager
def process_start() -> Iterator[None]:
    """Start processes in this context: they never receive Ctrl-C, and prefer no module of the current folder.

    Raises:
        MaglevError: If a frozen program was started as a worker but runs as the program, which would never end.
    """
    import multiprocessing  # slow import, rarely needed

    as_worker = any(word == "--multiprocessing-fork" or word.startswith("from multiprocessing.") for word in sys.argv)
    if getattr(sys, "frozen", False) and as_worker and multiprocessing.parent_process() is None:
        raise MaglevError("a frozen program must first call multiprocessing.freeze_support()")
    before = os.environ.setdefault("PYTHONSAFEPATH", "")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        if hasattr(os, "fork"):
            from multiprocessing import resource_tracker

            resource_tracker.ensure_running()  # a later start would unblock interrupts
        with interrupts_held():
            yield
    finally:
        os.environ["PYTHONSAFEPATH"] = before


class SideProcess:
    """Function in a separate process, with a message pipe.

    Args:
        function: Called in the process with its end of the pipe and the arguments; must return when the pipe closes.
        arguments: Picklable arguments.

    Attributes:
        line: This end of the pipe.
        ended: True if either end has been closed.
    """

    def __init__(self, function: Callable[..., object], *arguments: Any) -> None:
        import multiprocessing  # slow import, rarely needed
        from multiprocessing.connection import Connection
        from socket import socketpair

        context = multiprocessing.get_context("spawn")
        # as Pipe() on POSIX; on Windows a Pipe is not a socket, but `select` requires one
        self.line, remote = (Connection(end.detach()) for end in socketpair())
        self.ended = False
        self._process = context.Process(target=function, args=(remote, *arguments))
        try:
            with process_start():  # the parent closes the process
                self._process.start()
                atexit.register(self.close)  # otherwise the interpreter would wait for it indefinitely at exit
        except KeyboardInterrupt:
            if self._process.pid is not None:
                self.close(0.0)
            raise
        finally:
            remote.close()

    @property
    def ready(self) -> bool:
        """True if a message can be sent without blocking."""
        return not self.ended and bool(select((), (self.line,), (), 0.0)[1])

    def send(self, message: object) -> None:
        """Send a message; `received` detects that the other end is closed, after its last messages."""
        with suppress(OSError):
            if not self.ended:
                self.line.send(message)

    def received(self) -> Iterator[Any]:
        """Yield the messages received so far, without blocking."""
        try:
            while not self.ended and select((self.line,), (), (), 0.0)[0]:  # poll() is four times slower
                yield self.line.recv()
        except (EOFError, OSError):
            self.ended = True

    def close(self, patience: float = _TIMEOUT) -> None:
        """Close the pipe and wait for the process; kill it after the timeout. Idempotent.

        Args:
            patience: Timeout [s].
        """
        atexit.unregister(self.close)
        self.ended = True
        self.line.close()
        self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_TIMEOUT)


class SideAnswers(SideProcess):
    """Function evaluated in a separate process, for the newest question only.

    Non-blocking in both directions; one question is in progress at a time.

    Args:
        function: Picklable function of a question's parts; parts and answers must be picklable.
        unknown: Beginning of the error message if there is no answer.
        timeout: Timeout for an answer [s].
    """

    _question: tuple[Any, ...] | None = None
    _until: float | None = None  # None without a question in progress
    _busy = True  # until the first message: imports done

    def __init__(self, function: Callable[..., Any], unknown: str, timeout: float = math.inf) -> None:
        super().__init__(_answer, function)
        self._unknown, self._timeout = unknown, timeout

    @property
    def started(self) -> bool:
        """True once the process can compute, or has ended; call before the first question only."""
        self._busy = self._busy and not any(True for _ in self.received())
        return not self._busy or self.ended

    def ask(self, *question: Any) -> None:
        """Set the question that the next `answer` sends; earlier ones are dropped."""
        self._question, self._until = question, time.monotonic() + self._timeout

    def answer(self) -> Any:
        """Return the answer to the newest question, once; None if there is none yet.

        Raises:
            MaglevError: If the function fails or exceeds the timeout, or the process has ended.
        """
        answer: Any = None
        for message in self.received():
            self._busy = False
            if self._question is None and self._until is not None:  # else it answers an older question
                answer = message
        if self._question is not None and not self._busy:
            self.send(self._question)
            self._question, self._busy = None, True
        if self._until is not None and answer is None:
            if self.ended:
                answer = MaglevError(f"{self._unknown}: its process has ended")
            elif time.monotonic() > self._until:
                answer = MaglevError(f"{self._unknown}: timeout after {self._timeout:g} s")
        if answer is not None:
            self._question = self._until = None
        if isinstance(answer, MaglevError):
            raise answer
        return answer


def _answer(line: Any, function: Callable[..., Any]) -> None:
    """Answer questions until the pipe closes; runs in the side process."""
    be_nice()
    answer: Any = None
    with suppress(OSError):
        while True:
            line.send(answer)
            try:
                answer = function(*line.recv())
            except EOFError:
                return
            except Exception as error:  # also of classes that the parent cannot unpickle
                answer = MaglevError(str(error) or repr(error))


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Defer Ctrl-C to the end of the context; processes started meanwhile never receive it.

    A terminal sends Ctrl-C to every process of the group, also to one that is still importing without a handler.
    """
    pending = list[int]()
    is_main = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is not None
    # another thread may receive the signal that this one blocks
    before = signal.signal(signal.SIGINT, lambda number, _: pending.append(number)) if is_main else None
    blocks = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if blocks else set()
    try:
        yield
    finally:
        if blocks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if is_main:
            signal.signal(signal.SIGINT, before)
        if pending:
            signal.raise_signal(pending[0])
