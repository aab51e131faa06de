"""Loop that explains a recorded oscillation: the stated loop first, then values that are not stated."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.plants.hand import Hand
from maglev_mj.studies.oscillation import Oscillation
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.two_rates import rates_of

_PAIRS = ("inertia", "delay"), ("own_damping", "delay"), ("inertia", "own_damping")
_FIELDS = "inertia", "delay", "own_damping"
_AGREES = 0.05  # largest change of a stated value that is put down to noise
_CLOSE, _SURE = 0.003, 5.0  # distance of two poles: relative, in standard errors
_SPREAD, _FINEST = 2.0, 1e-4  # half an interval: in standard errors, and the least that is printed, relative
_LONGEST, _STARTS = 10, 4  # periods of delay searched, and starts in each
_STEPS, _SHIFT, _DAMPED, _STILL, _SAME = 25, 1e-6, 1e-5, 1e-3, 0.01
_LIMITS = {"inertia": (1e-4, 1e4), "delay": (0.0, _LONGEST - _SHIFT), "own_damping": (0.0, 10.0)}  # in their scales
_ALIASES = 4  # multiples of the log's rate

Complex: TypeAlias = NDArray[np.complex128]


class _Explained(NamedTuple):
    """Loop that has a measured pole.

    Attributes:
        loop: The loop.
        oscillation: The oscillation; its frequency is that of the loop if the log shows an alias of it.
        remarks: What was measured, given and fitted, in words.
        assumptions: What was assumed.
    """

    loop: Loop
    oscillation: Oscillation
    remarks: tuple[str, ...]
    assumptions: tuple[str, ...]


class _Candidate(NamedTuple):
    """Loop, its largest relative change of a stated value, that by noise, and half widths of intervals."""

    loop: Loop
    change: float
    noise: float
    errors: Mapping[str, float]


def explain(seen: Oscillation, loop: Loop, given: Collection[str], assumptions: tuple[str, ...] = ()) -> _Explained:
    """Return the loop whose dominant pole is the measured one: as stated, else with what is not stated fitted.

    Args:
        seen: The oscillation.
        loop: The loop; values that are not stated are ignored.
        given: Which of inertia, delay and own_damping are stated.
        assumptions: What was assumed before.

    Raises:
        ParameterError: If no such loop has it.
    """
    if {"inertia", "delay"} <= {*given}:
        own = _rate(loop)
        for alias in _aliases(seen, 1.0 / loop.period):
            if abs(own - _target(alias)) <= _tolerance(alias):
                seen_as = f", which a log at {seen.rate:.6g} Hz shows at {seen.frequency:.4g} Hz" * (alias != seen)
                return _Explained(loop, alias, (f"the loop as given explains the oscillation{seen_as}",), assumptions)
    if loop.period * seen.rate < 0.98:
        assumptions += (f"a frequency below half the log's rate, {0.5 * seen.rate:.6g} Hz",)
    start = loop if "own_damping" in given else replace(loop, own_damping=0.0)
    pairs = _PAIRS[:1] if "own_damping" in given else [x for x in _PAIRS if {*_PAIRS[0]} <= {*x, *given}]
    tried: dict[tuple[str, str], list[_Candidate]] = {}
    for loose in (False, True):  # what is stated is exact, or else rounded
        for pair in pairs:
            candidates = tried[pair] if loose else _candidates(seen, start, pair, given)
            tried[pair] = candidates
            if close := [one for one in candidates if one.change <= (_AGREES if loose else one.noise)]:
                others = close[1:] + tried[_PAIRS[0]] * (pair != _PAIRS[0])  # without own damping, too
                return _fitted(seen, start, pair, given, [close[0], *others], assumptions)
    raise ParameterError(_refusal(seen, loop, given, tried[_PAIRS[0]], assumptions))


def _fitted(
    seen: Oscillation,
    loop: Loop,
    pair: tuple[str, str],
    given: Collection[str],
    candidates: list[_Candidate],
    assumptions: tuple[str, ...],
) -> _Explained:
    """Return the best candidate with the stated values as stated, and what it rests on, in words."""
    best, *others = candidates
    free = [name for name in pair if name not in given]
    kept = [name for name in _FIELDS if name in given]
    remarks = [f"given: {_values(loop, kept)}"] if kept else []
    remarks.append(f"fitted: {_values(best.loop, free, best.errors)}" if free else "consistent with what is given")
    remarks += [f"not determined: {_values(one.loop, _FIELDS)} explains it, too" for one in others]
    if "own_damping" not in (*pair, *given):
        assumptions += ("no damping of the device's own",)
    fitted = replace(loop, **{name: getattr(best.loop, name) for name in free})
    return _Explained(fitted, seen, tuple(remarks), assumptions)


def _refusal(
    seen: Oscillation, loop: Loop, given: Collection[str], tried: list[_Candidate], assumptions: tuple[str, ...]
) -> str:
    """Return the message for an oscillation that the stated values contradict."""
    measured = f"measured {_motion(_target(seen))}"
    if {"inertia", "delay"} <= {*given}:
        measured += f", this loop {_motion(_rate(loop))}"
    rest = f"; assumed: {'; '.join(assumptions)}" * bool(assumptions)
    if tried:
        best = tried[0]
        wrong = [name for name in _PAIRS[0] if name in given and _change(name, best.loop, loop) > _AGREES]
        words = " and ".join(_word(name, loop) for name in wrong)
        return (
            f"{words} must be consistent with the oscillation (got {_values(loop, wrong)}, but "
            f"{_values(best.loop, _PAIRS[0])} explains it; {measured}): correct or leave out what is uncertain{rest}"
        )
    free = "" if "own_damping" in given else " without damping of the device's own"
    what = f"; given: {_values(loop, [name for name in _FIELDS if name in given])}" * bool(given)
    return (
        f"no {_word('inertia', loop)} and delay up to {_LONGEST} periods{free} explain the oscillation with these "
        f"gains ({measured}{what}{rest}): check the gains, the rate of the loop, and state hand, mode or filter"
    )


def _is_rotary(loop: Loop) -> bool:
    return AXES.index(loop.axis) > 2


def _word(name: str, loop: Loop) -> str:
    return {"inertia": "inertia" if _is_rotary(loop) else "mass", "own_damping": "own damping"}.get(name, name)


def _values(loop: Loop, names: Iterable[str], errors: Mapping[str, float] | None = None) -> str:
    """Return values in words, with the half widths of their intervals."""
    units = {"inertia": "kg m²" if _is_rotary(loop) else "kg", "own_damping": unit_of("N s/m", loop.axis)}
    texts = []
    for name in names:
        factor = 1e3 if name == "delay" else 1.0
        value, error = factor * getattr(loop, name), factor * (errors or {}).get(name, 0.0)
        number = f"{value:.4g}"
        if 0.0 < error < math.inf:
            error = max(error, _FINEST * value)
            number = f"{round(value, -math.floor(math.log10(error))):.10g} ± {error:.1g}"
        texts.append(f"{_word(name, loop)} {number} {units.get(name, 'ms')}")
    return ", ".join(texts)


def _motion(rate: complex) -> str:
    """Return frequency and growth in a cycle of a complex rate [1/s], in words."""
    frequency = rate.imag / (2.0 * math.pi)
    if not frequency:
        return "without oscillation"
    factor = math.exp(min(abs(rate.real) / frequency, 700.0))
    return f"{frequency:.4g} Hz, {'growing' if rate.real > 0.0 else 'decaying'} by a factor {factor:.3g} in a cycle"


def _target(seen: Oscillation) -> complex:
    """Return growth and angular frequency as a complex rate [1/s]."""
    return complex(seen.growth, 2.0 * math.pi * seen.frequency)


def _tolerance(seen: Oscillation) -> float:
    return _SURE * seen.error + _CLOSE * abs(_target(seen))


def _rate(loop: Loop) -> complex:
    """Return the complex rate of the dominant pole [1/s]."""
    radius, frequency = loop.array().pole(loop.stiffness, loop.damping)
    return complex(math.log(max(radius, 1e-300)) / loop.period, 2.0 * math.pi * frequency)


def _aliases(seen: Oscillation, rate: float) -> list[Oscillation]:
    """Return the oscillations below half a rate that a log shows alike, the lowest first."""
    around = [seen.frequency, *(n * seen.rate + s * seen.frequency for n in range(1, _ALIASES) for s in (-1.0, 1.0))]
    inside = [f for f in around if f == seen.frequency or f <= 0.5 * rate]
    return [seen._replace(frequency=f, period=1.0 / f) for f in inside]


def _least(name: str, stated: Loop) -> float:
    """Return a stated inertia or delay, or half a period if the delay is shorter."""
    return max(stated.delay, 0.5 * stated.period) if name == "delay" else stated.inertia


def _change(name: str, loop: Loop, stated: Loop) -> float:
    """Return the relative change of a stated inertia or delay."""
    return float(abs(getattr(loop, name) - getattr(stated, name)) / _least(name, stated))


def _candidates(seen: Oscillation, loop: Loop, pair: tuple[str, str], given: Collection[str]) -> list[_Candidate]:
    """Return the loops with the measured dominant pole, the closest to the stated values first."""
    z, found = complex(np.exp(_target(seen) * loop.period)), list[_Candidate]()
    body = loop.inertia if "inertia" in given else _body(loop, z)
    about = replace(loop, inertia=body)
    for values in _roots(about, pair, z, _starts(about, pair, z)):
        one = replace(loop, **values)  # type: ignore[arg-type]
        if abs(_rate(one) - _target(seen)) <= _tolerance(seen):
            errors = _errors(one, pair, z, seen.error)
            kept = [name for name in pair if name in given]
            noise = max((errors[name] / _least(name, loop) for name in kept), default=0.0)
            change = max((_change(name, one, loop) for name in kept), default=0.0)
            found.append(_Candidate(one, change, _CLOSE + _SURE / _SPREAD * noise, errors))
    return sorted(found, key=lambda one: (one.change, one.loop.delay))


def _body(loop: Loop, z: complex) -> float:
    """Return the inertia that balances the stiffness at a pole: a scale."""
    return float(loop.stiffness / abs(np.log(z) / loop.period) ** 2)


def _starts(loop: Loop, pair: tuple[str, str], z: complex) -> list[dict[str, float]]:
    """Return values from which to search: a device law at another rate acts as hand and damper at first."""
    if loop.device is not None:
        law, hand = loop.device, loop.hand
        plain = replace(loop, device=None, own_damping=loop.own_damping + law.damping)
        if hand is None or not hand.soft:
            mass, damping, stiffness = (0.0, 0.0, 0.0) if hand is None else (float(x) for x in hand.values[:3])
            plain = replace(plain, hand=Hand(mass=mass, damping=damping, stiffness=stiffness + law.stiffness))
        near = _roots(plain, pair, z, _starts(plain, pair, z))
        return [one | {"own_damping": max(one["own_damping"] - law.damping, 0.0)} for one in near]
    delays = (np.arange(_LONGEST * _STARTS) + 0.5) * loop.period / _STARTS if "delay" in pair else [loop.delay]
    values = {"inertia": np.full(len(delays), loop.inertia), "delay": np.array(delays)}
    values["own_damping"] = np.full(len(delays), loop.own_damping)
    if "inertia" in pair:  # the gap is all but linear in it
        gap = _gap(loop, z, values)
        slope = _gap(loop, z, values | {"inertia": 2.0 * values["inertia"]}) - gap
        with np.errstate(all="ignore"):
            best = 1.0 - (slope.conj() * gap).real / np.abs(slope) ** 2
        values["inertia"] *= np.clip(np.nan_to_num(best, nan=1.0), 0.05, 20.0)
    return [dict(zip(values, row)) for row in np.transpose([*values.values()]).tolist()]


def _scales(loop: Loop) -> dict[str, float]:
    return {"inertia": loop.inertia, "delay": loop.period, "own_damping": loop.inertia / loop.period}


def _gap(loop: Loop, z: complex, values: Mapping[str, Array]) -> Complex:
    """Return the force of an impulse over the position that it leaves at z, (N,): 0 at a pole, smooth in all values."""
    around = loop.array(**values)
    matrix = around.matrix(loop.stiffness, loop.damping)
    host = 1 if loop.device is None else rates_of(loop.period, loop.device).host
    rest = z**host * np.eye(matrix.shape[-1]) - matrix
    minor = np.delete(np.delete(rest, 1, axis=-2), 0, axis=-1)
    with np.errstate(all="ignore"):
        return np.asarray(values["inertia"] / loop.inertia * np.linalg.det(rest) / np.linalg.det(minor))


def _slopes(loop: Loop, pair: tuple[str, str], z: complex, values: dict[str, Array]) -> tuple[Complex, list[Complex]]:
    """Return the gap, and its slopes by the two values in their scales."""
    scales, gap = _scales(loop), _gap(loop, z, values)
    shifted = [{**values, name: values[name] + _SHIFT * scales[name]} for name in pair]
    return gap, [(_gap(loop, z, one) - gap) / _SHIFT for one in shifted]


def _roots(loop: Loop, pair: tuple[str, str], z: complex, starts: list[dict[str, float]]) -> list[dict[str, float]]:
    """Return the values at which z is a pole, or all but one, each once: least squares, damped along valleys."""
    if not starts:
        return []
    scales = _scales(loop)
    values = {name: np.array([start[name] for start in starts]) for name in _FIELDS}
    for _ in range(_STEPS):
        gap, slopes = _slopes(loop, pair, z, values)
        here = np.array([values[name] / scales[name] for name in pair])
        low, high = np.transpose([_LIMITS[name] for name in pair])[..., None]
        most = np.array(
            [np.full(len(gap), 1.0) if name == "delay" else np.maximum(0.5 * x, 0.1) for name, x in zip(pair, here)]
        )
        steps = _least_squares(gap, *slopes)
        pinned = (here <= low) & (steps < 0.0)  # then the other one alone
        alone = np.array([-(slope.conj() * gap).real / np.abs(slope) ** 2 for slope in slopes])
        steps = np.clip(np.nan_to_num(np.where(pinned[::-1], alone, steps)), -most, most)
        new = np.clip(here + steps, low, high)
        values |= {name: x * scales[name] for name, x in zip(pair, new)}
    still = np.abs(new - here).max(axis=0) < _STILL
    rows = np.array([values[name] / scales[name] for name in _FIELDS]).T
    kept = [row for row in np.argsort(np.abs(gap)) if still[row] and np.isfinite(rows[row]).all()]
    kept = [row for at, row in enumerate(kept) if all(np.abs(rows[row] - rows[x]).max() > _SAME for x in kept[:at])]
    return [{name: float(values[name][row]) for name in _FIELDS} for row in kept]


def _least_squares(gap: Complex, first: Complex, second: Complex) -> Array:
    """Return the steps of two values that bring the gap to 0, (2, N), damped where their slopes are parallel."""
    both = (first.conj() * second).real
    squares = [np.abs(slope) ** 2 * (1.0 + _DAMPED) for slope in (first, second)]
    sides = [-(slope.conj() * gap).real for slope in (first, second)]
    with np.errstate(all="ignore"):
        size = squares[0] * squares[1] - both**2
        return np.array([squares[1] * sides[0] - both * sides[1], squares[0] * sides[1] - both * sides[0]]) / size


def _errors(loop: Loop, pair: tuple[str, str], z: complex, error: float) -> dict[str, float]:
    """Return the half widths of the intervals of two values by that of growth and frequency [1/s]."""
    values: dict[str, Any] = {name: np.array([getattr(loop, name)]) for name in _FIELDS}
    gap, (first, second) = _slopes(loop, pair, z, values)
    by_z = (_gap(loop, z * (1.0 + _SHIFT), values) - gap) / _SHIFT
    parts = np.array([by_z, 1j * by_z]) * error * loop.period * _SPREAD
    with np.errstate(all="ignore"):
        moved = np.array([-second.conj() * parts, first.conj() * parts]).imag / (second.conj() * first).imag
    scales = _scales(loop)
    return {name: float(np.hypot(*part[:, 0])) * scales[name] for name, part in zip(pair, moved)}
