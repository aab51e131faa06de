"""Real time: when a frame is due, how many control ticks fit in a budget, and how long a note is shown."""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence

from maglev_mj.parameters import number

__all__ = ["TIME_SCALES", "Due", "Note", "Pacer", "next_scale", "real_time"]

TIME_SCALES = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Steps of slow motion."""

_ROUNDING = 1e-9
_LONGEST_PAUSE = 1.0
_SHOWN = 6.0


def real_time(
    duration: float | None, step: float, clock: Callable[[], float] = time.perf_counter
) -> Iterator[tuple[float, float]]:
    """Yield the real time that has gone by since the last turn and since the first [s], sleeping in between.

    Args:
        duration: For how long [s]; None for as long as the caller goes on.
        step: How long to sleep after each turn [s].
        clock: Returns real time [s].
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
        scale: Simulated time for each second of real time now.
        action: One of the two.
        scales: Those there are, in rising order.
    """
    place = bisect_right(scales, scale) if action == "faster" else bisect_left(scales, scale) - 1
    return scales[min(max(place, 0), len(scales) - 1)]


class Due:
    """Tell when a frame is due, on a grid from which a late call does not drift away.

    Args:
        period: From one frame to the next [s].
        clock: Returns real time [s].
    """

    def __init__(self, period: float = 1.0 / 60.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._period, self._clock, self._next = period, clock, -1.0

    def __call__(self) -> bool:
        """Return whether a frame is due, once for each."""
        if (now := self._clock()) < self._next:
            return False
        soon = self._next + self._period
        self._next = soon if now < soon else now + self._period
        return True


class Pacer:
    """Makes as many control ticks as real time has gone by, later ones in the next frame where the budget is spent.

    A machine that stalls catches up from frame to frame. What it is behind by more than `patience` is given up:
    simulated time then slows down, and the ticks are counted as missed.

    Args:
        budget: Real time that the ticks of one frame may take [s].
        patience: How far simulated time may be behind [s].
        clock: Returns real time [s].

    Attributes:
        owed: Real time that has not been simulated yet [s].
        missed: Ticks given up so far.
        late: Whether ticks were given up in the last frame.
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
        """Make the ticks that are due.

        Args:
            elapsed: Real time since the last call [s].
            period: Sample period [s].
            tick: Makes one tick.

        Returns:
            How many were made.
        """
        self.owed += elapsed
        start, made = self._clock(), 0
        least = period * (1.0 - _ROUNDING)
        while self.owed >= least:
            tick()
            made += 1
            self.owed -= period
            if self._clock() - start >= self.budget:
                break
        if made:
            self.cost = (self._clock() - start) / made
        beyond = int((self.owed - self.patience) / period + _ROUNDING)
        self.late = beyond > 0
        if self.late:
            self.missed += beyond
            self.owed -= beyond * period
        return made

    def forgive(self) -> None:
        """Forget what is owed: after a pause, or where nothing can be made."""
        self.owed, self.late = 0.0, False


class Note:
    """Hold one line for the person, for some seconds.

    Args:
        clock: Returns real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._text, self._until = clock, "", 0.0

    def say(self, text: str) -> None:
        """Show a line in place of the last."""
        self._text, self._until = text, self._clock() + _SHOWN

    @property
    def lines(self) -> list[str]:
        """The line, while it is to be shown."""
        return [self._text] if self._text and self._clock() < self._until else []
