"""Why a rendered wall shakes, and which change helps most: verdict, margins and ranked remedies of one loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maglev_mj.control import FiniteDifference, LinearController, LowPass
from maglev_mj.device import Device
from maglev_mj.errors import KeywordError, ParameterError, choice_message
from maglev_mj.frames import AXES, Array, Mask
from maglev_mj.keywords import checked, rate_of, with_period
from maglev_mj.parameters import loop_delay, param
from maglev_mj.plants.hand import HANDS, Hand, get_hand
from maglev_mj.plants.model import body_of
from maglev_mj.result import NoTruthValue, Result, Table, number_text
from maglev_mj.spec import MAX_DELAY, MAX_PERIOD, MIN_PERIOD, RANGE
from maglev_mj.theory.boundary import (
    StiffestWall,
    boundary_of,
    least_passive_damping,
    rates_beside,
    rigid_note,
    stiffest_of,
)
from maglev_mj.theory.closed_loop import LinearisedLaw, PdLaw, SampledLoop, bisect, is_stable, pd
from maglev_mj.theory.held import Held, held_of
from maglev_mj.theory.loop import Bound, Loop, StableDelays, holds, stable_delays
from maglev_mj.theory.two_rates import DeviceLaw, DeviceParameters, rates_of
from maglev_mj.theory.verdict import Verdict, judge, margin_words, nearest

if TYPE_CHECKING:
    from maglev_mj.studies.oscillation import Oscillation

COSTS = "gains", "timing", "firmware", "mechanics", "feel"
"""Kinds of cost of a remedy, cheapest first: `feel` renders a softer wall."""

_POINTS = 241, 6, 15
"""Values tried in a range, steps of its refinement, and values in each."""
_FEW = 13, 11, 1
_ROUGH = 1e-3
_RATIO = 40  # largest ratio of two rates in a range
_DEVICE_PERIOD, _DEVICE_DELAY = 1e-3, 2e-4
_DIGITS = 3
_HEAVIER, _FILTERS = 1.5, (20.0, 200.0)
_MODEST = 0.05
"""Relative gain in critical stiffness below which a change of a stable loop counts as without effect."""

_SAMPLES = 4096
_MOST_DAMPING = 1e6  # damping of a device's own, `DeviceParameters` [N s/m]
_APART = 0.02  # largest distance of measured and judged frequency, relative
MOTIONS = ".maglev", ".csv", ".txt", ".tsv"


class DiagnosedLoop(DeviceParameters):
    """One axis of a device that renders a wall, a spring or any stiffness with damping.

    Raises:
        ParameterError: If a value is outside its bounds, or mass and inertia are both given.
    """

    stiffness: float = param("stiffness K of wall or spring", "N/m", default=0.0, at_least=0.0, at_most=1e8)
    damping: float = param("damping B of the law", "N s/m", default=0.0, at_least=0.0, at_most=1e6)
    period: float = param("sample period T", "s", default=MAX_PERIOD, at_least=MIN_PERIOD, at_most=MAX_PERIOD)
    rate: float = rate_of("period")
    delay: float = param("delay from a sample to the effect of its command", "s", default=0.0, at_least=0.0)
    mass: float | None = param("moving mass with the handle", "kg", default=None, above=0.0, optional=True)
    inertia: float | None = param(
        "moment of inertia of a rotary axis, whose units are N m/rad", "kg m²", default=None, above=0.0, optional=True
    )
    friction: float = param("Coulomb friction of the device", "N", default=0.0, at_least=0.0)
    quantum: float = param("resolution of the position sensor", "m", default=0.0, at_least=0.0)
    cutoff: float | None = param(
        "cutoff of the velocity's low-pass filter", "Hz", default=None, above=0.0, optional=True
    )
    hand: str = param(f"hand: {', '.join(HANDS)} or MASS,DAMPING,STIFFNESS[,GRIP_...]", default="none")
    target: float = param("wanted ratio of critical to requested stiffness", default=2.0, above=1.0, at_most=100.0)
    law: LinearisedLaw | PdLaw | None = param(
        "law with memory on the axis, linearised at some gains; or PD with any linear estimator",
        default=None,
        optional=True,
        parse=lambda law: law,
    )

    def check(self) -> None:
        """See `Parameters`."""
        super().check()
        if self.mass is not None and self.inertia is not None:
            raise ParameterError(f"mass and inertia must not both be given (got {self.mass:g}, {self.inertia:g})")
        loop_delay(self.delay, self.period)
        get_hand(self.hand)

    def trial(self, **changes: Any) -> DiagnosedLoop:
        """Return a copy with changes that the user did not state: their bounds are not checked."""
        copy = object.__new__(type(self))
        vars(copy).update(vars(self) | changes)
        return copy

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.inertia is not None

    @property
    def body(self) -> float:
        """Moving mass [kg] or moment of inertia [kg m²]."""
        return float(self.inertia if self.mass is None else self.mass)  # type: ignore[arg-type]

    @property
    def holding(self) -> Hand | None:
        """Hand on the axis; None for none."""
        hand = get_hand(self.hand)
        return replace(hand, axes=AXES[3:]) if hand is not None and self.rotary else hand

    @property
    def on_host(self) -> bool:
        """False if the whole stiffness is on the device: gains, rate and delay in question are then the device's."""
        return not self.device_stiffness or self.stiffness > 0.0

    def name(self, word: str) -> str:
        """Return the name of stiffness, damping, period or delay of the law in question."""
        return word if self.on_host else f"device_{word}"

    def value(self, word: str) -> float:
        """Return one of these."""
        return float(getattr(self, self.name(word)))

    @property
    def gains(self) -> tuple[float, float]:
        """Stiffness and damping of the law in question."""
        return self.value("stiffness"), self.value("damping")

    @property
    def step(self) -> float:
        """Force by a unit step of the position sensor through the velocity [N/m]."""
        return max(self.damping / self.period, self.device_damping / self.device_period)

    @property
    def sampled(self) -> SampledLoop:
        """Loop without the gains of the law in question; the other law is its device law."""
        return self.loop_in_question.array()

    @property
    def loop_in_question(self) -> Loop:
        """Loop with gains, clock and filter of the law in question, and the other law beside it."""
        other, cutoff = self.device_law, self.cutoff if self.on_host else self.device_cutoff
        if not self.on_host:
            other = DeviceLaw(0.0, self.damping, self.period, self.delay, self.cutoff) if self.damping else None
        return Loop(
            stiffness=self.gains[0],
            damping=self.gains[1],
            period=self.value("period"),
            delay=self.value("delay"),
            inertia=self.body,
            own_damping=self.own_damping,
            driver_lag=self.lag,
            mode=self.flexible,
            hand=self.holding,
            axis="rx" if self.rotary else "z",
            velocity=None if cutoff is None else LowPass(cutoff=cutoff),
            law=self.law,
            device=other,
        )

    def critical(self) -> float:
        """Return the critical stiffness at the present damping."""
        return float(boundary_of(self.sampled, np.asarray(self.gains[1])))


