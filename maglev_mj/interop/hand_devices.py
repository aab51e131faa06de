"""Gamepads and 3D mice as the hand: their deflections set the target of its spring."""

from __future__ import annotations

import os
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cached_property
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import Parameters, param
from maglev_mj.plants.hand import SpringHand
from maglev_mj.process import SideProcess
from maglev_mj.session import FrameClock, Snapshot

BUTTONS = "centre", "pause", "zero"
"""Actions of the first buttons; "zero" takes the current position for the rest position."""


class HandState(NamedTuple):
    """State of an input device.

    Attributes:
        shares: Deflection of the six axes relative to full scale, -1 to 1; None while the device is disconnected.
        pressed: Numbers of the buttons pressed since the last reading.
    """

    shares: Sequence[float] | None
    pressed: Sequence[int] = ()


GONE = HandState(None)
"""Reading of a disconnected device."""


class InputDevice(Protocol):
    """Interface of a six-axis device with non-blocking reads; it may reconnect after a disconnection."""

    name: str

    def read(self) -> HandState:
        """Return the current state and the buttons pressed since the last call."""

    def close(self) -> None:
        """Close the device; idempotent."""


_NOTHING, _NONE = "0", "none"
_FINITE = 1e6


@checked
class AxisMapping(Parameters):
    """Mapping of an input device's six deflections: dead zone, order and sign, gains, then the dominant axis.

    The default is the identity.

    Raises:
        ParameterError: If a value is outside its bounds, or a name is not an axis.

    Example:
        >>> mapping = AxisMapping(order="x,y,z,0,0,0", invert="y", dominant=True)
        >>> mapping([0.2, 0.1, 0.5, 0.9, 0.0, 0.0]).tolist()
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    """

    gain: float = param("gain of translations", default=1.0, at_least=0.0, at_most=100.0)
    turning_gain: float = param("gain of rotations", default=1.0, at_least=0.0, at_most=100.0)
    dead_zone: float = param("dead zone, as a fraction of full deflection", default=0.0, at_least=0.0, at_most=0.9)
    order: str = param("source axis of each output axis; 0 for none", default=",".join(AXES))
    invert: str = param("inverted output axes, e.g. x,rz", default=_NONE)
    dominant: bool = param("only the axis with the largest deflection", default=False)

    def check(self) -> None:
        """See `Parameters`."""
        words, inverted = self.order.split(","), self._inverted()
        if len(words) != len(AXES) or not set(words) <= {*AXES, _NOTHING}:
            raise ParameterError(f"order must be six of {', '.join(AXES)} and {_NOTHING} (got {self.order!r})")
        if not set(inverted) <= set(AXES) or len(set(inverted)) < len(inverted):
            raise ParameterError(f"invert must be {_NONE}, or some of {', '.join(AXES)} (got {self.invert!r})")

    def outside(self, deflection: Array, full: Array) -> Array:
        """Apply the dead zone to a deflection, (6,); full deflection is unchanged.

        Args:
            deflection: Deflection from the centre [m, rad], (6,).
            full: Full deflection [m, rad], (6,).
        """
        if self.dead_zone == 0.0:
            return deflection
        size = np.maximum(np.abs(deflection) - self.dead_zone * full, 0.0) / (1.0 - self.dead_zone)
        return np.copysign(size, deflection)

    def __call__(self, shares: Array) -> Array:
        """Map deflections to output axes, (6,); NaN counts as 0.

        Args:
            shares: Deflections relative to full scale, (6,).
        """
        values: Array = self._matrix @ np.nan_to_num(shares, posinf=_FINITE, neginf=-_FINITE)
        if self.dominant:
            values[np.arange(len(AXES)) != np.argmax(np.abs(values))] = 0.0
        return values

    def _inverted(self) -> list[str]:
        return [] if self.invert == _NONE else self.invert.split(",")

    @cached_property
    def _matrix(self) -> Array:
        matrix = np.zeros((len(AXES), len(AXES)))
        for row, (name, source) in enumerate(zip(AXES, self.order.split(","))):
            if source != _NOTHING:
                gain = self.gain if row < 3 else self.turning_gain
                matrix[row, AXES.index(source)] = -gain if name in self._inverted() else gain
        return matrix


HAND_MAPPING = AxisMapping(gain=3.0, turning_gain=3.0, dead_zone=0.15)
"""Default mapping: full deflection sets the target at three times the range, to press against walls."""

