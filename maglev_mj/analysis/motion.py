"""Motion between recorded samples, from the recorded forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.control.timeline import recorded_switches
from maglev_mj.frames import Array, Mask
from maglev_mj.plants.trace import Trace
from maglev_mj.recording import InvalidRecordingError, RunMetadata, Stretch

_ROUNDING = 1e-9

Numbers: TypeAlias = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the flotor over N samples.

    Attributes:
        trace: The motion through every sample, from 0 on; a sample with a jump of the speed has two knots.
        starts: Index of each sample's knot, the second of two, (N,).
        jumps: One-step prediction error of each sample, predicted from the sample before, its speed and the recorded
            forces [m, rad], (N, 6); NaN for the first two, because no earlier speed is known.
        unexplained: Wrench of unrecorded forces from each sample to the next [N, N m], (N - 1, 6).
    """

    trace: Trace
    starts: Numbers
    jumps: Array
    unexplained: Array

    @property
    def time(self) -> Array:
        """Times of the samples [s], (N,)."""
        return self.trace.time[self.starts]

    def between(self, first: int, last: int) -> Motion:
        """Return the motion between two samples, both included."""
        chosen = slice(0 if first == 0 else self.starts[first], self.starts[last] + 1)
        trace = self.trace
        parts = (part[chosen] for part in (trace.time, trace.pose, trace.twist, trace.wrench))
        starts = self.starts[first : last + 1] - chosen.start
        return Motion(Trace(*parts), starts, self.jumps[first : last + 1], self.unexplained[first:last])


class _Pieces(NamedTuple):
    """M periods cut at the switches of the force.

    Each has at most S pieces.

    Attributes:
        there: True for existing pieces, (M, S).
        width: Duration of each piece [s], (M, S); 0 for missing ones.
        force: Force of the actuators [N, N m], (M, S, 6).
        start: Start of each period [s], (M,).
    """

    there: Mask
    width: Array
    force: Array
    start: Array


def reconstruct(stretch: Stretch) -> Motion:
    """Return the motion through the samples of a stretch.

    Between two samples the recorded forces and their switching times are known. The speed at the first sample is such
    that the piecewise parabola under these forces ends at the second. Without other forces this is the exact motion.
    Other forces, such as those of an unmeasured hand, cause jumps of the speed at the samples; they are assumed
    constant from one sample to the next, and included in the parabolas.

    Time begins at release if the first sample is within a period of it, otherwise at the first sample.

    Args:
        stretch: The stretch.

    Raises:
        InvalidRecordingError: If it has less than two samples, or they are not in order.
    """
    if len(stretch.tick) < 2:
        raise InvalidRecordingError(f"a stretch must have at least 2 samples to be analysed, not {len(stretch.tick)}")
    if not (np.diff(stretch.time) > 0.0).all():
        raise InvalidRecordingError("the samples of a recording must be in the order in which they were taken")
    metadata = stretch.metadata
    released = stretch.time[0] < metadata.period * (1.0 - _ROUNDING)
    time = stretch.time if released else stretch.time - stretch.time[0]
    pieces = _pieces(stretch, time)
    steady = np.tile(metadata.load, (len(time) - 1, 1))
    if metadata.hand_acts_on_flotor:
        steady += stretch.known_hand[:-1]
    _, twist, end = _through(stretch.position, pieces, steady, metadata.inertia)
    period = np.diff(time)[:, None]
    jump = twist[1:, 0] - end[:-1]
    jumps = np.full((len(time), 6), np.nan)
    jumps[2:] = jump * period[1:]
    unexplained = _held(metadata.inertia * jump / (0.5 * (period[1:] + period[:-1])), len(period))
    pose, twist, end = _through(stretch.position, pieces, steady + unexplained, metadata.inertia)
    trace, starts = _joined(stretch.position, pieces, pose, twist, end, float(time[-1]))
    if time[0] > 0.0:
        trace, starts = _from_release(trace, metadata), starts + 1
    return Motion(trace, starts, jumps, unexplained)


