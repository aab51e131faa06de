"""Motion between samples, stored at every switch of the force, and energy.

Energy of hand and rendered environment: for a running session, from samples alone, or for a complete trace.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.timeline import Interval, Timing
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Command, Component, Sample, unit_of
from maglev_mj.parameters import numbers
from maglev_mj.result import Result

_STILL = 1e-6
"""Range of motion up to which an axis rests [m, rad]."""
_KNOTS = 0.5, 1.0, 2.0, 3.5, 6.0
"""Times after a switch at which a lagging force is recorded, in time constants."""


def lagging_parts(duration: Component, lag: float) -> list[Component]:
    """Return the parts of an interval by which a recorded curve shows the lag of the drivers [s]."""
    shortest = duration if duration.__class__ is float else float(np.min(duration))
    ends = [0.0, *(lag * knot for knot in _KNOTS if lag * knot < 0.95 * shortest)]
    return [*(end - start for start, end in pairwise(ends)), duration - ends[-1]]


BLOCK = 1000
"""Rows of a running log that are packed into arrays together: as objects they would take ten times the memory, and the
garbage collector would visit each of them again and again, so that a tick of a long run would cost twice as much."""


class TraceRecorder:
    """Recorder of the states at each switch.

    Args:
        time: Function from a tick and an offset [s] to the time [s].
        arrays: Function from K stored states to pose, twist and wrench, (K, ..., 6) each.
    """

    def __init__(
        self,
        time: Callable[[int, Component], Any],
        arrays: Callable[[Sequence[Any]], tuple[Array, Array, Array]],
    ) -> None:
        self._time, self._arrays = time, arrays
        self._rows: list[tuple[int, Component, Any]] = []
        self._blocks: list[Sequence[Array]] = []

    def add(self, tick: int, offset: Component, state: Any) -> None:
        """Store an immutable state at `offset` [s] after sample `tick`."""
        self._rows.append((tick, offset, state))
        if len(self._rows) == BLOCK:
            self._blocks.append(self._packed(self._rows))
            self._rows = []

    def finish(self, tick: int, state: Any) -> Trace:
        """Return the trace up to the state at `tick`."""
        blocks = [*self._blocks, self._packed([*self._rows, (tick, 0.0, state)])]
        return Trace(*map(np.concatenate, zip(*blocks, strict=True)))

    def _packed(self, rows: Sequence[tuple[int, Component, Any]]) -> Sequence[Array]:
        """Return times, poses, twists and wrenches of rows."""
        ticks, offsets, states = zip(*rows, strict=True)
        pose, twist, wrench = self._arrays(states)
        time = np.empty(pose.shape[:-1])
        for row, instant in enumerate(map(self._time, ticks, offsets)):
            time[row] = instant
        return time, pose, twist, wrench


def _pose(h: Array, s: Array, x0: Array, v0: Array, v1: Array, cubic: Array) -> Array:
    """Return poses on cubics of length h [s] at shares s of it."""
    return x0 + h * s * (v0 + 0.5 * s * (v1 - v0)) + cubic * s * s * (3.0 - 2.0 * s)


@dataclass(frozen=True, eq=False)
class Trace(Result):
    """Motion as knots at the switches of the wrench: the state, and the wrench until the next knot.

    Under a constant wrench the motion between knots is a parabola, which cubic Hermite interpolation reproduces
    exactly, for rotations about one axis; about several axes its error is of second order in the angle.

    Attributes:
        time: Knot times since release [s], (K, ...).
        pose: Pose at the knots [m, rad], (K, ..., 6).
        twist: Velocity at the knots [m/s, rad/s], (K, ..., 6).
        wrench: Wrench of the actuators from each knot on [N, N m], (K, ..., 6), without gravity.
        origin: Function that returns plant or scene, axes, rate and delay in words, for charts; None if unknown.
    """

    time: Array
    pose: Array
    twist: Array
    wrench: Array
    units: ClassVar = {"time": "s"} | {
        f"{name}.{axis}": unit_of(unit, axis)
        for name, unit in (("pose", "m"), ("twist", "m/s"), ("wrench", "N"))
        for axis in AXES
    }

    origin: Callable[[], str] | None = field(default=None, repr=False, kw_only=True)
    pictures: ClassVar = {"motion": "maglev_mj.plants.pictures:trace"}

    def _headline(self) -> str:
        ranges = np.ptp(self.pose, axis=0).reshape(-1, self.pose.shape[-1]).max(axis=0)
        moving = [axis for axis, moved in zip(AXES, ranges) if moved > _STILL] if len(ranges) == len(AXES) else []
        motion = f"of motion along {', '.join(moving)}" if moving else "without motion"
        return f"{np.ptp(self.time):.4g} s {motion}"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return "" if self.origin is None else self.origin()

    def columns(self) -> dict[str, Array]:
        """Return the knots as columns such as `pose.z`, (K,) each.

        Raises:
            ParameterError: If the trace is not of one device on six axes.
        """
        if self.pose.ndim != 2 or self.pose.shape[1] != len(AXES):
            raise ParameterError(f"trace must be of one device on six axes, (K, 6) (got {self.pose.shape})")
        return dict(zip(self.units, [self.time, *self.pose.T, *self.twist.T, *self.wrench.T], strict=True))

    def at(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Interpolate the motion.

        Args:
            time: Times since release [s], (M,), within the trace.

        Returns:
            Pose, twist and wrench, (M, ..., 6) each; at a switch, the wrench after it.

        Raises:
            ParameterError: If a time is outside the trace.
        """
        times, knot, h, s, x0, v0, v1, cubic = self._between(time)
        wrench = np.take_along_axis(self.wrench, knot, axis=0)
        twist = v0 + s * (v1 - v0) + cubic * 6.0 * s * (1.0 - s) / h
        final = np.abs(times.reshape(s.shape[:1] + (1,) * (s.ndim - 1)) - self.time[-1][..., None]) <= 1e-12
        return _pose(h, s, x0, v0, v1, cubic), twist, np.where(final, self.wrench[-1], wrench)

    def positions(self, time: ArrayLike) -> Array:
        """Interpolate the pose alone, (M, ..., 6): the first part of `at`, in half its time."""
        return _pose(*self._between(time)[2:])

    def _between(self, time: ArrayLike) -> tuple[Array, Any, Array, Array, Array, Array, Array, Array]:
        """Return times and the knots before them, and of the cubics from there: length, share, x0, v0, v1, cubic."""
        times = np.atleast_1d(numbers("time", time, shape="() or (M,)"))
        first, last = float(self.time[0].max()), float(self.time[-1].min())
        if times.size and not (first - 1e-12 <= times.min() and times.max() <= last + 1e-12):
            extremes = f"{times.min():g} to {times.max():g} s"
            raise ParameterError(f"time must be from {first:g} to {last:g} s (got {extremes})")
        knots = self.time.reshape(len(self.time), -1)
        # tolerance of 1 ps: switch times and grid times round differently
        index = np.stack([np.searchsorted(column, times + 1e-12, side="right") - 1 for column in knots.T], axis=-1)
        index = np.clip(index, 0, len(knots) - 2).reshape(times.shape + self.time.shape[1:])
        start, end = (np.take_along_axis(self.time, index + shift, axis=0) for shift in (0, 1))
        width = np.where(end > start, end - start, 1.0)
        elapsed = (times.reshape((-1,) + (1,) * (self.time.ndim - 1)) - start)[..., None]
        knot = index[..., None]
        x0, x1, v0, v1 = (
            np.take_along_axis(values, knot + shift, axis=0) for values in (self.pose, self.twist) for shift in (0, 1)
        )
        h = width[..., None]
        s = elapsed / h
        # cubic term in addition to the parabola through x0, v0, v1; zero to rounding under a constant wrench
        cubic = (x1 - x0) - 0.5 * h * (v0 + v1)
        return times, knot, h, s, x0, v0, v1, cubic

    def along(self, axis: int) -> Trace:
        """Return one coordinate of the motion; the last dimension is 1."""
        parts = (part[..., axis : axis + 1] for part in (self.pose, self.twist, self.wrench))
        return Trace(self.time, *parts, origin=self.origin)

    def furthest(self) -> Array:
        """Return the largest magnitude of each coordinate [m, rad], (..., 6), motion between knots included.

        Exact under a constant wrench.
        """
        poses = np.concatenate([self.pose, self.turning_points()[1]])
        return np.asarray(np.abs(poses).max(axis=0))

    def until(self, end: float) -> Trace:
        """Return the trace up to `end` [s]; later knots become copies of the state at the end.

        Raises:
            ParameterError: If `end` is outside the trace.
        """
        pose, twist, wrench = self.at(end)
        after = self.time > end
        keep = np.flatnonzero(~after.reshape(len(after), -1).all(axis=1))
        last = min(int(keep[-1]) + 2, len(after)) if keep.size else 1
        pairs = (pose, self.pose), (twist, self.twist), (wrench, self.wrench)
        parts = (np.where(after[..., None], at_end, knots)[:last] for at_end, knots in pairs)
        return Trace(np.where(after, end, self.time)[:last], *parts, origin=self.origin)

    def turning_points(self) -> tuple[Array, Array]:
        """Return times and poses of turning points between knots.

        Returns:
            Times and positions, (K - 1, ..., 6) each; for a coordinate without a turning point between two knots,
            those of the first knot. Exact under a constant wrench.
        """
        h = np.diff(self.time, axis=0)[..., None]
        v0, v1 = self.twist[:-1], self.twist[1:]
        turns = v0 * v1 < 0.0
        share = np.where(turns, v0 / np.where(turns, v0 - v1, 1.0), 0.0)
        return self.time[:-1][..., None] + share * h, self.pose[:-1] + 0.5 * share * h * v0


