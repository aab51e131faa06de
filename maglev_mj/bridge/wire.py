"""Encoding of frames: little-endian, packed, SI units, with a CRC-32 and an optional authentication tag.

Received data never raises: an invalid frame is dropped and counted by reason.

Source: docs/reference/protocol.md.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple, TypeAlias

from maglev_mj.errors import ParameterError


class State(IntEnum):
    """State of a device; FAULT is latched until a reset."""

    INACTIVE = 0
    ACTIVE = 1
    FAULT = 2


class Fault(IntFlag):
    """Reasons for the fault state; the first four bits as in the Maglev 200."""

    SENSOR_OUT_OF_RANGE = 1
    COIL_OVERTEMP = 2
    COIL_OVERCURRENT = 4
    FLOTOR_OVERSPEED = 8
    BOUNDARY = 16  # the flotor left the envelope allowed by the host
    WATCHDOG = 32  # no command for longer than the watchdog timeout
    INVALID_COMMAND = 64  # non-finite command
    ESTOP = 128
    COIL_NOT_FOLLOWING = 256  # a coil's measured current differs from the commanded one
    SENSOR_FROZEN = 512  # a diode repeats its reading more often than its noise permits
    CLOCK = 1024  # the device's timestamps jumped
    NOT_FOLLOWING = 2048  # the flotor does not follow: wrong signs, swapped diodes, or something holds it
    HOST = 4096  # the host program failed, or lost the device's samples
    SENSOR_STOPPED = 8192  # the sensor's conversion counter stopped
    COIL_NOT_OFF = 16384  # current flows although the currents are cut
    WALL_ENERGY = 32768  # the walls on the device generated energy


class Flag(IntFlag):
    """Flags of a STATE frame."""

    HOLDING = 1  # commands are missing: hover currents from ARM are on
    ENABLED = 2  # the amplifier board sees its enable line toggle
    STOPPING = 4  # a controlled stop: currents flow in FAULT


class Operation(IntEnum):
    """Operations that a host requests in a CTRL frame."""

    ARM = 1
    DISARM = 2
    RESET = 4
    TRIP = 5  # enter the fault state for faults detected by the host
    BYE = 6


class Result(IntEnum):
    """Status in a device's answer to a CTRL frame."""

    DONE = 0
    REFUSED = 1


class HelloStatus(IntEnum):
    """Status in a device's answer to a HELLO frame."""

    WELCOME = 0
    VERSION = 1
    BUSY = 2
    CALIBRATION = 3


def fault_names(faults: int) -> str:
    """Return the names of fault bits, separated by spaces, or "none"."""
    names = [fault.name or "" for fault in Fault if faults & fault]
    unknown = faults & ~sum(Fault)
    return " ".join(names + ([f"0x{unknown:x}"] if unknown else [])) or "none"


MAGIC = 0x4A4D
"""The bytes "MJ"."""
_MAGIC = MAGIC.to_bytes(2, "little")

VERSION = 4

MOST_WALLS = 6
"""Largest number of walls in a CMD."""

WRAP = NEVER = 0xFFFFFFFF
"""Largest sequence number; sentinel for 'no command' in its number and age."""

CUT = (0.0,) * 8
"""Parameters of a controlled stop that cuts the currents instead."""

_HEADER = "<HBBIIQ"
_CRC = struct.Struct("<I")
_CRC_RESIDUE = 0x2144DF1C
"""CRC-32 of any data followed by its own CRC."""


class Hello(NamedTuple):
    """Request for a session; the same nonce gets the same session."""

    nonce: int
    calibration: bytes


class HelloAck(NamedTuple):
    """Answer to HELLO with the device's properties.

    Times [ns], currents [A], `spot_limit` [m], `spot_speed` [m/s].
    """

    nonce: int
    status: int
    lockstep: int
    version: int
    state: int
    device: int
    calibration: bytes
    period: int
    delay: int
    watchdog: int
    enable: int
    stale: int
    fault_time: int
    faults: int
    first: int
    frozen: int
    current_limit: float
    continuous_current: float
    hover_limit: float
    thermal_time: float  # [s]
    spot_limit: float
    spot_speed: float
    wall_period: int  # 0: no walls on the device
    wall_delay: int
    stiffness_limit: float  # [N/m]; for a rotation see `LEVER`
    damping_limit: float  # [N s/m]
    edge_speed: float  # [m/s]


