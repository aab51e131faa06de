"""Pure laws: frozen parameters, state in and state out, written once for one device and for N.

A law acts on some of the six axes. The controller hands it the position and velocity components of all six,
and each law adds its force to the same wrench.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from maglev_mj.frames import Component
from maglev_mj.laws.bias import Bias
from maglev_mj.laws.bristle import Dahl, ElastoPlastic, HaywardArmstrong, LuGre
from maglev_mj.laws.friction import Friction, FrictionState, ImplicitCoulomb, SpringReset, StickSlip
from maglev_mj.laws.hold import Hold
from maglev_mj.laws.linear import LinearController
from maglev_mj.laws.passivity import PassivityController
from maglev_mj.laws.prediction import ObserverWall, PredictiveWall
from maglev_mj.laws.velocity import AdaptiveWindow, FiniteDifference, LowPass, Window
from maglev_mj.laws.wall import Wall

__all__ = [
    "AdaptiveWindow",
    "Bias",
    "Dahl",
    "ElastoPlastic",
    "FiniteDifference",
    "Friction",
    "FrictionState",
    "HaywardArmstrong",
    "Hold",
    "ImplicitCoulomb",
    "Law",
    "LinearController",
    "LowPass",
    "LuGre",
    "ObserverWall",
    "PassivityController",
    "PredictiveWall",
    "SpringReset",
    "StickSlip",
    "VelocityEstimator",
    "Wall",
    "Window",
]


class Law(Protocol):
    """What the controller asks of a law."""

    @property
    def batch(self) -> tuple[int, ...]:
        """Shape of parameters that differ from device to device; () where they do not."""

    @property
    def pulse_width(self) -> float:
        """How long the law's pulses last [s]; 0 for a law without any."""

    def start(self) -> Any:
        """Return the state before the first sample."""

    def __call__(
        self,
        position: Sequence[Component],
        velocity: Sequence[Component],
        state: Any,
        wrench: list[Component],
    ) -> tuple[Any, Sequence[Component] | None]:
        """Answer one sample: add the held force to `wrench`.

        Args:
            position: Six position components [m, rad].
            velocity: Six velocity components [m/s, rad/s].
            state: What the previous call returned, or `start()`.
            wrench: Six components that the laws add up in [N, N m]; the only argument that is changed.

        Returns:
            The next state, and six components of pulse on top of the held force for `pulse_width`, or None.
        """


class VelocityEstimator(Protocol):
    """What the controller asks of a velocity estimate."""

    def __call__(self, position: Sequence[Component], state: Any, period: float) -> tuple[Sequence[Component], Any]:
        """Return six velocity components and the next state; `state` is None at the first sample."""