def actuator_work(trace: Trace, carried: ArrayLike = 0.0) -> Array:
    """Return the work of the actuators between knots [J], (K - 1, ..., 6); exact under a constant wrench.

    Args:
        trace: Motion.
        carried: Weight compensation, which is excluded [N, N m], (6,).
    """
    return np.asarray((trace.wrench[:-1] - np.asarray(carried)) * np.diff(trace.pose, axis=0))


def hand_work(poses: Array, efforts: Array) -> Array:
    """Return the work of the hand between samples [J], (N - 1, 6).

    Args:
        poses: Poses at the samples [m, rad], (N, 6).
        efforts: Wrenches of the hand from each sample on [N, N m], (N, 6).
    """
    return np.asarray(efforts[:-1] * np.diff(poses, axis=0))


class HandWork:
    """Accumulator of the work of a hand with constant wrench between samples.

    Attributes:
        total: Work since the first sample [J]; NaN if a wrench of the hand is not available (NaN).
    """

    def __init__(self) -> None:
        self._pose: Array | None = None
        self._effort: Array = np.zeros(6)
        self.total = 0.0

    def add(self, pose: Array, effort: Sequence[float]) -> None:
        """Add the work up to a sample.

        Args:
            pose: Pose at the sample [m, rad], (6,).
            effort: Wrench of the hand from the sample on [N, N m], six.
        """
        if self._pose is None:
            self._pose, self._effort = pose, np.array(effort)
        self.total += float(self._effort @ (pose - self._pose))
        self._pose, self._effort = pose, np.array(effort)

    def take(self, poses: Array, efforts: Array) -> Array:
        """Add N samples; return the totals [J], (N,), bit-identical to one `add` per sample.

        Args:
            poses: Poses at the samples [m, rad], (N, 6).
            efforts: Wrenches of the hand from each sample on [N, N m], (N, 6).
        """
        acting = np.concatenate([efforts[:1] if self._pose is None else self._effort[None], efforts[:-1]])
        travels = np.diff(poses, axis=0, prepend=poses[:1] if self._pose is None else self._pose[None])
        work = (acting[:, None, :] @ travels[:, :, None])[:, 0, 0]
        totals: Array = np.add.accumulate(np.append(self.total, work))[1:]
        self._pose, self._effort, self.total = poses[-1], efforts[-1], float(totals[-1])
        return totals


