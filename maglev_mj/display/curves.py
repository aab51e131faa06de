"""Curves of position, speed and force over the last seconds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.session import Snapshot

_ROUNDING = 1e-6


class Curves(NamedTuple):
    """Curves of one axis.

    Attributes:
        axis: Name of the axis.
        unit: Of the position: mm or mrad; the speed's is that per second.
        torque: Of the force: N, or N m.
        time: Before the last sample [s], (N,).
        position: In `unit`, (N,).
        speed: In `unit` per second, (N,).
        device: Force of the device, (N,).
        hand: Force of the hand, (N,).
        edges: Walls on the axis, in `unit`.
    """

    axis: str
    unit: str
    torque: str
    time: Array
    position: Array
    speed: Array
    device: Array
    hand: Array
    edges: Sequence[float]


def curves(snapshot: Snapshot, axis: int, most: int) -> Curves:
    """Return the curves of one axis of a snapshot.

    Args:
        snapshot: The snapshot.
        axis: Index into AXES.
        most: Largest number of points.
    """
    rows = snapshot.history
    if len(rows) > most:
        rows = rows[:: -(-len(rows) // most)]
    time = rows[:, 0] - (rows[-1, 0] if len(rows) else 0.0)
    return Curves(
        axis=AXES[axis],
        unit=unit_of("mm", axis),
        torque=unit_of("N", axis),
        time=time,
        position=1e3 * rows[:, 1 + axis],
        speed=1e3 * rows[:, 7 + axis],
        device=rows[:, 13 + axis],
        hand=rows[:, 19 + axis],
        edges=[edge * 1e3 for index, _, edge in snapshot.faces if index == axis],
    )


class SteadyRange:
    """Range of a plot's axis that follows data without jitter.

    Args:
        least: Smallest span, in the data's unit.
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._last: tuple[float, float] | None = None

    def __call__(self, *values: ArrayLike) -> tuple[float, float]:
        """Return a range that holds all values.

        It is narrower than the last only if that is twice as wide.
        """
        found = fitted_range(np.concatenate([np.ravel(some) for some in values]), self._least)
        last = self._last
        if last is None or found[0] < last[0] or found[1] > last[1] or found[1] - found[0] <= 0.5 * (last[1] - last[0]):
            self._last = found
        assert self._last is not None
        return self._last


class Ranges:
    """Ranges of the plots of one axis.

    Args:
        axis: Index into AXES.

    Attributes:
        place: Of the position [mm, mrad].
        speed: Of the speed [mm/s, mrad/s].
        force: Of the force [N, N m].
    """

    def __init__(self, axis: int) -> None:
        self.axis = axis
        self.place, self.speed = SteadyRange(2.0), SteadyRange(20.0)
        self.force = SteadyRange(0.02 if axis > 2 else 2.0)


def fitted_range(values: Array, least: float) -> tuple[float, float]:
    """Return a range between multiples of a power of ten.

    That below its span.

    Args:
        values: Values that it holds; any number.
        least: Smallest span.
    """
    kept = values[np.isfinite(values)]
    low, high = (float(kept.min()), float(kept.max())) if kept.size else (0.0, 0.0)
    if (lack := least - (high - low)) > 0.0:
        low, high = low - 0.5 * lack, high + 0.5 * lack
    step = 10.0 ** np.floor(np.log10(high - low) + _ROUNDING)
    while True:
        bottom, top = (float(np.floor(low / step + _ROUNDING)), float(np.ceil(high / step - _ROUNDING)))
        if top - bottom < 10.0:
            return bottom * step, top * step
        step *= 10.0  # both ends rounded away beyond the next power


def round_up(value: float) -> float:
    """Return the next of 1, 2, 5 times 10^n."""
    step = 10.0 ** np.floor(np.log10(value))
    return float(next(step * size for size in (1.0, 2.0, 5.0, 10.0) if step * size >= 0.999 * value))
