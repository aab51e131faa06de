"""Why a rendered wall shakes, and which change helps most: verdict, margins and ranked remedies of one loop."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import FiniteDifference, LowPass
from maglev_mj.device import Device
from maglev_mj.errors import KeywordError, ParameterError, choice_message
from maglev_mj.frames import AXES
from maglev_mj.keywords import checked, with_period
from maglev_mj.parameters import MEASURED_MOTIONS
from maglev_mj.plants.hand import Hand
from maglev_mj.plants.model import body_of
from maglev_mj.result import NoTruthValue, Result, Table, conditions_text, number_text, plain
from maglev_mj.spec import RANGE
from maglev_mj.studies.diagnosed_loops import (
    DiagnosedLoop,
    DiagnosedLoops,
    checked_arrays,
    error_gain,
    loops_of,
    passive_damping,
)
from maglev_mj.theory.boundary import StiffestWall, rigid_note
from maglev_mj.theory.held import Held, held_of
from maglev_mj.theory.line import LineVerdict, LossyLine
from maglev_mj.theory.loop import Bound, Loop, Loops, StableDelays, StableRange, holds
from maglev_mj.theory.loop_array import LinearisedLaw, PdLaw
from maglev_mj.theory.remedies import MOST_DAMPING, Remedy, has_room, hidden_amplitude, short
from maglev_mj.theory.two_rates import rates_of
from maglev_mj.theory.verdict import Verdict, amplitude_text, judge, margin_words, verdicts

if TYPE_CHECKING:
    from maglev_mj.studies.log_gains import LogGains
    from maglev_mj.studies.oscillation import LoggedMotion, Oscillation

_APART = 0.02  # largest distance of measured and judged frequency, relative
_NAMES = (
    *("loop", "stable", "spectral_radius", "frequency", "doubling_time", "critical_stiffness", "damping_range"),
    *("critical_delay", "stable_delays", "rate_range", "rate_in_periods", "best", "remedies", "ineffective"),
    *("passive_damping", "amplitude_limit", "hum", "assumptions", "measured", "remarks", "valid_to", "held"),
    *("leaves_after", "line", "from_log"),
)
"""Figures in the JSON."""


@dataclass(frozen=True, eq=False)
class Diagnosis(NoTruthValue, Result):
    """Verdict on one loop, its margins, and what helps.

    Attributes:
        loop: The loop as stated, with what was asked: target, friction and resolution.
        verdict: Verdict on it, whose figures are below.
        assumptions: What was assumed.
        measured: Oscillation of the recording; None without one.
        remarks: What the recording shows, what was given, and what was fitted; empty without one.
        valid_to: Speed of motion up to which a law without declared gains is linear [m/s, rad/s]; None for others.
        scene_hand: Hand of the scene, whose worst of free and held is `loop`; None without one.
        reach: Range of motion of the axis [m, rad].
        subject: Name of the scene or recording, for charts.
        line: Verdict over a line whose delay varies or that loses samples; None without one.
        samples: Samples of the recording; None without one.
        stated: Inertia and own damping as far as they are stated with a recording.
    """

    loop: DiagnosedLoop
    verdict: Verdict
    assumptions: tuple[str, ...]
    measured: Oscillation | None = None
    remarks: tuple[str, ...] = ()
    valid_to: Bound | None = None
    scene_hand: Hand | None = None
    reach: float = RANGE[2]
    subject: str = field(default="loop", repr=False)
    line: LineVerdict | None = None
    samples: LoggedMotion | None = field(default=None, repr=False)
    stated: Mapping[str, float] = field(default_factory=dict, repr=False)

    @property
    def pictures(self) -> Mapping[str, str]:
        """See `Result`."""
        shown = ["diagnosis", *["jitter"] * (self.line is not None and not self.line.reason)]
        return {name: f"maglev_mj.studies.diagnosis_picture:{name}" for name in shown}

    @property
    def stable(self) -> bool:
        """True if the loop settles."""
        return bool(self.verdict.stable)

    @property
    def spectral_radius(self) -> float:
        """Spectral radius per sample of the host."""
        return self.verdict.spectral_radius

    @property
    def frequency(self) -> float:
        """Frequency at which it rings [Hz]; 0 for a motion that does not oscillate."""
        return self.verdict.frequency

    @property
    def doubling_time(self) -> float:
        """Time in which the motion doubles [s]; negative for the time in which it halves."""
        return self.verdict.doubling_time

    @property
    def critical_stiffness(self) -> Bound:
        """Stiffness of the law in question at which stability changes, at this damping [N/m, N m/rad]."""
        return self.verdict.critical_gain

    @property
    def ratio(self) -> float:
        """Ratio of critical to requested stiffness."""
        return self.critical_stiffness / self.loop.gains[0]

    @property
    def damping_range(self) -> StableRange | None:
        """Dampings that are stable at this stiffness [N s/m, N m s/rad]; None for none."""
        return self.verdict.damping_range

    @property
    def stable_delays(self) -> StableDelays:
        """All stable delays of the law in question, and the end of their search [s]."""
        return self.verdict.stable_delays

    @property
    def critical_delay(self) -> Bound:
        """Delay at which stability changes [s]; 0 if unstable without delay."""
        return self.stable_delays.bound

    @property
    def rate_range(self) -> StableRange | None:
        """Sample rates that are stable with this delay [Hz]; None for none."""
        return self.verdict.rate_range

    @property
    def rate_in_periods(self) -> StableRange | None:
        """The same if the delay stays the same number of periods."""
        return self.verdict.rate_in_periods

    @property
    def best(self) -> StiffestWall:
        """Stiffest stable wall over all dampings."""
        return self.verdict.best

    @cached_property
    def _advice(self) -> tuple[tuple[Remedy, ...], tuple[str, ...]]:
        return self.verdict.advice(self.loop.target)

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """Changes that help, best first; none if the wall is stable and reaches the target."""
        return self._advice[0]

    @property
    def ineffective(self) -> tuple[str, ...]:
        """Changes without effect, in words."""
        return self._advice[1]

    @cached_property
    def passive_damping(self) -> float:
        """Own damping that makes the law passive [N s/m, N m s/rad]; NaN at two rates, with a driver lag or a mode."""
        return float(passive_damping(self.loop.sampled, *self.loop.gains))

    @cached_property
    def amplitude_limit(self) -> float:
        """Amplitude below which friction ends the oscillation [m, rad]; NaN for none."""
        friction = self.loop.friction
        return math.nan if self.stable or not friction else hidden_amplitude(self.loop.whole, friction)

    @cached_property
    def hum(self) -> float:
        """Largest steady error by the sensor's resolution while contact lasts [m, rad]; NaN if unknown."""
        around, quantum = self.loop.sampled, self.loop.quantum
        known = self.stable and quantum and around.device is None and not around.long
        return 0.5 * quantum * float(error_gain(around, *self.loop.gains)) if known else math.nan

    @cached_property
    def held(self) -> Held:
        """Verdict free and in each hand."""
        return held_of(self.loop.loop_in_question, reach=[self.reach] * len(AXES), own=self.scene_hand)

    @cached_property
    def from_log(self) -> LogGains | None:
        """Device and gains from the recording, or why it does not tell them; None without one."""
        if self.samples is None or self.measured is None:
            return None
        from maglev_mj.studies.log_gains import gains_from_log  # slow

        return gains_from_log(
            self.samples,
            self.loop.loop_in_question,
            self.measured,
            target=self.loop.target,
            stated={**self.stated, "quantum": self.loop.quantum},
        )

    @property
    def leaves_after(self) -> float | None:
        """See `Held`."""
        return self.held.leaves_after

    @property
    def summary(self) -> str:
        """Verdict in one line."""
        return f"{margin_words(self.stable, self.ratio)}, {self.motion}"

    @property
    def setting(self) -> str:
        """Gains, rate, delay and body in words."""
        loop, (gains, body) = self.loop, self._around
        rate, delay = 1.0 / loop.value("period"), 1e3 * loop.value("delay")
        return f"{gains}, {rate:.4g} Hz, delay {delay:.4g} ms, {body}"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        loop = self.loop
        clock = [loop.value("period")], [loop.value("delay")]
        return conditions_text(self.subject, [loop.loop_in_question.axis], *clock, *self._around)

    @property
    def _around(self) -> tuple[str, str]:
        """Gains, and body, in words."""
        loop, (stiffness, damping) = self.loop, self.loop.gains
        where = loop.described if loop.whole.on_host else " on the device"
        gains = f"{stiffness:g} {self.unit('N/m')}, {damping:g} {self.unit('N s/m')}"
        return gains, f"{loop.body:g} {self.unit('kg')}{where}"

    @property
    def motion(self) -> str:
        """Spectral radius, ringing frequency and growth in words."""
        text = f"spectral radius {self.spectral_radius:.4f}"
        if self.frequency:
            text += f", rings at {_hertz(self.frequency)}"
            text += f" (measured {_hertz(self.measured.frequency)})" if self.measured else ""
        word = "halves" if self.doubling_time < 0.0 else "doubles"
        if math.isfinite(self.doubling_time):
            span = abs(self.doubling_time)
            text += f", amplitude {word} in " + (f"{span:.3g} s" if span >= 1.0 else f"{1e3 * span:.3g} ms")
        return text

    def _headline(self) -> str:
        unit, word = self.unit("N/m"), "Stable" if self.stable else "Unstable"
        present, bound = number_text(self.loop.gains[0]), self.critical_stiffness
        more = "more than " * bound.beyond
        critical = f"{more}{number_text(bound)} {unit}" if math.isfinite(bound) else "not computed"
        goal = f"For {self.loop.target:g} times the stiffness" if self.stable else "Change first"
        first = f". {goal}: {self.remedies[0].words}" if self.remedies else ""
        return f"{word}: {present} {unit}, critical stiffness {critical}{first}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """See `Result`."""
        return tuple(filter(None, [self.line.warning if self.line else ""]))

    def unit(self, unit: str) -> str:
        """Return a unit of a translation, or that of a rotation for a rotary axis."""
        return self.loop.unit(unit)

    @property
    def units(self) -> Mapping[str, str]:
        """See `Result`."""
        return {"critical_stiffness": self.unit("N/m")}

    def as_json(self) -> dict[str, Any]:
        """Return the loop and all figures, ready for JSON."""
        return {name: plain(getattr(self, name)) for name in _NAMES}

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return a row for each remedy."""
        names = "words", "critical_stiffness", "ratio", "noise", "cost"
        return {name: np.array([getattr(remedy, name) for remedy in self.remedies]) for name in names}

    def table(self) -> Table:
        """Return margins, remedies and notes."""
        k, b = self.unit("N/m"), self.unit("N s/m")
        more = "more than" if self.critical_stiffness.beyond else "up to"
        ranges = (self.damping_range, b), (self.rate_range, "Hz"), (self.rate_in_periods, "Hz")
        damping, rate, in_periods = ("none" if found is None else found.text(unit) for found, unit in ranges)
        rows = [
            ("stiffness", f"{more} {number_text(self.critical_stiffness)} {k} (x {self.ratio:.3g})"),
            ("damping", damping),
            ("delay", self.stable_delays.text),
            ("rate, same delay", rate),
            ("rate, same periods of delay", in_periods),
        ]
        remedies = [
            (index, short(one.ratio), number_text(one.critical_stiffness), _price(one), one.words)
            for index, one in enumerate(self.remedies, 1)
        ]
        head = ("", "ratio", f"critical [{k}]", "cost", "remedy")
        without = "no help" if self.stable else "not enough to end it"
        notes = [f"{without}: {'; '.join(self.ineffective)}" if self.ineffective else "", *self._notes()]
        title = (
            f"What helps, the cheapest that reaches a ratio of {self.loop.target:g} first "
            "(critical over requested stiffness)"
        )
        if has_room(self.loop.whole, self.stable, self.critical_stiffness, self.loop.target):
            title = f"No change needed: critical over requested stiffness is at least {self.loop.target:g}"
        found = Table(title, head, remedies, "\n".join(notes))
        over = [Table(f"Line: {self.line.setting}", ("verdict", ""), self.line.rows)] if self.line else []
        log = [] if self.from_log is None else [self.from_log.table()]
        title, below = f"{self.setting}: {self.motion}", [*over, found, *log]
        return Table(title, ("stable for", ""), rows, str(self.held), below=below, warnings=self.warnings)

    def _notes(self) -> Iterable[str]:
        if math.isfinite(self.amplitude_limit):
            yield (
                f"friction of {self.loop.friction:g} {self.unit('N')} hides the oscillation up to an amplitude of "
                f"{1e3 * self.amplitude_limit:.3g} m{self.unit('m')}"
            )
        if math.isfinite(self.hum):
            yield f"sensor resolution: rests within {1e6 * self.hum:.3g} µ{self.unit('m')} while contact lasts"
        if self.passive_damping > MOST_DAMPING:
            yield "no damping of the device's own makes it passive"
        elif math.isfinite(self.passive_damping):
            yield f"passive only with {self.passive_damping:.4g} {self.unit('N s/m')} of damping of the device's own"
        yield from self.remarks
        yield from (f"assumed: {text}" for text in self.assumptions)
        if self.loop.mode:
            yield rigid_note(self.loop.sampled)
        yield "not modelled: edge of the wall, saturation, amplifiers" + ", flexible modes" * (self.loop.mode is None)


