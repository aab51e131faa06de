"""Exact plant: decoupled rigid-body axes in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from operator import add, mul
from typing import Any, TypeAlias, Unpack

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.timeline import Timing
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component, Six, components, join
from maglev_mj.keywords import checked
from maglev_mj.parameters import LAG, number, numbers, six
from maglev_mj.plants.base import PlantKeywords, SampledPlant
from maglev_mj.plants.hand import Hand, motion, transition
from maglev_mj.plants.model import Model, acceleration, drivers_lag, load_model
from maglev_mj.plants.sensor import Measure
from maglev_mj.spec import DRIVER_TIME_CONSTANT, GRAVITY, INERTIA

Drive: TypeAlias = tuple[Six, Six]
"""Accelerations with gravity [m/s², rad/s²] and forces [N, N m], six components each."""

_Snapshot: TypeAlias = tuple[Sequence[Component], Sequence[Component], Sequence[Component]]
"""Position, velocity and actuator force, six components each."""


@checked(own="escape model sensor")
class ExactPlant(SampledPlant):
    """One or N devices with closed-form motion between force switches.

    Each coordinate is a mass m under a constant force F: x(t) = x0 + v0 t + F t² / (2 m).

    Exact for translation, and for rotation about one principal axis; the coupling between rotations, of
    second order in the angle, is neglected. Driver lag, a hand and dry friction have closed forms too.

    Args:
        timing: Sample period, delay and phase; delays and phases (N,) need a pose (N, 6).
        model: Source of mass, moments of inertia, gravity and drivers, as for `MuJoCoPlant`; None for the published
            device.
        mass: Mass of the flotor with its handle [kg], instead of the model's; (N,) for N devices.
        inertia: Moments of inertia about x, y, z [kg m²], (3,), instead of the model's.
        pose: Pose at release [m, rad], (..., 6).
        twist: Velocity at release [m/s, rad/s], (..., 6).
        gravity: Gravitational acceleration along -z, or in stator axes (3,) for a tilted base [m/s²], instead of the
            model's.
        driver_lag: First-order lag of the drivers; None for that of a device file.
        driver_time_constant: Time constant of that lag [s], instead of the model's.
        hand: Hand on the flotor.
        dry_friction: Coulomb friction of the device itself [N, N m], (..., 6) or a number; not with driver lag, and
            not on an axis held by a hand.
        keywords: Those of `SampledPlant`: wrench, wrench_limit, sensor, escape, record, metered.

    Attributes:
        inertia: Mass and moments of inertia [kg, kg m²], (..., 6).
        load: Weight [N, N m], (..., 6).
        start: Pose and twist at release [m, rad; m/s, rad/s], (..., 6) each.

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.

    Example:
        >>> from maglev_mj import Command, ExactPlant
        >>> with ExactPlant() as plant:
        ...     start = plant.read()
        ...     written = plant.write(Command([0.0] * 6))
        ...     fallen = plant.read()
        >>> fallen.time, round(fallen.position[2], 9)  # -g t²/2
        (0.005, -0.000122625)
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
        gravity: ArrayLike | None = None,
        driver_lag: bool | None = None,
        driver_time_constant: float | None = None,
        hand: Hand | None = None,
        dry_friction: ArrayLike | None = None,
        **keywords: Unpack[PlantKeywords],
    ) -> None:
        timing = timing or Timing()
        moving, moments, lag, fall = INERTIA[0], np.array(INERTIA[3:]), DRIVER_TIME_CONSTANT, acceleration(GRAVITY)
        if isinstance(model, Device):
            moving, moments, lag = model.mass, model.inertia[3:], model.driver.time_constant
            fall = np.array(model.body.gravity)
        elif model is not None:
            device = load_model(model, driver_time_constant=driver_time_constant)
            moving, moments, lag = device.mass, device.inertia, device.driver_time_constant
            fall = device.gravity
        if driver_time_constant is not None:
            lag = number("driver_time_constant", driver_time_constant, above=0.0, **LAG)
        start = _start(timing, pose, twist)
        batch = start[0].shape[:-1]
        body = _body(moving if mass is None else mass, moments if inertia is None else inertia, batch)
        gx, gy, gz = self._fall = (fall if gravity is None else acceleration(gravity)).tolist()
        self.hand = hand
        self.inertia = join(body)
        self._body = tuple(1.0 / value for value in body[2:])
        self._weight = gx * body[0], gy * body[1], gz * body[2], 0.0, 0.0, 0.0
        self.load = join(self._weight) + 0.0
        self._lag = drivers_lag(model, driver_lag, lag)
        special = self._lag or hand is not None or dry_friction is not None
        self._uses_force = bool(special or keywords.get("record") or keywords.get("metered"))
        super().__init__(timing, batch=batch, **keywords)
        self._amendments = tuple(self._amended(body, hand, dry_friction)) if special else ()
        self._release(timing, start, self._started())

    def _checked_start(self, timing: Timing, pose: ArrayLike, twist: ArrayLike) -> tuple[Array, Array]:
        start = _start(timing, pose, twist)
        if start[0].shape[:-1] != self.batch:
            shape = start[0].shape[:-1]
            raise ParameterError(
                f"pose, twist and phase must have the batch shape {self.batch} of the plant (got {shape})"
            )
        return start

    def _release(self, timing: Timing, start: tuple[Array, Array], measure: Measure | None) -> None:
        pose, twist = start
        self._pose, self._velocity = _shared(components(pose)), _shared(components(twist))
        super()._release(timing, start, measure)
        self._pull: tuple[Component, ...] | None = None
        self._actual = components(self.before) if self._amendments else []
        for amendment in self._amendments:
            if isinstance(amendment, HeldAxis):
                amendment.release(self._pose, self._velocity, self._actual)

    def _amended(
        self, body: list[Component], hand: Hand | None, dry_friction: ArrayLike | None
    ) -> Iterator[Lag | DryFriction | HeldAxis]:
        """Yield the corrections to the motion of free masses."""
        rub = None if dry_friction is None else six("dry_friction", dry_friction, self.batch, finite=True)
        held = hand.indices if hand is not None else ()
        if hand is not None and hand.shape not in ((), self.batch):
            raise ParameterError(f"hand must be scalar or of batch shape {self.batch} (got {hand.shape})")
        if rub is not None and self._lag:
            raise ParameterError(
                "dry_friction and driver_lag cannot be combined: no closed form (driver_lag=False leaves out the lag)"
            )
        if self._lag:
            yield Lag(body, self._lag)
        if rub is not None:
            friction = {index: part for index, part in enumerate(components(rub)) if np.any(np.asarray(part) > 0.0)}
            if not friction.keys().isdisjoint(held):
                raise ParameterError("dry_friction must be 0 on an axis held by a hand")
            yield DryFriction(friction, body, self._weight, single=not self.batch)
        for index in held:
            assert hand is not None
            yield HeldAxis(index, body[index], self._weight[index], hand, self._lag)

    def _prepare(self, force: Six) -> Drive:
        fx, fy, fz, tx, ty, tz = force
        per_mass, by_x, by_y, by_z = self._body
        gx, gy, gz = self._fall
        if self._uses_force:  # copied: the caller may reuse its list or arrays
            force = [part if part.__class__ is float else np.array(part) for part in force]
        x, y, z = fx * per_mass, fy * per_mass, fz * per_mass + gz
        if gx or gy:
            x, y = x + gx, y + gy
        return (x, y, z, tx * by_x, ty * by_y, tz * by_z), force

    def _advance(self, duration: Component, drive: Drive, pieces: int = 1) -> None:
        pose, velocity = self._pose, self._velocity
        half = 0.5 * duration
        # written out for speed, as in `FiniteDifference`: runs two or three times per tick
        ax, ay, az, arx, ary, arz = drive[0]
        if (pull := self._pull) is not None:
            ax, ay, az = ax + pull[0], ay + pull[1], az + pull[2]
            arx, ary, arz = arx + pull[3], ary + pull[4], arz + pull[5]
        x, y, z, rx, ry, rz = pose
        u, v, w, p, q, r = velocity
        self._pose = [
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
        if self._amendments:
            forces = drive[1], self._effort
            before, after = (pose, velocity, self._actual), (self._pose, self._velocity, list(drive[1]))
            for amendment in self._amendments:
                amendment.amend(duration, forces, before, after)
            self._actual = after[2]

    def _where(self) -> Sequence[Component]:
        return self._pose

    def _work(self, drive: Drive, before: Sequence[Component], after: Sequence[Component]) -> Component:
        return sum(force * (end - start) for force, start, end in zip(drive[1], before, after))

    def _exert(self, effort: Six) -> None:
        per_mass, by_x, by_y, by_z = self._body
        fx, fy, fz, tx, ty, tz = effort
        self._pull = fx * per_mass, fy * per_mass, fz * per_mass, tx * by_x, ty * by_y, tz * by_z

    def _motion(self) -> tuple[Six, Six]:
        return self._pose, self._velocity

    def _position(self) -> list[Component]:
        self._check_escape(self._pose)
        return self._pose.copy()

    def _snapshot(self, drive: Drive) -> _Snapshot:
        return self._pose, self._velocity, self._actual if self._lag else drive[1]

    def _arrays(self, snapshots: Sequence[_Snapshot]) -> tuple[Array, Array, Array]:
        pose, twist, wrench = map(self._stacked, zip(*snapshots))
        return pose, twist, wrench

    def _stacked(self, rows: Sequence[Sequence[Component]]) -> Array:
        """Return K rows of components as (K, ..., 6)."""
        if not self.batch:
            return np.array(rows, dtype=np.float64)
        stacked = np.empty((len(rows), *self.batch, 6))
        for array, row in zip(stacked, rows, strict=True):
            for axis, part in enumerate(row):
                array[..., axis] = part
        return stacked


def _start(timing: Timing, pose: ArrayLike, twist: ArrayLike) -> tuple[Array, Array]:
    """Return checked copies of pose and twist, of one shape."""
    start, motion = (numbers(name, part, shape="(..., 6)").copy() for name, part in (("pose", pose), ("twist", twist)))
    shapes = (start.shape, motion.shape, (*np.shape(timing.phase), 6))
    try:
        shape = np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"pose, twist and phase must have one batch shape (got {shapes})") from None
    return np.broadcast_to(start, shape), np.broadcast_to(motion, shape)


