"""Base class of simulated plants: sampling, limits, sensor, energy metering and errors."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from math import isfinite
from typing import Any, ClassVar, Self, TypeAlias, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.timeline import Interval, Timeline, Timing
from maglev_mj.errors import DivergenceError, PlantError, check_instance
from maglev_mj.frames import (
    AXES,
    Array,
    Command,
    Component,
    DeviceWall,
    Sample,
    Six,
    clipped,
    components,
    is_finite,
    join,
    not_finite,
)
from maglev_mj.keywords import checked, every_tick
from maglev_mj.parameters import flag, number, numbers, six
from maglev_mj.plants.device_walls import DeviceWalls, HeldWalls
from maglev_mj.plants.hand import Hand, HandForce
from maglev_mj.plants.sensor import Measure, PoseSensor, measuring
from maglev_mj.plants.trace import HandWork, Trace, TraceRecorder, lagging_parts
from maglev_mj.result import conditions_text
from maglev_mj.spec import ESCAPE

_NO_EFFORT: Six = (0.0,) * 6


class PlantKeywords(TypedDict, total=False):
    """Keywords of `SampledPlant` accepted by its subclasses."""

    wrench: ArrayLike
    wrench_limit: ArrayLike | None
    sensor: PoseSensor | None
    escape: tuple[float, float]
    record: bool
    longest_step: float | None
    hand_force: HandForce | None
    metered: bool


@checked(own="escape sensor")
class SampledPlant(ABC):
    """Simulated device under a piecewise constant wrench.

    A `Timeline` gives the switching instants of the wrench; a subclass only advances its state from one to the next.

    Args:
        timing: Sample period, delay and phase.
        batch: Batch shape; () for one device.
        wrench: Actuator wrench from release until the first command takes effect, (..., 6) [N, N m].
        wrench_limit: Largest wrench, (..., 6) or a number [N, N m]; infinity or None for no limit.
        sensor: Pose sensor; None for an ideal sensor.
        escape: Divergence bounds: distance and angle from the centre [m, rad].
        record: Store the state at every switch, for `trace()`.
        longest_step: Longest time between two stored or computed states [s]; None for no bound.
        hand_force: Force of a hand's muscles from the first sample on: on the flotor, or on the hand's own mass in a
            soft grip.
        metered: Integrate the work of the actuators, for `work`.

    Attributes:
        before: Wrench of the actuators until the first command takes effect [N, N m], (..., 6).
        given: Constructor arguments by name.
        hand: Impedance of the hand on the flotor; None without a hand.
        start: Pose and twist at release [m, rad; m/s, rad/s], (..., 6) each.
        unanswered: Last sample until its command is written, then None; see `Plant`.
    """

    # rarely used attributes, in slots: lookup is slower in an object with more than 30 attributes
    __slots__ = (
        "__dict__",
        "__weakref__",
        "_lag",
        "_longest_step",
        "_release_options",
        "_walls",
        "batch",
        "before",
        "given",
        "inertia",
        "load",
        "start",
    )

    _lag: float  # time constant of the drivers [s]; 0 for none

    renders_walls: ClassVar[bool] = True
    """True: the plant renders the walls of a command on the device."""
    hand: Hand | None = None
    given: Mapping[str, Any]
    inertia: Any
    start: tuple[Array, Array]

    def __new__(cls, *timing: Any, **options: Any) -> Self:
        """Store the constructor arguments in the new plant."""
        plant = super().__new__(cls)
        plant._lag = 0.0
        plant.given = {**dict(zip(("timing",), timing)), **options}
        check_instance("timing", plant.given.get("timing"), Timing | None, "a Timing, such as Timing(period=0.005)")
        check_instance("hand", plant.given.get("hand"), Hand | None, "a Hand, such as get_hand('arm')")
        check_instance("hand_force", plant.given.get("hand_force"), Callable | None, "a function (tick, time, state)")
        return plant

    @property
    def driver_lag(self) -> float:
        """Time constant of the drivers [s]; 0 for none."""
        return self._lag

    def __init__(
        self,
        timing: Timing,
        batch: tuple[int, ...],
        *,
        wrench: ArrayLike = 0.0,
        wrench_limit: ArrayLike | None = None,
        sensor: PoseSensor | None = None,
        escape: tuple[float, float] = (ESCAPE, 1.0),
        record: bool = False,
        longest_step: float | None = None,
        hand_force: HandForce | None = None,
        metered: bool = False,
    ) -> None:
        # few attributes: lookup is slower with more than 30
        self.batch = batch
        self._limit = None if wrench_limit is None else components(six("wrench_limit", wrench_limit, batch))
        distance, angle = numbers("escape", escape, shape="(2,)", above=0.0).tolist()
        self._escape = distance * distance, angle * angle
        self._longest_step = None if longest_step is None else number("longest_step", longest_step, above=0.0)
        self.before = six("wrench", wrench, batch, at_least=-math.inf, finite=True)
        self._closed = False
        self._limits = self._limit is not None
        self._release_options = sensor, hand_force, flag("record", record), flag("metered", metered)
        self._check_timing(timing)

    def _check_timing(self, timing: Timing) -> None:
        """Raise ParameterError if a timing does not fit the devices."""
        numbers("delay", timing.delay, shape=f"() or {self.batch}")

    def _started(self) -> Measure | None:
        """Return the measurement function of the sensor in its initial state; None for an ideal sensor."""
        sensor = self._release_options[0]
        return None if sensor is None else measuring(sensor)

    def _release(self, timing: Timing, start: tuple[Array, Array], measure: Measure | None) -> None:
        """Set all that changes in a run to its value at release; the constructor ends with it, and so does `restart`.

        Args:
            timing: Sample period, delay and phase.
            start: Checked pose and twist [m, rad; m/s, rad/s], (..., 6) each.
            measure: Result of `_started`.
        """
        _, hand_force, record, metered = self._release_options
        self.timing, self.start, self._measure = timing, start, measure
        self._recorder = TraceRecorder(timing.time, self._arrays) if record else None
        self._total: Component | None = 0.0 if metered else None
        self._run = self._carry if self._recorder is None and self._longest_step is None else self._run_in_pieces
        self._hand_force, self._effort = hand_force, _NO_EFFORT
        self._tick = -1
        self._offset: Component = 0.0
        self._timeline = Timeline(timing, self._prepare(components(self.before)), compares=not self.batch)
        self._intervals: Iterable[Interval] = []
        # copies, because they are used on every tick
        self._period, self._phase = timing.period, timing.phase
        self._intervals_of: Callable[..., Iterable[Interval]] = self._timeline.period
        self._answer: tuple[Any, Any, float] | None = None
        self.unanswered: Sample | None = None
        self._walls: Any = None  # `DeviceWalls`, or those of a twin's firmware

    @abstractmethod
    def _checked_start(self, timing: Timing, pose: ArrayLike, twist: ArrayLike) -> tuple[Array, Array]:
        """Return checked copies of pose and twist at release, (..., 6) each."""

    def restart(self, pose: ArrayLike, twist: ArrayLike = (0.0,) * 6, *, timing: Timing | None = None) -> None:
        """Release the device again, from another pose and twist, as a new plant with otherwise equal arguments.

        Samples, trace and state are then bit for bit those of the new plant, for a fraction of its cost: with MuJoCo,
        a new one compiles and allocates. The sensor is restarted, the first hand force is back, opened coils are
        connected, and the trace is empty. A hand that remembers, such as a `SpringHand` with a rise time, is the same
        object, as it would be in the new plant. Changes to `device.model` from outside stay.

        Args:
            pose: Pose at release [m, rad], of the shape of the first one.
            twist: Velocity at release [m/s, rad/s], of the same shape.
            timing: Sample period, delay and phase, in place of those so far.

        Raises:
            ParameterError: If a value is outside its bounds or of another shape; the plant is then unchanged.
            PlantError: If the plant is closed, or another object divides its periods (`follow`).

        Example:
            >>> from maglev_mj import MuJoCoPlant
            >>> with MuJoCoPlant(gravity=0.0) as plant:
            ...     heights = []
            ...     for height in (0.001, 0.002):
            ...         plant.restart([0.0, 0.0, height, 0.0, 0.0, 0.0])
            ...         heights.append(plant.read().position[2])
            >>> heights
            [0.001, 0.002]
        """
        if self._closed:
            raise PlantError("the plant is closed")
        if self._walls is not None and not isinstance(self._walls, DeviceWalls):
            raise PlantError("restart() is not possible after follow(): make a new plant")
        if timing is None:
            timing = self.timing
        else:
            self._check_timing(timing)
        start, measure = self._checked_start(timing, pose, twist), self._started()
        self.given = {**self.given, "timing": timing, "pose": start[0], "twist": start[1]}
        self._release(timing, start, measure)

    @abstractmethod
    def _prepare(self, force: Six) -> Any:
        """Convert a wrench to a drive for `_advance`."""

    @abstractmethod
    def _advance(self, duration: Component, drive: Any, pieces: int = 1) -> None:
        """Advance the state by `duration` [s] under a constant drive, in an engine by `pieces` equal steps."""

    @abstractmethod
    def _motion(self) -> tuple[Six, Six]:
        """Return the present true pose and velocity components."""

    @abstractmethod
    def _position(self) -> list[Component]:
        """Return the true pose components; raise an error if the state is invalid."""

    @abstractmethod
    def _exert(self, effort: Six) -> None:
        """Apply the wrench of the hand's muscles from now on."""

    @abstractmethod
    def _snapshot(self, drive: Any) -> Any:
        """Return a cheap, immutable snapshot of the present state and drive."""

    @abstractmethod
    def _arrays(self, snapshots: Sequence[Any]) -> tuple[Array, Array, Array]:
        """Return pose, twist and wrench on the flotor of K snapshots of `_snapshot`, (K, ..., 6) each."""

    @abstractmethod
    def _where(self) -> Sequence[Component]:
        """Return the position as an argument of `_work`."""

    @abstractmethod
    def _work(self, drive: Any, before: Sequence[Component], after: Sequence[Component]) -> Component:
        """Return the actuators' work [J] between two positions under a constant drive."""

    def read(self) -> Sample:
        """Advance to the next sampling instant and return its measurement.

        Raises:
            DivergenceError: If the flotor is far outside its range.
            PlantError: If the plant is closed, the engine warned, or a hand or sensor does not return six components.
        """
        if self._closed:
            raise PlantError("the plant is closed")
        tick, self.unanswered = self._tick, None
        if tick >= 0:
            self._offset = 0.0
            run = self._run
            self._intervals = intervals = self._intervals_of(tick, self._answer)
            self._answer = None
            for duration, drive in intervals:
                run(duration, drive)
        elif np.count_nonzero(self._phase):  # from release to the first sample, tick 0
            ahead = self._phase * self._period
            self._offset = -ahead
            self._run(ahead, self._timeline.acting)
        self._tick = tick = tick + 1
        position = self._position()
        time = (tick + self._phase) * self._period
        if self._hand_force is not None:
            self._effort = self._hand_force(tick, time, self.state)
            if len(self._effort) != 6 or not self._valid(sum(self._effort)):
                raise _invalid(self._effort, tick, self.batch, "a hand's wrench")
            self._exert(self._effort)
        if self._measure is not None:
            position = self._measure(position)
            if len(position) != 6:
                raise PlantError(f"a sensor must return 6 components (got {len(position)})")
        self.unanswered = sample = Sample(tick, time, position)
        return sample

    @every_tick
    def write(self, command: Command) -> Command:
        """Queue the command for the last sample; return it as applied, after the limits.

        Raises:
            PlantError: If the command is not finite, or no sample was read.
        """
        if self._closed or self._tick < 0:
            raise PlantError("the plant is closed" if self._closed else "write() needs a sample: call read() first")
        width = 0.0
        try:
            total = command.force
            if command.extra is not None:
                total = [held + pulse for held, pulse in zip(total, command.extra, strict=True)]
                width = command.pulse_width
                if not 0.0 < width < math.inf:
                    raise PlantError(f"pulse_width must be finite and above 0 (got {width:g})")
            check = sum(total)  # finite only if all terms are, short of overflow
        except (AttributeError, TypeError, ValueError):
            raise PlantError(f"a command must have 6 components, and so must its pulse (got {command})") from None
        if len(total) != 6 or not (isfinite(check) if check.__class__ is float else self._valid(check)):
            raise _invalid(total, self._tick, self.batch)
        walls = command.walls
        if self._limits:
            command = self._limited(command)
            if width:
                total = [held + pulse for held, pulse in zip(command.force, command.extra or ())]
        self._answer = self._prepare(command.force), self._prepare(total) if width else None, width
        if walls or self._walls is not None:
            command = self._on_device(command, total, walls)
        self.unanswered = None
        return command

    def _on_device(self, command: Command, total: Six, walls: Sequence[DeviceWall]) -> Command:
        """Add walls on the device to the answer; return the command with them."""
        if self._walls is None:
            sensor = self.given.get("sensor")
            self._walls = DeviceWalls(self._timeline, self._motion, self._driven, self.inertia, self.batch, sensor)
            self._intervals_of = self._walls.period
        walls = self._walls.check(walls)
        held, pulsed, width = self._answer or (None, None, 0.0)
        force, both = self._kept(command.force), self._kept(total) if width else None
        self._answer = HeldWalls((force, walls), held), HeldWalls((both, walls), pulsed) if both else None, width
        return command if command.walls is walls else replace(command, walls=walls)

    def _kept(self, force: Six) -> list[Component]:
        """Return a copy of a wrench: the caller may reuse its list or arrays."""
        return [np.array(part) for part in force] if self.batch else list(force)

    def _driven(self, force: Six) -> Any:
        """Return the drive of a wrench within the limits."""
        return self._prepare(self._limited(Command(force)).force if self._limits else force)

    def _switch(
        self,
        drive_of: Callable[[Sequence[float]], Any],
        currents: Sequence[float],
        pulsed: Sequence[float] | None,
        width: float,
        after: float | None,
    ) -> None:
        """Switch currents; see `MuJoCoPlant.drive`."""
        if self._tick < 0 or not isfinite(sum(currents) + sum(pulsed or ()) + width):
            raise PlantError(f"currents must be finite and follow a sample (got {tuple(currents)} for {width:g} s)")
        held = drive_of(currents)
        self._timeline.answer(self._tick, held, held if pulsed is None else drive_of(pulsed), width, after=after)
        self.unanswered = None

    def follow(self, walls: Any) -> None:
        """Let an object in place of `DeviceWalls` divide each period into intervals of constant force."""
        self._walls, self._intervals_of = walls, walls.period

    def advance(self, time: float) -> None:
        """Advance to a time after the last sample [s]; only with `follow`."""
        for duration, drive in self._walls.until(self._tick, time):
            self._run(duration, drive)

    def close(self) -> None:
        """Release the plant; may be called at any time and repeatedly."""
        self._closed, self.unanswered = True, None

    def trace(self) -> Trace:
        """Return the motion recorded since release.

        Raises:
            PlantError: If the plant was created without `record=True`, or no sample was read.
        """
        if self._recorder is None or self._tick < 0:
            raise PlantError("no trace: create the plant with record=True and read at least one sample")
        drive = self._timeline.now() if self._walls is None else self._walls.drive
        trace, delays = self._recorder.finish(self._tick, self._snapshot(drive)), np.unique(self.timing.delay).tolist()
        return replace(trace, origin=partial(conditions_text, type(self).__name__, AXES, [self.timing.period], delays))

    def state(self) -> tuple[Array, Array]:
        """Return true pose and twist at the last sample, (..., 6) each."""
        drive = self._timeline.acting if self._walls is None else self._walls.drive
        pose, twist, _ = self._arrays([self._snapshot(drive)])
        return pose[0], twist[0]

    @property
    def _last_intervals(self) -> list[Interval]:
        """Intervals of the last period, in order."""
        return self._walls.intervals if self._walls is not None else list(self._intervals)

    @property
    def started(self) -> bool:
        """True after the first sample."""
        return self._tick >= 0

    def hold(self, hand_force: HandForce | None) -> None:
        """Replace the hand force from the next sample on, by none if None; the hand's impedance stays."""
        self._hand_force = hand_force

    @property
    def held(self) -> bool:
        """True if a hand exerts a force."""
        return self._hand_force is not None

    @property
    def hand_wrench(self) -> Six:
        """Wrench of the hand's muscles since the last sample [N, N m], six components."""
        return self._effort

    @property
    def walls_wrench(self) -> Six:
        """Wrench of walls on the device in effect [N, N m], six components."""
        return _NO_EFFORT if self._walls is None else self._walls.force or _NO_EFFORT

    @property
    def work(self) -> Component:
        """Work of the actuators since release [J].

        With driver lag or force falloff it is the work of the commanded wrench.

        Raises:
            PlantError: If the plant was created without `metered=True`.
        """
        if self._total is None:
            raise PlantError("work is not metered: create the plant with metered=True")
        return self._total

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return self.timing.period

    def __iter__(self) -> Iterator[Sample]:
        while True:
            yield self.read()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _carry(self) -> Callable[..., None]:
        return self._advance if self._total is None else self._advance_metered

    def _advance_metered(self, duration: Component, drive: Any, pieces: int = 1) -> None:
        """Advance, and add the actuators' work: wrench times displacement, because the drive is constant."""
        before = self._where()
        self._advance(duration, drive, pieces)
        self._total = self._total + self._work(drive, before, self._where())

    def _run_in_pieces(self, duration: Component, drive: Any) -> None:
        """Advance over one interval, with recording and step limit."""
        if self._lag and self._recorder is not None:
            for part in lagging_parts(duration, self._lag):
                self._run_in_equal_pieces(part, drive)
        else:
            self._run_in_equal_pieces(duration, drive)

    def _run_in_equal_pieces(self, duration: Component, drive: Any) -> None:
        pieces = 1
        if self._longest_step is not None:
            longest = duration if duration.__class__ is float else float(np.max(duration))
            pieces = max(math.ceil(longest / self._longest_step - 1e-9), 1)
        carry, recorder = self._carry, self._recorder
        if recorder is None:
            return carry(duration, drive, pieces)
        tick, piece = max(self._tick, 0), duration if pieces == 1 else duration / pieces
        recorder.add(tick, self._offset, self._snapshot(drive))
        carry(piece, drive)
        for index in range(1, pieces):
            recorder.add(tick, self._offset + duration * (index / pieces), self._snapshot(drive))
            carry(piece, drive)
        self._offset = self._offset + duration

    def _limited(self, command: Command) -> Command:
        """Saturate the held wrench and the pulse wrench separately."""
        limit = self._limit
        if limit is None:
            return command
        if command.extra is None:
            within = not self.batch and _within(command.force, limit)  # the usual case
            return command if within else Command(list(map(clipped, command.force, limit)))
        force = list(map(clipped, command.force, limit))
        total = (clipped(held + pulse, most) for held, pulse, most in zip(command.force, command.extra, limit))
        return Command(force, [both - held for both, held in zip(total, force)], command.pulse_width)

    def _valid(self, total: Any) -> bool:
        """Return True if a sum of components is finite and has the batch shape."""
        return np.shape(total) in ((), self.batch) and is_finite(total)

    def _check_escape(self, position: Six) -> Component:
        """Return the squared angle [rad²]; raise DivergenceError outside the escape bounds or for NaN."""
        x, y, z, rx, ry, rz = position
        largest_distance, largest_angle = self._escape
        distance, angle = x * x + y * y + z * z, rx * rx + ry * ry + rz * rz
        if distance.__class__ is float and angle.__class__ is float:
            if distance < largest_distance and angle < largest_angle:
                return angle
        elif np.all((distance < largest_distance) & (angle < largest_angle)):
            return angle
        raise _escaped(distance, angle, self._escape, self.timing.time(self._tick), self.batch)