@overload
def diagnose(  # type: ignore[overload-overlap]  # a number is an array too
    scene: Any = None,
    *,
    on_axis: str | None = None,
    line: LossyLine | None = None,
    **values: float | str | LinearisedLaw | PdLaw | None,
) -> Diagnosis: ...


@overload
def diagnose(
    scene: None = None, *, on_axis: None = None, line: None = None, **values: ArrayLike | None
) -> DiagnosedLoops: ...


@checked
def diagnose(
    scene: Any = None, *, on_axis: str | None = None, line: LossyLine | None = None, **values: Any
) -> Diagnosis | DiagnosedLoops:
    """Return verdict, margins and ranked remedies of a wall's closed loop, in contact.

    Of arrays of values it returns verdict and margins of every loop as columns, see `DiagnosedLoops`. Loops are
    computed together unless they differ in a cutoff or in their law on the device.

    For a recording of a shaking device, the loop as stated must have its oscillation; of mass, delay and own damping,
    what is not stated is fitted to its frequency and growth.

    Args:
        scene: Scene, or name of one, for its worst loop: the one with the largest spectral radius if it is unstable,
            else with the smallest margin; or path of a recording or CSV file; None for the values.
        on_axis: Axis of a scene whose worst loop is diagnosed; None for all.
        line: Delays that vary, and losses; the delay of the loop, unless stated, is the middle of its jitter.
        values: Parameters of `DiagnosedLoop` or of the scene; `rate` [Hz] for `period`. They replace those of scene or
            recording. Without either, each number may be an array; all broadcast.

    Raises:
        ParameterError: If a value is missing or outside its bounds, shapes do not match, or a recording contains no
            oscillation.

    Example:
        >>> from maglev_mj import diagnose
        >>> found = diagnose(stiffness=500.0, damping=1.0, rate=200.0, delay=0.005, mass=0.15)
        >>> found.stable, round(found.frequency, 2), round(found.critical_stiffness, 1)
        (False, 8.92, 128.4)
        >>> diagnose(stiffness=[100.0, 200.0], damping=1.0, rate=200.0, delay=0.005, mass=0.15).ratio.round(3)
        array([1.284, 0.642])
    """
    accepted = [item.name for item in DiagnosedLoop.parameters()]
    values = with_period(accepted, values)
    arrays = checked_arrays(values)
    if arrays and scene is not None:
        raise ParameterError(f"{next(iter(arrays))} must be a number beside a scene or recording (see `sweep`)")
    if arrays and line is not None:
        raise ParameterError(f"{next(iter(arrays))} must be a number beside a line")
    values |= {name: float(array.max()) for name, array in arrays.items()}
    assumptions: list[str] = []
    of_scene: dict[str, Any] = {"valid_to": None, "scene_hand": None}
    recorded = isinstance(scene, str | Path) and str(scene).endswith(MEASURED_MOTIONS)
    if line is not None and line.jitter is not None and not recorded:
        values = _within(line.jitter, values, assumptions)
    if scene is not None and not recorded:
        values, of_scene = _of_scene(scene, on_axis, values, assumptions)
    elif on_axis is not None:
        raise ParameterError(f"on_axis must be of a scene (got {on_axis!r} without one)")
    if wrong := [name for name in values if name not in accepted]:
        raise KeywordError(choice_message("argument of diagnose", ("scene", "on_axis", "line", *accepted), wrong[0]))
    measured: Oscillation | None = None
    remarks, stated, taken = tuple[str, ...](), values, tuple[str, ...]()
    if recorded:
        measured, values, taken, of_scene["samples"] = _of_recording(Path(scene), values)
    if "device" in stated and (scene is None or recorded):
        hardware = Device.load(stated["device"])
        own = {"period": hardware.period, "delay": hardware.delay, "mass": hardware.mass}
        rotary = "inertia" in values if recorded else bool(values.get("inertia"))
        values = {name: own[name] for name in own if name != "mass" or not rotary} | values
    if measured is not None and "period" not in values:
        values = values | {"period": 1.0 / measured.rate}
        assumptions.append(f"the rate of the loop is that of the log, {measured.rate:.6g} Hz")
    if values.get("device_stiffness"):  # alone, or beside that of the host
        values = {"stiffness": 0.0, "damping": 0.0} | values
    given = {name for name, value in values.items() if value is not None}
    if recorded and not {"mass", "inertia"} & given:
        values = values | {"inertia" if "inertia" in values else "mass": 1.0}  # fitted below
    for names in (("stiffness",), ("damping",), ("period", "rate"), ("mass", "inertia")):
        if all(values.get(name) is None for name in names):
            raise ParameterError(f"{' or '.join(names)} must be given, or a scene")
    late: dict[str, Any] = {"delay": values["period"]}
    loop = DiagnosedLoop(**late | {name: value for name, value in values.items() if value is not None})
    if arrays:
        return loops_of(loop, arrays, delay_is_stated=values.get("delay") is not None)
    if not loop.gains[0]:
        raise ParameterError(f"stiffness must be above 0 (got {loop.stiffness:g})")
    if measured is not None:
        loop, measured, how = _explained(loop, measured, given, assumptions)
        remarks = (*taken, _seen(Path(scene), measured), *how)
        known = {"inertia": loop.body if {"mass", "inertia"} & given else 0.0, "own_damping": loop.own_damping}
        of_scene |= {
            "subject": Path(scene).stem,
            "stated": {name: value for name, value in known.items() if value or name in given},
        }
    elif values.get("delay") is None:
        others = [loop.trial(delay=share * loop.period) for share in (0.0, 0.5, 1.0, 2.0)]
        words = ["stable" if one.whole.spectral_radius < 1.0 else "unstable" for one in others]
        assumptions.append(
            f"a delay of one period, {1e3 * loop.period:.4g} ms; state the true one: with a delay of 0, 1/2, 1 and 2 "
            f"periods the loop is {', '.join(words)}"
        )
    if loop.device_law is not None and len(rates_of(loop.period, loop.device_law).phases) > 1:
        assumptions.append("clocks of host and device are not commensurate: the worst of ten phases between them")
    if "reach" not in of_scene:
        axis = AXES.index(loop.loop_in_question.axis)
        of_scene["reach"] = float(body_of({"model": loop.hardware}).bounded.range[axis])
    if loop.device_law is None and loop.device_cutoff is not None:
        loop = loop.trial(device_cutoff=None)  # of no law: it would filter that of a remedy
    verdict = verdicts([Loops((loop.whole,))])[0]
    if measured is not None and not abs(verdict.frequency / measured.frequency - 1.0) <= _APART:
        raise ParameterError(
            f"the loop must have the measured frequency, within {_APART:.0%} (got {verdict.frequency:.4g} Hz, measured "
            f"{measured.frequency:.4g} Hz): correct or leave out what is uncertain"
        )
    over = None if line is None else LineVerdict(loop.whole, line)
    return Diagnosis(loop, verdict, tuple(assumptions), measured, remarks, **of_scene, line=over)


