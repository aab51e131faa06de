"""How one coordinate moves under a constant force, closed form: free, with lagging drivers, held, or rubbing."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from maglev_mj.frames import Array, Component
from maglev_mj.hand import Hand, motion, transition

__all__ = ["AxisMotion", "FreeAxis", "HeldAxis", "LaggedAxis", "RubbingAxis"]


class AxisMotion(Protocol):
    """One coordinate of one device or of N."""

    @property
    def place(self) -> Component:
        """Position [m, rad]."""

    @property
    def velocity(self) -> Component:
        """Velocity [m/s, rad/s]."""

    @property
    def actual(self) -> Component:
        """Force of the actuators now [N, N m]; it trails the command where the drivers lag."""

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """Go on for `duration` [s] under a commanded force, a weight, and what a hand's muscles exert [N, N m]."""


class FreeAxis:
    """A mass, and nothing else."""

    def __init__(self, place: Component, velocity: Component, actual: Component, inertia: float) -> None:
        self.place, self.velocity, self.actual = place, velocity, actual
        self._inverse = 1.0 / inertia

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """See `AxisMotion`."""
        acceleration = (command + weight + effort) * self._inverse
        self.place = self.place + duration * (self.velocity + 0.5 * duration * acceleration)
        self.velocity = self.velocity + duration * acceleration
        self.actual = command


class LaggedAxis:
    """A mass behind first-order drivers: actual force = command + (actual - command) exp(-t / lag)."""

    def __init__(self, place: Component, velocity: Component, actual: Component, inertia: float, lag: float) -> None:
        self.place, self.velocity, self.actual = place, velocity, actual
        self._inverse, self._lag = 1.0 / inertia, lag

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """See `AxisMotion`; the exponential is integrated twice."""
        lag, faded = self._lag, -np.expm1(-duration / self._lag)
        acceleration, missing = (command + weight + effort) * self._inverse, (self.actual - command) * self._inverse
        gained = missing * lag * faded
        travel = self.velocity + 0.5 * duration * acceleration + missing * lag
        self.place = self.place + duration * travel - lag * gained
        self.velocity = self.velocity + duration * acceleration + gained
        self.actual = command + (self.actual - command) * (1.0 - faded)


class HeldAxis:
    """A mass in a hand, its drivers with or without lag: the transition matrix of `motion`."""

    def __init__(
        self, place: Component, velocity: Component, actual: Component, inertia: float, hand: Hand, lag: float
    ) -> None:
        self._state: list[Component] = [place, velocity, *([hand.place(place), velocity] if hand.soft else [])]
        self._lags = lag > 0.0
        if self._lags:
            self._state.append(actual)
        self.actual = actual
        self._a, self._b = motion(inertia, hand, lag)
        self._known: dict[float | bytes, tuple[list[list[Component]], list[list[Component]]]] = {}

    @property
    def place(self) -> Component:
        """Position of the flotor [m]."""
        return self._state[0]

    @property
    def velocity(self) -> Component:
        """Velocity of the flotor [m/s]."""
        return self._state[1]

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """See `AxisMotion`."""
        phi, gamma = self._transition(duration)
        self._state = [
            sum((one * part for one, part in zip(row, self._state)), by[0] * command + by[1] * weight + by[2] * effort)
            for row, by in zip(phi, gamma)
        ]
        self.actual = self._state[-1] if self._lags else command

    def _transition(self, duration: Component) -> tuple[list[list[Component]], list[list[Component]]]:
        """Return the matrices as rows of components, kept because the durations return every period."""
        key = duration if isinstance(duration, float) else np.asarray(duration).tobytes()
        known = self._known.get(key)
        if known is None:
            if len(self._known) > 64:
                self._known.clear()
            phi, gamma = _rows(*transition(self._a, self._b, duration))
            known = self._known[key] = phi, gamma
        return known


def _rows(*matrices: Array) -> Any:
    """Return matrices (..., n, m) as rows of components: floats, or arrays (...,)."""
    result = []
    for matrix in matrices:
        if matrix.ndim == 2:
            result.append(matrix.tolist())
        else:
            result.append([[entry.copy() for entry in row] for row in np.moveaxis(matrix, (-2, -1), (0, 1))])
    return tuple(result)


class RubbingAxis:
    """A mass with dry friction of its own: it stops, stays, or turns back within the stretch."""

    def __init__(
        self, place: Component, velocity: Component, actual: Component, inertia: float, friction: Component
    ) -> None:
        self.place, self.velocity, self.actual = place, velocity, actual
        self._inverse, self._friction = 1.0 / inertia, friction

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """See `AxisMotion`."""
        force, speed, rub = np.asarray(command + weight + effort), np.asarray(self.velocity), self._friction
        breaks = np.where(np.abs(force) > rub, np.sign(force), 0.0)
        sense = np.where(speed != 0.0, np.sign(speed), breaks)
        first = np.where(sense != 0.0, force - sense * rub, 0.0) * self._inverse
        stops = first * speed < 0.0
        until = np.where(stops, np.minimum(-speed / np.where(stops, first, 1.0), duration), duration)
        place = self.place + until * (speed + 0.5 * until * first)
        stopped = stops & (until < duration)
        second = np.where(breaks != 0.0, force - breaks * rub, 0.0) * self._inverse
        left = duration - until
        speed = np.where(stopped, left * second, speed + until * first)
        place = np.where(stopped, place + 0.5 * left * left * second, place)
        single = not place.ndim and not math.isnan(place)
        self.place, self.velocity = (float(place), float(speed)) if single else (place, speed)
        self.actual = command
