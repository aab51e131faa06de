"""Driver lag, hand and dry friction of the exact plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add, mul
from typing import Any, Protocol, TypeAlias

import numpy as np

from maglev_mj.frames import Component
from maglev_mj.hand import Hand, motion, transition

_MOST_KEPT = 64

Motion: TypeAlias = tuple[list[Component], list[Component], list[Component]]
"""Position, velocity and actuator force, six components each.

In [m, rad], [m/s, rad/s] and [N, N m]. The actuator force trails the command if the drivers lag.
"""

Forces: TypeAlias = tuple[Sequence[Component], Sequence[Component]]
"""Commanded wrench and hand muscle wrench [N, N m].

Six components each.
"""


class Amendment(Protocol):
    """A correction of the motion of free masses."""

    def amend(self, duration: Component, forces: Forces, before: Motion, after: Motion) -> None:
        """Correct the motion `after` in place.

        Args:
            duration: Duration [s].
            forces: Commanded wrench and wrench of the hand's muscles.
            before: Motion at the beginning.
            after: Motion of free masses at the end.
        """


class Lag:
    """First-order lag of the drivers.

    Actual force = command + (actual - command) exp(-t / lag), integrated twice.

    Args:
        inertia: Mass and moments of inertia of the axes, six [kg, kg m²].
        lag: Time constant [s].
    """

    def __init__(self, inertia: Sequence[Component], lag: float) -> None:
        self._inverse, self._lag = [1.0 / value for value in inertia], lag
        self._known: dict[float, tuple[Component, list[Component], list[Component]]] = {}

    def amend(self, duration: Component, forces: Forces, before: Motion, after: Motion) -> None:
        """See `Amendment`."""
        factors = self._known.get(duration) if duration.__class__ is float else None
        left, (way_x, way_y, way_z, way_rx, way_ry, way_rz), (by_x, by_y, by_z, by_rx, by_ry, by_rz) = (
            factors or self._factors(duration)
        )
        fx, fy, fz, tx, ty, tz = forces[0]
        ax, ay, az, arx, ary, arz = before[2]
        place, velocity, actual = after
        # command error of each force; written out because this runs two or three times a tick
        dx, dy, dz, drx, dry, drz = ax - fx, ay - fy, az - fz, arx - tx, ary - ty, arz - tz
        place[0] += way_x * dx
        place[1] += way_y * dy
        place[2] += way_z * dz
        place[3] += way_rx * drx
        place[4] += way_ry * dry
        place[5] += way_rz * drz
        velocity[0] += by_x * dx
        velocity[1] += by_y * dy
        velocity[2] += by_z * dz
        velocity[3] += by_rx * drx
        velocity[4] += by_ry * dry
        velocity[5] += by_rz * drz
        actual[0] = fx + left * dx
        actual[1] = fy + left * dy
        actual[2] = fz + left * dz
        actual[3] = tx + left * drx
        actual[4] = ty + left * dry
        actual[5] = tz + left * drz

    def _factors(self, duration: Component) -> tuple[Component, list[Component], list[Component]]:
        """Return decay factor, displacement and velocity per unit force error.

        The last two are [m/N] and [m/s/N], six each, after a duration [s]. Results for a float duration are cached,
        because the durations recur every period.
        """
        faded = -np.expm1(-duration / self._lag)
        faded = faded if np.ndim(faded) else float(faded)
        gained = self._lag * faded
        way = self._lag * (duration - gained)
        factors = 1.0 - faded, [way * one for one in self._inverse], [gained * one for one in self._inverse]
        if duration.__class__ is float:
            _keep(self._known, duration, factors)
        return factors


def _keep(known: dict[Any, Any], key: Any, value: Any) -> None:
    """Store a value, clearing a full cache first.

    A full cache means that the durations do not recur.
    """
    if len(known) >= _MOST_KEPT:
        known.clear()
    known[key] = value


class HeldAxis:
    """Axis held by a hand, solved by transition matrix.

    The matrix is that of `motion`.

    Args:
        index: Index of the axis into AXES.
        place: Position at release [m].
        velocity: Velocity at release [m/s].
        actual: Force of the actuators at release [N].
        inertia: Mass of the flotor [kg].
        weight: Its weight along the axis [N].
        hand: The hand.
        lag: Time constant of the drivers [s]; 0 for none.
    """

    def __init__(
        self,
        index: int,
        place: Component,
        velocity: Component,
        actual: Component,
        inertia: Component,
        weight: Component,
        hand: Hand,
        lag: float,
    ) -> None:
        self._index, self._weight = index, weight
        # the states of `motion` beyond position and velocity
        self._others = [*([hand.place(place), velocity] if hand.soft else []), *([actual] if lag else [])]
        self._a, self._b = motion(inertia, hand, lag)
        self._known: dict[float | bytes, list[list[Component]]] = {}

    def amend(self, duration: Component, forces: Forces, before: Motion, after: Motion) -> None:
        """See `Amendment`."""
        index, (force, effort) = self._index, forces
        (place, velocity, _), (places, velocities, _) = before, after
        rows = self._known.get(duration) if duration.__class__ is float else None
        rows = rows or self._rows(duration)
        push, weight, pull, x, v = force[index], self._weight, effort[index], place[index], velocity[index]
        if len(rows) == 2:  # written out, at a third of the time
            (a, b, c, d, e), (p, q, r, s, t) = rows
            places[index] = a * push + b * weight + c * pull + d * x + e * v
            velocities[index] = p * push + q * weight + r * pull + s * x + t * v
            return
        known = push, weight, pull, x, v, *self._others
        # not sum(), which from Python 3.12 on rounds floats otherwise than arrays
        places[index], velocities[index], *self._others = [reduce(add, map(mul, row, known)) for row in rows]

    def _rows(self, duration: Component) -> list[list[Component]]:
        """Return a transition's rows as components, from the cache.

        The input columns come first. Rows are cached because durations recur.
        """
        key = duration if duration.__class__ is float else np.asarray(duration).tobytes()
        if (known := self._known.get(key)) is not None:
            return known
        whole = np.concatenate(transition(self._a, self._b, duration)[::-1], axis=-1)
        rows: list[list[Component]]
        if whole.ndim == 2:
            rows = whole.tolist()
        else:
            rows = [[entry.copy() for entry in row] for row in np.moveaxis(whole, (-2, -1), (0, 1))]
        _keep(self._known, key, rows)
        return rows


class DryFriction:
    """Coulomb friction of the device, with stops within a segment.

    Args:
        friction: Friction of the axes with friction, by index into AXES [N, N m].
        inertia: Mass and moments of inertia, six [kg, kg m²].
        weight: Weight, six [N, N m].
        single: True for one device.
    """

    def __init__(
        self,
        friction: Mapping[int, Component],
        inertia: Sequence[Component],
        weight: Sequence[Component],
        *,
        single: bool,
    ) -> None:
        self._single = single
        self._axes = [(index, rub, 1.0 / inertia[index], weight[index]) for index, rub in friction.items()]

    def amend(self, duration: Component, forces: Forces, before: Motion, after: Motion) -> None:
        """See `Amendment`."""
        (force, effort), (place, velocity, _), (places, velocities, _) = forces, before, after
        for index, rub, inverse, weight in self._axes:
            x, v, push = place[index], velocity[index], force[index] + (weight + effort[index])
            # a value common to all devices of a batch is a number too
            one = self._single or all(isinstance(part, float) for part in (push, v, x, duration, rub, inverse))
            slide = _slide if one else _slide_many
            places[index], velocities[index] = slide(duration, x, v, push, rub, inverse)


def _slide(duration: float, x: float, v: float, push: float, rub: float, inverse: float) -> tuple[float, float]:
    """Return one axis's position and velocity after sliding.

    Args:
        duration: Duration [s].
        x: Position [m, rad].
        v: Velocity [m/s, rad/s].
        push: Force without friction [N, N m].
        rub: Sliding friction, and largest static friction [N, N m].
        inverse: One over the mass or moment of inertia.
    """
    if v == 0.0 and -rub <= push <= rub:
        return x, v
    first = (push - rub if v > 0.0 or (v == 0.0 and push > 0.0) else push + rub) * inverse
    speed = v + duration * first
    if v * speed < 0.0:  # it stops within the duration
        until = -v / first
        x += until * (v + 0.5 * until * first)
        if -rub <= push <= rub:
            return x, 0.0
        left, second = duration - until, (push - rub if push > 0.0 else push + rub) * inverse
        return x + 0.5 * left * left * second, left * second
    return x + duration * (v + 0.5 * duration * first), speed


def _slide_many(
    duration: Component, x: Component, v: Component, push: Component, rub: Component, inverse: Component
) -> tuple[Component, Component]:
    """Return the result of `_slide` for a batch, (...,)."""
    rests = v == 0.0
    first = (push - np.copysign(rub, v)) * inverse
    if np.count_nonzero(rests):
        first = np.where(rests, _beyond(push, rub) * inverse, first)
    speed = v + duration * first
    place = x + duration * (v + 0.5 * duration * first)
    stops = v * speed < 0.0  # few do: these are computed again
    if np.count_nonzero(stops):
        place, speed = (np.array(part) for part in np.broadcast_arrays(place, speed))
        stops = np.nonzero(np.broadcast_to(stops, place.shape))
        parts = duration, x, v, push, rub, inverse, first
        duration, x, v, push, rub, inverse, first = (np.broadcast_to(one, place.shape)[stops] for one in parts)
        until = -v / first
        left, second = duration - until, _beyond(push, rub) * inverse
        place[stops] = x + until * (v + 0.5 * until * first) + 0.5 * left * left * second
        speed[stops] = left * second
    return place, speed


def _beyond(push: Component, rub: Component) -> Component:
    """Return the force in excess of friction [N, N m].

    (...,) for a batch.
    """
    return push - np.clip(push, -rub, rub)
