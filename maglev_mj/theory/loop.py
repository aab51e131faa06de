"""One description of a rendered loop: all that enters a verdict on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import LinearController, LowPass, VelocityEstimator
from maglev_mj.control.stack import alike, computed_together
from maglev_mj.control.timeline import split_delay
from maglev_mj.frames import AXES, Array, Mask
from maglev_mj.lazy import loaded
from maglev_mj.plants.hand import Hand, Mode
from maglev_mj.result import number_text
from maglev_mj.spec import MAX_DELAY, MAX_DELAY_PERIODS
from maglev_mj.theory.delay import AnyCutOf, first_delays, stable_intervals
from maglev_mj.theory.linearise import INTEGRATOR_POLE, Linearised, StateSpace
from maglev_mj.theory.loop_array import LONG, LOOPS, LinearisedLaw, LoopArray, critical_delay_of, pd, sampled_fields
from maglev_mj.theory.two_rates import DeviceLaw, rates_of

RELATIVE_ROUNDING = 1e-9
"""Relative difference of spectral radii, stiffnesses or shares that is rounding.

It is above the error of an eigenvalue, and moves no printed digit.
"""
_ERROR_OF_AFFINE_LAW = 1e-6
"""Largest error of an affine law, relative to its largest response: extrapolated from two gains to a third one."""
_SAMPLES_OF_RESPONSE = 64
"""Length of the impulse response of declared gains [samples], from which a filter is realised: twice its states do."""
_DEFECTIVE_VECTORS = 1e8
"""Condition number of eigenvectors that do not separate poles, as of a double integrator: half of the digits lost."""
STILL = 1e-6
"""Static stiffness that counts as zero, relative to the response: a difference of forces that cancel."""
_DOUBLE_POLE = 1e-8
"""Distance from 1 of the mean of a double pole: each is accurate to half of the digits, their mean to nearly all."""


class Bound(float):
    """Value at which stability changes, or, if `beyond`, the end of a search without a change: more than that.

    0 if it is unstable from the start. `largest_gain` is the largest loop gain where it is below 1 at every frequency,
    which proves that any delay is stable; None without such a proof.
    """

    beyond: bool
    largest_gain: float | None

    def __new__(cls, value: float, beyond: bool = False, largest_gain: float | None = None) -> Bound:
        """Return the bound."""
        self = super().__new__(cls, value)
        self.beyond, self.largest_gain = beyond and not math.isnan(value), largest_gain
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the parts of a pickle."""
        return type(self), (float(self), self.beyond, self.largest_gain)

    @property
    def proved(self) -> bool:
        """True if any delay is stable."""
        return self.largest_gain is not None

    @classmethod
    def least(cls, bounds: Iterable[Bound]) -> Bound:
        """Return the smallest of some bounds; NaN if there is one."""
        return min(bounds, key=lambda one: (-math.inf if math.isnan(one) else float(one), one.beyond, one._rank))

    @property
    def _rank(self) -> float:
        return 0.0 if self.largest_gain is None else 2.0 - self.largest_gain

    def as_json(self) -> float | dict[str, float | bool]:
        """Return the value, or it as `more_than`, or `any` with the largest gain."""
        if self.largest_gain is not None:
            return {"any": True, "largest_gain": self.largest_gain}
        return {"more_than": float(self)} if self.beyond else float(self)

    def text(self, unit: str, scale: float = 1.0) -> str:
        """Return the bound in words."""
        if self.largest_gain is not None:
            return f"any (proved: largest loop gain {self.largest_gain:.3g})"
        return f"{'more than' if self.beyond else 'up to'} {scale * self:.4g} {unit}"


