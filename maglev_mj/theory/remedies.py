"""What helps a loop: ranges of damping and sample rate in which it is stable, and ranked remedies.

All are of the law in question, `Loop.in_question`: that of the host, or a wall on the device.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control import FiniteDifference, LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask, unit_of
from maglev_mj.parameters import SAMPLE_PERIOD, loop_delay, number
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, MAX_DELAY, MAX_PERIOD, MIN_PERIOD
from maglev_mj.theory.boundary import StiffestWall, boundary_of, highest_of, rates_beside, stiffest_of
from maglev_mj.theory.loop import RELATIVE_ROUNDING, Bound, Loop, StableRange
from maglev_mj.theory.loop_array import bisect
from maglev_mj.theory.two_rates import DeviceLaw

COSTS = "gains", "timing", "firmware", "mechanics", "feel"
"""Kinds of cost of a remedy, cheapest first: `feel` renders a softer wall."""

MOST_DAMPING = 1e6
"""Largest damping of a law, and of the device itself [N s/m, N m s/rad]."""

# -- search of a range
_VALUES_IN_RANGE = 241
"""Values tried in a range: 50 a decade of damping, 60 of the rate; a narrower stable range is missed."""
_VALUES_AT_ONCE = 24
"""Values tried together to each side of the present one; effort alone."""
_REFINEMENT = 6, 15
"""Steps of a refinement, and values in each: 16 ** -6, or 6e-8, of the interval."""
_VALUES_OF_LEAST = 41
"""Values over four decades in which the least sufficient one is searched, before its refinement."""
_SEARCH_OF_DAMPER = 13, (11, 1)
"""The same of a damper on the device, whose loops are computed one by one: values, and a refinement to 5e-4."""
_MOST_RATIO = 40
"""Largest ratio of two rates in a range: a host of 25 Hz beside the device's default of 1 kHz."""

# -- remedies
_ERROR_OF_BEST_DAMPING = 1e-3
"""Relative error of the best damping of a change: below its three printed digits, as the maximum is flat."""
_DIGITS_PRINTED = 3
"""Digits of a printed gain; a remedy is evaluated as printed."""
_FACTOR_OF_MASS, _CUTOFFS_TRIED = 1.5, (20.0, 200.0)
"""Factor of a heavier flotor, and cutoff frequencies of velocity filters [Hz]: examples, not optima."""
_LEAST_EFFECT = 0.05
"""Relative gain in critical stiffness below which a change of a stable loop counts as without effect."""


class Remedy(NamedTuple):
    """Change that makes a loop stable, or stiffer.

    Attributes:
        words: The change in words.
        change: The change as keywords of `diagnose`.
        critical_stiffness: Critical stiffness with it [N/m, N m/rad].
        ratio: Critical over requested stiffness.
        noise: Force of one sensor step, relative to the present loop; NaN without damping at present.
        cost: One of COSTS.
    """

    words: str
    change: Mapping[str, float]
    critical_stiffness: float
    ratio: float
    noise: float
    cost: str


def critical_of(loop: Loop) -> Bound:
    """Return the critical stiffness of the law in question at its damping; of declared gains, or a law with memory."""
    return critical_of_host(loop.in_question)


def critical_of_host(loop: Loop) -> Bound:
    """Return the critical stiffness of the host's law at its damping, beside a law on the device."""
    array = loop.array()
    found = float(boundary_of(array, np.asarray(loop.damping)))
    return Bound(found, found >= float(highest_of(array)) * (1.0 - RELATIVE_ROUNDING))


def damping_range(loop: Loop) -> StableRange | None:
    """Return the stable dampings nearest to the present one [N s/m, N m s/rad], from 0 to 8 m/T; None for none."""
    own = loop.in_question
    around = own.array()
    values = np.geomspace(1e-4, 8.0, _VALUES_IN_RANGE) * own.inertia / own.period * around.narrowed
    found = _nearest(partial(around.stable, own.stiffness), np.append(0.0, values), own.damping)
    # a damping is not negative: 0 is no end of the search
    return StableRange(Bound(0.0), found.upper) if found is not None and found.lower.beyond else found


