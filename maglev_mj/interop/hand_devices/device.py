"""Input device as hand: deflections set the spring's target."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.interop.spacenav import AxisMapping
from maglev_mj.plants.hand import SpringHand
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
        self.act: Callable[[str], object] = _nothing

    def take(self) -> None:
        """Return None: a device requests no scene."""
        return None

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


def _nothing(_: str) -> None: ...
