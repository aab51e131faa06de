"""State of an input device of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

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
