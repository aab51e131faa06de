"""Motion between recorded samples, and its figures: contacts at walls, energy, friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.control.timeline import peak_forces, recorded_switches
from maglev_mj.frames import AXES, Array, Mask, unit_of
from maglev_mj.plants.trace import Trace, actuator_work, hand_work
from maglev_mj.recording import InvalidRecordingError, RunMetadata, Segment
from maglev_mj.recording.sample import Face
from maglev_mj.result import Table, number_text, plain, with_unit
from maglev_mj.scenes.figures import Hardness, perceived_hardness, summarise_bounce

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
        mask: True for existing pieces, (M, S).
        width: Duration of each piece [s], (M, S); 0 for missing ones.
        force: Force of the actuators [N, N m], (M, S, 6).
        start: Start of each period [s], (M,).
    """

    mask: Mask
    width: Array
    force: Array
    start: Array


def reconstruct(segment: Segment) -> Motion:
    """Return the motion through the samples of a segment.

    Between two samples the recorded forces and their switching times are known. The speed at the first sample is such
    that the piecewise parabola under these forces ends at the second. Without other forces this is the exact motion.
    Other forces, such as those of an unmeasured hand, cause jumps of the speed at the samples; they are assumed
    constant from one sample to the next, and included in the parabolas.

    Time begins at release if the first sample is within a period of it, otherwise at the first sample.

    Args:
        segment: The segment.

    Raises:
        InvalidRecordingError: If it has less than two samples, or they are not in order.
    """
    if len(segment.tick) < 2:
        raise InvalidRecordingError(f"a segment must have at least 2 samples for analysis (got {len(segment.tick)})")
    if not (np.diff(segment.time) > 0.0).all():
        raise InvalidRecordingError("samples must be in time order")
    metadata = segment.metadata
    released = segment.time[0] < metadata.period * (1.0 - _ROUNDING)
    time = segment.time if released else segment.time - segment.time[0]
    pieces = _pieces(segment, time)
    steady = np.tile(metadata.load, (len(time) - 1, 1))
    if metadata.hand_acts_on_flotor:
        steady += segment.recorded_hand_wrench[:-1]
    _, twist, end = _through(segment.position, pieces, steady, metadata.inertia)
    period = np.diff(time)[:, None]
    jump = twist[1:, 0] - end[:-1]
    jumps = np.full((len(time), 6), np.nan)
    jumps[2:] = jump * period[1:]
    unexplained = _held(metadata.inertia * jump / (0.5 * (period[1:] + period[:-1])), len(period))
    pose, twist, end = _through(segment.position, pieces, steady + unexplained, metadata.inertia)
    trace, starts = _joined(segment.position, pieces, pose, twist, end, float(time[-1]))
    if time[0] > 0.0:
        trace, starts = _from_release(trace, metadata), starts + 1
    return Motion(trace, starts, jumps, unexplained)


def _pieces(segment: Segment, time: Array) -> _Pieces:
    """Cut the time between samples at force switches."""
    held, extra, widths = segment.applied, segment.applied_pulse, segment.applied_pulse_width
    metadata = segment.metadata
    times, force = recorded_switches(time, held, extra, widths, period=metadata.period, delay=metadata.delay)
    inside = times[(times > time[0]) & (times < time[-1])]
    knots = np.unique(np.concatenate([time, inside]))[:-1]
    period = np.searchsorted(time, knots, side="right") - 1
    slot = np.arange(len(knots)) - np.searchsorted(period, period)
    shape = (len(time) - 1, int(slot.max()) + 1)
    mask, width, forces = np.zeros(shape, dtype=np.bool_), np.zeros(shape), np.zeros((*shape, 6))
    mask[period, slot] = True
    width[period, slot] = np.diff(knots, append=time[-1])
    forces[period, slot] = np.vstack([metadata.before, force])[np.searchsorted(times, knots, side="right")]
    return _Pieces(mask, width, forces, time[:-1])


