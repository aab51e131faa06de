"""Joystick, coupling and slave as one matrix.

Along one axis from sample to sample, and gains chosen by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.plants import Timing
from maglev_mj.plants.hand import Hand, motion, transition
from maglev_mj.spec import Spec
from maglev_mj.theory import stiffest_wall

_STIFFNESS_SHARE, _DAMPING_SHARE = 0.25, 0.5
_MASS = Spec.moving_mass.value


class Gains(NamedTuple):
    """Stiffness [N/m] and damping [N s/m]."""

    stiffness: float
    damping: float


def stiffest_coupling(timing: Timing, slave_mass: float, mass: float = _MASS) -> Gains:
    """Return the stiffest stable coupling, and its damping, between two free bodies.

    The force comes at the same instants on both, one way and the other. So their distance moves as one body of the
    reduced mass would before a wall, and the coupling has that wall's bound.

    Args:
        timing: Sample period and delay.
        slave_mass: Of the slave as felt at the joystick [kg]; infinite for a law on the joystick alone.
        mass: Of the joystick [kg].
    """
    return _stiffest(timing.period, timing.delay, mass / (1.0 + mass / slave_mass))


@cache
def _stiffest(period: float, delay: float, mass: float) -> Gains:
    wall = stiffest_wall(period=period, delay=delay, mass=mass)
    return Gains(float(wall.stiffness), float(wall.damping))


def chosen_gains(timing: Timing, slave_mass: float, mass: float = _MASS) -> Gains:
    """Return a quarter of that stiffness, half its damping.

    That is half the frequency, as well damped.

    Args:
        timing: Sample period and delay.
        slave_mass: Of the slave as felt at the joystick [kg]; infinite for a law on the joystick alone.
        mass: Of the joystick [kg].
    """
    most = stiffest_coupling(timing, slave_mass, mass)
    return Gains(_STIFFNESS_SHARE * most.stiffness, _DAMPING_SHARE * most.damping)


NO_GAINS = Gains(0.0, 0.0)
"""No law at all."""


@dataclass(frozen=True, kw_only=True)
class TwoBodies:
    """Bodies that the coupling joins, along one axis; all as felt at the joystick.

    Args:
        timing: Sample period and delay.
        slave_mass: Mass of the slave [kg].
        contact: Stiffness of what the slave touches [N/m]; 0 where it is free.
        contact_damping: Its damping [N s/m].
        mass: Mass of the joystick [kg].
        hand: The hand on it; None for none.
        friction: Gains of a stuck stick-slip law on the joystick.
    """

    timing: Timing
    slave_mass: float
    contact: float = 0.0
    contact_damping: float = 0.0
    mass: float = _MASS
    hand: Hand | None = None
    friction: Gains = NO_GAINS

    def matrix(self, coupling: Gains) -> Array:
        """Return the matrix from one sample to the next.

        Its state: place and speed of the joystick, of the hand if its grip is soft, of the slave; the forces (on
        joystick, on slave) of the commands on their way, newest first; then both places one sample before.
        """
        timing, (a, b) = self.timing, self._motion()
        before, old = transition(a, b, timing.rest)
        after, new = transition(a, b, timing.period - timing.rest)
        waiting, bodies = timing.whole + (timing.rest > 0.0), len(a)
        size = bodies + 2 * waiting + 2
        command = self._command(coupling, bodies, size)
        m = np.zeros((size, size))
        m[:bodies, :bodies] = after @ before
        for age, share in ((timing.whole, new), (timing.whole + 1, after @ old)):
            if age == 0:
                m[:bodies] += share @ command
            elif age <= waiting:
                m[:bodies, bodies + 2 * age - 2 : bodies + 2 * age] += share
        if waiting:
            m[bodies : bodies + 2] = command
            m[bodies + 2 : -2, bodies:-4] = np.eye(2 * waiting - 2)
        m[-2, 0] = m[-1, bodies - 2] = 1.0
        return m

    def modulus(self, coupling: Gains) -> float:
        """Return the largest modulus of the eigenvalues, at least 1 if both bodies are free."""
        return float(np.abs(np.linalg.eigvals(self.matrix(coupling))).max())

    def boundary(self, damping: float) -> float:
        """Return the largest stable coupling stiffness [N/m], at some damping [N s/m]."""
        low, high = 1.0, 1e7
        for stiffness in np.geomspace(low, high, 200).tolist():
            if self.modulus(Gains(stiffness, damping)) > 1.0:
                high = stiffness
                break
            low = stiffness
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.modulus(Gains(middle, damping)) > 1.0 else (middle, high)
        return low

    def _motion(self) -> tuple[Array, Array]:
        """Return the continuous equations for both forces."""
        own, push = motion(self.mass, self.hand)
        size, slave = len(own) + 2, self.slave_mass
        a, b = np.zeros((size, size)), np.zeros((size, 2))
        a[:-2, :-2], b[:-2, 0] = own, push[:, 0]
        a[-2, -1] = 1.0
        a[-1, -2:] = -self.contact / slave, -self.contact_damping / slave
        b[-1, 1] = 1.0 / slave
        return a, b

    def _command(self, coupling: Gains, bodies: int, size: int) -> Array:
        """Return both forces from the state at a sample."""
        period, unit = self.timing.period, np.eye(size)
        joystick, before = unit[0], unit[-2]
        stretch, last = joystick - unit[bodies - 2], before - unit[-1]
        force = coupling.stiffness * stretch + coupling.damping / period * (stretch - last)
        stuck = self.friction.stiffness * joystick + self.friction.damping / period * (joystick - before)
        return np.array([-force - stuck, force])
