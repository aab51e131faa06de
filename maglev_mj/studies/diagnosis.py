"""Why a rendered wall shakes, and which change helps most: verdict, margins and ranked remedies of one loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from maglev_mj.control import LowPass
from maglev_mj.errors import KeywordError, ParameterError, choice_message
from maglev_mj.frames import Array, Mask
from maglev_mj.keywords import with_period
from maglev_mj.parameters import Parameters, param, transport_delay
from maglev_mj.plants.hand import HANDS, get_hand
from maglev_mj.recording import Recording
from maglev_mj.result import Result, Table, number_text
from maglev_mj.spec import MAX_DELAY_PERIODS, MAX_PERIOD, MIN_PERIOD
from maglev_mj.studies.oscillation import Oscillation, find_oscillation, matched, read_motion, recorded_motion
from maglev_mj.theory import (
    StiffestWall,
    critical_delay,
    largest_stable_stiffness,
    least_passive_damping,
    stiffest_wall,
)
from maglev_mj.theory.closed_loop import SampledLoop, bisect, is_stable, pd
from maglev_mj.theory.two_rates import DeviceLaw, two_rate_radius, two_rate_stiffness

COSTS = "gains", "timing", "firmware", "mechanics", "feel"
"""Kinds of cost of a remedy, cheapest first: `feel` renders a softer wall."""

_FACTORS, _BISECTIONS = np.geomspace(1e-2, 1e2, 201), 24
_DEVICE_PERIOD, _DEVICE_DELAY = 1e-3, 2e-4
_DIGITS = 3
_HEAVIER, _FILTERS = 1.5, (20.0, 200.0)
_MODEST = 0.05
"""Relative gain in critical stiffness below which a change counts as without effect."""

_LEAST, _SAMPLES = 1e-9, 4096
_MOTIONS = ".maglev", ".csv", ".txt", ".tsv"


class DiagnosedLoop(Parameters):
    """One axis of a device that renders a wall, a spring or any stiffness with damping.

    Raises:
        ParameterError: If a value is outside its bounds, or mass and inertia are both given.
    """

    stiffness: float = param("stiffness K of wall or spring", "N/m", default=0.0, at_least=0.0, at_most=1e8)
    damping: float = param("damping B of the law", "N s/m", default=0.0, at_least=0.0, at_most=1e6)
    period: float = param("sample period T", "s", default=MAX_PERIOD, at_least=MIN_PERIOD, at_most=MAX_PERIOD)
    delay: float = param(
        "delay from a sample to the effect of its command; one period if not stated", "s", default=0.0, at_least=0.0
    )
    mass: float | None = param("moving mass with the handle", "kg", default=None, above=0.0, optional=True)
    inertia: float | None = param(
        "moment of inertia of a rotary axis, whose units are N m/rad", "kg m²", default=None, above=0.0, optional=True
    )
    own_damping: float = param("damping of the device's own", "N s/m", default=0.0, at_least=0.0, at_most=1e6)
    friction: float = param("Coulomb friction of the device", "N", default=0.0, at_least=0.0)
    quantum: float = param("resolution of the position sensor", "m", default=0.0, at_least=0.0)
    cutoff: float | None = param(
        "cutoff of the velocity's low-pass filter", "Hz", default=None, above=0.0, optional=True
    )
    hand: str = param(f"hand: {', '.join(HANDS)} or MASS,DAMPING,STIFFNESS[,GRIP_...]", default="none")
    target: float = param("wanted ratio of critical to requested stiffness", default=2.0, above=1.0, at_most=100.0)
    device_damping: float = param("damping of a law on the device", "N s/m", default=0.0, at_least=0.0, at_most=1e6)
    device_stiffness: float = param("stiffness of a law on the device", "N/m", default=0.0, at_least=0.0, at_most=1e9)
    device_period: float = param(
        "sample period of a law on the device", "s", default=_DEVICE_PERIOD, above=0.0, at_most=MAX_PERIOD
    )
    device_delay: float = param("delay of a law on the device", "s", default=_DEVICE_DELAY, at_least=0.0, at_most=0.01)

    def check(self) -> None:
        """See `Parameters`."""
        if self.mass is not None and self.inertia is not None:
            raise ParameterError(f"mass and inertia must not both be given (got {self.mass:g}, {self.inertia:g})")
        transport_delay(self.delay, self.period)
        transport_delay(self.device_delay, self.device_period)
        get_hand(self.hand)

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.inertia is not None

    @property
    def body(self) -> float:
        """Moving mass [kg] or moment of inertia [kg m²]."""
        return float(self.inertia if self.mass is None else self.mass)  # type: ignore[arg-type]

    @property
    def keywords(self) -> dict[str, Any]:
        """Keywords of the theory besides the gains."""
        keywords: dict[str, Any] = {"period": self.period, "delay": self.delay, "mass": self.body}
        keywords |= {"hand": get_hand(self.hand), "own_damping": self.own_damping}
        return keywords | ({} if self.cutoff is None else {"velocity": LowPass(cutoff=self.cutoff)})

    @property
    def device_keywords(self) -> dict[str, Any]:
        """Keywords of the theory for a wall that is on the device alone."""
        return self.keywords | {"period": self.device_period, "delay": self.device_delay}

    @property
    def device(self) -> DeviceLaw | None:
        """Law on the device; None for none."""
        if not self.device_damping and not self.device_stiffness:
            return None
        gains = {"stiffness": self.device_stiffness, "damping": self.device_damping}
        return DeviceLaw(**gains, period=self.device_period, delay=self.device_delay)

    @property
    def on_host(self) -> bool:
        """False if the whole wall is on the device."""
        return not self.device_stiffness

    def critical(self) -> float:
        """Return the critical stiffness at the present damping."""
        if not self.on_host:
            return float(largest_stable_stiffness(self.device_damping, **self.device_keywords))
        if self.device is not None:
            return float(two_rate_stiffness(self.damping, self.device, **self.keywords))
        return float(largest_stable_stiffness(self.damping, **self.keywords))

    def stiffest(self) -> tuple[float, float]:
        """Return the largest critical stiffness over all dampings, and its damping."""
        best = _stiffest(self)
        return float(best.stiffness), float(best.damping)


@lru_cache(maxsize=64)
def _stiffest(loop: DiagnosedLoop) -> StiffestWall:
    """Return the stiffest stable wall over all dampings."""
    return stiffest_wall(**loop.keywords)


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
class Diagnosis(Result):
    """Verdict on one loop, its margins, and what helps.

    Attributes:
        loop: The loop.
        stable: True if the loop settles.
        spectral_radius: Spectral radius per sample of the host.
        frequency: Frequency at which it rings [Hz]; 0 for a motion that does not oscillate.
        doubling_time: Time in which the motion doubles [s]; negative for the time in which it halves.
        critical_stiffness: Stiffness at which stability changes, at this damping [N/m, N m/rad].
        damping_range: Dampings that are stable at this stiffness [N s/m, N m s/rad]; None for none.
        critical_delay: Delay at which stability changes [s]; 0 if unstable without delay.
        rate_range: Sample rates that are stable with this delay [Hz]; None for none.
        rate_in_periods: The same if the delay stays the same number of periods.
        best: Stiffest stable wall over all dampings.
        remedies: Changes that help, best first.
        ineffective: Changes without effect, in words.
        passive_damping: Damping of the device's own that makes the law passive [N s/m, N m s/rad].
        amplitude_limit: Amplitude below which friction ends the oscillation [m, rad]; NaN for none.
        hum: Largest steady error by the sensor's resolution while contact lasts [m, rad]; NaN if unknown.
        assumptions: What was assumed.
        measured: Oscillation of the recording; None without one.
    """

    loop: DiagnosedLoop
    stable: bool
    spectral_radius: float
    frequency: float
    doubling_time: float
    critical_stiffness: float
    damping_range: tuple[float, float] | None
    critical_delay: float
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
    picture: ClassVar = "maglev_mj.studies.diagnosis_picture:diagnosis"

    @property
    def summary(self) -> str:
        """Verdict in one line."""
        pair = "stable" if self.stable else "unstable"
        text = f"{pair}: spectral radius {self.spectral_radius:.4f}"
        if self.frequency:
            text += f", rings at {self.frequency:.3g} Hz"
        word = "halves" if self.doubling_time < 0.0 else "doubles"
        if math.isfinite(self.doubling_time):
            text += f", amplitude {word} in {1e3 * abs(self.doubling_time):.3g} ms"
        return text

    def _headline(self) -> str:
        share = self.loop.stiffness / self.critical_stiffness if self.critical_stiffness else math.inf
        unit = self.unit("N/m")
        if self.stable:
            return f"Stable at {share:.0%} of critical stiffness, {self.critical_stiffness:.4g} {unit}"
        first = f"; {self.remedies[0].words} helps most" if self.remedies else ""
        return f"Unstable, critical stiffness {self.critical_stiffness:.4g} {unit}{first}"

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
            (
                "stiffness",
                f"up to {self.critical_stiffness:.4g} {k} ({_ratio(self.critical_stiffness, self.loop.stiffness)})",
            ),
            ("damping", _interval(self.damping_range, b)),
            (
                "delay",
                "unstable without delay" if not self.critical_delay else f"up to {_milliseconds(self.critical_delay)}",
            ),
            ("rate, same delay", _interval(self.rate_range, "Hz")),
            ("rate, same periods of delay", _interval(self.rate_in_periods, "Hz")),
        ]
        remedies = [
            (index, short(one.ratio), number_text(one.critical_stiffness), _price(one), one.words)
            for index, one in enumerate(self.remedies, 1)
        ]
        head = ("", "ratio", f"critical [{k}]", "cost", "remedy")
        notes = [*(f"little or no effect: {text}" for text in self.ineffective), *self._notes()]
        found = Table(
            "What helps, best first; ratio of critical to requested stiffness", head, remedies, "\n".join(notes)
        )
        title = self.summary[0].upper() + self.summary[1:]
        return Table(title, ("stable for", ""), rows, below=[found])

    def _notes(self) -> Iterable[str]:
        if math.isfinite(self.amplitude_limit):
            yield (
                f"friction of {self.loop.friction:g} {self.unit('N')} hides the oscillation up to an amplitude of "
                f"{1e3 * self.amplitude_limit:.3g} m{self.unit('m')}"
            )
        if math.isfinite(self.hum):
            yield f"sensor resolution: rests within {1e6 * self.hum:.3g} µ{self.unit('m')} while contact lasts"
        yield f"passive only with {self.passive_damping:.4g} {self.unit('N s/m')} of damping of the device's own"
        yield from (f"assumed: {text}" for text in self.assumptions)
        yield "not modelled: edge of the wall, saturation, amplifiers" + ", flexible modes" * (self.loop.hand == "none")


def diagnose(scene: Any = None, **values: Any) -> Diagnosis:
    """Return verdict, margins and ranked remedies of a wall's closed loop, in contact.

    From a recording of a shaking device, the frequency and growth of its oscillation give mass and delay, if stiffness
    and damping are known.

    Args:
        scene: Scene, or name of one, for its worst axis; or path of a recording or CSV file; None for the values.
        values: Parameters of `DiagnosedLoop`; `rate` [Hz] for `period`. They replace those of scene or recording.

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
    if wrong := [name for name in values if name not in accepted]:
        raise KeywordError(choice_message("argument of diagnose", ("scene", *accepted), wrong[0]))
    assumptions: list[str] = []
    measured: Oscillation | None = None
    if isinstance(scene, str | Path) and Path(scene).suffix in _MOTIONS:
        measured, values = _of_recording(Path(scene), values, assumptions)
    elif scene is not None:
        values = {**_of_scene(scene, assumptions), **values}
        if values.get("inertia") is not None:
            values.pop("mass", None)
    for names in (("stiffness",), ("damping",), ("period", "rate"), ("mass", "inertia")):
        if all(values.get(name) is None for name in names):
            raise ParameterError(f"{' or '.join(names)} must be given, or a scene")
    if values.get("delay") is None:
        values["delay"] = values["period"]
        assumptions.append(f"a delay of one period, {_milliseconds(values['period'])}; state the true one")
    return _diagnosed(DiagnosedLoop(**values), tuple(assumptions), measured)


