"""Stability verdict on any controller.

It is computed from the gains declared by the laws, or by numerical linearisation if a law declares none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from operator import itemgetter
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.keywords import checked
from maglev_mj.lazy import loaded
from maglev_mj.result import NoTruthValue, Result, Table, conditions_text, plain, radius_text
from maglev_mj.spec import MAX_DELAY, RANGE
from maglev_mj.theory.boundary import StiffestWall, boundary_of, stiffest_of
from maglev_mj.theory.critical import critical_ratios
from maglev_mj.theory.doubts import reached_speed, up_to
from maglev_mj.theory.held import Held
from maglev_mj.theory.linearise import StateSpace, pose_text
from maglev_mj.theory.loop import (
    RELATIVE_ROUNDING,
    Bound,
    Loop,
    Loops,
    StableDelays,
    StableRange,
    coupled_bound,
    delay_bound,
    delay_bounds,
    poles_of,
    radius_of,
    stable_delays,
)
from maglev_mj.theory.read import JUMPS, UNKNOWN, of_scene
from maglev_mj.theory.remedies import Remedy, critical_of, critical_of_host, damping_range, rate_range, remedies_of

_SLIGHT = 1e-3
"""Relative change of a gain that shows the stiffness of an axis that it adds."""
_LAWS = {"contact": "walls", "stuck": "friction"}
_NO_RANGE = StableRange(Bound(math.nan), Bound(math.nan))


class _LoopState(NamedTuple):
    """Closed loop of axes with equal gains in one combination of law states.

    Attributes:
        axes: Names of the axes.
        acting: Active states, such as "contact"; () for none.
        others: Inactive states of the laws on these axes.
        spectral_radius: Spectral radius without the poles of free motion; 0 if there are no others.
        free: True without stiffness: poles at exactly 1.
    """

    axes: tuple[str, ...]
    acting: tuple[str, ...]
    others: tuple[str, ...]
    spectral_radius: float
    free: bool

    def row(self) -> tuple[str, ...]:
        """Return axes, state, spectral radius and verdict as texts for a table."""
        axes = "all axes" if self.axes == AXES else ", ".join(self.axes)
        inactive = (f"no {name}" if name == "contact" else f"not {name}" for name in self.others)
        state = ", ".join([*self.acting, *inactive]) or "always"
        if not self.spectral_radius:
            return axes, state, "-", "free motion"
        word = f"{_word(self.spectral_radius < 1.0 - RELATIVE_ROUNDING)}{' (free motion)' * self.free}"
        return axes, state, f"{self.spectral_radius:.4f}", word


class AtAmplitude(NamedTuple):
    """Closed loop of a law in fixed point for motion of one amplitude.

    Attributes:
        axis: Name of the axis.
        amplitude: Displacement [m, rad].
        stiffness: Mean stiffness over the positions within a count [N/m, N m/rad].
        damping: Mean damping over them [N s/m, N m s/rad].
        spectral_radius: Spectral radius; 1 for a law without stiffness and damping.
        judged: False within a few counts, where each such law rings or rests, and for negative stiffness.
    """

    axis: str
    amplitude: float
    stiffness: float
    damping: float
    spectral_radius: float
    judged: bool

    def __str__(self) -> str:
        gains = f"{self.stiffness:.4g} {unit_of('N/m', self.axis)}, {self.damping:.3g} {unit_of('N s/m', self.axis)}"
        word = _word(self.spectral_radius < 1.0 - RELATIVE_ROUNDING)
        verdict = f"{word}, {radius_text(self.spectral_radius)}{' (not judged)' * (not self.judged)}"
        return f"{self.axis}, motion of {amplitude_text(self.amplitude, self.axis)}: {gains}, {verdict}"


def amplitude_text(amplitude: float, axis: str) -> str:
    """Return an amplitude [m, rad] with its unit."""
    scale, prefix = (1e3, "m") if amplitude >= 1e-3 else (1e6, "µ")
    return f"{scale * amplitude:.3g} {prefix}{unit_of('m', axis)}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict(NoTruthValue, Result):
    """Stability verdict on a controller, with its worst closed loop.

    Attributes:
        stable: False if a loop is unstable; else None if one was not computed; else True. Free motion is stable.
        spectral_radius: Spectral radius of the worst loop, without the poles of free motion, which are exactly 1
            without stiffness. Below 1 for a stable loop; NaN if not computed.
        axes: Names of the worst loop's axes; () if not computed.
        acting: Active law states of the worst loop: "contact", "stuck" and so on; () if a law declares no gains.
        pose: Pose of the worst loop [m, rad], (6,).
        stiffness: Total stiffness at the pose, without integral action [N/m, N m/rad], (6, 6).
        damping: Total damping at the pose [N s/m, N m s/rad], (6, 6).
        stated: True if all laws declare their gains, so that the verdict does not depend on the pose.
        jumps: Skipped poses: the wrench or its slope is discontinuous there, (J, 6).
        unknown: Skipped poses: the impulse response exceeds 512 samples and has no low-order realisation, (U, 6).
        away: Skipped poses: unstable equilibria, such as the crest between two detents, (A, 6).
        states: Loop of each axis in each state of its laws, equal ones merged; () if a law declares no gains.
        unjudged: Names of axes with a loop that was not computed, such as a law with a sign of the velocity.
        doubts: Reasons by axis why laws without declared gains are not linear, such as "the force does not repeat".
        valid_to: Speed of motion up to which the laws are linear [m/s, rad/s], on the axis where it is the smallest
            share of the speed reached after a fall; None for declared gains.
        range: That range in words, if less than what a fall reaches; empty otherwise.
        loops: All loops; those that cannot be judged with their reason.
        loop: The worst of them; None if none was judged.
        subject: Name of the scene, for charts.
    """

    stable: bool | None
    spectral_radius: float
    axes: tuple[str, ...]
    acting: tuple[str, ...] = ()
    pose: Array
    stiffness: Array
    damping: Array
    eigenvalues: NDArray[np.complex128]
    stated: bool
    jumps: Array = field(default_factory=lambda: np.zeros((0, 6)))
    unknown: Array = field(default_factory=lambda: np.zeros((0, 6)))
    away: Array = field(default_factory=lambda: np.zeros((0, 6)))
    states: tuple[_LoopState, ...] = ()
    unjudged: tuple[str, ...] = ()
    doubts: Mapping[str, str] = field(default_factory=dict)
    valid_to: Bound | None = None
    range: str = ""
    loops: Loops = field(default_factory=lambda: Loops(()))
    loop: Loop | None = None
    subject: str = "controller"
    units: ClassVar = {"pose": "m, rad", "stiffness": "N/m, N m/rad", "damping": "N s/m, N m s/rad"}
    pictures: ClassVar = {"stability": "maglev_mj.theory.pictures:pole_map"}

    def _headline(self) -> str:
        pose = pose_text(self.pose) if self.axes else ""
        if self.loop is not None and self.loop.at_amplitude:
            pose = f"{pose}, motion of {amplitude_text(self.loop.at_amplitude, self.loop.axis)}"
        worst = f"in {' and '.join(self.acting)}" * bool(self.acting) if self.stated else pose
        worst = ", ".join(filter(None, (worst, "held by the scene's hand" * self.in_hand)))
        return f"{self} (worst {worst})" if worst else str(self)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return pose, stiffness and damping of each axis."""
        gains = {"stiffness": np.diag(self.stiffness), "damping": np.diag(self.damping)}
        return {"axis": np.array(AXES), "pose": self.pose, **gains}

    def table(self) -> Table:
        """Return a row for each combination of law states; without declared gains, the worst pose."""
        rows = [state.row() for state in self.states]
        method = "from the gains declared by the laws" if self.stated else "by numerical linearisation"
        remarks = [*self.held.lines, f"line above the table: worst axis; computed {method}", *self.remarks]
        remarks += map(str, sorted(self.amplitudes, key=lambda one: -one.spectral_radius))
        return Table("", ("axes", "state", "spectral radius", "verdict"), rows, "\n".join(remarks))

    def __str__(self) -> str:
        if self.stable is None:
            reasons = [*self.doubts.values(), *(reason for _, reason in self._skipped())]
            reasons += [loop.reason for loop in self.loops if loop.reason]
            return f"not computed{self._unjudged}: {next(iter(reasons), 'no finite force')}"
        return _loop_text(self.axes, self.stable, self.spectral_radius)

    @cached_property
    def contact(self) -> tuple[Loop, float] | None:
        """Loop that a chart shows, with its spectral radius; None if there is none.

        The worst; of a stable scene the worst in contact, or stuck.
        """
        if self.loop is None:
            return None
        radii = self.loops.spectral_radii().tolist()
        some = [pair for pair in zip(self.loops, radii, strict=True) if pair[0].state and math.isfinite(pair[1])]
        if self.stable and some:
            return max(some, key=itemgetter(1))
        return self.loop, self.spectral_radius

    @property
    def contact_headline(self) -> str:
        """Verdict on the loop of the chart."""
        if self.contact is None or self.contact[0] is self.loop:
            return self.headline
        loop, radius = self.contact
        return f"{_loop_text(loop.axes, self.stable, radius)} (in {' and '.join(loop.state)})"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        shown = self.loop or next(iter(self.loops), None) if self.contact is None else self.contact[0]
        return "" if shown is None else conditions_text(self.subject, shown.axes, [shown.period], [shown.delay])

    def as_json(self) -> dict[str, Any]:
        """Return the verdict, ready for JSON; amplitudes of laws in fixed point alone."""
        names = "stable", "spectral_radius", "axes", "acting", "pose", "stated", "states", "unjudged", "doubts"
        more: tuple[str, ...] = ("valid_to", "in_hand", "held", "leaves_after", "remarks")
        more += ("amplitudes",) * bool(self.amplitudes)
        return {name: plain(getattr(self, name)) for name in (*names, *more)}

    @property
    def in_hand(self) -> bool:
        """True if the worst loop is that in the hand of the scene."""
        return self.loops.hand is not None and self.loop is not None and self.loop.hand is not None

    @cached_property
    def held(self) -> Held:
        """Verdict free and in each hand."""
        hand = self.loop.hand if self.loops.hand is None and self.loop is not None else self.loops.hand
        reach = RANGE if self.loops.reach is None else tuple(self.loops.reach.tolist())
        return Held(self.loops.released, reach, hand, not self.unjudged)

    @property
    def leaves_after(self) -> float | None:
        """See `Held`."""
        return self.held.leaves_after

    @property
    def remarks(self) -> tuple[str, ...]:
        """Axes that were not computed, limits of the verdict, and number of skipped poses by reason, one line each."""
        skipped = [f"{count} pose{'s' * (count > 1)} skipped: {reason}" for count, reason in self._skipped()]
        linear = [self.range] * bool(self.range)
        linear += [f"{' and '.join(self.loops.partial)} as declared, without the rest"] * bool(self.loops.partial)
        return (*self._not_computed(), *linear, *skipped)

    def _not_computed(self) -> Iterator[str]:
        for reason in dict.fromkeys(self.doubts.values()):
            yield f"not computed on {', '.join(axis for axis in self.doubts if self.doubts[axis] == reason)}: {reason}"
        named = {reason for _, reason in self._skipped()}
        others = [axis for axis in self.unjudged if axis not in self.doubts]
        for reason in dict.fromkeys(loop.reason for loop in self.loops if loop.reason and loop.axis in others):
            axes = ", ".join(loop.axis for loop in self.loops if loop.reason == reason and loop.axis in others)
            yield f"not computed on {axes}{f': {reason}' * (reason not in named)}"

    @cached_property
    def amplitudes(self) -> tuple[AtAmplitude, ...]:
        """Loops of laws in fixed point, which have no slope at the smallest motion; () for other laws."""
        each = [one for one in self.loops if one.at_amplitude and one.hand is None]
        poles = poles_of(computed := [replace(one, reason="") for one in each])
        return tuple(
            AtAmplitude(
                one.axis, one.at_amplitude, one.stiffness, one.damping + 0.0, radius_of(same, own), not one.reason
            )
            for one, same, own in zip(each, computed, poles, strict=True)
        )

    @property
    def _unjudged(self) -> str:
        return f" on {', '.join(self.unjudged)}" * bool(self.unjudged)

    @cached_property
    def marginal(self) -> tuple[Loop | None, str]:
        """Loop to change first, and why in words: the worst, or of a stable scene the one with the smallest margin.

        That is the one nearest to its critical stiffness; of laws that declare no gains the worst. None if not judged.
        """
        if self.stable is None or self.loop is None:
            return None, ""
        if self.stable and self.stated:
            return nearest(self.loops), "the one with the smallest margin"
        return self.loop, "the one with the largest spectral radius"

    @cached_property
    def in_question(self) -> Loop | None:
        """Worst loop with the law in question on its host; None without stiffness, and of coupled axes."""
        loop = self.loop
        if loop is None or len(loop.axes) > 1 or not loop.total[0] > 0.0:
            return None
        return loop.in_question

    @cached_property
    def frequency(self) -> float:
        """Frequency at which the worst loop rings [Hz]; 0 for a motion that does not oscillate, NaN if not computed."""
        if (own := self.in_question) is not None:
            return own.array().pole(own.stiffness, own.damping)[1]
        if self.loop is None or not self.spectral_radius > 0.0:
            return 0.0 if self.loop is not None else math.nan
        dominant = self.eigenvalues[np.abs(np.abs(self.eigenvalues) - self.spectral_radius).argmin()]
        return abs(float(np.angle(dominant))) / (2.0 * math.pi * self.loop.period)

    @property
    def doubling_time(self) -> float:
        """Time in which the motion of the worst loop doubles [s]; negative for the time in which it halves."""
        growth = math.log(self.spectral_radius) if self.spectral_radius > 0.0 else -math.inf
        if self.loop is None or math.isnan(growth):
            return math.nan
        return math.log(2.0) * self.loop.period / growth if growth else math.inf

    @cached_property
    def damping_range(self) -> StableRange | None:
        """Dampings at which the worst loop is stable, see `theory.remedies`; None for none, NaN if not computed."""
        return _NO_RANGE if (own := self.in_question) is None else damping_range(own)

    @cached_property
    def rate_range(self) -> StableRange | None:
        """Sample rates at which it is stable with the same delay [Hz]; None for none, NaN if not computed."""
        return _NO_RANGE if self.in_question is None else rate_range(self._whole)

    @cached_property
    def rate_in_periods(self) -> StableRange | None:
        """The same with a delay of the same number of periods."""
        return _NO_RANGE if self.in_question is None else rate_range(self._whole, in_periods=True)

    @cached_property
    def best(self) -> StiffestWall:
        """Stiffest stable wall over all dampings, of the law in question."""
        if (own := self.in_question) is None:
            return StiffestWall(np.array(math.nan), np.array(math.nan), np.array(False))
        return stiffest_of(own.array())

    @cached_property
    def critical_gain(self) -> Bound:
        """Critical stiffness of the law in question, beside the other law [N/m, N m/rad]; NaN if not computed."""
        return Bound(math.nan) if (own := self.in_question) is None else critical_of(own)

    @cached_property
    def stable_delays(self) -> StableDelays:
        """All stable delays of the law in question; NaN as the end of the search if not computed."""
        if (own := self.in_question) is None:
            return StableDelays((), math.nan)
        return stable_delays(own.array(), own.stiffness, own.damping)

    def remedies(self, target: float = 2.0) -> tuple[Remedy, ...]:
        """Return changes that make the worst loop stable, or stiffer, best first; none if there is no need.

        Args:
            target: Wanted ratio of critical to requested stiffness.
        """
        return self.advice(target)[0]

    def advice(self, target: float = 2.0) -> tuple[tuple[Remedy, ...], tuple[str, ...]]:
        """Return the remedies, and changes without effect in words."""
        if self.in_question is None:
            return (), ()
        around: Any = {"stable": self._loop_is_stable, "critical": self.critical_gain, "best": self.best}
        return remedies_of(self._whole, target, **around)

    @property
    def _whole(self) -> Loop:
        """Worst loop with the laws on host and device where they are; one with memory as its law in question."""
        assert self.loop is not None
        return self.loop if self.loop.linear is None else self.loop.in_question

    @property
    def _loop_is_stable(self) -> bool:
        """True if the worst loop is stable, whatever could not be judged."""
        return self.spectral_radius < 1.0 - RELATIVE_ROUNDING

    @cached_property
    def critical_delay(self) -> Bound:
        """Delay of the host at which stability changes [s]: 0 if unstable without delay, NaN if one is not judged."""
        if len(self.loops) == 1 and self.loop is not None and self.in_question is self.loop:
            return self.stable_delays.bound
        return critical_delay_of(self.loops)

    @cached_property
    def _critical(self) -> _Critical:
        return _UNKNOWN if self.loop is None else critical_stiffness_of(self.loops, self.loop)

    @property
    def critical_stiffness(self) -> Bound:
        """Stiffness of the worst loop's axis at which stability changes [N/m, N m/rad].

        The scene's declared gain `stiffness` alone grows, or the loop's own stiffness without one. 0 if no softer one
        is stable; NaN if not computed.
        """
        return self._critical.stiffness

    @property
    def ratio(self) -> Bound:
        """Ratio of critical to present gain."""
        return self._critical.ratio

    @property
    def gains(self) -> tuple[float, float]:
        """Total stiffness and damping of the worst loop's first axis [N/m, N m/rad; N s/m, N m s/rad]."""
        index = AXES.index(self.axes[0]) if self.axes else 0
        return float(self.stiffness[index, index]), float(self.damping[index, index])

    @property
    def words(self) -> str:
        """Verdict with the share of the critical stiffness, and the spectral radius."""
        return margin_words(self.stable, self.ratio, self.spectral_radius)

    @property
    def details(self) -> str:
        """Laws, axis, share of the critical stiffness, gains, rate and delay of the worst loop, for a warning."""
        loop, (stiffness, damping) = self.loop, self.gains
        if loop is None:
            return str(self)
        stiff, damp = (unit_of(unit, self.axes[0]) for unit in ("N/m", "N s/m"))
        acting = " and ".join(_LAWS.get(state, state) for state in self.acting)
        acting = (acting or ("other laws" if self.stated else "all laws")) + " in the scene's hand" * self.in_hand
        share, critical = self.words, self.critical_stiffness
        share = share if self.ratio == 0.0 else share.removeprefix("un").removeprefix("stable").lstrip(":, ")
        limit = f"; stable up to {critical:.4g} {stiff} at this damping" * (critical > 0.0)
        return (
            f"{acting} on {self.axes[0]}: {share} (must be below 1) with a total of {stiffness:.4g} {stiff} and "
            f"{damping:.4g} {damp}, at {1.0 / loop.period:.4g} Hz, delay {loop.delay * 1e3:.3g} ms{limit}"
        )

    def _skipped(self) -> list[tuple[int, str]]:
        reasons = (
            (self.unknown, UNKNOWN),
            (self.jumps, JUMPS),
            (self.away, "unstable equilibrium (negative stiffness)"),
        )
        return [(len(poses), reason) for poses, reason in reasons if len(poses)]


