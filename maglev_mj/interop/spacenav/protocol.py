"""Events, requests and answers of spacenav: native 32-bit integers.

A client begins in protocol 0: it sends single floats, sensitivities, and gets events. libspnav 1.0 first asks for
protocol 1 in four bytes; from the answer on it sends requests of 32 bytes, each answered by as many. Strings travel
24 bytes a packet behind the number of bytes left, and what a client calls itself is not answered.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from maglev_mj.frames import AXES
from maglev_mj.parameters import flag

EVENT = 32
"""Bytes of an event, a request, or an answer."""

ALL_EVENTS = 0xFFFF
"""Default event mask of a client."""

DEVICE = b"maglev_mj"
"""Device name reported to clients."""

_WORDS, _WORD, _FLOAT = struct.Struct("=8i"), struct.Struct("=I"), struct.Struct("=f")
_MOTION, _PRESS, _RELEASE = 0, 1, 2

GREETING = _FLOAT.pack(1.0)
"""First word of a protocol 0 client: its sensitivity."""

MOTIONS, BUTTONS = 1, 2
"""Bits of the event mask: for motions, for buttons."""

MOST = 32767
"""Largest value of an axis that is told."""
_LEAST_SENSITIVITY, _MOST_SENSITIVITY = 1e-3, 1e3
_TAG, _NUMBER, _VERSION = 0x7FAA0000, 0xFFFF, 0xFF
_CHANGE, _NEWEST = 0x5500, 1
_SET_NAME, _SET_SENSITIVITY, _GET_SENSITIVITY, _SET_MASK, _GET_MASK = 0x1000, 0x1001, 0x1002, 0x1003, 0x1004
_NAME, _AXES, _BUTTONS, _KIND = 0x2000, 0x2002, 0x2003, 0x2005


class GarbageError(Exception):
    """A client sent bytes that are not a request."""


def motion_event(axes: Sequence[int], period: int) -> bytes:
    """Return the event of a motion.

    Args:
        axes: x, y, z, rx, ry, rz as the protocol has them.
        period: Since the last event [ms].
    """
    return _WORDS.pack(_MOTION, *axes, period)


def button_event(number: int, down: bool) -> bytes:
    """Return the event of a button press or release."""
    return _WORDS.pack(_PRESS if flag("down", down) else _RELEASE, number, down, 0, 0, 0, 0, 0)


def read_event(event: bytes) -> tuple[tuple[int, ...] | None, int | None]:
    """Return the motion or the button of an event.

    None for the one that the event is not about.

    Args:
        event: The event, 32 bytes.
    """
    kind, *values = _WORDS.unpack(event)
    return tuple(values[: len(AXES)]) if kind == _MOTION else None, values[0] if kind == _PRESS else None


class Conversation:
    """Requests of one client, and their answers.

    Attributes:
        version: Of the protocol that it speaks.
        begun: Whether it has said anything.
        mask: Which events it wants.
        sensitivity: Its factor on every axis.
    """

    def __init__(self) -> None:
        self.version, self.begun, self.mask = 0, False, ALL_EVENTS
        self.sensitivity, self._rest = 1.0, b""

    def scaled(self, axes: Sequence[int]) -> tuple[int, ...]:
        """Return the axes by its sensitivity, rounded."""
        return tuple(round(max(-MOST, min(MOST, self.sensitivity * one))) for one in axes)

    def hear(self, data: bytes) -> bytes:
        """Return the answers to received bytes, whole or partial.

        Raises:
            GarbageError: If it is no request.
        """
        self.begun = True
        self._rest += data
        answers = b""
        while len(self._rest) >= (size := EVENT if self.version else _WORD.size):
            packet, self._rest = self._rest[:size], self._rest[size:]
            answers += self._request(packet) if self.version else self._word(packet)
        return answers

    def _word(self, packet: bytes) -> bytes:
        (word,) = _WORD.unpack(packet)
        if word & ~_VERSION != _TAG | _CHANGE:
            self._set_sensitivity(packet)
            return b""
        if self._rest:
            return b""  # it has gone on without waiting for the answer, and would take that for an event
        self.version = min(word & _VERSION, _NEWEST)
        return _WORD.pack(_TAG | _CHANGE | self.version)

    def _request(self, packet: bytes) -> bytes:
        kind, *given, _ = _WORDS.unpack(packet)
        number = kind & _NUMBER
        # libspnav leaves the tag out where it sends strings
        if kind & ~_NUMBER not in (0, _TAG) or not 0x1000 <= number <= _CHANGE | _VERSION:
            raise GarbageError
        if number == _SET_NAME:
            return b""
        if number == _SET_MASK:
            self.mask = given[0] & ALL_EVENTS
        if number == _NAME:
            return struct.pack("=i24si", kind, DEVICE, len(DEVICE))
        known = {_SET_MASK: 0, _GET_MASK: self.mask, _AXES: 6, _BUTTONS: 2, _KIND: 0}
        if number == _GET_SENSITIVITY:
            known[number] = _WORDS.unpack_from(_FLOAT.pack(self.sensitivity) + bytes(28))[0]
        if number == _SET_SENSITIVITY and self._set_sensitivity(packet[4:8]):
            known[number] = 0
        # what is not known here is refused: there is no file of settings and no USB device
        return _WORDS.pack(kind, known.get(number, 0), 0, 0, 0, 0, 0, 0 if number in known else -1)

    def _set_sensitivity(self, data: bytes) -> bool:
        """Take a sensitivity; return whether it is a sensible one."""
        (asked,) = _FLOAT.unpack(data)
        # libspnav 1.0 and 1.1 send the lower half of a double instead: 0 for round numbers, 4e-8 for 0.3
        sensible: bool = _LEAST_SENSITIVITY <= abs(asked) <= _MOST_SENSITIVITY
        if sensible:
            self.sensitivity = asked
        return sensible
