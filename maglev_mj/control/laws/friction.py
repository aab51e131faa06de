"""Rendered friction: Karnopp stick-slip, spring reset, implicit Coulomb friction and bristle models.

Every friction law keeps a `FrictionState` per axis. The bristle models (Dahl, LuGre, elasto-plastic,
Hayward-Armstrong) have the bristle deflection z as their state, with the anchor x - z. Their equations dz/dx are
integrated over the travel dx between two samples, at constant velocity.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import Answer, AxisLaw, Gains, apply, choose, gain, setting
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Component, Six, clipped
from maglev_mj.parameters import flag
from maglev_mj.spec import MAX_PERIOD, MIN_PERIOD

SLIDING_SHARE = 0.95
"""Fraction of the limit force above which an axis counts as sliding.

A bristle approaches its limit asymptotically, and a quantized position can leave a sliding one unchanged for a sample.
"""


class FrictionState(NamedTuple):
    """State of a friction law on one axis."""

    stuck: Component
    """True while the axis sticks, with the friction force below its limit."""
    anchor: Component
    """Anchor of the friction spring [m, rad]: position minus deflection."""
    memory: Any = None
    """Additional state of the law."""


FrictionStep: TypeAlias = tuple[Component, FrictionState]
"""Friction force on one axis [N, N m], and the next state."""


class Friction(AxisLaw):
    """Base class of friction laws.

    Each parameter is a number, one number per axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        stiffness: Stiffness while stuck [N/m, N m/rad], above 0.
        damping: Viscous damping, stuck or sliding [N s/m, N m s/rad].
        breakaway: Breakaway force, the largest friction force [N, N m], above 0.

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.
    """

    called: ClassVar[str]
    """Value of `--law`."""
    slides_at: ClassVar[float] = 1.0
    """Nominal friction in steady sliding over breakaway force."""

    stiffness: ArrayLike = gain(unit="N/m, N m/rad", above=0.0)
    damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)
    breakaway: ArrayLike = gain(unit="N, N m", above=0.0)

    @classmethod
    def of(cls, **common: Any) -> Self:
        """Return a law from parameters that all friction laws share, ignoring those it does not have."""
        names = {one.name for one in fields(cls)}
        return cls(**{name: value for name, value in common.items() if name in names})

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Return friction force [N, N m], without viscous damping, and next state."""
        raise NotImplementedError

    def force(self, x: Component, v: Component, gains: Any, state: FrictionState | None) -> FrictionStep:
        """Return the force on one axis and its next state; at the first sample the axis sticks."""
        friction, following = self.axis(x, v, state or _stuck_at(x), gains)
        return friction - gains.damping * v, following

    def gains(self) -> Iterable[Gains]:
        """Return the viscous damping, and the stiffness while stuck."""
        none = np.zeros(len(AXES))
        yield Gains("always", none, self.on_axes(self.damping))
        yield Gains("stuck", self.on_axes(self.stiffness), self.on_axes(self.stuck_damping))

    @property
    def stuck_damping(self) -> ArrayLike:
        """Additional damping while stuck [N s/m, N m s/rad]."""
        return 0.0

    def signals(self, state: Any) -> Mapping[str, Sequence[Component]]:
        """Return `stick_position` [m, rad], while sliding the previous one, and `stuck`."""
        axes = [axis for axis in state if axis is not None]
        return (
            {"stick_position": [axis.anchor for axis in axes], "stuck": [axis.stuck for axis in axes]} if axes else {}
        )

    def stick_positions(self, state: Any) -> Mapping[int, float]:
        """Return stick positions [m, rad] by index into AXES; NaN for a sliding axis."""
        states = zip(self.indices, state)
        return {index: axis.anchor if axis.stuck else math.nan for index, axis in states if axis is not None}