def margin_words(stable: bool | None, ratio: float, spectral_radius: float | None = None) -> str:
    """Return a verdict with the share of the critical stiffness, such as "stable: 59 % of critical stiffness".

    Args:
        stable: None if not computed.
        ratio: Ratio of critical to present stiffness; 0 if the loop is unstable at any, NaN if not computed.
        spectral_radius: Appended if not None.
    """
    if stable is None:
        return "stability not computed"
    text = _word(stable)
    if ratio == 0.0:
        text = f"{text} at any stiffness with this damping"
    elif ratio > 0.0 and not getattr(ratio, "beyond", False):
        text = f"{text}: {100.0 / ratio:.0f} % of critical stiffness"
    return text if spectral_radius is None else f"{text}, spectral radius {spectral_radius:.4f}"


@checked(own="scene")
def stability(
    scene: Any, *, inertia: ArrayLike | None = None, delay: float | None = None, poses: ArrayLike | None = None
) -> Verdict:
    """Return the stability verdict on a scene; see `judge`.

    Args:
        scene: The scene, its class, or a text or file for `find_scene`.
        inertia: Mass and moments of inertia in place of the scene's own [kg, kg m²], (6,).
        delay: Transport delay in place of the scene's own [s]; gains derived from the delay do not change.
        poses: Poses at which laws without declared gains are linearised in place of all [m, rad], (P, 6).

    Raises:
        ParameterError: If `scene` is not a scene, or a value is outside its bounds.

    Example:
        >>> from maglev_mj import find_scene, stability
        >>> stability("drop").stable, stability(find_scene("drop")(stiffness=20000.0)).stable
        (True, False)
    """
    if isinstance(scene, type) or not hasattr(scene, "controller"):
        scene = loaded("maglev_mj.scenes.find:get_scene")(scene)  # a higher layer: by name
    verdict = verdicts([of_scene(scene, inertia=inertia, delay=delay, poses=poses)])[0]
    return replace(verdict, subject=getattr(scene, "name", "scene"))