def _within(jitter: Sequence[float], values: Mapping[str, Any], assumptions: list[str]) -> dict[str, Any]:
    """Return values with a delay in the range of a jitter: the middle, unless stated.

    Raises:
        ParameterError: If it is stated outside.
    """
    low, high = jitter
    if (delay := values.get("delay")) is None:
        delay = 0.5 * (low + high)
        assumptions.append(f"a delay of {1e3 * delay:.4g} ms, the middle of the jitter, where it does not vary")
    elif not low <= delay <= high:
        raise ParameterError(f"delay must be within the jitter, {low:g} to {high:g} s (got {delay:g})")
    return {**values, "delay": delay}


def _of_scene(
    scene: Any, on_axis: str | None, values: Mapping[str, Any], assumptions: list[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the worst loop of a scene, replaced by stated values, and fields of `Diagnosis`; see `Verdict.marginal`.

    Args:
        scene: The scene, its class or its name.
        on_axis: Name of the axis; None for all.
        values: Stated values. Those of parameters of the scene change it, unless a parameter of the loop with that name
            is of another kind or unit, or the hand; a name is always that of the scene.
        assumptions: Receives what was assumed, in words.

    Raises:
        ParameterError: If the scene renders no stiffness there, or is not judged.
    """
    from maglev_mj.scenes.find import get_scene  # slow

    found, kinds = get_scene(scene), {item.name: (item.kind, item.unit) for item in DiagnosedLoop.parameters()}
    named = [item for item in found.parameters() if item.name in values and item.name != "hand"]
    same = [
        item.name
        for item in named
        if kinds.get(item.name, (item.kind, item.unit)) == (item.kind, item.unit)
        or (item.kind is str and isinstance(values[item.name], str))  # the name of a law, where the loop takes one
    ]
    found = found.replace(**{name: values[name] for name in same})
    stated = {name: value for name, value in values.items() if name not in same or name == "device"}
    loops = Loop.of(found, hand="none" if "hand" in stated else None)
    if on_axis is not None:
        if on_axis not in AXES:
            raise ParameterError(choice_message("on_axis", AXES, on_axis))
        loops = loops.only([loop for loop in loops if on_axis in loop.axes])
    verdict = judge(loops)
    loop, why = verdict.marginal
    if loop is None:
        raise ParameterError(f"no diagnosis of {found.name}: stability {verdict}")
    axis, own_law, damping = loop.axes[0], loop.law, max(loop.damping, 0.0)
    if not loop.total[0] > 0.0:
        raise ParameterError(f"scene {found.name} renders no stiffness on its worst axis, {axis}")
    if partial := verdict.loops.partial:
        assumptions.append(f"{' and '.join(partial)} as declared, without the rest")
    if loop.linear is not None:
        memory = "coupling to other axes and memory left out"
        if len(loop.axes) == 1:
            own_law = loop.in_question.law
            memory = "with its memory, which scales with the stiffness and keeps its length in samples"
        motion = f" for motion of {amplitude_text(loop.at_amplitude, axis)}" if loop.at_amplitude else ""
        assumptions += [f"law linearised at the worst pose{motion}, {memory}", *[verdict.range] * bool(verdict.range)]
    elif not isinstance(loop.velocity, FiniteDifference | LowPass):
        own_law = PdLaw(loop.velocity or FiniteDifference())
        if not loop.on_host and damping:
            assumptions.append("damping of the host beside the wall on the device by the finite difference")
    state = f" ({', '.join(loop.state)})" if loop.state else ""
    assumptions.append(f"axis {axis} of {found.name}{state}, {why}")
    result: dict[str, Any] = {"stiffness": loop.stiffness, "damping": damping, "law": own_law}
    result |= {name: getattr(loop, name) for name in ("period", "delay", "driver_lag")}
    if isinstance(loop.velocity, LowPass):
        result["cutoff"] = loop.velocity.cutoff
    if loop.device is not None:
        names = "stiffness", "damping", "period", "delay", "cutoff"
        result |= {f"device_{name}": getattr(loop.device, name) for name in names}
    name, other = ("inertia", "mass") if axis.startswith("r") else ("mass", "inertia")
    if stated.get(other) is not None:
        raise ParameterError(f"{other} must not be given on axis {axis} of {found.name}: state its {name}")
    if stated.get(name) is None:
        result[name] = loop.inertia
    hand, side = verdict.loops.hand, AXES[3:] if axis.startswith("r") else AXES[:3]
    of_scene: dict[str, Any] = {
        "valid_to": verdict.valid_to,
        "scene_hand": replace(hand, axes=side) if hand is not None and holds(hand, loop) else None,
        "reach": float(found.body.bounded.range[AXES.index(axis)]),
        "subject": found.name,
    }
    if loop.hand is not None:
        result["hand"] = ",".join(f"{float(part)!r}" for part in loop.hand.values[: 5 if loop.hand.soft else 3])
        assumptions.append("held by the scene's hand, in which it is less stable than free")
    return {**result, **stated}, of_scene


def _of_recording(
    path: Path, values: dict[str, Any]
) -> tuple[Oscillation, dict[str, Any], tuple[str, ...], LoggedMotion]:
    """Return the oscillation of a recording, the values that its file states, notes and samples."""
    from maglev_mj.studies.oscillation import read_oscillation  # slow

    seen, known, taken, motion = read_oscillation(path)
    if values.get("mass") is not None or values.get("inertia") is not None:
        known = {name: value for name, value in known.items() if name not in ("mass", "inertia")}
    if values.get("cutoff") is not None:
        known.pop("law", None)
    known |= {name: value for name, value in values.items() if value is not None}
    if known.get("stiffness") is None or known.get("damping") is None:
        if not known.get("device_stiffness"):
            raise ParameterError(f"stiffness and damping of the law must be given to explain {_seen(path, seen)}")
    return seen, known, taken, motion


def _seen(path: Path, seen: Oscillation) -> str:
    """Return what a recording shows, in words."""
    factor = math.exp(abs(seen.growth) / seen.frequency)
    word = "grows" if seen.growth > 0.0 else "decays"
    return (
        f"{path.name}: {seen.frequency:.4g} Hz, {word} by a factor {factor:.3g} in a cycle, over {seen.samples} samples"
        + f"; {seen.damage}" * bool(seen.damage)
    )


def _explained(loop: DiagnosedLoop, seen: Oscillation, given: set[str], assumptions: list[str]) -> tuple[Any, ...]:
    """Return the loop that explains an oscillation, the oscillation, and how, in words."""
    from maglev_mj.studies.recorded_loop import explain  # slow

    names = {
        "inertia": "inertia" if loop.rotary else "mass",
        "delay": loop.whole.name("delay"),
        "own_damping": "own_damping",
    }
    stated = {name for name, word in names.items() if word in given}
    axis = AXES[3] if loop.rotary else "z"
    found = explain(seen, replace(loop.loop_in_question, axis=axis), stated, tuple(assumptions))
    assumptions[:] = found.assumptions
    fitted = {word: getattr(found.loop, name) for name, word in names.items() if name not in stated}
    how = (
        found.remarks if loop.whole.on_host else tuple(text.replace("delay", "device delay") for text in found.remarks)
    )
    return loop.trial(**fitted), found.oscillation, how


def _hertz(value: float) -> str:
    return f"{value:.0f} Hz" if value >= 1000.0 else f"{value:.3g} Hz"


def _price(one: Remedy) -> str:
    noise = f", noise x {short(one.noise)}" if math.isfinite(one.noise) and abs(one.noise - 1.0) > 0.01 else ""
    return f"{one.cost}{noise}"