def _of_recording(path: Path, values: dict[str, Any], assumptions: list[str]) -> tuple[Oscillation, dict[str, Any]]:
    """Return the oscillation of a recording, and the values of the loop that explains it."""
    usable, velocity, known = None, None, dict(values)
    if path.suffix == ".maglev":
        motion = recorded_motion(Recording.load(path))
        (time, position, period, usable), velocity = motion[:4], motion.velocity
        stated = {"stiffness": motion.stiffness, "damping": motion.damping, "delay": motion.delay}
        stated["inertia" if motion.axis.startswith("r") else "mass"] = motion.mass
        known = {name: value for name, value in stated.items() if value is not None} | known
    else:
        time, position, period = read_motion(path)
    found = find_oscillation(time, position, period=period, usable=usable)
    period = known.setdefault("period", period)
    text = f"{path.name}: rings at {found.frequency:.4g} Hz, {'grows' if found.growth > 0.0 else 'decays'} by a factor "
    assumptions.append(
        f"{text}{math.exp(abs(found.growth) / found.frequency):.3g} in a cycle, over {found.samples} samples"
    )
    if known.get("stiffness") is None or known.get("damping") is None:
        raise ParameterError(
            f"stiffness and damping of the law must be given to explain the oscillation ({assumptions[0]})"
        )
    mass = "inertia" if known.get("inertia") is not None else "mass"
    if known.get("cutoff") is not None:
        velocity = LowPass(cutoff=known["cutoff"])
    matches = matched(
        found,
        known["stiffness"],
        known["damping"],
        period,
        mass=known.get(mass),
        delay=known.get("delay"),
        velocity=velocity,
    )
    if not matches:
        raise ParameterError(f"no mass and delay explain the oscillation with these gains ({assumptions[0]})")
    assumptions += [match.text for match in matches]
    best = matches[0]
    return found, known | {mass: best.mass, "delay": best.delay, "own_damping": best.own_damping}