@checked(own="what")
def judge(what: Any = None, **changes: Any) -> Verdict:
    """Return the stability verdict on a closed loop: of a scene, device, recording, controller or of numbers.

    With a hand, that of a scene or controller is the worst of free and held by it. Unstable outranks not judged, and
    not judged outranks stable. If all laws declare their gains, the loop is exact in every combination of their states.
    Otherwise the controller is linearised at the start, at the centre, along each axis, and 1 µm to 0.1 mm inside each
    face and each edge of a region of constant gains; coupled axes form one loop. Probes say where such laws are not
    linear (`Verdict.doubts`).

    Args:
        what: Scene or its name; controller, with laws for one device, which is not changed; `Device`, its name or file;
            recording; `Loop` or `Loops`; None for numbers alone.
        changes: Parameters of the scene, or `delay` [s], `inertia` [kg, kg m²] (6,), `driver_lag` [s] and `hand` in
            place of its own; of a controller `delay`, up to 1 s, `pose` at the start [m, rad] (6,), `inertia`,
            `reach` of the motion [m, rad] (6,), `load` [N, N m] (6,) at whose rest laws are probed, `device` with
            sample period and delay of walls on the device [s] (2,), `driver_lag` and `hand`; else fields of `Loop`, in
            place of the device's.

    Raises:
        ParameterError: If there is no such scene or device, or a value is missing or outside its bounds.
        MaglevError: If a law fails at a pose.

    Example:
        >>> from maglev_mj import Controller, Wall, judge
        >>> wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)
        >>> judge(Controller([wall], period=0.005), delay=0.0015).stable
        True
        >>> judge("drop", stiffness=20_000.0).stable, judge(device="stage", stiffness=6000.0, damping=80.0).stable
        (False, True)
    """
    return verdicts([Loop.of(what, **changes)])[0]


