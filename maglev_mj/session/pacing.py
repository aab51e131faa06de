"""Real-time pacing of frames and control ticks, and timed messages."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence

from maglev_mj.keywords import checked
from maglev_mj.parameters import number

TIME_SCALES = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Time scales of slow motion."""

_ROUNDING = 1e-9
_LONGEST_PAUSE = 1.0
_NOTE_DURATION = 6.0


@checked
def real_time(
    duration: float | None, step: float, clock: Callable[[], float] = time.perf_counter
) -> Iterator[tuple[float, float]]:
    """Yield the real time since the previous turn and since the first one [s]; sleep between turns.

    Args:
        duration: Total time [s]; None for indefinitely.
        step: Sleep after each turn [s].
        clock: Real-time clock [s].

    Example:
        >>> from maglev_mj import real_time
        >>> passed = sum(elapsed for elapsed, now in real_time(0.004, step=0.001))
        >>> passed > 0.0
        True
    """
    number("step", step, at_least=0.0)
    start = last = clock()
    while duration is None or last - start < duration:
        now = clock()
        yield min(now - last, _LONGEST_PAUSE), now - start  # do not catch up after the machine was suspended
        last = now
        time.sleep(step)


def next_scale(scale: float, action: str, scales: Sequence[float] = TIME_SCALES) -> float:
    """Return the next time scale for "slower" or "faster".

    Args:
        scale: Current time scale, simulated over real time.
        action: "slower" or "faster".
        scales: Available scales in ascending order.
    """
    index = bisect_right(scales, scale) if action == "faster" else bisect_left(scales, scale) - 1
    return scales[min(max(index, 0), len(scales) - 1)]


class FrameClock:
    """Frame clock on a fixed time grid; delayed calls do not shift the grid.

    Args:
        period: Frame period [s].
        clock: Real-time clock [s].
    """

    def __init__(self, period: float = 1.0 / 60.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._period, self._clock, self._next = number("period", period, above=0.0), clock, -1.0

    def __call__(self) -> bool:
        """Return True once for each frame that is due."""
        if (now := self._clock()) < self._next:
            return False
        upcoming = self._next + self._period
        self._next = upcoming if now < upcoming else now + self._period
        return True


class Pacer:
    """Scheduler of control ticks in real time, within a computing budget.

    Ticks that exceed the budget are run in later frames. A backlog above `patience` is dropped: these ticks are
    skipped, and simulated time runs slower than real time.

    Args:
        budget: Largest computing time of the ticks of one frame [s].
        patience: Largest backlog of simulated time [s].
        clock: Real-time clock [s].

    Attributes:
        backlog: Real time not simulated yet [s].
        missed: Total number of skipped ticks.
        overloaded: True if ticks were skipped in the last frame.
        cost: Computing time per tick in the last frame with ticks [s].
    """

    def __init__(
        self, *, budget: float = 0.012, patience: float = 0.5, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self.budget = number("budget", budget, above=0.0)
        self.patience = number("patience", patience, at_least=0.0)
        self._clock = clock
        self.backlog, self.missed, self.overloaded, self.cost = 0.0, 0, False, 0.0

    def advance(self, elapsed: float, period: float, tick: Callable[[], object]) -> int:
        """Run the ticks that are due.

        Args:
            elapsed: Real time since the last call [s].
            period: Sample period [s].
            tick: Function that runs one tick.

        Returns:
            Number of ticks run.
        """
        self.backlog += elapsed
        start, ticks = self._clock(), 0
        threshold = period * (1.0 - _ROUNDING)
        while self.backlog >= threshold:
            tick()
            ticks += 1
            self.backlog -= period
            if self._clock() - start >= self.budget:
                break
        if ticks:
            self.cost = (self._clock() - start) / ticks
        skipped = int((self.backlog - self.patience) / period + _ROUNDING)
        self.overloaded = skipped > 0
        if self.overloaded:
            self.missed += skipped
            self.backlog -= skipped * period
        return ticks

    def clear_backlog(self) -> None:
        """Clear the backlog, for example after a pause."""
        self.backlog, self.overloaded = 0.0, False


class Note:
    """Message shown for a few seconds.

    Args:
        clock: Real-time clock [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._text, self._until = clock, "", 0.0

    def say(self, text: str) -> None:
        """Show a message, replacing the previous one."""
        self._text, self._until = text, self._clock() + _NOTE_DURATION

    def clear(self) -> None:
        """Remove the message."""
        self._text = ""

    @property
    def lines(self) -> list[str]:
        """The message in a list; empty when it has expired."""
        return [self._text] if self._text and self._clock() < self._until else []
