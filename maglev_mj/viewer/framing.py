"""The camera: the handle in the middle of what is free, however the window changes."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from maglev_mj.frames import Array
from maglev_mj.viewer.layout import Area

__all__ = ["Framing"]

_HIGH, _WIDE = 0.85, 0.95
"""Shares of the height that the file's own camera sees which are to be in view, up and across."""

_NEAR, _INSET, _ROOM = 0.45, 55, 260
"""How far the axes are from the camera, of the way to what it looks at, and from the corner; and the room they need."""


class Framing:
    """Moves a free camera so that what its file shows is in the middle of the free part of a picture.

    Args:
        model: The compiled model, whose file says from where it is seen.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._last: tuple[Area, Area] | None = None

    def reset(self, camera: Any) -> None:
        """Point a camera as the file says, at the next `follow`."""
        mujoco.mjv_defaultFreeCamera(self._model, camera)
        camera.lookat[:2] = 0.0  # the flotor's own place
        self._last = None

    def follow(self, camera: Any, view: Area, free: Area) -> None:
        """Move a camera after a change of what is free; what a person has turned and moved stays so.

        Args:
            camera: The camera, which is moved.
            view: The picture.
            free: What is free of it.
        """
        if self._last == (view, free) or camera.type != int(mujoco.mjtCamera.mjCAMERA_FREE):
            return
        if self._last is not None:
            camera.lookat[:] += self._shift(camera, *self._last)
            camera.distance /= _zoom(*self._last)
        camera.distance *= _zoom(view, free)
        camera.lookat[:] -= self._shift(camera, view, free)
        self._last = view, free

    def corner(self, camera: Any, view: Area, free: Area) -> tuple[Array, float] | None:
        """Return a place near the camera that is seen at the upper left of what is free; None where there is no room.

        With it the height of a pixel there. Both are in metres; the place is (3,).
        """
        if free.width < _ROOM:
            return None
        across, up = directions(camera)
        pixel = _NEAR * self._pixel(camera, view)
        x, y = free.left + _INSET - view.centre[0], free.top - _INSET - view.centre[1]
        eye = camera.lookat - camera.distance * np.cross(up, across)
        place: Array = eye + _NEAR * (camera.lookat - eye) + pixel * (x * across + y * up)
        return place, pixel

    def _pixel(self, camera: Any, view: Area) -> float:
        """Return the height of a pixel at what a camera looks at [m]."""
        half = math.radians(0.5 * float(self._model.vis.global_.fovy))
        return 2.0 * float(camera.distance) * math.tan(half) / view.height

    def _shift(self, camera: Any, view: Area, free: Area) -> Array:
        """Return how far the middle of what is free is from that of the picture, at the camera's distance [m], (3,)."""
        across, up = directions(camera)
        pixel = self._pixel(camera, view)
        (x, y), (middle, level) = free.centre, view.centre
        shift: Array = pixel * ((x - middle) * across + (y - level) * up)
        return shift


def directions(camera: Any) -> tuple[Array, Array]:
    """Return unit vectors to the right and upward in a free camera's picture, (3,) each."""
    turn, lift = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array([math.cos(lift) * math.cos(turn), math.cos(lift) * math.sin(turn), math.sin(lift)])
    across = np.array([math.sin(turn), -math.cos(turn), 0.0])
    return across, np.cross(across, forward)


def _zoom(view: Area, free: Area) -> float:
    """Return how many times as far away a camera must be for what is free than for the whole picture."""
    return max(_HIGH * view.height / max(free.height, 1), _WIDE * view.height / max(free.width, 1))