def verdicts(each: Sequence[Loops]) -> list[Verdict]:
    """Return the verdict on the loops of each controller; all poles are computed together."""
    poles = iter(poles_of([loop for loops in each for loop in loops]))
    return [_verdict(loops, [next(poles) for _ in loops]) for loops in each]


def _verdict(loops: Loops, poles: Sequence[NDArray[np.complex128]]) -> Verdict:
    worst, radius, roots = None, math.nan, np.empty(0, dtype=np.complex128)
    kinds: dict[tuple[Any, ...], list[str]] = {}
    for loop, own in zip(loops, poles, strict=True):
        if loop.reason:
            continue
        size = radius_of(loop, own)
        if worst is None or size > radius * (1.0 + RELATIVE_ROUNDING):
            worst, radius, roots = loop, size, own
    in_hand = worst is not None and worst.hand is not None
    twins = {(loop.axis, loop.state) for loop in loops if loop.hand is not None} if loops.hand is not None else ()
    for loop, own in zip(loops, poles, strict=True):
        if not loop.reason and loop.linear is None:
            if (loop.axis, loop.state) in twins and (loop.hand is not None) != in_hand:
                continue  # the other one of free and held is in the table
            size = round(radius_of(loop, own), 12)
            kinds.setdefault((loop.state, loop.others, size, loop.free > 0), []).append(loop.axis)
    unstable = radius >= 1.0 - RELATIVE_ROUNDING
    stiffness, damping = np.full((2, 6, 6), np.nan) if worst is None else _gains(loops, worst)
    valid_to, text = _valid_to(loops)
    return Verdict(
        stable=not unstable if unstable or (not loops.unjudged and worst is not None) else None,
        spectral_radius=radius,
        doubts=doubts_of(loops, unstable),
        valid_to=valid_to,
        range=text,
        axes=() if worst is None else worst.axes,
        acting=() if worst is None else worst.state,
        pose=loops.start if worst is None or worst.pose is None else np.array(worst.pose),
        stiffness=stiffness,
        damping=damping,
        eigenvalues=roots,
        stated=loops.stated,
        jumps=loops.jumps,
        unknown=loops.unknown,
        away=loops.away,
        states=tuple(_LoopState(tuple(axes), *kind) for kind, axes in kinds.items()),
        unjudged=loops.unjudged,
        loops=loops,
        loop=worst,
    )