class StickSlip(Friction):
    """Karnopp stick-slip friction rendered by a PD spring.

    Stuck at x_s: f = k (x_s - x) - b v until abs(k (x_s - x)) > breakaway. Sliding: f = -b v until abs(v) < v_min.
    The state changes at most once per sample.

    Args:
        v_min: Speed below which a sliding axis sticks [m/s, rad/s], above 0.
        coupled: Treat the law's axes as one vector, as for a block on a table: breakaway force and speed are norms, and
            all axes stick and slide together. Translations only, with equal parameters on all axes.

    Source: Salcudean & Vlaar 1997, eq. (12)-(13).

    Example:
        >>> from maglev_mj import Controller, Sample, StickSlip
        >>> friction = StickSlip(axes="x", stiffness=6000.0, breakaway=2.0, v_min=0.01)
        >>> controller = Controller([friction], period=0.005)
        >>> path = enumerate([0.0, 1e-4, 3e-4, 1e-3])  # it sticks, and lets go
        >>> samples = [Sample(k, 0.005 * k, [x, 0, 0, 0, 0, 0]) for k, x in path]
        >>> [round(controller.step(sample).force[0], 3) + 0.0 for sample in samples]
        [0.0, -0.6, -1.8, 0.0]
    """

    called: ClassVar = "stick-slip"
    slides_at: ClassVar = 0.0

    v_min: ArrayLike = gain(unit="m/s, rad/s", above=0.0)
    coupled: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        flag("coupled", self.coupled)
        if self.coupled and any(np.ptp(np.atleast_1d(getattr(self, name)), axis=-1).any() for name in self.per_device):
            raise ParameterError("coupled axes share their parameters: give one number per parameter")
        if self.coupled and not set(self.indices) <= {0, 1, 2}:
            raise ParameterError(f"coupled axes must be translations (x, y, z) (got {self.axes!r})")

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Return force and next state of one axis; see `Friction`."""
        pull = gains.stiffness * (state.anchor - position)
        return self._decide(position, pull, abs(pull), abs(velocity), state, gains)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Add the forces for one sample; see `Law`."""
        if not self.coupled:
            return super().__call__(position, velocity, state, wrench)
        gains = self._each[0][1]
        before = [axis or _stuck_at(position[index]) for index, axis in zip(self.indices, state)]
        pulls = [gains.stiffness * (axis.anchor - position[index]) for index, axis in zip(self.indices, before)]
        pull = apply(np.sqrt, sum(part * part for part in pulls))
        speed = apply(np.sqrt, sum(velocity[index] * velocity[index] for index in self.indices))
        after = []
        for index, part, axis in zip(self.indices, pulls, before):
            friction, following = self._decide(position[index], part, pull, speed, axis, gains)
            wrench[index] = wrench[index] + (friction - gains.damping * velocity[index])
            after.append(following)
        return after, None

    def _decide(
        self, position: Component, pull: Component, size: Component, speed: Component, state: FrictionState, gains: Any
    ) -> FrictionStep:
        """Return force and next state for a spring force `pull`, with magnitudes `size` and `speed`."""
        holds = state.stuck & (size <= gains.breakaway)
        sticks = (state.stuck == False) & (speed < gains.v_min)  # noqa: E712 - elementwise
        anchor = choose(holds, state.anchor, position)
        return choose(holds, pull, 0.0), FrictionState(holds | sticks, anchor)


