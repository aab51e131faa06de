"""Stability of the scene shown, computed beside the loop.

The gains that act together under their boundary, or words.
"""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.scenes import Scene
from maglev_mj.theory import Verdict, inertia_of, largest_stable_stiffness, stability, stated_gains

_DAMPINGS = 32
_NOTHING = np.zeros(0)


class Margin(NamedTuple):
    """Place of a scene's gains under the stability boundary.

    Attributes:
        words: Verdict, such as "stable: 59 % of the boundary".
        stable: None where that is not known.
        axis: Name of the axis that is nearest to its boundary; empty where the laws do not state their gains.
        stiffness: Of all that acts together there [N/m, N m/rad].
        damping: Likewise [N s/m, N m s/rad].
        dampings: Of the axis' boundary, increasing, (N,).
        stiffnesses: Largest stable stiffness at each, (N,).
    """

    words: str
    stable: bool | None = None
    axis: str = ""
    stiffness: float = 0.0
    damping: float = 0.0
    dampings: Array = _NOTHING
    stiffnesses: Array = _NOTHING

    @property
    def shown(self) -> tuple[float, str]:
        """Factor and unit of stiffness in a plot."""
        return (1.0, "N m/rad") if self.axis.startswith("r") else (1e-3, "kN/m")


def margin(scene: Scene) -> Margin:
    """Return a scene's gains and their stability boundary.

    The loop is that of a flotor that nobody holds: of all axes and combinations of laws the one nearest its boundary.
    """
    try:
        gains = stated_gains(scene.controller())
        verdict = stability(scene)
        if gains is None:
            return Margin(str(verdict), verdict.stable)
        return _placed(scene, verdict, list(gains.values()))
    except MaglevError:
        return Margin("stability not known")


def _placed(scene: Scene, verdict: Verdict, gains: list[tuple[Array, Array]]) -> Margin:
    stiffness, damping = (np.array(both) for both in zip(*gains, strict=True))
    body, shares = inertia_of(scene), np.zeros_like(stiffness)
    if stiffness.any():
        most = largest_stable_stiffness(damping, period=scene.period, delay=scene.delay, mass=body)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(stiffness > 0.0, stiffness / most, 0.0)
        # of those that are alike but for rounding the first
        place = divmod(int(np.argmax(shares >= shares.max() * (1.0 - 1e-9))), len(AXES))
    else:  # the most damped combination, on the axis that is looked at
        place = int(damping[:, scene.axis_index].argmax()), scene.axis_index
    share, index = float(shares[place]), place[1]
    own = float(stiffness[place]), float(damping[place])
    if not verdict.stable:
        index = AXES.index(verdict.axes[0])
        own = float(verdict.stiffness[index, index]), float(verdict.damping[index, index])
        words = f"UNSTABLE on {AXES[index]}"
        if 1.0 <= share < np.inf:
            words += f": {100.0 * share:.0f} % of the boundary"
    elif own[0]:
        words = f"stable: {100.0 * share:.0f} % of the boundary"
    else:
        words = "stable: no stiffness"
    return Margin(words, verdict.stable, AXES[index], *own, *_boundary(scene.period, scene.delay, float(body[index])))


class StabilityMap:
    """Margin of the newest parameters, found beside the session."""

    def __init__(self) -> None:
        self._key: Scene | None = None
        self._found = Margin("")
        self._busy: threading.Thread | None = None

    def of(self, scene: Scene) -> Margin:
        """Return a scene's margin, or the last one meanwhile."""
        if scene != self._key and (self._busy is None or not self._busy.is_alive()):
            self._busy = threading.Thread(target=self._find, args=(scene,), daemon=True)
            self._busy.start()
        return self._found

    def wait(self, scene: Scene) -> None:
        """Compute a missing margin at once."""
        if scene != self._key:
            self._find(scene)

    def _find(self, scene: Scene) -> None:
        self._found = margin(scene)
        self._key = scene


@lru_cache
def _boundary(period: float, delay: float, mass: float) -> tuple[Array, Array]:
    """Return dampings and the largest stable stiffness at each.

    Of an axis with one mass or moment of inertia.
    """
    # no damping beyond this is stable, whatever the stiffness
    most = 0.5 * np.pi * mass / (0.5 * period + delay) * 1.1
    dampings = np.linspace(0.0, most, _DAMPINGS)
    try:
        stiffnesses = largest_stable_stiffness(dampings, period=period, delay=delay, mass=mass)
    except ParameterError:  # theory goes up to ten periods of delay; beyond it there is no boundary to draw
        stiffnesses = np.zeros_like(dampings)
    end = int(np.flatnonzero(stiffnesses).max(initial=-2)) + 2
    return dampings[:end], stiffnesses[:end]
