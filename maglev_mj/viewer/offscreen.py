"""The same picture without a window: shapes, plots and words, drawn into an array."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import MaglevError
from maglev_mj.parameters import flag
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.viewer.overlay import help_text, status_text
from maglev_mj.viewer.plots import Plots
from maglev_mj.viewer.scenery import Scenery

__all__ = ["DisplayError", "OffscreenPainter", "arranged", "label_place"]

_SHADOWS, _SAMPLES = 2048, 4
_NEEDS = {"osmesa": "on Debian libosmesa6", "egl": "on Debian libegl1 and libgl1", "glfw": "and a display"}
_SMALL, _HELPED = 600, 500
_LABEL, _MARGIN = (280, 34), 6


class DisplayError(MaglevError):
    """There is nothing to draw with or to draw on."""


def column(width: int) -> int:
    """Return how wide the column of plots is in a picture so wide, in pixels; their titles need some room."""
    return max(int(0.27 * width), min(250, width // 2))


def arranged(width: int, height: int) -> list[Any]:
    """Return where the four plots go in a picture: a column at its right."""
    wide, high = column(width), height // 4
    return [mujoco.MjrRect(width - wide, height - (place + 1) * high, wide, high) for place in range(4)]


def label_place(width: int, height: int) -> Any:
    """Return where the emergency stop's label goes: at the bottom, left of the plots."""
    free = width - column(width)
    return mujoco.MjrRect(max(free - _LABEL[0] - _MARGIN, 0), _MARGIN, min(_LABEL[0], free), _LABEL[1])


class OffscreenPainter:
    """Draws snapshots of one scene into arrays, by OSMesa or EGL as MUJOCO_GL says; by OSMesa where it says nothing.

    Args:
        scene: The scene.
        width: Of the pictures [pixels].
        height: Likewise.
        plots: Whether plots and words are in them.
        backend: What to draw with: osmesa, egl, or glfw, which needs a display; None for what MUJOCO_GL says. A
            program in which a window was opened can only use glfw.

    Raises:
        DisplayError: If there is no library to draw with.
        ModelError: If the scene cannot be used.
    """

    def __init__(
        self, scene: Scene, width: int, height: int, *, plots: bool = True, backend: str | None = None
    ) -> None:
        self._plots = Plots() if flag("plots", plots) else None
        self.scenery = Scenery(scene)
        self._whole = mujoco.MjrRect(0, 0, width, height)
        model = self.scenery.model
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.shadowsize, model.vis.quality.offsamples = _SHADOWS, _SAMPLES
        self._gl = _context(width, height, backend or os.environ.get("MUJOCO_GL", "").lower() or "osmesa")
        self._gl.make_current()
        self._scene = mujoco.MjvScene(model, 2000)
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, self._camera)
        scales = mujoco.mjtFontScale
        scale = scales.mjFONTSCALE_50 if height < _SMALL else scales.mjFONTSCALE_100
        self._render = mujoco.MjrContext(model, scale)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._render)

    def wait(self, snapshot: Snapshot) -> None:
        """Wait until all that the plots need is known."""
        if self._plots is not None:
            self._plots.wait(snapshot)

    def picture(self, snapshot: Snapshot) -> NDArray[np.uint8]:
        """Return a picture, (height, width, 3)."""
        scenery, scene, whole, render = self.scenery, self._scene, self._whole, self._render
        self._gl.make_current()
        scenery.place(snapshot)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(scenery.model, scenery.data, self._option, None, self._camera, everything, scene)
        scenery.decorate(scene, snapshot)
        mujoco.mjr_render(whole, scene, render)
        if self._plots is not None:
            for rectangle, figure in zip(
                arranged(whole.width, whole.height), self._plots.update(snapshot), strict=True
            ):
                mujoco.mjr_figure(rectangle, figure, render)
            font, grid = mujoco.mjtFont.mjFONT_NORMAL, mujoco.mjtGridPos
            left = mujoco.MjrRect(0, 0, whole.width - column(whole.width), whole.height)
            mujoco.mjr_overlay(font, grid.mjGRID_TOPLEFT, left, *status_text(snapshot), render)
            if whole.height >= _HELPED:
                mujoco.mjr_overlay(font, grid.mjGRID_BOTTOMLEFT, left, *help_text(type(snapshot.scene)), render)
        pixels = np.empty((whole.height, whole.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, whole, render)
        return pixels[::-1]

    def close(self) -> None:
        """Let go of what it draws with."""
        self._render.free()
        self._gl.free()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _context(width: int, height: int, backend: str) -> Any:
    """Return an OpenGL context without a window to be seen."""
    if backend not in _NEEDS:
        raise DisplayError(f"MUJOCO_GL must be one of {', '.join(_NEEDS)} for a picture, not {backend!r}")
    try:
        return import_module(f"mujoco.{backend}").GLContext(width, height)
    except (ImportError, AttributeError, OSError, RuntimeError, TypeError) as error:
        raise DisplayError(f"pictures need {backend}, {_NEEDS[backend]}; MUJOCO_GL chooses: {error}") from error