def _through(position: Array, pieces: _Pieces, steady: Array, inertia: Array) -> tuple[Array, Array, Array]:
    """Return pose and twist at the start of each piece.

    (M, S, 6) each; the twist at the end of each period is returned too.
    """
    width = pieces.width[:, :, None]
    push = (pieces.force + steady[:, None, :]) / inertia
    speed_gain = np.cumsum(width * push, axis=1)
    speed = np.concatenate([np.zeros_like(speed_gain[:, :1]), speed_gain[:, :-1]], axis=1)
    shift = np.cumsum(width * (speed + 0.5 * width * push), axis=1)
    elapsed = np.cumsum(width, axis=1)
    start = (np.diff(position, axis=0) - shift[:, -1]) / elapsed[:, -1]
    before, elapsed = (np.concatenate([np.zeros_like(part[:, :1]), part[:, :-1]], axis=1) for part in (shift, elapsed))
    pose = position[:-1, None, :] + before + elapsed * start[:, None, :]
    return pose, speed + start[:, None, :], start + speed_gain[:, -1]


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
    mask = np.column_stack([pieces.mask, np.ones(len(end), dtype=np.bool_)])
    time = np.append(pieces.start, finish)
    elapsed = np.cumsum(pieces.width, axis=1)
    knots = np.column_stack([time[:-1], time[:-1, None] + elapsed[:, :-1], time[1:]])
    last = pieces.mask.sum(axis=1) - 1
    wrench = np.concatenate([pieces.force, pieces.force[np.arange(len(end)), last][:, None]], axis=1)
    poses = np.concatenate([pose, position[1:, None, :]], axis=1)
    twists = np.concatenate([twist, end[:, None, :]], axis=1)
    counts = mask.sum(axis=1)
    total = int(counts.sum())
    starts = np.append(np.cumsum(counts) - counts, total - 1)
    return Trace(knots[mask], poses[mask], twists[mask], wrench[mask]), starts


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


_HARDNESS_WINDOW = 0.005
"""Window of the force rise for the hardness [s]."""

_REST = 0.1
"""Final share of a segment over which a settled flotor is at rest."""
_CONTACTS_SHOWN, _STICKS_SHOWN = 8, 8
_NOTHING = 1e-12
"""Figure below which a difference is rounding, in SI units."""


class Contact(NamedTuple):
    """Contact from entering a wall to leaving it.

    Attributes:
        start: Time of entry [s].
        duration: Time until the exit, or the end of the recording [s].
        approach_speed: Speed at entry [m/s, rad/s]; NaN if the recording begins inside.
        penetration: Largest depth [m, rad].
        peak_force: Largest force of the actuators on the axis during contact, either sign [N, N m].
    """

    start: float
    duration: float
    approach_speed: float
    penetration: float
    peak_force: float


@dataclass(frozen=True, kw_only=True, eq=False)
class OfWall:
    """Values that belong to a plane of a wall.

    Attributes:
        axis: Name of the axis.
        normal: 1 if the axis is free above the edge, -1 if below.
        edge: Edge of the wall [m, rad].
    """

    axis: str
    normal: float
    edge: float

    @classmethod
    def of(cls, face: Face, **values: Any) -> Self:
        """Return the values of a wall given by index of the axis, normal and edge."""
        axis, normal, edge = face
        return cls(axis=AXES[axis], normal=float(normal), edge=float(edge), **values)

    @property
    def name(self) -> str:
        """Axis, side and edge, such as "z below 0 mm"."""
        side = "below" if self.normal > 0.0 else "above"
        return f"{self.axis} {side} {self.edge * 1e3:.4g} {unit_of('mm', self.axis)}"


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceFigures(OfWall):
    """Figures of the contacts at one wall.

    Attributes:
        penetration: Largest depth of all [m, rad].
        rebound: Largest distance from the wall after the first contact, from any cause [m, rad].
        peak_force: Largest force of the actuators on the axis, in contact or not [N, N m].
        settling_time: Time from the start after which the position stays within 2 % of the way from start to rest
            around the rest [s]; NaN if the flotor does not rest over the last tenth.
        rest: Mean position over the last tenth [m, rad].
        rate_hardness: Rate-hardness of the contact with the fastest approach [N/m, N m/rad]; NaN if there is no such
            contact with enough time.
        extended_hardness: Extended rate-hardness of the same contact [N/m, N m/rad]; see `Hardness`.
        contacts: All contacts, in order.
    """

    penetration: float
    rebound: float
    peak_force: float
    settling_time: float
    rest: float
    rate_hardness: float
    extended_hardness: float
    contacts: Sequence[Contact]

    def row(self) -> list[str]:
        """Return the figures as texts for a table."""
        hard = 1.0 if self.axis in AXES[3:] else 1e-3
        figures = (
            (self.penetration, 1e3),
            (self.rebound, 1e3),
            (self.peak_force, 1.0),
            (self.settling_time, 1e3),
            (self.rate_hardness, hard),
            (self.extended_hardness, hard),
        )
        return [*(number_text(figure * scale, 3, 2) for figure, scale in figures), str(len(self.contacts))]


