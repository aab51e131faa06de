"""What a loop in Python asks of the system: to be on time, and to be told when to stop."""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, Literal, TypeAlias, get_args

from maglev_mj.bridge.lateness import Lateness
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.parameters import number

__all__ = ["Lateness", "Realtime", "RealtimeError", "realtime", "stopping"]

Realtime: TypeAlias = Literal["enforce", "ignore"]
"""What to do where the system refuses: raise, or go on."""

_GET_SLACK, _SET_SLACK = 30, 29  # of prctl
_CURRENT_AND_FUTURE = 3  # of mlockall


class RealtimeError(MaglevError):
    """The system does not permit what a real-time loop asks for."""


@contextmanager
def realtime(mode: Realtime, priority: int = 80, cpu: int | None = None) -> Iterator[list[str]]:
    """Make this thread as punctual as the system permits, and give everything back at the end.

    It sleeps to the nanosecond, goes before what has no deadline (SCHED_FIFO), keeps its memory, stays on one
    processor, and collects no garbage. Threads and processes started meanwhile inherit some of that: start those first.

    Args:
        mode: "enforce" or "ignore": what to do where something is refused.
        priority: Of SCHED_FIFO, 1 to 99.
        cpu: Number of the processor to stay on; None for any.

    Yields:
        What was refused, a line each.

    Raises:
        ParameterError: If an argument is outside its bounds.
        RealtimeError: If something is refused and the mode is "enforce".
    """
    if mode not in get_args(Realtime):
        raise ParameterError(f"realtime must be one of {', '.join(get_args(Realtime))}, not {mode!r}")
    number("priority", priority, at_least=1, at_most=99)
    steps: list[tuple[str, Callable[[], Callable[[], object]]]] = [
        ("timer slack of 1 ns", _timer_slack),
        (f"SCHED_FIFO {priority}", partial(_scheduler, priority)),
        ("memory lock", _memory),
    ]
    if cpu is not None:
        steps.append((f"processor {cpu}", partial(_affinity, cpu)))
    complaints = []
    with ExitStack() as back:
        for name, step in steps:
            try:
                back.callback(step())
            except (OSError, ValueError, OverflowError) as error:
                complaints.append(f"{name}: {getattr(error, 'strerror', None) or error}")
        if complaints and mode == "enforce":
            raise RealtimeError(f"no real time: {'; '.join(complaints)}; see `ulimit -r` and `ulimit -l`")
        back.callback(_no_garbage())
        yield complaints


def _libc(name: str, *arguments: int) -> int:
    """Call a function of the C library.

    Raises:
        OSError: If there is none, or it fails.
    """
    try:
        function: Any = getattr(ctypes.CDLL(None, use_errno=True), name)
    except (AttributeError, TypeError):
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS)) from None
    result = int(function(*map(ctypes.c_ulong, arguments)))
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _system(name: str) -> Any:
    """Return a function of `os` that not every system has.

    Raises:
        OSError: If this has it not.
    """
    function = getattr(os, name, None)
    if function is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    return function


def _timer_slack() -> Callable[[], object]:
    before = _libc("prctl", _GET_SLACK)
    _libc("prctl", _SET_SLACK, 1)
    return partial(_libc, "prctl", _SET_SLACK, before)


def _scheduler(priority: int) -> Callable[[], object]:
    change = _system("sched_setscheduler")
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    change(0, os.SCHED_FIFO, os.sched_param(priority))
    return partial(change, 0, policy, parameters)


def _memory() -> Callable[[], object]:
    _libc("mlockall", _CURRENT_AND_FUTURE)
    return partial(_libc, "munlockall")


def _affinity(cpu: int) -> Callable[[], object]:
    change = _system("sched_setaffinity")
    before = os.sched_getaffinity(0)
    change(0, {cpu})
    return partial(change, 0, before)


def _no_garbage() -> Callable[[], object]:
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()

    def back() -> None:
        gc.unfreeze()
        if enabled:
            gc.enable()

    return back


@contextmanager
def stopping(stop: Callable[[], object]) -> Iterator[None]:
    """Call `stop` at the first SIGINT or SIGTERM, and raise KeyboardInterrupt at the second."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    asked = False

    def ask(*_: Any) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        stop()

    kinds = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(kind, ask) for kind in kinds]
    try:
        yield
    finally:
        for kind, handler in zip(kinds, before, strict=True):
            signal.signal(kind, handler)
