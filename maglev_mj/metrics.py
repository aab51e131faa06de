"""Figures of one motion along one axis: how deep, how hard, how long, how much energy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array, Command, Sample
from maglev_mj.parameters import number, numbers
from maglev_mj.timeline import Timeline, Timing
from maglev_mj.trace import Trace

__all__ = [
    "BounceSummary",
    "EnergyBalance",
    "Hardness",
    "PassivityObserver",
    "energy_balance",
    "perceived_hardness",
    "percentiles",
    "summarise_bounce",
]


class BounceSummary(NamedTuple):
    """How a flotor met a wall; each figure (...), one for each device.

    Attributes:
        penetration: Greatest depth behind the wall [m].
        rebound: Greatest height above the wall after the first contact [m], 0 if it never leaves.
        peak_force: Largest force of the actuators on the axis, either sign [N].
        settling_time: Time from release after which the position stays within 2 % of the way from start to
            rest around the rest [s]; NaN if it does not, or if there is no rest.
        final_z: Position at the end [m].
    """

    penetration: Array
    rebound: Array
    peak_force: Array
    settling_time: Array
    final_z: Array


class EnergyBalance(NamedTuple):
    """Where the energy went between the first and the last knot [J]; each (...)."""

    kinetic: Array
    """Gain in kinetic energy."""
    actuators: Array
    """Work of the actuators."""
    gravity: Array
    """Work of gravity."""


def summarise_bounce(trace: Trace, rest: float, *, axis: int = 2, wall: float = 0.0) -> BounceSummary:
    """Summarise a drop on a wall that fills x <= `wall`.

    Positions are extremes of the exact curve, not of samples of it.

    Args:
        trace: The motion.
        rest: Where the flotor comes to rest [m]; NaN for nowhere.
        axis: Index into AXES.
        wall: Position of the wall [m].
    """
    line = trace.along(axis)
    turn_time, turn = (part[..., 0] for part in line.turning_points())
    times = np.concatenate([line.time, turn_time])
    places = np.concatenate([line.pose[..., 0], turn])
    touched = np.where(places <= wall, times, np.inf).min(axis=0)
    after = times >= touched
    highest = np.where(after, places - wall, 0.0).max(axis=0)
    return BounceSummary(
        penetration=np.maximum(wall - places.min(axis=0), 0.0),
        rebound=np.maximum(highest, 0.0),
        peak_force=np.abs(line.wrench[:-1, ..., 0]).max(axis=0),  # the last knot's force has not acted yet
        settling_time=_settling_time(line, rest),
        final_z=line.pose[-1, ..., 0],
    )


def _settling_time(line: Trace, rest: float, share: float = 0.02, step: float = 1e-4) -> Array:
    """Return when the position last enters the band around `rest`, interpolated on a grid of `step` [s]."""
    end = float(line.time[-1].min())
    grid = np.minimum(step * np.arange(int(np.ceil(end / step)) + 1), end)
    away = np.abs(line.at(grid)[0][..., 0] - rest)
    band = share * np.abs(line.pose[0, ..., 0] - rest)
    outside = ~(away <= band)
    last = len(grid) - 1 - np.argmax(outside[::-1], axis=0)
    following = np.minimum(last + 1, len(grid) - 1)
    before, behind = (np.take_along_axis(away, index[None], axis=0)[0] for index in (last, following))
    fall = np.where(before > behind, before - behind, 1.0)
    entered = grid[last] + (grid[following] - grid[last]) * np.clip((before - band) / fall, 0.0, 1.0)
    settled = np.where(outside.any(axis=0), entered, 0.0)
    return np.where(outside[-1], np.nan, settled)


def energy_balance(trace: Trace, mass: float, gravity: float, *, axis: int = 2) -> EnergyBalance:
    """Add up work and energy along one axis; exact under a wrench constant between knots.

    Args:
        trace: The motion.
        mass: Mass or moment of inertia on the axis [kg, kg m²].
        gravity: Acceleration of free fall against the axis [m/s²].
        axis: Index into AXES.
    """
    travel = np.diff(trace.pose[..., axis], axis=0)
    speed = trace.twist[..., axis]
    return EnergyBalance(
        kinetic=0.5 * mass * (speed[-1] ** 2 - speed[0] ** 2),
        actuators=(trace.wrench[:-1, ..., axis] * travel).sum(axis=0),
        gravity=-mass * gravity * (trace.pose[-1, ..., axis] - trace.pose[0, ..., axis]),
    )


class PassivityObserver:
    """Adds up the energy that the rendered environment takes in, axis by axis; below 0 it has made energy.

    Hand it to `run` as `observe`. Between two samples up to four forces act in turn: the older command and what is
    left of its pulse, the newer command and its pulse. How the way between the samples splits among them follows
    from the inertia, exactly where no other force acts but a constant load; without inertia the way is taken as
    straight, which is exact only where one force acts throughout, so without delay and pulse.

    Args:
        timing: Of the plant.
        inertia: Mass and moments of inertia of the six axes [kg, kg m²], (6,); None for a straight line.
        load: Constant wrench that acts besides, such as weight [N, N m], (6,).
        before: What the environment exerts until the first command takes effect [N, N m], (6,).

    Attributes:
        energy: Taken in so far [J], (..., 6).
        least: The least it has been [J], (..., 6).

    Raises:
        ParameterError: If an inertia is not above 0.

    Source: Hannaford & Ryu 2002, with each force paired with the way that it acted over.
    """

    def __init__(
        self, timing: Timing, inertia: ArrayLike | None = None, load: ArrayLike = 0.0, before: ArrayLike = 0.0
    ) -> None:
        self._load = numbers("load", load)
        self._inertia = np.inf if inertia is None else numbers("inertia", inertia, at_least=1e-12)
        acting = np.zeros(6) + numbers("before", before)
        self._timeline, self._count = Timeline(timing, acting), 0
        for sample in range(-timing.whole, 0):  # as if it had been the answer to the samples before the first
            self._timeline.answer(sample, acting.copy())
        self._pose: Array | None = None
        self.energy: Array = np.zeros(6)
        self.least: Array = np.zeros(6)

    def __call__(self, sample: Sample, command: Command) -> None:
        """Take in one sample and the command that answered it; samples that are missing count for nothing."""
        pose = sample.pose
        if self._pose is not None:
            self.energy = self.energy - self._work(pose - self._pose)
            self.least = np.minimum(self.least, self.energy)
            self._count += 1
        self._pose = pose
        held = command.wrench
        if command.extra is None:
            self._timeline.answer(self._count, held)
        else:
            self._timeline.answer(self._count, held, held + command.pulse, command.pulse_width)

    def _work(self, moved: Array) -> Array:
        """Return the work of the forces over the period behind the last sample kept."""
        segments = self._timeline.period(self._count)
        # speed at the start, such that the segments add up to the way between the samples
        place, speed = np.zeros_like(moved), np.zeros_like(moved)
        for duration, force in segments:
            pull = (force + self._load) / self._inertia
            place, speed = place + duration * (speed + 0.5 * duration * pull), speed + duration * pull
        speed, work = (moved - place) / self._timeline.timing.period, np.zeros_like(moved)
        for duration, force in segments:
            pull = (force + self._load) / self._inertia
            work, speed = work + force * duration * (speed + 0.5 * duration * pull), speed + duration * pull
        return work


class Hardness(NamedTuple):
    """How hard a tap feels [N/m], (...,) each.

    Attributes:
        rate: Rate-hardness: how fast the force rises over the first window after contact, over the speed of impact.
        extended: The same for the fastest rise over any window that overlaps the first contact.
    """

    rate: Array
    extended: Array


def perceived_hardness(trace: Trace, window: float, *, axis: int = 2, wall: float = 0.0) -> Hardness:
    """Return the hardness of the first contact with a wall that fills x <= `wall`.

    A force that is held between samples rises at once, so its rate is that of its mean over a window, which is
    (f(t + window) - f(t)) / window.

    Args:
        trace: The motion; NaN comes out where a device does not touch the wall.
        window: Length of the window [s].
        axis: Index into AXES.
        wall: Position of the wall [m].

    Raises:
        ParameterError: If the window is not above 0, or longer than the trace.

    Source: Lawrence, Pao, Dougherty, Salada & Pavlou 2000; Han & Choi 2010. Definitions recalled; the window is ours.
    """
    width = number("window", window, above=0.0)
    line = trace.along(axis)
    end = float(line.time[-1].min())
    number("window", window, below=end)
    grid = np.arange(int(np.floor(end / 1e-4)) + 1) * 1e-4
    pose, twist, wrench = (part[..., 0] for part in line.at(grid))
    inside = pose <= wall
    touched = inside.any(axis=0)
    contact = np.maximum(np.argmax(inside, axis=0) - 1, 0)  # before the force begins to rise
    away = ~inside & (np.arange(len(grid)).reshape((-1,) + (1,) * (inside.ndim - 1)) > contact)
    leaves = np.where(away.any(axis=0), np.argmax(away, axis=0), len(grid) - 1)
    shift = max(round(width / 1e-4), 1)
    rise = np.zeros_like(wrench)
    rise[:-shift] = (wrench[shift:] - wrench[:-shift]) / width
    place = np.arange(len(grid)).reshape((-1,) + (1,) * (rise.ndim - 1))
    during = (place >= contact - shift) & (place <= leaves)
    speed = np.abs(np.take_along_axis(twist, contact[None], axis=0)[0])
    first = np.take_along_axis(rise, contact[None], axis=0)[0]
    most = np.where(during, rise, -np.inf).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Hardness(*(np.where(touched & (speed > 0.0), part / speed, np.nan) for part in (first, most)))


def percentiles(summary: BounceSummary, share: float) -> BounceSummary:
    """Return a percentile of each figure over the devices.

    A settling time that is missing counts as later than every other; where the percentile falls among the
    missing, it is NaN.
    """
    return BounceSummary(*(_percentile(figure, share) for figure in summary))


def _percentile(values: Array, share: float) -> Array:
    late = np.where(np.isnan(values), np.inf, values)
    if np.isinf(np.percentile(late, share, method="higher")):
        return np.array(np.nan)
    finite = np.where(np.isinf(late), np.finfo(float).max, late)  # keeps its rank without spoiling the interpolation
    return np.asarray(np.percentile(finite, share))