def doubts_of(loops: Loops, unstable: bool) -> dict[str, str]:
    """Return the doubts by name of the axis, as far as they are the reason not to judge it."""
    reasons = {loop.axis: loop.reason for loop in loops if loop.reason}
    result = {}
    for index, doubt in loops.doubts.items():
        if doubt.reason:
            slow = not unstable and not doubt.void and reasons[AXES[index]] == doubt.reason
            judged = [loop for loop in loops if loop.at_amplitude and not loop.reason and loop.axis == AXES[index]]
            larger = not unstable and bool(judged)
            only = "stable for slower motion only: " * slow + "stable for larger motion only: " * larger
            result[AXES[index]] = f"{only}{doubt.reason}"
    return result


def _valid_to(loops: Loops) -> tuple[Bound | None, str]:
    """Return the speed up to which laws are linear, and it in words if less than what a fall reaches."""
    valid = {axis: one.valid_to for axis, one in loops.doubts.items() if not one.void}
    if not valid or loops.reach is None:
        return None, ""
    fall = reached_speed(loops.reach)
    axis = min(valid, key=lambda axis: (valid[axis].beyond, float(valid[axis]) / fall[axis]))
    limit, unit = valid[axis], f"m{unit_of('m', AXES[axis])}/s"
    if limit.beyond or limit >= fall[axis] or loops.doubts[axis].reason:
        return limit, ""
    linear = f"linear on {AXES[axis]} up to {up_to(limit, loops[0].period, AXES[axis])}"
    return limit, f"valid for small motion: {linear}; a fall reaches {1e3 * fall[axis]:.3g} {unit}"


