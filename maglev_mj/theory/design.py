"""Design of the stiffest wall for ranges of mass and delay, and a set of hands.

The design inverts the stability map.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control import Law, ObserverWall
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.frames import Array
from maglev_mj.parameters import param, param_range, transport_delay
from maglev_mj.plants.hand import get_hand
from maglev_mj.spec import DRIVER_TIME_CONSTANT, MAX_PERIOD, MIN_PERIOD, Spec
from maglev_mj.theory.boundary import first_end, flattened, maxima, ranges_of, spans
from maglev_mj.theory.closed_loop import (
    Design,
    SampledLoop,
    least_dynamic_stiffness,
    rendered_stiffness,
)
from maglev_mj.theory.two_rates import DeviceParameters

LAWS = ("pd", "observer")
"""Names of the wall laws."""
GOALS = ("static", "dynamic")
"""Stiffness to maximise: static, or least dynamic."""

_POLES = (0.0, 0.2, 0.4, 0.6)
_DAMPINGS = np.array([0.0, *np.geomspace(1e-4, 8.0, 60)])
_DENSE = np.array([0.0, *np.geomspace(1e-4, 8.0, 1000)])
_GRID, _RANDOM, _ROUNDS, _MAP, _STARTS, _COARSE = 9, 200, 8, 33, 3, 5
_GOOD, _NEAR = 1e-3, 1e-6
_SINGLE = "period", "hand", "driver_lag", "design", "own_damping", "mode", "device"
_SOFTER = 1.0 - np.array([0.0, 1e-6, 1e-5, 1e-4, 1e-3])


class Case(NamedTuple):
    """One loop of the requirements: mass [kg], delay [s], and the name or numbers of the hand."""

    mass: float
    delay: float
    hand: str

    def __str__(self) -> str:
        return f"{self.mass:.3g} kg, {self.delay * 1e3:.3g} ms, hand {self.hand}"


class WallRequirements(DeviceParameters):
    """Loops in which a wall must be stable: every combination of masses, delays and hands.

    Raises:
        ParameterError: If a value is outside its bounds.

    Example:
        >>> WallRequirements(mass=(0.56, 0.84), hands=["none", "arm"]).nominal
        (0.7, 0.0015)
    """

    period: float = param(
        "sample period", "s", default=1.0 / Spec.control_rate.value, at_least=MIN_PERIOD, at_most=MAX_PERIOD
    )
    mass: tuple[float, float] = param_range(
        "mass",
        "range of the moving mass",
        "kg",
        default=(Spec.moving_mass.value,) * 2,
        at_least=1e-3,
        at_most=1e3,
    )
    delay: tuple[float, float] = param_range(
        "delay", "range of the transport delay", "s", default=(Spec.transport_delay.value,) * 2
    )
    hands: Sequence[str] = param(
        'hands, as names or numbers (see `get_hand`); "none" for a free flotor',
        default=("none",),
        parse=lambda hands: (hands,) if isinstance(hands, str) else tuple(hands),
    )
    driver_lag: bool = param("lag of the current drivers", default=False)
    spectral_radius: float = param(
        "largest spectral radius allowed; 1 for no margin", default=0.97, above=0.0, at_most=1.0
    )

    def check(self) -> None:
        """See `Parameters`."""
        super().check()
        transport_delay(self.delay, self.period)
        if not self.hands or len(set(self.hands)) != len(self.hands):
            raise ParameterError(
                f"hands must be at least one, without duplicates (got {', '.join(self.hands) or 'none'})"
            )
        for hand in self.hands:
            get_hand(hand)

    @property
    def nominal(self) -> tuple[float, float]:
        """Mass and delay at the middle of their ranges, used by the model of an observer."""
        return 0.5 * sum(self.mass), 0.5 * sum(self.delay)

    @property
    def description(self) -> str:
        """One-line summary of the requirements."""
        lag = " with driver lag" if self.driver_lag else ""
        mass, delay = _span(self.mass, 1.0), _span(self.delay, 1e3)
        return f"mass {mass} kg, delay {delay} ms{lag}, hand: {', '.join(self.hands)}{self.described}"

    def grid(self, points: int) -> list[Case]:
        """Return cases on a grid over masses and delays for each hand, corners included."""
        masses, delays = (np.unique(np.linspace(*ends, points)) for ends in (self.mass, self.delay))
        return [Case(float(m), float(d), hand) for m, d, hand in itertools.product(masses, delays, self.hands)]

    def random(self, count: int, seed: int = 0) -> list[Case]:
        """Return random cases, uniform over masses and delays, with the hands in turn."""
        random = np.random.default_rng(seed)
        drawn = zip(random.uniform(*self.mass, count), random.uniform(*self.delay, count))
        return [Case(float(m), float(d), hand) for (m, d), hand in zip(drawn, itertools.cycle(self.hands))]

    def map(self, stiffness: float, damping: float, design: Design | None = None) -> tuple[Array, Array, Array]:
        """Return masses (M,), delays (D,), and the largest spectral radius over the hands (M, D).

        A range of zero width has one value.

        Args:
            stiffness: Gain on the position [N/m].
            damping: Gain on the velocity [N s/m].
            design: Linear controller in place of the PD wall.
        """
        cases = self.grid(_MAP)
        spectral_radii = self.spectral_radii(cases, stiffness, damping, design)
        masses, delays = (np.unique([case[column] for case in cases]) for column in (0, 1))
        return masses, delays, spectral_radii.reshape(masses.size, delays.size, len(self.hands)).max(axis=-1)

    def spectral_radii(
        self, cases: Sequence[Case], stiffness: float, damping: float, design: Design | None = None
    ) -> Array:
        """Return the spectral radius of each case, (C,); see `map`."""
        result = np.zeros(len(cases))
        for index, loop in self.loops(cases, design):
            result[index] = loop.spectral_radius(stiffness, damping)
        return result

    def loops(self, cases: Sequence[Case], design: Design | None) -> list[tuple[Array, SampledLoop]]:
        """Return one loop per hand, of shape (C,), with the indices of its cases."""
        result = []
        for hand in dict.fromkeys(case.hand for case in cases):
            index = np.array([row for row, case in enumerate(cases) if case.hand == hand])
            loop = SampledLoop(
                period=self.period,
                mass=[cases[row].mass for row in index],
                delay=[cases[row].delay for row in index],
                hand=get_hand(hand),
                driver_lag=DRIVER_TIME_CONSTANT if self.driver_lag else 0.0,
                design=design,
                **self.around,
            )
            result.append((index, loop))
        return result


@dataclass(frozen=True, kw_only=True)
class DesignedWall:
    """Stiffest wall for requirements, with its figures.

    Attributes:
        requirements: Requirements met by the wall.
        law: One of `LAWS`.
        stiffness: Gain on the position [N/m].
        damping: Gain on the velocity [N s/m].
        pole: Pole of the observer; None for PD.
        rendered: Static stiffness [N/m]; the gain itself for PD.
        spectral_radius: Largest spectral radius over the requirements.
        worst: Case with the largest spectral radius.
        dynamic_stiffness: Least dynamic stiffness over the requirements [N/m].
        softest: Case with the least dynamic stiffness.
        island: Lower end of the first stable island at this damping in any case [N/m]; None without islands.
    """

    requirements: WallRequirements
    law: str
    stiffness: float
    damping: float
    pole: float | None
    rendered: float
    spectral_radius: float
    worst: Case
    dynamic_stiffness: float
    softest: Case
    island: float | None

    @property
    def design(self) -> Design | None:
        """Closed-loop design for any gains; None for PD."""
        return _design(self.requirements, self.pole)

    def make(self, *, force_limit: float = math.inf) -> Law | None:
        """Return the observer's law along z; None for PD.

        Args:
            force_limit: Force limit of the actuators in the observer's model [N].
        """
        if self.pole is None:
            return None
        gains = {"stiffness": self.stiffness, "damping": self.damping, "force_limit": force_limit}
        return _observer(self.requirements, self.pole, **gains)


class _Gains(NamedTuple):
    stiffness: float
    damping: float
    figure: float


def _observer(requirements: WallRequirements, pole: float, **gains: float) -> ObserverWall:
    mass, delay = requirements.nominal
    return ObserverWall(axes="z", inertia=mass, period=requirements.period, delay=delay, pole=pole, **gains)


def _design(requirements: WallRequirements, pole: float | None) -> Design | None:
    if pole is None:
        return None
    wall = _observer(requirements, pole, stiffness=1.0, damping=1.0)
    return lambda stiffness, damping, period: wall.linear(stiffness, damping)


def _static_stiffness(design: Design | None, period: float, stiffness: Array, damping: Array) -> Array:
    if design is None:
        return stiffness
    return rendered_stiffness(design(stiffness, damping, np.asarray(period)))


def design_wall(
    requirements: WallRequirements, law: str = "pd", *, goal: str = "static", pole: float | None = None
) -> DesignedWall:
    """Return the stiffest wall that meets all requirements.

    In every case the spectral radius is at most the limit, and all softer walls of that damping are stable. The gains
    are designed for the corners and the middle of the ranges. Then the worst case over all combinations is searched (a
    grid, random cases, and decreasing steps from the worst of them); if it exceeds the limit, it is added to the cases
    and the design is repeated. Dampings from 0 to 8 m/T are searched; static stiffness is within 1 % of a dense scan
    over both gains.

    Args:
        requirements: Requirements on the wall.
        law: One of `LAWS`; an observer models the delay, with nominal mass and delay.
        goal: "static" for the largest static stiffness, "dynamic" for the largest least dynamic stiffness.
        pole: Pole of the observer, in [0, 1); None for the best of 0, 0.2, 0.4 and 0.6.

    Raises:
        ParameterError: If a value is outside its bounds, or no wall meets the requirements.

    Example:
        >>> from maglev_mj import WallRequirements, design_wall
        >>> wall = design_wall(WallRequirements(mass=(0.6, 0.8)))
        >>> round(wall.stiffness), round(wall.damping)
        (7725, 74)
    """
    check_one_of("law", LAWS, law)
    check_one_of("goal", GOALS, goal)
    poles: Sequence[float | None] = (None,) if law == "pd" else _POLES if pole is None else (pole,)
    best: tuple[_Gains, float | None] | None = None
    cases = _first_cases(requirements)
    for chosen in poles:
        gains = _robust_gains(requirements, _design(requirements, chosen), goal, cases)
        if gains is not None and (best is None or gains.figure > best[0].figure):
            best = gains, chosen
    if best is None:
        raise ParameterError(
            f"spectral_radius must be above {requirements.spectral_radius:g}: no {law} wall reaches it in every case"
        )
    return _evaluated(requirements, law, *best)


def _first_cases(requirements: WallRequirements) -> list[Case]:
    """Return the corners and the middle of the ranges for each hand."""
    return list(dict.fromkeys([*requirements.grid(2), *(Case(*requirements.nominal, h) for h in requirements.hands)]))


def _robust_gains(requirements: WallRequirements, design: Design | None, goal: str, cases: list[Case]) -> _Gains | None:
    """Return the best gains for all cases, or None. Worse cases are appended to `cases`."""
    best = _Gains(0.0, 0.0, 0.0)
    grid, limit = requirements.grid(_COARSE), requirements.spectral_radius * (1.0 + 1e-9)
    for _ in range(_ROUNDS):
        stiffest = (_stiffest_static if goal == "static" else _stiffest_dynamic)(requirements, design, cases)
        if stiffest is None:
            break
        for share in _SOFTER:  # a crossing of the limit is accurate to 1e-6
            gains = stiffest._replace(stiffness=stiffest.stiffness * share, figure=stiffest.figure * share)
            spectral_radius, case = worst_case(requirements, gains.stiffness, gains.damping, design)
            if not limit < spectral_radius < limit * (1.0 + _NEAR):
                break
        if spectral_radius > limit:
            cases.append(case)
            continue
        if goal == "static":
            return gains
        least = _dynamic_stiffness(requirements, design, grid, np.asarray(gains.stiffness), np.asarray(gains.damping))
        if least.min() > best.figure:
            best = gains._replace(figure=float(least.min()))
        if least.min() >= 0.99 * gains.figure:
            return best
        cases.append(grid[int(np.argmin(least))])
    if best.figure or goal == "static":
        return best if best.figure else None
    static = _robust_gains(requirements, design, "static", cases)
    return None if static is None else static._replace(figure=0.0)


def _common_stiffness(
    requirements: WallRequirements, design: Design | None, cases: Sequence[Case], damping: Array
) -> Array:
    """Return the largest stiffness that meets the limit in all cases at each damping [N/m], (B,); 0 for none."""
    ranges, caps = [], []
    for _, loop in requirements.loops(cases, design):
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


def _stiffest_static(requirements: WallRequirements, design: Design | None, cases: Sequence[Case]) -> _Gains | None:
    """Return the gains of the largest static stiffness; a dense grid is searched only if the coarse one has none."""
    unit = requirements.nominal[0] / requirements.period

    def figure(damping: Array) -> Array:
        stiffness = _common_stiffness(requirements, design, cases, damping)
        return _static_stiffness(design, requirements.period, stiffness, damping) * (stiffness > 0.0)

    for grid in (_DAMPINGS * unit, _DENSE * unit):
        damping = maxima(figure, grid, _GOOD)
        figures = figure(damping)
        best = int(np.argmax(figures))
        if figures[best] > 0.0:
            stiffness = _common_stiffness(requirements, design, cases, damping)
            return _Gains(float(stiffness[best]), float(damping[best]), float(figures[best]))
    return None


def _stiffest_dynamic(requirements: WallRequirements, design: Design | None, cases: Sequence[Case]) -> _Gains | None:
    """Return the gains of the largest least dynamic stiffness, by grids refined around the best points."""

    def search(share: Array, damping: Array) -> tuple[Array, Array]:
        """Return stiffnesses and their figures, (S, B), for fractions of the largest stiffness at each damping."""
        stiffness = share[:, None] * _common_stiffness(requirements, design, cases, damping)
        least = _dynamic_stiffness(requirements, design, cases, stiffness, np.broadcast_to(damping, stiffness.shape))
        return stiffness, least.min(axis=0)

    unit = requirements.nominal[0] / requirements.period
    shares = np.linspace(0.05, 1.0, 20)
    dampings = np.array([0.0, *np.geomspace(1e-3, 0.1, 6, endpoint=False), *np.linspace(0.1, 3.0, 24)]) * unit
    _, coarse = search(shares, dampings)
    most = _Gains(0.0, 0.0, 0.0)
    for _ in range(_STARTS):
        row, column = np.unravel_index(int(coarse.argmax()), coarse.shape)
        coarse[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3] = 0.0  # excluded from the next start
        at, wide = np.array([shares[row], dampings[column]]), np.array([0.1, min(dampings[column], 0.2 * unit)])
        best = 0.0
        for _ in range(6):
            share, damping = (centre + size * np.linspace(-1.0, 1.0, 7) for centre, size in zip(at, wide))
            share, damping = np.clip(share, 0.0, 1.0), np.maximum(damping, 0.0)
            stiffness, least = search(share, damping)
            row, column = np.unravel_index(int(least.argmax()), least.shape)
            if least[row, column] > best:
                at, best = np.array([share[row], damping[column]]), float(least[row, column])
            if best > most.figure:
                most = _Gains(float(stiffness[row, column]), float(damping[column]), best)
            wide *= 0.6
    return most if most.figure > 0.0 else None


def _dynamic_stiffness(
    requirements: WallRequirements, design: Design | None, cases: Sequence[Case], stiffness: Array, damping: Array
) -> Array:
    """Return each case's least dynamic stiffness [N/m], (C, ...); 0 for an unstable loop."""
    result = np.zeros((len(cases), *stiffness.shape))
    for index, loop in requirements.loops(cases, design):
        wide = (slice(None), *(None,) * stiffness.ndim)
        around: Any = {name: getattr(loop, name) for name in _SINGLE}
        around |= {name: np.asarray(getattr(loop, name))[wide] for name in ("mass", "delay")}
        result[index] = least_dynamic_stiffness(stiffness, damping, **around)
    return result