def _body(mass: ArrayLike, inertia: ArrayLike, batch: tuple[int, ...]) -> list[Any]:
    """Return checked mass and moments of inertia of the six axes."""
    masses = numbers("mass", mass, shape=f"() or {batch}", above=0.0)
    moments = numbers("inertia", inertia, shape="(3,)", above=0.0)
    return [*[masses if masses.ndim else float(masses)] * 3, *moments.tolist()]


def _shared(parts: list[Component]) -> list[Component]:
    """Replace components common to all devices by numbers, for speed; one stays an array, to mark a batch."""
    shared = [float(part.flat[0]) if np.size(part) > 1 and (part == part.flat[0]).all() else part for part in parts]
    if np.ndim(parts[0]) and not any(np.ndim(part) for part in shared):
        shared[2] = parts[2]
    return shared


_CACHE_SIZE = 64

Motion: TypeAlias = tuple[list[Component], list[Component], list[Component]]
"""Position [m, rad], velocity [m/s, rad/s] and actuator force [N, N m], with driver lag; six components each."""

Forces: TypeAlias = tuple[Six, Six]
"""Commanded wrench and wrench of the hand's muscles [N, N m], six components each."""


class Lag:
    """First-order lag of the drivers: f(t) = u + (f(0) - u) exp(-t / lag), integrated twice.

    Args:
        inertia: Mass and moments of inertia, six [kg, kg m²].
        lag: Time constant [s].
    """

    def __init__(self, inertia: Six, lag: float) -> None:
        self._inverse, self._lag = [1.0 / value for value in inertia], lag
        self._cache: dict[float, tuple[Component, list[Component], list[Component]]] = {}

    def amend(self, duration: Component, forces: Forces, before: Motion, after: Motion) -> None:
        """Correct in place the motion `after` that free masses reach in `duration` [s] from `before`."""
        factors = self._cache.get(duration) if duration.__class__ is float else None
        left, (way_x, way_y, way_z, way_rx, way_ry, way_rz), (by_x, by_y, by_z, by_rx, by_ry, by_rz) = (
            factors or self._factors(duration)
        )
        fx, fy, fz, tx, ty, tz = forces[0]
        ax, ay, az, arx, ary, arz = before[2]
        place, velocity, actual = after
        # force errors; written out for speed: runs two or three times per tick
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
        """Return decay factor, and displacement [m/N] and velocity [m/s/N] per unit force error, six each.

        Cached for float durations, which recur every period.
        """
        decay = -np.expm1(-duration / self._lag)
        decay = decay if np.ndim(decay) else float(decay)
        first = self._lag * decay
        second = self._lag * (duration - first)
        factors = (
            1.0 - decay,
            [second * inverse for inverse in self._inverse],
            [first * inverse for inverse in self._inverse],
        )
        if duration.__class__ is float:
            _keep(self._cache, duration, factors)
        return factors


