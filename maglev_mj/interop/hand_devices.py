"""Gamepads and 3D mice as the hand: deflections set the target of its spring."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES
from maglev_mj.interop.spacenav import AxisMapping, searched_paths
from maglev_mj.interop.spacenav.mapping import EXCHANGED, FULL, REST
from maglev_mj.interop.spacenav.protocol import EVENT, GREETING, read_event
from maglev_mj.plants.hand import SpringHand
from maglev_mj.process import SideProcess
from maglev_mj.session import Snapshot
from maglev_mj.spec import RANGE

BUTTONS = "centre", "pause"
"""Actions of the first and second button."""


class Reading(NamedTuple):
    """State of an input device.

    Attributes:
        shares: Shares of the full deflection on each axis, -1 to 1, six; None while the device is missing.
        pressed: Numbers of the buttons pressed since the last reading.
    """

    shares: Sequence[float] | None
    pressed: Sequence[int] = ()


GONE = Reading(None)
"""Reading of an absent device."""


class InputDevice(Protocol):
    """Interface of a six-axis device, read without waiting.

    After it is unplugged, it may return.
    """

    name: str

    def read(self) -> Reading:
        """Return the state since the last reading."""

    def close(self) -> None:
        """Close the device; idempotent."""


HAND_MAPPING = AxisMapping(gain=3.0, turning_gain=3.0, dead_zone=0.15)
"""Default settings of the axes.

A full deflection pulls to three times the range, so that a wall can be pressed.
"""

_FURTHEST = 1.0  # rad: a turn of more than pi would be one the other way round; no hand pulls so hard
_FULL = np.ones(len(AXES))


class HandDevice:
    """Input device that moves a hand's target; a `Publisher`.

    A deflection is a pose: the hand holds all six axes there. At rest, within the dead zone on every axis, it is
    released, so that the mouse can be used and friction holds the flotor. Another target of the hand, such as the
    mouse's, has priority.

    Args:
        device: The device; closed with this.
        hand: The hand.
        mapping: Settings of the axes; `HAND_MAPPING` if None.

    Attributes:
        note: Message for the user while the device is missing.
        act: Called with the action of a pressed button; may be replaced.
    """

    def __init__(self, device: InputDevice, hand: SpringHand, mapping: AxisMapping | None = None) -> None:
        self.note, self._device, self._hand, self._mapping = "", device, hand, mapping or HAND_MAPPING
        self.act: Callable[[str], object] = lambda action: None

    def take(self) -> None:
        """Return None: a device requests no scene."""

    def show(self, snapshot: Snapshot) -> None:
        """Move the hand; see `Publisher`."""
        shares, pressed = self._device.read()
        self.note = f"{self._device.name} is gone: the hand is released" if shares is None else ""
        self._hand.device_target = None if shares is None else self._target(shares)
        for number in pressed:
            if number < len(BUTTONS):
                self.act(BUTTONS[number])

    def close(self) -> None:
        """Release the hand and close the device; idempotent."""
        self._hand.device_target = None
        self._device.close()

    def _target(self, shares: Sequence[float]) -> list[float] | None:
        """Return the target pose [m, rad]; None at rest."""
        outside = self._mapping.outside(np.asarray(shares), _FULL)
        target = np.clip(self._mapping(outside) * RANGE, -_FURTHEST, _FURTHEST)
        return target.tolist() if target.any() else None


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
        self.name, self._state = found[0], _first(self._process)

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
    with closing(SideProcess(watch, "")) as process:
        return list(_first(process))


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
    process.line.poll(_PATIENCE)
    return next(process.received(), [])


_AT_ONCE = 65_536
_AGAIN = 1.0


class SpacenavMouse:
    """3D mouse behind a spacenav socket, in protocol 0.

    Every spacenavd speaks that.

    After a loss of the connection it is reopened, tried every second.

    Args:
        path: Path of the socket.
        clock: Clock of real time [s].

    Attributes:
        name: Name of the device.

    Raises:
        MaglevError: If there is no answer.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self.name, self._path, self._clock = f"3D mouse at {path}", path, clock
        self._line: socket.socket | None = None
        self._call()
        if self._line is None:
            raise MaglevError(f"no {self.name}")

    def read(self) -> Reading:
        """Return the state; see `InputDevice`."""
        if self._line is None and self._clock() >= self._next:
            self._call()
        if self._line is None:
            return GONE
        try:
            data = self._line.recv(_AT_ONCE)
        except BlockingIOError:
            return Reading(self._shares)
        except OSError:
            data = b""
        if not data:
            self.close()
            return GONE
        pressed = self._receive(data)
        return Reading(self._shares, pressed)

    def close(self) -> None:
        """Close the connection; idempotent."""
        if self._line is not None:
            self._line.close()
        self._line, self._next = None, self._clock() + _AGAIN

    def _call(self) -> None:
        """Connect to the socket, if possible."""
        self._rest, self._shares = b"", _shares(REST)
        if not hasattr(socket, "AF_UNIX"):
            return
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._line.setblocking(False)
        try:
            self._line.connect(os.fspath(self._path))
            self._line.send(GREETING)
        except OSError:  # no driver, or too many clients wait
            self.close()

    def _receive(self, data: bytes) -> list[int]:
        """Store the last received motion; return pressed buttons.

        Data may arrive in pieces.
        """
        self._rest += data
        pressed = []
        while len(self._rest) >= EVENT:
            event, self._rest = self._rest[:EVENT], self._rest[EVENT:]
            axes, button = read_event(event)
            if axes is not None:
                self._shares = _shares(axes)
            if button is not None:
                pressed.append(button)
        return pressed


def _shares(axes: tuple[int, ...]) -> tuple[float, ...]:
    """Return shares of the full deflection, in device order."""
    return tuple(axes[index] / FULL for index in EXCHANGED)


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
