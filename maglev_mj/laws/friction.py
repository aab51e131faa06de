"""Friction rendered on a frictionless device: stick-slip by PD, spring reset, implicit Coulomb friction.

Every friction law keeps, for each axis, a `FrictionState`; the models with a bristle are in `bristle`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Component
from maglev_mj.laws.base import AxisLaw, Gains, gain
from maglev_mj.parameters import flag, number

__all__ = ["Friction", "FrictionState", "ImplicitCoulomb", "SpringReset", "StickSlip", "apply", "choose"]


SLIDING_SHARE = 0.95
"""Share of its limit from which on a force counts as sliding friction.

A bristle nears its limit without ever reaching it, and a quantized position makes a sliding one rest for a sample.
"""


class FrictionState(NamedTuple):
    """What a friction law remembers of one axis."""

    stuck: Component
    """Whether the axis sticks: its friction is below what the law can give."""
    anchor: Component
    """Where the spring that holds it is attached [m, rad]: x minus its stretch."""
    memory: Any = None
    """What else the law needs."""


class Friction(AxisLaw):
    """What friction laws share.

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

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, gains: Any
    ) -> tuple[Component, FrictionState]:
        """Return the friction force without viscous damping [N, N m], and the next state, of one axis."""
        raise NotImplementedError

    def force(
        self, x: Component, v: Component, gains: Any, state: FrictionState | None
    ) -> tuple[Component, FrictionState]:
        """Return the force on one axis and its next state: at the first sample it sticks where it is."""
        friction, following = self.axis(x, v, state or _stuck_at(x), gains)
        return friction - gains.damping * v, following

    def gains(self) -> Iterable[Gains]:
        """Return the damping, which always acts, and the stiffness while stuck."""
        none = np.zeros(len(AXES))
        yield Gains("always", none, self.on_axes(self.damping))
        yield Gains("stuck", self.on_axes(self.stiffness), self.on_axes(self.stuck_damping))

    @property
    def stuck_damping(self) -> ArrayLike:
        """Further damping while stuck [N s/m, N m s/rad]."""
        return 0.0

    def signals(self, state: Any) -> Mapping[str, Sequence[Component]]:
        """Return stick_position [m, rad], that of the last stick while sliding, and stuck."""
        known = [one for one in state if one is not None]
        return {"stick_position": [one.anchor for one in known], "stuck": [one.stuck for one in known]} if known else {}

    def stick_positions(self, state: Any) -> Mapping[int, float]:
        """Return stick positions [m, rad] by index into AXES, NaN where an axis slides."""
        found = zip(self.indices, state)
        return {index: one.anchor if one.stuck else math.nan for index, one in found if one is not None}


class StickSlip(Friction):
    """Karnopp's stick-slip emulated by PD: a spring to the stick position, none while sliding.

    Breaks away where the spring exceeds `breakaway`; sticks where it is where the speed falls below `v_min`. One
    change of state a sample.

    Args:
        v_min: Speed below which a sliding axis sticks [m/s, rad/s], above 0.
        coupled: Treat the law's axes, translations then, as one vector, as a block on a table: breakaway and
            speed are norms, and all axes stick and slide together. Every parameter is one number for all axes.

    Source: Salcudean & Vlaar 1997, eq. (12)-(13).
    """

    v_min: ArrayLike = gain(unit="m/s, rad/s", above=0.0)
    coupled: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        flag("coupled", self.coupled)
        if self.coupled and any(map(np.ndim, (self.stiffness, self.damping, self.breakaway, self.v_min))):
            raise ParameterError("coupled axes share their parameters: give one number for each")
        if self.coupled and not set(self.indices) <= {0, 1, 2}:
            raise ParameterError(f"coupled axes must be translations, of x, y, z, not {self.axes!r}")

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, gains: Any
    ) -> tuple[Component, FrictionState]:
        """Answer one sample of one axis; see `Friction`."""
        pull = gains.stiffness * (state.anchor - position)
        return self._decide(position, pull, abs(pull), abs(velocity), state, gains)

    def __call__(
        self, position: Sequence[Component], velocity: Sequence[Component], state: Any, wrench: list[Component]
    ) -> tuple[Any, Sequence[Component] | None]:
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
        self,
        position: Component,
        pull: Component,
        size: Component,
        speed: Component,
        state: FrictionState,
        gains: Any,
    ) -> tuple[Component, FrictionState]:
        """Return the force and the next state, given the spring's pull and the sizes that decide."""
        holds = state.stuck & (size <= gains.breakaway)
        sticks = (state.stuck == False) & (speed < gains.v_min)  # noqa: E712 - elementwise
        anchor = choose(holds, state.anchor, position)
        return choose(holds, pull, 0.0), FrictionState(holds | sticks, anchor)


class SpringReset(Friction):
    """A spring to a stick point that moves to the flotor, force gone, where the spring exceeds the limit.

    Without a velocity in it the law never slides: it hops. At speed v its force is a sawtooth of mean breakaway / 2
    that vanishes where one sample's travel stretches the spring past the limit.

    Source: described after the stick-slip effect of CHAI3D 3 (www.chai3d.org), which has no damping.
    """

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, gains: Any
    ) -> tuple[Component, FrictionState]:
        """Answer one sample of one axis; see `Friction`."""
        pull = gains.stiffness * (state.anchor - position)
        holds = abs(pull) <= gains.breakaway
        return choose(holds, pull, 0.0), FrictionState(holds, choose(holds, state.anchor, position))


class ImplicitCoulomb(Friction):
    """Coulomb friction behind a spring and damper, integrated by implicit Euler: no chatter at any rate.

    The force of the spring-damper that would follow the flotor is saturated, and the stretch set to what that force
    leaves: f = sat(breakaway, (K + B/T) (e + dx) - B e / T).

    Args:
        period: Sample period T [s].
        element_damping: Damping B of the element in series with the friction [N s/m, N m s/rad].

    Source: Kikuuwe, Takesue, Sano, Mochiyama & Fujimoto 2006; formula recalled and derived again.
    """

    period: float
    element_damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        number("period", self.period, above=0.0)

    @property
    def stuck_damping(self) -> ArrayLike:
        """Damping of the element in series; see `Friction`."""
        return self.element_damping

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, gains: Any
    ) -> tuple[Component, FrictionState]:
        """Answer one sample of one axis; see `Friction`."""
        # the anchor stays while the flotor moves: position - anchor is the old stretch plus the travel
        drag = gains.element_damping / self.period
        stiff = gains.stiffness + drag
        before = 0.0 if state.memory is None else state.memory
        trial = stiff * (position - state.anchor) - drag * before
        limit = gains.breakaway
        force = choose(trial > limit, limit, choose(trial < -limit, -limit, trial))
        stretch = (force + drag * before) / stiff
        anchor = choose(abs(trial) <= limit, state.anchor, position - stretch)
        return -force, FrictionState(abs(trial) < SLIDING_SHARE * limit, anchor, stretch)


def _stuck_at(position: Component) -> FrictionState:
    """Return the state of one axis at the first sample: stuck, unstretched."""
    return FrictionState(position == position, position)


def choose(mask: Component, yes: Component, no: Component) -> Component:
    """Return `yes` where the mask holds and `no` elsewhere, for floats or arrays."""
    if isinstance(mask, bool | np.bool_):
        return yes if mask else no
    return np.where(mask, yes, no)


def apply(function: Callable[[Component], Component], value: Component) -> Component:
    """Apply a numpy function to a component; a float stays a float.

    numpy's own function serves both cases, because the standard library's may round differently.
    """
    result = function(value)
    return float(result) if isinstance(value, float) else result
