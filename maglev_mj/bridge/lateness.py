"""How late a loop was, and a picture of it for a terminal."""

from __future__ import annotations

import math

import numpy as np

from maglev_mj.parameters import number

__all__ = ["Lateness"]

_BAR = 44  # characters
_EIGHTHS = " ▏▎▍▌▋▊▉"
_EDGES = [step * 10**power for power in range(3, 10) for step in (1, 2, 5)]  # [ns], 1 µs to 5 s


class Lateness:
    """How late a loop was: the last ones, and the worst of all.

    Args:
        size: How many to keep, at least 1.

    Attributes:
        count: How many there were.
        worst: Greatest of all [ns].

    Raises:
        ParameterError: If the size is less.
    """

    def __init__(self, size: int = 1 << 16) -> None:
        self._ring = np.zeros(int(number("size", size, at_least=1)), np.int64)
        self._size = len(self._ring)
        self.count = 0
        self.worst = 0

    def add(self, lateness: int) -> None:
        """Take one more in [ns]."""
        self._ring[self.count % self._size] = lateness
        self.count += 1
        if lateness > self.worst:
            self.worst = lateness

    def percentile(self, share: float) -> float:
        """Return what `share` percent of those kept are below [s]; NaN for none."""
        kept = self._ring[: self.count]
        return float(np.percentile(kept, share)) * 1e-9 if len(kept) else math.nan

    @property
    def p50(self) -> float:
        """Median of those kept [s]."""
        return self.percentile(50.0)

    @property
    def p99(self) -> float:
        """What 99 of 100 of those kept are below [s]."""
        return self.percentile(99.0)

    @property
    def max(self) -> float:
        """Greatest of all [s]."""
        return self.worst * 1e-9 if self.count else math.nan

    def histogram(self) -> str:
        """Return those kept as bars, a line for each bin, within 80 columns."""
        if not self.count:
            return "lateness: none yet"
        kept = self._ring[: self.count]
        bins = np.bincount(np.searchsorted(_EDGES, kept, side="right"), minlength=len(_EDGES) + 1)
        used = np.flatnonzero(bins)
        which = self.count if self.count <= self._size else f"the last {self._size} of {self.count}"
        lines = [f"lateness of {which}: p50 {_span(self.p50)}, p99 {_span(self.p99)}, max {_span(self.max)}"]
        for index in range(used[0], used[-1] + 1):
            lines.append(f"{_label(index)}  {_bar(bins[index] / bins.max()):<{_BAR}} {bins[index]:>9}")
        return "\n".join(line.rstrip() for line in lines)


def _span(duration: float) -> str:
    """Return a duration [s] for a person."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if duration >= 0.9995 * size:  # which is written as 1
            return f"{duration / size:.3g} {unit}"
    return f"{duration * 1e6:.3g} µs"


def _label(index: int) -> str:
    """Return the bounds of a bin, 18 characters."""
    if index == 0:
        return f"{'below':>8} {_span(_EDGES[0] * 1e-9):<9}"
    low = _span(_EDGES[index - 1] * 1e-9)
    if index == len(_EDGES):
        return f"{'above':>8} {low:<9}"
    return f"{low:>7} to {_span(_EDGES[index] * 1e-9):<7}"


def _bar(share: float) -> str:
    """Return a bar; nothing is none, and little is still seen."""
    eighths = max(round(share * _BAR * 8), 1) if share > 0.0 else 0
    return "█" * (eighths // 8) + _EIGHTHS[eighths % 8].strip()
