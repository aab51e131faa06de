"""Size of the engine's window, and plain drags of the knob in it."""

from __future__ import annotations

import warnings
from typing import Any

import glfw
import numpy as np

from maglev_mj.frames import Array
from maglev_mj.plants.shapes import KNOB

_SHARES, _AT_MOST, _LARGE = (0.92, 0.88), (1200, 800), 2.0 / 3.0
"""Shares of a small screen, width and height; their largest size [pixels]; a large screen's share."""


def fitted_size(width: int, height: int) -> tuple[int, int]:
    """Return a window's size [pixels]: nearly a small screen's, two thirds of a large one's."""
    sizes = (int(max(min(s * a, m), _LARGE * a)) for s, a, m in zip(_SHARES, (width, height), _AT_MOST))
    return next(sizes), next(sizes)


class Grab:
    """Take plain left drags of the knob before the engine's viewer gets them.

    Others go on to it: they turn the camera.

    Attributes:
        moved: Displacement of the held knob in the drawing [m], (3,); None if it is not held.
        knob: Its place on the screen, see `Framing.seen`; None if no hand moves it.
    """

    def __init__(self) -> None:
        self.moved: Array | None = None
        self.knob: tuple[Array, Array, Array] | None = None
        self._start = np.zeros(2)
        self._kept: tuple[Any, ...] = ()

    def attach(self, window: Any) -> None:
        """Size a window of the engine, and take its mouse.

        The thread that polls its events calls this.
        """
        with warnings.catch_warnings():  # some screens place windows themselves
            warnings.simplefilter("ignore")
            left, top, wide, high = glfw.get_monitor_workarea(glfw.get_primary_monitor())
            size = fitted_size(wide, high)
            glfw.set_window_size(window, *size)
            glfw.set_window_pos(window, left + (wide - size[0]) // 2, top + (high - size[1]) // 2)
        inner: Any = glfw  # the package's own setters do not return the engine's callbacks
        raw = inner._glfw

        def button(which: Any, number: int, action: int, modifiers: int) -> None:
            if number == glfw.MOUSE_BUTTON_LEFT and action == glfw.RELEASE and self.moved is not None:
                self.moved = None
            elif number != glfw.MOUSE_BUTTON_LEFT or action != glfw.PRESS or modifiers or not self._take(window):
                pressed(which, number, action, modifiers)

        def cursor(which: Any, x: float, y: float) -> None:
            if self.moved is None or self.knob is None:
                pointed(which, x, y)
            else:
                right, up = _pixel(window) - self._start
                self.moved = right * self.knob[1] + up * self.knob[2]

        calls = inner._GLFWmousebuttonfun(button), inner._GLFWcursorposfun(cursor)
        pressed, pointed = (
            raw.glfwSetMouseButtonCallback(window, calls[0]),
            raw.glfwSetCursorPosCallback(window, calls[1]),
        )
        self._kept = calls, pressed, pointed

    def _take(self, window: Any) -> bool:
        """Take hold of the knob if the mouse points at it."""
        self._start, knob = _pixel(window), self.knob
        if knob is not None and np.linalg.norm(self._start - knob[0]) * np.linalg.norm(knob[1]) <= KNOB[0]:
            self.moved = np.zeros(3)
        return self.moved is not None


def _pixel(window: Any) -> Array:
    """Return the mouse's pixel, from the lower left corner, (2,)."""
    (x, y), (wide, high) = glfw.get_cursor_pos(window), glfw.get_framebuffer_size(window)
    scale = wide / max(glfw.get_window_size(window)[0], 1)
    return np.array([scale * x, high - scale * y])
