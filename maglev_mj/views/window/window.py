"""Window of a session in MuJoCo's viewer; the mouse is the hand."""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import closing, suppress
from itertools import count
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import glfw
import numpy as np

from maglev_mj.errors import MaglevError
from maglev_mj.frames import Array, rotation_matrix, rotation_vector
from maglev_mj.lazy import mujoco
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.shapes import GRIP, KNOB
from maglev_mj.process import interrupts_held
from maglev_mj.session import FrameClock, Note, Snapshot, SnapshotSource, real_time
from maglev_mj.views.magnifier import magnified, true_pose
from maglev_mj.views.viewer_process import ShowReport
from maglev_mj.views.window.backend import DisplayError
from maglev_mj.views.window.keys import AXIS, CAMERA, KEYS, MAGNIFY, SCREENSHOT, keys_of
from maglev_mj.views.window.layout import Area
from maglev_mj.views.window.offscreen import OffscreenPainter, write_picture
from maglev_mj.views.window.scenery import Framing, Scenery
from maglev_mj.views.window.screen import Screen, moved_by_mouse

_SMALL, _LIMITS, _LARGE = (0.92, 0.88), (1200, 800), 2.0 / 3.0
"""Fractions of a small screen, width and height; their limits [pixels]; fraction of a large screen."""


def fitted_size(width: int, height: int) -> tuple[int, int]:
    """Return the window size [pixels]: most of a small screen, two thirds of a large one."""
    sizes = (int(max(min(s * a, m), _LARGE * a)) for s, a, m in zip(_SMALL, (width, height), _LIMITS))
    return next(sizes), next(sizes)


