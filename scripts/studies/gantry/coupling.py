"""Virtual coupling between joystick and slave.

One law of the joystick's controller, whose opposite drives the slave.

In what follows a figure is the joystick's unless it is said to be the slave's: a way of the slave counts as way / scale
and a force on it as force * reflection, so that what the slave weighs, feels like and takes in energy is seen from
the handle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from maglev_mj.control import Law, StickSlip
from maglev_mj.frames import Array
from maglev_mj.interop.spacenav.navigation import Mode, Navigator
from maglev_mj.parameters import number


@dataclass(frozen=True, kw_only=True)
class Coupling:
    """A spring and a damper from joystick to slave.

    Args:
        stiffness: Of the spring [N/m].
        damping: Of the damper [N s/m].
        scale: The slave's way for the joystick's [1].
        reflection: The joystick's force for the slave's [1].
        bound: Largest force that the coupling gives, on each axis [N].

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: a coupling between device and virtual tool after Colgate, Stanley & Brown 1995 and Adams & Hannaford 1999,
        recalled.
    """

    stiffness: float
    damping: float
    scale: float = 10.0
    reflection: float = 0.1
    bound: float = 8.0

    def __post_init__(self) -> None:
        number("stiffness", self.stiffness, above=0.0)
        number("damping", self.damping, at_least=0.0)
        for name in ("scale", "reflection", "bound"):
            number(name, getattr(self, name), above=0.0)

    @property
    def felt(self) -> float:
        """Factor from the slave's impedance to the joystick's [1], for masses, stiffnesses and dampings."""
        return self.scale * self.reflection

    @property
    def energy(self) -> float:
        """Factor from the slave's energies to the joystick's [1]."""
        return self.reflection / self.scale


class CouplingLaw(Law):
    """Stick-slip, if any, and the coupling's force, which is also kept for the slave.

    The slave is asked where it is when the joystick is. Where it is drawn to, the target, moves by the navigator's
    increments. In rate mode the target stays where the spring would pull harder than the coupling may: else it would
    go on into whatever the slave presses on, and the slave would be stuck to that until it had all come back.

    Args:
        coupling: The coupling.
        place: Returns where the slave is [m, the slave's], (3,).
        period: Sample period [s].
        navigator: What moves the target.
        friction: Stick-slip on the joystick, by which the navigator tells what the hand does; None for none.

    Attributes:
        force: What draws the slave, and the joystick the other way [N], (3,).
        target: Where the slave is drawn to [m, the slave's], (3,).
        modes: Of the three axes.
    """

    def __init__(
        self,
        coupling: Coupling,
        place: Callable[[], Array],
        *,
        period: float,
        navigator: Navigator,
        friction: StickSlip | None = None,
    ) -> None:
        self.coupling, self._place, self._period = coupling, place, period
        self._navigator, self._friction = navigator, friction
        self.force, self.target = np.zeros(3), place()
        self.modes = navigator.modes[:3]
        self._stretch: Array | None = None

    def start(self) -> Any:
        """Return the friction's state before the first sample."""
        return None if self._friction is None else self._friction.start()

    def __call__(
        self, position: Sequence[float], velocity: Sequence[float], state: Any, wrench: list[float]
    ) -> tuple[Any, None]:
        """Answer one sample; see `Law`."""
        anchors = None
        if self._friction is not None:
            state, _ = self._friction(position, velocity, state, wrench)
            anchors = np.full(6, np.nan)
            for index, anchor in self._friction.stick_positions(state).items():
                anchors[index] = anchor
        moved = self._navigator.move(position, anchors, self._period)[:3]
        self.modes = self._navigator.modes[:3]
        place = self._place()
        self.target = self.target + self._allowed(moved, self.target - place)
        self.force = self._pull((self.target - place) / self.coupling.scale)
        for axis in range(3):
            wrench[axis] = wrench[axis] - float(self.force[axis])
        return state, None

    def _pull(self, stretch: Array) -> Array:
        """Return the coupling's force."""
        coupling = self.coupling
        rate = np.zeros(3) if self._stretch is None else (stretch - self._stretch) / self._period
        self._stretch = stretch
        pull = coupling.stiffness * stretch + coupling.damping * rate
        return np.clip(pull, -coupling.bound, coupling.bound)

    def _allowed(self, moved: Array, ahead: Array) -> Array:
        """Return the target's allowed movement [m]: the slave's, given its wish and its lead."""
        rates = [mode is Mode.RATE for mode in self.modes]
        most = self.coupling.bound / self.coupling.stiffness * self.coupling.scale
        cut = np.clip(moved, np.minimum(-most - ahead, 0.0), np.maximum(most - ahead, 0.0))
        return np.where(rates, cut, moved)
