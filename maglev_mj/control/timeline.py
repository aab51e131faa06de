"""Clock of samples and commands.

It defines the sampling instants and the acting command at any time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component
from maglev_mj.parameters import number, numbers, store, whole
from maglev_mj.spec import Spec

Interval: TypeAlias = tuple[Any, Any]
"""Duration [s] and acting drive.

The drive is in the form of the given commands.
"""

MOST_PERIODS = 10_000
"""Longest delay, in sample periods."""

_ROUNDING = 1e-9
"""Share of a period that counts as rounding error."""


_BLOCK = 256


@lru_cache(maxsize=64)
def _draws(seed: int, block: int) -> tuple[float, ...]:
    """Return random numbers for a block of ticks.

    They are uniform between -1 and 1.

    They depend on seed and tick alone, so that the order of calls does not matter.
    """
    return tuple(np.random.default_rng((seed, block)).uniform(-1.0, 1.0, _BLOCK).tolist())


def split_delay(delay: Component, period: Component) -> tuple[Component, Component]:
    """Split a delay into whole periods and rest [s].

    (...,) each.

    A delay within rounding of a whole number of periods counts as that number.

    Args:
        delay: Delay [s], 0 or more, (...,).
        period: Sample period [s], above 0, (...,).
    """
    whole = (delay / period + _ROUNDING) // 1.0
    rest = delay - whole * period
    return whole, rest * (rest > _ROUNDING * period)


def checked_delay(delay: float, period: float) -> tuple[int, float]:
    """Return whole periods and rest [s] of a checked delay."""
    whole, rest = split_delay(number("delay", delay, at_least=0.0, at_most=MOST_PERIODS * period), period)
    return int(whole), rest


@dataclass(frozen=True, kw_only=True, eq=False)
class Timing:
    """Times of samples and command effects, in whole ticks.

    Sample k is taken at (k + phase) period after release; its command takes effect `delay` later.

    Args:
        period: Sample period [s], above 0.
        delay: Transport delay [s], 0 or more; may exceed the period, up to 10 000 times. (N,) for N different
            devices, all with the same number of whole periods.
        phase: Phase of the samples in [0, 1); (N,) for N different devices.
        jitter: Half range of a uniform random delay, delay ± jitter [s], the same for a whole batch. Commands must
            stay in order and in their period.
        seed: Seed of the jitter: the same seed gives the same run.

    Raises:
        ParameterError: If a value is outside its bounds.

    Example:
        >>> from maglev_mj import ExactPlant, Timing
        >>> with ExactPlant(Timing(period=0.001, phase=0.5)) as plant:
        ...     first = plant.read()
        >>> first.time  # half a period after release
        0.0005
    """

    period: float = 1.0 / Spec.control_rate.value
    delay: Component = Spec.transport_delay.value
    phase: Component = 0.0
    jitter: float = 0.0
    seed: int = 0
    whole: int = field(init=False)
    """Whole periods in the delay."""
    rest: Component = field(init=False)
    """Rest of the delay [s], in [0, period)."""
    negligible: float = field(init=False)
    """Longest time that counts as rounding error [s]."""

    def __post_init__(self) -> None:
        period = number("period", self.period, above=0.0)
        delay = np.asarray((numbers if np.ndim(self.delay) else number)("delay", self.delay, at_least=0.0))
        phase = numbers("phase", self.phase, at_least=0.0)
        if not (phase < 1.0).all():
            raise ParameterError(f"phase must be at least 0 and below 1, not {float(phase.max()):g}")
        if (delay / period > MOST_PERIODS).any():
            raise ParameterError(
                f"delay must be at most {MOST_PERIODS} periods of {period:g} s, not {float(delay.max()):g} s"
            )
        wholes, rest = map(np.asarray, split_delay(delay, period))
        if np.ptp(wholes):
            raise ParameterError(
                f"delay must have the same whole periods of {period:g} s for all devices, not "
                f"{float(delay.min()):g} to {float(delay.max()):g} s"
            )
        jitter = number("jitter", self.jitter, at_least=0.0)
        room = float(np.minimum(rest, period - rest).min())
        if jitter > room:
            raise ParameterError(f"jitter must be at most {room:g} s at this delay and period, not {jitter:g}")
        parts = {"delay": delay, "phase": phase, "rest": rest}
        store(self, **{name: part if part.ndim else float(part) for name, part in parts.items()})
        store(self, period=period, jitter=jitter, seed=whole("seed", self.seed))
        store(self, whole=int(wholes.flat[0]), negligible=_ROUNDING * period)

    def rest_at(self, tick: int) -> Component:
        """Return the rest of a delay [s].

        It remains after whole periods, for the command that takes effect after `tick`.
        """
        if self.jitter == 0.0:
            return self.rest
        return self.rest + self.jitter * _draws(self.seed, tick // _BLOCK)[tick % _BLOCK]

    def time(self, tick: int, offset: Component = 0.0) -> Any:
        """Return the time [s] of `offset` after sample `tick`.

        It is computed directly, not as a running sum.
        """
        return (tick + self.phase) * self.period + offset


class Timeline:
    """Delayed commands and their times of effect.

    A command is a drive held until the next one takes effect, and may begin with a pulse: another drive for its first
    seconds. The next command ends a pulse; without one it runs out. Drives may be of any type: wrenches, currents, or
    values prepared by a plant.

    Args:
        timing: Sample period and delay.
        acting: The drive until the first command takes effect.
        compares: See below.

    Attributes:
        acting: The drive since the last switch.
        compares: True if drives are tuples, and drives with equal first parts are the same: there is no switch between
            them. It may be changed from period to period.
    """

    def __init__(self, timing: Timing, acting: Any, *, compares: bool = False) -> None:
        self.acting, self.compares, self.timing = acting, compares, timing
        # when, in ticks and seconds after one, to which drive, and that of a pulse ahead of it with its width
        self._switches: deque[tuple[int, Any, Any, Any, float]] = deque()
        self._pulse: tuple[Any, Any] | None = None
        self._period, self._rest, self._whole = timing.period, timing.rest, timing.whole
        self._negligible, self._jitters = timing.negligible, timing.jitter > 0.0
        self._each = np.ndim(timing.delay) > 0
        # one switch within the period, or at the sample
        self._at_once = not self._each and timing.rest == 0.0
        room = np.minimum(timing.rest, timing.period - timing.rest) - timing.jitter
        self._plain = timing.whole == 0 and (self._each or self._at_once or float(room) > self._negligible)

    def answer(
        self, tick: int, held: Any, pulsed: Any = None, width: float = 0.0, *, after: float | None = None
    ) -> None:
        """Add the answer to a sample.

        Commands with effect at the same time or later are cancelled.

        Args:
            tick: Number of the sample.
            held: The drive.
            pulsed: The drive in place of it for the first `width` seconds.
            width: Duration of the pulse [s]; 0 for no pulse.
            after: Time of effect since the sample [s]; the timing's delay by default.
        """
        if after is None:
            tick += self._whole
            offset = self.timing.rest_at(tick) if self._jitters else self._rest
        else:
            whole, offset = split_delay(after, self._period)
            tick += int(whole)
        switches = self._switches
        while switches and switches[-1][0] >= tick and (switches[-1][0] > tick or np.all(switches[-1][1] >= offset)):
            switches.pop()
        switches.append((tick, offset, held, pulsed, width))

    def period(
        self, tick: int, answer: tuple[Any, Any, float] | None = None, *, after: float | None = None
    ) -> list[Interval]:
        """Return the intervals from sample `tick` to the next.

        They are in order; their durations add up to the period.

        With delays (N,) durations are (N,), and an interval missing on a device has duration 0.

        Args:
            tick: Number of the sample.
            answer: The answer to it as for `answer`: held, pulsed, width; None if it was added by `answer`, or there
                is none.
            after: Its time of effect, as for `answer`; for one device.
        """
        switches = self._switches
        if answer is not None:
            held, pulsed, width = answer
            plain = self._plain if after is None else self._negligible < after < self._period - self._negligible
            if plain and width == 0.0 and self._pulse is None and not switches:  # most periods, at half the cost
                before = self.acting
                if self.compares and held[0] == before[0]:
                    return [(self._period, before)]
                self.acting = held
                if after is None:
                    if self._at_once:
                        return [(self._period, held)]
                    after = self.timing.rest_at(tick) if self._jitters else self._rest
                return [(after, before), (self._period - after, held)]
            self.answer(tick, held, pulsed, width, after=after)
        intervals: list[Interval] = []
        done, each, least = 0.0, self._each, self._negligible
        while switches and switches[0][0] <= tick:
            _, offset, held, pulsed, width = switches.popleft()
            duration = offset - done
            if self._pulse is not None:
                duration = self._add_pulse(duration, intervals)
            elif width == 0.0 and self.compares and held[0] == self.acting[0]:
                continue
            if each or duration > least:
                intervals.append((duration, self.acting))
            self.acting, self._pulse, done = held, (pulsed, width) if width > 0.0 else None, offset
        duration = self._period - done
        if self._pulse is not None:
            duration = self._add_pulse(duration, intervals)
        if each or duration > least:
            intervals.append((duration, self.acting))
        return intervals

    def now(self) -> Any:
        """Return the present drive, including a pulse."""
        return self.acting if self._pulse is None else self._pulse[0]

    def _add_pulse(self, duration: Any, intervals: list[Interval]) -> Any:
        """Add the rest of a pulse within a duration.

        Returns the remaining duration [s].
        """
        assert self._pulse is not None
        pulsed, width = self._pulse
        inside = np.minimum(width, duration) if self._each else min(width, duration)
        if self._each or inside > self._negligible:
            intervals.append((inside, pulsed))
        self._pulse = (pulsed, width - inside) if np.any(width - inside > self._negligible) else None
        return duration - inside


def recorded_switches(
    time: Array, held: Array, extra: Array, width: Array, *, period: float, delay: float
) -> tuple[Array, Array]:
    """Return the switches of recorded commands.

    Times [s], (K,), and wrenches from then on [N, N m], (K, 6), of N commands.

    The rule is that of `Timeline`, for all samples at once: the next recorded command ends a pulse; if samples are
    missing it runs out.

    Args:
        time: Times of the samples [s], (N,), N > 1.
        held: Held wrenches [N, N m], (N, 6).
        extra: Wrenches of the pulses on top of them [N, N m], (N, 6).
        width: Widths of the pulses [s], (N,); 0 for none.
        period: Sample period [s].
        delay: Time from a sample to the effect of its command [s].
    """
    on, near = time + delay, _ROUNDING * period
    ends = (width > 0.0) & (on + width < np.append(on[1:], np.inf) - near)
    when = np.concatenate([on, (on + width)[ends]])
    force = np.concatenate([held + np.where(width > 0.0, 1.0, 0.0)[:, None] * extra, held[ends]])
    order = np.argsort(when, kind="stable")
    when, force = when[order], force[order]
    # a switch within rounding of a sample is at that sample
    nearest = np.clip(np.searchsorted(time, when), 1, len(time) - 1)
    nearest -= (when - time[nearest - 1]) < (time[nearest] - when)
    return np.where(np.abs(time[nearest] - when) <= near, time[nearest], when), force
