"""Running totals of a recording: energy, work and missed samples, from its samples alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from maglev_mj.energy import HandWork, PassivityObserver
from maglev_mj.frames import Command, Sample
from maglev_mj.recording.metadata import RunMetadata
from maglev_mj.timeline import Timing

__all__ = ["Totals"]


class Totals:
    """Adds up what the rendered world takes in, what the hand does, and what is missing, from sample to sample.

    Args:
        metadata: What a stretch is, besides its samples.
    """

    def __init__(self, metadata: RunMetadata) -> None:
        timing = Timing(period=metadata.period, delay=metadata.delay)
        self._carried = metadata.carried
        load, before = self._carried + metadata.load, metadata.before - self._carried
        self._observer = PassivityObserver(timing, metadata.inertia, load, before)
        self._hand, self._missed = HandWork(), 0
        self._tick: float | None = None

    def miss(self, count: int) -> None:
        """Count samples that were missed, other than by a gap in the ticks."""
        self._missed += count

    def add(self, row: Mapping[str, Any]) -> tuple[float, float, int]:
        """Return the totals at a sample, given by name: energy taken [J], work of the hand [J], samples missed."""
        force, width = np.array(row["applied"]) - self._carried, row["applied_pulse_width"]
        command = Command(force.tolist(), row["applied_pulse"], width) if width else Command(force.tolist())
        self._observer(Sample(int(row["tick"]), row["time"], row["position"]), command)
        self._hand.add(np.array(row["position"]), row["hand"])
        if self._tick is not None:  # a device counts on from stretch to stretch
            self._missed += max(int(row["tick"] - self._tick) - 1, 0)
        self._tick = row["tick"]
        return float(self._observer.energy.sum()), self._hand.total, self._missed
