"""Probe of a control law in C, run as a script in a process of its own: a crash or endless loop ends that alone.

Usage: probe.py LIBRARY SYMBOL BYTES SECONDS, with the gains as JSON on standard input: a list for each axis and device.
It prints `ANSWER` and the first fault, or nothing after it. This file imports nothing of the package.
"""

from __future__ import annotations

import ctypes
import json
import math
import random
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any

ANSWER = "maglev-mj probe:"
"""Start of the answer; the law itself may print, too."""

_SAMPLES = 5000
"""Samples of the probe, shared by the rows of gains, with at least `_LEAST_SAMPLES` each."""
_LEAST_SAMPLES = 50
_GUARD = 64
"""Bytes on both sides of the memory, which the law must not change, and which differ between devices."""
_BEYOND = 8
"""Numbers on both sides of the gains, all NaN: a law that reads them returns NaN."""
_EXTREMES = (0.0, -0.0, 5e-324, -5e-324, 1e3, -1e3)
"""Positions, and with a factor 1000 speeds, at which a law must not crash [m, m/s]; its force is not checked there."""


def function_of(library: str, symbol: str) -> Callable[..., None]:
    """Return a law's function of a shared library.

    Raises:
        OSError: If the library cannot be loaded.
        AttributeError: If it has no such function.
    """
    # PyDLL keeps the interpreter's lock, which takes longer to pass on than a law takes to run
    function: Any = getattr(ctypes.PyDLL(library), symbol)
    function.argtypes = ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p
    function.restype = None
    return function  # type: ignore[no-any-return]


class _Device:
    """Device with its own gains and memory, each between guards."""

    def __init__(self, function: Callable[..., None], gains: Sequence[float], size: int, around: int) -> None:
        self._function, self._size = function, size
        self._guard = bytes([around]) * _GUARD
        beyond = [math.nan] * _BEYOND
        self._gains = (ctypes.c_double * (len(gains) + 2 * _BEYOND))(*beyond, *gains, *beyond)
        self._memory = ctypes.create_string_buffer(self._guard + bytes(size) + self._guard, size + 2 * _GUARD)
        self._force = (ctypes.c_double * 3)()
        self._before = bytes(self._gains)

    def __call__(self, x: float, v: float) -> float:
        """Return the force at the next sample; NaN if the law sets none."""
        self._force[:] = [1.0, math.nan, 1.0]
        gains, memory = ctypes.addressof(self._gains) + 8 * _BEYOND, ctypes.addressof(self._memory) + _GUARD
        self._function(x, v, gains, memory, ctypes.addressof(self._force) + 8)
        return self._force[1]

    def fault(self) -> str:
        """Return what the law has written outside its memory and force; empty for nothing."""
        memory = self._memory.raw
        if memory[:_GUARD] != self._guard or memory[_GUARD + self._size :] != self._guard:
            return f"writes outside its memory of {self._size} bytes"
        if bytes(self._gains) != self._before:
            return "writes to its gains"
        return "" if self._force[0] == self._force[2] == 1.0 else "writes beside its force"


def _path(seed: int, samples: int) -> list[tuple[float, float]]:
    """Return positions [m] and speeds [m/s] of any size to both sides, some held, some zero."""
    draw, path = random.Random(seed), list[tuple[float, float]]()
    while len(path) < samples:
        x, v = (draw.choice((-1.0, 1.0)) * 10.0 ** draw.uniform(*sizes) for sizes in ((-7.0, -1.0), (-5.0, 0.5)))
        path += [(x, v), *draw.choice(([], [], [(0.0, 0.0)], [(x, 0.0)] * 5))]
    return path[:samples]


def fault(function: Callable[..., None], size: int, rows: Sequence[Sequence[float]]) -> str:
    """Return the first fault of a law; empty for none.

    Args:
        function: The law.
        size: Size of its memory [bytes].
        rows: Gains of each axis and device.
    """
    samples = max(_SAMPLES // len(rows), _LEAST_SAMPLES)
    for row in rows:
        alone, beside, other = (_Device(function, row, size, around) for around in (0xA5, 0, 0))
        path, forces = _path(1, samples), list[float]()
        for x, v in path:
            forces.append(alone(x, v))
            if reason := alone.fault():
                return reason
            if not math.isfinite(forces[-1]):
                beyond = f"; it has {len(row)} gains, and what it reads beyond is NaN" * math.isnan(forces[-1])
                return f"sets no finite force at x = {x!r}, v = {v!r} (got {forces[-1]}){beyond}"
        # two devices in turn, as in a batch
        differs = False
        for (x, v), elsewhere, force in zip(path, _path(2, samples), forces):
            differs |= beside(x, v) != force
            other(*elsewhere)
        for x in _EXTREMES:
            for v in _EXTREMES:
                other(x, 1e3 * v)
        if reason := beside.fault() or other.fault():
            return reason
        if differs:
            return f"returns another force for equal samples: it keeps values outside its memory of {size} bytes"
    return ""


def _main(library: str, symbol: str, size: str, seconds: str) -> str:
    rows = json.load(sys.stdin)
    if hasattr(signal, "setitimer"):  # processor time: a busy machine ends no law
        signal.setitimer(signal.ITIMER_PROF, float(seconds))
    try:
        function = function_of(library, symbol)
    except OSError as error:
        return f"cannot be loaded: {error}"
    except AttributeError:
        return "is not in the library: declare it without static"
    return fault(function, int(size), rows)


if __name__ == "__main__":
    print(ANSWER, _main(*sys.argv[1:]), flush=True)