class EnergyAccount:
    """Energy balance of hand and rendered environment, updated at each sample.

    The rendered environment is all actuator action except weight compensation: walls, friction, springs. Absorbed
    energy fills an energy tank, up to a bound above the energy of any spring in the package; emitted energy empties it.
    An environment that emits more than its tank holds is not passive; one that keeps emitting is unstable.

    Args:
        pose: Initial pose [m, rad], (6,).
        carried: Weight compensation of the actuators [N, N m], (6,).
        tank: Capacity of the tank [J].

    Attributes:
        taken: Energy absorbed by the rendered environment [J]; negative if it generated energy.
        stored: Energy in the tank [J]; negative if the tank is overdrawn.
    """

    def __init__(self, pose: Array, carried: ArrayLike, *, tank: float = 0.2) -> None:
        self._pose, self._carried, self._tank = pose, np.asarray(carried), tank
        self._hand, self._work = HandWork(), 0.0
        self.taken = self.stored = 0.0

    @property
    def hand(self) -> float:
        """Work of the hand [J]."""
        return self._hand.total

    def add(self, pose: Array, effort: Sequence[float], work: float) -> None:
        """Add the energy up to a sample.

        Args:
            pose: Pose at the sample [m, rad], (6,).
            effort: Wrench of the hand from the sample on [N, N m], six.
            work: Work of the actuators since the start [J], as metered by the plant.
        """
        absorbed = float(self._carried @ (pose - self._pose)) - (work - self._work)
        self._hand.add(pose, effort)
        self.taken += absorbed
        self.stored = min(self.stored + absorbed, self._tank)
        self._pose, self._work = pose, work


