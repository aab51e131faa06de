"""Drawing of scene, plots and text into an array.

No window is needed.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from maglev_mj.lazy import mujoco
from maglev_mj.parameters import flag
from maglev_mj.process import interrupts_held
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.views.window.backend import NEEDS, DisplayError, drawing_library
from maglev_mj.views.window.framing import Framing
from maglev_mj.views.window.layout import Area
from maglev_mj.views.window.scenery import Scenery
from maglev_mj.views.window.screen import Screen

_SHADOWS, _SAMPLES = 2048, 4
_LARGE = 1500


class OffscreenPainter:
    """Painter of one scene's snapshots into arrays.

    It draws with the library that MUJOCO_GL names, by default with the first that works.

    Args:
        scene: The scene.
        width: Width of the pictures [pixels].
        height: Height of the pictures [pixels].
        plots: True to include plots and text.
        default: Drawing library where MUJOCO_GL names none; None to look for one. A program that has opened a window
            can only use glfw.

    Raises:
        DisplayError: If there is no drawing library.
        ModelError: If the scene cannot be used.
    """

    def __init__(
        self, scene: Scene, width: int, height: int, *, plots: bool = True, default: str | None = None
    ) -> None:
        self._screen = Screen(keys=False) if flag("plots", plots) else None
        self.scenery = Scenery(scene)
        self._framing = Framing(self.scenery.model)
        self._whole = mujoco.MjrRect(0, 0, width, height)
        model = self.scenery.model
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.shadowsize, model.vis.quality.offsamples = _SHADOWS, _SAMPLES
        self._gl = _context(width, height, drawing_library(default))
        self._gl.make_current()
        self._scene = mujoco.MjvScene(model, 2000)
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._framing.reset(self._camera)
        self._scale = 150 if height >= _LARGE else 100
        self._render = mujoco.MjrContext(model, self._scale)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._render)

    def wait(self, snapshot: Snapshot) -> None:
        """Wait until all data of the plots is computed."""
        if self._screen is not None:
            self._screen.wait(snapshot.scene)

    def picture(self, snapshot: Snapshot) -> NDArray[np.uint8]:
        """Return a picture, (height, width, 3)."""
        scenery, scene, whole, render = self.scenery, self._scene, self._whole, self._render
        view = Area(0, 0, whole.width, whole.height)
        over = None if self._screen is None else self._screen.draw(snapshot, view, self._scale)
        self._gl.make_current()
        scenery.place(snapshot)
        self._framing.follow(self._camera, view, view if over is None else over.layout.handle)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(scenery.model, scenery.data, self._option, None, self._camera, everything, scene)
        scenery.decorate(scene, snapshot)
        if over is not None:
            if (corner := self._framing.corner(self._camera, view, over.layout.handle)) is not None:
                scenery.draw_axes(scene, *corner)
        mujoco.mjr_render(whole, scene, render)
        if over is not None:
            for rectangle, figure in over.figures:
                mujoco.mjr_figure(rectangle, figure, render)
            for font, grid, *columns in over.texts:
                mujoco.mjr_overlay(font, grid, whole, *columns, render)
        pixels = np.empty((whole.height, whole.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, whole, render)
        return pixels[::-1]

    def close(self) -> None:
        """Release the drawing resources."""
        self._render.free()
        self._gl.free()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _context(width: int, height: int, library: str) -> Any:
    """Return an OpenGL context without a visible window."""
    try:
        with interrupts_held(), warnings.catch_warnings():  # a context half made cannot be released
            warnings.simplefilter("error", UserWarning)  # glfw only warns of a missing display
            return import_module(f"mujoco.{library}").GLContext(width, height)
    except (ImportError, AttributeError, OSError, RuntimeError, TypeError, UserWarning) as error:
        raise DisplayError(f"pictures by {library} need {NEEDS[library]}; MUJOCO_GL chooses: {error}") from error
