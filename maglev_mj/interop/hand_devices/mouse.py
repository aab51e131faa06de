"""3D mouse behind its driver's socket, by the spacenav protocol."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

from maglev_mj.errors import MaglevError
from maglev_mj.interop.hand_devices.device import GONE, Reading
from maglev_mj.interop.spacenav.mapping import EXCHANGED, FULL, REST
from maglev_mj.interop.spacenav.protocol import EVENT, GREETING, read_event

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
