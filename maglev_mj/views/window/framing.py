"""Camera control: the handle centred in the free area.

It stays centred for any window size.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.lazy import mujoco
from maglev_mj.views.window.layout import Area

_HIGH, _WIDE = 0.85, 0.95
"""Shares of the default view's height kept in view.

Vertically and horizontally.
"""

_NEAR, _INSET, _ROOM = 0.45, 55, 260
"""Position of the axes in the picture.

Their distance from the camera as a share of the distance to its target, their distance from the corner, and the width
they need [pixels].
"""


class Framing:
    """Free camera with its target centred in a free area.

    Args:
        model: The compiled model, whose file gives the default view.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._last: tuple[Area, Area] | None = None

    def reset(self, camera: Any) -> None:
        """Reset a camera to the default view.

        The view is applied at the next `follow`.
        """
        mujoco.mjv_defaultFreeCamera(self._model, camera)
        camera.lookat[:2] = 0.0  # the flotor's own axis
        self._last = None

    def follow(self, camera: Any, view: Area, free: Area) -> None:
        """Move a camera after a change of the free area.

        Turns and shifts by the user are kept.

        Args:
            camera: The camera to be moved.
            view: The picture.
            free: Its free area.
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
        """Return a position in the free area's upper left corner.

        It is near the camera; None if there is no room.

        The height of a pixel there is returned too. Both are in metres; the position is (3,).
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
        """Return a pixel's height at the camera's target [m]."""
        half = math.radians(0.5 * float(self._model.vis.global_.fovy))
        return 2.0 * float(camera.distance) * math.tan(half) / view.height

    def _shift(self, camera: Any, view: Area, free: Area) -> Array:
        """Return the offset of the free area's middle [m], (3,).

        It is that from the middle of the picture, at the camera's distance.
        """
        across, up = directions(camera)
        pixel = self._pixel(camera, view)
        (x, y), (middle, level) = free.centre, view.centre
        shift: Array = pixel * ((x - middle) * across + (y - level) * up)
        return shift


def directions(camera: Any) -> tuple[Array, Array]:
    """Return a camera's right and upward unit vectors, (3,) each."""
    turn, lift = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array([math.cos(lift) * math.cos(turn), math.cos(lift) * math.sin(turn), math.sin(lift)])
    across = np.array([math.sin(turn), -math.cos(turn), 0.0])
    return across, np.cross(across, forward)


def _zoom(view: Area, free: Area) -> float:
    """Return the camera's distance factor for the free area.

    It is relative to the distance for the whole picture.
    """
    return max(_HIGH * view.height / max(free.height, 1), _WIDE * view.height / max(free.width, 1))
