"""Real-time pacing of frames, control ticks and messages."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence

from maglev_mj.parameters import number

TIME_SCALES = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Steps of slow motion."""

_ROUNDING = 1e-9
_LONGEST_PAUSE = 1.0
_SHOWN = 6.0


def real_time(
    duration: float | None, step: float, clock: Callable[[], float] = time.perf_counter
) -> Iterator[tuple[float, float]]:
    """Yield real time since the last and first turn [s].

    It sleeps between turns.

    Args:
        duration: Total time [s]; None for no end.
        step: Sleep after each turn [s].
        clock: Clock of real time [s].

    Example:
        >>> from maglev_mj import real_time
        >>> passed = sum(elapsed for elapsed, now in real_time(0.004, step=0.001))
        >>> passed > 0.0
        True
    """
    start = last = clock()
    while duration is None or last - start < duration:
        now = clock()
        yield min(now - last, _LONGEST_PAUSE), now - start  # a machine that was suspended owes no more
        last = now
        time.sleep(step)


def next_scale(scale: float, action: str, scales: Sequence[float] = TIME_SCALES) -> float:
    """Return the next time scale for "slower" or "faster".

    Args:
        scale: Present simulated time per second of real time.
        action: "slower" or "faster".
        scales: Available scales in rising order.
    """
    place = bisect_right(scales, scale) if action == "faster" else bisect_left(scales, scale) - 1
    return scales[min(max(place, 0), len(scales) - 1)]


class Due:
    """Frame clock on a fixed time grid.

    A late call does not shift the grid.

    Args:
        period: Time between frames [s].
        clock: Clock of real time [s].
    """

    def __init__(self, period: float = 1.0 / 60.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._period, self._clock, self._next = period, clock, -1.0

    def __call__(self) -> bool:
        """Return True once for each frame that is due."""
        if (now := self._clock()) < self._next:
            return False
        soon = self._next + self._period
        self._next = soon if now < soon else now + self._period
        return True


class Pacer:
    """Scheduler of control ticks in real time, within a budget.

    Ticks beyond the budget follow in later frames. A delay of more than `patience` is given up:
    simulated time then slows down, and the ticks count as missed.

    Args:
        budget: Largest real time of the ticks of one frame [s].
        patience: Largest delay of simulated time [s].
        clock: Clock of real time [s].

    Attributes:
        owed: Real time not simulated yet [s].
        missed: Ticks given up so far.
        late: True if ticks were given up in the last frame.
        cost: Real time of one tick in the last frame that had any [s].
    """

    def __init__(
        self, *, budget: float = 0.012, patience: float = 0.5, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self.budget = number("budget", budget, above=0.0)
        self.patience = number("patience", patience, at_least=0.0)
        self._clock = clock
        self.owed, self.missed, self.late, self.cost = 0.0, 0, False, 0.0

    def advance(self, elapsed: float, period: float, tick: Callable[[], object]) -> int:
        """Run the ticks that are due.

        Args:
            elapsed: Real time since the last call [s].
            period: Sample period [s].
            tick: Function that runs one tick.

        Returns:
            Number of ticks.
        """
        self.owed += elapsed
        start, ticks = self._clock(), 0
        least = period * (1.0 - _ROUNDING)
        while self.owed >= least:
            tick()
            ticks += 1
            self.owed -= period
            if self._clock() - start >= self.budget:
                break
        if ticks:
            self.cost = (self._clock() - start) / ticks
        beyond = int((self.owed - self.patience) / period + _ROUNDING)
        self.late = beyond > 0
        if self.late:
            self.missed += beyond
            self.owed -= beyond * period
        return ticks

    def forgive(self) -> None:
        """Reset the owed time, as after a pause."""
        self.owed, self.late = 0.0, False


class Note:
    """Message shown for some seconds.

    Args:
        clock: Clock of real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._text, self._until = clock, "", 0.0

    def say(self, text: str) -> None:
        """Show a message in place of the last."""
        self._text, self._until = text, self._clock() + _SHOWN

    @property
    def lines(self) -> list[str]:
        """Message in a list, empty after its time."""
        return [self._text] if self._text and self._clock() < self._until else []
