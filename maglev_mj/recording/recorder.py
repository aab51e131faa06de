"""What a control loop records to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.parameters import numbers
from maglev_mj.recording.stretch import Setup, Stretch, table
from maglev_mj.spec import GRAVITY, INERTIA

__all__ = ["Felt", "Mechanics", "Recorder", "row_of"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanics:
    """What the actuators push at, which says where the energy goes; the device as published by default.

    Attributes:
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        load: Constant wrench that acts besides the actuators', its weight [N, N m], (6,).
        before: Wrench of the actuators until the first command takes effect [N, N m], (6,).

    Raises:
        ParameterError: If a value is not finite, or an inertia is not above 0.
    """

    inertia: ArrayLike = INERTIA
    load: ArrayLike = (0.0, 0.0, -INERTIA[2] * GRAVITY, 0.0, 0.0, 0.0)
    before: ArrayLike = ZERO

    def __post_init__(self) -> None:
        numbers("inertia", self.inertia, at_least=1e-12)
        numbers("load", self.load)
        numbers("before", self.before)


class Felt(Protocol):
    """What a recorder asks of a plant."""

    @property
    def hand_wrench(self) -> Sequence[Any]:
        """What the hand exerts since the last sample [N, N m], six."""


class Recorder:
    """Keeps what goes by in a control loop, in memory: hand it to the loop as `record`.

    Args:
        plant: The plant that is driven.
        setup: What plant and controller were made from.
    """

    def __init__(self, plant: Felt, setup: Setup) -> None:
        self._plant, self._setup = plant, dict(setup)
        self._rows: list[tuple[Any, ...]] = []

    def __call__(self, sample: Sample, command: Command, applied: Command) -> None:
        """Keep one cycle."""
        hand = self._plant.hand_wrench
        self._rows.append((sample.tick, sample.time, sample.position, row_of(command), row_of(applied), hand))

    def stretch(self) -> Stretch:
        """Return what was kept so far."""
        tick, time, position, command, applied, hand = list(zip(*self._rows)) if self._rows else [()] * 6
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