def worst_case(
    requirements: WallRequirements, stiffness: float, damping: float, design: Design | None = None
) -> tuple[float, Case]:
    """Return the largest spectral radius over the requirements, and its case.

    Args:
        requirements: Requirements on the wall.
        stiffness: Gain on the position [N/m].
        damping: Gain on the velocity [N s/m].
        design: Linear controller in place of the PD wall.
    """
    cases = [*requirements.grid(_GRID), *requirements.random(_RANDOM)]
    spectral_radii = requirements.spectral_radii(cases, stiffness, damping, design)
    worst, largest = cases[int(np.argmax(spectral_radii))], float(spectral_radii.max())
    for hand in requirements.hands:  # decreasing steps from the worst case of each hand
        start = max((index for index, case in enumerate(cases) if case.hand == hand), key=lambda at: spectral_radii[at])
        centre, size, spectral_radius = cases[start], 1.0 / _GRID, float(spectral_radii[start])
        for _ in range(12):
            mass, delay = (
                np.unique(np.clip(at + size * (high - low) * np.linspace(-1.0, 1.0, 5), low, high))
                for at, (low, high) in ((centre.mass, requirements.mass), (centre.delay, requirements.delay))
            )
            near = [Case(float(m), float(d), hand) for m, d in itertools.product(mass, delay)]
            around = requirements.spectral_radii(near, stiffness, damping, design)
            if around.max() > spectral_radius:
                centre, spectral_radius = near[int(np.argmax(around))], float(around.max())
            size *= 0.5
        if spectral_radius > largest:
            worst, largest = centre, spectral_radius
    return largest, worst