def _rough_damping(loop: DiagnosedLoop) -> float:
    """Return the damping of the stiffest wall to three digits; 0 if no wall is stable."""
    return float(stiffest_of(loop.sampled, _ROUGH).damping)


class Remedy(NamedTuple):
    """Change that makes a loop stable, or stiffer.

    Attributes:
        words: The change in words.
        change: The change as keywords of `diagnose`.
        critical_stiffness: Critical stiffness with it [N/m, N m/rad].
        ratio: Critical over requested stiffness.
        noise: Force of one sensor step, relative to the present loop; infinite without damping at present.
        cost: One of COSTS.
    """

    words: str
    change: Mapping[str, float]
    critical_stiffness: float
    ratio: float
    noise: float
    cost: str


@dataclass(frozen=True, eq=False)
class Diagnosis(NoTruthValue, Result):
    """Verdict on one loop, its margins, and what helps.

    Attributes:
        loop: The loop.
        stable: True if the loop settles.
        spectral_radius: Spectral radius per sample of the host.
        frequency: Frequency at which it rings [Hz]; 0 for a motion that does not oscillate.
        doubling_time: Time in which the motion doubles [s]; negative for the time in which it halves.
        critical_stiffness: Stiffness at which stability changes, at this damping [N/m, N m/rad].
        damping_range: Dampings that are stable at this stiffness [N s/m, N m s/rad]; None for none.
        critical_delay: Delay at which stability changes [s]; 0 if unstable without delay; more than its value if
            `beyond` is true.
        stable_delays: All stable delays, and the end of their search [s].
        rate_range: Sample rates that are stable with this delay [Hz]; None for none.
        rate_in_periods: The same if the delay stays the same number of periods.
        best: Stiffest stable wall over all dampings.
        remedies: Changes that help, best first; none if the wall is stable and reaches the target.
        ineffective: Changes without effect, in words.
        passive_damping: Damping of the device's own that makes the law passive [N s/m, N m s/rad]; NaN at two
            rates.
        amplitude_limit: Amplitude below which friction ends the oscillation [m, rad]; NaN for none.
        hum: Largest steady error by the sensor's resolution while contact lasts [m, rad]; NaN if unknown.
        assumptions: What was assumed.
        measured: Oscillation of the recording; None without one.
        remarks: What the recording shows, what was given, and what was fitted; empty without one.
        valid_to: Speed of motion up to which a law without declared gains is linear [m/s, rad/s]; None for others.
        scene_hand: Hand of the scene, whose worst of free and held is `loop`; None without one.
        reach: Range of motion of the axis [m, rad].
    """

    loop: DiagnosedLoop
    stable: bool
    spectral_radius: float
    frequency: float
    doubling_time: float
    critical_stiffness: float
    damping_range: tuple[float, float] | None
    critical_delay: Bound
    stable_delays: StableDelays
    rate_range: tuple[float, float] | None
    rate_in_periods: tuple[float, float] | None
    best: StiffestWall
    remedies: tuple[Remedy, ...]
    ineffective: tuple[str, ...]
    passive_damping: float
    amplitude_limit: float
    hum: float
    assumptions: tuple[str, ...]
    measured: Oscillation | None = None
    remarks: tuple[str, ...] = ()
    valid_to: Bound | None = None
    scene_hand: Hand | None = field(default=None, repr=False)
    reach: float = field(default=RANGE[2], repr=False)
    derived: ClassVar = ("held", "leaves_after")
    picture: ClassVar = "maglev_mj.studies.diagnosis_picture:diagnosis"

    @property
    def ratio(self) -> float:
        """Ratio of critical to requested stiffness."""
        return self.critical_stiffness / self.loop.gains[0]

    @cached_property
    def held(self) -> Held:
        """Verdict free and in each hand."""
        return held_of(self.loop.loop_in_question, reach=[self.reach] * len(AXES), own=self.scene_hand)

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
        loop, (stiffness, damping) = self.loop, self.loop.gains
        rate, delay = 1.0 / loop.value("period"), 1e3 * loop.value("delay")
        where = loop.described if loop.on_host else " on the device"
        return (
            f"{stiffness:g} {self.unit('N/m')}, {damping:g} {self.unit('N s/m')}, {rate:.4g} Hz, delay {delay:.4g} ms, "
            f"{loop.body:g} {self.unit('kg')}{where}"
        )

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
        present, critical = number_text(self.loop.gains[0]), number_text(self.critical_stiffness)
        goal = f"For {self.loop.target:g} times the stiffness" if self.stable else "Change first"
        first = f". {goal}: {self.remedies[0].words}" if self.remedies else ""
        return f"{word}: {present} {unit}, critical stiffness {critical} {unit}{first}"

    def unit(self, unit: str) -> str:
        """Return a unit of a translation, or that of a rotation for a rotary axis."""
        turned = {"N/m": "N m/rad", "N s/m": "N m s/rad", "m": "rad", "N": "N m", "kg": "kg m²"}
        return turned[unit] if self.loop.rotary else unit

    @property
    def units(self) -> Mapping[str, str]:
        """See `Result`."""
        return {"critical_stiffness": self.unit("N/m")}

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return a row for each remedy."""
        names = "words", "critical_stiffness", "ratio", "noise", "cost"
        return {name: np.array([getattr(remedy, name) for remedy in self.remedies]) for name in names}

    def table(self) -> Table:
        """Return margins, remedies and notes."""
        k, b = self.unit("N/m"), self.unit("N s/m")
        rows = [
            ("stiffness", f"up to {number_text(self.critical_stiffness)} {k} (x {self.ratio:.3g})"),
            ("damping", _interval(self.damping_range, b)),
            ("delay", self.stable_delays.text),
            ("rate, same delay", _interval(self.rate_range, "Hz")),
            ("rate, same periods of delay", _interval(self.rate_in_periods, "Hz")),
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
        if _has_room(self.loop, self.stable, self.critical_stiffness):
            title = f"No change needed: critical over requested stiffness is at least {self.loop.target:g}"
        found = Table(title, head, remedies, "\n".join(notes))
        return Table(f"{self.setting}: {self.motion}", ("stable for", ""), rows, str(self.held), below=[found])

    def _notes(self) -> Iterable[str]:
        if math.isfinite(self.amplitude_limit):
            yield (
                f"friction of {self.loop.friction:g} {self.unit('N')} hides the oscillation up to an amplitude of "
                f"{1e3 * self.amplitude_limit:.3g} m{self.unit('m')}"
            )
        if math.isfinite(self.hum):
            yield f"sensor resolution: rests within {1e6 * self.hum:.3g} µ{self.unit('m')} while contact lasts"
        if self.passive_damping > _MOST_DAMPING:
            yield "no damping of the device's own makes it passive"
        elif math.isfinite(self.passive_damping):
            yield f"passive only with {self.passive_damping:.4g} {self.unit('N s/m')} of damping of the device's own"
        yield from self.remarks
        yield from (f"assumed: {text}" for text in self.assumptions)
        if self.loop.mode:
            yield rigid_note(self.loop.sampled)
        yield "not modelled: edge of the wall, saturation, amplifiers" + ", flexible modes" * (self.loop.mode is None)


@checked
def diagnose(scene: Any = None, **values: Any) -> Diagnosis:
    """Return verdict, margins and ranked remedies of a wall's closed loop, in contact.

    For a recording of a shaking device, the loop as stated must have its oscillation; of mass, delay and own damping,
    what is not stated is fitted to its frequency and growth.

    Args:
        scene: Scene, or name of one, for its worst axis; or path of a recording or CSV file; None for the values.
        values: Parameters of `DiagnosedLoop` or of the scene; `rate` [Hz] for `period`. They replace those of scene or
            recording.

    Raises:
        ParameterError: If a value is missing or outside its bounds, or a recording contains no oscillation.

    Example:
        >>> from maglev_mj import diagnose
        >>> found = diagnose(stiffness=500.0, damping=1.0, rate=200.0, delay=0.005, mass=0.15)
        >>> found.stable, round(found.frequency, 2), round(found.critical_stiffness, 1)
        (False, 8.92, 128.4)
    """
    accepted = [item.name for item in DiagnosedLoop.parameters()]
    values = with_period(accepted, values)
    assumptions: list[str] = []
    of_scene: dict[str, Any] = {"valid_to": None, "scene_hand": None}
    recorded = isinstance(scene, str | Path) and str(scene).endswith(MOTIONS)
    if scene is not None and not recorded:
        values, of_scene = _of_scene(scene, values, assumptions)
    if wrong := [name for name in values if name not in accepted]:
        raise KeywordError(choice_message("argument of diagnose", ("scene", *accepted), wrong[0]))
    measured: Oscillation | None = None
    remarks, stated = tuple[str, ...](), values
    if recorded:
        measured, values = _of_recording(Path(scene), values)
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
    if not loop.gains[0]:
        raise ParameterError(f"stiffness must be above 0 (got {loop.stiffness:g})")
    if measured is not None:
        loop, measured, how = _explained(loop, measured, given, assumptions)
        remarks = (_seen(Path(scene), measured), *how)
    elif values.get("delay") is None:
        others = [loop.trial(delay=share * loop.period) for share in (0.0, 0.5, 1.0, 2.0)]
        verdicts = ["stable" if is_stable(x.sampled.spectral_radius(*x.gains)) else "unstable" for x in others]
        assumptions.append(
            f"a delay of one period, {_milliseconds(loop.period)}; state the true one: with a delay of 0, 1/2, 1 and 2 "
            f"periods the loop is {', '.join(verdicts)}"
        )
    if loop.device_law is not None and len(rates_of(loop.period, loop.device_law).phases) > 1:
        assumptions.append("clocks of host and device are not commensurate: the worst of ten phases between them")
    if "reach" not in of_scene:
        axis = AXES.index(loop.loop_in_question.axis)
        of_scene["reach"] = float(body_of({"model": loop.hardware}).bounded.range[axis])
    return replace(_diagnosed(loop, tuple(assumptions), measured, remarks), **of_scene)


def _of_scene(scene: Any, values: Mapping[str, Any], assumptions: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the loop of a scene with the smallest margin, replaced by stated values, and fields of `Diagnosis`.

    Args:
        scene: The scene, its class or its name.
        values: Stated values. Those of parameters of the scene change it, unless a parameter of the loop with that name
            is of another kind or unit, or the hand.
        assumptions: Receives what was assumed, in words.

    Raises:
        ParameterError: If the scene renders no stiffness there, or is not judged.
    """
    from maglev_mj.scenes.find import get_scene  # slow

    found, kinds = get_scene(scene), {item.name: (item.kind, item.unit) for item in DiagnosedLoop.parameters()}
    named = [item for item in found.parameters() if item.name in values and item.name != "hand"]
    same = [item.name for item in named if kinds.get(item.name, (item.kind, item.unit)) == (item.kind, item.unit)]
    found = found.replace(**{name: values[name] for name in same})
    stated = {name: value for name, value in values.items() if name not in same or name == "device"}
    verdict = judge(found, hand="none" if "hand" in stated else None)
    loop, why = _in_question(verdict)
    if loop is None:
        raise ParameterError(f"no diagnosis of {found.name}: stability {verdict}")
    law: LinearController | PdLaw | None = None
    if partial := verdict.loops.partial:
        assumptions.append(f"{' and '.join(partial)} as declared, without the rest")
    if loop.linear is not None:
        memory = "coupling to other axes and memory left out"
        if len(loop.axes) == 1:
            law = loop.controller()
            memory = "with its memory, which scales with the stiffness and keeps its length in samples"
        assumptions += [f"law linearised at the worst pose, {memory}", *[verdict.range] * bool(verdict.range)]
    elif not isinstance(loop.velocity, FiniteDifference | LowPass):
        law = PdLaw(loop.velocity or FiniteDifference())
    axis, (k, b), own = loop.axes[0], (loop.stiffness, max(loop.damping, 0.0)), loop.device
    if not loop.total[0] > 0.0:
        raise ParameterError(f"scene {found.name} renders no stiffness on its worst axis, {axis}")
    state = f" ({', '.join(loop.state)})" if loop.state else ""
    assumptions.append(f"axis {axis} of {found.name}{state}, {why}")
    own_law = LinearisedLaw(law, k, b) if isinstance(law, LinearController) else law
    result: dict[str, Any] = {"stiffness": k, "damping": b, "law": own_law}
    result |= {name: getattr(loop, name) for name in ("period", "delay", "driver_lag")}
    if isinstance(loop.velocity, LowPass):
        result["cutoff"] = loop.velocity.cutoff
    if own is not None:
        names = "stiffness", "damping", "period", "delay", "cutoff"
        result |= {f"device_{name}": getattr(own, name) for name in names}
    if stated.get("inertia") is None:
        result["inertia" if axis.startswith("r") else "mass"] = loop.inertia
    hand, side = verdict.loops.hand, AXES[3:] if axis.startswith("r") else AXES[:3]
    of_scene: dict[str, Any] = {
        "valid_to": verdict.valid_to,
        "scene_hand": replace(hand, axes=side) if hand is not None and holds(hand, loop) else None,
        "reach": float(found.body.bounded.range[AXES.index(axis)]),
    }
    if loop.hand is not None:
        result["hand"] = ",".join(f"{float(part)!r}" for part in loop.hand.values[: 5 if loop.hand.soft else 3])
        assumptions.append("held by the scene's hand, in which it is less stable than free")
    return {**result, **stated}, of_scene