def _of_scene(scene: Any, assumptions: list[str]) -> dict[str, Any]:
    """Return the values of a scene's worst axis."""
    from maglev_mj.frames import AXES
    from maglev_mj.scenes.find import get_scene
    from maglev_mj.theory import stability, stated_gains

    found = get_scene(scene)
    controller = found.controller()
    gains, body = stated_gains(controller), found.body.inertia
    if gains is None:
        verdict = stability(found)
        index, acting = AXES.index(verdict.axes[0]) if verdict.axes else found.axis_index, verdict.acting
        k, b = float(verdict.stiffness[index, index]), float(verdict.damping[index, index])
        assumptions.append("gains by linearisation at the worst pose, the law's memory left out")
    else:
        loops = [
            (float(k[axis]), float(b[axis]), axis, acting) for acting, (k, b) in gains.items() for axis in range(6)
        ]
        keywords: dict[str, Any] = {"period": found.period, "delay": found.delay}
        ratios = [
            k / max(float(largest_stable_stiffness(b, mass=body[axis], **keywords)), _LEAST) for k, b, axis, _ in loops
        ]
        k, b, index, acting = loops[int(np.argmax(ratios))]
    if not k > 0.0:
        raise ParameterError(f"scene {found.name} renders no stiffness on its worst axis, {AXES[index]}")
    state = f" ({', '.join(acting)})" if acting else ""
    assumptions.append(f"axis {AXES[index]} of {found.name}{state}, the one with the smallest margin")
    velocity = controller.velocity
    values: dict[str, Any] = {"stiffness": k, "damping": b}
    values |= {"cutoff": velocity.cutoff} if isinstance(velocity, LowPass) else {}
    values |= {"inertia" if index > 2 else "mass": float(body[index])}
    return {**values, "period": found.period, "delay": found.delay}