def _keep(cache: dict[Any, Any], key: Any, value: Any) -> None:
    """Store a value; clear a full cache first, because its durations do not recur."""
    if len(cache) >= _CACHE_SIZE:
        cache.clear()
    cache[key] = value


class HeldAxis:
    """Axis held by a hand, solved by the transition matrix of `motion`.

    Args:
        index: Index of the axis into AXES.
        inertia: Mass of the flotor [kg].
        weight: Its weight along the axis [N].
        hand: Hand.
        lag: Time constant of the drivers [s]; 0 for no lag.
    """

    def __init__(self, index: int, inertia: Component, weight: Component, hand: Hand, lag: float) -> None:
        self._index, self._weight, self._hand, self._lag = index, weight, hand, lag
        self._others: list[Component] = []  # states of `motion` after position and velocity
        self._a, self._b = motion(inertia, hand, lag)
        self._cache: dict[float | bytes, list[list[Component]]] = {}

    def release(self, pose: Six, velocity: Six, actual: Six) -> None:
        """Start at a pose [m, rad] and velocity [m/s, rad/s] under actuator forces [N, N m], six components each."""
        index, hand = self._index, self._hand
        own = [hand.position_at_rest(pose[index]), velocity[index]] if hand.soft else []
        self._others = [*own, *([actual[index]] if self._lag else [])]

    def amend(self, duration: Component, forces: Forces, before: Motion, after: Motion) -> None:
        """Correct the motion `after` in place; see `Lag`."""
        index, (force, effort) = self._index, forces
        (place, velocity, _), (places, velocities, _) = before, after
        rows = self._cache.get(duration) if duration.__class__ is float else None
        rows = rows or self._rows(duration)
        push, weight, pull, x, v = force[index], self._weight, effort[index], place[index], velocity[index]
        if len(rows) == 2:  # written out: a third of the time
            (a, b, c, d, e), (p, q, r, s, t) = rows
            places[index] = a * push + b * weight + c * pull + d * x + e * v
            velocities[index] = p * push + q * weight + r * pull + s * x + t * v
            return
        inputs = push, weight, pull, x, v, *self._others
        # not sum(): since Python 3.12 it rounds floats and arrays differently
        places[index], velocities[index], *self._others = [reduce(add, map(mul, row, inputs)) for row in rows]

    def _rows(self, duration: Component) -> list[list[Component]]:
        """Return the rows of the transition as components, input columns first; cached."""
        key = duration if duration.__class__ is float else np.asarray(duration).tobytes()
        if (cached := self._cache.get(key)) is not None:
            return cached
        matrix = np.concatenate(transition(self._a, self._b, duration)[::-1], axis=-1)
        rows: list[list[Component]]
        if matrix.ndim == 2:
            rows = matrix.tolist()
        else:
            rows = [[entry.copy() for entry in row] for row in np.moveaxis(matrix, (-2, -1), (0, 1))]
        _keep(self._cache, key, rows)
        return rows


