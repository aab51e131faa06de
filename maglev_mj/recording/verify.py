"""Recordings run again, and compared bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array, Sample
from maglev_mj.hand import HandForce, RecordedHand
from maglev_mj.plants import SampledPlant
from maglev_mj.recording.recorder import row_of
from maglev_mj.recording.stretch import Recording, Setup, Stretch, table

__all__ = ["Rebuild", "Verdict", "verify"]

Rebuild: TypeAlias = Callable[[Setup, HandForce | None], tuple[SampledPlant | None, Controller]]
"""Makes plant and controller; None for a plant that cannot be made, such as a device."""


class Verdict(NamedTuple):
    """What running a recording again gave.

    Attributes:
        ticks: Samples in it.
        commands: How many commands of the controller, given the recorded samples, were the same to the last bit.
        positions: How many samples of the plant, given the recorded hand, were; None for a device, which no hand that
            was recorded moves again.
        first: Stretch and tick of the first that was not; None where all were.
    """

    ticks: int
    commands: int
    positions: int | None
    first: tuple[int, int] | None

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.commands == self.ticks and self.positions in (self.ticks, None)


def verify(recording: Recording, rebuild: Rebuild) -> Verdict:
    """Feed the recorded samples to a new controller, and the recorded hand to a new plant, and compare bit for bit.

    Args:
        recording: The recording.
        rebuild: Makes plant and controller from a setup and a hand.

    Raises:
        ParameterError: If a setup is not one that can be made.
    """
    commands = positions = 0
    moved = False
    first: tuple[int, int] | None = None
    for place, stretch in enumerate(recording.stretches):
        answered = _answers(stretch, rebuild)
        odd = ~np.isfinite(answered) & ~np.isfinite(stretch.command)
        good = ((answered == stretch.command) | odd).all(axis=1)
        commands += int(good.sum())
        seen = _positions(stretch, rebuild)
        if seen is not None:
            followed = (seen == stretch.position).all(axis=1)
            positions, moved = positions + int(followed.sum()), True
            good &= followed
        if first is None and not good.all():
            first = place, int(stretch.tick[np.argmin(good)])
    return Verdict(recording.ticks, commands, positions if moved else None, first)


def _answers(stretch: Stretch, rebuild: Rebuild) -> Array:
    """Return what a new controller answers to the recorded samples, (N, 13)."""
    _, controller = rebuild(stretch.setup, None)
    samples = zip(stretch.tick.tolist(), stretch.time.tolist(), stretch.position.tolist(), strict=True)
    return table([row_of(controller.step(Sample(int(tick), time, place))) for tick, time, place in samples], 13)


def _positions(stretch: Stretch, rebuild: Rebuild) -> Array | None:
    """Return what a new plant is seen to do in the recorded hand, (N, 6), NaN from where it stops; None without one."""
    plant, controller = rebuild(stretch.setup, RecordedHand(stretch.hand.reshape(-1, 6)))
    if plant is None:
        return None
    seen = np.full(stretch.position.shape, np.nan)
    try:
        for row in seen:
            sample = plant.read()
            row[:] = sample.position
            plant.write(controller.step(sample))
    except ParameterError:
        raise
    except MaglevError:
        pass  # the recorded run ended there too, or the comparison will say that it did not
    return seen
