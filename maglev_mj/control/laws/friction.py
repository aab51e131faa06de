"""Rendered friction: PD stick-slip, spring reset, implicit Coulomb friction.

Every friction law keeps, for each axis, a `FrictionState`; the models with a bristle are in `bristle`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import AxisLaw, Gains, gain
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Component
from maglev_mj.parameters import flag, number

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

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, gains: Any
    ) -> tuple[Component, FrictionState]:
        """Return friction force [N, N m] and next state.

        Viscous damping is not included.
        """
        raise NotImplementedError

    def force(
        self, x: Component, v: Component, gains: Any, state: FrictionState | None
    ) -> tuple[Component, FrictionState]:
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
        found = zip(self.indices, state)
        return {index: one.anchor if one.stuck else math.nan for index, one in found if one is not None}


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

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, gains: Any
    ) -> tuple[Component, FrictionState]:
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
    """Return a stuck state with zero deflection.

    It is the state of an axis at its first sample.
    """
    return FrictionState(position == position, position)


def choose(mask: Component, yes: Component, no: Component) -> Component:
    """Select `yes` or `no` by a mask, elementwise.

    Floats and arrays are both accepted.
    """
    if isinstance(mask, bool | np.bool_):
        return yes if mask else no
    return np.where(mask, yes, no)


def apply(function: Callable[[Component], Component], value: Component) -> Component:
    """Apply a numpy function; a float stays a float.

    numpy's own function serves both cases, because the standard library's may round differently.
    """
    result = function(value)
    return float(result) if isinstance(value, float) else result