def _in_question(verdict: Verdict) -> tuple[Loop | None, str]:
    """Return the loop of a scene to diagnose, and why in words: a wall on the device, or the smallest margin."""
    walls = [loop for loop in verdict.loops if loop.device is not None and loop.state == ("contact",)]
    if walls:  # the wall in question; the host's laws in contact are beside it
        gains = lambda loop: (loop.device.stiffness, loop.device.damping, loop.spectral_radius)  # noqa: E731
        return max(walls, key=gains), "stiffest wall on the device"
    if not verdict.stated:
        return (None if verdict.stable is None else verdict.loop), "the one with the smallest margin"
    return nearest(verdict.loops), "the one with the smallest margin"


def _of_recording(path: Path, values: dict[str, Any]) -> tuple[Oscillation, dict[str, Any]]:
    """Return the oscillation of a recording, and the values that its file states, or those in their place."""
    from maglev_mj.studies.oscillation import read_oscillation  # slow

    seen, known = read_oscillation(path)
    if values.get("mass") is not None or values.get("inertia") is not None:
        known = {name: value for name, value in known.items() if name not in ("mass", "inertia")}
    if values.get("cutoff") is not None:
        known.pop("law", None)
    known |= {name: value for name, value in values.items() if value is not None}
    if known.get("stiffness") is None or known.get("damping") is None:
        if not known.get("device_stiffness"):
            raise ParameterError(f"stiffness and damping of the law must be given to explain {_seen(path, seen)}")
    return seen, known


