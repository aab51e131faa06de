"""Stability of what is shown, found beside the loop: a boundary and the gains' place in it, or a verdict in words."""

from __future__ import annotations

import threading
from functools import lru_cache

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array
from maglev_mj.scenes import Scene
from maglev_mj.theory import inertia_of, largest_stable_stiffness, stability, stated_gains

__all__ = ["StabilityMap"]

_DAMPINGS = 32
_NO_BOUNDARY = np.zeros(0), np.zeros(0)


class StabilityMap:
    """Stability of the newest parameters, found beside the session: a boundary, or a verdict in words."""

    def __init__(self) -> None:
        self._key: Scene | None = None
        self._found: tuple[Array, Array] | str = _NO_BOUNDARY
        self._busy: threading.Thread | None = None

    def of(self, scene: Scene) -> tuple[Array, Array] | str:
        """Return dampings [N s/m] and stiffnesses [N/m], or the verdict; the last one until a scene's own is known."""
        if scene != self._key and (self._busy is None or not self._busy.is_alive()):
            self._busy = threading.Thread(target=self._find, args=(scene,), daemon=True)
            self._busy.start()
        return self._found

    def wait(self, scene: Scene) -> None:
        """Find at once what is not known yet."""
        if scene != self._key:
            self._find(scene)

    def _find(self, scene: Scene) -> None:
        try:
            if stated_gains(scene.controller()) is None:
                self._found = str(stability(scene))
            else:
                self._found = _boundary(scene.period, scene.delay, float(inertia_of(scene)[0]))
        except MaglevError:
            self._found = "stability not known"
        self._key = scene


@lru_cache
def _boundary(period: float, delay: float, mass: float) -> tuple[Array, Array]:
    """Return dampings [N s/m] and the largest stable stiffness at each [N/m]."""
    # no damping beyond this is stable, whatever the stiffness
    most = 0.5 * np.pi * mass / (0.5 * period + delay) * 1.1
    dampings = np.linspace(0.0, most, _DAMPINGS)
    try:
        stiffnesses = largest_stable_stiffness(dampings, period=period, delay=delay, mass=mass)
    except ParameterError:  # theory goes up to ten periods of delay; beyond it there is no boundary to draw
        stiffnesses = np.zeros_like(dampings)
    end = int(np.flatnonzero(stiffnesses).max(initial=-2)) + 2
    return dampings[:end], stiffnesses[:end]