class Energy(NamedTuple):
    """Energy balance of each axis [J], (6,) each.

    Attributes:
        taken: Energy absorbed by the rendered environment; below 0 it has generated energy.
        least: Least absorbed energy at any switch of the force; the further below 0, the less passive.
        hand: Work of the hand; NaN if its force was not recorded.
        others: Work of unrecorded forces: of an unmeasured hand, or from a wrong mass.
    """

    taken: Array
    least: Array
    hand: Array
    others: Array


class Stick(NamedTuple):
    """One sticking phase of an axis.

    Attributes:
        start: Time of the first stuck sample [s].
        duration: Time until the first sliding sample, or the last of all [s].
        position: Final anchor of the friction spring [m, rad].
        slipped: True if it broke away; otherwise it stuck until the end.
    """

    start: float
    duration: float
    position: float
    slipped: bool


class Sticking(NamedTuple):
    """Stick-slip motion of an axis with friction.

    Attributes:
        slips: Number of breakaways.
        transitions: Number of transitions between stick and slip.
        sticks: Sticking phases, in order.
    """

    slips: int
    transitions: int
    sticks: Sequence[Stick]


@dataclass(frozen=True, kw_only=True, eq=False)
class SegmentFigures:
    """Figures of a segment.

    Attributes:
        samples: Number of samples.
        missed: Number of missing samples, by the gaps in their numbers.
        start: Time of the first sample [s].
        end: Time of the last sample [s].
        travel: Distance between the extremes of each axis [m, rad], (6,).
        peak_force: Largest wrench of the actuators on each axis [N, N m], (6,).
        device_force: Largest force of the device, pulses included, without weight compensation [N]; see TOTALS.
        faces: Touched walls.
        untouched: Number of untouched walls.
        energy: Energy balance.
        unexplained: Root mean square of the wrench of unrecorded forces [N, N m], (6,).
        friction: Stick-slip motion of each axis with friction, by its name.
    """

    samples: int
    missed: int
    start: float
    end: float
    travel: Array
    peak_force: Array
    device_force: float
    faces: Sequence[FaceFigures]
    untouched: int
    energy: Energy
    unexplained: Array
    friction: Mapping[str, Sticking]

    def tables(self, beside: SegmentFigures | None = None) -> list[Table]:
        """Return the tables of walls, contacts, axes and friction.

        Args:
            beside: Figures of the simulation, for rows beside; None for none.
        """
        tables = []
        for axes in (AXES[:3], AXES[3:]):  # translations and rotations differ in units
            if faces := [face for face in self.faces if face.axis in axes]:
                tables += [_walls(faces, beside), _contacts(faces)]
        if not self.faces:
            tables = [Table("", [], [], "no wall contact" if self.untouched else "no walls")]
        elif self.untouched:
            tables[-1] = tables[-1]._replace(note=f"{tables[-1].note}\nwalls without contact: {self.untouched}")
        return [*tables, self._axes(beside), *([_friction(self.friction)] if self.friction else [])]

    def _axes(self, beside: SegmentFigures | None) -> Table:
        """Return the table of travel and energy on each axis."""
        energy = self.energy
        by_hand = np.isfinite(energy.hand).any()
        work = ("work of the hand", energy.hand) if by_hand else ("unrecorded work", energy.others)
        rows = [
            axis_row("travel", self.travel, 1e3, "mm, mrad"),
            axis_row("energy absorbed", energy.taken, 1e3, "mJ"),
            *([] if beside is None else [axis_row("  simulated", beside.energy.taken, 1e3, "mJ")]),
            axis_row("  minimum", energy.least, 1e3, "mJ"),
            axis_row(*work, 1e3, "mJ"),
            axis_row("unrecorded force", self.unexplained, 1e3, "mN, mN m"),
        ]
        return Table("", ("", *AXES, ""), rows)

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        fields = {
            name: plain(getattr(self, name))
            for name in ("samples", "missed", "start", "end", "device_force", "faces", "friction")
        }
        axes = {"travel": self.travel, "peak_force": self.peak_force, "unexplained_force": self.unexplained}
        return {**fields, **by_axis(axes), "energy": by_axis(self.energy._asdict())}