def _pieces(stretch: Stretch, time: Array) -> _Pieces:
    """Cut the time between samples at force switches."""
    held, extra, widths = stretch.applied, stretch.applied_pulse, stretch.applied_pulse_width
    metadata = stretch.metadata
    when, force = recorded_switches(time, held, extra, widths, period=metadata.period, delay=metadata.delay)
    inside = when[(when > time[0]) & (when < time[-1])]
    knots = np.unique(np.concatenate([time, inside]))[:-1]
    period = np.searchsorted(time, knots, side="right") - 1
    slot = np.arange(len(knots)) - np.searchsorted(period, period)
    shape = (len(time) - 1, int(slot.max()) + 1)
    there, width, forces = np.zeros(shape, dtype=np.bool_), np.zeros(shape), np.zeros((*shape, 6))
    there[period, slot] = True
    width[period, slot] = np.diff(knots, append=time[-1])
    forces[period, slot] = np.vstack([metadata.before, force])[np.searchsorted(when, knots, side="right")]
    return _Pieces(there, width, forces, time[:-1])


def _through(position: Array, pieces: _Pieces, steady: Array, inertia: Array) -> tuple[Array, Array, Array]:
    """Return pose and twist at the start of each piece.

    (M, S, 6) each; the twist at the end of each period is returned too.
    """
    width = pieces.width[:, :, None]
    push = (pieces.force + steady[:, None, :]) / inertia
    gained = np.cumsum(width * push, axis=1)
    speed = np.concatenate([np.zeros_like(gained[:, :1]), gained[:, :-1]], axis=1)
    way = np.cumsum(width * (speed + 0.5 * width * push), axis=1)
    gone = np.cumsum(width, axis=1)
    start = (np.diff(position, axis=0) - way[:, -1]) / gone[:, -1]
    before, elapsed = (np.concatenate([np.zeros_like(part[:, :1]), part[:, :-1]], axis=1) for part in (way, gone))
    pose = position[:-1, None, :] + before + elapsed * start[:, None, :]
    return pose, speed + start[:, None, :], start + gained[:, -1]


def _held(at_samples: Array, periods: int) -> Array:
    """Return forces between samples from those at samples.

    (M, 6), from those at the M - 1 inner samples.
    """
    if not len(at_samples):
        return np.zeros((periods, 6))
    return 0.5 * (np.vstack([at_samples[:1], at_samples]) + np.vstack([at_samples, at_samples[-1:]]))


def _joined(
    position: Array, pieces: _Pieces, pose: Array, twist: Array, end: Array, finish: float
) -> tuple[Trace, Numbers]:
    """Return one curve, with each sample's knot index."""
    there = np.column_stack([pieces.there, np.ones(len(end), dtype=np.bool_)])
    time = np.append(pieces.start, finish)
    elapsed = np.cumsum(pieces.width, axis=1)
    knots = np.column_stack([time[:-1], time[:-1, None] + elapsed[:, :-1], time[1:]])
    last = pieces.there.sum(axis=1) - 1
    wrench = np.concatenate([pieces.force, pieces.force[np.arange(len(end)), last][:, None]], axis=1)
    poses = np.concatenate([pose, position[1:, None, :]], axis=1)
    twists = np.concatenate([twist, end[:, None, :]], axis=1)
    counts = there.sum(axis=1)
    total = int(counts.sum())
    starts = np.append(np.cumsum(counts) - counts, total - 1)
    return Trace(knots[there], poses[there], twists[there], wrench[there]), starts


def _from_release(trace: Trace, metadata: RunMetadata) -> Trace:
    """Return the curve from time 0 on.

    Before the first sample the flotor moves under the wrench at release.
    """
    ahead = trace.time[0]
    push = (metadata.before + metadata.load) / metadata.inertia
    twist = trace.twist[0] - ahead * push
    pose = trace.pose[0] - ahead * (twist + 0.5 * ahead * push)
    rows = (np.zeros(1), pose[None], twist[None], metadata.before[None])
    old = (trace.time, trace.pose, trace.twist, trace.wrench)
    return Trace(*(np.concatenate([row, rest]) for row, rest in zip(rows, old, strict=True)))
