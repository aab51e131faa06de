"""Running totals of a recording: energy, work and missed samples, from its samples alone."""

from __future__ import annotations

import numpy as np

from maglev_mj.energy import HandWork, PassivityObserver
from maglev_mj.frames import Command, Sample
from maglev_mj.recording.ring import Row
from maglev_mj.recording.stretch import Basis
from maglev_mj.timeline import Timing

__all__ = ["Totals"]


class Totals:
    """Adds up what the rendered world takes in, what the hand does, and what is missing, from sample to sample.

    Args:
        basis: What a stretch is, besides its samples.
    """

    def __init__(self, basis: Basis) -> None:
        timing = Timing(period=basis.period, delay=basis.delay)
        self._carried = np.array(basis.carried)
        load, before = self._carried + np.array(basis.load), np.array(basis.before) - self._carried
        self._observer = PassivityObserver(timing, basis.inertia, load, before)
        self._hand, self._missed = HandWork(), 0
        self._tick: float | None = None

    def miss(self, count: int) -> None:
        """Count samples that were missed, other than by a gap in the ticks."""
        self._missed += count

    def add(self, row: Row) -> tuple[float, float, int]:
        """Return the totals at a sample: energy taken [J], work of the hand [J], samples missed."""
        force = np.array(row[21:27]) - self._carried
        command = Command(force.tolist(), row[27:33], row[33]) if row[33] else Command(force.tolist())
        self._observer(Sample(int(row[0]), row[1], row[2:8]), command)
        self._hand.add(np.array(row[2:8]), row[34:40])
        if self._tick is not None:  # a device counts on from stretch to stretch
            self._missed += max(int(row[0] - self._tick) - 1, 0)
        self._tick = row[0]
        return float(self._observer.energy.sum()), self._hand.total, self._missed
