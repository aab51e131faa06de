"""Gains from a log: the device with 95 % intervals, and gains that reach a ratio for every device that explains it.

The fit is that of `device_fit`. A log that cannot tell the device is refused with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

import maglev_mj
from maglev_mj.control import LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, unit_of
from maglev_mj.result import Table, number_text
from maglev_mj.studies.device_fit import (
    INTERVAL,
    LONGEST_DELAY,
    MOST_SAMPLES,
    REGION,
    DeviceFit,
    Points,
    Ring,
    independent,
)
from maglev_mj.studies.oscillation import LoggedMotion, Oscillation, is_white, reversals
from maglev_mj.theory.boundary import boundary_of, first_end, flattened, maxima, spans
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import LoopArray

_HALF_CYCLES, _COUNTS = 5, 10.0
"""Fewest half cycles, and travel in steps of the sensor."""
_STARTS, _MARGIN = 4, 2
"""Starts from which a log is tried, until no other force acts, and half cycles that are then left out, too."""
_STEPS, _MISFIT = 0.6, 0.01
"""Least residual of another force: in sensor steps, if it is no white noise; as a share of the motion's deviation."""
_UNSTEADY = 3.0
"""Largest ratio of the residuals of two quarters of a log: noise of a sensor does not follow the motion."""
_OTHER_MASS = 0.02
"""Least distance of a stated mass from the interval of the fitted one that is another body, relative."""
_SURE, _RELEVANT = 5.0, 0.02
"""Least spring beside the law that is named: in standard errors, and as a share of the law's stiffness."""
_EXACT = 1e-9
"""Least noise, as a share of the travel: rounding of a log without noise."""
_INERTIA, _DELAY = 0.1, 0.3
"""Largest half widths of 95 % intervals: of the mass, relative, and of the delay, in periods."""
_BEFORE = 2.0
"""Largest squares, per sample, of the samples for which a constant command before the log is assumed."""
_APART = 0.02
"""Largest distance of fitted and measured frequency, relative."""
_DAMPINGS, _ERROR_OF_DAMPING, _DIGITS = np.array([0.0, *np.geomspace(1e-3, 4.0, 48)]), 1e-3, 4
"""Dampings searched [m/T], their relative error, and digits of the gains, rounded down."""


class Interval(NamedTuple):
    """Value with its 95 % interval."""

    value: float
    low: float
    high: float

    def text(self, scale: float = 1.0) -> str:
        """Return the interval in words, in digits that show its width."""
        width = max(self.high - self.low, 1e-4 * abs(self.high))
        digits = 1 - math.floor(math.log10(scale * width)) if width > 0.0 else 4
        return " to ".join(f"{round(scale * one, digits):.10g}" for one in (self.low, self.high))

    def number(self, scale: float = 1.0) -> str:
        """Return the value in as many digits."""
        width = max(self.high - self.low, 1e-4 * abs(self.high))
        digits = 1 - math.floor(math.log10(scale * width)) if width > 0.0 else 4
        return f"{round(scale * self.value, digits):.10g}"