def _gains(loops: Loops, worst: Loop) -> tuple[Array, Array]:
    """Return total stiffness and damping of all axes in the states, or at the pose, of one loop, (6, 6) each."""
    if worst.linear is not None:
        return worst.linear.gains(np.array(worst.body))
    stiffness, damping = np.zeros((2, 6, 6))
    for loop in loops:
        if loop.linear is None and set(loop.state) == set(worst.state) & {*loop.state, *loop.others}:
            index = AXES.index(loop.axis)
            stiffness[index, index], damping[index, index] = loop.total
    return stiffness, damping


class _Critical(NamedTuple):
    """Point at which stability of a loop changes as the declared gain grows.

    Attributes:
        ratio: Ratio of critical to present gain.
        stiffness: Total stiffness of the axis there [N/m, N m/rad].
    """

    ratio: Bound
    stiffness: Bound


_UNKNOWN = _Critical(Bound(math.nan), Bound(math.nan))


def critical_stiffness_of(loops: Loops, loop: Loop) -> _Critical:
    """Return where stability of one loop changes; see `Verdict.critical_stiffness`."""
    total, grown = loop.total[0], loops.grown
    if len(loop.axes) > 1 or not total > 0.0:
        return _UNKNOWN
    rise, other, own = 0.0, loop, loop.stiffness
    if grown is None and loop.linear is None:
        own = rise = loop.in_question.stiffness
    if grown is not None:
        try:
            other = grown(loop, 1.0 + _SLIGHT)
        except ParameterError:  # at the end of its bounds
            other = grown(loop, 1.0 - _SLIGHT)
        change = other.total[0] - total
        rise = abs(change) / _SLIGHT if abs(change) > RELATIVE_ROUNDING * total else total
    # the stiffness of one law alone changes, so that no crossing is missed
    if loop.linear is None and own and other == replace(loop, stiffness=other.stiffness):
        found = critical_of(loop) if grown is None else critical_of_host(loop)
        ratio = 1.0 + (found - own) / rise
        return _Critical(Bound(max(ratio, 0.0), found.beyond), Bound(found + total - own, found.beyond))
    if grown is None:
        return _UNKNOWN

    def at(_: Sequence[int], ratios: Sequence[float]) -> list[Loops]:
        return [_grown(loops, loop, ratio) for ratio in ratios]

    (ratio,) = critical_ratios(at, [loops.only([loop])])
    return _Critical(ratio, ratio if ratio == 0.0 else Bound(total + (ratio - 1.0) * rise, ratio.beyond))