def rate_range(loop: Loop, *, in_periods: bool = False) -> StableRange | None:
    """Return the stable sample rates nearest to the present one [Hz]; None for none.

    They are searched from a hundredth to a hundred times the present one; beside a law at another rate, its fractions
    or multiples.

    Args:
        loop: The loop.
        in_periods: True for a delay of the same number of periods, False for the same delay.
    """
    own = loop.in_question
    around, period, delay = own.array(), own.period, own.delay

    def stable(values: Array) -> Mask:
        delays = delay / period / values if in_periods else np.broadcast_to(delay, values.shape)
        return replace(around, period=1.0 / values, delay=delays).stable(own.stiffness, own.damping)

    values = 1.0 / period * np.geomspace(1e-2, 1e2, _VALUES_IN_RANGE)
    if around.mode is not None:
        values = np.unique(np.append(values, rates_beside(around.mode)))
    if around.device is not None:
        ratios = np.arange(1.0, _MOST_RATIO + 1.0)
        values = (1.0 / ratios[::-1] if loop.on_host else ratios) / around.device.period
    slowest = max(1.0 / MAX_PERIOD, delay / period / MAX_DELAY if in_periods else 0.0)
    values = values[(values >= slowest) & (values <= 1.0 / MIN_PERIOD)]
    return _nearest(stable, values, 1.0 / period, refine=around.device is None)


def _nearest(
    stable: Callable[[Array], Mask], values: Array, present: float, *, refine: bool = True
) -> StableRange | None:
    """Return the range of stable values nearest to the present one; None for none.

    Values are tried from the present one outward, as far as is needed.

    Args:
        stable: Function of values, (N,).
        values: Values to try, ascending.
        present: The present value.
        refine: False for values between which there are none.
    """
    count, middle = len(values), int(np.searchsorted(values, present))
    good, tried = np.zeros((2, count), dtype=bool)
    low, high, step, nearest = middle, middle, _VALUES_AT_ONCE, -1
    below = above = np.empty(0, dtype=np.int64)
    while True:
        chosen = np.flatnonzero(~tried[low:high]) + low
        if len(chosen):
            good[chosen], tried[chosen] = stable(values[chosen]), True
        if nearest < 0 and len(places := np.flatnonzero(good)):
            nearest = int(places[np.abs(places - middle).argmin()])
        bad = np.flatnonzero(tried & ~good)
        if nearest >= 0:
            below, above = bad[bad < nearest][-1:], bad[bad > nearest][:1]
        down, up = not below.size and low > 0, not above.size and high < count
        if not (down or up):
            break
        low, high, step = max(low - step * down, 0), min(high + step * up, count), 2 * step
    if nearest < 0:
        return None
    outside = values[np.concatenate([below, above])]
    inside = values[np.concatenate([below + 1, above - 1])]
    refine = refine and bool(outside.size)
    found = bisect(stable, outside, inside, *_REFINEMENT).tolist() if refine else inside.tolist()
    return StableRange(
        Bound(found[0]) if below.size else Bound(float(values[0]), True),
        Bound(found[-1]) if above.size else Bound(float(values[-1]), True),
    )


def has_room(loop: Loop, stable: bool | None, critical: float, target: float) -> bool:
    """Return True for a stable wall that reaches a ratio of critical to requested stiffness."""
    return bool(stable) and critical >= target * loop.in_question.stiffness


def remedies_of(
    loop: Loop, target: float, *, stable: bool, critical: float, best: StiffestWall
) -> tuple[tuple[Remedy, ...], tuple[str, ...]]:
    """Return the changes that help, best first, and those that do not, in words; none if no change is needed.

    Args:
        loop: The loop.
        target: Wanted ratio of critical to requested stiffness.
        stable: Its verdict.
        critical: Its critical stiffness, see `critical_of`.
        best: Stiffest wall of the law in question.
    """
    if has_room(loop, stable, critical, target):
        return (), ()
    found = _Search(loop, target)
    k, b = found.gains
    most, at = float(best.stiffness), float(best.damping)
    tried = [
        *found.by_gains(most, at),
        *found.by_timing(),
        *(found.by_firmware() if loop.on_host else ()),
        *found.by_mechanics(),
    ]
    tried = [one for one in tried if found.allowed(one.change)]
    present = critical / k
    enough = present * (1.0 + _LEAST_EFFECT) if stable else 1.0
    better = [one for one in tried if one.ratio > enough]
    if most and not any(one.ratio >= target for one in better):
        softer, at = _rounded(most / target), _rounded(at)
        change = {found.loop.name("stiffness"): softer, found.loop.name("damping"): at}
        if found.allowed(change):
            words = f"stiffness {softer:g} {found.spring} at {at:g} {found.damper}"
            better.append(found.remedy(words, "feel", **change))
    reached = target * (1.0 - RELATIVE_ROUNDING)
    better.sort(key=lambda one: (one.ratio < reached, COSTS.index(one.cost) * (one.ratio >= reached), -one.ratio))
    useless = [f"{one.words}, ratio {short(one.ratio)}" for one in tried if one not in better]
    half = b + 0.5 * k * loop.in_question.period
    if (ratio := critical_of(found.changed({found.loop.name("damping"): half})) / k) < enough:
        useless.append(f"half-sample prediction, as {half - b:.3g} {found.damper} more: ratio {ratio:.2g}")
    return tuple(better), tuple(useless)