def _evaluated(requirements: WallRequirements, law: str, gains: _Gains, pole: float | None) -> DesignedWall:
    """Return the designed wall with its figures over all combinations of the requirements."""
    design = _design(requirements, pole)
    spectral_radius, worst = worst_case(requirements, gains.stiffness, gains.damping, design)
    cases = [*requirements.grid(_COARSE), worst]
    k, b = np.asarray(gains.stiffness), np.asarray(gains.damping)
    least = _dynamic_stiffness(requirements, design, cases, k, b)
    islands = [
        low
        for _, loop in requirements.loops(_first_cases(requirements), design)
        for index in range(loop.shape[0])
        for low, _ in ranges_of(loop.part(loop.shape, index), gains.damping)
        if low > gains.stiffness
    ]
    return DesignedWall(
        requirements=requirements,
        law=law,
        stiffness=gains.stiffness,
        damping=gains.damping,
        pole=pole,
        rendered=float(_static_stiffness(design, requirements.period, k, b)),
        spectral_radius=spectral_radius,
        worst=worst,
        dynamic_stiffness=float(least.min()),
        softest=cases[int(np.argmin(least))],
        island=min(islands, default=None),
    )


def _span(ends: tuple[float, float], scale: float) -> str:
    low, high = (f"{end * scale:g}" for end in ends)
    return low if low == high else f"{low} to {high}"
