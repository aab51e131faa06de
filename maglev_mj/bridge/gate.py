"""The one gate that six currents leave a host through: finite, wrench limit, current limit, warmth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.safety import Limits, Warmth
from maglev_mj.coils import CoilMap, limited_wrench
from maglev_mj.errors import PlantError
from maglev_mj.frames import ZERO, Command, clipped
from maglev_mj.parameters import numbers
from maglev_mj.timeline import Timeline, Timing

__all__ = ["Gate"]


class Gate:
    """Turns a command into currents, after every limit.

    Args:
        coils: What is known of the coils.
        limits: What the device bears.
        wrench_limit: Largest wrench, a number or (6,) [N, N m]; None for what the currents allow.
        period: Sample period [s].

    Attributes:
        warmth: Of the coils, by what was let through and told to `passed`.

    Raises:
        ParameterError: If a limit is negative or of another shape.
    """

    def __init__(self, coils: CoilMap, limits: Limits, wrench_limit: ArrayLike | None, period: float) -> None:
        self._limit: list[float] | None = None
        if wrench_limit is not None:
            values = numbers("wrench_limit", wrench_limit, at_least=0.0, finite=False)
            self._limit = [float(part) for part in np.broadcast_to(values, (6,))]
        self._inverse_turned, self._current, self._period = coils.inverse_turned, limits.current, period
        self.warmth = Warmth(limits)
        self._timeline = Timeline(Timing(period=period, delay=0.0), ZERO)

    def passed(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Let what `currents` returned flow for a period: it has been sent."""
        self.warmth.add(self._timeline.period(0, (held, pulsed, width)))

    def stay(self, periods: int, currents: Sequence[float]) -> None:
        """Let currents [A] flow for so many periods in which none were let through; a pulse runs out before them."""
        switch = None if currents == self._timeline.acting else (currents, None, 0.0)
        self.warmth.add(self._timeline.period(0, switch))
        if periods > 1:
            self.warmth.add((((periods - 1) * self._period, currents),))

    def currents(
        self, command: Command, position: Sequence[float]
    ) -> tuple[Command, Sequence[float], Sequence[float] | None, float]:
        """Return what is left of a command, its currents [A], those of its pulse if it has one, and its width [s].

        Args:
            command: What the controller answered.
            position: The pose that was measured: the coils turn with the flotor.

        Raises:
            PlantError: If the command is not six finite numbers.
        """
        force, extra, limit = command.force, command.extra, self._limit
        width = 0.0 if extra is None else command.pulse_width
        if len(force) != 6 or not math.isfinite(sum(force) + width + (0.0 if extra is None else sum(extra))):
            raise PlantError(f"a command must be six finite numbers, not {list(force)} and {extra} for {width:g} s")
        inverse_map = self._inverse_turned(*position[3:])
        if limit is not None:
            force = [clipped(one, most) for one, most in zip(force, limit)]
        left, held = limited_wrench(inverse_map, force, self._current)
        if extra is None:
            return Command(left), held, None, 0.0
        total: Sequence[float] = [one + other for one, other in zip(command.force, extra)]
        if limit is not None:
            total = [clipped(one, most) for one, most in zip(total, limit)]
        total, _ = limited_wrench(inverse_map, total, self._current)
        # the pulse as it will be known, so that whoever adds it to the force comes to the same currents
        extra = [one - other for one, other in zip(total, left)]
        pulsed: list[float] = inverse_map.dot([one + other for one, other in zip(left, extra)]).tolist()
        return Command(left, extra, width), held, pulsed, width
