"""Another process, and Ctrl-C while a command runs or starts a program."""

from __future__ import annotations

import atexit
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from select import select
from typing import Any

from maglev_mj.errors import MaglevError

NICE = 5
"""Niceness of processes without deadlines."""

LONGEST_ANSWER = 10.0
"""Longest time for an answer from another process [s]."""

_PATIENCE = 10.0


def be_nice() -> None:
    """Give way to processes with deadlines, where a system knows niceness."""
    if hasattr(os, "nice"):
        os.nice(NICE)


def start_tracker() -> None:
    """Start the tracker of shared resources, where processes have one.

    Its later start would let interrupts through.
    """
    if hasattr(os, "fork"):
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()


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
        import multiprocessing  # slow to load, and most commands need none
        from multiprocessing.connection import Connection
        from socket import socketpair

        context = multiprocessing.get_context("spawn")
        # as its Pipe() on POSIX systems; on Windows that is no socket, for which alone there is `select`
        self.line, far = (Connection(end.detach()) for end in socketpair())
        self.ended = False
        self._process = context.Process(target=function, args=(far, *arguments))
        start_tracker()
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


class SideAnswers(SideProcess):
    """Answers of a function in a separate process, to the newest question only.

    Neither question nor answer is waited for. The process gets a question once it has answered the one before.

    Args:
        function: Function of a question's parts, called there; it, parts and answers can be pickled.
        unknown: What is not known without an answer, for the error.
    """

    _question: tuple[Any, ...] | None = None
    _until, _busy = math.inf, True  # until its modules are loaded, which its first message says

    def __init__(self, function: Callable[..., Any], unknown: str) -> None:
        super().__init__(_answer, function)
        self._unknown = unknown

    def ask(self, *question: Any) -> None:
        """Take a question for the next `answer` to send; one before gets no answer any more."""
        self._question, self._until = question, time.monotonic() + LONGEST_ANSWER

    def answer(self) -> Any:
        """Return the answer to the newest question, once; None until then.

        Raises:
            MaglevError: If the function fails, takes over 10 s, or its process has ended.
        """
        answer: Any = None
        for found in self.received():
            self._busy = False
            if self._question is None and self._until < math.inf:  # otherwise of an older question
                answer = found
        if self._question is not None and not self._busy:
            self.send(self._question)
            self._question, self._busy = None, True
        if self._until < math.inf and answer is None:
            if self.ended:
                answer = MaglevError(f"{self._unknown}: the process that computes it has ended")
            elif time.monotonic() > self._until:
                answer = MaglevError(f"{self._unknown}: it takes over {LONGEST_ANSWER:g} s")
        if answer is not None:
            self._question, self._until = None, math.inf
        if isinstance(answer, MaglevError):
            raise answer
        return answer


def _answer(line: Any, function: Callable[..., Any]) -> None:
    """Answer questions until the line ends, in an own process."""
    be_nice()
    answer: Any = None
    with suppress(OSError):
        while True:
            line.send(answer)
            try:
                answer = function(*line.recv())
            except EOFError:
                return
            except Exception as error:  # also of a class that this process does not find
                answer = MaglevError(str(error) or repr(error))


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back during the context.

    Processes started meanwhile never receive it; this process receives it afterwards.

    A terminal sends Ctrl-C to every process, also to one that is still importing and has no handler of its own.
    """
    late = list[int]()
    here = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is not None
    # other threads of this process may take it where this one blocks it
    before = signal.signal(signal.SIGINT, lambda number, _: late.append(number)) if here else None
    blocks = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if blocks else set()
    try:
        yield
    finally:
        if blocks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if here:
            signal.signal(signal.SIGINT, before)
        if late:
            signal.raise_signal(late[0])
