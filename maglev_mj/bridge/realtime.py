"""Real-time scheduling and stop signals of a Python loop."""

from __future__ import annotations

import ctypes
import errno
import gc
import math
import os
import signal
import threading
from array import array
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, Literal, NoReturn, TypeAlias, get_args

import numpy as np

from maglev_mj.errors import MaglevError, check_one_of
from maglev_mj.parameters import number


class LatencyHistogram:
    """Latencies of a loop: recent values and the maximum.

    Args:
        size: Number of recent values to keep; a ParameterError if below 1.

    Attributes:
        count: Number of all added values.
        worst: Maximum of all values [ns].
    """

    def __init__(self, size: int = 1 << 16) -> None:
        self._ring = array("q", bytes(8 * int(number("size", size, at_least=1))))
        self._size = len(self._ring)
        self.count = self.worst = 0

    def add(self, latency: int) -> None:
        """Add one latency [ns]."""
        self._ring[self.count % self._size] = latency
        self.count += 1
        if latency > self.worst:
            self.worst = latency

    def percentile(self, share: float) -> float:
        """Return a percentile of recent latencies [s]; NaN without any."""
        return float(np.percentile(self._ring[: self.count], share)) * 1e-9 if self.count else math.nan

    p50 = property(lambda self: self.percentile(50.0), doc="Median of the recent latencies [s]; NaN without any.")
    p99 = property(lambda self: self.percentile(99.0), doc="99th percentile of the recent latencies [s].")

    max = property(lambda self: self.worst * 1e-9 if self.count else math.nan, doc="Maximum of all latencies [s].")


Realtime: TypeAlias = Literal["enforce", "ignore"]
"""Reaction to a refusal by the system: raise or continue."""

_GET_SLACK, _SET_SLACK = 30, 29  # of prctl
_CURRENT_AND_FUTURE = 3  # of mlockall


class RealtimeError(MaglevError):
    """The system refuses a real-time setting."""


@contextmanager
def realtime(mode: Realtime, priority: int = 80, cpu: int | None = None) -> Iterator[list[str]]:
    """Give this thread real-time scheduling; restore it at the end.

    Timer slack 1 ns, SCHED_FIFO, locked memory, one processor, no garbage collection. Threads and processes inherit
    some of that: start those first.

    Args:
        mode: "enforce" raises if something is refused, "ignore" goes on.
        priority: Priority of SCHED_FIFO, 1 to 99.
        cpu: Number of the processor to stay on; None for any.

    Yields:
        Refusals, a line each.

    Raises:
        ParameterError: If an argument is outside its bounds.
        RealtimeError: If something is refused and the mode is "enforce".
    """
    check_one_of("realtime", get_args(Realtime), mode)
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
            except (AttributeError, TypeError):  # a system without that function, or without such a library
                complaints.append(f"{name}: {os.strerror(errno.ENOSYS)}")
            except (OSError, ValueError, OverflowError) as error:
                complaints.append(f"{name}: {getattr(error, 'strerror', None) or error}")
        if complaints and mode == "enforce":
            raise RealtimeError(f"no real time: {'; '.join(complaints)}; see `ulimit -r` and `ulimit -l`")
        back.callback(_no_garbage())
        yield complaints


def _libc(name: str, *arguments: int) -> int:
    """Call a C library function; raise OSError if it fails."""
    if (result := int(getattr(ctypes.CDLL(None, use_errno=True), name)(*map(ctypes.c_ulong, arguments)))) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _timer_slack() -> Callable[[], object]:
    before = _libc("prctl", _GET_SLACK)
    _libc("prctl", _SET_SLACK, 1)
    return partial(_libc, "prctl", _SET_SLACK, before)


def _scheduler(priority: int) -> Callable[[], object]:
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    return partial(os.sched_setscheduler, 0, policy, parameters)


def _memory() -> Callable[[], object]:
    _libc("mlockall", _CURRENT_AND_FUTURE)
    return partial(_libc, "munlockall")


def _affinity(cpu: int) -> Callable[[], object]:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {cpu})
    return partial(os.sched_setaffinity, 0, before)


def _no_garbage() -> Callable[[], object]:
    enabled, frozen = gc.isenabled(), gc.get_freeze_count() > 0
    gc.collect()
    gc.freeze()
    gc.disable()

    def back() -> None:
        if not frozen:  # all that a program has frozen itself would be thawed too, and be looked through from then on
            gc.unfreeze()
        if enabled:
            gc.enable()

    return back


_HANGUP, _ALARM = getattr(signal, "SIGHUP", None), getattr(signal, "SIGALRM", None)  # not on every system


def interrupt() -> NoReturn:
    """Raise KeyboardInterrupt."""
    raise KeyboardInterrupt


@contextmanager
def stopping(
    stop: Callable[[], object], cut: Callable[[], object] = interrupt, *, within: float | None = None
) -> Iterator[None]:
    """Call `stop` at the first stop signal, then `cut`.

    Stop signals are SIGINT, SIGTERM and SIGHUP; each SIGINT after the first signal calls `cut`.

    Only Ctrl-C cuts: SIGTERM may be sent twice, and a closing terminal adds a SIGHUP.

    Args:
        stop: Called in the main thread, between any two of its steps; it may raise.
        cut: Called in the main thread; it may raise.
        within: Time after `stop` at which `cut` is called too [s]; None for never.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    asked = False

    def ask(kind: int, _frame: Any) -> None:
        nonlocal asked
        if asked:
            if kind in (signal.SIGINT, _ALARM):
                cut()
            return
        asked = True
        if within is not None and _ALARM is not None:
            signal.setitimer(signal.ITIMER_REAL, within)
        stop()

    kinds = [signal.SIGINT, signal.SIGTERM, *([] if _ALARM is None else [_ALARM])]
    if _HANGUP is not None and signal.getsignal(_HANGUP) != signal.SIG_IGN:  # nohup's stays ignored
        kinds.append(_HANGUP)
    before = [(kind, signal.signal(kind, ask)) for kind in kinds]
    try:
        yield
    finally:
        if within is not None and _ALARM is not None:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for kind, handler in before:
            signal.signal(kind, handler)
