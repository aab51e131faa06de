"""Rendered friction: PD stick-slip, spring reset, implicit Coulomb friction.

Every friction law keeps, for each axis, a `FrictionState`. The bristle models (Dahl, LuGre, elasto-plastic,
Hayward-Armstrong) carry a stretch z behind the position x; the anchor of their state is x - z. Their differential
equations in z are driven by the travel dx of a sample, over which the velocity counts as constant.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import Answer, AxisLaw, Gains, apply, choose, gain, setting
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Component, Six, clipped
from maglev_mj.parameters import flag

SLIDING_SHARE = 0.95
"""Share of the limit force that counts as sliding.

A bristle approaches its limit without reaching it, and a quantized position can make a sliding one rest for a sample.
"""


class FrictionState(NamedTuple):
    """State of a friction law on one axis."""

    stuck: Component
    """True while the axis sticks.

    The friction force is then below its limit.
    """
    anchor: Component
    """Anchor of the friction spring [m, rad]: x minus deflection."""
    memory: Any = None
    """Further state of the law."""


FrictionStep: TypeAlias = tuple[Component, FrictionState]
"""Friction force on one axis [N, N m], and the next state."""


class Friction(AxisLaw):
    """Base class of friction laws.

    Each parameter is a number for all of the law's axes, one number an axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        stiffness: Stiffness while stuck [N/m, N m/rad], above 0.
        damping: Viscous damping, stuck or sliding [N s/m, N m s/rad].
        breakaway: Largest friction force [N, N m], above 0.

    Raises:
        ParameterError: If a value is outside its bounds or a shape does not fit.
    """

    stiffness: ArrayLike = gain(unit="N/m, N m/rad", above=0.0)
    damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)
    breakaway: ArrayLike = gain(unit="N, N m", above=0.0)

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Return friction force [N, N m] and next state.

        Viscous damping is not included.
        """
        raise NotImplementedError

    def force(self, x: Component, v: Component, gains: Any, state: FrictionState | None) -> FrictionStep:
        """Return the force on one axis and its next state.

        At the first sample the axis sticks at its position.
        """
        friction, following = self.axis(x, v, state or _stuck_at(x), gains)
        return friction - gains.damping * v, following

    def gains(self) -> Iterable[Gains]:
        """Return the permanent damping and the stiffness while stuck."""
        none = np.zeros(len(AXES))
        yield Gains("always", none, self.on_axes(self.damping))
        yield Gains("stuck", self.on_axes(self.stiffness), self.on_axes(self.stuck_damping))

    @property
    def stuck_damping(self) -> ArrayLike:
        """Further damping while stuck [N s/m, N m s/rad]."""
        return 0.0

    def signals(self, state: Any) -> Mapping[str, Sequence[Component]]:
        """Return stick_position [m, rad] and stuck, by name.

        While sliding, stick_position is that of the last stick.
        """
        known = [one for one in state if one is not None]
        return {"stick_position": [one.anchor for one in known], "stuck": [one.stuck for one in known]} if known else {}

    def stick_positions(self, state: Any) -> Mapping[int, float]:
        """Return stick positions [m, rad] by index into AXES.

        NaN for a sliding axis.
        """
        states = zip(self.indices, state)
        return {index: one.anchor if one.stuck else math.nan for index, one in states if one is not None}