def _diagnosed(loop: DiagnosedLoop, assumptions: tuple[str, ...], measured: Oscillation | None) -> Diagnosis:
    radius, frequency = pole_of(loop)
    growth = math.log(radius) if radius > 0.0 else -math.inf
    stable, critical = bool(is_stable(radius)), loop.critical()
    remedies, ineffective = _remedies(loop, stable, critical)
    undelayed = {name: value for name, value in loop.keywords.items() if name != "delay"}
    return Diagnosis(
        loop=loop,
        stable=stable,
        spectral_radius=radius,
        frequency=frequency,
        doubling_time=math.log(2.0) * loop.period / growth if growth else math.inf,
        critical_stiffness=critical,
        damping_range=_range(loop, "damping"),
        critical_delay=float(critical_delay(loop.stiffness, loop.damping, **undelayed)),
        rate_range=_range(loop, "rate"),
        rate_in_periods=_range(loop, "rate in periods"),
        best=_stiffest(loop),
        remedies=remedies,
        ineffective=ineffective,
        passive_damping=float(
            least_passive_damping(
                loop.stiffness,
                loop.damping,
                period=loop.period,
                delay=loop.delay,
                design=pd(loop.keywords.get("velocity")),
            )
        ),
        amplitude_limit=math.nan if stable or not loop.friction else _hidden(loop),
        hum=_hum(loop) if stable and loop.quantum else math.nan,
        assumptions=assumptions,
        measured=measured,
    )


