"""Where the energy of a session went: what the hand put in, and what the rendered world took or made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array

__all__ = ["EnergyAccount"]


class EnergyAccount:
    """Adds up what the hand puts in and what the rendered world takes, from sample to sample.

    The rendered world is what the actuators do beyond carrying the flotor: walls, friction, springs. It has a tank:
    what it takes in fills it, up to a bound that no spring here can store more than, and what it gives empties it. A
    world that gives more than it has is not passive, and one that keeps on giving is unstable.

    Args:
        pose: At the start [m, rad], (6,).
        carried: Wrench by which the actuators carry the flotor [N, N m], (6,); zero where they do not.
        tank: The most that counts as stored [J].

    Attributes:
        hand: Work of the hand [J]; its force is held from sample to sample.
        taken: What the rendered world has taken in [J]; below 0 it has made energy.
        stored: What is in the tank [J]; below 0 by as much as it has made beyond.
    """

    def __init__(self, pose: Array, carried: ArrayLike, *, tank: float = 0.2) -> None:
        self._pose, self._carried, self._tank = pose, np.asarray(carried), tank
        self._effort, self._work = np.zeros(6), 0.0
        self.hand = self.taken = self.stored = 0.0

    def add(self, pose: Array, effort: Sequence[float], work: float) -> None:
        """Add the stretch up to a sample.

        Args:
            pose: At the sample [m, rad], (6,).
            effort: What the hand exerts from there on [N, N m].
            work: Of the actuators, since the start [J].
        """
        way = pose - self._pose
        taken = float(self._carried @ way) - (work - self._work)
        self.hand += float(self._effort @ way)
        self.taken += taken
        self.stored = min(self.stored + taken, self._tank)
        self._pose, self._effort, self._work = pose, np.array(effort), work