_FURTHEST = 1.0  # [m, rad]: a rotation above pi would wrap around
_FULL = np.ones(len(AXES))
_STILL, _JITTER, _NEAR = 10, 0.02, 0.3  # at rest: number of readings, largest change, largest deflection
_LARGEST = 16.0  # of a valid reading; drivers may scale


class HandDevice:
    """Input device that moves a hand's target; a `Publisher`.

    The deflection from rest sets the target pose on all six axes. With all axes in the dead zone the hand is released,
    so that the mouse can be used and friction holds the flotor. Other targets of the hand, such as the mouse's, have
    priority. The rest position is the first one near zero that is still; until then the hand is released. After a
    disconnection or an invalid reading it is released until a button is pressed: another user may have the device.

    Args:
        device: The input device; `close` closes it too.
        hand_force: The hand.
        mapping: Axis mapping; `HAND_MAPPING` if None.

    Attributes:
        note: Message for the user while the device cannot be used.
        act: Function called with the action of a pressed button; may be replaced.
    """

    def __init__(self, device: InputDevice, hand_force: SpringHand, mapping: AxisMapping | None = None) -> None:
        self.note, self._device, self._hand, self._mapping = "", device, hand_force, mapping or HAND_MAPPING
        self.act: Callable[[str], object] = lambda action: None
        self._lost = False
        self._rest: Array | None = None
        self._recent: deque[Array] = deque(maxlen=_STILL)

    def take(self) -> None:
        """Return None: an input device does not change the scene."""

    def show(self, snapshot: Snapshot) -> None:
        """Move the hand; see `Publisher`."""
        shares, pressed = self._device.read()
        self._hand.device_target, self.note = None, ""
        valid = shares is not None and all(abs(share) <= _LARGEST for share in shares)  # false for NaN
        if not valid or (self._lost and not pressed):
            self.note = f"no position from {self._device.name}: the hand is released until you press one of its buttons"
            self._lost, self._rest = True, None
            self._recent.clear()
            return
        position = np.asarray(shares)
        for number in () if self._lost else pressed:
            if number == BUTTONS.index("zero"):
                self._rest = position
            elif number < len(BUTTONS):
                self.act(BUTTONS[number])
        self._lost = False
        self._recent.append(position)
        if self._rest is not None:
            self._hand.device_target = self._target(position - self._rest, snapshot.scene.body.bounded.range)
        elif np.abs(position).max() > _NEAR:
            self.note = f"{self._device.name} is deflected: let it go, or press its third button where it is at rest"
        elif len(self._recent) == _STILL and np.ptp(self._recent, axis=0).max() <= _JITTER:
            self._rest = position

    def close(self) -> None:
        """Release the hand and close the device; idempotent."""
        self._hand.device_target = None
        self._device.close()

    def _target(self, deflection: Array, reach: Array) -> list[float] | None:
        """Return the target pose [m, rad]; None at rest."""
        outside = self._mapping.outside(deflection, _FULL)
        target = np.clip(self._mapping(outside) * reach, -_FURTHEST, _FURTHEST)
        return target.tolist() if target.any() else None


_PERIOD = 1.0 / 120.0
_PATIENCE = 20.0
_RESEND, _MAX_AGE = 0.5, 2.0  # interval of an unchanged state, largest age [s]

State: TypeAlias = tuple[tuple[float, ...], tuple[bool, ...]] | None
"""Deflections relative to full scale and pressed buttons; None for a disconnected device."""


class Gamepad:
    """Gamepad, or another joystick.

    Args:
        name: Part of its name, case-insensitive; empty for the first device.
        clock: Real-time clock [s].

    Attributes:
        name: Full name.

    Raises:
        MaglevError: If there is no such device, or no display.
    """

    def __init__(self, name: str = "", clock: Callable[[], float] = time.monotonic) -> None:
        self._process = SideProcess(watch, name)
        matches = [full for full in _first(self._process) if name.lower() in full.lower()]
        if not matches:
            self.close()
            raise MaglevError(f"no gamepad{f' named {name!r}' if name else ''} found")
        self.name, self._state = matches[0], _first(self._process)
        self._clock, self._received = clock, clock()

    def read(self) -> HandState:
        """Return the state; see `InputDevice`."""
        pressed: list[int] = []
        lost = False
        for state in self._process.received():
            before = self._state[1] if self._state else ()
            down = state[1] if state else ()
            pressed += [number for number, (old, new) in enumerate(zip(before, down)) if new and not old]
            self._state, self._received, lost = state, self._clock(), lost or state is None
        # a device that was away and is back may be another one
        if self._process.ended or lost or self._state is None or self._clock() - self._received > _MAX_AGE:
            return GONE
        return HandState(self._state[0], pressed)

    def close(self) -> None:
        """Close the device; idempotent."""
        self._process.close()