def pole_of(loop: DiagnosedLoop) -> tuple[float, float]:
    """Return the spectral radius per sample of the host, and the frequency of the dominant pole [Hz]."""
    keywords, k, b = loop.keywords, loop.stiffness, loop.damping
    if not loop.on_host:
        keywords = loop.device_keywords
        k, b = loop.device_stiffness, loop.device_damping
    elif loop.device is not None:
        return float(two_rate_radius(k, b, loop.device, **keywords)), 0.0
    poles = np.linalg.eigvals(SampledLoop(**keywords).matrix(k, b))
    pole = poles[np.argmax(np.abs(poles))]
    period = keywords["period"]
    frequency = abs(float(np.angle(pole))) / (2.0 * math.pi * period)
    return float(abs(pole)) ** (loop.period / period), frequency


def _range(loop: DiagnosedLoop, name: str) -> tuple[float, float] | None:
    """Return the stable range of the damping or rate that is nearest to the present one; None for none.

    Dampings are searched up to 8 m/T, rates from a hundredth to a hundred times the present one; an end outside is NaN.
    """
    present = {"damping": loop.damping, "rate": 1.0 / loop.period}
    periods = loop.delay / loop.period

    def stable(values: Array) -> Mask:
        damping = values if name == "damping" else np.full_like(values, loop.damping)
        period = np.full_like(values, loop.period) if name == "damping" else 1.0 / values
        delay = periods * period if name == "rate in periods" else np.full_like(values, loop.delay)
        around = {**loop.keywords, "period": period, "delay": delay}
        return np.asarray(is_stable(SampledLoop(**around).spectral_radius(loop.stiffness, damping)))

    centre = present[name.partition(" ")[0]]
    if name == "damping":
        values = np.geomspace(1e-4, 8.0, len(_FACTORS)) * loop.body / loop.period
    else:
        values = centre * _FACTORS
        fastest = min(MAX_DELAY_PERIODS / loop.delay if loop.delay and name == "rate" else math.inf, 1.0 / MIN_PERIOD)
        values = values[(values >= 1.0 / MAX_PERIOD) & (values <= fastest)]
    good = stable(values)
    if not good.any():
        return None
    middle, bad = np.searchsorted(values, centre), np.flatnonzero(~good)
    nearest = np.flatnonzero(good)[np.abs(np.flatnonzero(good) - middle).argmin()]
    below, above = bad[bad < nearest][-1:], bad[bad > nearest][:1]
    outside = values[np.concatenate([below, above])]
    found = bisect(stable, outside, np.full_like(outside, values[nearest]), _BISECTIONS).tolist()
    return (found[0] if below.size else math.nan), (found[-1] if above.size else math.nan)


def _rounded(value: float, *, up: bool = False) -> float:
    """Return a value with the digits that are printed, so that obeying the print gives the printed result."""
    step = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{(math.ceil(value / step) if up else round(value / step)) * step:.12g}")


def _remedy(loop: DiagnosedLoop, words: str, cost: str, **change: float) -> Remedy:
    """Return a remedy, evaluated as printed."""
    changed = loop.replace(**change)
    stiffness = changed.device_stiffness or changed.stiffness
    step = max(
        0.0 if changed.device_stiffness else changed.damping / changed.period,
        changed.device_damping / changed.device_period,
    )
    noise = step * loop.period / loop.damping if loop.damping else math.inf
    critical = changed.critical()
    return Remedy(words, change, critical, critical / stiffness, noise, cost)


