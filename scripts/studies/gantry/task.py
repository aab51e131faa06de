"""Task of the teleoperation study.

Go to the block, press on it, hold, release; and its means.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from gantry.coupling import Coupling
from gantry.slave import BLOCK_STIFFNESS
from gantry.theory import Gains, chosen_gains
from maglev_mj import Timing
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.parameters import number
from maglev_mj.plants.hand import Hand, Trajectory
from maglev_mj.spec import Spec

DELAY_SHARE = 0.3
"""Transport delay in parts of the period.

The paper's 1.5 ms at 200 Hz, 0.3 ms at 1 kHz.
"""

FIRM = Hand(mass=0.5, damping=25.0, stiffness=1000.0)
"""A firm grip, near the top of published hands."""

_Point: TypeAlias = tuple[float, float, float, float]

_JERK, _PUSHED = 0.1, 5.4
_BLOCK = {
    "position": (0.02, -0.01, -0.005),
    "rate": (0.13, 0.0, -0.06),
    "touching": (0.0, 0.0, 0.0),
    "free": (0.0, 0.0, -0.1),
}
"""Position of the block in each mode [m].

From the start of the pin's tip, the slave's.
"""


@dataclass(frozen=True, kw_only=True)
class Task:
    """The task and its means.

    Args:
        mode: "position", or "rate": stick-slip on the joystick, and a rate beyond its edge. For studies of stability
            also "touching", position mode on the block from the start, and "free", without a block.
        period: Sample period [s].
        delay: From a sample to its command taking effect on joystick and slave [s].
        phase: When the first sample is taken [periods].
        press: Force with which the hand presses [N].
        speed: Of the joystick when the slave meets the block, in position mode [m/s].
        coupling: Virtual coupling; None for gains by the theory.
        hand: The hand on the joystick, with an arm.
        block: Stiffness of the block [N/m, the slave's].
        hold: How long it is pressed after the pushing has come to its end [s].
        leaves: Whether the hand lifts the slave off at the end, in the first two modes.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    mode: str = "position"
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    phase: float = 0.0
    press: float = 5.0
    speed: float = 0.02
    coupling: Coupling | None = None
    hand: Hand = FIRM
    block: float = BLOCK_STIFFNESS
    hold: float = 1.2
    leaves: bool = True

    def __post_init__(self) -> None:
        if self.mode not in _BLOCK:
            raise ParameterError(f"mode must be one of {', '.join(_BLOCK)}, not {self.mode!r}")
        number("press", self.press, above=0.0, at_most=6.0)
        number("speed", self.speed, at_least=0.001, at_most=0.1)
        number("hold", self.hold, above=0.0)

    @property
    def timing(self) -> Timing:
        """Sample period, delay and phase."""
        return Timing(period=self.period, delay=self.delay, phase=self.phase)

    def chosen(self, slave_mass: float) -> Coupling:
        """Return the coupling.

        By default one for a slave of this mass along its lightest axis [kg, the slave's].
        """
        if self.coupling is not None:
            return self.coupling
        start = Coupling(stiffness=1.0, damping=0.0)
        return replace(start, **chosen_gains(self.timing, start.felt * slave_mass)._asdict())

    @property
    def friction(self) -> Gains:
        """Gains of the stick-slip law in rate mode.

        No stiffer than at the paper's rate and delay, which serves.
        """
        return min(chosen_gains(self.timing, math.inf), chosen_gains(Timing(), math.inf))

    @property
    def block_top(self) -> Array:
        """Middle of the block's top [m], (3,), from the start of the pin's tip, the slave's."""
        return np.array(_BLOCK[self.mode])

    def path(self, coupling: Coupling) -> tuple[Trajectory, float]:
        """Return the arm's path, and its end of pushing [s]."""
        _, _, arm, _, grip = (float(value) for value in self.hand.values)
        reach = 1e3 * self.press * (1.0 / arm + (1.0 / grip if grip else 0.0))
        if self.mode == "rate":
            return _steered(self, reach)
        if self.mode == "touching":
            return _path([(0.1, 0, 0, 0), (0.6, 0, 0, -reach), (0.7, 0, 0, -reach), (0.701, 0, 0, -reach - _JERK)]), 0.6
        if self.mode == "free":
            return _path([(0.7, 0, 0, 0), (0.701, 0, 0, _JERK)]), 0.6
        return _drawn(self, reach + 1e3 * self.press / coupling.stiffness)


def _drawn(task: Task, reach: float) -> tuple[Trajectory, float]:
    """Return the way to the block in position mode.

    Aside, down at a speed that is greatest on contact, and press.

    Args:
        task: The task.
        reach: By how much arm, grip and coupling are stretched in the end [mm].
    """
    down = 0.7 + 1.875 * 0.004 / task.speed  # a minimum-jerk stroke of 4 mm
    points: list[_Point] = [(0.1, 0, 0, 0), (0.6, 2, -1, 1.5), (0.7, 2, -1, 1.5), (down, 2, -1, -2.5)]
    points += [(down + 0.4, 2, -1, -0.5 - reach)]
    if task.leaves:
        end = down + 0.4 + task.hold
        points += [(end, 2, -1, -0.5 - reach), (end + 0.4, 2, -1, 1.5), (end + 0.6, 2, -1, 1.5)]
    return _path(points), down + 0.4


def _steered(task: Task, reach: float) -> tuple[Trajectory, float]:
    """Return the way to the block in rate mode.

    Push aside, release, push down onto the block, press, release.

    Args:
        task: The task.
        reach: By how much arm and grip are stretched in the end [mm].
    """
    aside, along = 3.5, 4.0
    points: list[_Point] = [(0.1, 0, 0, 0), (0.8, along, 0, 0), (1.0, _PUSHED, 0, 0), (2.0, _PUSHED, 0, 0)]
    points += [(2.2, aside, 0, 0), (2.8, aside, 0, -along), (3.0, aside, 0, -_PUSHED), (4.0, aside, 0, -_PUSHED)]
    points += [(4.8, aside, 0, -along - reach)]
    if task.leaves:
        end = 4.8 + task.hold
        points += [(end, aside, 0, -along - reach), (end + 0.4, aside, 0, 2.5), (end + 0.8, aside, 0, 2.5)]
    return _path(points), 4.8


def _path(points: Sequence[_Point]) -> Trajectory:
    """Return a path from times [s] and places [mm]."""
    table = np.array(points)
    return Trajectory(table[:, 0], np.pad(table[:, 1:] * 1e-3, ((0, 0), (0, 3))))
