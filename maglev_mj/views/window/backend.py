"""Choice of the OpenGL library for offscreen rendering."""

from __future__ import annotations

import os
import sys
from functools import cache

from maglev_mj.errors import MaglevError, ParameterError, choice_message

_LIBRARIES = {"linux": ("osmesa", "egl", "glfw"), "darwin": ("cgl", "glfw")}.get(sys.platform, ("glfw",))
_WORDS = dict(zip(_LIBRARIES, _LIBRARIES)) | {"linux": {"glx": "glfw"}, "win32": {"wgl": "glfw"}}.get(sys.platform, {})
_ON, _OFF = ("", "on", "enable", "enabled", "true", "1"), ("off", "disable", "disabled", "false", "0")
_TRIAL = "from mujoco.{0} import GLContext; GLContext(8, 8).make_current()"
NEEDS = {
    "osmesa": "needs `apt install libosmesa6` on Debian",
    "egl": "needs `apt install libegl1 libgl1` on Debian",
    "glfw": "needs a display with OpenGL",
    "cgl": "needs a Mac with OpenGL",
}
"""Requirement of each library."""


class DisplayError(MaglevError):
    """Missing display or OpenGL library."""


def check_mujoco_gl() -> str:
    """Return the value of MUJOCO_GL, in lower case.

    Raises:
        ParameterError: If MuJoCo does not accept the value on this system.
    """
    value = os.environ.get("MUJOCO_GL", "")
    word = value.lower().strip()
    if word not in (*_WORDS, *_ON, *_OFF):
        raise ParameterError(choice_message("MUJOCO_GL", (*_WORDS, *_ON[1:], *_OFF), value, " or unset"))
    return word


def drawing_library() -> str:
    """Return the name of the OpenGL library for offscreen rendering.

    Order: MUJOCO_GL, the first that works: osmesa, egl, glfw on Linux; cgl, glfw on macOS; glfw on Windows.
    Each is tried in a process of its own, because a process can load only one.

    Raises:
        DisplayError: If none works, or MUJOCO_GL disables rendering.
        ParameterError: If MuJoCo does not accept the value of MUJOCO_GL on this system.
    """
    word = check_mujoco_gl()
    if word in _OFF:
        raise DisplayError(f"MUJOCO_GL={word} disables rendering: unset it, or use one of {', '.join(_LIBRARIES)}")
    return _WORDS.get(word) or _first_working()


@cache
def _first_working() -> str:
    import subprocess

    if getattr(sys, "frozen", False):  # it would start itself
        raise DisplayError(f"a frozen program cannot try OpenGL libraries: set MUJOCO_GL to {', '.join(_LIBRARIES)}")
    for name in _LIBRARIES:
        trial = [sys.executable, "-P", "-W", "error::UserWarning", "-c", _TRIAL.format(name)]  # glfw only warns
        environment = {**os.environ, "MUJOCO_GL": name}
        if subprocess.run(trial, env=environment, capture_output=True, check=False).returncode == 0:
            return name
    raise DisplayError(
        f"no working OpenGL library among {', '.join(_LIBRARIES)}: {_LIBRARIES[0]} {NEEDS[_LIBRARIES[0]]}"
    )