@dataclass(frozen=True, kw_only=True)
class LogGains:
    """Device from a log, and gains for it; or the reason against both.

    Attributes:
        refused: Why the log cannot tell the device; empty if it can.
        values: Mass or inertia, delay, own damping and friction with 95 % intervals, in SI units.
        ratio: Critical over present stiffness, with its ends over the confidence region.
        stiffness: Recommended stiffness [N/m, N m/rad].
        damping: Recommended damping [N s/m, N m s/rad].
        least_ratio: Least ratio of critical to recommended stiffness over the confidence region.
        target: Ratio that was asked for.
        noise: Root mean square of the residual [m, rad].
        samples: Samples used.
        not_identifiable: What the log does not tell, in words.
        axis: Name of the axis.
        period: Sample period [s].
        source: Name of the log.
        velocity: Velocity estimator of the gains, in words.
    """

    refused: str = ""
    values: Mapping[str, Interval] = field(default_factory=dict)
    ratio: Interval = field(default_factory=lambda: Interval(*[math.nan] * 3))
    stiffness: float = math.nan
    damping: float = math.nan
    least_ratio: float = math.nan
    target: float = math.nan
    noise: float = math.nan
    samples: int = 0
    not_identifiable: Sequence[str] = ()
    axis: str = "z"
    period: float = math.nan
    source: str = ""
    velocity: str = "finite difference"

    def _rows(self) -> Iterator[tuple[str, str, str, str]]:
        for name, one in self.values.items():
            scale, unit = _UNITS[name]
            unit = {"kg": "kg m²"}.get(unit, unit_of(unit, self.axis)) if self.axis.startswith("r") else unit
            yield name, one.number(scale), one.text(scale), unit
        yield "critical over present stiffness", f"{self.ratio.value:.3f}", self.ratio.text(), ""

    def table(self) -> Table:
        """Return device and gains, or the refusal."""
        if self.refused:
            return Table(f"Gains from the log: refused, as {self.refused}", (), ())
        k, b = unit_of("N/m", self.axis), unit_of("N s/m", self.axis)
        gains = f"{number_text(self.stiffness)} {k}, {number_text(self.damping)} {b}"
        title = f"Gains from the log: {gains}, ratio at least {self.target:g} for every device that explains it"
        notes = [
            f"interval: 95 %, all values that raise the squared residual by less than {INTERVAL:.3g} of its mean per "
            f"independent sample; the gains hold up to {REGION:g}. Residual {1e6 * self.noise:.2g} µ"
            f"{unit_of('m', self.axis)} over {self.samples} samples",
            *[f"not identifiable: {text}" for text in self.not_identifiable],
        ]
        return Table(title, ("identified", "value", "95 % interval", "unit"), [*self._rows()], "\n".join(notes))

    def header(self) -> str:
        """Return the gains as a C header for the firmware.

        Raises:
            ParameterError: If the log was refused.
        """
        if self.refused:
            raise ParameterError(f"log must tell the device (got: {self.refused})")
        k, b = (unit_of(unit, self.axis).replace("²", "2") for unit in ("N/m", "N s/m"))
        device = [f"   {name}: {value} {unit} ({interval})" for name, value, interval, unit in self._rows()]
        lines = [
            f"/* Gains from {self.source} by maglev-mj {maglev_mj.__version__}, velocity: {self.velocity}.",
            f"   Critical over this stiffness: at least {self.target:g} for every device that explains the log.",
            "   Identified, with 95 % intervals:",
            *[line.rstrip().replace("²", "2") for line in device],
            "*/",
            "#ifndef MAGLEV_GAINS_H",
            "#define MAGLEV_GAINS_H",
            f"#define MAGLEV_STIFFNESS {self.stiffness!r} /* {k} */",
            f"#define MAGLEV_DAMPING {self.damping!r} /* {b} */",
            f"#define MAGLEV_PERIOD {self.period:.12g} /* s */",
            "#endif",
        ]
        return "\n".join(lines) + "\n"


_UNITS = {
    "mass": (1.0, "kg"),
    "inertia": (1.0, "kg"),
    "delay": (1e3, "ms"),
    "own damping": (1.0, "N s/m"),
    "friction": (1.0, "N"),
}


class _Refused(Exception):
    """Reason why a log does not tell the device."""


class _Identified(NamedTuple):
    """Fit of a log that only the sensor's noise separates from it, with its independent samples and noise."""

    fit: DeviceFit
    best: Points
    independent: float
    noise: float


def gains_from_log(
    motion: LoggedMotion, loop: Loop, seen: Oscillation, *, target: float, stated: Mapping[str, float]
) -> LogGains:  # fmt: skip
    """Return device and gains from the motion under a known law.

    Args:
        motion: The samples.
        loop: Loop of the host's law, whose gains, estimator and period are used.
        seen: The oscillation found in it.
        target: Wanted ratio of critical to recommended stiffness.
        stated: What is stated of inertia, own_damping and quantum, in SI units: own damping is fitted if it is not,
            an inertia that the log contradicts is refused.
    """
    common: dict[str, Any] = {"axis": loop.axis, "period": loop.period, "source": motion.source, "target": target}
    if isinstance(loop.velocity, LowPass):
        common["velocity"] = f"low-pass {loop.velocity.cutoff:g} Hz"
    elif loop.law is not None:
        common["velocity"] = repr(getattr(loop.law, "velocity", loop.law))
    try:
        _check_loop(motion, loop)
        quantum = stated.get("quantum") or _quantum(motion.position)
        identified = _identify(motion, loop, stated.get("own_damping"), quantum)
        return LogGains(**common, **_designed(identified, loop, seen, target, stated.get("inertia")))
    except _Refused as refusal:
        return LogGains(**common, refused=str(refusal))


