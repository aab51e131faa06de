"""Friction rendered on a frictionless device: stick-slip by PD, spring reset, implicit Coulomb friction.

Every friction law keeps, for each axis, a `FrictionState`; the models with a bristle are in `bristle`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Component
from maglev_mj.parameters import axis_indices, batch_shape, flag, number, numbers, per_axis

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Friction(ABC):
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

    axes: str | Sequence[str] = AXES
    stiffness: ArrayLike
    damping: ArrayLike = 0.0
    breakaway: ArrayLike

    indices: tuple[int, ...] = field(init=False)
    batch: tuple[int, ...] = field(init=False)
    pulse_width: float = field(init=False, default=0.0)
    _of_axis: tuple[dict[str, Component], ...] = field(init=False, repr=False)

    _POSITIVE: ClassVar[tuple[str, ...]] = ("stiffness", "breakaway")
    """Parameters that must be above 0; a law adds its own."""
    _OTHER: ClassVar[tuple[str, ...]] = ("damping",)
    """Parameters that may be 0."""

    def __post_init__(self) -> None:
        indices = axis_indices(self.axes)
        values = {name: numbers(name, getattr(self, name), at_least=0.0) for name in (*self._POSITIVE, *self._OTHER)}
        for name in self._POSITIVE:
            if not (values[name] > 0.0).all():
                raise ParameterError(f"{name} must be above 0 everywhere, not {values[name].min():g}")
        split = {name: per_axis(name, value, len(indices)) for name, value in values.items()}
        of_axis = tuple({name: parts[slot] for name, parts in split.items()} for slot in range(len(indices)))
        object.__setattr__(self, "indices", indices)
        object.__setattr__(self, "batch", batch_shape("friction", values.values()))
        object.__setattr__(self, "_of_axis", of_axis)

    def start(self) -> tuple[FrictionState, ...] | None:
        """Return the state before the first sample: none; at the first sample the law sticks where it is."""
        return None

    def begin(self, position: Component) -> FrictionState:
        """Return the state of one axis at the first sample: stuck, unstretched."""
        return FrictionState(position == position, position)

    @abstractmethod
    def axis(
        self, position: Component, velocity: Component, state: FrictionState, parameters: dict[str, Component]
    ) -> tuple[Component, FrictionState]:
        """Return the friction force without viscous damping [N, N m], and the next state, of one axis."""

    def __call__(
        self,
        position: Sequence[Component],
        velocity: Sequence[Component],
        state: tuple[FrictionState, ...] | None,
        wrench: list[Component],
    ) -> tuple[tuple[FrictionState, ...], None]:
        """Answer one sample; see `Law`."""
        before = state or tuple(self.begin(position[index]) for index in self.indices)
        after = []
        answers = self.answers(position, velocity, before)
        for index, (force, following), parameters in zip(self.indices, answers, self._of_axis):
            wrench[index] = wrench[index] + (force - parameters["damping"] * velocity[index])
            after.append(following)
        return tuple(after), None

    def answers(
        self, position: Sequence[Component], velocity: Sequence[Component], before: tuple[FrictionState, ...]
    ) -> list[tuple[Component, FrictionState]]:
        """Return what `axis` does for each of the law's axes; a law that couples them does it here."""
        return [
            self.axis(position[index], velocity[index], memory, parameters)
            for index, memory, parameters in zip(self.indices, before, self._of_axis)
        ]


@dataclass(frozen=True, kw_only=True, eq=False)
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

    v_min: ArrayLike
    coupled: bool = False

    _POSITIVE: ClassVar[tuple[str, ...]] = ("stiffness", "breakaway", "v_min")

    def __post_init__(self) -> None:
        super().__post_init__()
        flag("coupled", self.coupled)
        if self.coupled and any(np.ndim(getattr(self, name)) for name in (*self._POSITIVE, *self._OTHER)):
            raise ParameterError("coupled axes share their parameters: give one number for each")
        if self.coupled and not set(self.indices) <= {0, 1, 2}:
            raise ParameterError(f"coupled axes must be translations, of x, y, z, not {self.axes!r}")

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, parameters: dict[str, Component]
    ) -> tuple[Component, FrictionState]:
        """Answer one sample of one axis; see `Friction`."""
        pull = parameters["stiffness"] * (state.anchor - position)
        return self._decide(position, pull, abs(pull), abs(velocity), state, parameters)

    def answers(
        self, position: Sequence[Component], velocity: Sequence[Component], before: tuple[FrictionState, ...]
    ) -> list[tuple[Component, FrictionState]]:
        """Answer one sample of all axes; see `Friction`."""
        if not self.coupled:
            return super().answers(position, velocity, before)
        shared = self._of_axis[0]
        pulls = [shared["stiffness"] * (memory.anchor - position[index]) for index, memory in zip(self.indices, before)]
        pull = apply(np.sqrt, sum(part * part for part in pulls))
        speed = apply(np.sqrt, sum(velocity[index] * velocity[index] for index in self.indices))
        return [
            self._decide(position[index], part, pull, speed, memory, shared)
            for index, memory, part in zip(self.indices, before, pulls)
        ]

    def _decide(
        self,
        position: Component,
        pull: Component,
        size: Component,
        speed: Component,
        state: FrictionState,
        parameters: dict[str, Component],
    ) -> tuple[Component, FrictionState]:
        """Return the force and the next state, given the spring's pull and the sizes that decide."""
        holds = state.stuck & (size <= parameters["breakaway"])
        sticks = (state.stuck == False) & (speed < parameters["v_min"])  # noqa: E712 - elementwise
        anchor = choose(holds, state.anchor, position)
        return choose(holds, pull, 0.0), FrictionState(holds | sticks, anchor)


@dataclass(frozen=True, kw_only=True, eq=False)
class SpringReset(Friction):
    """A spring to a stick point that moves to the flotor, force gone, where the spring exceeds the limit.

    Without a velocity in it the law never slides: it hops. At speed v its force is a sawtooth of mean breakaway / 2
    that vanishes where one sample's travel stretches the spring past the limit.

    Source: described after the stick-slip effect of CHAI3D 3 (www.chai3d.org), which has no damping.
    """

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, parameters: dict[str, Component]
    ) -> tuple[Component, FrictionState]:
        """Answer one sample of one axis; see `Friction`."""
        pull = parameters["stiffness"] * (state.anchor - position)
        holds = abs(pull) <= parameters["breakaway"]
        return choose(holds, pull, 0.0), FrictionState(holds, choose(holds, state.anchor, position))


@dataclass(frozen=True, kw_only=True, eq=False)
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
    element_damping: ArrayLike = 0.0

    _OTHER: ClassVar[tuple[str, ...]] = ("damping", "element_damping")

    def __post_init__(self) -> None:
        super().__post_init__()
        number("period", self.period, above=0.0)

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, parameters: dict[str, Component]
    ) -> tuple[Component, FrictionState]:
        """Answer one sample of one axis; see `Friction`."""
        # the anchor stays while the flotor moves: position - anchor is the old stretch plus the travel
        drag = parameters["element_damping"] / self.period
        stiff = parameters["stiffness"] + drag
        before = 0.0 if state.memory is None else state.memory
        trial = stiff * (position - state.anchor) - drag * before
        limit = parameters["breakaway"]
        force = choose(trial > limit, limit, choose(trial < -limit, -limit, trial))
        stretch = (force + drag * before) / stiff
        anchor = choose(abs(trial) <= limit, state.anchor, position - stretch)
        return -force, FrictionState(abs(trial) < SLIDING_SHARE * limit, anchor, stretch)


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