class DryFriction:
    """Coulomb friction of the device; the flotor may come to rest within an interval.

    Args:
        friction: Friction by index into AXES [N, N m], of the axes that have it.
        inertia: Mass and moments of inertia, six [kg, kg m²].
        weight: Weight, six [N, N m].
        single: True for one device.
    """

    def __init__(self, friction: Mapping[int, Component], inertia: Six, weight: Six, *, single: bool) -> None:
        self._single = single
        self._axes = [(index, rub, 1.0 / inertia[index], weight[index]) for index, rub in friction.items()]

    def amend(self, duration: Component, forces: Forces, before: Motion, after: Motion) -> None:
        """Correct the motion `after` in place; see `Lag`."""
        (force, effort), (place, velocity, _), (places, velocities, _) = forces, before, after
        for index, rub, inverse, weight in self._axes:
            x, v, push = place[index], velocity[index], force[index] + (weight + effort[index])
            # values common to all devices of a batch are numbers too
            scalar = self._single or all(isinstance(part, float) for part in (push, v, x, duration, rub, inverse))
            slide = _slide if scalar else _slide_many
            places[index], velocities[index] = slide(duration, x, v, push, rub, inverse)


def _slide(duration: float, x: float, v: float, push: float, rub: float, inverse: float) -> tuple[float, float]:
    """Return position and velocity of one axis under Coulomb friction, m dv/dt = push - rub sgn(v).

    Args:
        duration: Duration [s].
        x: Position [m, rad].
        v: Velocity [m/s, rad/s].
        push: Force without friction [N, N m].
        rub: Sliding friction, and largest static friction [N, N m].
        inverse: Reciprocal of the mass or moment of inertia.
    """
    if v == 0.0 and -rub <= push <= rub:
        return x, v
    first = (push - rub if v > 0.0 or (v == 0.0 and push > 0.0) else push + rub) * inverse
    speed = v + duration * first
    if v * speed < 0.0:  # comes to rest within the duration
        until = -v / first
        x += until * (v + 0.5 * until * first)
        if -rub <= push <= rub:
            return x, 0.0
        remaining, second = duration - until, (push - rub if push > 0.0 else push + rub) * inverse
        return x + 0.5 * remaining * remaining * second, remaining * second
    return x + duration * (v + 0.5 * duration * first), speed


