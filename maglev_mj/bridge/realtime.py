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
        size: Number of recent values to store, at least 1.

    Attributes:
        count: Number of added values.
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
        """Return a percentile of the recent latencies [s]; NaN without any."""
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
    """Run this thread with real-time scheduling; restore its settings at the end.

    Sets timer slack 1 ns, SCHED_FIFO, locked memory, CPU affinity; disables garbage collection. Threads and processes
    inherit some of these: start them before.

    Args:
        mode: "enforce" raises if a setting is refused, "ignore" continues.
        priority: Priority of SCHED_FIFO, 1 to 99.
        cpu: Index of the processor to run on; None for any.

    Yields:
        Refused settings with reasons, one line each.

    Raises:
        ParameterError: If an argument is outside its bounds.
        RealtimeError: If a setting is refused and the mode is "enforce".
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
    refusals = []
    with ExitStack() as back:
        for name, step in steps:
            try:
                back.callback(step())
            except (AttributeError, TypeError):  # not available on this system
                refusals.append(f"{name}: {os.strerror(errno.ENOSYS)}")
            except (OSError, ValueError, OverflowError) as error:
                refusals.append(f"{name}: {getattr(error, 'strerror', None) or error}")
        if refusals and mode == "enforce":
            raise RealtimeError(f"real-time settings refused: {'; '.join(refusals)}; see `ulimit -r` and `ulimit -l`")
        back.callback(_no_garbage())
        yield refusals


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
        if not frozen:  # unfreeze would also thaw what the program froze itself
            gc.unfreeze()
        if enabled:
            gc.enable()

    return back


_HANGUP, _ALARM = getattr(signal, "SIGHUP", None), getattr(signal, "SIGALRM", None)  # POSIX only


def interrupt() -> NoReturn:
    """Raise KeyboardInterrupt."""
    raise KeyboardInterrupt


@contextmanager
def stopping(
    stop: Callable[[], object], cut: Callable[[], object] = interrupt, *, within: float | None = None
) -> Iterator[None]:
    """Call `stop` at the first stop signal, and `cut` at each later SIGINT.

    Stop signals are SIGINT, SIGTERM and SIGHUP. Later SIGTERM and SIGHUP are ignored: SIGTERM may be sent twice, and a
    closing terminal adds a SIGHUP.

    Args:
        stop: Called in the main thread between any two bytecodes; may raise.
        cut: Called in the main thread; may raise.
        within: Time after `stop` at which `cut` is called as well [s]; None for never.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread receives signals
        return
    stopped = False

    def handle(kind: int, _frame: Any) -> None:
        nonlocal stopped
        if stopped:
            if kind in (signal.SIGINT, _ALARM):
                cut()
            return
        stopped = True
        if within is not None and _ALARM is not None:
            signal.setitimer(signal.ITIMER_REAL, within)
        stop()

    kinds = [signal.SIGINT, signal.SIGTERM, *([] if _ALARM is None else [_ALARM])]
    if _HANGUP is not None and signal.getsignal(_HANGUP) != signal.SIG_IGN:  # stays ignored under nohup
        kinds.append(_HANGUP)
    before = [(kind, signal.signal(kind, handle)) for kind in kinds]
    try:
        yield
    finally:
        if within is not None and _ALARM is not None:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for kind, handler in before:
            signal.signal(kind, handler)