class SpringReset(Friction):
    """Friction spring that resets to zero force at its limit.

    f = k (x_s - x) while abs(f) <= breakaway; otherwise f = 0 and x_s = x.

    The law uses no velocity, so it jumps instead of sliding. While the flotor moves, its force is a sawtooth with mean
    breakaway / 2; it vanishes if the travel per sample stretches the spring past the limit.

    Source: `cEffectStickSlip` of CHAI3D (github.com/chai3d/chai3d), which has no damping.
    """

    called: ClassVar = "spring-reset"
    slides_at: ClassVar = 0.0  # intended as stick-slip, but its force is a sawtooth

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Return force and next state of one axis; see `Friction`."""
        pull = gains.stiffness * (state.anchor - position)
        holds = abs(pull) <= gains.breakaway
        return choose(holds, pull, 0.0), FrictionState(holds, choose(holds, state.anchor, position))


class ImplicitCoulomb(Friction):
    """Coulomb friction in series with a spring-damper, by implicit Euler; free of chatter at any sample rate.

    f = sat(breakaway, (K + B/T) (e + dx) - B e / T); the deflection e is then set to match f.

    Args:
        period: Sample period T [s].
        element_damping: Damping B of the series element [N s/m, N m s/rad].

    Source: implicit Euler step of a Coulomb element in series with a spring-damper, as the abstracts of Kikuuwe,
    Takesue, Sano, Mochiyama & Fujimoto 2005 and 2006 state it; the closed form is derived here, their equations were
    not opened.

    Example:
        >>> from maglev_mj import Controller, ImplicitCoulomb, Sample
        >>> friction = ImplicitCoulomb(axes="x", stiffness=6000.0, breakaway=2.0, period=0.005)
        >>> controller = Controller([friction], period=0.005)
        >>> path = enumerate([0.0, 1e-4, 3e-4, 1e-3])  # it sticks, and slides at the breakaway force
        >>> samples = [Sample(k, 0.005 * k, [x, 0, 0, 0, 0, 0]) for k, x in path]
        >>> [round(controller.step(sample).force[0], 3) + 0.0 for sample in samples]
        [0.0, -0.6, -1.8, -2.0]
    """

    called: ClassVar = "kikuuwe"

    period: float = setting(at_least=MIN_PERIOD, at_most=MAX_PERIOD, unit="s")
    element_damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)

    @property
    def stuck_damping(self) -> ArrayLike:
        """Damping of the series element; see `Friction`."""
        return self.element_damping

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Return force and next state of one axis; see `Friction`."""
        # position - anchor = e + dx, because the anchor is that of the last sample
        drag = gains.element_damping / self.period
        stiff = gains.stiffness + drag
        before = 0.0 if state.memory is None else state.memory
        trial = stiff * (position - state.anchor) - drag * before
        limit = gains.breakaway
        force = clipped(trial, limit)
        stretch = (force + drag * before) / stiff
        anchor = choose(abs(trial) <= limit, state.anchor, position - stretch)
        return -force, FrictionState(abs(trial) < SLIDING_SHARE * limit, anchor, stretch)


def _stuck_at(position: Component) -> FrictionState:
    """Return the state of an axis at its first sample: stuck, zero deflection."""
    return FrictionState(position == position, position)


class _Bristle(Friction):
    """Friction law with the bristle deflection z as its state."""

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the deflection [m, rad] after a travel [m, rad].

        The default solves dz = dx - abs(dx) z / limit, which tends to the limit in the direction of travel.
        """
        limit = self.limit(velocity, gains) / gains.stiffness
        end = choose(travel > 0.0, limit, -limit)
        return end + (z - end) * apply(np.exp, -abs(travel) / limit)

    def pull(self, before: Component, z: Component, velocity: Component, gains: Any) -> Component:
        """Return the bristle force [N, N m]."""
        return -(gains.stiffness * z)

    def limit(self, velocity: Component, gains: Any) -> Component:
        """Return the sliding force at this velocity [N, N m]."""
        return gains.breakaway

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Return force and next state of one axis; see `Friction`."""
        last, before = (position, 0.0) if state.memory is None else state.memory
        z = self.stretch(before, position - last, velocity, gains)
        force = self.pull(before, z, velocity, gains)
        sticks = gains.stiffness * abs(z) < SLIDING_SHARE * self.limit(velocity, gains)
        return force, FrictionState(sticks, position - z, (position, z))


class Dahl(_Bristle):
    """Dahl friction: dz/dx = 1 - sgn(dx) z / z_c, f = -k z, with z_c = breakaway / k.

    Solved exactly for the travel of each sample.

    Source: LuGre with constant g and no bristle damping, as MuJoCo's `dcmotor` computes it; Dahl 1968 was not opened.
    """

    called: ClassVar = "dahl"