def _check_loop(motion: LoggedMotion, loop: Loop) -> None:
    """Refuse loops whose device is not the one that the log shows."""
    if loop.hand is not None:
        raise _Refused("a hand holds the device, and gains must hold when it lets go: ring it free")
    if loop.mode is not None:
        raise _Refused("a flexible mode is stated, and the fit is that of a rigid device")
    if loop.device is not None:
        raise _Refused("a law on the device acts beside yours: its commands are not in the log")
    if abs(motion.period / loop.period - 1.0) > 1e-3:
        raise _Refused(
            f"the log has {1.0 / motion.period:.6g} samples a second and the law runs at {1.0 / loop.period:.6g} Hz: "
            "record every sample of the law"
        )


def _quantum(position: Array) -> float:
    """Return the step of the lattice of all positions; 0 for none."""
    values = np.unique(position)
    steps = np.diff(values)
    steps = steps[steps > 1e-9 * (values[-1] - values[0])]
    if not len(steps):
        return 0.0
    step = float(steps.min())
    return step if np.abs(steps / step - np.rint(steps / step)).max() < 0.05 else 0.0


def _commands(motion: LoggedMotion, loop: Loop) -> tuple[Array, float]:
    """Return the forces of the commands (N,), and that before the first; NaN if it is unknown."""
    if motion.command is not None:
        return motion.command, motion.before
    walled = math.isfinite(motion.edge)
    position = motion.position - (motion.edge if walled else motion.position[0])
    law = loop.controller()
    memory = np.linalg.lstsq(np.eye(len(law.advance)) - law.advance, law.take * position[0], rcond=None)[0]
    force = np.zeros(len(position))
    for index, value in enumerate(position):
        force[index] = law.give @ memory + law.direct * value
        memory = law.advance @ memory + law.take * value
    return (np.where(motion.usable, force, 0.0) if walled else force), motion.before


def _identify(motion: LoggedMotion, loop: Loop, own_damping: float | None, quantum: float) -> _Identified:
    """Return the fit of the longest usable run, from the first start at which only the sensor's noise is left."""
    force, before = _commands(motion, loop)
    bounds = np.flatnonzero(np.diff(np.pad(motion.usable.astype(int), 1)))
    first, last = max(zip(bounds[::2], bounds[1::2]), key=lambda run: run[1] - run[0])
    last = min(int(last), int(first) + MOST_SAMPLES)
    turns = reversals(motion.position[first:last])
    if len(turns) <= _HALF_CYCLES:
        raise _Refused(f"it has {max(len(turns) - 1, 0)} half cycles, and five are needed: ring it longer")
    travel = float(np.ptp(motion.position[first : first + turns[-1] + 1]))
    if travel < _COUNTS * quantum:
        raise _Refused(f"it moves by less than {_COUNTS:g} steps of the sensor: ring it with a larger amplitude")
    end = int(first) + turns[-1] + 1
    starts = [int(first), *[int(first) + turn for turn in turns[:-_HALF_CYCLES]]][: _STARTS + _MARGIN]
    refusals: list[_Refused] = []
    for index, start in enumerate(starts[:_STARTS]):
        try:
            identified = _fitted(motion, (start, end), force, before, loop, own_damping, quantum)
            if index == 0:
                return identified
            if index + _MARGIN < len(starts):  # what acted before may still do so a little
                return _fitted(motion, (starts[index + _MARGIN], end), force, before, loop, own_damping, quantum)
        except _Refused as refusal:
            refusals.append(refusal)
    raise refusals[0]


def _fitted(
    motion: LoggedMotion,
    span: tuple[int, int],
    force: Array,
    before: float,
    loop: Loop,
    own: float | None,
    quantum: float,
) -> _Identified:
    """Return the fit from a start to an end, with the commands before it as far as they are known."""
    (start, end), known = span, math.isfinite(before)
    if known or start > LONGEST_DELAY:
        command = np.concatenate([[before], force[:end]]) if known else force[:end]
        return _checked(Ring(motion.position[start:end], command, True, loop.period), loop, own, quantum)
    later = start + LONGEST_DELAY + 1
    identified = _checked(Ring(motion.position[later:end], force[start:end], True, loop.period), loop, own, quantum)
    if start:
        return identified
    with_start = Ring(motion.position[:end], force[:end], False, loop.period)  # a constant command before it
    other = _checked(with_start, loop, own, quantum)
    if float(other.best.squares[0] - identified.best.squares[0]) > _BEFORE * later * identified.noise**2:
        raise _Refused("its first samples are no release: log the release from its first sample")
    return other