def by_axis(values: Mapping[str, Array]) -> dict[str, Any]:
    """Return values (6,) by the names of their axes, ready for JSON."""
    return {name: dict(zip(AXES, plain(six))) for name, six in values.items()}


def axis_row(label: str, values: Array, scale: float, unit: str) -> tuple[str, ...]:
    """Return a row of a table with values of each axis, rounding errors as 0."""
    return label, *(number_text(v * scale, 3, 2) if abs(v) >= _NOTHING else "0" for v in values.tolist()), unit


def _walls(faces: Sequence[FaceFigures], beside: SegmentFigures | None) -> Table:
    """Return the table of walls, and of their simulation."""
    axis = faces[0].axis
    small, force = unit_of("mm", axis), unit_of("N", axis)
    stiff = "N/mm" if axis in AXES[:3] else unit_of("N/m", axis)
    units = {"penetration": small, "rebound": small, "peak force": force, "settling time": "ms"}
    units |= {"rate hardness": stiff, "extended hardness": stiff}
    rows = []
    for face in faces:
        rows.append((face.name, *face.row()))
        if beside is not None:
            twins = [one.row() for one in beside.faces if (one.axis, one.normal) == (face.axis, face.normal)]
            rows.append(("  simulated", *next(iter(twins), ["0.00", *["-"] * 5, "0"])))
    return Table("", ("wall", *(with_unit(*one) for one in units.items()), "contacts"), rows)


def _contacts(faces: Sequence[FaceFigures]) -> Table:
    """Return the table of the first contacts, by time."""
    small, force = unit_of("mm", faces[0].axis), unit_of("N", faces[0].axis)
    units = {"time": "s", "duration": "ms", "approach speed": f"{small}/s", "penetration": small, "peak force": force}
    contacts = [(one.start, face.name, one) for face in faces for one in face.contacts]
    contacts.sort(key=lambda row: (round(row[0], 7), row[1]))  # rounding must not order simultaneous ones
    rows = []
    for start, name, one in contacts[:_CONTACTS_SHOWN]:
        figures = (one.duration * 1e3, one.approach_speed * 1e3, one.penetration * 1e3, one.peak_force)
        rows.append((name, f"{start:.4f}", *(number_text(figure, 3, 2) for figure in figures)))
    more = len(contacts) - len(rows)
    head = "contact", *(with_unit(*one) for one in units.items())
    return Table("", head, rows, f"and {more} more: see --json" if more else "")


def _friction(axes: Mapping[str, Sticking]) -> Table:
    """Return the table of slips and stick positions."""
    rows = []
    for axis, friction in axes.items():
        longest = number_text(max(stick.duration for stick in friction.sticks) * 1e3, 3, 2)
        positions = [f"{stick.position * 1e3:.3f}" for stick in friction.sticks[:_STICKS_SHOWN]]
        more = len(friction.sticks) - len(positions)
        stuck = f"{', '.join(positions)}{f' and {more} more' if more else ''} {unit_of('mm', axis)}"
        rows.append((axis, friction.slips, longest, stuck))
    return Table("", ("friction", "slips", "longest stick [ms]", "stick positions"), rows)