def _grown(loops: Loops, loop: Loop, ratio: float) -> Loops:
    """Return one loop at a ratio of the declared gain; none out of its bounds."""
    assert loops.grown is not None
    try:
        return loops.only([loops.grown(loop, ratio)])
    except ParameterError:
        return loops.only([])


def nearest(loops: Loops, axis: str = "z") -> Loop:
    """Return the loop of declared gains nearest to its critical stiffness.

    Without any stiffness the most damped one on an axis.
    """
    stiff = [loop for loop in loops if loop.linear is None and loop.total[0] > 0.0]
    if not stiff:
        return max([loop for loop in loops if axis in loop.axes] or loops, key=lambda loop: loop.damping)
    groups: dict[Loop, list[Loop]] = {}
    for loop in stiff:
        own = loop.in_question
        alike = replace(own, stiffness=0.0, damping=0.0, inertia=1.0, axis="", state=(), others=())
        groups.setdefault(alike, []).append(loop)
    shares: dict[int, float] = {}
    for alike, some in groups.items():
        gains = [(one.stiffness, one.damping, one.inertia) for one in (loop.in_question for loop in some)]
        stiffness, damping, inertia = np.array(gains).T
        with np.errstate(divide="ignore"):
            found = stiffness / boundary_of(alike.array(inertia=inertia), damping)
        shares |= dict(zip(map(id, some), found.tolist(), strict=True))
    most = max(shares.values()) * (1.0 - RELATIVE_ROUNDING)  # the first of those equal within rounding
    return next(loop for loop in stiff if shares[id(loop)] >= most)


