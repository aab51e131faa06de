"""The contract between a control loop and a plant, and when things happen in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Command, Component, Sample
from maglev_mj.parameters import number, numbers
from maglev_mj.spec import Spec

__all__ = ["Plant", "Timing"]

_MOST_PERIODS = 10_000


class Plant(Protocol):
    """What a control loop asks of a plant, simulated or real."""

    @property
    def period(self) -> float:
        """Sample period [s]."""

    def read(self) -> Sample:
        """Wait for the next sampling instant and return what is measured there."""

    def write(self, command: Command) -> Command:
        """Send the answer to the last sample; return it as applied, after every limit."""

    def close(self) -> None:
        """Let go of the plant; safe to call at any time, and more than once."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Timing:
    """When samples are taken and when commands take effect, counted in whole ticks.

    Sample k is taken at (k + phase) period after release; its command takes effect `delay` later.

    Args:
        period: Sample period [s], above 0.
        delay: Transport delay [s], 0 or more; may exceed the period, up to 10 000 times. (N,) for N devices that
            differ, all with the same whole periods in it.
        phase: In [0, 1); (N,) for N devices that differ.
        jitter: The delay of each command is drawn evenly from delay ± jitter [s], the same for a whole batch.
            Commands must stay in order and in their period.
        seed: Of the jitter: the same seed gives the same run.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    period: float = 1.0 / Spec.control_rate.value
    delay: Component = Spec.transport_delay.value
    phase: Component = 0.0
    jitter: float = 0.0
    seed: int = 0
    whole: int = field(init=False)
    """Whole periods in the delay."""
    rest: Component = field(init=False)
    """What remains of the delay [s], in [0, period)."""
    negligible: float = field(init=False)
    """Stretches shorter than this [s] are rounding, not time."""

    def __post_init__(self) -> None:
        period = number("period", self.period, above=0.0)
        delay = np.asarray((numbers if np.ndim(self.delay) else number)("delay", self.delay, at_least=0.0))
        phase = numbers("phase", self.phase, at_least=0.0)
        if not (phase < 1.0).all():
            raise ParameterError(f"phase must be at least 0 and below 1, not {float(phase.max()):g}")
        if (delay / period > _MOST_PERIODS).any():
            raise ParameterError(
                f"delay must be at most {_MOST_PERIODS} periods of {period:g} s, not {float(delay.max()):g} s"
            )
        # a delay within rounding of a whole number of periods is that number
        wholes = np.floor(delay / period + 1e-9)
        if np.ptp(wholes):
            raise ParameterError(
                f"delay must have the same whole periods of {period:g} s for all devices, not "
                f"{float(delay.min()):g} to {float(delay.max()):g} s"
            )
        whole = int(wholes.flat[0])
        rest = np.maximum(delay - whole * period, 0.0)
        rest = np.where(rest > 1e-9 * period, rest, 0.0)
        jitter = number("jitter", self.jitter, at_least=0.0)
        room = float(np.minimum(rest, period - rest).min())
        if jitter > room:
            raise ParameterError(f"jitter must be at most {room:g} s at this delay and period, not {jitter:g}")
        number("seed", self.seed, at_least=0)
        object.__setattr__(self, "jitter", jitter)
        object.__setattr__(self, "period", period)
        object.__setattr__(self, "delay", delay if delay.ndim else float(delay))
        object.__setattr__(self, "phase", phase if phase.ndim else float(phase))
        object.__setattr__(self, "whole", whole)
        object.__setattr__(self, "negligible", 1e-9 * period)
        object.__setattr__(self, "rest", rest if rest.ndim else float(rest))

    def rest_at(self, tick: int) -> Component:
        """Return what remains of the delay [s] after whole periods, for the command that takes effect after `tick`."""
        if self.jitter == 0.0:
            return self.rest
        # from tick and seed alone, so that it does not matter who asks, nor in which order
        draw = np.random.default_rng((self.seed, tick)).uniform(-1.0, 1.0)
        return self.rest + float(self.jitter * draw)

    def time(self, tick: int, offset: Component = 0.0) -> Any:
        """Return the time [s] of an instant `offset` after sample `tick`; never a running sum."""
        return (tick + self.phase) * self.period + offset