class StableRange(NamedTuple):
    """Range of values in which a loop is stable.

    Attributes:
        lower: Lower end; where it is `beyond`, the search ended there, and less may be stable.
        upper: Upper end.
    """

    lower: Bound
    upper: Bound

    def as_json(self) -> list[Any]:
        """Return both ends, an end of the search as `less_than` or `more_than`."""
        lower = {"less_than": float(self.lower)} if self.lower.beyond else self.lower.as_json()
        return [lower, self.upper.as_json()]

    def text(self, unit: str) -> str:
        """Return the range in words."""
        if math.isnan(self.lower):
            return "-"
        low, high = map(number_text, self)
        if self.upper.beyond and self.lower.beyond:
            return f"no limit found from {low} to {high} {unit}"
        if self.upper.beyond:
            return f"from {low} {unit} (searched to {high} {unit})"
        if self.lower.beyond:
            return f"up to {high} {unit} (searched from {low} {unit})"
        return f"{low} to {high} {unit}" if self.lower else f"up to {high} {unit}"


class StableDelays(NamedTuple):
    """All stable delays of a loop.

    Attributes:
        intervals: Lower and upper end of each interval [s]; the last may be the end of the search.
        searched_to: End of the search [s].
        largest_gain: See `Bound`.
    """

    intervals: tuple[tuple[float, float], ...]
    searched_to: float
    largest_gain: float | None = None

    @property
    def bound(self) -> Bound:
        """Critical delay."""
        if math.isnan(self.searched_to):
            return Bound(math.nan)
        first = self.intervals[0] if self.intervals else (1.0, 0.0)
        if first[0] > 0.0:
            return Bound(0.0)
        return Bound(first[1], first[1] >= self.searched_to, self.largest_gain)

    @property
    def text(self) -> str:
        """The intervals in words; "-" if they were not computed."""
        if math.isnan(self.searched_to):
            return "-"
        later = [(low, high) for low, high in self.intervals if low > 0.0]
        open_end = bool(later) and later[-1][1] >= self.searched_to
        words = [f"from {1e3 * low:.4g} to {1e3 * high:.4g} ms" for low, high in later[: len(later) - open_end]]
        if open_end:
            words.append(f"from {1e3 * later[-1][0]:.4g} ms (searched to {1e3 * self.searched_to:.4g} ms)")
        words = [self.bound.text("ms", 1e3)] * bool(self.bound) + words
        ranges = " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
        return ", stable ".join(["unstable without delay"] * (not self.bound) + [ranges] * bool(ranges))


class Doubt(NamedTuple):
    """What the probes of one axis found.

    Attributes:
        valid_to: Speed up to which the laws are linear [m/s, rad/s], as a displacement in one sample.
        reason: Reason not to judge the axis; empty for none.
        void: True if the linearisation describes the laws not even for small motion.
        rests: Positions at which the laws carry the load, where they were probed [m, rad].
        position: Position at which they were probed [m, rad].
        depth: Depth of the motion there [m, rad].
        resolution: Resolution of laws in fixed point [m, rad]; 0 for others.
    """

    valid_to: Bound
    reason: str = ""
    void: bool = False
    rests: tuple[float, ...] = ()
    position: float = 0.0
    depth: float = 0.0
    resolution: float = 0.0


class AtPose(NamedTuple):
    """Laws linearised at a pose, on coupled axes.

    Attributes:
        near: The linearisation.
        axes: Indices of the axes.
        scaled: Its dimensionless impulse response, (M, n, n).
        settles: True if the response decays.
        system: Dimensionless state space; None without a low-order realisation of a long response.
        still: Number of directions without stiffness.
        moments: Sums of the response and of age times response, dimensionless.
        unstable_equilibrium: True for negative stiffness.
    """

    near: Linearised
    axes: tuple[int, ...]
    scaled: Array
    settles: bool
    system: StateSpace | None
    still: int
    moments: tuple[Array, Array]
    unstable_equilibrium: bool

    def gains(self, body: Array) -> tuple[Array, Array]:
        """Return stiffness and damping without integral action, (6, 6) each, from mass and moments of inertia (6,)."""
        block, root = np.ix_(self.axes, self.axes), np.sqrt(body[list(self.axes)])
        stiffness, damping = self.near.stiffness.copy(), self.near.damping.copy()
        size, (static, ages) = np.outer(root, root) / self.near.period**2, self.moments
        if self.system is not None and not np.isfinite(static).all():
            static, ages = _without_integral(self.system)
        stiffness[block], damping[block] = -size * static, self.near.period * size * ages
        return stiffness, damping

    @property
    def states(self) -> StateSpace:
        """Dimensionless state space, of the response itself without a realisation."""
        return self.system or StateSpace.of(self.scaled[: memory_of(self.scaled)])


