"""Window of a session; the mouse is the hand."""

from __future__ import annotations

import os
import sys
import time
import warnings
from itertools import count
from pathlib import Path
from typing import Any

import glfw
import numpy as np

from maglev_mj.errors import MaglevError
from maglev_mj.files import atomic_path
from maglev_mj.frames import Array
from maglev_mj.session import FrameClock, Note, Snapshot, SnapshotSource, real_time
from maglev_mj.views.handle import dragged_pose
from maglev_mj.views.window.backend import DisplayError
from maglev_mj.views.window.keys import AXIS, CAMERA, KEYS, SCREENSHOT, keys_of
from maglev_mj.views.window.offscreen import write_picture
from maglev_mj.views.window.painter import Painter
from maglev_mj.views.window.screen import Area, Screen, moved_by_mouse

_SMALL, _LIMITS, _LARGE = (0.92, 0.88), (1200, 800), 2.0 / 3.0
_NO_MONITOR = 0, 0, 1280, 800  # area for windows [pixels]
"""Fractions of a small screen, width and height; their limits [pixels]; fraction of a large screen."""

_FRAME, _NAP = 1.0 / 60.0, 0.002
_SLOW_FRAME = 0.05
"""Time of a frame [s] above which shadows and smooth edges are left out, as where the processor draws."""

_HANDS = {0: "push", glfw.MOD_SHIFT: "tilt", glfw.MOD_CONTROL: "twist"}
"""Motion of the handle by the modifier of a drag of the knob."""


def fitted_size(width: int, height: int) -> tuple[int, int]:
    """Return the window size [pixels]: most of a small screen, two thirds of a large one."""
    sizes = (int(max(min(s * a, m), _LARGE * a)) for s, a, m in zip(_SMALL, (width, height), _LIMITS))
    return next(sizes), next(sizes)


def require_display() -> None:
    """Check that a window can be opened.

    Raises:
        DisplayError: If there is no display or no OpenGL library.
    """
    instead = "use --web (browser) or `maglev-mj render SCENE --out FILE.png` (picture)"
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise DisplayError(f"no display for a window (DISPLAY and WAYLAND_DISPLAY are not set): {instead}")
    with warnings.catch_warnings():  # raised as DisplayError below
        warnings.simplefilter("ignore")
        if not glfw.init():
            raise DisplayError(f"cannot open a window on this display: {instead}")


def show(source: SnapshotSource, *, folder: Path = Path()) -> None:
    """Show a session in a window until the user closes it.

    Args:
        source: Session to show.
        folder: Folder for screenshots.

    Raises:
        DisplayError: If a window cannot be opened.
        MaglevError: If the session ends.
    """
    require_display()
    try:
        _Window(source, folder).run()
    finally:
        glfw.terminate()


