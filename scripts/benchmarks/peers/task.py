"""The task and control law of every peer.

A flotor falls from rest on a sampled wall below z = 0, the five other axes held. Commands take effect a transport delay
after their sample; the sample that finds the flotor to have entered the wall is answered by a braking pulse first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

Intervals: TypeAlias = list[tuple[float, list[float]]]
"""Duration [s] and wrench [N, N m] of a period's parts."""

Simulate: TypeAlias = Callable[[], Array]

Law: TypeAlias = Callable[[Sequence[float]], tuple[list[float], list[float] | None]]
"""Function from a pose to held and pulsed wrench.

The pose is six numbers; the whole wrench during a pulse is None without one.
"""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A drop on the wall.

    Attributes:
        mass: Moving mass [kg].
        inertia: Principal moments of inertia about the centre of mass [kg m²].
        gravity: Acceleration of free fall, along -z [m/s²].
        offset: Where the flotor starts from rest, x y z [m].
        tilt: Its rotation about x at the start [rad].
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        pulse: Further damping in the braking pulse [N s/m].
        pulse_width: How long the pulse lasts [s].
        ticks: Samples that are answered; a run lasts as many periods.

    Raises:
        ValueError: If a pulse would outlast the period of its sample.
    """

    mass: float = 0.7
    inertia: tuple[float, float, float] = (9.3e-4, 9.3e-4, 8.2e-4)
    gravity: float = 9.81
    offset: tuple[float, float, float] = (0.5e-3, -0.3e-3, 4.5e-3)
    tilt: float = 0.0
    period: float = 0.005
    delay: float = 0.0015
    stiffness: float = 6000.0
    damping: float = 80.0
    pulse: float = 220.0
    pulse_width: float = 0.003
    ticks: int = 80

    def __post_init__(self) -> None:
        if not (self.delay > 0.0 and self.pulse_width > 0.0 and self.delay + self.pulse_width < self.period):
            raise ValueError("delay and pulse_width must be above 0, and together below the period")

    @property
    def pose(self) -> list[float]:
        """Start pose: x y z [m], rotation vector [rad]."""
        return [*self.offset, self.tilt, 0.0, 0.0]

    @property
    def body(self) -> list[float]:
        """Mass [kg] or moment of inertia [kg m²], by axis."""
        return [self.mass] * 3 + list(self.inertia)

    @property
    def duration(self) -> float:
        """Length of a run [s]."""
        return self.ticks * self.period

    def law(self) -> Law:
        """Return a new control law in plain floats; each run takes one."""
        period, stiffness, damping, braking = self.period, self.stiffness, self.damping, self.pulse + self.damping
        frequency = min(50.0, 0.25 / (self.period + self.delay))
        springs = [body * frequency**2 for body in self.body]
        dampers = [2.0 * body * frequency for body in self.body]
        previous: Sequence[float] | None = None

        def answer(position: Sequence[float]) -> tuple[list[float], list[float] | None]:
            nonlocal previous
            before = position if previous is None else previous
            previous = position
            force = [
                -k * now - b * (now - then) / period for k, b, now, then in zip(springs, dampers, position, before)
            ]
            z = position[2]
            if z > 0.0:
                force[2] = 0.0
                return force, None
            speed = (z - before[2]) / period
            force[2] = -stiffness * z - damping * speed
            # a flotor first seen inside has not entered: it was not above before
            if before[2] <= 0.0:
                return force, None
            pulse = force.copy()
            pulse[2] = -braking * speed
            return force, pulse

        return answer

    def intervals(self, held: list[float], force: list[float], pulse: list[float] | None) -> Intervals:
        """Return a period's intervals: duration [s], wrench [N, N m].

        Args:
            held: Wrench in effect at the sample [N, N m].
            force: Wrench that the sample is answered with [N, N m].
            pulse: Wrench during the pulse [N, N m], or None.
        """
        if pulse is None:
            return [(self.delay, held), (self.period - self.delay, force)]
        rest = self.period - self.delay - self.pulse_width
        return [(self.delay, held), (self.pulse_width, pulse), (rest, force)]

    def grid(self, step: float) -> Callable[[list[float], list[float], list[float] | None], Intervals]:
        """Return a `intervals` for steps on a fixed grid [s]; a command waits for the next."""
        steps = round(self.period / step)
        begins, ends = steps_in(self.delay, step), steps_in(self.delay + self.pulse_width, step)

        def on_grid(held: list[float], force: list[float], pulse: list[float] | None) -> Intervals:
            pulsed = [(step, pulse or force)] * (ends - begins)
            return [(step, held)] * begins + pulsed + [(step, force)] * (steps - ends)

        return on_grid


@dataclass(frozen=True)
class Variant:
    """One method to simulate the task with one peer.

    Attributes:
        peer: Name of the package.
        name: Name of the variant.
        build: Does what is done once, and returns a function that simulates from the start and returns the poses at
            the samples [m, rad], (ticks + 1, 6).
        title: Name in the table of the best methods; empty for none of them.
    """

    peer: str
    name: str
    build: Callable[[Task], Simulate]
    title: str = ""


def closed_loop(
    task: Task,
    restart: Callable[[], object],
    pose: Callable[[], list[float]],
    advance: Callable[[float, list[float]], object],
    intervals: Callable[[list[float], list[float], list[float] | None], Intervals] | None = None,
) -> Simulate:
    """Return a run from sample to sample, answered by the law.

    Args:
        task: The task.
        restart: Puts the flotor back to the start, at rest.
        pose: Reads its pose [m, rad].
        advance: Moves it on for a time [s] under a constant wrench [N, N m].
        intervals: Divides a period; None for `Task.intervals`.
    """
    divided = intervals or task.intervals

    def run() -> Array:
        restart()
        law, held, poses = task.law(), [0.0] * 6, []
        for _ in range(task.ticks):
            seen = pose()
            poses.append(seen)
            force, pulse = law(seen)
            for length, wrench in divided(held, force, pulse):
                advance(length, wrench)
            held = force
        poses.append(pose())
        return np.array(poses)

    return run


def steps_in(duration: float, step: float) -> int:
    """Return the number of steps begun before a time, rounding aside."""
    return math.ceil(duration / step - 1e-9)


def rotation_vector(w: float, x: float, y: float, z: float) -> list[float]:
    """Convert a unit quaternion into a rotation vector [rad] of an angle below pi."""
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return [0.0, 0.0, 0.0]
    scale = 2.0 * math.atan2(sine, w) / sine
    return [scale * x, scale * y, scale * z]


def quaternion(vector: Sequence[float]) -> list[float]:
    """Convert a rotation vector [rad] into a unit quaternion: w first."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    scale = math.sin(0.5 * angle) / angle if angle else 0.5
    return [math.cos(0.5 * angle), scale * x, scale * y, scale * z]
