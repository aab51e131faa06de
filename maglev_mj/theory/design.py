"""Design of the stiffest wall for ranges of mass and delay, and a set of hands.

The design inverts the stability map.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control.stack import alike
from maglev_mj.errors import ParameterError, refuse_mask
from maglev_mj.frames import Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import param, param_range
from maglev_mj.theory.boundary import first_end, flattened, maxima, ranges_of, spans
from maglev_mj.theory.loop import RELATIVE_ROUNDING, Loop
from maglev_mj.theory.loop_array import LoopArray, least_dynamic_stiffness
from maglev_mj.theory.loop_parameters import LoopParameters, device_mass

# -- search of the gains
_COARSE_DAMPINGS = np.array([0.0, *np.geomspace(1e-4, 8.0, 60)])
_DENSE_DAMPINGS = np.array([0.0, *np.geomspace(1e-4, 8.0, 1000)])
"""Dampings [m/T] that are tried first, and where none of them is stable: a range narrower than 1 % may be missed."""
_ERROR_OF_DAMPING = 1e-3
"""Relative error of the best damping; at 0.1 the wall is not the stiffest one (tests/studies/test_design.py)."""
_SHARES_OF_STIFFNESS, _ERROR_OF_LIMIT = 1.0 - np.array([0.0, 1e-6, 1e-5, 1e-4, 1e-3]), 1e-6
"""Shares of the stiffness that are tried while the spectral radius is above the limit by less than its error."""
_MOST_REPEATS = 8
"""Most designs, each with the worst case of the last one added: in 109 random requirements the first one sufficed."""

# -- cases: points along masses and along delays
_POINTS_OF_WORST_CASE, _RANDOM_CASES = 9, 200
"""Points at which the worst case is searched, and random cases between them; steps from the worst of them follow."""
_POINTS_OF_MAP, _POINTS_OF_FIGURES = 33, 5
"""Points of a map, and of the least dynamic stiffness, which is a figure and no requirement."""

_FIELDS_OF_ALL_CASES = "period", "hand", "driver_lag", "velocity", "own_damping", "mode", "device"
_NO_EFFECT = {
    "friction": "a design is of the linear loop",
    "quantum": "the resolution of the sensor is quantize, of the simulated contact",
}


def _names(hands: Any) -> tuple[str, ...]:
    refuse_mask("hand", hands)
    return (hands,) if isinstance(hands, str) else tuple(hands)


@checked
class WallRequirements(LoopParameters):
    """Loops in which a wall must be stable: every combination of masses or moments of inertia, delays and hands.

    Raises:
        ParameterError: If a value is outside its bounds.

    Example:
        >>> WallRequirements(mass=(0.56, 0.84), hand=["none", "arm"]).nominal
        (0.7, 0.0015)
    """

    mass: tuple[float, float] | None = param_range(  # type: ignore[assignment]
        "mass",
        "range of the moving mass",
        "kg",
        default=None,
        derive=lambda needs: (mass := device_mass(needs)) and (mass, mass),
        optional=True,
        at_least=1e-3,
        at_most=1e3,
    )
    inertia: tuple[float, float] | None = param_range(  # type: ignore[assignment]
        "inertia",
        "range of the moment of inertia of a rotary axis, whose units are N m/rad",
        "kg m²",
        default=None,
        at_least=1e-9,
        at_most=1e3,
    )
    delay: tuple[float, float] = param_range(  # type: ignore[assignment]
        "delay", "range of the transport delay", "s", default=None, derive=lambda needs: (needs.hardware.delay,) * 2
    )
    hand: Sequence[str] = param(  # type: ignore[assignment]
        'hands, as names or numbers (see `get_hand`); "none" for a free flotor',
        default=("none",),
        parse=_names,
    )
    spectral_radius: float = param(
        "largest spectral radius allowed; 1 for no margin", default=0.97, above=0.0, at_most=1.0
    )

    def check(self) -> None:
        """See `Parameters`."""
        super().check()
        self.refuse(_NO_EFFECT)
        if not self.hands or len(set(self.hands)) != len(self.hands):
            raise ParameterError(
                f"hand must be at least one, without duplicates (got {', '.join(self.hands) or 'none'})"
            )

    @property
    def hands(self) -> tuple[str, ...]:
        """See `LoopParameters`."""
        return tuple(self.hand)

    @property
    def bodies(self) -> tuple[float, float]:
        """Range of the mass [kg] or of the moment of inertia [kg m²]."""
        found = self.mass if self.inertia is None else self.inertia
        assert found is not None
        return found

    @property
    def nominal(self) -> tuple[float, float]:
        """Mass or moment of inertia, and delay, at the middle of their ranges."""
        return 0.5 * sum(self.bodies), 0.5 * sum(self.delay)

    @property
    def description(self) -> str:
        """One-line summary of the requirements."""
        body, delay = _span(self.bodies, 1.0), _span(self.delay, 1e3)
        name = "inertia" if self.rotary else "mass"
        return f"{name} {body} {self.unit('kg')}, delay {delay} ms, hand: {', '.join(self.hands)}{self.described}"

    def describe(self, case: Loop) -> str:
        """Return mass, delay and hand of a case in words."""
        return f"{case.inertia:.3g} {self.unit('kg')}, {case.delay * 1e3:.3g} ms, hand {self.hand_of(case)}"

    def hand_of(self, case: Loop) -> str:
        """Return the name or numbers of the hand of a case."""
        return next(name for name, loop in self._held.items() if loop.hand == case.hand)

    @cached_property
    def _held(self) -> dict[str, Loop]:
        """Loop in each hand, at the middle of the ranges."""
        body, delay = self.nominal
        return {name: self.loop(inertia=body, delay=delay, hand=self.holding(name)) for name in self.hands}

    def case(self, body: float, delay: float, hand: str) -> Loop:
        """Return the loop of a mass [kg] or moment of inertia [kg m²], a delay [s] and a hand."""
        return replace(self._held[hand], inertia=float(body), delay=float(delay))

    def grid(self, points: int) -> list[Loop]:
        """Return cases on a grid over masses and delays for each hand, corners included."""
        bodies, delays = (np.unique(np.linspace(*ends, points)) for ends in (self.bodies, self.delay))
        return list(itertools.starmap(self.case, itertools.product(bodies, delays, self.hands)))

    def random(self, count: int, seed: int = 0) -> list[Loop]:
        """Return random cases, uniform over masses and delays, with the hands in turn."""
        random = np.random.default_rng(seed)
        drawn = zip(random.uniform(*self.bodies, count), random.uniform(*self.delay, count))
        return [self.case(*pair, hand) for pair, hand in zip(drawn, itertools.cycle(self.hands))]

    def map(self, stiffness: float, damping: float) -> tuple[Array, Array, Array]:
        """Return masses (M,), delays (D,), and the largest spectral radius over the hands (M, D).

        A range of zero width has one value.

        Args:
            stiffness: Gain on the position [N/m].
            damping: Gain on the velocity [N s/m].
        """
        cases = self.grid(_POINTS_OF_MAP)
        spectral_radii = self.spectral_radii(cases, stiffness, damping)
        bodies, delays = (np.unique([getattr(case, name) for case in cases]) for name in ("inertia", "delay"))
        return bodies, delays, spectral_radii.reshape(bodies.size, delays.size, len(self.hands)).max(axis=-1)

    def spectral_radii(self, cases: Sequence[Loop], stiffness: float, damping: float) -> Array:
        """Return the spectral radius of each case, (C,); see `map`."""
        result = np.zeros(len(cases))
        for index, loop in self.loops(cases):
            result[index] = loop.spectral_radius(stiffness, damping)
        return result

    def loops(self, cases: Sequence[Loop]) -> list[tuple[Array, LoopArray]]:
        """Return one loop per hand, of shape (C,), with the indices of its cases."""
        rows = alike((case.hand,) for case in cases)
        values = {name: np.array([getattr(case, name) for case in cases]) for name in ("inertia", "delay")}
        return [
            (np.array(index), cases[index[0]].array(**{name: array[index] for name, array in values.items()}))
            for index in rows.values()
        ]


@dataclass(frozen=True, kw_only=True)
class DesignedWall:
    """Stiffest wall for requirements, with its figures.

    Attributes:
        requirements: Requirements met by the wall.
        stiffness: Gain on the position [N/m].
        damping: Gain on the velocity [N s/m].
        spectral_radius: Largest spectral radius over the requirements.
        worst: Loop with the largest spectral radius.
        dynamic_stiffness: Least dynamic stiffness over the requirements [N/m].
        softest: Loop with the least dynamic stiffness.
        island: Lower end of the first stable island at this damping in any case [N/m]; None without islands.
    """

    requirements: WallRequirements
    stiffness: float
    damping: float
    spectral_radius: float
    worst: Loop
    dynamic_stiffness: float
    softest: Loop
    island: float | None


class _Gains(NamedTuple):
    stiffness: float
    damping: float


@checked
def design_wall(requirements: WallRequirements) -> DesignedWall:
    """Return the stiffest PD wall that meets all requirements.

    In every case the spectral radius is at most the limit, and all softer walls of that damping are stable. The gains
    are designed for the corners and the middle of the ranges. Then the worst case over all combinations is searched (a
    grid, random cases, and decreasing steps from the worst of them); if it exceeds the limit, it is added to the cases
    and the design is repeated. Dampings from 0 to 8 m/T are searched; the stiffness is within 1 % of a dense scan over
    both gains.

    Args:
        requirements: Requirements on the wall.

    Raises:
        ParameterError: If a value is outside its bounds, or no wall meets the requirements.

    Example:
        >>> from maglev_mj import WallRequirements, design_wall
        >>> wall = design_wall(WallRequirements(mass=(0.6, 0.8)))
        >>> round(wall.stiffness), round(wall.damping)
        (7725, 74)
    """
    cases, limit = _first_cases(requirements), requirements.spectral_radius * (1.0 + RELATIVE_ROUNDING)
    for _ in range(_MOST_REPEATS):
        stiffest = _stiffest(requirements, cases)
        if stiffest is None:
            break
        for share in _SHARES_OF_STIFFNESS:  # a crossing of the limit is accurate to 1e-6
            gains = stiffest._replace(stiffness=stiffest.stiffness * share)
            spectral_radius, case = worst_case(requirements, *gains)
            if not limit < spectral_radius < limit * (1.0 + _ERROR_OF_LIMIT):
                break
        if spectral_radius <= limit:
            return _evaluated(requirements, gains, spectral_radius, case)
        cases.append(case)
    raise ParameterError(
        f"spectral_radius must be above {requirements.spectral_radius:g}: no pd wall reaches it in every case"
    )


def _first_cases(requirements: WallRequirements) -> list[Loop]:
    """Return the corners and the middle of the ranges for each hand."""
    return list(dict.fromkeys([*requirements.grid(2), *requirements._held.values()]))


def _common_stiffness(requirements: WallRequirements, cases: Sequence[Loop], damping: Array) -> Array:
    """Return the largest stiffness that meets the limit in all cases at each damping [N/m], (B,); 0 for none."""
    ranges, caps = [], []
    for _, loop in requirements.loops(cases):
        flat, b, shape = flattened(loop, damping[:, None])
        edges, good = spans(flat, b, requirements.spectral_radius)
        ends = np.stack([edges[:, :-1], edges[:, 1:]], axis=-1)
        ranges.append(np.where(good[..., None], ends, np.nan).reshape(*shape, -1, 2))
        stable = (edges, good) if requirements.spectral_radius == 1.0 else spans(flat, b, 1.0)
        caps.append(first_end(*stable)[0].reshape(shape))
    most = np.concatenate(caps, axis=1).min(axis=1)
    width = max(part.shape[2] for part in ranges)
    pads = [((0, 0), (0, 0), (0, width - part.shape[2]), (0, 0)) for part in ranges]
    padded = [np.pad(part, pad, constant_values=np.nan) for part, pad in zip(ranges, pads)]
    low, high = np.moveaxis(np.concatenate(padded, axis=1), -1, 0)
    result = np.zeros(damping.size)
    for row, cap in enumerate(most):
        tops = np.unique(np.minimum(high[row], cap))
        tops = tops[tops > 0.0]
        stable = ((low[row] <= tops[:, None, None]) & (tops[:, None, None] <= high[row])).any(axis=-1).all(axis=-1)
        result[row] = tops[stable].max(initial=0.0)
    return result


def _stiffest(requirements: WallRequirements, cases: Sequence[Loop]) -> _Gains | None:
    """Return the gains of the stiffest wall; a dense grid is searched only if the coarse one has none."""
    unit, figure = requirements.nominal[0] / requirements.period, partial(_common_stiffness, requirements, cases)
    for grid in (_COARSE_DAMPINGS * unit, _DENSE_DAMPINGS * unit):
        damping = maxima(figure, grid, _ERROR_OF_DAMPING)
        stiffness = figure(damping)
        best = int(np.argmax(stiffness))
        if stiffness[best] > 0.0:
            return _Gains(float(stiffness[best]), float(damping[best]))
    return None


def _dynamic_stiffness(
    requirements: WallRequirements, cases: Sequence[Loop], stiffness: Array, damping: Array
) -> Array:
    """Return each case's least dynamic stiffness [N/m], (C, ...); 0 for an unstable loop."""
    result = np.zeros((len(cases), *stiffness.shape))
    for index, loop in requirements.loops(cases):
        wide = (slice(None), *(None,) * stiffness.ndim)
        around: Any = {name: getattr(loop, name) for name in _FIELDS_OF_ALL_CASES}
        around |= {name: np.asarray(getattr(loop, name))[wide] for name in ("mass", "delay")}
        result[index] = least_dynamic_stiffness(stiffness, damping, **around)
    return result