class LuGre(_Bristle):
    """LuGre friction with Stribeck effect and bristle damping.

    dz/dt = v - s0 abs(v) z / g(v), f = -(s0 z + s1 dz/dt),
    g(v) = breakaway (c + (1 - c) exp(-(v / v_s)²)), with s0 = `stiffness`.

    Args:
        period: Sample period [s].
        coulomb: Coulomb friction c, as a fraction of `breakaway`, in (0, 1].
        stribeck: Stribeck velocity v_s [m/s, rad/s], above 0.
        bristle_damping: Bristle damping s1 [N s/m, N m s/rad].

    Source: Canudas de Wit, Olsson, Astrom & Lischinsky 1995 (not opened), as in github.com/auralius/LuGre, which
    rebuilds its figures; the deflection is that of MuJoCo's `dcmotor`, damped by its mean rate over a sample.
    """

    called: ClassVar = "lugre"
    slides_at: ClassVar = 0.8

    period: float = setting(at_least=MIN_PERIOD, at_most=MAX_PERIOD, unit="s")
    coulomb: float = setting(default=0.8, above=0.0, at_most=1.0)
    stribeck: ArrayLike = gain(unit="m/s, rad/s", default=0.01, above=0.0)
    bristle_damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)

    @classmethod
    def of(cls, **common: Any) -> Self:
        """Return a law whose Stribeck velocity is `v_min`; see `Friction`."""
        return super().of(stribeck=common["v_min"], **common)

    @property
    def stuck_damping(self) -> ArrayLike:
        """Bristle damping; see `Friction`."""
        return self.bristle_damping

    def limit(self, velocity: Component, gains: Any) -> Component:
        """Return the Stribeck curve g(v) [N, N m]."""
        ratio = velocity / gains.stribeck
        share = self.coulomb + (1.0 - self.coulomb) * apply(np.exp, -(ratio * ratio))
        return share * gains.breakaway

    def pull(self, before: Component, z: Component, velocity: Component, gains: Any) -> Component:
        """Return the bristle force, damping included [N, N m]."""
        return -(gains.stiffness * z + gains.bristle_damping * ((z - before) / self.period))


class ElastoPlastic(_Bristle):
    """Elasto-plastic friction, free of creep under small loads.

    dz/dx = 1 - alpha(z) abs(z) / z_ss, f = -k z, with z_ss = breakaway / k. If z and dx have the same sign, alpha rises
    from 0 to 1 as half a sine between elastic z_ss and z_ss; otherwise alpha = 0.

    Args:
        elastic: Largest purely elastic deflection, as a fraction of z_ss, in (0, 1).

    Source: Dupont, Hayward, Armstrong & Altpeter 2002 (not opened), as in github.com/SilvinWillemsen/ElastoPlastic,
    without Stribeck effect and bristle damping, by one explicit step over the travel.
    """

    called: ClassVar = "elasto-plastic"

    elastic: float = setting(default=0.7, above=0.0, below=1.0)

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the deflection after a travel; see `_Bristle`."""
        limit = gains.breakaway / gains.stiffness
        share = abs(z) / limit
        middle = (share - 0.5 * (1.0 + self.elastic)) / (1.0 - self.elastic)
        rising = 0.5 + 0.5 * apply(np.sin, np.pi * choose(middle < -0.5, -0.5, choose(middle > 0.5, 0.5, middle)))
        alpha = choose(z * travel > 0.0, rising, 0.0)
        moved = z + travel * (1.0 - alpha * share)
        return clipped(moved, limit)


class HaywardArmstrong(_Bristle):
    """Displacement-based friction, nearly free of drift: a variant after Hayward & Armstrong.

    dw = alpha(z) abs(dx) z for the anchor w = x - z, abs(z) <= z_max = breakaway / k, f = -k z, with
    alpha(z) = z^8 / (z_stick^8 + z^8) / z_max: almost 0 while stuck, so small load cycles hardly creep.

    Args:
        stick: z_stick as a fraction of z_max, in (0, 1).

    Source: a variant of ours, after Hayward & Armstrong 2000 (not opened): a displacement-based law that is nearly
    free of drift, whose alpha(z) could not be verified.
    """

    called: ClassVar = "hayward-armstrong"

    stick: float = setting(default=0.7, above=0.0, below=1.0)

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the deflection after a travel; see `_Bristle`."""
        limit = gains.breakaway / gains.stiffness
        moved = z + travel
        square = moved * moved / (limit * limit)
        fourth = square * square
        eighth = fourth * fourth
        alpha = eighth / (self.stick**8 + eighth) / limit
        followed = moved / (1.0 + alpha * abs(travel))  # implicit step: never overshoots the flotor
        return clipped(followed, limit)
