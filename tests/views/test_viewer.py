"""Viewer window on a virtual screen, moved by xdotool.

Pictures without a window too.
"""

import json
import math
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj.device import Knob
from maglev_mj.frames import Array
from maglev_mj.plants.hand import SpringHand
from maglev_mj.recording import Recording, RecordingError
from maglev_mj.recording.verify import verify
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import CENTRING, Joystick
from maglev_mj.session.replay import rebuild
from maglev_mj.views.window.painter import Scenery, default_view, project, zoom
from maglev_mj.views.window.screen import Area, Layout
from maglev_mj.views.window.window import fitted_size
from tests.views.virtual_screen import VirtualScreen, waited

needs_screen = pytest.mark.needs("screen", "xdotool")

SCREEN = 600, 400
VIEW = Area(0, 0, *fitted_size(*SCREEN))
RATE = 200
DRAG = 8
"""Pixels."""

FRAME = 0.25
"""Time of a frame on a slow screen [s]."""

PATIENCE = 60.0
"""Longest wait for a slow machine [s]."""

PRESSED = {
    "7": ("pulse", False),
    "8": ("friction", True),
    "6": ("wall", False),
    "Up": ("stiffness", 7500.0),
    "Down": ("stiffness", 6000.0),
    "period": ("damping", 100.0),
    "comma": ("damping", 80.0),
    "F9": ("period", 0.002),
    "F8": ("period", 0.005),
    "apostrophe": ("delay", 0.002),
    "semicolon": ("delay", 0.0015),
}
"""Effect of each key, one after the other.

Keys by xdotool's name, settings and values.
"""


@dataclass
class Session:
    """Results of a session by mouse and keys."""

    status: int
    said: str
    folder: Path
    paused: int
    """Samples while it is paused."""

    @property
    def recordings(self) -> list[Recording]:
        """In the order in which they were made."""
        return [Recording.load(path) for path in sorted(self.folder.glob("*.maglev"))]


def whole(folder: Path) -> list[Path]:
    """Return the closed recordings.

    Files exist from their start on.
    """
    found = []
    for path in folder.glob("*.maglev"):
        with suppress(RecordingError):
            found += [path] if not Recording.load(path).damage else []
    return found