def _seen(path: Path, seen: Oscillation) -> str:
    """Return what a recording shows, in words."""
    factor = math.exp(abs(seen.growth) / seen.frequency)
    word = "grows" if seen.growth > 0.0 else "decays"
    return (
        f"{path.name}: {seen.frequency:.4g} Hz, {word} by a factor {factor:.3g} in a cycle, over {seen.samples} samples"
    )


def _explained(loop: DiagnosedLoop, seen: Oscillation, given: set[str], assumptions: list[str]) -> tuple[Any, ...]:
    """Return the loop that explains an oscillation, the oscillation, and how, in words."""
    from maglev_mj.studies.recorded_loop import explain  # slow

    names = {"inertia": "inertia" if loop.rotary else "mass", "delay": loop.name("delay"), "own_damping": "own_damping"}
    stated = {name for name, word in names.items() if word in given}
    axis = AXES[3] if loop.rotary else "z"
    found = explain(seen, replace(loop.loop_in_question, axis=axis), stated, tuple(assumptions))
    assumptions[:] = found.assumptions
    fitted = {word: getattr(found.loop, name) for name, word in names.items() if name not in stated}
    how = found.remarks if loop.on_host else tuple(text.replace("delay", "device delay") for text in found.remarks)
    return loop.trial(**fitted), found.oscillation, how


