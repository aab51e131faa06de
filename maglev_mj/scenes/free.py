"""Scenes without walls: free rotation, fall, soft centring."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from maglev_mj.control import Hold, Law
from maglev_mj.parameters import param
from maglev_mj.plants import Timing
from maglev_mj.scenes.scene import Scene, Start


class _Body(Scene):
    """Scene whose run has no extra sample if its end coincides with one."""

    takes_phase: ClassVar[bool] = False

    def laws(self) -> list[Law]:
        """Return no laws."""
        return []

    def ticks(self, timing: Timing) -> int:
        """See `Scene`."""
        return max(math.ceil(self.end / self.period - 1e-9), 1)


class Twist(_Body):
    """Free flotor rotating at 3.7 rad/s about all three axes."""

    figures: ClassVar = ("peak_speed", "final_position")
    shown_axis: ClassVar[str] = "rx"
    plots: ClassVar[Mapping[str, str]] = {"twist": "maglev_mj.scenes.pictures:every_axis"}

    duration: float = param("simulated time", "s", default=0.04, above=0.0, at_most=1e6)

    def start(self) -> Start:
        """Return a rotating flotor, its weight compensated."""
        twist = (0.0, 0.0, 0.0, 2.0, -1.5, 2.7)
        return Start(pose=(0.0, 0.0, 0.0, -0.04, 0.03, -0.02), twist=twist, gravity=0.0)

    def describe(self) -> str:
        """Return a one-line description."""
        return "free flotor rotating at 3.7 rad/s about all three axes"


class LetGo(_Body):
    """Fall of the flotor from the centre on its stop, without currents."""

    figures: ClassVar = ("peak_speed", "final_position")
    tolerance: ClassVar[float] = 1e-4
    tolerance_reason: ClassVar[str] = "well below the 0.5 mm compression of the stop"

    duration: float = param(
        "simulated time",
        "s",
        default=None,
        derive=lambda scene: 0.08 * math.sqrt(scene.hardware.range_ratio[2]),
        above=0.0,
        at_most=1e6,
    )

    def describe(self) -> str:
        """Return a one-line description."""
        return "currents off at the centre: the flotor falls on its stop"


def _soft(gain: str) -> Callable[[Any], float]:
    """Return a function that derives a gain of `Hold.critically_damped`."""

    def derived(scene: SixAxes) -> float:
        soft = Hold.critically_damped("x", inertia=scene.hardware.mass, period=scene.period, delay=scene.delay)
        return float(np.asarray(getattr(soft, gain)))

    return derived


class SixAxes(_Body):
    """PD centring of the flotor on all six axes.

    Rotational gains are the translational ones times the square of the radius of gyration.
    """

    figures: ClassVar = ("peak_speed", "final_position", "ripple")
    shown_axis: ClassVar[str] = "x"
    plots: ClassVar[Mapping[str, str]] = {"six-axes": "maglev_mj.scenes.pictures:every_axis"}

    duration: float = param("simulated time", "s", default=0.3, above=0.0, at_most=1e6)
    stiffness: float = param(
        "stiffness of the hold", "N/m", default=None, derive=_soft("stiffness"), at_least=0.0, at_most=1e8, live=True
    )
    damping: float = param(
        "damping of the hold", "N s/m", default=None, derive=_soft("damping"), at_least=0.0, at_most=1e6, live=True
    )

    def laws(self) -> list[Law]:
        """Return the hold."""
        share = self.hardware.inertia / self.hardware.mass
        return [Hold(stiffness=self.stiffness * share, damping=self.damping * share)]

    def start(self) -> Start:
        """Return a flotor displaced on all six axes, its weight compensated."""
        pose = np.array([0.003, -0.002, 0.003, 0.06, -0.04, 0.05]) * self.hardware.range_ratio
        return Start(pose=pose.tolist(), gravity=0.0)

    def describe(self) -> str:
        """Return a one-line description."""
        gains = f"{self.stiffness:.6g} N/m and {self.damping:.4g} N s/m"
        reach = f"{3.0 * self.hardware.range_ratio[0]:.3g} mm and {3.4 * self.hardware.range_ratio[3]:.3g} degrees"
        return f"PD centring from {reach} on all six axes, {gains}"
