"""Clock of the walls of a twin: samples between two samples of the host, and the currents that follow them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from maglev_mj.control.timeline import Interval, Timeline


class WallClock:
    """Periods of a simulated device whose firmware renders walls.

    Without walls the intervals of a period are those of the timeline.

    Args:
        timeline: Drives of the host's currents.
        step: Sample period of the walls [s], a whole fraction of the host's.
        delay: Delay of the walls' currents [s].
        sample: Function that samples the walls at a time after the last sample [s], and calls `add`.
        walled: Function that returns True while there are walls.
        drive_of: Function from a drive and currents of walls to the drive of both.

    Attributes:
        drive: Drive in effect.
        intervals: Intervals of the last period.
        measure: None; the sensor is the twin's.
    """

    measure = None

    def __init__(
        self,
        timeline: Timeline,
        step: float,
        delay: float,
        sample: Callable[[float], None],
        walled: Callable[[], bool],
        drive_of: Callable[[Any, Sequence[float]], Any],
    ) -> None:
        self._timeline, self._step, self._delay = timeline, step, delay
        self._sample, self._walled, self._drive_of = sample, walled, drive_of
        self._period = timeline.timing.period
        self._least = 1e-6 * self._period
        self._extra: Sequence[float] | None = None  # currents in effect
        self._waiting: deque[tuple[float, Sequence[float]]] = deque()
        self._done, self._next = 0.0, 0  # time of the motion after the last sample [s]; next wall sample
        self.drive, self.intervals = timeline.now(), list[Interval]()

    @property
    def busy(self) -> bool:
        """True while there are walls or their currents."""
        return self._walled() or self._extra is not None or bool(self._waiting)

    def add(self, at: float, currents: Sequence[float]) -> None:
        """Queue currents of walls, sampled at a time after the last sample [s]."""
        self._waiting.append((at + self._delay, currents))

    def cut(self) -> None:
        """Remove the currents of walls."""
        self._extra = None
        self._waiting.clear()

    def period(self, tick: int, answer: tuple[Any, Any, float] | None = None) -> Iterator[Interval]:
        """Yield the rest of a period's intervals; advance the plant between them."""
        yield from self.until(tick, self._period)
        self._waiting = deque((at - self._period, currents) for at, currents in self._waiting)
        self._done, self._next = 0.0, 0

    def until(self, tick: int, end: float) -> Iterator[Interval]:
        """Yield the intervals up to a time after sample `tick` [s]."""
        if self._done == 0.0:
            self.intervals = []
        while self._done < end - self._least:
            following = end
            if self._walled():
                self._next = max(self._next, int((self._done - self._least) // self._step) + 1)
                if self._next * self._step <= self._done + self._least:
                    self._sample(self._next * self._step)
                    self._next += 1
                following = min(following, self._next * self._step)
            while self._waiting and self._waiting[0][0] <= self._done + self._least:
                self._extra = self._waiting.popleft()[1]
                self._extra = self._extra if any(self._extra) else None
            if self._waiting:
                following = min(following, self._waiting[0][0])
            whole = self._done == 0.0 and following == self._period
            part: dict[str, Any] = {} if whole else {"begin": self._done, "until": following}
            for duration, drive in self._timeline.period(tick, **part):
                self.drive = drive if self._extra is None else self._drive_of(drive, self._extra)
                self.intervals.append((duration, self.drive))
                yield duration, self.drive
            self._done = following
        self.drive = self._timeline.now()
        if self._extra is not None:
            self.drive = self._drive_of(self.drive, self._extra)