def face_figures(trace: Trace, face: Face, *, rest: float | None = None) -> FaceFigures | None:
    """Return the figures of a wall, None if untouched.

    Args:
        trace: The motion.
        face: The wall: index into AXES, normal, edge.
        rest: Rest position of the flotor [m, rad]; its mean position over the last tenth by default.
    """
    axis, normal, edge = face
    line, begin = trace.along(axis), float(trace.time[0])
    # relative to the wall, which fills positions up to 0, from time 0
    line = Trace(line.time - begin, normal * (line.pose - edge), normal * line.twist, normal * line.wrench)
    curve = _Curve.of(line)
    if not curve.inside.any():
        return None
    contacts = curve.contacts()
    end = float(line.time[-1])
    tail = line.positions(np.linspace(end * (1.0 - _REST), end, 201))[:, 0]
    resting = float(tail.mean()) if rest is None else normal * (rest - edge)
    bounce = summarise_bounce(line, resting, axis=0)
    settled = float(bounce.settling_time)
    hardness = _hardness(line, contacts)
    return FaceFigures.of(
        face,
        penetration=float(bounce.penetration),
        rebound=float(bounce.rebound),
        peak_force=float(bounce.peak_force),
        settling_time=settled if settled <= end * (1.0 - _REST) else math.nan,
        rest=edge + normal * resting,
        rate_hardness=float(hardness.rate),
        extended_hardness=float(hardness.extended),
        contacts=[contact._replace(start=contact.start + begin) for contact in contacts],
    )


def _hardness(line: Trace, contacts: Sequence[Contact]) -> Hardness:
    """Return the hardness of the contact with fastest approach.

    A grazing contact has no hardness.
    """
    speeds = [contact.approach_speed for contact in contacts]
    undefined = Hardness(np.array(np.nan), np.array(np.nan))
    if np.isnan(speeds).all():
        return undefined
    index = int(np.nanargmax(speeds))
    if index:  # start midway between the previous contact and this one
        before, this = contacts[index - 1], contacts[index]
        start = 0.5 * (before.start + before.duration + this.start)
        pose, twist, wrench = line.at(start)
        later = line.time > start
        time = np.append(0.0, line.time[later] - start)
        parts = ((pose, line.pose), (twist, line.twist), (wrench, line.wrench))
        line = Trace(time, *(np.concatenate([first, part[later]]) for first, part in parts))
    is_long = float(line.time[-1]) > _HARDNESS_WINDOW
    return perceived_hardness(line, _HARDNESS_WINDOW, axis=0) if is_long else undefined


class _Curve(NamedTuple):
    """One axis at its knots and turning points, monotonic between them."""

    time: Array
    position: Array
    speed: Array
    force: Array
    inside: Mask

    @classmethod
    def of(cls, line: Trace) -> _Curve:
        """Return the curve of a trace of one axis."""
        turn_time, turn = (part[:, 0] for part in line.turning_points())
        knots, position, speed = line.time, line.pose[:, 0], line.twist[:, 0]
        turned = speed[:-1] * speed[1:] < 0.0
        times, positions = _interleave(knots, turn_time), _interleave(position, turn)
        speeds = _interleave(speed, np.where(turned, 0.0, speed[:-1]))
        return cls(times, positions, speeds, np.repeat(line.wrench[:, 0], 2)[:-1], positions <= 0.0)

    def contacts(self) -> list[Contact]:
        """Return every contact, in order."""
        changes = np.flatnonzero(self.inside[1:] != self.inside[:-1])
        crossings = [self._crossing(int(index)) for index in changes]
        entered = [(int(index) + 1, *crossing) for index, crossing in zip(changes, crossings) if self.inside[index + 1]]
        left = [(int(index), when) for index, (when, _) in zip(changes, crossings) if self.inside[index]]
        if self.inside[0]:
            entered.insert(0, (0, float(self.time[0]), math.nan))
        if self.inside[-1]:
            left.append((len(self.time) - 1, float(self.time[-1])))
        contacts = []
        for (first, start, speed), (last, end) in zip(entered, left, strict=True):
            depth = -float(self.position[first : last + 1].min())
            # from the piece of the entry on
            force = float(np.abs(self.force[max(first - 1, 0) : max(last, first) + 1]).max())
            contacts.append(Contact(start, end - start, speed, depth, force))
        return contacts

    def _crossing(self, index: int) -> tuple[float, float]:
        """Return time and speed of an edge crossing.

        It is after a given point: v² = v0² - 2 a x0, exact on a parabola.
        """
        width = self.time[index + 1] - self.time[index]
        start, speed = float(self.position[index]), float(self.speed[index])
        if width <= 0.0:
            return float(self.time[index]), abs(speed)
        push = (self.speed[index + 1] - speed) / width
        crossing = math.sqrt(max(speed * speed - 2.0 * push * start, 0.0))
        mean = 0.5 * (abs(speed) + crossing)
        elapsed = min(abs(start) / mean, width) if mean > 0.0 else 0.0
        return float(self.time[index] + elapsed), crossing