class _Search:
    """Search of remedies of a loop for a wanted ratio of critical to requested stiffness."""

    def __init__(self, loop: Loop, target: float) -> None:
        self.loop, self.own, self.turned = loop, loop.in_question, loop.axis.startswith("r")
        self.around, self.gains = self.own.array(), (self.own.stiffness, self.own.damping)
        self.wanted = target * self.own.stiffness
        self.damper, self.spring = unit_of("N s/m", loop.axis), unit_of("N/m", loop.axis)

    def changed(self, change: Mapping[str, Any]) -> Loop:
        """Return the loop with a change as keywords of `diagnose`."""
        own, law = dict(change), self.loop.device or DeviceLaw()
        beside = {name.removeprefix("device_"): own.pop(name) for name in change if name.startswith("device_")}
        if beside:
            law = replace(law, **beside)
            own["device"] = law if law.stiffness or law.damping else None
        for name in {"mass", "inertia"} & own.keys():
            own["inertia"] = own.pop(name)
        if "cutoff" in own:
            cutoff = own.pop("cutoff")
            own["velocity"] = None if cutoff is None else LowPass(cutoff=cutoff)
        return replace(self.loop, **own)

    def allowed(self, change: Mapping[str, Any]) -> bool:
        """Return False for a change to a value that `diagnose` would refuse."""
        with suppress(ParameterError):
            loop = self.changed(change)
            number("period", loop.period, **SAMPLE_PERIOD)
            loop_delay(loop.delay, loop.period)
            laws = [loop.damping, loop.own_damping, *([loop.device.damping] if loop.device else [])]
            return max(laws) <= MOST_DAMPING
        return False

    def remedy(self, words: str, cost: str, **change: Any) -> Remedy:
        """Return a remedy, evaluated as printed."""
        changed = self.changed(change)
        critical = critical_of(changed)
        noise = _step(changed) / (_step(self.loop) or math.nan)
        return Remedy(words, change, critical, critical / changed.in_question.stiffness, noise, cost)

    def best_damping(self, change: Mapping[str, Any]) -> float:
        """Return the damping of the stiffest wall with a change, as printed; 0 if no wall is stable."""
        return _rounded(float(stiffest_of(self.changed(change).in_question.array(), _ERROR_OF_BEST_DAMPING).damping))

    def by_gains(self, most: float, best: float) -> Iterable[Remedy]:
        """Yield the least damping that reaches the target, or that of the stiffest wall."""
        if not most:
            return
        if most >= self.wanted:
            stable, critical = partial(self.around.stable, self.wanted), partial(boundary_of, self.around)
            best = _rounded(_sufficient(stable, critical, self.wanted, best) or 0.0, up=True)
        else:
            best = _rounded(best)
        yield self.remedy(f"damping {best:g} {self.damper}", "gains", **{self.loop.name("damping"): best})

    def by_timing(self) -> Iterable[Remedy]:
        """Yield a shorter delay and a higher rate, at their best damping."""
        period, delay = self.own.period, self.own.delay
        faster, sooner = {self.loop.name("period"): 0.5 * period}, {self.loop.name("delay"): 0.5 * delay}
        rate = f"{'' if self.loop.on_host else 'device '}rate {2.0 / period:.4g} Hz"
        cases = {rate: faster}
        if delay:
            cases = {
                f"{rate}, delay {_milliseconds(0.5 * delay)}": faster | sooner,
                f"delay {_milliseconds(0.5 * delay)}": sooner,
                f"{rate}, same delay": faster | {self.loop.name("delay"): delay},
            }
        for words, change in cases.items():
            if self.allowed(change):
                damping = self.best_damping(change)
                change = change | {self.loop.name("damping"): damping}
                yield self.remedy(f"{words}, damping {damping:g} {self.damper}", "timing", **change)

    def by_firmware(self) -> Iterable[Remedy]:
        """Yield the whole wall on the device at its best damping, and a damper on the device that suffices."""
        loop, law = self.loop, self.loop.device or DeviceLaw()
        times = {"device_period": loop.period / max(round(loop.period / DEVICE_PERIOD), 1)}
        times["device_delay"] = DEVICE_DELAY if loop.delay > DEVICE_DELAY else loop.delay
        if not self.allowed(times):
            return
        where = f"on the device ({1.0 / times['device_period']:.4g} Hz, {_milliseconds(times['device_delay'])})"
        moved = times | {"stiffness": 0.0, "damping": 0.0, "device_stiffness": loop.total[0]}
        damping = self.best_damping(moved)
        moved |= {"device_damping": damping}
        yield self.remedy(f"whole wall {where}, damping {damping:g} {self.damper}", "firmware", **moved)
        law = replace(law, damping=0.0, period=times["device_period"], delay=times["device_delay"])

        def stable(values: Array) -> Mask:
            loops = [replace(self.around, device=replace(law, damping=value)) for value in values.tolist()]
            return np.array([bool(one.stable(self.wanted, loop.damping)) for one in loops])

        enough = _least(stable, loop.inertia / times["device_period"], *_SEARCH_OF_DAMPER)
        if enough is not None:
            damping = _rounded(enough, up=True)
            words = f"damper of {damping:g} {self.damper} {where}, inside the wall"
            yield self.remedy(words, "firmware", **times, device_damping=damping)

    def by_mechanics(self) -> Iterable[Remedy]:
        """Yield more mass, a damper on the device, and another velocity filter."""
        loop, name = self.loop, "inertia" if self.turned else "mass"
        yield self.remedy(f"{name} x {_FACTOR_OF_MASS:g}", "mechanics", **{name: _FACTOR_OF_MASS * loop.inertia})

        def critical(added: Array) -> Array:
            return boundary_of(replace(self.around, own_damping=loop.own_damping + added), np.asarray(self.gains[1]))

        most = 4.0 * loop.inertia / self.own.period
        enough = _sufficient(partial(_damped, loop, self.wanted), critical, self.wanted, most)
        if enough is not None:
            added = _rounded(enough, up=True)
            words = f"mechanical damper of {added:g} {self.damper}"
            yield self.remedy(words, "mechanics", own_damping=loop.own_damping + added)
        velocity = loop.velocity or FiniteDifference()
        if loop.law is not None or not loop.on_host or not isinstance(velocity, FiniteDifference | LowPass):
            return
        filtered = isinstance(velocity, LowPass)
        cutoffs = (
            {"no velocity filter": None} if filtered else {f"velocity filter of {f:g} Hz": f for f in _CUTOFFS_TRIED}
        )
        for words, cutoff in cutoffs.items():
            yield self.remedy(words, "gains", cutoff=cutoff)


