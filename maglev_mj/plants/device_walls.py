"""Walls that a simulated device renders between two samples of the host, at its own rate and delay."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from operator import is_
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.control.timeline import Interval, Timeline
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import AXES, Array, Component, DeviceWall, Six
from maglev_mj.parameters import number, numbers
from maglev_mj.plants.sensor import Measure, PoseSensor, Sensor, measuring

HALF_ACCELERATION, HALF_ANGULAR = 60.0, 2500.0
"""Half the largest acceleration of the flotor under coils and hand [m/s², rad/s²]."""

_SEED = 104_729
"""Offset of the seed of the device's sensor noise: independent of the noise of the host's samples."""
_SETTLED, _SPREADS = 10.0, 10.0
"""Time constants of a velocity filter and standard deviations of noise that count as all of them."""

Motion: TypeAlias = Callable[[], tuple[Six, Six]]
"""Function that returns the true pose [m, rad] and velocity [m/s, rad/s] at present."""


class HeldWalls(NamedTuple):
    """Drive of a timeline with walls: the host's wrench [N, N m] and walls as its key, and drive of that wrench."""

    key: tuple[Six, Sequence[DeviceWall]]
    drive: Any


class DeviceWalls:
    """Walls on the device of one plant.

    The device samples the pose every h, computes f = -K (x - edge) - B v inside each wall, and applies it after its
    delay. Samples are skipped while the flotor cannot reach a wall.

    Args:
        timeline: Drives of the host; those with walls are of type `HeldWalls`.
        motion: Present motion.
        drive_of: Function that limits a wrench and converts it to a drive.
        inertia: Mass and moments of inertia [kg, kg m²], (..., 6).
        batch: Batch shape of the plant.
        sensor: Sensor of the device; the noise is independent of that of the host's samples.

    Attributes:
        drive: Drive in effect.
        intervals: Intervals of the last period.
        force: Wrench of the walls in effect [N, N m]; None for none.
        measure: Measurement function; None for an ideal sensor.

    Raises:
        PlantError: If the delay differs between the devices of a batch.
    """

    def __init__(
        self,
        timeline: Timeline,
        motion: Motion,
        drive_of: Callable[[Six], Any],
        inertia: Array,
        batch: tuple[int, ...],
        sensor: PoseSensor | None,
    ) -> None:
        timing = timeline.timing
        if np.ndim(timing.delay):
            raise PlantError(f"delay must be a number with walls on the device (got shape {np.shape(timing.delay)})")
        self._timeline, self._motion, self._drive_of, self._batch = timeline, motion, drive_of, batch
        self._inertia = np.broadcast_to(inertia, (*batch, 6)).min(axis=tuple(range(len(batch)))).tolist()
        self._host, self._period, self._phase = timing.period, timing.device_period, timing.device_phase
        self._delay, self._least = timing.device_delay, 1e-6 * min(self._period, self._host)
        self._margin: list[float] = [0.0] * 6
        if isinstance(sensor, Sensor):
            self._margin = np.broadcast_to(np.add(sensor.quantum, _SPREADS * np.asarray(sensor.noise)), 6).tolist()
            sensor = replace(sensor, seed=sensor.seed + _SEED)
        elif sensor is not None:  # it may measure anything: no sample is skipped
            self._margin = [math.inf] * 6
        self.measure: Measure | None = None if sensor is None else measuring(sensor)
        self.drive, self.intervals = timeline.now(), list[Interval]()
        self._checked: Sequence[DeviceWall] = ()
        self._last: tuple[int, Six] | None = None  # last sample
        self._next = 0
        self._speeds: dict[tuple[int, float], Component] = {}
        self.force: Six | None = None
        self._waiting: deque[tuple[int, Six | None]] = deque()
        self._total: tuple[Any, Any, Any] = None, None, None

    def check(self, walls: Sequence[DeviceWall]) -> Sequence[DeviceWall]:
        """Return walls as a tuple; those of the last call are not checked again.

        Raises:
            ParameterError: If a value is outside its bounds or has another batch shape.
        """
        if len(walls) == len(self._checked) and all(map(is_, walls, self._checked)):
            return walls if isinstance(walls, tuple) else self._checked
        for wall in walls:
            if wall.axis not in range(len(AXES)) or wall.side not in (-1, 0, 1):
                raise ParameterError(f"device wall needs an axis from 0 to 5 and a side of -1, 0 or 1 (got {wall})")
            for name, least in (("edge", -math.inf), ("stiffness", 0.0), ("damping", 0.0)):
                value = numbers(f"device wall {name}", getattr(wall, name), at_least=least)
                if value.shape not in ((), self._batch):
                    raise ParameterError(f"device wall {name} must have shape () or {self._batch} (got {value.shape})")
            if wall.cutoff is not None:
                number("device wall cutoff", wall.cutoff, above=0.0)
        self._checked = tuple(walls)
        return self._checked

    def period(self, tick: int, answer: tuple[Any, Any, float] | None = None) -> Iterator[Interval]:
        """Yield the intervals of constant force from sample `tick` to the next; advance the plant between them."""
        self.intervals, end, host = [], 0.0, self._timeline.period(tick, answer)
        free = min(self._reach(held) for _, held in host) >= self._host + self._period
        for duration, held in host:
            begin, end = end, end + duration
            if free or not isinstance(held, HeldWalls):
                pieces: Iterable[Interval] = ((duration, held.drive if isinstance(held, HeldWalls) else held),)
            else:
                pieces = self._rendered(tick, begin, end, held)
            for duration, self.drive in pieces:
                self.intervals.append((duration, self.drive))
                yield duration, self.drive

    def _rendered(self, tick: int, now: float, end: float, held: HeldWalls) -> Iterator[Interval]:
        start, least = tick * self._host, self._least
        self._plan(start + now, held)
        while now < end:
            if self._time(self._next) - start <= now + least:
                self._sample(held)
                self._plan(start + now, held)
            while self._waiting and self._time(self._waiting[0][0]) + self._delay - start <= now + least:
                self.force = self._waiting.popleft()[1]
            until = self._time(self._next) - start
            if self._waiting:
                until = min(until, self._time(self._waiting[0][0]) + self._delay - start)
            until = end if until > end - least else until
            yield until - now, self._driven(held)
            now = until

    def _time(self, index: int) -> float:
        """Return the time of a sample of the device after the first one of the host [s]."""
        return (index + self._phase) * self._period

    def _driven(self, held: HeldWalls) -> Any:
        """Return the drive of host and device together."""
        if self.force is None:
            return held.drive
        if self._total[0] is not held or self._total[1] is not self.force:
            force = [host + device for host, device in zip(held.key[0], self.force)]
            self._total = held, self.force, self._drive_of(force)
        return self._total[2]

    def _sample(self, held: HeldWalls) -> None:
        """Take a sample, and queue its force."""
        pose, _ = self._motion()
        measured = list(pose) if self.measure is None else self.measure(pose)
        index, before = self._last or (self._next - 1, measured)
        elapsed, speeds = (self._next - index) * self._period, {}
        forces: list[Component] | None = None
        for axis, edge, side, stiffness, damping, cutoff in held.key[1]:
            x = measured[axis]
            velocity = (x - before[axis]) / elapsed
            if cutoff is not None:
                last = self._speeds.get((axis, cutoff), 0.0)
                velocity = last - math.expm1(-2.0 * math.pi * cutoff * elapsed) * (velocity - last)
                speeds[axis, cutoff] = velocity
            offset = x - edge
            inside = side * offset <= 0.0
            if inside is False or (inside is not True and not inside.any()):
                continue
            forces = forces or [0.0] * len(AXES)
            forces[axis] = forces[axis] - inside * (stiffness * offset + damping * velocity)
        if forces is not None or self.force is not None or self._waiting:
            # a tuple: `states_of` copies lists, and `_driven` compares identities
            self._waiting.append((self._next, None if forces is None else tuple(forces)))
        self._last, self._speeds = (self._next, measured), speeds

    def _plan(self, now: float, held: HeldWalls) -> None:
        """Set the next sample: the last one before the flotor can reach a wall, and at least the next one after `now`.

        The sample after it may be in a wall, whose velocity needs both.
        """
        self._next = math.ceil((now - self._least) / self._period - self._phase)
        if self._last is not None and self._last[0] >= self._next:
            self._next = self._last[0] + 1
        until = math.floor((now + self._reach(held) + self._least) / self._period - self._phase)
        self._next = max(self._next, until)

    def _reach(self, held: Any) -> float:
        """Return the time in which no flotor can reach a wall [s], up to a period of the host and one of the device."""
        if self.force is not None or self._waiting or not isinstance(held, HeldWalls):
            return 0.0
        (pose, velocity), (force, walls) = self._motion(), held.key
        least = self._host + self._period
        for axis, edge, side, _, _, cutoff in walls:
            half = (HALF_ACCELERATION if axis < 3 else HALF_ANGULAR) + 0.5 * abs(force[axis]) / self._inertia[axis]
            gap, speed = side * (pose[axis] - edge) - self._margin[axis], -side * velocity[axis]
            if gap.__class__ is float and speed.__class__ is float:
                time = (math.sqrt(speed * speed + 4.0 * half * gap) - speed) / (2.0 * half) if gap > 0.0 else 0.0
            else:
                time = float(
                    np.min((np.sqrt(speed * speed + 4.0 * half * np.maximum(gap, 0.0)) - speed) / (2.0 * half))
                )
            least = min(least, time - (0.0 if cutoff is None else _SETTLED / (2.0 * math.pi * cutoff)))
        return max(least, 0.0)
