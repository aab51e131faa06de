"""Choice of the library that draws off screen."""

from __future__ import annotations

import os
import sys
from functools import cache

from maglev_mj.errors import MaglevError, ParameterError, not_one_of

_LIBRARIES = {"linux": ("osmesa", "egl", "glfw"), "darwin": ("cgl", "glfw")}.get(sys.platform, ("glfw",))
_WORDS = dict(zip(_LIBRARIES, _LIBRARIES)) | {"linux": {"glx": "glfw"}, "win32": {"wgl": "glfw"}}.get(sys.platform, {})
_ON, _OFF = ("", "on", "enable", "enabled", "true", "1"), ("off", "disable", "disabled", "false", "0")
_TRIAL = "from mujoco.{0} import GLContext; GLContext(8, 8).make_current()"
NEEDS = {
    "osmesa": "on Debian `apt install libosmesa6`",
    "egl": "on Debian `apt install libegl1 libgl1`",
    "glfw": "a display with OpenGL",
    "cgl": "a Mac with OpenGL",
}
"""What each library needs."""


class DisplayError(MaglevError):
    """Error of a missing display or drawing library."""


def check_mujoco_gl() -> str:
    """Return the word of MUJOCO_GL, one that the engine knows on this system.

    Raises:
        ParameterError: If it is another.
    """
    given = os.environ.get("MUJOCO_GL", "")
    word = given.lower().strip()
    if word not in (*_WORDS, *_ON, *_OFF):
        raise ParameterError(not_one_of("MUJOCO_GL", (*_WORDS, *_ON[1:], *_OFF), given, " or unset"))
    return word


def drawing_library(default: str | None = None) -> str:
    """Return the name of the library to draw with.

    That is the one which MUJOCO_GL names, else the default, else the first that works here: osmesa, egl or glfw on
    Linux, cgl or glfw on macOS, glfw on Windows. Each is tried in a program of its own: loading one excludes others.

    Args:
        default: Library where MUJOCO_GL names none; None to look for one.

    Raises:
        DisplayError: If none works, or MUJOCO_GL turns drawing off.
        ParameterError: If MUJOCO_GL is no word that the engine knows on this system.
    """
    word = check_mujoco_gl()
    if word in _OFF:
        raise DisplayError(f"MUJOCO_GL={word} turns drawing off: unset it, or choose one of {', '.join(_LIBRARIES)}")
    return _WORDS.get(word) or default or _first_working()


@cache
def _first_working() -> str:
    import subprocess

    for name in _LIBRARIES:
        trial = [sys.executable, "-W", "error::UserWarning", "-c", _TRIAL.format(name)]  # glfw only warns
        environment = {**os.environ, "MUJOCO_GL": name}
        if subprocess.run(trial, env=environment, capture_output=True, check=False).returncode == 0:
            return name
    raise DisplayError(f"nothing that draws works here, of {', '.join(_LIBRARIES)}: {NEEDS[_LIBRARIES[0]]}")