@checked
def worst_case(requirements: WallRequirements, stiffness: float, damping: float) -> tuple[float, Loop]:
    """Return the largest spectral radius over the requirements, and its case.

    Args:
        requirements: Requirements on the wall.
        stiffness: Gain on the position [N/m].
        damping: Gain on the velocity [N s/m].
    """
    cases = [*requirements.grid(_POINTS_OF_WORST_CASE), *requirements.random(_RANDOM_CASES)]
    spectral_radii = requirements.spectral_radii(cases, stiffness, damping)
    worst, largest = cases[int(np.argmax(spectral_radii))], float(spectral_radii.max())
    for hand in requirements.hands:  # decreasing steps from the worst case of each hand
        held = requirements._held[hand].hand
        start = max((index for index, case in enumerate(cases) if case.hand == held), key=lambda at: spectral_radii[at])
        centre, size, spectral_radius = cases[start], 1.0 / _POINTS_OF_WORST_CASE, float(spectral_radii[start])
        for _ in range(12):
            mass, delay = (
                np.unique(np.clip(at + size * (high - low) * np.linspace(-1.0, 1.0, 5), low, high))
                for at, (low, high) in ((centre.inertia, requirements.bodies), (centre.delay, requirements.delay))
            )
            near = [requirements.case(m, d, hand) for m, d in itertools.product(mass, delay)]
            around = requirements.spectral_radii(near, stiffness, damping)
            if around.max() > spectral_radius:
                centre, spectral_radius = near[int(np.argmax(around))], float(around.max())
            size *= 0.5
        if spectral_radius > largest:
            worst, largest = centre, spectral_radius
    return largest, worst


def _evaluated(requirements: WallRequirements, gains: _Gains, spectral_radius: float, worst: Loop) -> DesignedWall:
    """Return the designed wall with its figures over all combinations of the requirements."""
    cases = [*requirements.grid(_POINTS_OF_FIGURES), worst]
    least = _dynamic_stiffness(requirements, cases, np.asarray(gains.stiffness), np.asarray(gains.damping))
    islands = [
        low
        for _, loop in requirements.loops(_first_cases(requirements))
        for index in range(loop.shape[0])
        for low, _ in ranges_of(loop.part(loop.shape, index), gains.damping)
        if low > gains.stiffness
    ]
    softest, worst = (replace(case, **gains._asdict()) for case in (cases[int(np.argmin(least))], worst))
    figures: Any = {"spectral_radius": spectral_radius, "worst": worst, "dynamic_stiffness": float(least.min())}
    return DesignedWall(
        requirements=requirements, **gains._asdict(), **figures, softest=softest, island=min(islands, default=None)
    )


def _span(ends: tuple[float, float], scale: float) -> str:
    low, high = (f"{end * scale:g}" for end in ends)
    return low if low == high else f"{low} to {high}"