def _interleave(knots: Array, between: Array) -> Array:
    """Return values at knots interleaved with values between them."""
    values = np.empty(2 * len(knots) - 1)
    values[0::2], values[1::2] = knots, between
    return values


def segment_figures(
    motion: Motion, segment: Segment, anchors: Array | None, rest: float | None = None
) -> SegmentFigures:
    """Return the figures of a segment of N samples.

    Args:
        motion: The motion through them.
        segment: The samples.
        anchors: Stick positions at each sample [m, rad], (N, 6), NaN while sliding; None without friction.
        rest: Rest position at a wall [m, rad]; computed from the samples by default.
    """
    trace, metadata, ticks = motion.trace, segment.metadata, segment.tick
    faces = [figures for face in metadata.faces if (figures := face_figures(trace, face, rest=rest)) is not None]
    sticks = np.full((len(ticks), len(AXES)), np.nan) if anchors is None else anchors
    stuck = np.isfinite(sticks)
    return SegmentFigures(
        samples=len(ticks),
        missed=round(float(ticks[-1] - ticks[0])) + 1 - len(ticks),
        start=float(motion.time[0]),
        end=float(motion.time[-1]),
        travel=np.ptp(trace.pose, axis=0),
        peak_force=np.abs(trace.wrench[:-1]).max(axis=0),
        device_force=float(
            peak_forces(segment.applied - metadata.carried, segment.applied_pulse, segment.applied_pulse_width).max()
        ),
        faces=faces,
        untouched=len(metadata.faces) - len(faces),
        energy=_energy(motion, segment),
        unexplained=np.sqrt((motion.unexplained**2).mean(axis=0)),
        friction={
            AXES[axis]: _stick_slip(motion.time, stuck[:, axis], sticks[:, axis])
            for axis in np.flatnonzero(stuck.any(axis=0))
        },
    )


def _energy(motion: Motion, segment: Segment) -> Energy:
    """Return the energy balance of each axis.

    Each force is paired with the displacement during its action.
    """
    taken = -np.vstack([np.zeros(len(AXES)), np.cumsum(actuator_work(motion.trace, segment.metadata.carried), axis=0)])
    positions = motion.trace.pose[motion.starts]
    recorded = segment.metadata.hand_recorded
    work = hand_work(positions, segment.hand).sum(axis=0) if recorded else np.full(len(AXES), np.nan)
    return Energy(taken[-1], taken.min(axis=0), work, (motion.unexplained * np.diff(positions, axis=0)).sum(axis=0))


def _stick_slip(time: Array, stuck: Mask, anchors: Array) -> Sticking:
    """Return the stick-slip motion of an axis that sticks at some samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stuck, [False]]).astype(np.int8)))
    final = len(time) - 1
    sticks = [
        Stick(
            float(time[first]),
            float(time[min(last, final)] - time[first]),
            float(anchors[last - 1]),
            bool(last <= final),
        )
        for first, last in edges.reshape(-1, 2)
    ]
    slips = sum(stick.slipped for stick in sticks)
    return Sticking(slips, slips + sum(stick.start > time[0] for stick in sticks), sticks)