def _slide_many(
    duration: Component, x: Component, v: Component, push: Component, rub: Component, inverse: Component
) -> tuple[Component, Component]:
    """Return the result of `_slide` for a batch, (...,)."""
    static = v == 0.0
    first = (push - np.copysign(rub, v)) * inverse
    if np.count_nonzero(static):
        first = np.where(static, _excess(push, rub) * inverse, first)
    speed = v + duration * first
    position = x + duration * (v + 0.5 * duration * first)
    stops = v * speed < 0.0  # few: recomputed
    if np.count_nonzero(stops):
        position, speed = (np.array(part) for part in np.broadcast_arrays(position, speed))
        stops = np.nonzero(np.broadcast_to(stops, position.shape))
        parts = duration, x, v, push, rub, inverse, first
        duration, x, v, push, rub, inverse, first = (np.broadcast_to(part, position.shape)[stops] for part in parts)
        until = -v / first
        remaining, second = duration - until, _excess(push, rub) * inverse
        position[stops] = x + until * (v + 0.5 * until * first) + 0.5 * remaining * remaining * second
        speed[stops] = remaining * second
    return position, speed


def _excess(push: Component, rub: Component) -> Component:
    """Return the force in excess of friction [N, N m]."""
    return push - np.clip(push, -rub, rub)
