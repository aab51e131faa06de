"""What is on a spacenav socket: events, requests and answers, all native 32-bit integers.

A client begins in protocol 0: it sends single floats, sensitivities, and gets events. libspnav 1.0 first asks for
protocol 1 in four bytes; from the answer on it sends requests of 32 bytes, each answered by as many. Strings travel
24 bytes a packet behind the number of bytes left, and what a client calls itself is not answered.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

__all__ = ["ALL_EVENTS", "DEVICE", "EVENT", "Conversation", "GarbageError", "motion_event"]

EVENT = 32
"""Bytes of an event, a request, or an answer."""

ALL_EVENTS = 0xFFFF
"""Mask of a client that has not said which events it wants."""

DEVICE = b"maglev_mj"
"""What the device calls itself."""

_WORDS, _WORD = struct.Struct("=8i"), struct.Struct("=I")
_MOTION, _WANTS_MOTION = 0, 1
_TAG, _NUMBER, _VERSION = 0x7FAA0000, 0xFFFF, 0xFF
_CHANGE, _NEWEST = 0x5500, 1
_SET_NAME, _GET_SENSITIVITY, _SET_MASK, _GET_MASK = 0x1000, 0x1002, 0x1003, 0x1004
_NAME, _AXES, _BUTTONS, _KIND = 0x2000, 0x2002, 0x2003, 0x2005
_ONE = 0x3F800000
"""1.0 as the bits of a float."""


class GarbageError(Exception):
    """A client has sent what is no request."""


def motion_event(axes: Sequence[int], period: int) -> bytes:
    """Return the event of a motion.

    Args:
        axes: x, y, z, rx, ry, rz as the protocol has them.
        period: Since the last event [ms].
    """
    return _WORDS.pack(_MOTION, *axes, period)


class Conversation:
    """What one client asks, and what it is answered.

    Attributes:
        version: Of the protocol that it speaks.
        begun: Whether it has said anything.
        mask: Which events it wants.
    """

    def __init__(self) -> None:
        self.version, self.begun, self.mask = 0, False, ALL_EVENTS
        self._rest = b""

    @property
    def wants_motion(self) -> bool:
        """Whether it wants to be told of motions."""
        return bool(self.mask & _WANTS_MOTION)

    def hear(self, data: bytes) -> bytes:
        """Return the answers to what has come, whole or in pieces.

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
            return b""  # a sensitivity: what it does with the axes is the program's own affair
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
        known = {_GET_SENSITIVITY: _ONE, _SET_MASK: 0, _GET_MASK: self.mask, _AXES: 6, _BUTTONS: 0, _KIND: 0}
        # what is not known here is refused: there is no file of settings, no USB device, and no sensitivity to set
        return _WORDS.pack(kind, known.get(number, 0), 0, 0, 0, 0, 0, 0 if number in known else -1)