def _checked(ring: Ring, loop: Loop, own: float | None, quantum: float) -> _Identified:
    """Return the fit of a ring, or refuse it if its residual is not that of a sensor."""
    travel = float(np.ptp(ring.position))
    fit, best = DeviceFit(ring, own, _EXACT * travel).fitted(reversals(ring.position))
    rest = fit.residual(best)
    noise = max(math.sqrt(float(np.square(rest).mean())), _EXACT * travel)
    count = independent(rest) if noise > 2.0 * _EXACT * travel else float(len(rest))
    if not best.inverse[0] > 0.0:
        raise _Refused("its force pushes the wrong way: check the sign of the gains")
    quarters = [math.sqrt(float(np.square(part).mean())) for part in np.array_split(rest, 4)]
    moved = not is_white(rest) or max(quarters) > _UNSTEADY * min(quarters)
    moved &= noise > max(_STEPS * quantum, 2.0 * _EXACT * travel)
    stiffness, error = fit.spring(best)
    error *= noise * math.sqrt(len(rest) / count)
    if abs(stiffness) > max(_SURE * error, _RELEVANT * loop.stiffness):
        k = unit_of("N/m", loop.axis)
        raise _Refused(
            f"a spring of {stiffness:.3g} ± {2.0 * error:.2g} {k} acts beside the law: a hand, a stop, or a stiffness "
            "other than the stated one"
        )
    size, m = f"{1e6 * noise:.3g}", unit_of("m", loop.axis)
    if moved:
        raise _Refused(
            f"the fit leaves {size} µ{m} that is not sensor noise: another force acts (hand, stop, flexible mode "
            "or saturation), or a gain is not the stated one"
        )
    if noise > max(_MISFIT * float(np.std(ring.position)), quantum):
        raise _Refused(
            f"the fit leaves {size} µ{m}, more than {_MISFIT:.0%} of the motion: ring it with a larger amplitude, and "
            "see that no other force acts"
        )
    return _Identified(fit, best, count, noise)


def _designed(
    identified: _Identified, loop: Loop, seen: Oscillation, target: float, inertia: float | None
) -> dict[str, Any]:
    """Return fields of `LogGains`: intervals, ratio over the region and gains; or refuse a region that is too wide."""
    fit, best, count, noise = identified
    period, rotary = loop.period, loop.axis.startswith("r")
    (mass, *_), near = _bodies(identified, INTERVAL), fit.region(best, INTERVAL, count)
    name = "inertia" if rotary else "mass"
    values = {
        name: Interval(float(1.0 / best.inverse[0]), float(mass.min()), float(mass.max())),
        "delay": _spread(period * near.delay),
        "own damping": _spread(near.rate / period / near.inverse),
    }
    friction, error = fit.friction(near)
    reach = _slack(identified, near, INTERVAL) * error
    unknown = []
    if (friction - reach).min() > 0.0:
        values["friction"] = Interval(
            float(friction[0]), *_spread(np.concatenate([friction - reach, friction + reach]))[1:]
        )
    else:
        unknown.append("friction, which is below the noise")
    body, delay, own = values.values() if len(values) == 3 else [*values.values()][:3]
    if body.high - body.low > 2.0 * _INERTIA * body.value:
        raise _Refused(f"its {name} is between {body.text()} {'kg m²' if rotary else 'kg'}: ring it longer or larger")
    if delay.high - delay.low > 2.0 * _DELAY * period:
        raise _Refused(
            f"its delay is between {delay.text(1e3)} ms and its own damping between {own.text()} "
            f"{unit_of('N s/m', loop.axis)}: state --own-damping, or log the release from its first sample"
        )
    if inertia and not body.low * (1.0 - _OTHER_MASS) <= inertia <= body.high * (1.0 + _OTHER_MASS):
        raise _Refused(
            f"its {name} is {body.text()} {'kg m²' if rotary else 'kg'} and {inertia:.4g} is stated: a hand holds it, "
            "a flexible mode moves, or a stated value is wrong"
        )
    if fit.own_damping is not None:
        del values["own damping"]
    elif own.low <= 0.0:
        unknown.append(f"own damping below {number_text(own.high, 2)} {unit_of('N s/m', loop.axis)}")
    unknown.append("a lag of the drivers, counted as delay")
    if inertia is None:
        unknown.append(f"a hand that adds {name}, counted as the device: state the {name}")
    if fit.own_damping is None:
        unknown.append("a hand that adds damping, counted as the device: state --own-damping")
    mass, delays, dampings = _bodies(identified, REGION)
    around = replace(loop, driver_lag=0.0).array(inertia=mass, delay=delays, own_damping=dampings)
    _check_pole(around, loop, seen)
    present = boundary_of(around, np.full(len(mass), loop.damping)) / loop.stiffness
    stiffness, damping, least = _gains(around, float(body.value / period), target)
    return {
        "values": values, "ratio": Interval(float(present[0]), float(present.min()), float(present.max())),
        "stiffness": stiffness, "damping": damping, "least_ratio": least, "noise": noise,
        "samples": len(fit.ring.position), "not_identifiable": tuple(unknown),
    }  # fmt: skip


