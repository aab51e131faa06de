"""Gamepads and joysticks by GLFW, in a separate process.

GLFW may be called by one thread alone, the window's.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any, TypeAlias

from maglev_mj.errors import MaglevError
from maglev_mj.frames import AXES
from maglev_mj.interop.hand_devices.device import BUTTONS, GONE, Reading
from maglev_mj.process import SideProcess

_PERIOD = 1.0 / 120.0
_PATIENCE = 20.0

State: TypeAlias = tuple[tuple[float, ...], tuple[bool, ...]] | None
"""Deflections and pressed buttons; None for no such device.

Deflections are shares of the full one.
"""


class Gamepad:
    """Gamepad, or a joystick of another kind.

    Args:
        name: Part of its name, in upper or lower case; empty for the first device.

    Attributes:
        name: Full name.

    Raises:
        MaglevError: If there is none, or no display.
    """

    def __init__(self, name: str = "") -> None:
        self._process = SideProcess(watch, name)
        found = [one for one in _first(self._process) if name.lower() in one.lower()]
        if not found:
            self.close()
            raise MaglevError(f"no gamepad{f' called {name!r}' if name else ''}")
        self.name, self._state = found[0], None
        self._state = _first(self._process)

    def read(self) -> Reading:
        """Return the state; see `InputDevice`."""
        pressed: list[int] = []
        for state in self._process.received():
            before = self._state[1] if self._state else ()
            down = state[1] if state else ()
            pressed += [number for number, (old, new) in enumerate(zip(before, down)) if new and not old]
            self._state = state
        if self._process.ended or self._state is None:
            return GONE
        return Reading(self._state[0], pressed)

    def close(self) -> None:
        """Close the device; idempotent."""
        self._process.close()


def gamepad_names() -> list[str]:
    """Return the names of all gamepads and joysticks.

    Empty without a display.
    """
    process = SideProcess(watch, "")
    try:
        found: list[str] = _first(process)
        return found
    finally:
        process.close()


def gamepad_shares(axes: Sequence[float], turn: float) -> tuple[float, ...]:
    """Return the six deflections of a gamepad.

    Args:
        axes: Left stick x, y, right stick x, y, left and right trigger; up is negative, a trigger at rest is -1.
        turn: 1 for the left bumper, -1 for the right one.
    """
    x, y, tilt_x, tilt_y, left, right = axes
    # turned about x, a handle leans towards the person: the stick pulled back
    return x, -y, 0.5 * (right - left), tilt_y, tilt_x, turn


def watch(line: Connection, wanted: str) -> None:
    """Send all device names, then each new state of one.

    It runs in a process of its own, until the line ends.

    Args:
        line: Connection to the program.
        wanted: Part of the device's name.
    """
    # imported here: it loads the library that opens windows
    import glfw

    glfw.ERROR_REPORTING = "ignore"
    glfw.init()  # where it cannot, as without a display, there are no devices
    pads = _Pads(glfw)
    sent: Any = pads.names()
    # once it is unplugged, no other becomes the hand
    wanted = next((name for name in sent if wanted.lower() in name.lower()), wanted)
    try:
        line.send(sent)
        while not line.poll(_PERIOD):  # the end of the program is something to read
            glfw.poll_events()
            if (state := pads.state(wanted)) != sent:
                line.send(state)
                sent = state
    except OSError:
        pass  # the program has ended
    finally:
        glfw.terminate()


class _Pads:
    """All gamepads and joysticks, gamepads first.

    Args:
        glfw: The library.
    """

    def __init__(self, glfw: Any) -> None:
        self._glfw = glfw
        self._rest: dict[int, tuple[float, ...]] = {}

    def names(self) -> list[str]:
        """Return the names of all present devices."""
        return [self._name(number) for number in self._there()]

    def state(self, wanted: str) -> State:
        """Return the state of the first device matching a name."""
        for number in self._there():
            if wanted.lower() in self._name(number).lower():
                return self._gamepad(number) if self._glfw.joystick_is_gamepad(number) else self._joystick(number)
        return None

    def _there(self) -> list[int]:
        glfw = self._glfw
        numbers = range(glfw.JOYSTICK_1, glfw.JOYSTICK_LAST + 1)
        there = [number for number in numbers if glfw.joystick_present(number)]
        self._rest = {number: rest for number, rest in self._rest.items() if number in there}
        return sorted(there, key=lambda number: not glfw.joystick_is_gamepad(number))

    def _name(self, number: int) -> str:
        name = self._glfw.get_gamepad_name(number) or self._glfw.get_joystick_name(number)
        return name.decode(errors="replace") if isinstance(name, bytes) else str(name)

    def _gamepad(self, number: int) -> State:
        glfw = self._glfw
        if (state := glfw.get_gamepad_state(number)) is None:
            return None
        buttons = [bool(down) for down in state.buttons]
        left, right = buttons[glfw.GAMEPAD_BUTTON_LEFT_BUMPER], buttons[glfw.GAMEPAD_BUTTON_RIGHT_BUMPER]
        return gamepad_shares(state.axes, float(left) - float(right)), tuple(buttons[: len(BUTTONS)])

    def _joystick(self, number: int) -> State:
        """Return deflections and buttons of a joystick.

        The first six axes, relative to their first values: a throttle rests at its end.
        """
        places, count = self._glfw.get_joystick_axes(number)
        axes = tuple(float(places[index]) if index < count else 0.0 for index in range(len(AXES)))
        rest = self._rest.setdefault(number, axes)
        x, y, *others = (place - first for place, first in zip(axes, rest))
        down, count = self._glfw.get_joystick_buttons(number)
        return (x, -y, *others), tuple(bool(down[index]) for index in range(min(count, len(BUTTONS))))


def _first(process: SideProcess) -> Any:
    """Return the next message of a process.

    An empty list if it ends first.
    """
    end = time.monotonic() + _PATIENCE
    while not process.ended and time.monotonic() < end:
        for message in process.received():
            return message
        time.sleep(0.005)
    return []