LEVER = 0.03
"""Lever arm of the limits of a wall on a rotation [m]: its square for gains, its inverse for the edge's speed."""


class Control(NamedTuple):
    """Request for an `Operation`; `faults` for TRIP, `hover` currents [A] and `stop` for ARM."""

    request: int
    operation: int
    faults: int
    hover: tuple[float, ...]
    stop: tuple[float, ...] = CUT  # controlled stop: damping by spots, six [s/m], duration [s], lift


class ControlAck(NamedTuple):
    """Answer to CTRL: request, operation and `Result`, with the resulting state and faults."""

    request: int
    operation: int
    result: int
    state: int
    faults: int


class StateReport(NamedTuple):
    """Measurements of a device at one sample, whose number is the frame's sequence number."""

    spots: tuple[float, ...]  # x and y on each of three diodes [m]
    currents: tuple[float, ...]  # measured, six [A]
    temperatures: tuple[float, ...]  # rise of each coil as a fraction of its limit, six; trips at 1
    state: int
    valid: int  # bit k: spot of diode k is valid
    flags: int
    faults: int
    answered: int  # number of the sample answered by the newest command
    age: int  # of that command [µs]; NEVER if none
    conversions: int  # conversion counter of the sensor interface


class Wall(NamedTuple):
    """Wall that the device renders at its own rate; fields as in `DeviceWall`, and a cutoff of 0 for none."""

    axis: int
    side: int
    edge: float  # [m, rad]
    stiffness: float  # [N/m, N m/rad]
    damping: float  # [N s/m, N m s/rad]
    cutoff: float  # [Hz]

    @property
    def lever(self) -> float:
        """Lever arm of the limits [m]; 1 for a translation."""
        return 1.0 if self.axis < 3 else LEVER


class Command(NamedTuple):
    """Commanded currents [A], six each: `pulsed` for the first `width` seconds, then `held`; and all walls."""

    answers: int  # number of the answered sample
    flags: int  # 0
    held: tuple[float, ...]
    pulsed: tuple[float, ...]
    width: float
    walls: tuple[Wall, ...] = ()


class Estop(NamedTuple):
    """Request for an emergency stop, from any host; repetitions keep the request number."""

    request: int


class EstopAck(NamedTuple):
    """Answer to an emergency stop, with time `sampled` [ns] and `currents` [A] of the last sample."""

    request: int
    state: int
    faults: int
    sampled: int
    currents: tuple[float, ...]


Body: TypeAlias = Hello | HelloAck | Control | ControlAck | StateReport | Command | Estop | EstopAck

_TYPES: dict[int, tuple[type[Body], str]] = {
    1: (Hello, "Q16s"),
    2: (HelloAck, "QBBBBI16sQQQQQQIII6dQQ3d"),
    3: (Control, "IB3xI14d"),
    4: (ControlAck, "IBBBxI"),
    5: (StateReport, "6d6f6fBBHIIII"),
    6: (Command, "II6d6dd"),
    7: (Estop, "Q"),
    8: (EstopAck, "QB3xIQ6f"),
}
_NUMBERS = {body: number for number, (body, _) in _TYPES.items()}
_STRUCTS = {number: struct.Struct(_HEADER + fields) for number, (_, fields) in _TYPES.items()}
_COMMAND, _WALL = 6, struct.Struct("<Bb2x4d")
_WALLED = [_STRUCTS[_COMMAND].size + _WALL.size * count for count in range(MOST_WALLS + 1)]
"""Lengths of header and body of a CMD, by the number of its walls."""
# bodies with fields of six numbers: to and from flat values
_FLAT: dict[int, Callable[[Any], Sequence[Any]]] = {
    3: lambda body: (*body[:3], *body[3], *body[4]),
    5: lambda body: (*body[0], *body[1], *body[2], *body[3:]),
    6: lambda body: (body[0], body[1], *body[2], *body[3], body[4]),
    8: lambda body: (*body[:4], *body[4]),
}
_NESTED: dict[int, Callable[[tuple[Any, ...]], Body]] = {
    3: lambda values: Control(values[6], values[7], values[8], values[9:15], values[15:]),
    5: lambda values: StateReport(values[6:12], values[12:18], values[18:24], *values[24:]),
    6: lambda values: Command(values[6], values[7], values[8:14], values[14:20], values[20]),
    8: lambda values: EstopAck(values[6], values[7], values[8], values[9], values[10:]),
}