def _without_integral(system: StateSpace) -> tuple[Array, Array]:
    """Return the moments of a system without its integrators, whose static stiffness is infinite; see `moments`.

    An integrator answers to a displacement by a constant force from that sample on.
    """
    poles, vectors = np.linalg.eig(system.advance)
    if np.linalg.cond(vectors) > _DEFECTIVE_VECTORS:  # a double integrator
        return system.moments()
    take, give = np.linalg.solve(vectors, system.take), system.give @ vectors
    integrates = np.abs(poles - 1.0) < INTEGRATOR_POLE
    rest = np.where(integrates, np.inf, 1.0 - poles)
    constant = give[:, integrates] @ take[integrates]
    sums = ((give / rest**power) @ take for power in (1, 2))
    static, ages = (part.real for part in sums)
    return system.direct - constant.real + static, ages


def memory_of(response: Array) -> int:
    """Return the length of a response without trailing zeros."""
    return 1 + int(np.flatnonzero(response.any(axis=(1, 2))).max(initial=0))


@dataclass(frozen=True, kw_only=True)
class Loop:
    """Loop of one axis in one state of its laws, or of coupled axes at a pose.

    Attributes:
        stiffness: Static stiffness of the host's laws [N/m, N m/rad].
        damping: Their damping [N s/m, N m s/rad].
        period: Sample period of the host [s].
        delay: Time from its sample to the effect of its command [s].
        inertia: Mass or moment of inertia [kg, kg m²].
        own_damping: Viscous damping of the device itself [N s/m, N m s/rad].
        driver_lag: Time constant of the drivers [s].
        mode: Flexible mode; None for a rigid flotor.
        hand: Hand on the axis; None for a free flotor.
        velocity: Linear velocity estimator; None for the finite difference.
        law: Linear law with memory in place of PD; it must answer to gains as a `Design`.
        device: Law on the device; None for none.
        axis: Name of the axis; of coupled axes all names, with commas.
        state: Active law states, such as "contact"; () for none.
        others: Inactive states of the laws on the axis.
        pose: Pose at which the laws were linearised [m, rad], six; None for declared gains.
        linear: Laws linearised there; None for declared gains.
        body: Mass and moments of inertia that scale `linear` [kg, kg m²], six.
        reason: Why the loop cannot be judged; empty if it can.
    """

    stiffness: float
    damping: float
    period: float
    delay: float
    inertia: float
    own_damping: float = 0.0
    driver_lag: float = 0.0
    mode: Mode | None = None
    hand: Hand | None = None
    velocity: VelocityEstimator | None = None
    law: Any = None
    device: DeviceLaw | None = None
    axis: str = "z"
    state: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    pose: tuple[float, ...] | None = None
    linear: AtPose | None = field(default=None, compare=False, repr=False)
    body: tuple[float, ...] = field(default=(), compare=False, repr=False)
    reason: str = ""

    @classmethod
    def of(cls, what: Any = None, **changes: Any) -> Loops:
        """Return the loops of a scene, controller, device or of numbers; nothing is left out.

        Args:
            what: Scene or its name, controller, `Device`, its name or file, recording, loop or loops; None for fields.
            changes: Of a scene, `delay`, `inertia`, `driver_lag`, `hand` and its parameters; of a controller, the
                keywords of `judge`; else fields of `Loop`, which replace those of the device. `rate` [Hz] for `period`.

        Returns:
            Every axis in every state of its laws, or at every pose of laws that declare no gains. A loop that cannot be
            judged has its `reason`.

        Raises:
            ParameterError: If there is no such scene or device, or a value is missing or outside its bounds.

        Example:
            >>> from maglev_mj.theory.loop import Loop
            >>> (stage,) = Loop.of("stage", stiffness=6000.0, damping=80.0)
            >>> stage.inertia, stage.driver_lag, round(stage.spectral_radius, 4)
            (0.3, 0.0001, 0.9011)
            >>> [loop.state for loop in Loop.of("drop") if loop.axis == "z"]
            [(), ('contact',)]
        """
        found: Loops = loaded("maglev_mj.theory.read:loops_of")(what, **changes)
        return found

    def as_json(self) -> dict[str, Any]:
        """Return the fields without those that are their default."""
        values = {item.name: (getattr(self, item.name), item.default) for item in fields(self)}
        return {name: value for name, (value, default) in values.items() if value is not default and value != default}

    @property
    def at_amplitude(self) -> float:
        """Amplitude of the motion for which a law in fixed point was linearised [m, rad]; 0 for another law."""
        if self.linear is None or not self.linear.near.resolution:
            return 0.0
        return float(self.linear.near.amplitude[AXES.index(self.axis)])

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of its axes."""
        return tuple(self.axis.split(", "))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of other axes on which its laws answer to its motion: this coupling is not in the loop."""
        if self.linear is None:
            return ()
        answers = self.linear.near.scaled(self.body)[:, :, list(self.linear.axes)]
        sizes = np.abs(answers).max(axis=(0, 2))
        return tuple(axis for axis, size in zip(AXES, sizes) if axis not in self.axes and size > STILL * sizes.max())

    @property
    def total(self) -> tuple[float, float]:
        """Stiffness and damping of host and device together [N/m, N m/rad; N s/m, N m s/rad]."""
        own = (self.device.stiffness, self.device.damping) if self.device is not None else (0.0, 0.0)
        return self.stiffness + own[0], self.damping + own[1]

    @property
    def on_host(self) -> bool:
        """False if the law on the device is the stiffer one of declared gains."""
        return self.device is None or self.stiffness >= self.device.stiffness

    def name(self, word: str) -> str:
        """Return the keyword of `diagnose` for stiffness, damping, period or delay of the law in question."""
        return word if self.on_host else f"device_{word}"

    @property
    def in_question(self) -> Loop:
        """Loop whose gains, clock and filter are those of the law in question, with the other law as its device law.

        That is the stiffer one, on host or device. The memory of laws linearised on one axis scales with the stiffness.
        """
        if self.linear is not None:
            memory = LinearisedLaw(self.controller(), self.stiffness, max(self.damping, 0.0))
            return replace(self, damping=memory.damping, law=memory, linear=None, pose=None, body=())
        law, own = self.device, self.velocity
        if law is None or self.on_host:
            return self
        beside = None
        if self.stiffness or self.damping:
            cutoff = own.cutoff if isinstance(own, LowPass) else None
            beside = DeviceLaw(self.stiffness, self.damping, self.period, self.delay, cutoff)
        gains: Any = {"stiffness": law.stiffness, "damping": law.damping, "period": law.period, "delay": law.delay}
        return replace(self, **gains, velocity=law.velocity, law=None, device=beside)

    @property
    def free(self) -> int:
        """Number of poles of free motion of declared gains, at exactly 1."""
        stiffness, damping = self.total
        if stiffness > 0.0 or self.hand is not None or self.law is not None:
            return 0
        return 1 if damping + self.own_damping > 0.0 else 2

    @property
    def acts(self) -> bool:
        """True if a law acts; without one a loop is the free motion of the flotor, or of the hand that holds it."""
        return any(self.total) or self.law is not None or (self.linear is not None and bool(self.linear.scaled.any()))

    def in_hand(self, hand: Hand | None) -> Loop:
        """Return the loop in a hand; free if the hand does not act on all of its axes, or is None."""
        held = hand if hand is not None and holds(hand, self) else None
        return self if held is self.hand else replace(self, hand=held)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles per period of the host."""
        return poles_of([self])[0]

    @property
    def spectral_radius(self) -> float:
        """Spectral radius without the poles of free motion; below 1 for a stable loop, NaN if not judged."""
        return radius_of(self, self.poles)

    def array(self, **values: Any) -> LoopArray:
        """Return the loop without its gains, for arrays of them and of any other field."""
        names = "period", "delay", "inertia", "hand", "driver_lag", "velocity", "law", "own_damping", "mode", "device"
        own = {name: getattr(self, name) for name in names}
        return LoopArray(**sampled_fields(own) | sampled_fields(values))

    def controller(self) -> LinearController:
        """Return the linear controller of the host's law on one axis, with its gains."""
        if self.linear is None:
            gains = map(np.asarray, (self.stiffness, self.damping, self.period))
            return (self.law or pd(self.velocity))(*gains)
        (axis,) = self.linear.axes
        advance, take, give, direct = self.linear.states.with_units(self.period, np.array([self.body[axis]]))
        return LinearController(advance, take[:, 0], give[0], direct[0, 0])

    def response(self) -> Array:
        """Return the force of the host's law at each sample after a unit displacement at the first, (M,)."""
        if self.linear is not None:
            (axis,) = self.linear.axes
            return np.asarray(self.linear.near.response[:, axis, axis])
        law = self.controller()
        state, response = law.take, [float(law.direct)]
        for _ in range(_SAMPLES_OF_RESPONSE):
            response.append(float(law.give @ state))
            state = law.advance @ state
        return np.array(response[: 2 + int(np.flatnonzero(response).max(initial=0))])


