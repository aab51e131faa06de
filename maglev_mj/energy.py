"""Energy of hand and rendered world: of a session as it runs, of samples alone, and of a whole motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array, Command, Component, Sample
from maglev_mj.parameters import numbers
from maglev_mj.timeline import Segment, Timeline, Timing
from maglev_mj.trace import Trace

__all__ = ["EnergyAccount", "HandWork", "PassivityObserver", "actuator_work", "hand_work"]


def actuator_work(trace: Trace, carried: ArrayLike = 0.0) -> Array:
    """Return the work of the actuators between knots [J], (K - 1, ..., 6); exact under a constant wrench there.

    Args:
        trace: The motion.
        carried: Wrench that carries the flotor and counts for nothing [N, N m], (6,).
    """
    work: Array = (trace.wrench[:-1] - np.asarray(carried)) * np.diff(trace.pose, axis=0)
    return work


def hand_work(poses: Array, efforts: Array) -> Array:
    """Return the work of a hand from each sample to the next [J], (N - 1, 6).

    Args:
        poses: Poses at the samples [m, rad], (N, 6).
        efforts: Wrenches of the hand from each sample on [N, N m], (N, 6).
    """
    work: Array = efforts[:-1] * np.diff(poses, axis=0)
    return work


class HandWork:
    """Add up the work of a hand whose wrench is held from sample to sample.

    Attributes:
        total: Since the first sample [J].
    """

    def __init__(self) -> None:
        self._pose: Array | None = None
        self._effort: Array = np.zeros(6)
        self.total = 0.0

    def add(self, pose: Array, effort: Sequence[float]) -> None:
        """Add the way up to a sample.

        Args:
            pose: At the sample [m, rad], (6,).
            effort: Wrench of the hand from there on [N, N m], six.
        """
        if self._pose is not None:
            self.total += float(self._effort @ (pose - self._pose))
        self._pose, self._effort = pose, np.array(effort)

    def take(self, poses: Array, efforts: Array) -> Array:
        """Add N samples; return the total at each [J], (N,).

        The bits are those of one by one.

        Args:
            poses: At the samples [m, rad], (N, 6).
            efforts: Wrenches of the hand from there on [N, N m], (N, 6).
        """
        acting = np.concatenate([self._effort[None], efforts])[:-1]
        ways = np.diff(poses, axis=0, prepend=poses[:1] if self._pose is None else self._pose[None])
        work = (acting[:, None, :] @ ways[:, :, None])[:, 0, 0]
        totals: Array = np.add.accumulate(np.append(self.total, work))[1:]
        self._pose, self._effort, self.total = poses[-1], efforts[-1], float(totals[-1])
        return totals


class EnergyAccount:
    """Add up the work of the hand and the energy that the rendered world takes, from sample to sample.

    The rendered world is what the actuators do beyond carrying the flotor: walls, friction, springs. It has a tank:
    what it takes in fills it, up to a bound that no spring here can store more than, and what it gives empties it. A
    world that gives more than it has is not passive, and one that keeps on giving is unstable.

    Args:
        pose: At the start [m, rad], (6,).
        carried: Wrench by which the actuators carry the flotor [N, N m], (6,); zero where they do not.
        tank: The most that counts as stored [J].

    Attributes:
        taken: Energy that the rendered world has taken in [J]; below 0 it has made energy.
        stored: Energy in the tank [J]; below 0 by as much as the world has made beyond.
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
        """Add the way up to a sample.

        Args:
            pose: At the sample [m, rad], (6,).
            effort: Wrench of the hand from there on [N, N m], six.
            work: Work of the actuators since the start [J], as a metered plant adds it up.
        """
        taken = float(self._carried @ (pose - self._pose)) - (work - self._work)
        self._hand.add(pose, effort)
        self.taken += taken
        self.stored = min(self.stored + taken, self._tank)
        self._pose, self._work = pose, work


class PassivityObserver:
    """Add up the energy that the rendered world takes in, axis by axis, from samples and commands alone.

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
            self.energy = self.energy - self._work(pose - self._pose, self._timeline.period(self._count))
            self.least = np.minimum(self.least, self.energy)
            self._count += 1
        self._pose = pose
        held = command.wrench
        if command.extra is None:
            self._timeline.answer(self._count, held)
        else:
            self._timeline.answer(self._count, held, held + command.pulse, command.pulse_width)

    def take(self, poses: Array, held: Array, pulses: Array, widths: Array) -> Array:
        """Take in N samples of one device and their commands.

        The bits are those of one by one.

        Args:
            poses: Poses [m, rad], (N, 6).
            held: Held wrenches of the commands [N, N m], (N, 6).
            pulses: Wrenches of their pulses [N, N m], (N, 6).
            widths: Widths of the pulses [s], (N,); 0 for none.

        Returns:
            Energy taken in up to each sample [J], (N, 6).
        """
        groups: dict[int, list[tuple[int, list[Segment]]]] = {}  # by how many segments a period has
        for place, (force, pulse, width) in enumerate(zip(held, pulses, widths.tolist())):
            if place or self._pose is not None:
                segments = self._timeline.period(self._count)
                groups.setdefault(len(segments), []).append((place, segments))
                self._count += 1
            if width:
                self._timeline.answer(self._count, force, force + pulse, width)
            else:
                self._timeline.answer(self._count, force)
        moved = np.diff(poses, axis=0, prepend=poses[:1] if self._pose is None else self._pose[None])
        work = np.zeros_like(poses)
        for group in groups.values():
            places = [place for place, _ in group]
            columns = zip(*(segments for _, segments in group), strict=True)
            stacked = [tuple(map(np.array, zip(*column, strict=True))) for column in columns]
            work[places] = self._work(moved[places], [(duration[:, None], force) for duration, force in stacked])
        energy: Array = np.subtract.accumulate(np.concatenate([self.energy[None], work]))[1:]
        self.energy, self._pose = energy[-1], poses[-1]
        self.least = np.minimum(self.least, energy.min(axis=0))
        return energy

    def _work(self, moved: Array, periods: Sequence[Segment]) -> Array:
        """Return the work of the forces over a period, from the way between its samples and its segments."""
        segments = [(duration, force, duration * ((force + self._load) / self._inertia)) for duration, force in periods]
        # speed at the start, such that the segments add up to the way between the samples
        place: Component = 0.0
        speed: Component = 0.0
        for duration, _, gained in segments:
            place, speed = place + duration * (speed + 0.5 * gained), speed + gained
        work: Component = 0.0
        speed = (moved - place) / self._timeline.timing.period
        for duration, force, gained in segments:
            work, speed = work + force * duration * (speed + 0.5 * gained), speed + gained
        return np.asarray(work)