class PassivityObserver:
    """Passivity observer of the rendered environment for each axis, from samples and commands alone.

    Pass it to `run` as `observe`. Between two samples up to four forces act in turn: the older command with the
    remainder of its pulse, and the newer command with its pulse. The inertia gives the displacement under each, exactly
    if the only other force is a constant load. Without inertia constant velocity is assumed, which is exact only for a
    single force per period, without delay and pulse.

    Args:
        timing: Timing of the plant.
        inertia: Mass and moments of inertia of the six axes [kg, kg m²], (6,); None for constant velocity.
        load: Other constant wrench, such as weight [N, N m], (6,).
        before: Wrench of the environment until the first command takes effect [N, N m], (6,).

    Attributes:
        energy: Absorbed energy [J], (..., 6).
        least: Minimum of the absorbed energy [J], (..., 6).

    Raises:
        ParameterError: If an inertia is not above 0.

    Source: after Hannaford & Ryu 2002 (not opened), with each force paired with the displacement during its action.
    """

    def __init__(
        self, timing: Timing, inertia: ArrayLike | None = None, load: ArrayLike = 0.0, before: ArrayLike = 0.0
    ) -> None:
        self._load = numbers("load", load)
        self._inertia = np.inf if inertia is None else numbers("inertia", inertia, at_least=1e-12)
        self._timing, self._before = timing, np.zeros(6) + numbers("before", before)
        # held wrench, wrench during the pulse and pulse width of the commands that are still in effect
        self._commands: Sequence[Array] = ()
        self._pose: Array | None = None
        self._count = 0
        self.energy: Array = np.zeros(6)
        self.least: Array = np.zeros(6)

    def __call__(self, sample: Sample, command: Command) -> None:
        """Process one sample and its command; lost samples are ignored."""
        pose = sample.pose
        held, pulse = (np.broadcast_to(wrench, pose.shape)[None] for wrench in (command.wrench, command.pulse))
        self.take(pose[None], held, pulse, np.array([0.0 if command.extra is None else command.pulse_width]))

    def take(self, poses: Array, held: Array, pulses: Array, widths: Array) -> Array:
        """Process N samples with their commands, bit-identical to one call per sample.

        Args:
            poses: Poses [m, rad], (N, ..., 6).
            held: Held wrenches of the commands [N, N m], (N, ..., 6).
            pulses: Wrenches of their pulses [N, N m], (N, ..., 6).
            widths: Pulse widths [s], (N,); 0 for no pulse.

        Returns:
            Absorbed energy up to each sample [J], (N, ..., 6).
        """
        age = self._timing.whole + 1  # periods until a command is replaced
        widths = widths.reshape(-1, *(1,) * (poses.ndim - 2))
        begun = self._pose is not None
        if self._pose is None:
            self._pose, self.energy = poses[0], np.zeros(poses.shape[1:])
            before = np.broadcast_to(self._before, (age, *poses.shape[1:]))
            self._commands = before, before, np.zeros((age, *widths.shape[1:]))
        new = held, held + pulses, widths
        commands = [np.concatenate(parts) for parts in zip(self._commands, new)]
        self._commands = [part[-age - 1 :] for part in commands]
        count, end = len(poses) - (not begun), len(commands[0]) - age
        travel = np.diff(poses, axis=0, prepend=self._pose[None])[len(poses) - count :]
        work = self._work(travel, self._intervals(*(part[end - count - 1 : end] for part in commands)))
        energy: Array = np.subtract.accumulate(np.concatenate([self.energy[None], work]))[int(begun) :]
        self.energy, self._pose, self._count = energy[-1], poses[-1], self._count + count
        self.least = np.minimum(self.least, energy.min(axis=0))
        return energy

    def _intervals(self, held: Array, pulsed: Array, width: Array) -> list[Interval]:
        """Return the intervals of the next K periods, as in `Timeline`; absent intervals have duration 0.

        Args:
            held: Held wrenches of the previous period and of the commands that take effect in these periods [N, N m],
                (K + 1, ..., 6).
            pulsed: Wrenches during the pulses [N, N m], (K + 1, ..., 6).
            width: Pulse widths [s], (K + 1, ...).
        """
        timing, ticks = self._timing, range(self._count - 1, self._count + len(held) - 1)
        rest = np.array([timing.rest_at(max(tick, 0)) for tick in ticks] if timing.jitter else [timing.rest])
        start, after = rest[-len(held) + 1 :], timing.period - rest
        if not width.any():
            return [(start[..., None], held[:-1]), (after[-len(held) + 1 :, ..., None], held[1:])]
        inside = np.minimum(width, after)
        remaining = np.minimum(self._rounded(width - inside)[:-1], start)
        durations = (
            self._rounded(remaining),
            self._rounded(start - remaining),
            self._rounded(inside[1:]),
            self._rounded((after - inside)[1:]),
        )
        forces = pulsed[:-1], held[:-1], pulsed[1:], held[1:]
        return [(duration[..., None], force) for duration, force in zip(durations, forces)]

    def _rounded(self, duration: Array) -> Array:
        """Return durations, with rounding errors set to 0."""
        return np.where(duration > self._timing.negligible, duration, 0.0)

    def _work(self, travel: Array, periods: Sequence[Interval]) -> Array:
        """Return the work of the forces over a period from the displacement between its samples."""
        intervals = [
            (duration, force, duration * ((force + self._load) / self._inertia)) for duration, force in periods
        ]
        # initial speed for which the intervals sum to the displacement between the samples
        position: Component = 0.0
        speed: Component = 0.0
        for duration, _, change in intervals:
            position, speed = position + duration * (speed + 0.5 * change), speed + change
        work: Component = 0.0
        speed = (travel - position) / self._timing.period
        for duration, force, change in intervals:
            work, speed = work + force * duration * (speed + 0.5 * change), speed + change
        return np.asarray(work)
