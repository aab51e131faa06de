"""Identification of walls, friction, mass, delay and sensor.

A recording allows two fits. Commands over measured positions give the law, exactly if it is a spring and a damper.
Positions under recorded forces give mass, delay and constant forces, and with springs and dampers of unknown gain the
actual stiffness of a wall; see `fit`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.analysis.fit import (
    ROUNDING,
    SLOW,
    CommandedLaw,
    Estimate,
    Fit,
    Forces,
    Windows,
    estimate_noise,
    estimate_quantum,
    fit,
    fit_law,
    is_inside,
)
from maglev_mj.analysis.motion import OfWall, reconstruct
from maglev_mj.control.timeline import recorded_switches, split_delay
from maglev_mj.errors import check_instance
from maglev_mj.frames import AXES, Array, Mask, unit_of
from maglev_mj.recording import RunMetadata, Stretch
from maglev_mj.recording.recording import READ_STRETCH
from maglev_mj.recording.sample import Face
from maglev_mj.result import Table, plain
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.theory.closed_loop import MOST_PERIODS

_MOST_SAMPLES, _LEAST_SAMPLES, _LEAST_INSIDE, _LEAST_DEGREES = 20_000, 12, 5, 6
_CLEAR = 10.0
"""Least ratio of caused motion to noise for identification."""
_MOST_DELAY = 0.1
"""Largest standard error of an identified delay, in periods."""
_UNEXPLAINED = 3e-3
"""Least share of motion of a relevant unrecorded force."""
_GYRATION = 0.036
"""Radius of gyration of the flotor [m]."""
_NOT_LINEAR, _DECIMALS = 0.02, 4
_STILL = 1e-9
"""Largest travel of an axis at rest [m, rad]."""
_HOLDS = 0.5
"""Least share of the breakaway force for continued friction.

