"""The state of an input device of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

__all__ = ["BUTTONS", "GONE", "InputDevice", "Reading"]

BUTTONS = "centre", "pause"
"""Actions of the first and the second button."""


class Reading(NamedTuple):
    """State of an input device.

    Attributes:
        shares: Of the full deflection on each axis, -1 to 1, six; None while the device is gone.
        pressed: Numbers of the buttons pressed since the last reading.
    """

    shares: Sequence[float] | None
    pressed: Sequence[int] = ()


GONE = Reading(None)
"""Reading of an absent device."""


class InputDevice(Protocol):
    """A device of six axes, read without waiting; once unplugged, it may come back."""

    name: str

    def read(self) -> Reading:
        """Return its state."""

    def close(self) -> None:
        """Close it; a second time does nothing."""