class Watched:
    """Scene behind a window, which writes each snapshot to a file; a slow machine is waited for.

    Args:
        path: The file, see `tests/views/watched_view.py`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        waited(path.exists, PATIENCE)

    def _snapshots(self) -> Iterator[dict[str, Any]]:
        """Yield the snapshots from now on, as they come."""
        line, end = "", time.monotonic() + PATIENCE
        with self._path.open(encoding="utf-8") as file:
            file.seek(0, os.SEEK_END)
            while time.monotonic() < end:
                line += file.readline()
                if line.endswith("\n"):
                    yield json.loads(line)
                    line = ""
                else:
                    time.sleep(0.01)
        raise AssertionError("waited in vain")

    def until(self, so: Callable[[dict[str, Any]], bool], samples: int = 0) -> None:
        """Wait until a condition has held for a number of samples."""
        first: int | None = None
        for snapshot in self._snapshots():
            first = None if not so(snapshot) else snapshot["tick"] if first is None else first
            if first is not None and snapshot["tick"] - first >= samples:
                return

    def set_to(self, name: str, value: object) -> None:
        """Wait until a parameter has a value."""
        self.until(lambda snapshot: bool(snapshot[name] == pytest.approx(value)))

    def later(self, seconds: float) -> None:
        """Wait for some time of the scene."""
        self.until(lambda _: True, round(seconds * RATE))

    def samples(self, count: int) -> int:
        """Return how many samples come from the first to the last of some snapshots."""
        first, *_, last = islice(self._snapshots(), count)
        return int(last["tick"] - first["tick"])


@pytest.fixture(scope="module")
def screen() -> Iterator[VirtualScreen]:
    with VirtualScreen(*SCREEN) as screen:
        yield screen


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, screen: VirtualScreen) -> Session:
    """Drag, release, press every key, close the window."""
    folder = tmp_path_factory.mktemp("session")
    snapshots, watched = folder / "snapshots.jsonl", Path(__file__).with_name("watched_view.py")
    command = [sys.executable, str(watched), str(snapshots), "joystick", "--no-wall", "--out", str(folder)]
    program = subprocess.Popen(
        command, env=screen.environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        scene, window = Watched(snapshots), screen.window("joystick")
        scene.later(1.0)
        geometry = dict(line.split("=") for line in screen.xdotool("getwindowgeometry", "--shell", window).split())
        assert (int(geometry["WIDTH"]), int(geometry["HEIGHT"])) == fitted_size(*SCREEN)
        camera = framed(Joystick(), VIEW)
        right, up = project(Scenery(Joystick()).model, camera, Layout(VIEW, 100).device, Knob().centre)[0]
        middle = int(geometry["X"]) + round(right), int(geometry["Y"]) + VIEW.height - round(up)
        screen.xdotool("mousemove", *middle)  # keys go to the window under the mouse
        time.sleep(0.5)
        screen.xdotool("key", "F10")
        waited(lambda: list(folder.glob("*.maglev")), PATIENCE)
        screen.xdotool("mousemove", *middle, "mousedown", 1)
        # a slow frame that sees the press with the first move takes the drag for shorter
        scene.until(lambda snapshot: bool(snapshot["held"]))
        for step in range(1, 5):
            screen.xdotool("mousemove", middle[0] + DRAG * step // 4, middle[1])
        places: deque[Array] = deque(maxlen=2)

        def at_rest(snapshot: dict[str, Any]) -> bool:
            places.append(np.array(snapshot["pose"]))
            return bool(np.ptp(places, axis=0).max() < 1e-7)

        def held(snapshot: dict[str, Any]) -> bool:
            return any(snapshot["hand"])

        scene.until(lambda snapshot: at_rest(snapshot) and held(snapshot), round(1.5 * RATE))
        screen.xdotool("mouseup", 1)
        scene.until(lambda snapshot: at_rest(snapshot) and not held(snapshot), round(1.0 * RATE))
        screen.xdotool("key", "F10")
        waited(lambda: whole(folder), PATIENCE)
        aside = middle[0] - 150, middle[1] + 40
        screen.xdotool("mousemove", *aside, "mousedown", 1)  # beside the knob: the camera turns
        time.sleep(2.0 * FRAME)
        screen.xdotool("mousemove", aside[0] + 20, aside[1], "mouseup", 1)
        scene.until(lambda snapshot: not held(snapshot), round(0.5 * RATE))
        time.sleep(1.1)  # names go by the second
        screen.xdotool("key", "6", "key", "F10")  # the wall is back for the keys' own turn
        waited(lambda: len(list(folder.glob("*.maglev"))) == 2, PATIENCE)
        for key, (name, value) in PRESSED.items():
            scene.later(0.1)
            screen.xdotool("key", key)
            scene.set_to(name, value)
        for key, weightless in (("9", False), ("slash", True)):
            scene.later(0.1)
            screen.xdotool("key", key)
            scene.set_to("weightless", weightless)
        scene.later(0.3)
        screen.xdotool("key", "space")
        scene.set_to("state", "paused")
        paused = scene.samples(30)
        screen.xdotool("key", "space")
        scene.later(0.3)
        screen.xdotool("key", "Return")
        scene.set_to("scene", "drop")
        scene.later(0.1)
        screen.xdotool("key", "F10", "key", "F12")  # at once: the one is written while the other is drawn
        waited(lambda: list(folder.glob("*.png")), PATIENCE)
        waited(lambda: len(whole(folder)) == 2, PATIENCE)
        screen.xdotool("key", "Return")  # to the next scene; its model is loaded by the frame after the next
        scene.until(lambda snapshot: snapshot["scene"] != "drop")
        screen.close(window)  # the load is not waited for
        said, _ = program.communicate(timeout=PATIENCE)
    finally:
        program.kill()
        program.communicate()
    return Session(program.returncode, said, folder, paused)


@needs_screen
def test_a_window_closed_while_it_loads_a_model_ends_the_program(session: Session) -> None:
    assert session.status == 0, session.said
    assert session.said.count("wrote") == 2  # two recordings
    assert "real-time factor" in session.said


@needs_screen
def test_a_drag_moves_the_flotor_by_the_hands_stiffness(session: Session) -> None:
    # Far end of the spring from pixels and camera alone; then two springs in balance.
    recording = session.recordings[0]
    position = np.concatenate([segment.position for segment in recording.segments])
    hand = np.concatenate([segment.hand for segment in recording.segments])
    held = np.flatnonzero(np.abs(hand).max(axis=1) > 0.0)
    assert held.size > 20
    drawn = camera_drag(Joystick(), DRAG, VIEW)
    stiffness = SpringHand().stiffness
    expected = drawn * stiffness / (stiffness + CENTRING)
    settled = position[held[-20:], :3].mean(axis=0)
    assert np.linalg.norm(settled - expected) < 0.1 * np.linalg.norm(expected)
    assert np.linalg.norm(hand[held[-1], :3]) == pytest.approx(CENTRING * np.linalg.norm(settled), rel=0.02)


@needs_screen
def test_the_flotor_returns_on_release(session: Session) -> None:
    segment = session.recordings[0].segments[-1]
    assert not segment.hand[-100:].any()
    assert np.abs(segment.position[-1]).max() < 1e-5


@needs_screen
def test_a_session_by_mouse_replays_bit_for_bit(session: Session) -> None:
    for recording in session.recordings:
        verdict = verify(recording, rebuild)
        assert verdict.same, verdict
        assert verdict.ticks


@needs_screen
def test_keys_match_the_help(session: Session) -> None:
    segments = session.recordings[1].segments
    settings = [segment.setup["parameters"] for segment in segments]
    for before, after, (name, value) in zip(settings, settings[1:], PRESSED.values(), strict=False):
        assert after[name] == pytest.approx(value)
        assert {key for key in after if after[key] != before[key]} == {name}
    dropped, centred, following = segments[len(PRESSED) + 1 : len(PRESSED) + 4]
    assert dropped.setup["plant"]["pose"][2] == 0.004
    assert not dropped.setup["parameters"]["weightless"]
    assert centred.setup["plant"]["pose"] == [0.0] * 6
    assert centred.setup["parameters"]["weightless"]
    # time passes before and after a pause, and not in it
    assert len(centred.tick) * centred.setup["parameters"]["period"] > 0.6
    assert session.paused == 0
    assert following.setup["scene"] == "drop"


@needs_screen
def test_a_screenshot_is_written(session: Session) -> None:
    (path,) = session.folder.glob("*.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def framed(scene: Scene, view: Area) -> Any:
    """Return the camera of a window on a scene."""
    model, camera = Scenery(scene).model, mujoco.MjvCamera()
    default_view(model, camera)
    camera.distance *= zoom(Layout(view, 100).device)
    return camera


def camera_drag(scene: Scene, pixels: int, view: Area) -> Array:
    """Return the grip's motion for a drag right [m], (3,).

    By the camera of a window alone.
    """
    camera = framed(scene, view)
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    depth = float((Knob().centre - camera.lookat) @ forward) + camera.distance
    across = 2.0 * depth * math.tan(math.radians(0.5 * 45.0))  # of the whole picture's height
    right = np.cross(forward, [0.0, 0.0, 1.0])
    drawn: Array = pixels / view.height * across * right / np.linalg.norm(right)
    return drawn