def _diagnosed(
    loop: DiagnosedLoop, assumptions: tuple[str, ...], measured: Oscillation | None, remarks: tuple[str, ...]
) -> Diagnosis:
    (k, b), sampled = loop.gains, loop.sampled
    own, frequency = sampled.pole(k, b)
    radius = own ** (loop.period / loop.value("period"))
    if measured is not None and not abs(frequency / measured.frequency - 1.0) <= _APART:
        raise ParameterError(
            f"the loop must have the measured frequency, within {_APART:.0%} (got {frequency:.4g} Hz, measured "
            f"{measured.frequency:.4g} Hz): correct or leave out what is uncertain"
        )
    growth = math.log(radius) if radius > 0.0 else -math.inf
    stable, critical, best = bool(is_stable(radius)), loop.critical(), stiffest_of(sampled)
    remedies, ineffective = _remedies(loop, stable, critical, best)
    delays = stable_delays(sampled, k, b)
    single = sampled.device is None
    design = sampled.design or pd(sampled.velocity)
    times: Any = {"period": sampled.period, "delay": sampled.delay, "design": design}
    return Diagnosis(
        loop=loop,
        stable=stable,
        spectral_radius=radius,
        frequency=frequency,
        doubling_time=math.log(2.0) * loop.period / growth if growth else math.inf,
        critical_stiffness=critical,
        damping_range=_range(loop, "damping"),
        critical_delay=delays.bound,
        stable_delays=delays,
        rate_range=_range(loop, "rate"),
        rate_in_periods=_range(loop, "rate in periods"),
        best=best,
        remedies=remedies,
        ineffective=ineffective,
        passive_damping=float(least_passive_damping(k, b, **times)) if single else math.nan,
        amplitude_limit=math.nan if stable or not loop.friction else _hidden(loop),
        hum=_hum(loop) if stable and loop.quantum and single and not sampled.long else math.nan,
        assumptions=assumptions,
        measured=measured,
        remarks=remarks,
    )