def _spread(values: Array) -> Interval:
    """Return the first value, and the ends of all."""
    return Interval(float(values[0]), float(values.min()), float(values.max()))


def _slack(identified: _Identified, points: Points, deviance: float) -> Array:
    """Return by how many standard errors at unit noise a linear value may differ at points of a region, (P,)."""
    fit, best, count, noise = identified
    left = np.maximum(deviance - count * np.log(points.squares / best.squares[0]), 0.0)
    return np.asarray(noise * np.sqrt(left * len(fit.ring.position) / count))


def _bodies(identified: _Identified, deviance: float) -> tuple[Array, Array, Array]:
    """Return masses, delays and own dampings at the ends of a region, (P,) each, the best first."""
    fit, best, count, _ = identified
    found = fit.region(best, deviance, count)
    reach = _slack(identified, found, deviance) * found.error
    inverse = np.concatenate([found.inverse[:1], *(np.maximum(found.inverse + sign * reach, 1e-3 * found.inverse)
                                                    for sign in (-1.0, 1.0))])  # fmt: skip
    delay, rate = (np.concatenate([part[:1], part, part]) for part in (found.delay, found.rate))
    own = rate / fit.ring.period / inverse
    return (
        1.0 / inverse,
        delay * fit.ring.period,
        own if fit.own_damping is None else np.full(len(own), fit.own_damping),
    )


def _check_pole(around: LoopArray, loop: Loop, seen: Oscillation) -> None:
    """Refuse a device that does not ring at the measured frequency."""
    one = around.part(around.shape, 0)
    frequency = one.pole(loop.stiffness, loop.damping)[1]
    if abs(frequency / seen.frequency - 1.0) > _APART:
        raise _Refused(
            f"the fitted device rings at {frequency:.4g} Hz and the log at {seen.frequency:.4g} Hz: another force "
            "acts, or a gain is not the stated one"
        )


def _gains(around: LoopArray, unit: float, target: float) -> tuple[float, float, float]:
    """Return stiffness and damping that reach a ratio in all loops, and the least ratio that they have."""

    def common(dampings: Array) -> Array:
        flat, b, shape = flattened(around, dampings[:, None])
        return np.asarray(first_end(*spans(flat, b, 1.0))[0].reshape(shape).min(axis=1))

    tops = maxima(common, _DAMPINGS * unit, _ERROR_OF_DAMPING)
    damping = _rounded_down(float(tops[np.argmax(common(tops))]))
    critical = float(boundary_of(around, np.full(around.shape, damping)).min())
    stiffness = _rounded_down(critical / target)
    if not stiffness > 0.0:
        raise _Refused("no stiffness is stable for every device that explains it")
    return stiffness, damping, critical / stiffness


def _rounded_down(value: float) -> float:
    """Return a value rounded down to four digits."""
    if not value > 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{math.floor(value / step * (1.0 + 1e-12)) * step:.{_DIGITS}g}")
