"""Drawing of snapshots with MuJoCo into the current OpenGL context, shared by window and pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maglev_mj.frames import Array, rotation_matrix
from maglev_mj.lazy import mujoco
from maglev_mj.plants.shapes import GRIP
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.views.magnifier import magnified
from maglev_mj.views.window.layout import Area, arranged
from maglev_mj.views.window.scenery import Scenery
from maglev_mj.views.window.screen import Screen

_HIGH, _WIDE = 0.85, 0.95
"""Fractions of the default view's height that stay visible, vertically and horizontally."""

_AXES, _AXES_SCALE = np.array([0.075, -0.075, -0.05]), 4.5e-4
"""Origin of the coordinate axes, beside the base [m], and their scale."""

_MAX_GEOMS, _TURN = 2000, 180.0  # [deg] per height of the picture
_HALF_TEXT = 0.17  # half the width of a number such as "2.4 N" [pixels], at a font scale of 1 %


class Painter:
    """Renderer of snapshots.

    Args:
        scene: The scene; others are loaded as snapshots show them.
        screen: Overlay.
        scale: Font scale, 100 to 300 [%].
        size: Width and height of an offscreen buffer [pixels]; None to draw into the window.
        shadows: True to draw shadows.

    Attributes:
        scenery: Displayed model.
        camera: The camera, which the user may move.

    Raises:
        ModelError: If the model file is missing or invalid.
    """

    def __init__(
        self,
        scene: Scene,
        screen: Screen,
        *,
        scale: int = 100,
        size: tuple[int, int] | None = None,
        shadows: bool = True,
    ) -> None:
        self._screen, self._scale, self._size, self._shadows = screen, scale, size, shadows
        self._option, self.camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._context: Any = None
        self._load(scene)

    def _load(self, scene: Scene) -> None:
        self.close()
        self.scenery = Scenery(scene)
        model = self.scenery.model
        if self._size is not None:
            model.vis.global_.offwidth, model.vis.global_.offheight = self._size
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        self._context = mujoco.MjrContext(model, self._scale)
        if self._size is not None:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self.reset()

    def reset(self) -> None:
        """Reset the camera to the default view."""
        default_view(self.scenery.model, self.camera)
        self._zoom = 1.0

    def device_area(self, view: Area) -> Area:
        """Return the area of the 3D view in a picture."""
        return arranged(view, self._scale).device if self._screen.plots else view

    def draw(self, snapshot: Snapshot, view: Area, notes: Sequence[str] = ()) -> None:
        """Draw a snapshot into a picture."""
        if snapshot.scene.model != self.scenery.path:
            self._load(snapshot.scene)
        scenery, scene, area = self.scenery, self._scene, self.device_area(view)
        last, self._zoom = self._zoom, zoom(area)
        self.camera.distance *= self._zoom / last  # the user's own zoom is kept
        factor = self._screen.factor
        scenery.set_pose(snapshot, factor)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(scenery.model, scenery.data, self._option, None, self.camera, everything, scene)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._shadows
        scenery.half_text = _HALF_TEXT * self._scale * self.knob(snapshot, view)[1]
        scenery.decorate(scene, snapshot, factor)
        if self._screen.plots:
            scenery.draw_axes(scene, _AXES, _AXES_SCALE)
        mujoco.mjr_render(mujoco.MjrRect(*area), scene, self._context)
        if self._screen.plots:
            self._screen.draw(snapshot, view, self._scale, notes).render(self._context)

    def pixels(self, view: Area) -> NDArray[np.uint8]:
        """Return the picture drawn last, (height, width, 3)."""
        pixels = np.empty((view.height, view.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, mujoco.MjrRect(*view), self._context)
        return pixels[::-1]

    def orbit(self, right: float, up: float) -> None:
        """Turn the camera by a drag, as a fraction of the picture's height."""
        self.camera.azimuth -= _TURN * right
        self.camera.elevation = min(max(self.camera.elevation + _TURN * up, -89.0), 89.0)

    def pan(self, right: float, up: float, view: Area) -> None:
        """Move the camera across by a drag, as a fraction of the picture's height."""
        area = self.device_area(view)
        _, across, above = project(self.scenery.model, self.camera, area, self.camera.lookat.copy())
        self.camera.lookat -= view.height * (right * across + up * above)

    def knob(self, snapshot: Snapshot, view: Area) -> tuple[Array, Array, Array]:
        """Return the knob's pixel, (2,), and the displacement of one pixel right and up there [m], (3,) each."""
        pose = magnified(snapshot, self._screen.factor).pose
        point = pose[:3] + rotation_matrix(pose[3:]) @ GRIP
        return project(self.scenery.model, self.camera, self.device_area(view), point)

    def close(self) -> None:
        """Free the OpenGL resources."""
        if self._context is not None:
            self._context.free()


def default_view(model: Any, camera: Any) -> None:
    """Set a camera to the default view of a square picture."""
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.lookat[:2] = 0.0  # the flotor's axis


def zoom(area: Area) -> float:
    """Return the factor of the default view's distance at which the device fits an area."""
    return max(_HIGH, _WIDE * area.height / area.width)


def project(model: Any, camera: Any, area: Area, point: Array) -> tuple[Array, Array, Array]:
    """Return a point's pixel, (2,), and the displacement of one pixel right and up there [m], (3,) each.

    Args:
        model: Compiled model.
        camera: Free camera.
        area: Area of the 3D view.
        point: The point [m], (3,).
    """
    azimuth, lift = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array([math.cos(lift) * math.cos(azimuth), math.cos(lift) * math.sin(azimuth), math.sin(lift)])
    across = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    up, away = np.cross(across, forward), point - (camera.lookat - camera.distance * forward)
    pixel = 2.0 * float(away @ forward) * math.tan(math.radians(0.5 * model.vis.global_.fovy)) / area.height
    return area.centre + np.array([away @ across, away @ up]) / pixel, pixel * across, pixel * up