class Frame(NamedTuple):
    """Decoded frame."""

    session: int  # 0 in a HELLO and an ESTOP
    sequence: int  # CMD: counted by the host; STATE: number of the sample; else 0
    time: int  # by the sender's clock [ns]
    body: Body


class Codec:
    """Encoder and decoder of frames.

    Args:
        key: Authentication key shared by both ends, 16 to 32 bytes; None for none.

    Attributes:
        dropped: Dropped frames by reason: short, magic, version, type, length, crc, tag.
        version_met: Protocol version of the last frame dropped for its version; None if there was none.

    Raises:
        ParameterError: If the key is too short or too long.
    """

    def __init__(self, key: bytes | None = None) -> None:
        if key is not None and not LEAST_KEY <= len(key) <= MOST_KEY:
            raise ParameterError(f"key must have {LEAST_KEY} to {MOST_KEY} bytes (got {len(key)})")
        self._key = key
        self._overhead = _CRC.size + (TAG if key is not None else 0)
        self.dropped: Counter[str] = Counter()
        self.version_met: int | None = None

    def encode(self, session: int, sequence: int, time: int, body: Body) -> bytes:
        """Return an encoded frame; `sequence` modulo 2³², `time` by the sender's clock [ns]."""
        number = _NUMBERS[body.__class__]
        values = _FLAT[number](body) if number in _FLAT else body
        data = _STRUCTS[number].pack(MAGIC, VERSION, number, session, sequence & WRAP, time, *values)
        if number == _COMMAND and body.walls:  # type: ignore[union-attr]
            data += b"".join(_WALL.pack(*wall) for wall in body.walls)  # type: ignore[union-attr]
        if self._key is not None:
            data += _tag(data, self._key)
        return data + _CRC.pack(zlib.crc32(data))

    def decode(self, data: bytes) -> Frame | None:
        """Return the decoded frame, or None if it is invalid, counted in `dropped`."""
        if reason := self._reason(data):
            self.dropped[reason] += 1
            return None
        number = data[3]
        values = _STRUCTS[number].unpack_from(data)
        body = _NESTED[number](values) if number in _NESTED else _TYPES[number][0](*values[6:])
        if number == _COMMAND and (end := len(data) - self._overhead) > _WALLED[0]:
            walls = tuple(map(Wall._make, _WALL.iter_unpack(data[_WALLED[0] : end])))
            body = body._replace(walls=walls)  # type: ignore[call-arg]
        return Frame(values[3], values[4], values[5], body)

    def _reason(self, data: bytes) -> str:
        """Return why data is not a valid frame; "" if it is."""
        if len(data) < 4:
            return "short"
        if data[:2] != _MAGIC:
            return "magic"
        # check the CRC before reading any other field
        if len(data) < self._overhead + 4 or zlib.crc32(data) != _CRC_RESIDUE:
            return "crc"
        if data[2] != VERSION:
            self.version_met = data[2]
            return "version"
        shape = _STRUCTS.get(data[3])
        if shape is None:
            return "type"
        end = len(data) - self._overhead
        if end != shape.size and (data[3] != _COMMAND or end not in _WALLED):
            return "length"
        if self._key is not None and not hmac.compare_digest(data[end : end + TAG], _tag(data[:end], self._key)):
            return "tag"
        return ""


def newer(number: int, reference: int) -> bool:
    """Return True if a sequence number is later than a reference, in 32-bit serial arithmetic.

    Source: RFC 1982.
    """
    return 0 < ((number - reference) & WRAP) < 0x80000000


LEAST_KEY, MOST_KEY = 16, 32
"""Smallest and largest key length [bytes]."""

TAG = 16
"""Tag length [bytes]."""


def _tag(data: bytes, key: bytes) -> bytes:
    """Return the keyed BLAKE2s of a message."""
    return hashlib.blake2s(data, digest_size=TAG, key=key).digest()
