"""Identification of walls, friction, mass, delay and sensor.

A recording allows two fits. Commands over measured positions give the law, exactly if it is a spring and a damper.
Positions under recorded forces give mass, delay and constant forces, and with springs and dampers of unknown gain the
actual stiffness of a wall; see `fit`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.analysis.fit import (
    CommandedLaw,
    Estimate,
    Fit,
    Forces,
    Part,
    Windows,
    estimate_noise,
    estimate_quantum,
    fit_constant,
    fit_law,
    fit_motion,
    is_inside,
    unit_integrals,
)
from maglev_mj.analysis.motion import OfWall, reconstruct
from maglev_mj.control.timeline import recorded_switches, split_delay
from maglev_mj.errors import check_instance
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.keywords import checked
from maglev_mj.recording import RunMetadata, Segment
from maglev_mj.recording.recording import SEGMENT_TYPE
from maglev_mj.recording.sample import Face
from maglev_mj.recording.setup import MEASURED
from maglev_mj.result import Table, plain
from maglev_mj.spec import MAX_DELAY
from maglev_mj.theory import largest_stable_stiffness

_MOST_SAMPLES, _LEAST_SAMPLES, _LEAST_INSIDE, _LEAST_DEGREES = 20_000, 12, 5, 6
_MOST_DELAY = 0.1
"""Largest standard error of an identified delay, in periods."""
_GYRATION = 0.036
"""Radius of gyration of the flotor [m]."""
_DECIMALS = 4
_STILL = 1e-9
"""Largest travel of an axis at rest [m, rad]."""
_HOLDS = 0.5
"""Share of the breakaway force above which friction after a slip counts as continuing."""
_WRONG_MASS, _ERRORS = 0.05, 3.0
"""Least error of a stated mass, relative and in standard errors, for which the identified one replaces it."""


@dataclass(frozen=True, kw_only=True)
class AxisEstimates:
    """Identified quantities of a coordinate, independent of the law.

    Attributes:
        inertia: Moving mass or moment of inertia, if the forces are as commanded [kg, kg m²].
        delay: Time from a sample to the switch of the force [s].
        force_error: Constant force in addition to the recorded load and weight compensation [N, N m].
        noise: Standard deviation of the sensor's noise before quantization [m, rad].
        quantum: Step of the positions [m, rad].
    """

    inertia: Estimate = field(metadata={"row": ("mass", "kg")})
    delay: Estimate
    force_error: Estimate = field(metadata={"row": ("uncompensated force", "mN", 1e3)})
    noise: Estimate = field(metadata={"row": ("noise", "µm", 1e6)})
    quantum: Estimate = field(metadata={"row": ("resolution", "µm", 1e6)})


@dataclass(frozen=True, kw_only=True)
class WallEstimates(OfWall):
    """Identified quantities of a wall.

    Attributes:
        stiffness: Stiffness from the motion, with the recorded mass of the flotor [N/m, N m/rad].
        damping: Damping from the motion, with the recorded mass of the flotor [N s/m, N m s/rad].
        share: Stiffness over the largest stable stiffness at this damping and delay.
        commanded_stiffness: Slope of the commands over the measured position [N/m, N m/rad].
        commanded_damping: Slope of the commands over its difference quotient [N s/m, N m s/rad].
    """

    stiffness: Estimate = field(metadata={"row": ("stiffness", "N/m")})
    damping: Estimate = field(metadata={"row": ("damping", "N s/m")})
    share: Estimate = field(metadata={"row": ("of critical stiffness", "%", 1e2)})
    commanded_stiffness: Estimate = field(metadata={"row": ("commanded stiffness", "N/m", 1.0, "N")})
    commanded_damping: Estimate = field(metadata={"row": ("commanded damping", "N s/m", 1.0, "N")})


@dataclass(frozen=True, kw_only=True)
class FrictionFit:
    """Identified friction of an axis.

    Attributes:
        stiffness: Stiffness while stuck, from the motion [N/m, N m/rad].
        commanded_stiffness: Stiffness while stuck, slope of the commands [N/m, N m/rad].
        breakaway: Largest friction before slip, as commanded [N, N m].
        sliding: Friction while sliding that does not depend on the speed, as commanded [N, N m].
        damping: Total viscous damping on the axis, as commanded [N s/m, N m s/rad].
    """

    stiffness: Estimate = field(metadata={"row": ("stiffness", "N/m")})
    commanded_stiffness: Estimate = field(metadata={"row": ("commanded stiffness", "N/m", 1.0, "N")})
    breakaway: Estimate = field(metadata={"row": ("breakaway force", "N", 1.0, "N")})
    sliding: Estimate = field(metadata={"row": ("sliding friction", "N", 1.0, "N")})
    damping: Estimate = field(metadata={"row": ("damping", "N s/m", 1.0, "N")})


_Estimates: TypeAlias = AxisEstimates | WallEstimates | FrictionFit


_RESAMPLED = Estimate(why="resampled")


def _every(kind: type[_Estimates], estimate: Estimate) -> dict[str, Estimate]:
    """Return the same estimate for all quantities."""
    return {quantity.name: estimate for quantity in fields(kind) if quantity.type == "Estimate"}


class _Row(NamedTuple):
    """Row of the table of identified quantities.

    Owner, axis, name, estimate, its unit on a translation and scale, and unit of its residual on a translation.
    """

    owner: str
    axis: str
    name: str
    estimate: Estimate
    unit: str
    scale: float = 1.0
    residual_unit: str = "µm"

    def cells(self) -> tuple[str, ...]:
        """Return an identified quantity as texts, its value rounded to two digits of its error."""
        value, error = self.estimate.value * self.scale, self.estimate.standard_error * self.scale
        decimals = min(max(1 - math.floor(math.log10(error)), 0), _DECIMALS) if error > 0.0 else _DECIMALS
        residual = self.estimate.residual * (1e6 if self.residual_unit == "µm" else 1.0)
        return (
            f"{'  ' if self.owner else ''}{self.name}",
            f"{round(value, decimals) + 0.0:.{decimals}f}",
            f"{error:.2g}" if error < 100.0 else f"{error:.0f}",
            unit_of(self.unit, self.axis),
            f"{residual:.2g} {unit_of(self.residual_unit, self.axis)}",
        )


@dataclass(frozen=True, kw_only=True)
class Identification:
    """All quantities identified from a segment.

    Attributes:
        axes: Quantities of each axis that moves, by its name.
        walls: Every plane of a wall.
        friction: Friction of each axis that has some, by its name.
        samples: Largest number of samples used on an axis.
        of: Number of samples in the segment.
        replaced: Stated masses and moments of inertia, by axis, that the motion of a measured recording contradicts:
            the identified ones replace them in the gains from the motion.
    """

    axes: Mapping[str, AxisEstimates]
    walls: Sequence[WallEstimates]
    friction: Mapping[str, FrictionFit]
    samples: int
    of: int
    replaced: Mapping[str, float] = field(default_factory=dict)

    @property
    def delay(self) -> Estimate:
        """Delay from the axis with the smallest error [s]."""
        delays = [estimates.delay for estimates in self.axes.values()] or [Estimate(why="no motion")]
        return min(delays, key=lambda delay: delay.standard_error if delay.known else math.inf)

    @property
    def outside(self) -> list[str]:
        """Quantities outside the validated ranges of the intervals; see docs/explanation/analysis.md."""
        outside = [
            f"{wall.name} at {wall.share.value:.0%} of critical" for wall in self.walls if wall.share.beyond(0.1, 0.8)
        ]
        for axis, friction in self.friction.items():
            if axis in AXES[:3] and friction.breakaway.beyond(0.5, 3.0):
                outside.append(f"breakaway force {friction.breakaway.value:.2g} N on {axis}")
        for axis, sensor in self.axes.items():
            if axis in AXES[:3] and (sensor.noise.beyond(0.0, 5.05e-6) or sensor.quantum.beyond(0.0, 5.05e-6)):
                outside.append(f"noise or resolution above 5 µm on {axis}")
        return outside

    def _rows(self) -> Iterator[_Row]:
        best = next((axis for axis, estimates in self.axes.items() if estimates.delay is self.delay), AXES[0])
        yield _Row("", best, "effective delay", self.delay, "ms", 1e3)
        owners: list[tuple[str, str, _Estimates]] = [(wall.name, wall.axis, wall) for wall in self.walls]
        owners += [(f"friction on {axis}", axis, friction) for axis, friction in self.friction.items()]
        owners += [(axis, axis, estimates) for axis, estimates in self.axes.items()]
        for owner, axis, estimates in owners:
            for quantity in (quantity for quantity in fields(estimates) if "row" in quantity.metadata):
                name, *cells = quantity.metadata["row"]
                if name == "mass" and axis in AXES[3:]:
                    name, *cells = "moment of inertia", "g m²", 1e3
                yield _Row(owner, axis, name, getattr(estimates, quantity.name), *cells)

    def table(self) -> Table:
        """Return a row for each identified quantity, and the reasons for the others below."""
        rows: list[tuple[str, ...]] = []
        failures: dict[tuple[str, str], list[str]] = {}
        heading = ""
        for (owner, why), group in groupby(self._rows(), key=lambda row: (row.owner, row.estimate.why)):
            quantities = list(group)
            if why:
                failures.setdefault((", ".join(row.name for row in quantities), why), []).append(owner)
                continue
            if owner not in ("", heading):
                rows.append((owner, *[""] * 4))
            heading = owner
            rows += [row.cells() for row in quantities]
        remarks = []
        for (names, why), owners in failures.items():
            of = f" of {', '.join(owners)}" if any(owners) else ""
            remarks.append(f"not identifiable: {names}{of}: {why}")
        for axis, stated in self.replaced.items():
            unit, mass = unit_of("kg", axis), self.axes[axis].inertia.value
            text = f"{stated:.4g} {unit} was stated, {mass:.4g} {unit} explains the motion and is used for the gains"
            remarks.append(f"wrong mass on {axis}: {text}")
        if self.outside:
            remarks.append(f"error estimates not validated for: {', '.join(self.outside)}")
        if self.samples < self.of:
            remarks.append(f"based on {self.samples} of {self.of} samples; see docs/explanation/analysis.md")
        return Table("", ("identified", "value", "std. error", "unit", "residual"), rows, "\n".join(remarks))

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        names = [part.name for part in fields(self) if part.name != "replaced" or self.replaced]
        values = {name: plain(getattr(self, name)) for name in names}
        return {"outside": self.outside, "delay": plain(self.delay), **values}


@checked(own="segment")
def identify(segment: Segment, metadata: RunMetadata | None = None, *, anchors: Array | None = None) -> Identification:
    """Identify walls, friction, mass, delay and sensor.

    Each quantity has its standard error.

    Each coordinate is treated separately. Of a long segment the 20 000 samples with the most curved motion are used.

    Args:
        segment: The segment.
        metadata: Metadata of the run; the segment's own by default.
        anchors: Stick positions at each sample [m, rad], (N, 6); None without friction.

    Example:
        >>> from maglev_mj import record_run
        >>> from maglev_mj.scenes.drop import Drop
        >>> (segment,) = record_run(Drop(stiffness=5000.0, quantize=5e-6), plant="exact").segments
        >>> (wall,) = identify(segment).walls
        >>> bool(wall.stiffness.low < 5000.0 < wall.stiffness.high), bool(0.49 < wall.share.value < 0.5)
        (True, True)
    """
    check_instance("segment", segment, Segment, SEGMENT_TYPE)
    if metadata is not None:
        segment = replace(segment, setup={**segment.setup, "run": metadata.as_json()})
    axes: dict[str, AxisEstimates] = {}
    walls: list[WallEstimates] = []
    friction: dict[str, FrictionFit] = {}
    replaced: dict[str, float] = {}
    resampled = segment.setup["kind"] == MEASURED and segment.setup["parameters"]["resampled"]
    used = 0
    for index, name in enumerate(AXES):
        stuck = None if anchors is None or not np.isfinite(anchors[:, index]).any() else anchors[:, index]
        faces = [face for face in segment.metadata.faces if face[0] == index]
        axis = _Axis.of(segment, index, stuck)
        if isinstance(axis, _Axis):
            axes[name] = axis.estimates()
            if axis.inertia != segment.metadata.inertia[index]:
                replaced[name] = float(segment.metadata.inertia[index])
            if resampled:
                axes[name] = replace(axes[name], delay=_RESAMPLED, noise=_RESAMPLED)
            used = max(used, int(axis.used.sum()))
            walls += [axis.wall(face) for face in faces]
        else:
            walls += [WallEstimates.of(face, **_every(WallEstimates, axis)) for face in faces]
        if stuck is not None:
            friction[name] = axis.friction() if isinstance(axis, _Axis) else FrictionFit(**_every(FrictionFit, axis))
    return Identification(axes=axes, walls=walls, friction=friction, samples=used, of=len(segment), replaced=replaced)


class _Axis:
    """One coordinate of a segment, with its fits.

    Args:
        segment: N samples: those used, and earlier ones whose commands take effect during them.
        axis: Index into AXES.
        anchors: Stick positions [m, rad], (N,); None without friction.
        windows: Windows of the samples used.
        held: True if an unrecorded spring and damper act on it, such as those of an arm.

    Attributes:
        position: Positions [m, rad], (N,).
        used: True for samples in a window, (N,).
        inertia: Recorded mass or moment of inertia [kg, kg m²]; the identified one if that is wrong.
        faces: Touched walls of the axis.
        forces: All recorded forces, a constant, and those of a holding hand.
        motion: Fit of the motion by these forces. It has their common factor, a constant, and their delay.
    """

    def __init__(
        self, segment: Segment, axis: int, anchors: Array | None, windows: Windows, *, held: bool = False
    ) -> None:
        self.segment, self.metadata, self.axis = segment, segment.metadata, axis
        self.anchors, self.windows, self.held = anchors, windows, held
        self.period, self.inertia = self.metadata.period, float(self.metadata.inertia[axis])
        self.position = np.ascontiguousarray(segment.position[:, axis])
        self.used = np.zeros(len(segment), dtype=np.bool_)
        self.used[windows.rows[windows.mask]] = True
        faces = [face for face in self.metadata.faces if face[0] == axis]
        self.faces = [face for face in faces if self._count_inside(face) >= _LEAST_INSIDE]
        self.forces = self._forces(np.zeros((len(segment), 0)), segment.applied[:, axis])
        self.motion = fit_motion(self.forces, windows, self.position, self.metadata.delay, self.period)
        if segment.setup["kind"] == MEASURED and (mass := self._inertia()).known:
            if abs(mass.value - self.inertia) > max(_ERRORS * mass.standard_error, _WRONG_MASS * self.inertia):
                self.inertia = mass.value

    @classmethod
    def of(cls, segment: Segment, axis: int, anchors: Array | None) -> _Axis | Estimate:
        """Return the coordinate with its selected samples, or an estimate with the reason against it.

        Of a long segment, the windows with the most curved motion are selected.
        """
        if len(segment) < _LEAST_SAMPLES:
            return Estimate(why=f"only {len(segment)} samples")
        if not np.ptp(segment.position[:, axis]) > _STILL:
            return Estimate(why="no motion on this axis")
        period = segment.metadata.period
        # the delayed commands after a gap are unknown
        ahead = int(split_delay(segment.metadata.delay, period)[0]) + 2
        breaks = (np.flatnonzero(np.diff(segment.tick) != 1) + 1).tolist()
        first = 0 if segment.time[0] < period else ahead
        runs = zip([first, *(index + ahead for index in breaks)], [*breaks, len(segment)])
        windows = Windows.cut(segment.time, [(start, end) for start, end in runs if end > start], period)
        windows = windows.choose(segment.position[:, axis], _MOST_SAMPLES)
        if windows.mask.sum() < _LEAST_SAMPLES:
            return Estimate(why="too few consecutive samples")
        needed = np.unique(np.maximum(windows.rows[windows.mask][:, None] - np.arange(ahead + 1), 0))
        windows = windows._replace(rows=np.searchsorted(needed, windows.rows) * windows.mask)
        stuck = None if anchors is None else anchors[needed]
        free = cls(segment[needed], axis, stuck, windows)
        if not free.disturbed:
            return free
        held = cls(segment[needed], axis, stuck, windows, held=True)
        return free if held.disturbed else held

    def _count_inside(self, face: Face) -> int:
        """Return the number of used samples in a wall."""
        return int((is_inside(self.position, face) & self.used).sum())

    def _forces(self, parts: Array, rest: Array) -> Forces:
        """Return P parts of the command, the rest of the recorded forces, a constant, and forces of a holding hand.

        Args:
            parts: Parts of the command, (N, P).
            rest: The command without them [N, N m], (N,).
        """
        segment, axis = self.segment, self.axis
        held = np.column_stack([parts, rest])
        pulse = np.column_stack([np.zeros_like(parts), segment.applied_pulse[:, axis]])
        width = segment.applied_pulse_width
        switch, levels = recorded_switches(segment.time, held, pulse, width, period=self.period, delay=0.0)
        before = np.append(np.zeros(parts.shape[1]), self.metadata.before[axis])
        hand = segment.recorded_hand_wrench[:-1, axis] * self.metadata.hand_acts_on_flotor
        prompt = unit_integrals(np.diff(segment.time)) * np.column_stack([hand, np.ones(len(hand))])[:, None]
        if self.held:
            prompt = np.concatenate([prompt, self._impedance], axis=2)
        return Forces(time=segment.time, switch=switch, levels=np.vstack([before, levels]), prompt=prompt)

    @cached_property
    def _impedance(self) -> Array:
        """Integral and double integral of a unit spring's and damper's force over each period, (N - 1, 2, 2)."""
        motion = reconstruct(self.segment)
        first, starts = motion.starts[0], motion.starts - motion.starts[0]
        trace = motion.trace.along(self.axis)
        knots, position, speed = (part[first:] for part in (trace.time, trace.pose[:, 0], trace.twist[:, 0]))
        width = np.diff(knots)
        bend = np.diff(position) - speed[:-1] * width
        # integral of the parabola between two knots, and its first moment about the earlier one
        integral = width * (position[:-1] + 0.5 * width * speed[:-1] + bend / 3.0)
        moment = width**2 * (position[:-1] / 2.0 + width * speed[:-1] / 3.0 + bend / 4.0)
        remaining = np.repeat(knots[starts[1:]], np.diff(starts)) - knots[:-1]
        spring = -np.add.reduceat([integral, remaining * integral - moment], starts[:-1], axis=1)
        start, end = self.position[:-1], self.position[1:]
        damper = [start - end, np.diff(self.segment.time) * start + spring[0]]
        return np.transpose([spring, damper])

    @cached_property
    def disturbed(self) -> str:
        """Reason for a motion with unrecorded forces, or empty.

        Empty if the motion is that of a mass under the recorded forces.
        """
        travel = np.ptp(self.segment.position, axis=0)
        travel[:3] /= _GYRATION
        # the product of two coordinates acts on a rotation; the model omits it
        if self.axis >= 3 and np.delete(travel, self.axis).max() * travel[3:].max() > self.motion.residual:
            return "coupled to other axes"
        return "unrecorded forces" if self.motion.is_incomplete else ""

    @cached_property
    def _why(self) -> str:
        """Reason against identification from the motion, or empty."""
        if self.disturbed:
            return self.disturbed
        factor = float(self.motion.values[0])
        is_driven = factor > 0.0 and self.motion.moves(0, factor)
        return "" if is_driven else "force variation below the noise"

    def estimates(self) -> AxisEstimates:
        """Return the quantities identified from the motion, independent of the law."""
        quantum = estimate_quantum(self.position[self.used])
        if self.disturbed:
            failure = Estimate(why=self.disturbed, residual=self.motion.residual)
            return AxisEstimates(**_every(AxisEstimates, failure) | {"quantum": quantum})
        return AxisEstimates(
            inertia=self._inertia(),
            delay=self._delay(),
            force_error=self._force_error(),
            noise=estimate_noise(self.motion, self.windows, self.position, quantum.value if quantum.known else 0.0),
            quantum=quantum,
        )

    def _inertia(self) -> Estimate:
        """Return the moving mass, or moment of inertia."""
        if self._why:
            return Estimate(why=self._why)
        mass = 1.0 / self.motion.values[0]
        return self.motion.estimate(mass, {0: mass**2})

    def _delay(self) -> Estimate:
        """Return the delay of the force."""
        if self._why:
            return Estimate(why=self._why)
        delay = self.motion.estimate(self.motion.values[-1], {-1: 1.0})
        if not self.motion.moves(-1, self.period) or delay.standard_error > _MOST_DELAY * self.period:
            return Estimate(why="force changes too small")
        return delay

    def _force_error(self) -> Estimate:
        """Return the constant force in addition to the recorded load, with the recorded mass if none is identified."""
        load = float(self.metadata.load[self.axis])
        if self._why:
            mass = self.inertia
            constant = fit_constant(self.forces, self.windows, self.position, self.metadata.delay, mass)
            return constant.estimate(mass * constant.values[0] - load, {0: mass})
        factor, acceleration = self.motion.values[:2]
        mass = 1.0 / factor
        return self.motion.estimate(mass * acceleration - load, {0: -acceleration * mass**2, 1: mass})

    # -- the law --------------------------------------------------------------------------------------------------

    @cached_property
    def law(self) -> CommandedLaw:
        """Law as a fit of commands by positions."""
        return fit_law(self.segment, self.axis, self.faces, self.anchors, self.used)

    @cached_property
    def rendered(self) -> Fit:
        """Fit of the motion by the law's parts.

        Each part's gain is identified from the motion.
        """
        forces, delay = self._forces(self.law.parts, self.law.rest), float(self.motion.values[-1])
        return fit_motion(forces, self.windows, self.position, delay, self.period)

    def _from_motion(self, name: Part) -> Estimate:
        """Return a gain identified from the motion, with the recorded mass."""
        if self._why:
            return Estimate(why=self._why, residual=self.motion.residual)
        commanded = self.law.estimates
        if not commanded[name].known:
            return commanded[name]
        rendered, index = self.rendered, list(commanded).index(name)
        if rendered.degrees < _LEAST_DEGREES:
            return Estimate(why="too few samples for the laws on this axis")
        if not rendered.moves(index, rendered.values[index]):
            return Estimate(why="effect on the motion below the noise")
        return rendered.estimate(self.inertia * rendered.values[index], {index: self.inertia})

    def wall(self, face: Face) -> WallEstimates:
        """Return the identified quantities of a wall."""
        if face not in self.faces:
            count = self._count_inside(face)
            failure = Estimate(why=f"only {count} samples in contact" if count else "no contact")
            return WallEstimates.of(face, **_every(WallEstimates, failure))
        spring, damper = ("stiffness", self.faces.index(face)), ("damping", self.faces.index(face))
        return WallEstimates.of(
            face,
            stiffness=self._from_motion(spring),
            damping=self._from_motion(damper),
            share=self._share(spring, damper),
            commanded_stiffness=self.law.estimates[spring],
            commanded_damping=self.law.estimates[damper],
        )

    def _share(self, *gains: Part) -> Estimate:
        """Return a wall's share of the largest stable stiffness.

        Its stiffness includes all other springs on the axis.
        """
        for estimate in map(self._from_motion, gains):
            if not estimate.known:
                return estimate
        rendered, names, mass = self.rendered, list(self.law.estimates), self.inertia
        weights = np.zeros((3, len(rendered.values)))
        for row, gain, everywhere in zip(weights, gains, (("spring", 0), ("damper", 0))):
            row[[index for index, name in enumerate(names) if name in (gain, everywhere)]] = mass
        weights[2, -1] = 1.0
        stiffness, damping, delay = weights @ rendered.values
        errors = np.sqrt(np.maximum(np.diag(weights @ rendered.covariance @ weights.T), 0.0))[1:]
        # the boundary at the identified damping and delay, and one standard error to either side of each
        offsets = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * errors
        dampings, delays = np.maximum(np.array([damping, delay]) + offsets, 0.0).T
        if delays.max() > MAX_DELAY:
            return Estimate(why=f"delay above {MAX_DELAY:g} s, the limit of the theory")
        most = largest_stable_stiffness(dampings, delay=delays, period=self.period, mass=mass)
        if not most.min() > 0.0:
            return Estimate(why="no wall is stable at this damping and delay")
        share = stiffness / most[0]
        reach = np.maximum(2.0 * errors, np.finfo(np.float64).tiny)
        slopes = np.array([1.0 / most[0], *(-share / most[0] * (most[1::2] - most[2::2]) / reach)])
        return rendered.estimate(float(share), dict(enumerate(slopes @ weights)))

    # -- friction -------------------------------------------------------------------------------------------------

    def friction(self) -> FrictionFit:
        """Return the identified friction."""
        return FrictionFit(
            stiffness=self._from_motion(("stuck", 0)),
            commanded_stiffness=self.law.estimates["stuck", 0],
            breakaway=self._breakaway(),
            sliding=self.law.estimates["sliding", 0],
            damping=self.law.estimates["damper", 0],
        )

    def _breakaway(self) -> Estimate:
        """Return the breakaway force, between the largest force while stuck and the smallest that caused slip."""
        law, anchors = self.law, self.anchors
        stiffness = law.estimates["stuck", 0]
        if not stiffness.known or anchors is None:
            return stiffness
        index = [list(law.estimates).index((name, 0)) for name in ("stuck", "sliding")]
        force = np.abs(law.parts[:, index] @ law.gains[index])
        stuck = np.isfinite(anchors)
        next_to = self.used[:-1] & self.used[1:] & (np.diff(self.segment.tick) == 1)
        last = np.flatnonzero(stuck[:-1] & ~stuck[1:] & next_to)
        if not len(last):
            return Estimate(why="no slip")
        ends = force[last], force[last + 1]
        if np.median(ends[1]) > _HOLDS * np.median(ends[0]):  # sliding continues at the breakaway force
            return law.estimates["sliding", 0]
        if not stiffness.value > 0.0:
            return Estimate(why="no sticking")
        largest = float(force[stuck & self.used].max())
        least = float((stiffness.value * np.abs(anchors[last] - self.position[last + 1])).min())
        middle, width = 0.5 * (largest + least), abs(least - largest)
        reach = 0.485 * width + stiffness.standard_error / stiffness.value * middle
        error = width / math.sqrt(12.0)
        return Estimate(
            value=middle, standard_error=error, low=middle - reach, high=middle + reach, residual=stiffness.residual
        )