def gamepad_names() -> list[str]:
    """Return the names of all gamepads and joysticks; empty without a display."""
    with closing(SideProcess(watch, "")) as process:
        return list(_first(process))


def gamepad_shares(axes: Sequence[float], turn: float) -> tuple[float, ...]:
    """Return the six deflections of a gamepad.

    Args:
        axes: Left stick x, y, right stick x, y, left and right trigger; up is negative, a trigger at rest is -1.
        turn: Rotation about the vertical: 1 for the left bumper, -1 for the right one.
    """
    x, y, tilt_x, tilt_y, left, right = axes
    # a positive rotation about x tilts the handle towards the user: stick pulled back
    return x, -y, 0.5 * (right - left), tilt_y, tilt_x, turn


def watch(line: Connection, wanted: str) -> None:
    """Send all device names, then each new state of one device; runs in a separate process until the pipe closes.

    Args:
        line: Pipe to the main process.
        wanted: Part of the device's name.
    """
    # imported here: loads the window library
    import glfw

    glfw.ERROR_REPORTING = "ignore"
    glfw.init()  # may fail, e.g. without a display; then there are no devices
    pads, due = _Pads(glfw), FrameClock(_RESEND)
    sent: Any = pads.names()
    # keep the full name: after a disconnection no other device may take over
    wanted = next((name for name in sent if wanted.lower() in name.lower()), wanted)
    try:
        line.send(sent)
        while not line.poll(_PERIOD):  # a closed pipe is readable
            glfw.poll_events()
            if (state := pads.state(wanted)) != sent or due():
                line.send(state)
                sent = state
    except OSError:
        pass  # the main process has ended
    finally:
        glfw.terminate()


class _Pads:
    """All gamepads and joysticks by number and name, gamepads first; GLFW reports no serial number."""

    def __init__(self, glfw: Any) -> None:
        self._glfw = glfw
        self._chosen: tuple[int, str] | None = None
        self._before: list[tuple[int, str]] = []

    def names(self) -> list[str]:
        """Return the names of all connected devices."""
        return [name for _, name in self._present()]

    def state(self, wanted: str) -> State:
        """Return the state of the first device matching a name; after its end, of one connected since then."""
        before, self._before = self._before, self._present()
        if self._chosen is None:  # after its end: a device that was there before is another user's
            matches = [pad for pad in self._before if pad not in before and wanted.lower() in pad[1].lower()]
            self._chosen = matches[0] if matches else None
        elif self._chosen not in self._before:
            self._chosen = None
        if self._chosen is None:
            return None
        number = self._chosen[0]
        return self._gamepad(number) if self._glfw.joystick_is_gamepad(number) else self._joystick(number)

    def _present(self) -> list[tuple[int, str]]:
        glfw = self._glfw
        numbers = range(glfw.JOYSTICK_1, glfw.JOYSTICK_LAST + 1)
        present = [(number, self._name(number)) for number in numbers if glfw.joystick_present(number)]
        return sorted(present, key=lambda pad: not glfw.joystick_is_gamepad(pad[0]))

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
        """Return the first six axes and the buttons."""
        values, count = self._glfw.get_joystick_axes(number)
        x, y, *others = (float(values[index]) if index < count else 0.0 for index in range(len(AXES)))
        down, count = self._glfw.get_joystick_buttons(number)
        return (x, -y, *others), tuple(bool(down[index]) for index in range(min(count, len(BUTTONS))))


def _first(process: SideProcess) -> Any:
    """Return the next message of a process; an empty list if it ends first."""
    process.line.poll(_PATIENCE)
    return next(process.received(), [])


