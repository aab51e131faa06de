"""Timing of samples and commands: sampling instants, delays, and the command in effect at any time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component
from maglev_mj.keywords import checked, every_tick, rate_of
from maglev_mj.parameters import SAMPLE_PERIOD, number, numbers, store, transport_delay, whole
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, Spec

Interval: TypeAlias = tuple[Any, Any]
"""Duration [s] and drive in effect, of the type passed to the `Timeline`."""

_ROUNDING = 1e-9
"""Rounding tolerance, as a fraction of a period."""


_BLOCK = 256

_DEVICE = DEVICE_PERIOD, DEVICE_DELAY, 0.0


@lru_cache(maxsize=64)
def _draws(seed: int, block: int) -> tuple[float, ...]:
    """Return uniform random numbers in [-1, 1] for a block of ticks.

    They depend only on seed and tick, not on the order of calls.
    """
    return tuple(np.random.default_rng((seed, block)).uniform(-1.0, 1.0, _BLOCK).tolist())


def split_delay(delay: Component, period: Component) -> tuple[Component, Component]:
    """Split a delay into whole periods and remainder [s], (...,) each.

    A delay within rounding of a multiple of the period counts as that multiple.

    Args:
        delay: Delay [s], 0 or more, (...,).
        period: Sample period [s], above 0, (...,).
    """
    periods = (delay / period + _ROUNDING) // 1.0
    remainder = delay - periods * period
    return periods, remainder * (remainder > _ROUNDING * period)


def check_delay(delay: float, period: float) -> tuple[int, float]:
    """Check a delay [s]; return its whole periods and remainder [s]."""
    periods, remainder = split_delay(float(transport_delay(number("delay", delay), period)), period)
    return int(periods), remainder


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Timing:
    """Sample period, delay, sampling phase and jitter.

    Sample k is taken at (k + phase) period after release; its command takes effect `delay` later.

    Args:
        period: Sample period [s], from 1 µs to 0.1 s.
        delay: Transport delay [s], from 0 to 10 periods; (...,) for a batch, all with the same number of
            whole periods.
        phase: Sampling phase in [0, 1); (...,) for a batch.
        jitter: Half-width of the uniform distribution delay ± jitter [s], common to a batch. It must not move a
            command into another period.
        seed: Seed of the jitter; equal seeds give equal runs.
        device_period: Sample period of walls on the device [s].
        device_delay: Delay to their effect [s], up to 10 such periods.
        device_phase: Phase of the device's samples after the first one of the host, in [0, 1).
        rate: Sample rate [Hz], in place of `period`; `device_rate` in place of `device_period`.

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
    device_period: float = DEVICE_PERIOD
    device_delay: float = DEVICE_DELAY
    device_phase: float = 0.0
    rate: float = rate_of("period")
    device_rate: float = rate_of("device_period")
    whole: int = field(init=False)
    """Whole periods in the delay."""
    rest: Component = field(init=False)
    """Remainder of the delay [s], in [0, period)."""
    negligible: float = field(init=False)
    """Rounding tolerance of times [s]."""

    def __post_init__(self) -> None:
        period = number("period", self.period, **SAMPLE_PERIOD)
        delay = transport_delay(self.delay, period)
        phase = numbers("phase", self.phase, at_least=0.0)
        if not (phase < 1.0).all():
            raise ParameterError(f"phase must be at least 0 and below 1 (got {float(phase.max()):g})")
        periods, rest = map(np.asarray, split_delay(delay, period))
        if np.ptp(periods):
            raise ParameterError(
                f"delay must have the same number of whole periods of {period:g} s on all devices "
                f"(got {float(delay.min()):g} to {float(delay.max()):g} s)"
            )
        jitter = number("jitter", self.jitter, at_least=0.0)
        largest = float(np.minimum(rest, period - rest).min())
        if jitter > largest:
            raise ParameterError(f"jitter must be at most {largest:g} s at this delay and period (got {jitter:g} s)")
        if (self.device_period, self.device_delay, self.device_phase) != _DEVICE:
            number("device_period", self.device_period, **SAMPLE_PERIOD)
            transport_delay(number("device_delay", self.device_delay), self.device_period, "device_delay")
            number("device_phase", self.device_phase, at_least=0.0, below=1.0)
        parts = {"delay": delay, "phase": phase, "rest": rest}
        store(self, **{name: part if part.ndim else float(part) for name, part in parts.items()})
        store(self, period=period, jitter=jitter, seed=whole("seed", self.seed))
        store(self, whole=int(periods.flat[0]), negligible=_ROUNDING * period)

    @property
    def device(self) -> tuple[float, float]:
        """Sample period and delay of walls on the device [s]."""
        return self.device_period, self.device_delay

    def rest_at(self, tick: int) -> Component:
        """Return the offset [s] from `tick` to the command that takes effect after it, with jitter."""
        if self.jitter == 0.0:
            return self.rest
        return self.rest + self.jitter * _draws(self.seed, tick // _BLOCK)[tick % _BLOCK]

    @every_tick
    def time(self, tick: int, offset: Component = 0.0) -> Any:
        """Return the time [s] at `offset` [s] after sample `tick`; a product, so rounding does not accumulate."""
        return (tick + self.phase) * self.period + offset


class Timeline:
    """Zero-order hold of delayed commands.

    A command is a drive that is held until the next command takes effect. It may start with a pulse: a different drive
    for the first `width` seconds, cut short by the next command. Drives may be of any type: wrenches, currents, or
    values prepared by a plant.

    Args:
        timing: Sample period and delay.
        acting: Drive until the first command takes effect.
        compares: See below.

    Attributes:
        acting: Drive since the last switch.
        compares: True if drives are tuples and equal first entries mean equal drives: no switch is made between them.
            May change from period to period.
    """

    def __init__(self, timing: Timing, acting: Any, *, compares: bool = False) -> None:
        self.acting, self.compares, self.timing = acting, compares, timing
        # (tick, offset [s], drive, pulse drive, pulse width)
        self._switches: deque[tuple[int, Any, Any, Any, float]] = deque()
        self._pulse: tuple[Any, Any] | None = None
        self._period, self._rest, self._whole = timing.period, timing.rest, timing.whole
        self._negligible, self._jitters = timing.negligible, timing.jitter > 0.0
        self._each = np.ndim(timing.delay) > 0
        # exactly one switch per period, at the sample or inside the period
        self._at_once = not self._each and timing.rest == 0.0
        distance = np.minimum(timing.rest, timing.period - timing.rest) - timing.jitter
        self._plain = timing.whole == 0 and (self._each or self._at_once or float(distance) > self._negligible)

    def answer(
        self, tick: int, held: Any, pulsed: Any = None, width: float = 0.0, *, after: float | None = None
    ) -> None:
        """Add the command for a sample; cancel commands that would take effect at the same time or later.

        Args:
            tick: Index of the sample.
            held: Drive after the pulse.
            pulsed: Drive during the first `width` seconds.
            width: Pulse width [s]; 0 for no pulse.
            after: Delay from the sample to the effect [s]; the timing's delay by default.
        """
        if after is None:
            tick += self._whole
            offset = self.timing.rest_at(tick) if self._jitters else self._rest
        else:
            periods, offset = split_delay(after, self._period)
            tick += int(periods)
        switches = self._switches
        while switches and switches[-1][0] >= tick and (switches[-1][0] > tick or np.all(switches[-1][1] >= offset)):
            switches.pop()
        switches.append((tick, offset, held, pulsed, width))

    def period(
        self,
        tick: int,
        answer: tuple[Any, Any, float] | None = None,
        *,
        after: float | None = None,
        begin: float = 0.0,
        until: float | None = None,
    ) -> list[Interval]:
        """Return the intervals from sample `tick` to the next, in order; their durations sum to the period.

        With delays (N,) durations are (N,); an interval absent on a device has duration 0.

        Args:
            tick: Index of the sample.
            answer: Its command as (held, pulsed, width); None if it was added by `answer`, or if there is none.
            after: Delay to its effect [s], as in `answer`; one device only.
            begin: Start of a part of the period [s], the end of the part before it; one device only.
            until: End of the part [s]; None for the period's.
        """
        switches = self._switches
        if answer is not None:
            held, pulsed, width = answer
            plain = self._plain if after is None else self._negligible < after < self._period - self._negligible
            if (
                plain and width == 0.0 and self._pulse is None and not switches
            ):  # fast path of most periods, at half the cost
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
        done, each, least, end = begin, self._each, self._negligible, self._period if until is None else until
        while switches and switches[0][0] <= tick and (until is None or switches[0][1] <= end + least):
            _, offset, held, pulsed, width = switches.popleft()
            duration = offset - done
            if self._pulse is not None:
                duration = self._add_pulse(duration, intervals)
            elif width == 0.0 and self.compares and held[0] == self.acting[0]:
                continue
            if each or duration > least:
                intervals.append((duration, self.acting))
            self.acting, self._pulse, done = held, (pulsed, width) if width > 0.0 else None, offset
        duration = end - done
        if self._pulse is not None:
            duration = self._add_pulse(duration, intervals)
        if each or duration > least:
            intervals.append((duration, self.acting))
        return intervals

    def now(self) -> Any:
        """Return the drive in effect, including a pulse."""
        return self.acting if self._pulse is None else self._pulse[0]

    def _add_pulse(self, duration: Any, intervals: list[Interval]) -> Any:
        """Append the part of the pulse within `duration`; return the remaining duration [s]."""
        assert self._pulse is not None
        pulsed, width = self._pulse
        inside = np.minimum(width, duration) if self._each else min(width, duration)
        if self._each or inside > self._negligible:
            intervals.append((inside, pulsed))
        self._pulse = (pulsed, width - inside) if np.any(width - inside > self._negligible) else None
        return duration - inside


def peak_wrenches(held: Array, extra: Array, width: Array) -> Array:
    """Return the wrench of larger magnitude of each command, during its pulse or after it, by component.

    Args:
        held: Held wrenches [N, N m], (N, 6).
        extra: Pulse wrenches, added to the held ones [N, N m], (N, 6).
        width: Pulse widths [s], (N,); 0 for no pulse.
    """
    pulsed = _pulsed(held, extra, width)
    return np.where(np.abs(pulsed) > np.abs(held), pulsed, held)


def peak_forces(held: Array, extra: Array, width: Array) -> Array:
    """Return the largest magnitude of each command's force, during its pulse or after it [N], (N,).

    Arguments as for `peak_wrenches`.
    """
    parts = [np.linalg.norm(wrench[:, :3], axis=1) for wrench in (held, _pulsed(held, extra, width))]
    return np.asarray(np.maximum(*parts))


def _pulsed(held: Array, extra: Array, width: Array) -> Array:
    return np.asarray(held + np.where(width > 0.0, 1.0, 0.0)[:, None] * extra)


def recorded_switches(
    time: Array, held: Array, extra: Array, width: Array, *, period: float, delay: float
) -> tuple[Array, Array]:
    """Return the switching times of N recorded commands and the wrenches from then on.

    Vectorised form of `Timeline`: a pulse ends after its width, or at the next recorded command.

    Args:
        time: Times of the samples [s], (N,), N > 1.
        held: Held wrenches [N, N m], (N, 6).
        extra: Pulse wrenches, added to the held ones [N, N m], (N, 6).
        width: Pulse widths [s], (N,); 0 for no pulse.
        period: Sample period [s].
        delay: Delay from a sample to the effect of its command [s].

    Returns:
        Times [s], (K,), and wrenches [N, N m], (K, 6).
    """
    on, near = time + delay, _ROUNDING * period
    ends = (width > 0.0) & (on + width < np.append(on[1:], np.inf) - near)
    switch = np.concatenate([on, (on + width)[ends]])
    force = np.concatenate([_pulsed(held, extra, width), held[ends]])
    order = np.argsort(switch, kind="stable")
    switch, force = switch[order], force[order]
    # snap switches within rounding to the sample
    nearest = np.clip(np.searchsorted(time, switch), 1, len(time) - 1)
    nearest -= (switch - time[nearest - 1]) < (time[nearest] - switch)
    return np.where(np.abs(time[nearest] - switch) <= near, time[nearest], switch), force