def _remedies(loop: DiagnosedLoop, stable: bool, critical: float) -> tuple[tuple[Remedy, ...], tuple[str, ...]]:
    """Return the changes that help, best first, and those that do not, in words."""
    k, b, turned = loop.stiffness, loop.damping, loop.rotary
    damper, spring = ("N m s/rad", "N m/rad") if turned else ("N s/m", "N/m")
    tried = [
        *_gains(loop, damper),
        *_timings(loop, damper),
        *_firmware(loop, damper, spring),
        *_mechanics(loop, damper),
    ]
    present = critical / k
    better = [one for one in tried if one.ratio > max(present * (1.0 + _MODEST), 0.0 if stable else 1.0)]
    most, at = loop.stiffest()
    if most and not any(one.ratio >= loop.target for one in better):
        softer, at = _rounded(most / loop.target), _rounded(at)
        better.append(
            _remedy(loop, f"stiffness {softer:g} {spring} at {at:g} {damper}", "feel", stiffness=softer, damping=at)
        )
    reached = loop.target * (1.0 - 1e-9)
    better.sort(key=lambda one: (one.ratio < reached, COSTS.index(one.cost) * (one.ratio >= reached), -one.ratio))
    useless = [f"{one.words}, ratio {short(one.ratio)}" for one in tried if one not in better]
    half = b + 0.5 * k * loop.period
    if (ratio := loop.replace(damping=half).critical() / k) < max(present * (1.0 + _MODEST), 1.0):
        useless.append(f"half-sample prediction, as {half - b:.3g} {damper} more: ratio {ratio:.2g}")
    return tuple(better), tuple(useless)


def _gains(loop: DiagnosedLoop, damper: str) -> Iterable[Remedy]:
    """Yield the least damping that reaches the target, or the best one."""
    most, best = loop.stiffest()
    if not most:
        return
    wanted = loop.target * loop.stiffness
    if most >= wanted:
        around = SampledLoop(**loop.keywords)
        best = _rounded(_least(lambda b: around.spectral_radius(wanted, b), best) or _LEAST, up=True)
    else:
        best = _rounded(best)
    yield _remedy(loop, f"damping {best:g} {damper}", "gains", damping=best)


def _timings(loop: DiagnosedLoop, damper: str) -> Iterable[Remedy]:
    """Yield a shorter delay and a higher rate, at their best damping."""
    faster, sooner = {"period": 0.5 * loop.period}, {"delay": 0.5 * loop.delay}
    rate = f"rate {2.0 / loop.period:.4g} Hz"
    cases = {rate: faster}
    if loop.delay:
        cases = {
            f"{rate}, delay {_milliseconds(0.5 * loop.delay)}": faster | sooner,
            f"delay {_milliseconds(0.5 * loop.delay)}": sooner,
            f"{rate}, same delay": faster | {"delay": loop.delay},
        }
    for words, change in cases.items():
        if change.get("delay", loop.delay) > MAX_DELAY_PERIODS * change.get("period", loop.period):
            continue
        damping = _rounded(loop.replace(**change).stiffest()[1] or _LEAST)
        yield _remedy(loop, f"{words}, damping {damping:g} {damper}", "timing", **change, damping=damping)


def _firmware(loop: DiagnosedLoop, damper: str, spring: str) -> Iterable[Remedy]:
    """Yield the whole wall on the device at its best damping, and a damper on the device that reaches the target."""
    times = {"device_period": loop.period / max(round(loop.period / _DEVICE_PERIOD), 1)}
    times["device_delay"] = _DEVICE_DELAY if loop.delay > _DEVICE_DELAY else loop.delay
    where = f"on the device ({1.0 / times['device_period']:.4g} Hz, {_milliseconds(times['device_delay'])})"
    best = stiffest_wall(**loop.replace(**times).device_keywords)
    damping = _rounded(float(best.damping) or _LEAST)
    both = {"device_stiffness": loop.stiffness, "device_damping": damping}
    yield _remedy(loop, f"whole wall {where}, damping {damping:g} {damper}", "firmware", **times, **both)
    wanted = loop.target * loop.stiffness

    def radius(values: Array) -> Array:
        laws = [DeviceLaw(damping=value, **device) for value in values.tolist()]
        return np.array([float(two_rate_radius(wanted, loop.damping, law, **loop.keywords)) for law in laws])

    device = {"period": times["device_period"], "delay": times["device_delay"]}
    enough = _least(radius, loop.body / times["device_period"], count=13, halvings=11)
    if enough is not None:
        damping = _rounded(enough, up=True)
        words = f"damper of {damping:g} {damper} {where}, inside the wall"
        yield _remedy(loop, words, "firmware", **times, device_damping=damping)