class Grab:
    """Filter that takes plain left drags of the knob from MuJoCo's viewer and passes on all other mouse events.

    Attributes:
        moved: Displayed displacement of the held knob [m], (3,); None if not held.
        knob: Projection of the knob, see `Framing.project`; None if the mouse is not the hand.
    """

    def __init__(self) -> None:
        self.moved: Array | None = None
        self.knob: tuple[Array, Array, Array] | None = None
        self._start = np.zeros(2)
        self._callbacks: tuple[Any, ...] = ()

    def attach(self, window: Any) -> None:
        """Set a window's size and mouse callbacks; call it in the thread that polls events."""
        with warnings.catch_warnings():  # some window systems do not let a program position its windows
            warnings.simplefilter("ignore")
            left, top, wide, high = glfw.get_monitor_workarea(glfw.get_primary_monitor())
            size = fitted_size(wide, high)
            glfw.set_window_size(window, *size)
            glfw.set_window_pos(window, left + (wide - size[0]) // 2, top + (high - size[1]) // 2)
        inner: Any = glfw  # its public setters do not return the previous callbacks
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
        pressed = raw.glfwSetMouseButtonCallback(window, calls[0])
        pointed = raw.glfwSetCursorPosCallback(window, calls[1])
        self._callbacks = calls, pressed, pointed  # ctypes keeps no reference

    def _take(self, window: Any) -> bool:
        """Grab the knob if the pointer is on it; return True if it is held."""
        self._start, knob = _pixel(window), self.knob
        if knob is not None and np.linalg.norm(self._start - knob[0]) * np.linalg.norm(knob[1]) <= KNOB[0]:
            self.moved = np.zeros(3)
        return self.moved is not None


def _pixel(window: Any) -> Array:
    """Return the pointer's position from the lower left corner [pixels], (2,)."""
    (x, y), (wide, high) = glfw.get_cursor_pos(window), glfw.get_framebuffer_size(window)
    scale = wide / max(glfw.get_window_size(window)[0], 1)
    return np.array([scale * x, high - scale * y])


_FRAME = 1.0 / 60.0
_NAP = 0.001
_PATIENCE = 10.0
_SLOW_FRAME, _SLOW_TIME = 0.05, 1.0
_PICTURE = 1600, 1000


class SlowFrames:
    """Detector of slow drawing: reports once, after a second in which every frame took more than 50 ms.

    Args:
        clock: Clock of real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._since, self._reported = clock, -1.0, False

    def add(self, cost: float) -> bool:
        """Return True once, when drawing is slow.

        Args:
            cost: Time of the last frame [s].
        """
        now = self._clock()
        if self._reported or cost <= _SLOW_FRAME:
            self._since = -1.0
            return False
        if self._since < 0.0:
            self._since = now
        self._reported = now - self._since >= _SLOW_TIME
        return self._reported


class _Mouse(NamedTuple):
    """Drag of the flotor by MuJoCo's viewer: translation and rotation flags, target of the grip [m], quaternion."""

    pushes: bool
    twists: bool
    position: Array
    quaternion: tuple[float, float, float, float]


def require_display() -> None:
    """Check that a window can be opened.

    Raises:
        DisplayError: If there is no display or no OpenGL library.
    """
    instead = "use --web (browser) or `maglev-mj render SCENE --out FILE.png` (picture)"
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise DisplayError(f"no display for a window (DISPLAY and WAYLAND_DISPLAY are not set): {instead}")
    # mjpython has loaded the viewer module and set this attribute
    if sys.platform == "darwin" and getattr(sys.modules.get("mujoco.viewer"), "_MJPYTHON", None) is None:
        raise DisplayError(
            "a window on macOS needs mjpython (part of mujoco): run `mjpython -m maglev_mj view`; or "
            "use `maglev-mj view --web` in a browser"
        )
    with warnings.catch_warnings():  # raised as DisplayError below
        warnings.simplefilter("ignore")
        if not glfw.init():
            raise DisplayError(f"cannot open a window on this display: {instead}")


def show(
    session: SnapshotSource, *, folder: Path = Path(), duration: float | None = None, shadows: bool | None = None
) -> ShowReport:
    """Show a session in a window and run it in real time until the window is closed.

    Args:
        session: Session to show.
        folder: Folder for screenshots.
        duration: Real time until the window closes [s]; None to wait for the user.
        shadows: True to draw shadows; None to turn them off when drawing is slow.

    Returns:
        Report of the frames and the session.

    Raises:
        DisplayError: If a window cannot be opened.
    """
    require_display()
    with interrupts_held():  # a half-open window cannot be closed, and its render thread would crash the exit
        window = _Window(session, folder, shadows)
    with closing(window), closing(session), engine_warnings_silenced():
        return window.run(duration)


class _Window:
    """Window of a session.

    Three threads: the caller's runs the ticks, a second passes snapshots to MuJoCo's viewer, the viewer renders in its
    own. Passing a snapshot blocks until a frame is drawn, which must not delay the ticks.
    """

    def __init__(self, session: SnapshotSource, folder: Path, shadows: bool | None) -> None:
        self._session, self._folder = session, folder
        self._screen, self._slow = Screen(), SlowFrames() if shadows is None else None
        self._scale = _font_scale()
        self._pressed: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._snapshots: queue.Queue[Snapshot | None] = queue.Queue(maxsize=1)
        self._mouse: _Mouse | None = None
        self._grab = Grab()
        self._grab_pose: Array | None = None
        self._note = Note()
        self._costs: list[float] = []
        self._failed: Exception | None = None
        self._pictures: list[threading.Thread] = []
        self._scenery = Scenery(session.snapshot().scene)
        self._framing, self._camera_back = Framing(self._scenery.model), True
        before = set(threading.enumerate())
        self._handle = _launch(self._scenery.model, self._scenery.data, self._pressed.put, self._grab)
        with self._handle.lock():  # for frames before our first
            self._framing.reset(self._handle.cam)
        if shadows is False:
            self._drop_shadows()
        self._painter = threading.Thread(target=self._paint, name="painter", daemon=True)
        self._threads = [thread for thread in threading.enumerate() if thread not in before]
        self._painter.start()

    def run(self, duration: float | None) -> ShowReport:
        """Run the ticks until the window is closed."""
        session, handle, due = self._session, self._handle, FrameClock(_FRAME)
        ticks, wall_time = 0, 0.0
        for elapsed, passed in real_time(duration, _NAP):
            ticks, wall_time = ticks + session.tick(elapsed), passed
            if self._failed is not None:
                raise self._failed
            self._press_keys()
            self._guide_hand()
            if self._snapshots.empty() and due():
                self._snapshots.put(session.snapshot())
            if not handle.is_running():
                break
        costs = self._costs
        return ShowReport(
            frames=len(costs),
            frame_cost=median(costs) if costs else 0.0,
            wall_time=wall_time,
            simulated=session.simulated,
            ticks=ticks,
            missed=session.snapshot().missed,
        )

    def close(self) -> None:
        """Close the window and join its threads, which must not outlive the program."""
        self._handle.close()
        simulation = self._handle._sim()
        loading = simulation is not None and simulation.loading  # that load never returns
        end = time.monotonic() + (_NAP if loading else _PATIENCE)
        while self._painter.is_alive() and time.monotonic() < end:
            with suppress(queue.Full):
                self._snapshots.put(None, timeout=0.1)
            self._painter.join(0.1)
        for thread in (*self._pictures, *self._threads):
            thread.join(_PATIENCE)

    def _press_keys(self) -> None:
        """Perform the actions of the keys pressed since the last tick."""
        while not self._pressed.empty():
            code, snapshot = self._pressed.get(), self._session.snapshot()
            self._screen.note_engine_key(code)
            action = keys_of(snapshot.actions).get(code)
            if action == SCREENSHOT:
                path = _new_picture(self._folder)
                thread = threading.Thread(target=self._picture, args=(snapshot, path))
                self._pictures.append(thread)
                thread.start()
            elif action == CAMERA:
                self._camera_back = True
            elif action in (AXIS, KEYS, MAGNIFY):
                self._screen.press(action, snapshot.scene)
            elif action is not None:
                try:
                    self._session.act(action)
                except (MaglevError, OSError) as error:  # for example a rate that no controller supports
                    self._note.say(str(error))

    def _guide_hand(self) -> None:
        """Set the hand's target from the mouse, or release the hand."""
        mouse, self._mouse, moved = self._mouse, None, self._grab.moved
        if mouse is None and moved is None:
            return
        hand = self._session.hand
        if moved is None and not (mouse is not None and (mouse.pushes or mouse.twists)):
            self._grab_pose = None
            if hand.target is not None:
                hand.target = None
            return
        pose = self._session.snapshot().pose
        start = self._grab_pose = pose if self._grab_pose is None else self._grab_pose
        goal, turned = pose[:3], pose[3:]
        if mouse is not None and moved is None:
            turned = np.array(rotation_vector(*mouse.quaternion)) if mouse.twists else turned
            moved = mouse.position - rotation_matrix(start[3:]) @ GRIP - start[:3] if mouse.pushes else None
        if moved is not None:
            goal, self._screen.dragged = start[:3] + true_pose(moved, self._screen.factor), True
        hand.target = [float(part) for part in (*goal, *turned)]

    def _paint(self) -> None:
        """Pass snapshots to the viewer until None arrives."""
        while (snapshot := self._snapshots.get()) is not None:
            begun = time.perf_counter()
            try:
                self._draw(snapshot)
            except Exception as error:
                if self._handle.is_running():  # else the window was closed
                    self._failed = error
                return
            cost = time.perf_counter() - begun
            self._costs.append(cost)
            if self._slow is not None and self._slow.add(cost):
                self._drop_shadows()
                self._note.say("Shadows off: slow drawing. S turns them on.")

    def _drop_shadows(self) -> None:
        with self._handle.lock():
            self._handle.user_scn.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0

    def _draw(self, snapshot: Snapshot) -> None:
        handle = self._handle
        if not handle.is_running():
            return
        if snapshot.scene.model != self._scenery.path:
            self._scenery = Scenery(snapshot.scene)
            self._framing, self._camera_back = Framing(self._scenery.model), True
            # the handle cannot change the model, but its simulation can
            simulation = handle._sim()
            simulation.loading = True  # set before the check: a window closed from here on is not destroyed
            if not handle.is_running():
                return
            simulation.load(self._scenery.model, self._scenery.data, "")
            simulation.loading = False
        scenery, framing, rectangle = self._scenery, self._framing, handle.viewport
        over = None
        if rectangle is not None and min(rectangle.width, rectangle.height) > 0:
            view = Area(rectangle.left, rectangle.bottom, rectangle.width, rectangle.height)
            over = self._screen.draw(snapshot, view, self._scale, self._note.lines)
        with handle.lock():
            factor = self._screen.factor
            scenery.set_pose(snapshot, factor)
            scene = handle.user_scn
            scene.ngeom = 0
            scenery.decorate(scene, snapshot, factor)
            if over is not None:
                if self._camera_back:
                    self._camera_back = False
                    framing.reset(handle.cam)
                framing.follow(handle.cam, view, over.layout.handle)
                pose = magnified(snapshot, factor).pose
                knob = pose[:3] + rotation_matrix(pose[3:]) @ GRIP
                self._grab.knob = framing.project(handle.cam, view, knob) if moved_by_mouse(snapshot) else None
                if (corner := framing.corner(handle.cam, view, over.layout.handle)) is not None:
                    scenery.draw_axes(scene, *corner)
            self._mouse = _mouse(handle.perturb)
            handle.perturb.select = scenery.flotor  # selected without a double click
            handle.perturb.localpos[:] = GRIP
        if over is not None:
            handle.set_figures(over.figures)
            handle.set_texts(over.texts)
        handle.sync()

    def _picture(self, snapshot: Snapshot, path: Path) -> None:
        """Write a screenshot, rendered off screen at a fixed size."""
        try:
            # a process can load one OpenGL library: the window's, unless MUJOCO_GL is set
            with self._handle.lock():  # not while a model loads: MuJoCo's table of GL functions is global
                painter = OffscreenPainter(snapshot.scene, *_PICTURE, default="glfw", factor=self._screen.factor)
            with closing(painter):
                write_picture(painter.picture(snapshot), path)
            self._note.say(f"wrote {path}")
        except (MaglevError, OSError, mujoco.FatalError) as error:
            self._note.say(f"no screenshot: {error}")


def _launch(model: mujoco.MjModel, data: mujoco.MjData, key_callback: Callable[[int], object], grab: Grab) -> Any:
    """Open MuJoCo's passive viewer on a model; return its handle."""
    from mujoco import viewer  # needs a display

    engine: Any = viewer
    plain = engine._Simulate

    class Simulation(engine._Simulate):  # type: ignore[misc]
        """MuJoCo's simulation with our mouse callbacks, and a window that may be closed during a load.

        A load waits for the render thread, which a closed window has ended: destroying the simulation would wait for
        the load indefinitely while holding the GIL.
        """

        loading = False

        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            grab.attach(glfw.get_current_context())  # the thread that polls events

        def destroy(self) -> None:
            """Destroy the simulation unless it is loading."""
            if not self.loading:
                super().destroy()

    engine._Simulate = Simulation  # launch_passive takes no mouse callback
    try:
        return viewer.launch_passive(model, data, key_callback=key_callback, show_left_ui=False, show_right_ui=False)
    finally:
        engine._Simulate = plain


def _mouse(perturb: Any) -> _Mouse:
    active = int(perturb.active)
    return _Mouse(
        pushes=bool(active & int(mujoco.mjtPertBit.mjPERT_TRANSLATE)),
        twists=bool(active & int(mujoco.mjtPertBit.mjPERT_ROTATE)),
        position=perturb.refselpos.copy(),
        quaternion=tuple(perturb.refquat.tolist()),
    )


def _font_scale() -> int:
    """Return MuJoCo's font scale on this screen [%], which its viewer does not report."""
    if not (monitor := glfw.get_primary_monitor()):
        return 100
    if sys.platform == "darwin":
        dpi = 100.0 * glfw.get_monitor_content_scale(monitor)[0]
    else:
        width, _ = glfw.get_monitor_physical_size(monitor)
        dpi = 25.4 * glfw.get_video_mode(monitor).size.width / width if width else 0.0
        dpi = dpi if 50.0 < dpi < 350.0 else 150.0
    return min(max(50 * round(0.02 * dpi), 100), 300)


def _new_picture(folder: Path) -> Path:
    return next(path for number in count(1) if not (path := folder / f"maglev-{number:03d}.png").exists())