@dataclass(frozen=True, eq=False)
class Loops(Sequence[Loop]):
    """Loops of one controller, and what was skipped.

    Attributes:
        items: The loops; of equal ones at several poses the first.
        stated: True if all laws declare their gains.
        start: Pose at release [m, rad], (6,).
        jumps: Skipped poses with a discontinuous wrench, (J, 6).
        unknown: Skipped poses with a response of more than 512 samples without a low-order realisation, (U, 6).
        away: Skipped poses at unstable equilibria, (A, 6).
        grown: Function of one of the loops and a ratio of the scene's declared gain `stiffness` that returns the loop
            with that gain; it raises `ParameterError` out of its bounds. None without such a gain.
        doubts: What probes of laws without declared gains found, by index of the axis.
        reach: Range of motion [m, rad], (6,); None for loops of numbers.
        partial: Names of laws that declare gains of their linear part.
        hand: Hand that may hold the flotor: the loops are those of the free flotor, and those in the hand.
    """

    items: tuple[Loop, ...]
    stated: bool = True
    start: Array = field(default_factory=lambda: np.zeros(6))
    jumps: Array = field(default_factory=lambda: np.zeros((0, 6)))
    unknown: Array = field(default_factory=lambda: np.zeros((0, 6)))
    away: Array = field(default_factory=lambda: np.zeros((0, 6)))
    grown: Callable[[Loop, float], Loop] | None = field(default=None, repr=False)
    doubts: Mapping[int, Doubt] = field(default_factory=dict)
    reach: Array | None = None
    partial: tuple[str, ...] = ()
    hand: Hand | None = None

    @overload
    def __getitem__(self, index: int) -> Loop: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Loop, ...]: ...
    def __getitem__(self, index: Any) -> Any:
        """Return a loop, or a tuple of them."""
        return self.items[index]

    def __len__(self) -> int:
        """Return the number of loops."""
        return len(self.items)

    def __iter__(self) -> Iterator[Loop]:
        """Iterate over the loops."""
        return iter(self.items)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Names of axes with a loop that cannot be judged."""
        names = {axis for loop in self.items if loop.reason for axis in loop.axes}
        return tuple(axis for axis in AXES if axis in names)

    def replace(self, **changes: Any) -> Loops:
        """Return the loops with other fields, such as `delay`; a hand acts on its axes only, None is a free flotor."""
        if "hand" not in changes:
            return replace(self, items=tuple(replace(one, **changes) for one in self.items))
        hand = changes.pop("hand")
        return replace(self, items=tuple(replace(one, **changes).in_hand(hand) for one in self.items), hand=None)

    @property
    def released(self) -> tuple[Loop, ...]:
        """Loops of its laws with a free flotor, as far as they can be judged."""
        some = self.items if self.hand is None else (one for one in self.items if one.hand is None)
        return tuple(one.in_hand(None) for one in some if not one.reason and one.acts)

    def free_and_held(self, hand: Hand | None) -> Loops:
        """Return the loops of a free flotor, and those of its laws in a hand."""
        free = [one.in_hand(None) for one in self.items]
        held = [one.in_hand(hand) for one in free if not one.reason and one.acts]
        return replace(self, items=(*free, *(one for one in held if one.hand is not None)), hand=hand)

    def only(self, loops: Iterable[Loop]) -> Loops:
        """Return these loops of them."""
        return replace(self, items=tuple(loops))

    def spectral_radii(self) -> Array:
        """Return the spectral radius of each, without the poles of free motion; NaN if it cannot be judged, (N,)."""
        return np.array([radius_of(*pair) for pair in zip(self.items, poles_of(self.items), strict=True)])


def holds(hand: Hand, loop: Loop) -> bool:
    """Return True if a hand acts on all axes of a loop."""
    return {*map(AXES.index, loop.axes)} <= set(hand.indices)


def radius_of(loop: Loop, poles: NDArray[np.complex128]) -> float:
    """Return the spectral radius without the poles of free motion; NaN if the loop cannot be judged.

    Each direction without stiffness has a pole at exactly 1, and a double one without damping or with a virtual mass.
    A double pole is accurate to half of the digits, its mean to nearly all.
    """
    if loop.reason:
        return math.nan
    bound = np.argsort(np.abs(poles - 1.0))
    free = loop.free
    if loop.linear is not None:
        still, near = loop.linear.still, poles[bound[: 2 * loop.linear.still]]
        counts = range(still, 2 * still + 1) if still else ()
        free = max((count for count in counts if abs(near[:count].mean() - 1.0) < _DOUBLE_POLE), default=still)
    return float(np.abs(poles[bound[free:]]).max(initial=0.0))


def poles_of(loops: Sequence[Loop]) -> list[NDArray[np.complex128]]:
    """Return the poles per host period of each loop; those of equal structure are computed together."""
    kinds = (None if loop.reason else _structure(loop) for loop in loops)
    return computed_together(loops, kinds, _poles, default=np.empty(0, dtype=np.complex128))


def _structure(loop: Loop) -> Any:
    """Return what loops must share to be computed together."""
    around = loop.period, loop.delay, loop.driver_lag, loop.hand, loop.mode, loop.own_damping
    if loop.linear is not None:
        return around, loop.linear.axes, len(loop.linear.states.advance)
    return around, loop.velocity, loop.device, id(loop.law)


def _poles(loops: Sequence[Loop]) -> list[NDArray[np.complex128]]:
    first = loops[0]
    names = "period", "delay", "hand", "driver_lag"
    around = {name: getattr(first, name) for name in names}
    if first.linear is not None:
        if len(first.linear.axes) == 1:
            systems = StateSpace(*map(np.array, zip(*(one.linear.states for one in loops if one.linear is not None))))
            inertia = first.body[first.linear.axes[0]]
            design = systems.with_units(first.period, np.array([inertia])).single
            single = LoopArray(mass=inertia, design=design, **around)
            if single.long:
                still = [one.linear.still for one in loops if one.linear is not None]
                return [*single.poles(np.arange(float(len(loops))), 0.0, still)]
        return [*np.linalg.eigvals(linear_matrices(loops)).astype(np.complex128)]
    more = {name: getattr(first, name) for name in ("velocity", "mode", "own_damping")}
    if first.device is not None:
        return [_two_rate_poles(one.stiffness, one.damping, one.inertia, one.device, **around | more) for one in loops]
    gains = tuple((one.stiffness, one.damping, one.inertia) for one in loops)
    distinct = tuple(dict.fromkeys(gains))
    found = _pd_poles(distinct, **around | more) if first.law is None else _law_poles(distinct, first)
    poles = dict(zip(distinct, found, strict=True))
    return [poles[one] for one in gains]


def linear_matrices(loops: Sequence[Loop]) -> Array:
    """Return the matrices of linearised loops of equal structure, positions first, (N, n, n)."""
    first, own = loops[0], [one.linear for one in loops if one.linear is not None]
    inertia = np.array(first.body)[list(own[0].axes)]
    around: Any = {name: getattr(first, name) for name in ("period", "delay", "hand", "driver_lag")}
    system = StateSpace(*map(np.array, zip(*(one.states for one in own)))).with_units(first.period, inertia)
    return system.closed_loop(inertia=inertia, **around)


@lru_cache(maxsize=512)  # rotations are the same in every hand
def _pd_poles(gains: tuple[tuple[float, float, float], ...], **around: Any) -> NDArray[np.complex128]:
    stiffness, damping, inertia = np.array(gains).T
    return LoopArray(mass=inertia, **around).poles(stiffness, damping)


def _law_poles(gains: tuple[tuple[float, float, float], ...], loop: Loop) -> NDArray[np.complex128]:
    stiffness, damping, inertia = np.array(gains).T
    return loop.array(inertia=inertia).poles(stiffness, damping)


@lru_cache(maxsize=512)
def _two_rate_poles(
    stiffness: float, damping: float, inertia: float, law: DeviceLaw, **around: Any
) -> NDArray[np.complex128]:
    """Return the poles per host period of gains beside a law on the device, at the worst phase between their clocks."""
    if not (stiffness or damping):
        around["delay"] = 0.0  # without gains on the host its delay does not matter
    loop, rates = LoopArray(mass=inertia, device=law, **around), rates_of(around["period"], law)
    if loop.long:
        return np.asarray(loop.poles(stiffness, damping) ** (1.0 / rates.host))
    controller = loop.law(np.asarray(stiffness), np.asarray(damping))
    each = [np.linalg.eigvals(loop.two_rates(phase).matrix(controller)[:-1, :-1]) for phase in rates.phases]
    worst = max(each, key=lambda poles: float(np.abs(poles).max()))
    return np.asarray(worst.astype(np.complex128) ** (1.0 / rates.host))


def arrays_of(loops: Sequence[Loop]) -> Iterator[tuple[NDArray[np.int64], LoopArray, Array, Array]]:
    """Yield loops whose matrices have equal structure as one `LoopArray`, at most 256 at once.

    Yields:
        Their indices (N,), the loops, and their stiffness and damping (N,).
    """
    for indices in alike(map(_matrix_kind, loops)).values():
        for rows in np.array_split(indices, math.ceil(len(indices) / LOOPS)):
            some = [loops[index] for index in rows.tolist()]
            names = "period", "delay", "inertia", "driver_lag", "own_damping", "stiffness", "damping"
            values = {name: np.array([getattr(loop, name) for loop in some]) for name in names}
            stiffness, damping = values.pop("stiffness"), values.pop("damping")
            yield rows, some[0].array(**values), stiffness, damping


def _matrix_kind(loop: Loop) -> Any:
    """Return what loops of one `LoopArray` must share for the figures that each has alone."""
    whole, rest = split_delay(loop.delay, loop.period)
    commands = int(whole) + (rest > 0.0) if whole <= LONG else math.inf
    clock = loop.period if loop.device is not None else 0.0  # a multiple of the device's or not
    laws = loop.velocity, loop.device, id(loop.law)
    return commands, whole > MAX_DELAY_PERIODS, clock, loop.driver_lag > 0.0, loop.hand, loop.mode, *laws


def stable_delays(loop: LoopArray, stiffness: float, damping: float, *, free: bool | None = None) -> StableDelays:
    """Return all stable delays of a single loop up to 1 s.

    Beside a device law whose rate is not a multiple of the host's, only the first interval up to ten periods is found.

    Args:
        loop: The loop.
        stiffness: Its stiffness.
        damping: Its damping.
        free: True if its free motion has poles at 1; None for that of the stiffness.
    """
    undelayed, period = replace(loop, delay=0.0), float(np.asarray(loop.period))
    k, b = undelayed.broadcast(stiffness, damping)
    if undelayed.affine:
        cut_of, moves = undelayed.cuts(k, b)
        return _all_delays(cut_of, bool(moves[0]) if free is None else free, period)
    found, searched = float(critical_delay_of(undelayed, k, b)), MAX_DELAY_PERIODS * period
    end = searched if math.isnan(found) else found
    return StableDelays(((0.0, end),) if end else (), searched)


def _all_delays(cut_of: AnyCutOf, free: bool, period: float) -> StableDelays:
    ends, searched, gain = stable_intervals(cut_of, free, MAX_DELAY / period)
    return StableDelays(tuple((low * period, high * period) for low, high in ends), searched * period, gain)


def coupled_bound(loop: Loop) -> Bound:
    """Return the critical delay of coupled axes, linearised at a pose."""
    assert loop.linear is not None
    own, free = [*loop.linear.axes], loop.linear.still > 0
    inertia = np.array(loop.body)[own]
    system = loop.linear.states.with_units(loop.period, inertia)
    cut_of = system.cuts(period=loop.period, inertia=inertia, hand=loop.hand, driver_lag=loop.driver_lag)
    delay = loop.period * float(first_delays(cut_of, np.array([free]))[0])
    return Bound(delay) if delay <= MAX_DELAY else _all_delays(cut_of, free, loop.period).bound


def delay_bound(loop: LoopArray, stiffness: float, damping: float) -> Bound:
    """Return the critical delay of a single loop."""
    return delay_bounds(loop, stiffness, damping)[0]


def delay_bounds(loop: LoopArray, stiffness: ArrayLike, damping: ArrayLike, free: Mask | None = None) -> list[Bound]:
    """Return the critical delay of N loops, or for N pairs of gains; see `stable_delays`."""
    undelayed = replace(loop, delay=0.0)
    k, b = (np.atleast_1d(gain) for gain in undelayed.broadcast(stiffness, damping))
    found = np.atleast_1d(critical_delay_of(undelayed, k, b, free))
    return [
        Bound(delay)
        if delay <= MAX_DELAY
        else stable_delays(
            undelayed.part(k.shape, row), k[row], b[row], free=None if free is None else bool(free[row])
        ).bound
        for row, delay in enumerate(found.tolist())
    ]


class AffineLaw(NamedTuple):
    """Law whose response is affine in one gain k, as a `Design`: its controller at k = 0, and change per k.

    Both share their states, so that the characteristic polynomial is linear in k and no crossing is missed.
    """

    advance: Array
    take: Array
    give: Array
    direct: Array

    def __call__(self, stiffness: Array, damping: Array, period: Array, /) -> LinearController:
        """Return the law with another gain."""
        share = np.asarray(stiffness + 0.0 * damping)
        give = self.give[0] + share[..., None] * self.give[1]
        return LinearController(self.advance, self.take, give, self.direct[0] + share * self.direct[1])

    @classmethod
    def of(cls, responses: Any, gains: Any, systems: Any) -> AffineLaw | None:
        """Return the law from impulse responses (M,) at two gains and one more to check; None if not affine.

        Args:
            responses: Force at sample j after a unit displacement at sample 0, at three gains, (3, M).
            gains: The gains, (3,).
            systems: Function from a response (M, 2, 2) to its state space, or None.
        """
        (first, second, third), (one, two, three) = np.asarray(responses), gains
        slope = (second - first) / (two - one)
        if np.abs(first + (three - one) * slope - third).max() > _ERROR_OF_AFFINE_LAW * np.abs(third).max():
            return None
        parts = first - one * slope, slope * one  # of equal size, for the realisation
        joint = np.zeros((len(first), 2, 2))
        joint[:, 0, 0], joint[:, 1, 0] = parts
        if (found := systems(joint)) is None:
            return None
        advance, take, give, direct = found
        scale = np.array([1.0, 1.0 / one])
        return cls(advance, take[:, 0], give * scale[:, None], direct[:, 0] * scale)