class _Window:
    """Window of a source: keys act on it, drags of the knob move its hand, other drags the camera."""

    def __init__(self, source: SnapshotSource, folder: Path) -> None:
        self._source, self._folder = source, folder
        self._screen, self._note, self._picture = Screen(), Note(), False
        for smooth in (True, False):
            self._window = _opened(f"maglev-mj: {source.snapshot().scene.name}", smooth)
            self._painter = Painter(source.snapshot().scene, self._screen, scale=_font_scale(), shadows=smooth)
            times = [self._draw() for _ in range(3)]
            if not smooth or min(times) < _SLOW_FRAME:
                break
            self._painter.close()
            glfw.destroy_window(self._window)
        glfw.show_window(self._window)
        self._drag, self._start = "", np.zeros(2)
        self._held: tuple[Snapshot, Array, Array] | None = None
        glfw.set_key_callback(self._window, self._key)
        glfw.set_mouse_button_callback(self._window, self._button)
        glfw.set_cursor_pos_callback(self._window, self._move)
        glfw.set_scroll_callback(self._window, self._scroll)

    def run(self) -> None:
        """Show the source until the window is closed."""
        due = FrameClock(_FRAME)
        for elapsed, _ in real_time(None, _NAP):
            self._source.tick(elapsed)
            glfw.poll_events()
            if glfw.window_should_close(self._window):
                return
            if due():
                self._draw()

    def _draw(self) -> float:
        """Draw a frame; return its time [s]."""
        begun, view, painter = time.perf_counter(), self._view(), self._painter
        if min(view.width, view.height) == 0:  # minimised
            return 0.0
        painter.draw(self._source.snapshot(), view, self._note.lines)
        if self._picture:
            self._picture = False
            self._write(painter.pixels(view))
        glfw.swap_buffers(self._window)
        return time.perf_counter() - begun

    def _write(self, pixels: Any) -> None:
        """Write a screenshot, and say where."""
        path = next(path for number in count(1) if not (path := self._folder / f"maglev-{number:03d}.png").exists())
        try:
            with atomic_path(path) as partial:
                write_picture(pixels, partial)
            self._note.say(f"wrote {path}")
        except (MaglevError, OSError) as error:
            self._note.say(f"no screenshot: {error}")

    def _view(self) -> Area:
        return Area(0, 0, *glfw.get_framebuffer_size(self._window))

    def _key(self, window: Any, code: int, scan: int, action: int, modifiers: int) -> None:
        """Perform the action of a key."""
        snapshot = self._source.snapshot()
        name = keys_of(snapshot.actions).get(code) if action == glfw.PRESS else None
        if name == SCREENSHOT:
            self._picture = True
        elif name == CAMERA:
            self._painter.reset()
        elif name in (AXIS, KEYS):
            self._screen.press(name, snapshot.scene)
        elif name is not None:
            self._source.act(name)

    def _button(self, window: Any, number: int, action: int, modifiers: int) -> None:
        """Begin or end a drag."""
        if action == glfw.RELEASE:
            self._drag, self._held, self._source.hand.target = "", None, None
            return
        self._start, snapshot = self._pixel(), self._source.snapshot()
        self._drag = "orbit" if number == glfw.MOUSE_BUTTON_LEFT else "pan"
        knob = self._painter.knob(snapshot, self._view())
        near = np.linalg.norm(self._start - knob[0]) * np.linalg.norm(knob[1]) <= snapshot.scene.hardware.knob.radius
        if near and self._drag == "orbit" and modifiers in _HANDS and moved_by_mouse(snapshot):
            self._drag, self._held = _HANDS[modifiers], (snapshot, *knob[1:])
            self._move(window, 0.0, 0.0)

    def _move(self, window: Any, x: float, y: float) -> None:
        """Move the hand or the camera."""
        right, up = moved = self._pixel() - self._start
        if self._held is not None:
            snapshot, across, above = self._held
            pose, knob = snapshot.pose, snapshot.scene.hardware.knob
            target = dragged_pose(pose, right * across + up * above, knob, tilts=self._drag == "tilt")
            if self._drag == "twist":  # as if the mouse rolled the knob
                target = pose + np.eye(6)[5] * right * np.linalg.norm(across) / knob.radius
            self._source.hand.target = [float(part) for part in target]
        elif self._drag:
            view = self._view()
            across, above = moved / max(view.height, 1)
            if self._drag == "orbit":
                self._painter.orbit(across, above)
            else:
                self._painter.pan(across, above, view)
            self._start = self._start + moved

    def _scroll(self, window: Any, _: float, turns: float) -> None:
        """Zoom."""
        self._painter.camera.distance *= 0.95**turns

    def _pixel(self) -> Array:
        """Return the pointer's position from the lower left corner [pixels], (2,)."""
        (x, y), (wide, high) = glfw.get_cursor_pos(self._window), glfw.get_framebuffer_size(self._window)
        scale = wide / max(glfw.get_window_size(self._window)[0], 1)
        return np.array([scale * x, high - scale * y])


def _opened(title: str, smooth: bool) -> Any:
    """Return a new hidden window in the middle of the screen, with its OpenGL context current; edges smooth or not."""
    left, top, wide, high = _work_area()
    size = fitted_size(wide, high)
    glfw.window_hint(glfw.VISIBLE, False)
    glfw.window_hint(glfw.SAMPLES, 4 * smooth)
    with warnings.catch_warnings():  # some window systems do not let a program position its windows
        warnings.simplefilter("ignore")
        if not (window := glfw.create_window(*size, title, None, None)):
            raise DisplayError("cannot open a window: the display has no OpenGL; use --web (browser)")
        glfw.set_window_pos(window, left + (wide - size[0]) // 2, top + (high - size[1]) // 2)
    glfw.make_context_current(window)
    glfw.swap_interval(1)
    return window


def _work_area() -> tuple[int, int, int, int]:
    """Return left, top, width and height of the area for windows; a common one if no monitor is connected."""
    monitor = glfw.get_primary_monitor()  # without one GLFW opens windows, and aborts when asked for this area
    return glfw.get_monitor_workarea(monitor) if monitor else _NO_MONITOR


def _font_scale() -> int:
    """Return MuJoCo's font scale for the resolution of this screen [%]."""
    scale = glfw.get_monitor_content_scale(monitor)[0] if (monitor := glfw.get_primary_monitor()) else 1.0
    return min(max(50 * round(2.0 * scale), 100), 300)