_AT_ONCE, _AGAIN, _FULL_COUNT = 65_536, 1.0, 500
_EVENT, _PROTOCOL = (
    struct.Struct("=8i"),
    struct.pack("=I", 0x7FAA5501),
)  # kind, values; request of protocol 1, and reply
# then sensitivity 1; a daemon of protocol 0 takes each word for a sensitivity, of which the last one counts
_GREETING = _PROTOCOL + struct.pack("=If5if", 0x7FAA1001, 1.0, *[0] * 5, 1.0)
_MOTION, _PRESS, _DEVICE, _REMOVED = 0, 1, 3, 1
_SETTINGS, _DAEMONS = Path("/etc/spnavrc"), Path("/var/run/spnav.sock")
_EXCHANGED = 0, 2, 1, 3, 5, 4  # axes of a 3D mouse, in the order of the device


def searched_paths() -> list[Path]:
    """Return possible 3D mouse sockets, in the order of libspnav 1.0."""
    try:
        lines = _SETTINGS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    split = [line.strip().partition("=") for line in lines]
    configured = [path.strip() for word, _, path in split if word.startswith("socket") and path.strip()]
    variable = os.environ.get("SPNAV_SOCKET")
    return [*map(Path, [variable] if variable else []), *map(Path, configured[:1]), _DAEMONS]


class SpacenavMouse:
    """3D mouse behind a spacenav socket, in protocol 1, or in protocol 0 of a spacenavd before 1.0.

    A lost connection is retried every second. In protocol 0 an unplugged mouse cannot be told from one held still.

    Args:
        path: Path of the socket.
        clock: Real-time clock [s].

    Attributes:
        name: Name of the device.

    Raises:
        MaglevError: If the socket does not accept a connection.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self.name, self._path, self._clock = f"3D mouse at {path}", path, clock
        self._line: socket.socket | None = None
        self._connect()
        if self._line is None:
            raise MaglevError(f"no {self.name}")

    def read(self) -> HandState:
        """Return the state; see `InputDevice`."""
        if self._line is None and self._clock() >= self._next:
            self._connect()
        if self._line is None:
            return GONE
        try:
            data = self._line.recv(_AT_ONCE)
        except BlockingIOError:
            return HandState(self._shares)
        except OSError:
            data = b""
        if not data:
            self.close()
            return GONE
        return self._receive(data)

    def close(self) -> None:
        """Close the connection; idempotent."""
        if self._line is not None:
            self._line.close()
        self._line, self._next = None, self._clock() + _AGAIN

    def _connect(self) -> None:
        """Connect to the socket; leave `_line` None on failure."""
        self._buffer, self._shares = b"", (0.0,) * len(AXES)
        if not hasattr(socket, "AF_UNIX"):
            return
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._line.setblocking(False)
        try:
            self._line.connect(os.fspath(self._path))
            self._line.send(_GREETING)
        except OSError:  # no driver, or its backlog is full
            self.close()

    def _receive(self, data: bytes) -> HandState:
        """Parse events, which may arrive in fragments; store the last motion."""
        self._buffer = (self._buffer + data).replace(_PROTOCOL, b"")  # shorter than an event
        pressed, removed = [], False
        while len(self._buffer) >= _EVENT.size:
            kind, *values = _EVENT.unpack(self._buffer[: _EVENT.size])
            self._buffer = self._buffer[_EVENT.size :]
            if kind == _MOTION:
                self._shares = tuple(values[index] / _FULL_COUNT for index in _EXCHANGED)
            elif kind == _PRESS:
                pressed.append(values[0])
            elif kind == _DEVICE and values[0] == _REMOVED:
                self._shares, removed = (0.0,) * len(AXES), True
        return GONE if removed else HandState(self._shares, pressed)


AUTO = "auto"
"""Name that selects the first available device."""

_MOUSE = "spacenav"


def open_device(name: str = AUTO) -> InputDevice:
    """Open an input device.

    Args:
        name: "auto", "spacenav" for the 3D mouse, the path of its socket, or part of a gamepad's name.

    Raises:
        ParameterError: If there is no such device.
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
    raise ParameterError(f"hand-device {name!r} not found; `--hand-device list` shows the connected devices") from None


def described_devices() -> list[str]:
    """Return a line for each device, that of "auto" first."""
    mouse = _mouse()
    names = [] if mouse is None else [mouse.name]
    if mouse is not None:
        mouse.close()
    return names + [f"gamepad {name}" for name in gamepad_names()]


def _mouse() -> SpacenavMouse | None:
    """Return the first 3D mouse that answers, or None."""
    for path in searched_paths():
        try:
            return SpacenavMouse(path)
        except MaglevError:
            continue
    return None
