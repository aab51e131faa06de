"""Energy of the hand and of the rendered environment.

It is computed for a running session, from samples alone, or for a whole motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.timeline import Segment, Timeline, Timing
from maglev_mj.frames import Array, Command, Component, Sample
from maglev_mj.parameters import numbers
from maglev_mj.plants.trace import Trace


def actuator_work(trace: Trace, carried: ArrayLike = 0.0) -> Array:
    """Return the work of the actuators between knots [J].

    (K - 1, ..., 6). It is exact under a constant wrench between knots.

    Args:
        trace: The motion.
        carried: Weight-bearing wrench, which does not count [N, N m], (6,).
    """
    work: Array = (trace.wrench[:-1] - np.asarray(carried)) * np.diff(trace.pose, axis=0)
    return work


def hand_work(poses: Array, efforts: Array) -> Array:
    """Return the work of the hand between samples [J].

    (N - 1, 6).

    Args:
        poses: Poses at the samples [m, rad], (N, 6).
        efforts: Wrenches of the hand from each sample on [N, N m], (N, 6).
    """
    work: Array = efforts[:-1] * np.diff(poses, axis=0)
    return work


class HandWork:
    """Accumulator of the hand's work.

    The hand's wrench is constant from sample to sample.

    Attributes:
        total: Work since the first sample [J]; NaN if a wrench of the hand is NaN, that is not known.
    """

    def __init__(self) -> None:
        self._pose: Array | None = None
        self._effort: Array = np.zeros(6)
        self.total = 0.0

    def add(self, pose: Array, effort: Sequence[float]) -> None:
        """Add the displacement up to a sample.

        Args:
            pose: Pose at the sample [m, rad], (6,).
            effort: Wrench of the hand from the sample on [N, N m], six.
        """
        if self._pose is None:
            self._pose, self._effort = pose, np.array(effort)
        self.total += float(self._effort @ (pose - self._pose))
        self._pose, self._effort = pose, np.array(effort)

    def take(self, poses: Array, efforts: Array) -> Array:
        """Add N samples; return the totals [J], (N,).

        The bits are the same as with one sample at a time.

        Args:
            poses: Poses at the samples [m, rad], (N, 6).
            efforts: Wrenches of the hand from each sample on [N, N m], (N, 6).
        """
        acting = np.concatenate([efforts[:1] if self._pose is None else self._effort[None], efforts[:-1]])
        ways = np.diff(poses, axis=0, prepend=poses[:1] if self._pose is None else self._pose[None])
        work = (acting[:, None, :] @ ways[:, :, None])[:, 0, 0]
        totals: Array = np.add.accumulate(np.append(self.total, work))[1:]
        self._pose, self._effort, self.total = poses[-1], efforts[-1], float(totals[-1])
        return totals


class EnergyAccount:
    """Energy account of hand and rendered environment.

    It is updated from sample to sample.

    The rendered environment is all actuator action besides weight compensation: walls, friction, springs. It has an
    energy tank: absorbed energy fills it, up to a bound above the energy of any spring here, and emitted energy empties
    it. An environment that emits more than its tank holds is not passive, and one that keeps emitting is unstable.

    Args:
        pose: At the start [m, rad], (6,).
        carried: Weight-bearing wrench of the actuators [N, N m], (6,); zero if there is none.
        tank: Largest energy that counts as stored [J].

    Attributes:
        taken: Energy absorbed by the rendered environment [J]; below 0 it has generated energy.
        stored: Energy in the tank [J]; below 0 by the generated energy.
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
        """Add the displacement up to a sample.

        Args:
            pose: Pose at the sample [m, rad], (6,).
            effort: Wrench of the hand from the sample on [N, N m], six.
            work: Work of the actuators since the start [J], as from a metered plant.
        """
        taken = float(self._carried @ (pose - self._pose)) - (work - self._work)
        self._hand.add(pose, effort)
        self.taken += taken
        self.stored = min(self.stored + taken, self._tank)
        self._pose, self._work = pose, work


class PassivityObserver:
    """Passivity observer of the rendered environment, axis by axis.

    It needs samples and commands alone.

    Pass it to `run` as `observe`. Between two samples up to four forces act in turn: the older command and the rest
    of its pulse, the newer command and its pulse. The inertia gives the displacement under each of them, exactly if the
    only other force is a constant load. Without inertia the motion is assumed straight, which is exact only if one
    force acts throughout, so without delay and pulse.

    Args:
        timing: Timing of the plant.
        inertia: Mass and moments of inertia of the six axes [kg, kg m²], (6,); None for a straight line.
        load: Further constant wrench, such as weight [N, N m], (6,).
        before: Wrench of the environment until the first command takes effect [N, N m], (6,).

    Attributes:
        energy: Absorbed energy [J], (..., 6).
        least: Least absorbed energy so far [J], (..., 6).

    Raises:
        ParameterError: If an inertia is not above 0.

    Source: Hannaford & Ryu 2002, with each force paired with the displacement during its action.
    """

    def __init__(
        self, timing: Timing, inertia: ArrayLike | None = None, load: ArrayLike = 0.0, before: ArrayLike = 0.0
    ) -> None:
        self._load = numbers("load", load)
        self._inertia = np.inf if inertia is None else numbers("inertia", inertia, at_least=1e-12)
        acting = np.zeros(6) + numbers("before", before)
        self._timeline, self._count = Timeline(timing, acting), 0
        for sample in range(-timing.whole, 0):  # as the answer to the samples before the first
            self._timeline.answer(sample, acting.copy())
        self._pose: Array | None = None
        self.energy: Array = np.zeros(6)
        self.least: Array = np.zeros(6)

    def __call__(self, sample: Sample, command: Command) -> None:
        """Process one sample and its command.

        Missing samples do not count.
        """
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
        """Process N samples of one device with their commands.

        The bits are the same as with one sample at a time.

        Args:
            poses: Poses [m, rad], (N, 6).
            held: Held wrenches of the commands [N, N m], (N, 6).
            pulses: Wrenches of their pulses [N, N m], (N, 6).
            widths: Widths of the pulses [s], (N,); 0 for none.

        Returns:
            Absorbed energy up to each sample [J], (N, 6).
        """
        groups: dict[int, list[tuple[int, list[Segment]]]] = {}  # by the number of segments in a period
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
        """Return the work of the forces over a period.

        It follows from the displacement between the samples and the segments of the period.
        """
        segments = [(duration, force, duration * ((force + self._load) / self._inertia)) for duration, force in periods]
        # speed at the start, such that the segments add up to the displacement between the samples
        place: Component = 0.0
        speed: Component = 0.0
        for duration, _, gained in segments:
            place, speed = place + duration * (speed + 0.5 * gained), speed + gained
        work: Component = 0.0
        speed = (moved - place) / self._timeline.timing.period
        for duration, force, gained in segments:
            work, speed = work + force * duration * (speed + 0.5 * gained), speed + gained
        return np.asarray(work)