Above it, friction after a slip counts as going on.
"""


@dataclass(frozen=True, kw_only=True)
class AxisEstimates:
    """Identified quantities of a coordinate, independent of the law.

    Attributes:
        inertia: Moving mass or moment of inertia, if the forces are as commanded [kg, kg m²].
        delay: Time from a sample to the switch of the force [s].
        force_error: Constant force beyond the recorded load and carrying command [N, N m].
        noise: Standard deviation of the sensor's noise before quantization [m, rad].
        quantum: Step of the positions [m, rad].
    """

    inertia: Estimate
    delay: Estimate
    force_error: Estimate
    noise: Estimate
    quantum: Estimate


@dataclass(frozen=True, kw_only=True)
class WallEstimates(OfWall):
    """Identified quantities of a wall.

    Attributes:
        stiffness: Stiffness from the motion, with the recorded mass of the flotor [N/m, N m/rad].
        damping: Damping from the motion, with the recorded mass of the flotor [N s/m, N m s/rad].
        commanded_stiffness: Slope of the commands over the measured position [N/m, N m/rad].
        commanded_damping: Slope of the commands over its difference quotient [N s/m, N m s/rad].
        share: Stiffness over the largest stable stiffness at this damping and delay.
    """

    stiffness: Estimate
    damping: Estimate
    commanded_stiffness: Estimate
    commanded_damping: Estimate
    share: Estimate


@dataclass(frozen=True, kw_only=True)
class Friction:
    """Identified friction of an axis.

    Attributes:
        stiffness: Stiffness while stuck, from the motion [N/m, N m/rad].
        commanded_stiffness: Stiffness while stuck, slope of the commands [N/m, N m/rad].
        breakaway: Largest friction before slip, as commanded [N, N m].
        sliding: Friction while sliding that does not depend on the speed, as commanded [N, N m].
        damping: Total viscous damping on the axis, as commanded [N s/m, N m s/rad].
    """

    stiffness: Estimate
    commanded_stiffness: Estimate
    breakaway: Estimate
    sliding: Estimate
    damping: Estimate


def _every(kind: type[AxisEstimates | WallEstimates | Friction], estimate: Estimate) -> dict[str, Estimate]:
    """Return the same estimate for all quantities."""
    return {one.name: estimate for one in fields(kind) if one.type == "Estimate"}


class _Row(NamedTuple):
    """Row of the table of identified quantities.

    Owner, axis, name, estimate, its unit and that of its residual on a translation, and scale of the estimate.
    """

    whose: str
    axis: str
    name: str
    estimate: Estimate
    unit: str
    left: str = "µm"
    scale: float = 1.0

    def cells(self) -> tuple[str, ...]:
        """Return an identified quantity as texts, its value rounded to two digits of its error."""
        value, error = self.estimate.value * self.scale, self.estimate.standard_error * self.scale
        decimals = min(max(1 - math.floor(math.log10(error)), 0), _DECIMALS) if error > 0.0 else _DECIMALS
        left = self.estimate.residual * (1e6 if self.left == "µm" else 1.0)
        return (
            f"{'  ' if self.whose else ''}{self.name}",
            f"{round(value, decimals) + 0.0:.{decimals}f}",
            f"{error:.2g}" if error < 100.0 else f"{error:.0f}",
            unit_of(self.unit, self.axis),
            f"{left:.2g} {unit_of(self.left, self.axis)}",
        )


@dataclass(frozen=True, kw_only=True)
class Identification:
    """All quantities identified from a stretch.

    Attributes:
        axes: Quantities of each axis that moves, by its name.
        walls: Every plane of a wall.
        friction: Friction of each axis that has some, by its name.
        samples: Largest number of samples used on an axis.
        of: Number of samples in the stretch.
    """

    axes: Mapping[str, AxisEstimates]
    walls: Sequence[WallEstimates]
    friction: Mapping[str, Friction]
    samples: int
    of: int

    @property
    def delay(self) -> Estimate:
        """Delay from the axis with the smallest error [s]."""
        delays = [one.delay for one in self.axes.values()] or [Estimate(why="nothing moves")]
        return min(delays, key=lambda one: one.standard_error if one.known else math.inf)

    @property
    def outside(self) -> list[str]:
        """Quantities outside the ranges in which the intervals were tested, in words.

        See docs/explanation/analysis.md.
        """
        beyond = [
            f"{one.name} at {one.share.value:.0%} of the limit" for one in self.walls if one.share.beyond(0.1, 0.8)
        ]
        for axis, friction in self.friction.items():
            if axis in AXES[:3] and friction.breakaway.beyond(0.5, 3.0):
                beyond.append(f"breakaway {friction.breakaway.value:.2g} N on {axis}")
        for axis, one in self.axes.items():
            if axis in AXES[:3] and (one.noise.beyond(0.0, 5.05e-6) or one.quantum.beyond(0.0, 5.05e-6)):
                beyond.append(f"noise or steps above 5 µm on {axis}")
        return beyond

    def _rows(self) -> Iterator[_Row]:
        best = next((axis for axis, one in self.axes.items() if one.delay is self.delay), AXES[0])
        yield _Row("", best, "effective delay", self.delay, "ms", scale=1e3)
        for wall in self.walls:
            name, axis = wall.name, wall.axis
            yield _Row(name, axis, "stiffness", wall.stiffness, "N/m")
            yield _Row(name, axis, "damping", wall.damping, "N s/m")
            yield _Row(name, axis, "of largest stable", wall.share, "%", scale=1e2)
            yield _Row(name, axis, "commanded stiffness", wall.commanded_stiffness, "N/m", "N")
            yield _Row(name, axis, "commanded damping", wall.commanded_damping, "N s/m", "N")
        for axis, friction in self.friction.items():
            name = f"friction on {axis}"
            yield _Row(name, axis, "stiffness", friction.stiffness, "N/m")
            yield _Row(name, axis, "commanded stiffness", friction.commanded_stiffness, "N/m", "N")
            yield _Row(name, axis, "breakaway", friction.breakaway, "N", "N")
            yield _Row(name, axis, "sliding", friction.sliding, "N", "N")
            yield _Row(name, axis, "damping", friction.damping, "N s/m", "N")
        for axis, one in self.axes.items():
            if axis in AXES[:3]:
                yield _Row(axis, axis, "mass", one.inertia, "kg")
            else:
                yield _Row(axis, axis, "moment of inertia", one.inertia, "g m²", scale=1e3)
            yield _Row(axis, axis, "force not compensated", one.force_error, "mN", scale=1e3)
            yield _Row(axis, axis, "noise", one.noise, "µm", scale=1e6)
            yield _Row(axis, axis, "steps", one.quantum, "µm", scale=1e6)

    def table(self) -> Table:
        """Return a row for each identified quantity, and the reasons for the others below."""
        rows: list[tuple[str, ...]] = []
        unknown: dict[tuple[str, str], list[str]] = {}
        heading = ""
        for (whose, why), group in groupby(self._rows(), key=lambda row: (row.whose, row.estimate.why)):
            quantities = list(group)
            if why:
                unknown.setdefault((", ".join(row.name for row in quantities), why), []).append(whose)
                continue
            if whose not in ("", heading):
                rows.append((whose, *[""] * 4))
            heading = whose
            rows += [row.cells() for row in quantities]
        remarks = []
        for (names, why), owners in unknown.items():
            whose = f" of {', '.join(owners)}" if any(owners) else ""
            remarks.append(f"not identified: {names}{whose}: {why}")
        if self.outside:
            remarks.append(f"outside the ranges in which errors were tested: {', '.join(self.outside)}")
        if self.samples < self.of:
            remarks.append(f"from {self.samples} of {self.of} samples: docs/explanation/analysis.md says which")
        return Table("", ("identified", "value", "std. error", "unit", "residual"), rows, "\n".join(remarks))

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        kept = {one.name: plain(getattr(self, one.name)) for one in fields(self)}
        return {"outside": self.outside, "delay": plain(self.delay), **kept}


def identify(stretch: Stretch, metadata: RunMetadata | None = None, *, anchors: Array | None = None) -> Identification:
    """Identify walls, friction, mass, delay and sensor.

    Each quantity has its standard error.

    Each coordinate is treated separately. A long stretch is represented by 20 000 samples of each, with the least
    straight motion.

    Args:
        stretch: The stretch.
        metadata: Metadata of the run; the stretch's own by default.
        anchors: Stick positions at each sample [m, rad], (N, 6); None without friction.

    Example:
        >>> from maglev_mj import record_run
        >>> from maglev_mj.scenes.drop import Drop
        >>> (stretch,) = record_run(Drop(stiffness=5000.0, quantize=5e-6), plant="exact").stretches
        >>> (wall,) = identify(stretch).walls
        >>> bool(wall.stiffness.low < 5000.0 < wall.stiffness.high), bool(0.49 < wall.share.value < 0.5)
        (True, True)
    """
    check_instance("stretch", stretch, Stretch, READ_STRETCH)
    if metadata is not None:
        stretch = replace(stretch, setup={**stretch.setup, "run": metadata.as_json()})
    axes: dict[str, AxisEstimates] = {}
    walls: list[WallEstimates] = []
    friction: dict[str, Friction] = {}
    used = 0
    for index, name in enumerate(AXES):
        stuck = None if anchors is None or not np.isfinite(anchors[:, index]).any() else anchors[:, index]
        faces = [face for face in stretch.metadata.faces if face[0] == index]
        axis = None
        if len(stretch) < _LEAST_SAMPLES:
            why = f"only {len(stretch)} samples"
        elif not np.ptp(stretch.position[:, index]) > _STILL:
            why = "the axis does not move"
        else:
            axis, why = _Axis.of(stretch, index, stuck), "too few samples without a gap"
        if axis is None:
            walls += [WallEstimates.of(face, **_every(WallEstimates, Estimate(why=why))) for face in faces]
        else:
            axes[name] = axis.estimates
            used = max(used, int(axis.used.sum()))
            walls += [axis.wall(face) for face in faces]
        if stuck is not None:
            friction[name] = Friction(**_every(Friction, Estimate(why=why))) if axis is None else axis.friction()
    return Identification(axes=axes, walls=walls, friction=friction, samples=used, of=len(stretch))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Axis:
    """One coordinate of a stretch, with its fits.

    Attributes:
        stretch: The samples used, and earlier ones whose commands take effect during them.
        axis: Index into AXES.
        anchors: Stick positions [m, rad], (N,); None without friction.
        windows: Windows of the samples used.
        held: True if an unrecorded spring and damper act on it, such as those of an arm.
    """

    stretch: Stretch
    axis: int
    anchors: Array | None
    windows: Windows
    held: bool = False

    @classmethod
    def of(cls, stretch: Stretch, axis: int, anchors: Array | None) -> _Axis | None:
        """Return the coordinate with its selected samples, or None.

        Of a long stretch, the windows with the least straight motion are selected; None if there are none.
        """
        period = stretch.metadata.period
        # after a gap the delayed commands are unknown
        ahead = int(split_delay(stretch.metadata.delay, period)[0]) + 2
        breaks = (np.flatnonzero(np.diff(stretch.tick) != 1) + 1).tolist()
        first = 0 if stretch.time[0] < period else ahead
        runs = [(one, end) for one, end in zip([first, *(at + ahead for at in breaks)], [*breaks, len(stretch)])]
        windows = Windows.cut(stretch.time, [run for run in runs if run[1] > run[0]], period)
        windows = windows.choose(stretch.position[:, axis], _MOST_SAMPLES)
        if windows.there.sum() < _LEAST_SAMPLES:
            return None
        needed = np.unique(np.maximum(windows.rows[windows.there][:, None] - np.arange(ahead + 1), 0))
        windows = windows._replace(rows=np.searchsorted(needed, windows.rows) * windows.there)
        stuck = None if anchors is None else anchors[needed]
        free = cls(stretch=stretch[needed], axis=axis, anchors=stuck, windows=windows)
        if free.disturbed:
            held = replace(free, held=True)
            return free if held.disturbed else held
        return free

    @cached_property
    def position(self) -> Array:
        """Positions [m, rad], (N,)."""
        return np.ascontiguousarray(self.stretch.position[:, self.axis])

    @cached_property
    def used(self) -> Mask:
        """True for samples in a window, (N,)."""
        used = np.zeros(len(self.position), dtype=np.bool_)
        used[self.windows.rows[self.windows.there]] = True
        return used

    @property
    def inertia(self) -> float:
        """Recorded mass or moment of inertia [kg, kg m²]."""
        return float(self.stretch.metadata.inertia[self.axis])

    def _fit(
        self, *, delay: float, search: bool, mass: float | None = None, law: tuple[Array, Array] | None = None
    ) -> Fit:
        """Fit the motion by forces of known shape.

        They are P parts of the command, the rest of the recorded forces, and a constant.

        Args:
            delay: First guess at the delay, or the delay [s].
            search: True to find the delay.
            mass: Moving mass or moment of inertia [kg, kg m²]; None to find it too.
            law: Parts of the command, each to be multiplied by a gain, (N, P), and the command without them [N, N m],
                (N,); None for no parts.
        """
        whole = np.zeros((len(self.position), 0)), self.stretch.applied[:, self.axis]
        parts, rest = whole if law is None else law
        count, gains = parts.shape
        period, time, axis = self.stretch.metadata.period, self.stretch.time, self.axis
        nothing, none = np.zeros((count, gains)), np.zeros(count)
        late = np.column_stack([parts, rest, none])
        extra = np.column_stack([nothing, self.stretch.applied_pulse[:, axis], none])
        width = self.stretch.applied_pulse_width
        switch, levels = recorded_switches(time, late, extra, width, period=period, delay=0.0)
        before = np.append(np.zeros(gains), [self.stretch.metadata.before[axis], 0.0])
        hand = self.stretch.known_hand[:-1, axis] if self.stretch.metadata.hand_acts_on_flotor else none[:-1]
        span = np.diff(time)[:, None]
        prompt = np.column_stack([nothing[:-1], hand, none[:-1] + 1.0])
        speed, way = span * prompt, 0.5 * span**2 * prompt
        fixed = np.full(gains + 2, np.nan)
        if mass is not None:
            fixed[gains] = 1.0 / mass
        if self.held:
            speed, way = (np.column_stack(both) for both in zip((speed, way), *self._impedance, strict=True))
            levels, before, fixed = (
                np.pad(levels, ((0, 0), (0, 2))),
                np.pad(before, (0, 2)),
                np.append(fixed, [np.nan] * 2),
            )
        forces = Forces(time=time, switch=switch, late=levels, before=before, speed=speed, way=way)
        floor = ROUNDING * float(np.abs(self.position).max())
        return fit(forces, self.windows, self.position, delay, period=period, search=search, floor=floor, fixed=fixed)

    @cached_property
    def _impedance(self) -> list[tuple[Array, Array]]:
        """Integrals of a unit spring's and a unit damper's force.

        The integral and double integral over each period, (N - 1,), for the spring, then for the damper.
        """
        motion, axis = reconstruct(self.stretch), self.axis
        trace, ends = motion.trace.along(axis), motion.starts
        knots, position, speed = trace.time, trace.pose[:-1, 0], trace.twist[:-1, 0]
        width = np.diff(knots)
        bend = trace.pose[1:, 0] - position - speed * width
        # of the parabola between two knots, and of its product with the time since the first
        whole = width * (position + 0.5 * width * speed + bend / 3.0)
        later = width**2 * (position / 2.0 + width * speed / 3.0 + bend / 4.0)
        period = np.searchsorted(ends, np.arange(len(width)), side="right") - 1
        inside = period >= 0
        left = knots[ends[period + 1]] - knots[:-1]
        count = len(self.position) - 1
        one, two = np.zeros((2, count))
        np.add.at(one, period[inside], whole[inside])
        np.add.at(two, period[inside], (left * whole - later)[inside])
        start, end = self.position[:-1], self.position[1:]
        return [(-one, -two), (start - end, np.diff(self.stretch.time) * start - one)]

    @cached_property
    def motion(self) -> Fit:
        """Fit of the motion by all recorded forces.

        It has their common factor, a constant, and their delay.
        """
        return self._fit(delay=self.stretch.metadata.delay, search=True)

    @property
    def pushed(self) -> bool:
        """True if recorded forces move it more than noise."""
        return bool(self.motion.moves[0] >= _CLEAR * self.motion.residual and self.motion.values[0] > 0.0)

    @property
    def disturbed(self) -> str:
        """Reason for a motion with unrecorded forces, or empty.

        Empty if the motion is that of a mass under the recorded forces.
        """
        travel = np.ptp(self.stretch.position, axis=0)
        travel[:3] /= _GYRATION
        # coordinates act on a rotation by the product of two of them, which is left out
        if self.axis >= 3 and np.delete(travel, self.axis).max() * travel[3:].max() > self.motion.residual:
            return "the other coordinates act on it"
        unknown = self.motion.whiteness < SLOW and self.motion.share > _UNEXPLAINED
        return "forces act that were not recorded" if unknown else ""

    @property
    def _why(self) -> str:
        """Reason against identification from the motion, or empty."""
        if why := self.disturbed:
            return why
        return "" if self.pushed else "the force on it does not change by more than noise"

    @cached_property
    def estimates(self) -> AxisEstimates:
        """Quantities identified from the motion, independent of the law."""
        motion = self.motion
        quantum = estimate_quantum(self.position[self.used])
        if self.disturbed:
            unknown = Estimate(why=self._why, residual=motion.residual)
            return AxisEstimates(**_every(AxisEstimates, unknown) | {"quantum": quantum})
        step = quantum.value if quantum.known else 0.0
        rows = self.windows.rows
        after, before = np.minimum(rows + 1, len(self.position) - 1), np.maximum(rows - 1, 0)
        moving = np.abs(self.position[after] - self.position[before])
        noise = estimate_noise(motion, self.windows.there, moving > 2.0 * step, step)
        inertia = delay = Estimate(why=self._why)
        mass = self.inertia
        if not self._why:
            mass = 1.0 / motion.values[0]
            inertia = motion.estimate(mass, mass**2 * motion.errors[0])
            delay = self._late(motion)
        else:
            motion = self._fit(delay=self.stretch.metadata.delay, search=False, mass=mass)
        slope = np.zeros(len(motion.errors))
        slope[:2] = -motion.values[1] * mass**2 * (not self._why), mass
        force = mass * motion.values[1] - float(self.stretch.metadata.load[self.axis])
        error = motion.estimate(force, motion.error_of(slope))
        return AxisEstimates(inertia=inertia, delay=delay, force_error=error, noise=noise, quantum=quantum)

    def _late(self, motion: Fit) -> Estimate:
        if (
            motion.moves[-1] < _CLEAR * motion.residual
            or motion.errors[-1] > _MOST_DELAY * self.stretch.metadata.period
        ):
            return Estimate(why="the force switches too little")
        return motion.estimate(motion.delay, motion.errors[-1])

    # -- the law --------------------------------------------------------------------------------------------------

    @cached_property
    def faces(self) -> list[Face]:
        """Touched walls of the axis."""
        faces = [face for face in self.stretch.metadata.faces if face[0] == self.axis]
        return [face for face in faces if (is_inside(self.position, face) & self.used).sum() >= _LEAST_INSIDE]

    @cached_property
    def law(self) -> CommandedLaw:
        """Law as a fit of commands by positions."""
        return fit_law(self.stretch, self.axis, self.faces, self.anchors, self.used)

    def _commanded(self, name: tuple[str, int]) -> Estimate:
        """Return an identified gain of the law."""
        law = self.law
        if law.residual > _NOT_LINEAR * law.scale:
            return Estimate(why=f"commands are not those of a spring and a damper ({law.residual:.2g} apart)")
        index = law.names.index(name)
        if not math.isfinite(law.errors[index]):
            return Estimate(why="nothing tells it from the other laws on the axis")
        return Estimate.of(law.gains[index], law.errors[index], law.degrees, law.residual)

    @cached_property
    def rendered(self) -> Fit:
        """Fit of the motion by the law's parts.

        The gain of each part is found from the motion.
        """
        return self._fit(delay=self.motion.delay, search=True, law=(self.law.parts, self.law.rest))

    def _shown(self, name: tuple[str, int]) -> Estimate:
        """Return a gain as identified from the motion.

        The flotor is assumed to have the recorded mass.
        """
        if self._why:
            return Estimate(why=self._why, residual=self.motion.residual)
        if not (commanded := self._commanded(name)).known:
            return commanded
        index, rendered = self.law.names.index(name), self.rendered
        if rendered.degrees < _LEAST_DEGREES:
            return Estimate(why="too few samples for all that acts on the axis")
        if rendered.moves[index] < _CLEAR * rendered.residual:
            return Estimate(why="it moves the flotor too little")
        return rendered.estimate(self.inertia * rendered.values[index], self.inertia * rendered.errors[index])

    def wall(self, face: Face) -> WallEstimates:
        """Return the identified quantities of a wall."""
        if face not in self.faces:
            count = int((is_inside(self.position, face) & self.used).sum())
            unknown = Estimate(why=f"only {count} samples in it" if count else "it was not touched")
            return WallEstimates.of(face, **_every(WallEstimates, unknown))
        spring, damper = (("stiffness", self.faces.index(face)), ("damping", self.faces.index(face)))
        return WallEstimates.of(
            face,
            stiffness=self._shown(spring),
            damping=self._shown(damper),
            commanded_stiffness=self._commanded(spring),
            commanded_damping=self._commanded(damper),
            share=self._share(spring, damper),
        )

    def _share(self, *gains: tuple[str, int]) -> Estimate:
        """Return a wall's share of the largest stable stiffness.

        Its stiffness includes all other springs on the axis.
        """
        for one in gains:
            if not (shown := self._shown(one)).known:
                return shown
        rendered, names, mass = self.rendered, self.law.names, self.inertia
        period, last = self.stretch.metadata.period, len(rendered.values)
        weights = np.zeros((3, last + 1))
        for row, name, other in zip(weights, gains, (("spring", 0), ("damper", 0))):
            row[[names.index(one) for one in (name, other) if one in names]] = mass
        weights[2, last] = 1.0
        stiffness, damping, delay = weights @ np.append(rendered.values, rendered.delay)
        errors = np.array([rendered.error_of(weight) for weight in weights])
        # the boundary at the identified damping and delay, and one standard error to either side of each
        aside = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * errors[1:]
        dampings, delays = np.maximum(np.array([damping, delay]) + aside, 0.0).T
        if delays.max() > MOST_PERIODS * period:
            return Estimate(why=f"the theory goes up to a delay of {MOST_PERIODS} periods")
        most = np.array(
            [
                largest_stable_stiffness(one, delay=late, period=period, mass=mass)
                for one, late in zip(dampings.tolist(), delays.tolist())
            ]
        )
        if not most.min() > 0.0:
            return Estimate(why="no wall is stable at this damping and delay")
        share = stiffness / most[0]
        reach = np.maximum(2.0 * errors[1:], np.finfo(np.float64).tiny)
        slopes = np.array([1.0 / most[0], *(-share / most[0] * (most[1::2] - most[2::2]) / reach)])
        return rendered.estimate(float(share), rendered.error_of(slopes @ weights))

    # -- friction -------------------------------------------------------------------------------------------------

    def friction(self) -> Friction:
        """Return the identified friction."""
        return Friction(
            stiffness=self._shown(("stuck", 0)),
            commanded_stiffness=self._commanded(("stuck", 0)),
            breakaway=self._breakaway(),
            sliding=self._commanded(("sliding", 0)),
            damping=self._commanded(("damper", 0)),
        )

    def _breakaway(self) -> Estimate:
        """Return the breakaway force.

        It is between the largest force while stuck and the least force that caused slip.
        """
        law, anchors = self.law, self.anchors
        stiffness = self._commanded(("stuck", 0))
        if not stiffness.known or anchors is None:
            return stiffness
        index = [law.names.index((name, 0)) for name in ("stuck", "sliding")]
        force = np.abs(law.parts[:, index] @ law.gains[index])
        stuck = np.isfinite(anchors)
        next_to = self.used[:-1] & self.used[1:] & (np.diff(self.stretch.tick) == 1)
        last = np.flatnonzero(stuck[:-1] & ~stuck[1:] & next_to)
        if not len(last):
            return Estimate(why="it never slips")
        ends = force[last], force[last + 1]
        if np.median(ends[1]) > _HOLDS * np.median(ends[0]):  # it goes on sliding at its largest friction
            return self._commanded(("sliding", 0))
        if not stiffness.value > 0.0:
            return Estimate(why="it does not stick")
        held = float(force[stuck & self.used].max())
        broke = float((stiffness.value * np.abs(anchors[last] - self.position[last + 1])).min())
        middle, width = 0.5 * (held + broke), abs(broke - held)
        reach = 0.485 * width + stiffness.standard_error / stiffness.value * middle
        error = width / math.sqrt(12.0)
        return Estimate(
            value=middle, standard_error=error, low=middle - reach, high=middle + reach, residual=law.residual
        )