def hidden_amplitude(loop: Loop, friction: float) -> float:
    """Return the amplitude below which Coulomb friction ends an oscillation, 4 f/(pi w b) [m, rad]; NaN for none.

    b is the damping of the device's own that would bring the loop to its boundary, w its frequency there: a describing
    function, within 5 % in simulation.

    Args:
        loop: The loop.
        friction: The friction f [N, N m].
    """
    own = loop.in_question
    needed = _least(partial(_damped, loop, own.stiffness), 4.0 * loop.inertia / own.period)
    if not needed:
        return math.nan
    damped = replace(own, own_damping=loop.own_damping + needed).array()
    _, frequency = damped.pole(own.stiffness, own.damping)
    return 4.0 * friction / (math.pi * 2.0 * math.pi * frequency * needed) if frequency else math.nan


def _damped(loop: Loop, stiffness: float, added: Array) -> Mask:
    """Return whether a stiffness is stable with more damping of the device's own, (N,)."""
    own = loop.in_question
    return own.array(own_damping=loop.own_damping + added).stable(stiffness, own.damping)


def _step(loop: Loop) -> float:
    """Return the force by a unit step of the position sensor through the velocity [N/m]."""
    return max(loop.damping / loop.period, loop.device.damping / loop.device.period if loop.device else 0.0)


def _rounded(value: float, *, up: bool = False) -> float:
    """Return a value with the digits that are printed, so that obeying the print gives the printed result."""
    if not value:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - _DIGITS_PRINTED + 1)
    return float(f"{(math.ceil(value / step) if up else round(value / step)) * step:.12g}")


def _least(
    stable: Callable[[Array], Mask],
    most: float,
    values: int = _VALUES_OF_LEAST,
    refinement: tuple[int, int] = _REFINEMENT,
) -> float | None:
    """Return the least value up to `most` at which a loop is stable; None without one.

    Args:
        stable: Function of values, (N,).
        most: Largest value.
        values: Values tried, over four decades.
        refinement: Steps of the refinement, and values in each.
    """
    if not most:
        return None
    grid = np.array([0.0, *np.geomspace(1e-4 * most, most, values)])
    good = stable(grid)
    if not good.any():
        return None
    index = int(np.argmax(good))
    if not index:
        return 0.0
    ends = grid[[index - 1]], grid[[index]]
    return float(bisect(stable, *ends, *refinement)[0])


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
    if enough is None or critical(np.array([_rounded(enough, up=True)]))[0] >= wanted * (1.0 - RELATIVE_ROUNDING):
        return enough  # the softer ones are stable too, unless a law with memory is stable in a band alone
    return _least(lambda values: critical(values) >= wanted, most)


def short(value: float) -> str:
    """Return two digits of a number, or all of a large one."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"


def _milliseconds(value: float) -> str:
    return f"{1e3 * value:.4g} ms"