def _range(loop: DiagnosedLoop, name: str) -> tuple[float, float] | None:
    """Return the stable range of the damping or rate that is nearest to the present one; None for none.

    Dampings are searched up to 8 m/T, rates from a hundredth to a hundred times the present one; an end outside is NaN.
    Beside a law at another rate, those of its fractions or multiples are tried.
    """
    (k, b), period, delay, around = loop.gains, loop.value("period"), loop.value("delay"), loop.sampled
    count, *refined = _POINTS

    def stable(values: Array) -> Mask:
        if name == "damping":
            return around.stable(k, values)
        times: Any = {"period": 1.0 / values, "delay": np.broadcast_to(delay, values.shape)}
        if name == "rate in periods":
            times["delay"] = delay / period / values
        return replace(around, **times).stable(k, b)

    centre = b if name == "damping" else 1.0 / period
    if name == "damping":
        values = np.geomspace(1e-4, 8.0, count) * loop.body / period * around.narrowed
    else:
        values = centre * np.geomspace(1e-2, 1e2, count)
        if around.mode is not None:
            values = np.unique(np.append(values, rates_beside(around.mode)))
        if around.device is not None:
            ratios = np.arange(1.0, _RATIO + 1.0)
            values = (ratios if not loop.on_host else 1.0 / ratios[::-1]) / around.device.period
        slowest = max(1.0 / MAX_PERIOD, delay / period / MAX_DELAY if name == "rate in periods" else 0.0)
        values = values[(values >= slowest) & (values <= 1.0 / MIN_PERIOD)]
    good = stable(values)
    if not good.any():
        return None
    middle, bad = np.searchsorted(values, centre), np.flatnonzero(~good)
    nearest = np.flatnonzero(good)[np.abs(np.flatnonzero(good) - middle).argmin()]
    below, above = bad[bad < nearest][-1:], bad[bad > nearest][:1]
    outside = values[np.concatenate([below, above])]
    inside = values[np.concatenate([below + 1, above - 1])]
    if around.device is not None and name != "damping":
        found = inside.tolist()
    else:
        found = bisect(stable, outside, inside, *refined).tolist()
    return (found[0] if below.size else math.nan), (found[-1] if above.size else math.nan)


def _has_room(loop: DiagnosedLoop, stable: bool, critical: float) -> bool:
    """Return True for a stable wall that reaches the target."""
    return stable and critical >= loop.target * loop.gains[0]


def _rounded(value: float, *, up: bool = False) -> float:
    """Return a value with the digits that are printed, so that obeying the print gives the printed result."""
    if not value:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{(math.ceil(value / step) if up else round(value / step)) * step:.12g}")


def _remedy(loop: DiagnosedLoop, words: str, cost: str, **change: float) -> Remedy:
    """Return a remedy, evaluated as printed."""
    changed = loop.trial(**change)
    critical = changed.critical()
    return Remedy(words, change, critical, critical / changed.gains[0], changed.step / (loop.step or math.nan), cost)


def _allowed(loop: DiagnosedLoop, change: Mapping[str, float]) -> bool:
    """Return False for a change to a value that would be refused."""
    with suppress(ParameterError):
        loop.replace(**change)
        return True
    return False