class StickSlip(Friction):
    """Karnopp stick-slip friction rendered by a PD spring.

    The spring pulls to the stick position; there is none while sliding.

    The axis breaks away when the spring force exceeds `breakaway`, and sticks again when the speed falls below `v_min`.
    The state changes at most once per sample.

    Args:
        v_min: Speed below which a sliding axis sticks [m/s, rad/s], above 0.
        coupled: Treat the law's axes as one vector, as for a block on a table: breakaway and speed are norms, and all
            axes stick and slide together. The axes must be translations, and every parameter the same on all.

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

    v_min: ArrayLike = gain(unit="m/s, rad/s", above=0.0)
    coupled: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        flag("coupled", self.coupled)
        if self.coupled and any(np.ptp(np.atleast_1d(getattr(self, name)), axis=-1).any() for name in self.per_device):
            raise ParameterError("coupled axes share their parameters: give one number for each")
        if self.coupled and not set(self.indices) <= {0, 1, 2}:
            raise ParameterError(f"coupled axes must be translations, of x, y, z, not {self.axes!r}")

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Answer one sample of one axis; see `Friction`."""
        pull = gains.stiffness * (state.anchor - position)
        return self._decide(position, pull, abs(pull), abs(velocity), state, gains)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Answer one sample of all axes; see `Law`."""
        if not self.coupled:
            return super().__call__(position, velocity, state, wrench)
        gains = self._each[0][1]
        before = [one or _stuck_at(position[index]) for index, one in zip(self.indices, state)]
        pulls = [gains.stiffness * (one.anchor - position[index]) for index, one in zip(self.indices, before)]
        pull = apply(np.sqrt, sum(part * part for part in pulls))
        speed = apply(np.sqrt, sum(velocity[index] * velocity[index] for index in self.indices))
        after = []
        for index, part, one in zip(self.indices, pulls, before):
            friction, following = self._decide(position[index], part, pull, speed, one, gains)
            wrench[index] = wrench[index] + (friction - gains.damping * velocity[index])
            after.append(following)
        return after, None

    def _decide(
        self, position: Component, pull: Component, size: Component, speed: Component, state: FrictionState, gains: Any
    ) -> FrictionStep:
        """Return the force and the next state.

        `pull` is the spring force; `size` and `speed` decide on the state.
        """
        holds = state.stuck & (size <= gains.breakaway)
        sticks = (state.stuck == False) & (speed < gains.v_min)  # noqa: E712 - elementwise
        anchor = choose(holds, state.anchor, position)
        return choose(holds, pull, 0.0), FrictionState(holds | sticks, anchor)


class SpringReset(Friction):
    """Friction spring that resets to zero force at its limit.

    When the spring force exceeds the limit, the stick point moves to the flotor.

    The law uses no velocity, so it jumps instead of sliding. At speed v its force is a sawtooth of mean breakaway / 2;
    it vanishes if one sample's travel stretches the spring past the limit.

    Source: described after the stick-slip effect of CHAI3D 3 (www.chai3d.org), which has no damping.
    """

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Answer one sample of one axis; see `Friction`."""
        pull = gains.stiffness * (state.anchor - position)
        holds = abs(pull) <= gains.breakaway
        return choose(holds, pull, 0.0), FrictionState(holds, choose(holds, state.anchor, position))


class ImplicitCoulomb(Friction):
    """Coulomb friction with spring and damper, by implicit Euler.

    It does not chatter at any sample rate.

    The force of the spring-damper is saturated, and its deflection is set to match:
    f = sat(breakaway, (K + B/T) (e + dx) - B e / T).

    Args:
        period: Sample period T [s].
        element_damping: Damping B of the element in series with the friction [N s/m, N m s/rad].

    Source: Kikuuwe, Takesue, Sano, Mochiyama & Fujimoto 2006; derived again, not checked against the original.

    Example:
        >>> from maglev_mj import Controller, ImplicitCoulomb, Sample
        >>> friction = ImplicitCoulomb(axes="x", stiffness=6000.0, breakaway=2.0, period=0.005)
        >>> controller = Controller([friction], period=0.005)
        >>> path = enumerate([0.0, 1e-4, 3e-4, 1e-3])  # it sticks, and slides at the breakaway force
        >>> samples = [Sample(k, 0.005 * k, [x, 0, 0, 0, 0, 0]) for k, x in path]
        >>> [round(controller.step(sample).force[0], 3) + 0.0 for sample in samples]
        [0.0, -0.6, -1.8, -2.0]
    """

    period: float = setting(above=0.0)
    element_damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)

    @property
    def stuck_damping(self) -> ArrayLike:
        """Damping of the element in series; see `Friction`."""
        return self.element_damping

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Answer one sample of one axis; see `Friction`."""
        # the anchor stays while the flotor moves: position - anchor is the old stretch plus the travel
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
    """Return a stuck state with zero deflection.

    It is the state of an axis at its first sample.
    """
    return FrictionState(position == position, position)


class _Bristle(Friction):
    """Friction law with the bristle deflection as its state."""

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the deflection [m, rad] after a travel [m, rad].

        By default it solves dz = dx - |dx| z / limit, and tends to the limit in the direction of travel.
        """
        limit = self.limit(velocity, gains) / gains.stiffness
        end = choose(travel > 0.0, limit, -limit)
        return end + (z - end) * apply(np.exp, -abs(travel) / limit)

    def pull(self, before: Component, z: Component, velocity: Component, gains: Any) -> Component:
        """Return the force of the bristle [N, N m]."""
        return -(gains.stiffness * z)

    def limit(self, velocity: Component, gains: Any) -> Component:
        """Return the sliding force at this velocity [N, N m]."""
        return gains.breakaway

    def axis(self, position: Component, velocity: Component, state: FrictionState, gains: Any) -> FrictionStep:
        """Answer one sample of one axis; see `Friction`."""
        last, before = (position, 0.0) if state.memory is None else state.memory
        z = self.stretch(before, position - last, velocity, gains)
        force = self.pull(before, z, velocity, gains)
        sticks = gains.stiffness * abs(z) < SLIDING_SHARE * self.limit(velocity, gains)
        return force, FrictionState(sticks, position - z, (position, z))


