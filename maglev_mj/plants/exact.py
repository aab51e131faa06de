"""The exact plant: a rigid body on six decoupled axes, closed form from switch to switch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias, Unpack

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component, components, join
from maglev_mj.hand import Hand, motion, transition
from maglev_mj.model import Model, load
from maglev_mj.parameters import flag, number, numbers
from maglev_mj.plants.base import PlantKeywords, SampledPlant
from maglev_mj.spec import DRIVER_TIME_CONSTANT, GRAVITY, INERTIA
from maglev_mj.timeline import Timing

__all__ = ["ExactPlant"]


Drive: TypeAlias = tuple[Sequence[Component], Sequence[Component]]
"""Acceleration of each axis, gravity included [m/s², rad/s²], and the force behind it [N, N m]."""


class ExactPlant(SampledPlant):
    """One device or N of them, each coordinate a mass under a constant force: no integrator at all.

    Exact for translation, and for rotation about one principal axis; the coupling between rotations, of
    second order in the angle, is left out. Driver lag, a hand and dry friction have closed forms too.

    Args:
        timing: Sample period, delay and phase; (N,) delays and phases go with a pose (N, 6).
        model: The device whose mass, moments and drivers these are, as for `MuJoCoPlant`; None for the published one.
        mass: Mass of the flotor with its handle in place of the model's [kg]; (N,) for N devices that differ.
        inertia: Moments of inertia about x, y, z in place of the model's [kg m²], (3,).
        pose: Pose at release [m, rad], (..., 6).
        twist: Velocity at release [m/s, rad/s], (..., 6).
        gravity: Acceleration of free fall along -z [m/s²].
        driver_lag: Switch the current drivers' first-order lag on.
        driver_time_constant: Time constant of that lag in place of the model's [s].
        hand: A hand on the flotor.
        dry_friction: Coulomb friction of the device itself [N, N m], (..., 6) or a number; not together with
            driver lag, nor on an axis that a hand holds.
        keywords: Those of `SampledPlant`: wrench, wrench_limit, sensor, escape, record, metered.

    Attributes:
        inertia: Mass and moments of inertia [kg, kg m²], (..., 6).
        load: Weight [N, N m], (..., 6).
        start: Pose and twist at release [m, rad; m/s, rad/s], (..., 6) each.

    Raises:
        ParameterError: If a value is outside its bounds or the shapes do not fit.
    """

    def __init__(
        self,
        timing: Timing | None = None,
        *,
        model: Model | None = None,
        mass: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        pose: ArrayLike = (0.0,) * 6,
        twist: ArrayLike = (0.0,) * 6,
        gravity: float = GRAVITY,
        driver_lag: bool = False,
        driver_time_constant: float | None = None,
        hand: Hand | None = None,
        dry_friction: ArrayLike | None = None,
        **keywords: Unpack[PlantKeywords],
    ) -> None:
        timing = timing or Timing()
        moving, moments, lag = INERTIA[0], np.array(INERTIA[3:]), DRIVER_TIME_CONSTANT
        if model is not None:
            device = load(model, driver_lag=driver_lag, driver_time_constant=driver_time_constant)
            moving, moments, lag = device.mass, device.inertia, device.driver_time_constant
        if driver_time_constant is not None:
            lag = number("driver_time_constant", driver_time_constant, above=0.0)
        start, motion, body = _start(
            timing, pose, twist, moving if mass is None else mass, moments if inertia is None else inertia
        )
        fall = -number("gravity", gravity)
        self.hand, self.start = hand, (start, motion)
        self.inertia = join(body)
        self._body = (*(1.0 / value for value in body[2:]), fall)
        self._weight = (0.0, 0.0, fall * body[2], 0.0, 0.0, 0.0)
        self.load = join(self._weight) + 0.0
        self._place, self._velocity = _shared(components(start)), _shared(components(motion))
        self._lag = lag if flag("driver_lag", driver_lag) else 0.0
        if keywords.get("record") and self._lag:
            # only the recorded curve needs the pieces: the state itself is exact over any stretch
            keywords["longest_step"] = 0.25 * self._lag
        super().__init__(timing, batch=start.shape[:-1], **keywords)
        self._axes: list[_AxisMotion] | None = None
        self._pull: tuple[Component, ...] | None = None
        if driver_lag or hand is not None or dry_friction is not None:
            self._axes = self._special_axes(body, hand, dry_friction)

    def _special_axes(self, body: list[float], hand: Hand | None, dry_friction: ArrayLike | None) -> list[_AxisMotion]:
        """Return how each axis moves where that is not as a free mass."""
        rub = None if dry_friction is None else self.six("dry_friction", dry_friction, finite=True)
        held = hand.indices if hand is not None else ()
        if hand is not None and hand.shape not in ((), self.batch):
            raise ParameterError(f"hand must be one, or one for each device of {self.batch}, not {hand.shape}")
        if rub is not None and self._lag:
            raise ParameterError("dry_friction must be without driver_lag: the two have no closed form together")
        frictions = [0.0] * 6 if rub is None else components(np.broadcast_to(rub, (*rub.shape[:-1], 6)))
        axes: list[_AxisMotion] = []
        start = zip(self._place, self._velocity, self._timeline.acting[1], body, frictions, strict=True)
        for index, (place, velocity, force, inertia, friction) in enumerate(start):
            if index in held and np.any(np.asarray(friction) > 0.0):
                raise ParameterError("dry_friction must be 0 on an axis that a hand holds")
            if hand is not None and index in held:
                axes.append(_HeldAxis(place, velocity, force, inertia, hand, self._lag))
            elif self._lag:
                axes.append(_LaggedAxis(place, velocity, force, inertia, self._lag))
            elif np.any(np.asarray(friction) > 0.0):
                axes.append(_RubbingAxis(place, velocity, force, inertia, friction))
            else:
                axes.append(_FreeAxis(place, velocity, force, inertia))
        return axes

    def _prepare(self, force: Sequence[Component]) -> Drive:
        fx, fy, fz, tx, ty, tz = force
        one, by_x, by_y, by_z, fall = self._body
        return (fx * one, fy * one, fz * one + fall, tx * by_x, ty * by_y, tz * by_z), force

    def _advance(self, duration: Component, drive: Drive, pieces: int = 1) -> None:
        if self._axes is not None:
            position, velocity = self._place.copy(), self._velocity
            self._place = position
            for index, (moving, command, weight, effort) in enumerate(
                zip(self._axes, drive[1], self._weight, self._effort)
            ):
                moving.advance(duration, command, weight, effort)
                position[index], velocity[index] = moving.place, moving.velocity
            return
        half = 0.5 * duration
        # written out, as in `FiniteDifference`: this runs two or three times a tick
        ax, ay, az, arx, ary, arz = drive[0]
        if (pull := self._pull) is not None:
            ax, ay, az = ax + pull[0], ay + pull[1], az + pull[2]
            arx, ary, arz = arx + pull[3], ary + pull[4], arz + pull[5]
        x, y, z, rx, ry, rz = self._place
        u, v, w, p, q, r = self._velocity
        self._place = [
            x + duration * (u + half * ax),
            y + duration * (v + half * ay),
            z + duration * (w + half * az),
            rx + duration * (p + half * arx),
            ry + duration * (q + half * ary),
            rz + duration * (r + half * arz),
        ]
        self._velocity = [
            u + duration * ax,
            v + duration * ay,
            w + duration * az,
            p + duration * arx,
            q + duration * ary,
            r + duration * arz,
        ]

    def _where(self) -> Sequence[Component]:
        return self._place

    def _work(self, drive: Drive, before: Sequence[Component], after: Sequence[Component]) -> Component:
        return sum(force * (end - start) for force, start, end in zip(drive[1], before, after))

    def _exert(self, effort: Sequence[Component]) -> None:
        one, by_x, by_y, by_z, _ = self._body
        fx, fy, fz, tx, ty, tz = effort
        self._pull = fx * one, fy * one, fz * one, tx * by_x, ty * by_y, tz * by_z

    def _position(self) -> list[Component]:
        self._check_escape(self._place)
        return self._place.copy()

    def _state(self, drive: Drive) -> tuple[Array, Array, Array]:
        force = drive[1]
        if self._axes is not None and self._lag:
            force = [axis.actual for axis in self._axes]
        shape = (*self.batch, 6)
        pose, twist, wrench = (np.broadcast_to(join(part), shape) for part in (self._place, self._velocity, force))
        return pose, twist, wrench


def _start(
    timing: Timing, pose: ArrayLike, twist: ArrayLike, mass: ArrayLike, inertia: ArrayLike
) -> tuple[Array, Array, list[Any]]:
    """Return checked pose and twist at release, of one shape, and mass and moments of inertia for the six axes."""
    start, motion = numbers("pose", pose), numbers("twist", twist)
    moments = numbers("inertia", inertia, at_least=0.0)
    shapes = (start.shape, motion.shape, (*np.shape(timing.phase), 6))
    if moments.shape != (3,) or any(shape[-1:] != (6,) for shape in shapes):
        raise ParameterError(
            f"pose and twist must be (..., 6) and inertia (3,), not {start.shape}, {motion.shape} and {moments.shape}"
        )
    try:
        shape = np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"pose, twist and phase must fit one batch, not {shapes}") from None
    masses = numbers("mass", mass) if np.ndim(mass) else number("mass", mass, above=0.0)
    if np.shape(masses) not in ((), shape[:-1]) or not np.all(masses > 0.0):
        raise ParameterError(f"mass must be above 0, a number or one for each device of {shape[:-1]}, not {mass!r}")
    body = [masses] * 3 + [number("inertia", value, above=0.0) for value in moments]
    return np.broadcast_to(start, shape), np.broadcast_to(motion, shape), body


def _shared(parts: list[Component]) -> list[Component]:
    """Return components of a batch with a number for each that all devices agree on: it stays one as they move alike.

    One of them stays an array in any case, so that a batch is seen to be one.
    """
    shared = [float(part.flat[0]) if np.size(part) > 1 and (part == part.flat[0]).all() else part for part in parts]
    if np.ndim(parts[0]) and not any(np.ndim(part) for part in shared):
        shared[2] = parts[2]
    return shared


class _AxisMotion(Protocol):
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


class _FreeAxis:
    """A mass, and nothing else."""

    def __init__(self, place: Component, velocity: Component, actual: Component, inertia: float) -> None:
        self.place, self.velocity, self.actual = place, velocity, actual
        self._inverse = 1.0 / inertia

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """See `_AxisMotion`."""
        acceleration = (command + weight + effort) * self._inverse
        self.place = self.place + duration * (self.velocity + 0.5 * duration * acceleration)
        self.velocity = self.velocity + duration * acceleration
        self.actual = command


class _LaggedAxis:
    """A mass behind first-order drivers: actual force = command + (actual - command) exp(-t / lag)."""

    def __init__(self, place: Component, velocity: Component, actual: Component, inertia: float, lag: float) -> None:
        self.place, self.velocity, self.actual = place, velocity, actual
        self._inverse, self._lag = 1.0 / inertia, lag

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """See `_AxisMotion`; the exponential is integrated twice."""
        lag, faded = self._lag, -np.expm1(-duration / self._lag)
        acceleration, missing = (command + weight + effort) * self._inverse, (self.actual - command) * self._inverse
        gained = missing * lag * faded
        travel = self.velocity + 0.5 * duration * acceleration + missing * lag
        self.place = self.place + duration * travel - lag * gained
        self.velocity = self.velocity + duration * acceleration + gained
        self.actual = command + (self.actual - command) * (1.0 - faded)


class _HeldAxis:
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
        """See `_AxisMotion`."""
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


class _RubbingAxis:
    """A mass with dry friction of its own: it stops, stays, or turns back within the stretch."""

    def __init__(
        self, place: Component, velocity: Component, actual: Component, inertia: float, friction: Component
    ) -> None:
        self.place, self.velocity, self.actual = place, velocity, actual
        self._inverse, self._friction = 1.0 / inertia, friction

    def advance(self, duration: Component, command: Component, weight: Component, effort: Component) -> None:
        """See `_AxisMotion`."""
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