def _remedies(
    loop: DiagnosedLoop, stable: bool, critical: float, best: StiffestWall
) -> tuple[tuple[Remedy, ...], tuple[str, ...]]:
    """Return the changes that help, best first, and those that do not, in words; none if no change is needed."""
    if _has_room(loop, stable, critical):
        return (), ()
    (k, b), turned = loop.gains, loop.rotary
    damper, spring = ("N m s/rad", "N m/rad") if turned else ("N s/m", "N/m")
    most, at = float(best.stiffness), float(best.damping)
    tried = [
        *_gains(loop, damper, most, at),
        *_timings(loop, damper),
        *(_firmware(loop, damper) if loop.on_host else ()),
        *_mechanics(loop, damper),
    ]
    tried = [one for one in tried if _allowed(loop, one.change)]
    present = critical / k
    enough = present * (1.0 + _MODEST) if stable else 1.0
    better = [one for one in tried if one.ratio > enough]
    if most and not any(one.ratio >= loop.target for one in better):
        softer, at = _rounded(most / loop.target), _rounded(at)
        change = {loop.name("stiffness"): softer, loop.name("damping"): at}
        if _allowed(loop, change):
            better.append(_remedy(loop, f"stiffness {softer:g} {spring} at {at:g} {damper}", "feel", **change))
    reached = loop.target * (1.0 - 1e-9)
    better.sort(key=lambda one: (one.ratio < reached, COSTS.index(one.cost) * (one.ratio >= reached), -one.ratio))
    useless = [f"{one.words}, ratio {short(one.ratio)}" for one in tried if one not in better]
    half = b + 0.5 * k * loop.value("period")
    if (ratio := loop.trial(**{loop.name("damping"): half}).critical() / k) < enough:
        useless.append(f"half-sample prediction, as {half - b:.3g} {damper} more: ratio {ratio:.2g}")
    return tuple(better), tuple(useless)


def _gains(loop: DiagnosedLoop, damper: str, most: float, best: float) -> Iterable[Remedy]:
    """Yield the least damping that reaches the target, or that of the stiffest wall."""
    if not most:
        return
    wanted = loop.target * loop.gains[0]
    if most >= wanted:
        around = loop.sampled
        stable, critical = partial(around.stable, wanted), partial(boundary_of, around)
        best = _rounded(_sufficient(stable, critical, wanted, best) or 0.0, up=True)
    else:
        best = _rounded(best)
    yield _remedy(loop, f"damping {best:g} {damper}", "gains", **{loop.name("damping"): best})


def _timings(loop: DiagnosedLoop, damper: str) -> Iterable[Remedy]:
    """Yield a shorter delay and a higher rate, at their best damping."""
    period, delay = loop.value("period"), loop.value("delay")
    faster, sooner = {loop.name("period"): 0.5 * period}, {loop.name("delay"): 0.5 * delay}
    rate = f"{'' if loop.on_host else 'device '}rate {2.0 / period:.4g} Hz"
    cases = {rate: faster}
    if delay:
        cases = {
            f"{rate}, delay {_milliseconds(0.5 * delay)}": faster | sooner,
            f"delay {_milliseconds(0.5 * delay)}": sooner,
            f"{rate}, same delay": faster | {loop.name("delay"): delay},
        }
    for words, change in cases.items():
        damping = _rounded(_rough_damping(loop.trial(**change)))
        change = change | {loop.name("damping"): damping}
        yield _remedy(loop, f"{words}, damping {damping:g} {damper}", "timing", **change)


def _firmware(loop: DiagnosedLoop, damper: str) -> Iterable[Remedy]:
    """Yield the whole wall on the device at its best damping, and a damper on the device that reaches the target."""
    times = {"device_period": loop.period / max(round(loop.period / _DEVICE_PERIOD), 1)}
    times["device_delay"] = _DEVICE_DELAY if loop.delay > _DEVICE_DELAY else loop.delay
    where = f"on the device ({1.0 / times['device_period']:.4g} Hz, {_milliseconds(times['device_delay'])})"
    moved = times | {"stiffness": 0.0, "damping": 0.0, "device_stiffness": loop.stiffness + loop.device_stiffness}
    damping = _rounded(_rough_damping(loop.trial(**moved)))
    moved |= {"device_damping": damping}
    yield _remedy(loop, f"whole wall {where}, damping {damping:g} {damper}", "firmware", **moved)
    wanted, around = loop.target * loop.stiffness, loop.sampled
    clock = times["device_period"], times["device_delay"]
    law = DeviceLaw(loop.device_stiffness, 0.0, *clock, loop.device_cutoff)

    def stable(values: Array) -> Mask:
        loops = [replace(around, device=replace(law, damping=value)) for value in values.tolist()]
        return np.array([bool(one.stable(wanted, loop.damping)) for one in loops])

    enough = _least(stable, loop.body / times["device_period"], _FEW)
    if enough is not None:
        damping = _rounded(enough, up=True)
        words = f"damper of {damping:g} {damper} {where}, inside the wall"
        yield _remedy(loop, words, "firmware", **times, device_damping=damping)