class Dahl(_Bristle):
    """Dahl friction model.

    dz = dx (1 - sgn(dx) z / z_c) with z_c = breakaway / stiffness. The equation is solved exactly for each travel.

    Source: Dahl 1968, in the form of Olsson et al. 1998; derived again, not checked against the original.
    """


class LuGre(_Bristle):
    """LuGre friction with Stribeck effect and bristle damping.

    `dz/dt = v - stiffness |v| z / g(v)`, with g falling from breakaway to Coulomb friction; F = s0 z + s1 dz/dt.

    Args:
        period: Sample period [s].
        coulomb: Friction in fast sliding, as a share of `breakaway`, in (0, 1].
        stribeck: Stribeck velocity, of the fall from breakaway to Coulomb friction [m/s, rad/s], above 0.
        bristle_damping: Damping s1 of the bristle [N s/m, N m s/rad].

    Source: Canudas de Wit, Olsson, Astrom & Lischinsky 1995; not checked against the original.
    """

    period: float = setting(above=0.0)
    coulomb: float = setting(default=0.8, above=0.0, at_most=1.0)
    stribeck: ArrayLike = gain(unit="m/s, rad/s", default=0.01, above=0.0)
    bristle_damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)

    @property
    def stuck_damping(self) -> ArrayLike:
        """Damping of the bristle; see `Friction`."""
        return self.bristle_damping

    def limit(self, velocity: Component, gains: Any) -> Component:
        """Return the Stribeck curve at this velocity [N, N m]."""
        ratio = velocity / gains.stribeck
        share = self.coulomb + (1.0 - self.coulomb) * apply(np.exp, -(ratio * ratio))
        return share * gains.breakaway

    def pull(self, before: Component, z: Component, velocity: Component, gains: Any) -> Component:
        """Return the bristle force with its damping [N, N m]."""
        return -(gains.stiffness * z + gains.bristle_damping * ((z - before) / self.period))


class ElastoPlastic(_Bristle):
    """Elasto-plastic friction without creep at small loads.

    dz = dx (1 - alpha(z) z / z_ss). Up to a share of the limit the bristle is purely elastic. alpha rises from 0 to 1
    over half a sine between elastic * z_ss and z_ss if z and dx have the same sign; otherwise it is 0.

    Args:
        elastic: Share of the largest stretch up to which the bristle is purely elastic, in (0, 1).

    Source: Dupont, Hayward, Armstrong & Altpeter 2002; not checked against the original.
    """

    elastic: float = setting(default=0.7, above=0.0, below=1.0)

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the stretch after a travel; see `_Bristle`."""
        limit = gains.breakaway / gains.stiffness
        share = abs(z) / limit
        middle = (share - 0.5 * (1.0 + self.elastic)) / (1.0 - self.elastic)
        rising = 0.5 + 0.5 * apply(np.sin, np.pi * choose(middle < -0.5, -0.5, choose(middle > 0.5, 0.5, middle)))
        alpha = choose(z * travel > 0.0, rising, 0.0)
        moved = z + travel * (1.0 - alpha * share)
        return clipped(moved, limit)


class HaywardArmstrong(_Bristle):
    """Displacement-based friction without drift.

    The anchor follows by `alpha(z) |dx| z` and stays within z_max of the flotor.

    alpha(z) = 1/z_max z^8 / (z_stick^8 + z^8): almost 0 while stuck, so small load cycles do not creep.

    Args:
        stick: z_stick as a share of z_max, in (0, 1).

    Source: Hayward & Armstrong 2000; not checked against the original.
    """

    stick: float = setting(default=0.7, above=0.0, below=1.0)

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the stretch after a travel; see `_Bristle`."""
        limit = gains.breakaway / gains.stiffness
        moved = z + travel
        square = moved * moved / (limit * limit)
        fourth = square * square
        eighth = fourth * fourth
        alpha = eighth / (self.stick**8 + eighth) / limit
        followed = moved / (1.0 + alpha * abs(travel))  # implicit: never past the flotor, however long the travel
        return clipped(followed, limit)
