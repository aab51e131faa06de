"""Search for input devices, and selection by name."""

from __future__ import annotations

from pathlib import Path

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.interop.hand_devices.device import InputDevice
from maglev_mj.interop.hand_devices.gamepad import Gamepad, gamepad_names
from maglev_mj.interop.hand_devices.mouse import SpacenavMouse
from maglev_mj.interop.spacenav import searched_paths

AUTO = "auto"
"""Name that selects the first available device."""

_MOUSE = "spacenav"


def open_device(name: str = AUTO) -> InputDevice:
    """Open an input device.

    Args:
        name: "auto", "spacenav" for the 3D mouse, the path of its socket, or part of a gamepad's name.

    Raises:
        ParameterError: If it is not found.
    """
    try:
        if "/" in name:
            return SpacenavMouse(Path(name))
        if name in (AUTO, _MOUSE) and (mouse := _mouse()) is not None:
            return mouse
        if name != _MOUSE:
            return Gamepad("" if name == AUTO else name)
    except MaglevError:
        pass
    raise ParameterError(f"hand-device must be one of those that `--hand-device list` prints, not {name!r}") from None


def described_devices() -> list[str]:
    """Return a line about each device.

    The first is that of "auto".
    """
    mouse = _mouse()
    found = [] if mouse is None else [mouse.name]
    if mouse is not None:
        mouse.close()
    return found + [f"gamepad {name}" for name in gamepad_names()]


def _mouse() -> SpacenavMouse | None:
    """Return the first 3D mouse that answers, or None."""
    for path in searched_paths():
        try:
            return SpacenavMouse(path)
        except MaglevError:
            continue
    return None