def _least(
    radius: Callable[[Array], Array], most: float, *, count: int = 41, halvings: int = _BISECTIONS
) -> float | None:
    """Return the least value up to `most` at which a spectral radius is below 1; None if there is none.

    Args:
        radius: Function of values, (N,).
        most: Largest value.
        count: Values tried, over four decades.
        halvings: Bisections.
    """
    grid = np.geomspace(1e-4 * most, most, count)
    good = np.asarray(is_stable(radius(grid)))
    if not good.any():
        return None
    index = int(np.argmax(good))
    low = grid[[index - 1]] if index else np.zeros(1)
    return float(bisect(lambda values: np.asarray(is_stable(radius(values))), low, grid[[index]], halvings)[0])


def _mechanics(loop: DiagnosedLoop, damper: str) -> Iterable[Remedy]:
    """Yield more mass, a damper on the device, and another velocity filter."""
    name = "inertia" if loop.rotary else "mass"
    yield _remedy(loop, f"{name} x {_HEAVIER:g}", "mechanics", **{name: _HEAVIER * loop.body})
    wanted = loop.target * loop.stiffness
    enough = _least(partial(_damped, loop, wanted), 4.0 * loop.body / loop.period)
    if enough is not None:
        added = _rounded(enough or _LEAST, up=True)
        yield _remedy(
            loop, f"mechanical damper of {added:g} {damper}", "mechanics", own_damping=loop.own_damping + added
        )
    cutoffs = {"no velocity filter": None} if loop.cutoff else {f"velocity filter of {f:g} Hz": f for f in _FILTERS}
    for words, cutoff in cutoffs.items():
        yield _remedy(loop, words, "gains", cutoff=cutoff)  # type: ignore[arg-type]


def _damped(loop: DiagnosedLoop, stiffness: float, added: Array) -> Array:
    """Return the spectral radius at a stiffness with more damping of the device's own, (N,)."""
    keywords = {**loop.keywords, "own_damping": loop.own_damping + added}
    return SampledLoop(**keywords).spectral_radius(stiffness, loop.damping)


def _hidden(loop: DiagnosedLoop) -> float:
    """Return the amplitude below which Coulomb friction ends an oscillation, 4 f/(pi w b).

    b is the damping of the device's own that would bring the loop to its boundary, w its frequency there: a describing
    function, within 5 % in simulation.
    """
    needed = _least(partial(_damped, loop, loop.stiffness), 4.0 * loop.body / loop.period)
    if needed is None:
        return math.nan
    _, frequency = pole_of(loop.replace(own_damping=loop.own_damping + needed))
    return 4.0 * loop.friction / (math.pi * 2.0 * math.pi * frequency * needed) if frequency else math.nan


def _hum(loop: DiagnosedLoop) -> float:
    """Return half a sensor step times the l1 norm from measurement error to position: a bound of the steady error."""
    around = SampledLoop(**loop.keywords)
    matrix, phi = around.matrix(loop.stiffness, loop.damping), around.flotor()[0]
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


def _ratio(value: float, present: float) -> str:
    return f"x {short(value / present)}"


def _interval(ends: tuple[float, float] | None, unit: str) -> str:
    """Return a stable range in words."""
    if ends is None:
        return "none"
    low, high = (math.isfinite(end) for end in ends)
    if low and high:
        return f"{ends[0]:.4g} to {ends[1]:.4g} {unit}"
    return f"from {ends[0]:.4g} {unit}" if low else f"up to {ends[1]:.4g} {unit}" if high else "any"


def _milliseconds(value: float) -> str:
    return f"{1e3 * value:.4g} ms" if math.isfinite(value) else "any"


def _price(one: Remedy) -> str:
    noise = f", noise x {short(one.noise)}" if math.isfinite(one.noise) and abs(one.noise - 1.0) > 0.01 else ""
    return f"{one.cost}{noise}"