def critical_delay_of(loops: Loops) -> Bound:
    """Return the first delay of the host at which a loop is unstable [s].

    0 if unstable without delay, NaN if a loop cannot be judged. Searched to 1 s.
    """
    if loops.unjudged or not len(loops):
        return Bound(math.nan)
    return Bound.least(map(_delay_of, loops))


def _delay_of(loop: Loop) -> Bound:
    """Return the critical delay of one loop."""
    if not loop.acts:  # a hand alone is passive
        return Bound(MAX_DELAY, True, 0.0)
    if loop.linear is None:
        return _stated_delay(loop) if loop.law is None else delay_bound(loop.array(), loop.stiffness, loop.damping)
    if len(loop.axes) > 1:
        return coupled_bound(loop)
    system = loop.linear.states.with_units(loop.period, np.array([loop.inertia]))
    design = StateSpace(*(part[None] for part in system)).single
    return delay_bounds(loop.array(law=design), 0.0, 0.0, np.array([loop.linear.still > 0]))[0]


@lru_cache(maxsize=512)  # rotations are the same in every hand
def _stated_delay(loop: Loop) -> Bound:
    """Return the critical delay of declared gains, beside a law on the device."""
    if loop.stiffness or loop.damping:
        return delay_bound(loop.array(), loop.stiffness, loop.damping)
    # the delay of a host without gains does not matter
    radius = radius_of(loop, poles_of([loop])[0])
    return Bound(MAX_DELAY, True, 0.0) if radius < 1.0 - RELATIVE_ROUNDING else Bound(0.0)


def _loop_text(axes: Sequence[str], stable: bool | None, radius: float) -> str:
    """Return the verdict on a loop in words."""
    return f"{', '.join(axes)}: {'free motion' if stable and not radius else f'{_word(stable)}, {radius_text(radius)}'}"


def _word(stable: bool | None) -> str:
    return {True: "stable", False: "unstable", None: "not computed"}[stable]