def _least(stable: Callable[[Array], Mask], most: float, search: tuple[int, int, int] | None = None) -> float | None:
    """Return the least value up to `most` at which a loop is stable; None without one.

    Args:
        stable: Function of values, (N,).
        most: Largest value.
        search: Values tried, over four decades, steps of the refinement, and values in each; see _POINTS.
    """
    if not most:
        return None
    count, halvings, points = search or (41, *_POINTS[1:])
    grid = np.array([0.0, *np.geomspace(1e-4 * most, most, count)])
    good = stable(grid)
    if not good.any():
        return None
    index = int(np.argmax(good))
    if not index:
        return 0.0
    ends = grid[[index - 1]], grid[[index]]
    return float(bisect(stable, *ends, halvings, points)[0])


def _sufficient(
    stable: Callable[[Array], Mask], critical: Callable[[Array], Array], wanted: float, most: float
) -> float | None:
    """Return the least value at which the wanted stiffness and all softer ones are stable; None without one.

    Args:
        stable: Function of values (N,) that returns whether the wanted stiffness is stable.
        critical: Function of them that returns the critical stiffness.
        wanted: The stiffness.
        most: Largest value.
    """
    enough = _least(stable, most)
    if enough is None or critical(np.array([_rounded(enough, up=True)]))[0] >= wanted * (1.0 - 1e-9):
        return enough  # the softer ones are stable too, unless a law with memory is stable in a band alone
    return _least(lambda values: critical(values) >= wanted, most)


def _mechanics(loop: DiagnosedLoop, damper: str) -> Iterable[Remedy]:
    """Yield more mass, a damper on the device, and another velocity filter."""
    name = "inertia" if loop.rotary else "mass"
    yield _remedy(loop, f"{name} x {_HEAVIER:g}", "mechanics", **{name: _HEAVIER * loop.body})
    wanted = loop.target * loop.gains[0]
    damping = np.asarray(loop.gains[1])
    critical = lambda added: boundary_of(replace(loop.sampled, own_damping=loop.own_damping + added), damping)  # noqa: E731
    enough = _sufficient(partial(_damped, loop, wanted), critical, wanted, 4.0 * loop.body / loop.value("period"))
    if enough is not None:
        added = _rounded(enough, up=True)
        yield _remedy(
            loop, f"mechanical damper of {added:g} {damper}", "mechanics", own_damping=loop.own_damping + added
        )
    if loop.law is not None or not loop.on_host:
        return
    cutoffs = {"no velocity filter": None} if loop.cutoff else {f"velocity filter of {f:g} Hz": f for f in _FILTERS}
    for words, cutoff in cutoffs.items():
        yield _remedy(loop, words, "gains", cutoff=cutoff)  # type: ignore[arg-type]


def _damped(loop: DiagnosedLoop, stiffness: float, added: Array) -> Mask:
    """Return whether a stiffness is stable with more damping of the device's own, (N,)."""
    return replace(loop.sampled, own_damping=loop.own_damping + added).stable(stiffness, loop.gains[1])


def _hidden(loop: DiagnosedLoop) -> float:
    """Return the amplitude below which Coulomb friction ends an oscillation, 4 f/(pi w b).

    b is the damping of the device's own that would bring the loop to its boundary, w its frequency there: a describing
    function, within 5 % in simulation.
    """
    needed = _least(partial(_damped, loop, loop.gains[0]), 4.0 * loop.body / loop.value("period"))
    if not needed:
        return math.nan
    _, frequency = loop.trial(own_damping=loop.own_damping + needed).sampled.pole(*loop.gains)
    return 4.0 * loop.friction / (math.pi * 2.0 * math.pi * frequency * needed) if frequency else math.nan


def _hum(loop: DiagnosedLoop) -> float:
    """Return half a sensor step times the l1 norm from measurement error to position: a bound of the steady error."""
    around = loop.sampled
    matrix, phi = around.matrix(*loop.gains), around.flotor()[0]
    error = matrix[:, 0].copy()
    error[: len(phi)] -= phi[:, 0]
    total, state = 0.0, error
    for _ in range(_SAMPLES):
        total += abs(float(state[0]))
        state = matrix @ state
    return 0.5 * loop.quantum * total


def short(value: float) -> str:
    """Return two digits of a number, or all of a large one."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"


def _interval(ends: tuple[float, float] | None, unit: str) -> str:
    """Return a stable range in words."""
    if ends is None:
        return "none"
    low, high = (math.isfinite(end) for end in ends)
    if low and high:
        return f"{ends[0]:.4g} to {ends[1]:.4g} {unit}"
    return f"from {ends[0]:.4g} {unit}" if low else f"up to {ends[1]:.4g} {unit}" if high else "no limit found"


def _hertz(value: float) -> str:
    return f"{value:.0f} Hz" if value >= 1000.0 else f"{value:.3g} Hz"


def _milliseconds(value: float) -> str:
    return f"{1e3 * value:.4g} ms"


def _price(one: Remedy) -> str:
    noise = f", noise x {short(one.noise)}" if math.isfinite(one.noise) and abs(one.noise - 1.0) > 0.01 else ""
    return f"{one.cost}{noise}"