States: TypeAlias = Sequence[tuple[Any, Mapping[str, Any]]]
"""Objects with their saved attributes."""


def states_of(*parts: Any) -> States:
    """Save the attributes of objects; mutable ones are copied."""
    return [(part, {name: _copied(value) for name, value in vars(part).items()}) for part in parts]


def restore(states: States) -> None:
    """Restore the attributes saved by `states_of`; may be repeated."""
    for part, values in states:
        part.__dict__.update({name: _copied(value) for name, value in values.items()})


def _copied(value: Any) -> Any:
    return copy(value) if isinstance(value, list | deque | HandWork) else value


def _within(force: Sequence[float], limit: Sequence[float]) -> bool:
    """Return True if the wrench of one device is within its limits, six each [N, N m]."""
    fx, fy, fz, tx, ty, tz = force
    x, y, z, rx, ry, rz = limit
    linear = -x <= fx <= x and -y <= fy <= y and -z <= fz <= z
    return linear and -rx <= tx <= rx and -ry <= ty <= ry and -rz <= tz <= rz


def _invalid(force: Six, tick: int, batch: tuple[int, ...], what: str = "a command") -> PlantError:
    """Return the error for the first invalid component of a wrench, called `what` in the message."""
    if len(force) != 6:
        return PlantError(f"{what} must have 6 components (got {len(force)})")
    wrench = join(force)
    if wrench.shape[:-1] not in ((), batch):
        return PlantError(f"{what} must have the batch shape {batch} of the plant (got {wrench.shape[:-1]})")
    return PlantError(not_finite(f"{what.removeprefix('a ')} at tick {tick}", force))


def _escaped(
    distance: Component, angle: Component, bounds: tuple[float, float], at: Component, batch: tuple[int, ...]
) -> DivergenceError:
    """Return the error for the first flotor outside `bounds`; distances, angles and bounds are squared."""
    metres, radians, time = np.broadcast_arrays(np.sqrt(distance), np.sqrt(angle), at)
    out = ~((metres**2 < bounds[0]) & (radians**2 < bounds[1]))
    index = tuple(np.argwhere(out)[0]) if out.ndim else ()
    device = f" (device {', '.join(map(str, index))} of {batch})" if index else ""
    return DivergenceError(
        f"diverged at {time[index]:.4g} s{device}: the flotor is {metres[index]:.3g} m and {radians[index]:.3g} rad "
        f"from its centre, outside {math.sqrt(bounds[0]):.3g} m and {math.sqrt(bounds[1]):.3g} rad"
    )
