"""A device's samples counted on the host: their numbers, what is missing, and whether the device's clock keeps step."""

from __future__ import annotations

__all__ = ["SampleCounter"]

_WRAP = 0xFFFFFFFF


class SampleCounter:
    """Counts samples by the numbers that the device gives them.

    Args:
        period: Sample period [ns].

    Attributes:
        period: Sample period [ns].
        tick: Of the last sample, from 0 at the first that came.
        elapsed: Samples from the one before to the last.
        lost: Samples that did not arrive.
        skipped: Samples that nobody answered because a newer one was there.
    """

    def __init__(self, period: int) -> None:
        self.tick, self.elapsed, self.lost, self.skipped = -1, 0, 0, 0
        self.period, self._sequence, self._time = period, 0, 0

    def count(self, sequence: int, time: int, skipped: int) -> str:
        """Count a sample; return what is wrong with the device's clock, nothing where it keeps step.

        Args:
            sequence: Its number.
            time: Of the device's clock [ns].
            skipped: Older samples that came with it.
        """
        said = ""
        if self.tick < 0:
            self.tick = 0
        else:
            self.elapsed = (sequence - self._sequence) & _WRAP
            passed = time - self._time
            if abs(passed - self.elapsed * self.period) > self.period // 2:
                said = f"{passed * 1e-6:.3f} ms went by in {self.elapsed} samples of {self.period * 1e-6:.3f} ms"
            self.tick += self.elapsed
            missing = self.elapsed - 1
            if missing:
                self.skipped += min(skipped, missing)
                self.lost += missing - min(skipped, missing)
        self._sequence, self._time = sequence, time
        return said
