"""The library that draws off screen: MUJOCO_GL's, else the first that works."""

import os
import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from maglev_mj.errors import ParameterError
from maglev_mj.views.window import backend
from maglev_mj.views.window.backend import DisplayError, drawing_library
from tests.processes import run_here

RENDER = "render drop --out a.png --size 160x160 --seconds 0.02"


BOTH = f"""
import sys
from maglev_mj.cli import main
assert main(["drop", "--duration", "0.05"]) == 0
sys.exit(main({RENDER.split()}))
"""


def say(command: str, folder: Any, word: str) -> tuple[int, str]:
    return run(["-m", "maglev_mj", *command.split()], folder, word)


def run(arguments: list[str], folder: Any, word: str, **more: str) -> tuple[int, str]:
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**environment, "MUJOCO_GL": word, **more},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120.0,
    )
    return done.returncode, done.stderr


@pytest.mark.needs("linux")
def test_a_window_library_without_a_display_is_one_line(tmp_path: Any) -> None:
    status, told = say(RENDER, tmp_path, "glfw")
    assert status == 1 and "Traceback" not in told and "Warning" not in told
    assert told.startswith("maglev-mj render: cannot render with glfw (needs a display with OpenGL"), told


@pytest.mark.needs("linux")
def test_a_missing_library_stops_only_rendering(tmp_path: Any) -> None:
    """The engine loads it by itself, and would not be loaded then."""
    (tmp_path / "OpenGL.py").write_text("raise AttributeError('no library')\n")
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    status, told = run(["-c", BOTH], tmp_path, "osmesa", PYTHONPATH=paths)
    assert (status, told.count("\n")) == (1, 1), told
    assert told.startswith("maglev-mj render: cannot render with osmesa (needs `apt install lib"), told


def test_disabled_rendering_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    status, _, told = run_here(*RENDER.split())
    assert status == 1 and told.startswith("maglev-mj render: MUJOCO_GL=off disables rendering: unset it"), told


@pytest.mark.needs("drawing")
def test_the_first_working_library_renders(tmp_path: Any) -> None:
    status, told = say(RENDER, tmp_path, "")
    assert (status, told) == (0, "")
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.fixture(autouse=True)
def anew() -> Iterator[None]:
    yield
    backend._first_working.cache_clear()


def works(monkeypatch: pytest.MonkeyPatch, *names: str) -> list[str]:
    """Let these libraries work alone; return those tried."""
    tried = list[str]()

    def run(command: list[str], *, env: dict[str, str], **_: Any) -> SimpleNamespace:
        tried.append(env["MUJOCO_GL"])
        assert f"mujoco.{tried[-1]} " in command[-1]
        return SimpleNamespace(returncode=tried[-1] not in names)

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(subprocess, "run", run)
    backend._first_working.cache_clear()
    return tried


@pytest.mark.needs("linux")
@pytest.mark.parametrize("working", [("osmesa", "egl", "glfw"), ("egl", "glfw"), ("glfw",)])
def test_libraries_are_tried_in_order_until_one_works(
    working: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = works(monkeypatch, *working)
    assert drawing_library() == drawing_library() == working[0] == tried[-1]
    assert tried == ["osmesa", "egl", "glfw"][: len(tried)]  # once


@pytest.mark.needs("linux")
def test_the_error_without_a_library_names_the_package_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    works(monkeypatch)
    with pytest.raises(DisplayError, match=r"no working OpenGL library among osmesa, egl, glfw: .* libosmesa6"):
        drawing_library()


@pytest.mark.needs("linux")
def test_mujoco_gl_takes_precedence(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = works(monkeypatch, "osmesa")
    for word, library in {"egl": "egl", "OSMesa": "osmesa", "glx": "glfw"}.items():
        monkeypatch.setenv("MUJOCO_GL", word)
        assert drawing_library() == library
        assert os.environ["MUJOCO_GL"] == word
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    with pytest.raises(ParameterError, match=r"or unset \(got 'nothing'"):
        drawing_library()
    assert not tried
