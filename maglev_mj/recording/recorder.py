"""What stands between a control loop and a controller, and keeps what goes by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES, Command, Sample
from maglev_mj.laws import Bias
from maglev_mj.recording.stretch import Setup, Stretch, table

__all__ = ["Felt", "Recorder", "carried_by", "row_of"]


class Felt(Protocol):
    """What a recorder asks of a plant."""

    @property
    def hand_wrench(self) -> Sequence[Any]:
        """What the hand exerts since the last sample [N, N m], six."""


class Recorder:
    """Stands between a control loop and a controller, and keeps what goes by.

    Args:
        plant: The plant that is driven.
        controller: The controller that drives it.
        setup: What both were made from.

    Attributes:
        period: The controller's sample period [s].
    """

    def __init__(self, plant: Felt, controller: Controller, setup: Setup) -> None:
        self.period = controller.period
        self._plant, self._answer, self._setup = plant, controller.step, dict(setup)
        self._rows: list[tuple[Any, ...]] = []
        self._applied: list[list[float]] = []

    def step(self, sample: Sample) -> Command:
        """Answer one sample as the controller does."""
        command = self._answer(sample)
        self._rows.append((sample.tick, sample.time, sample.position, row_of(command), self._plant.hand_wrench))
        return command

    def observe(self, sample: Sample, applied: Command) -> None:
        """Keep a command as applied."""
        self._applied.append(row_of(applied))

    def stretch(self) -> Stretch:
        """Return what was kept so far; an answer that the plant refused is kept as applied zero."""
        missing = len(self._rows) - len(self._applied)
        columns = list(zip(*self._rows)) if self._rows else [()] * 5
        tick, time, position, command, hand = columns
        applied = [*self._applied, *[[0.0] * 13] * missing]
        return Stretch(
            setup=self._setup,
            tick=np.array(tick, dtype=np.float64),
            time=np.array(time, dtype=np.float64),
            position=table(position, 6),
            command=table(command, 13),
            applied=table(applied, 13),
            hand=table(hand, 6),
        )


def row_of(command: Command) -> list[float]:
    """Return a command as 13 numbers."""
    extra = command.extra
    return [*command.force, *(extra if extra is not None else (0.0,) * 6), command.pulse_width if extra else 0.0]


def carried_by(controller: Controller) -> list[float]:
    """Return the wrench by which a controller carries the flotor [N, N m], six; zeros where it does not."""
    carried = np.zeros(len(AXES))
    for law in controller.laws:
        if isinstance(law, Bias):
            carried += np.asarray(law.wrench)
    values: list[float] = carried.tolist()
    return values
