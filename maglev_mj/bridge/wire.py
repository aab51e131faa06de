"""Frames on the wire: little-endian, packed, SI, sealed by CRC-32 and, with a key, by a tag; see docs/protocol.md.

Nothing that arrives can raise here: what is no frame is counted by reason and dropped.
"""

from __future__ import annotations

import hmac
import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from enum import IntEnum, IntFlag
from typing import NamedTuple, TypeAlias

from maglev_mj.net.authentication import TAG, Authenticator

__all__ = [
    "MAGIC",
    "VERSION",
    "Codec",
    "Command",
    "Control",
    "ControlAck",
    "Estop",
    "EstopAck",
    "Fault",
    "Flag",
    "Frame",
    "Hello",
    "HelloAck",
    "HelloStatus",
    "Operation",
    "Result",
    "State",
    "StateReport",
    "fault_names",
    "newer",
]


class State(IntEnum):
    """Of a device. A fault is latched: only an explicit reset leads out of it."""

    INACTIVE = 0
    ACTIVE = 1
    FAULT = 2


class Fault(IntFlag):
    """Why a device is in the fault state; the first four have the bits that Maglev 200 users know."""

    SENSOR_OUT_OF_RANGE = 1
    COIL_OVERTEMP = 2
    COIL_OVERCURRENT = 4
    FLOTOR_OVERSPEED = 8
    BOUNDARY = 16
    """The flotor is beyond the envelope that the host allows."""
    WATCHDOG = 32
    """No command for longer than the device waits."""
    INVALID_COMMAND = 64
    """A command that is not finite."""
    ESTOP = 128
    COIL_NOT_FOLLOWING = 256
    """A coil's measured current is not the one commanded."""
    SENSOR_FROZEN = 512
    """A diode repeats its reading more often than its noise allows."""
    CLOCK = 1024
    """The device's timestamps jumped."""
    NOT_FOLLOWING = 2048
    """The flotor does not go where it is led: wrong signs, diodes exchanged, or something holds it."""
    HOST = 4096
    """The host's program failed, or lost the device's samples."""
    SENSOR_STOPPED = 8192
    """The sensor's conversion counter stands still."""
    COIL_NOT_OFF = 16384
    """A current flows although the currents are cut."""


class Flag(IntFlag):
    """In a STATE frame."""

    HOLDING = 1
    """Commands are missing: the currents agreed at arming are on."""
    ENABLED = 2
    """The amplifier board sees its enable line live."""


class Operation(IntEnum):
    """What a host asks for in a CTRL frame."""

    ARM = 1
    DISARM = 2
    RESET = 4
    TRIP = 5
    """Go to the fault state for the faults that the host has seen."""
    BYE = 6


class Result(IntEnum):
    """How a device answers a CTRL frame."""

    DONE = 0
    REFUSED = 1


class HelloStatus(IntEnum):
    """How a device answers a HELLO frame."""

    WELCOME = 0
    VERSION = 1
    BUSY = 2
    CALIBRATION = 3


def fault_names(faults: int) -> str:
    """Return the names of fault bits, or "none"."""
    known = [fault.name or "" for fault in Fault if faults & fault]
    rest = faults & ~sum(Fault)
    return " ".join(known + ([f"0x{rest:x}"] if rest else [])) or "none"


MAGIC = 0x4A4D
"""The bytes "MJ"."""

VERSION = 2

_HEADER = "<HBBIIQ"
_CRC = struct.Struct("<I")
_SEALED = 0x2144DF1C
"""The CRC of anything that its own CRC follows, and of nothing else of that length and beginning."""


class Hello(NamedTuple):
    """A host asks for a session; the same nonce gets the same session."""

    nonce: int
    calibration: bytes


class HelloAck(NamedTuple):
    """The device answers, and says what it is.

    Attributes:
        nonce: Of the HELLO answered.
        status: See `HelloStatus`.
        lockstep: Whether simulated time waits for each answer.
        version: Of the protocol that the device speaks.
        state: See `State`.
        device: Its number.
        calibration: First 16 bytes of its calibration's hash.
        period: Sample period [ns].
        delay: From a command's arrival to its taking effect [ns].
        watchdog: How long it waits for a command [ns].
        enable: How long the amplifiers' enable line may stand still [ns].
        fault_time: Of the device's clock when the first latched fault was raised [ns]; 0 for none.
        faults: Latched, see `Fault`.
        first: Those of them that were raised first.
        frozen: Equal readings in a row that the sensor's noise rules out; 0 where it has none.
        current_limit: Largest current in any coil [A].
        continuous_current: Current that a coil bears continuously [A].
        hover_limit: Largest current of a coil in ARM's hover [A].
        thermal_time: Time constant of a coil's warming [s].
        spot_limit: Largest coordinate of a spot on its diode [m].
        spot_speed: Largest speed of a spot [m/s].
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
    fault_time: int
    faults: int
    first: int
    frozen: int
    current_limit: float
    continuous_current: float
    hover_limit: float
    thermal_time: float
    spot_limit: float
    spot_speed: float


class Control(NamedTuple):
    """A host asks for a change of state; the same request number is done once.

    Attributes:
        request: Its number, counted up by the host.
        operation: See `Operation`.
        faults: For TRIP: what the host has seen.
        hover: For ARM: currents that hold the flotor where commands are missing [A], six.
    """

    request: int
    operation: int
    faults: int
    hover: tuple[float, ...]


class ControlAck(NamedTuple):
    """The device answers: request and operation as asked, `Result`, and its state and faults after it."""

    request: int
    operation: int
    result: int
    state: int
    faults: int


class StateReport(NamedTuple):
    """What a device measured at a sample; its number is the frame's sequence number.

    Attributes:
        spots: Both coordinates of each of the three spots [m], six.
        currents: Measured in the coils [A], six.
        temperatures: Each coil's share of what it bears, 1 where it trips, six.
        state: See `State`.
        valid: Bit k is set where diode k's spot can be trusted.
        flags: See `Flag`.
        faults: See `Fault`.
        answered: Number of the sample that the command in force answers.
        age: Of the command in force [us], 0xFFFFFFFF for none.
        conversions: Counter of the sensor interface, up with every conversion of all diodes.
    """

    spots: tuple[float, ...]
    currents: tuple[float, ...]
    temperatures: tuple[float, ...]
    state: int
    valid: int
    flags: int
    faults: int
    answered: int
    age: int
    conversions: int


class Command(NamedTuple):
    """Currents from now on.

    Attributes:
        answers: Number of the sample answered.
        flags: None are defined; 0.
        held: Currents [A], six.
        pulsed: Currents in place of those for the first `width` seconds [A], six.
        width: How long [s]; 0 for no pulse.
    """

    answers: int
    flags: int
    held: tuple[float, ...]
    pulsed: tuple[float, ...]
    width: float


class Estop(NamedTuple):
    """Anyone asks for an emergency stop; the same request number in every repetition."""

    request: int


class EstopAck(NamedTuple):
    """The device answers an emergency stop.

    Attributes:
        request: Of the ESTOP answered.
        state: See `State`.
        faults: See `Fault`.
        sampled: Instant of the last sample [ns].
        currents: Measured in the coils then [A], six.
    """

    request: int
    state: int
    faults: int
    sampled: int
    currents: tuple[float, ...]


Body: TypeAlias = Hello | HelloAck | Control | ControlAck | StateReport | Command | Estop | EstopAck

_TYPES: dict[int, tuple[type[Body], str]] = {
    1: (Hello, "Q16s"),
    2: (HelloAck, "QBBBBI16sQQQQQIII6d"),
    3: (Control, "IB3xI6d"),
    4: (ControlAck, "IBBBxI"),
    5: (StateReport, "6d6f6fBBHIIII"),
    6: (Command, "II6d6dd"),
    7: (Estop, "Q"),
    8: (EstopAck, "QB3xIQ6f"),
}
_NUMBERS = {body: number for number, (body, _) in _TYPES.items()}
_STRUCTS = {number: struct.Struct(_HEADER + fields) for number, (_, fields) in _TYPES.items()}
_CONTROL, _STATE, _COMMAND, _ESTOP_ACK = 3, 5, 6, 8


class Frame(NamedTuple):
    """A frame that was read.

    Attributes:
        session: Number of the session, 0 in a HELLO and an ESTOP.
        sequence: In a CMD counted up by the host, in a STATE the number of the sample; else 0.
        time: Of the sender's clock [ns].
        body: What it says.
    """

    session: int
    sequence: int
    time: int
    body: Body


class Codec:
    """Writes and reads frames, sealed by a key if there is one.

    Args:
        key: 16 to 32 bytes shared by both ends; None for none.

    Attributes:
        dropped: How many frames were dropped, by reason: short, magic, version, type, length, crc, tag.
        version_met: Protocol version of the last frame that was dropped for its version; None for none.

    Raises:
        ParameterError: If the key is too short or too long.
    """

    def __init__(self, key: bytes | None = None) -> None:
        self._seal = None if key is None else Authenticator(key)
        self._overhead = _CRC.size + (TAG if self._seal is not None else 0)
        self.dropped: Counter[str] = Counter()
        self.version_met: int | None = None

    def encode(self, session: int, sequence: int, time: int, body: Body) -> bytes:
        """Return a frame.

        Args:
            session: Number of the session.
            sequence: Of the frame, or of the sample; taken modulo 2³².
            time: Of the sender's clock [ns].
            body: What it says.
        """
        number = _NUMBERS[body.__class__]
        values: Sequence[object] = body
        if isinstance(body, Command):
            values = (body.answers, body.flags, *body.held, *body.pulsed, body.width)
        elif isinstance(body, StateReport):
            values = (*body.spots, *body.currents, *body.temperatures, *body[3:])
        elif isinstance(body, Control):
            values = (*body[:3], *body.hover)
        elif isinstance(body, EstopAck):
            values = (*body[:4], *body.currents)
        data = _STRUCTS[number].pack(MAGIC, VERSION, number, session, sequence & 0xFFFFFFFF, time, *values)
        if self._seal is not None:
            data += self._seal.tag(data)
        return data + _CRC.pack(zlib.crc32(data))

    def decode(self, data: bytes) -> Frame | None:
        """Return the frame, or None where there is none that can be trusted; the reason is counted in `dropped`."""
        reason = self._reason(data)
        if reason:
            self.dropped[reason] += 1
            return None
        number = data[3]
        values = _STRUCTS[number].unpack_from(data)
        if number == _STATE:
            body: Body = StateReport(values[6:12], values[12:18], values[18:24], *values[24:])
        elif number == _COMMAND:
            body = Command(values[6], values[7], values[8:14], values[14:20], values[20])
        elif number == _CONTROL:
            body = Control(values[6], values[7], values[8], values[9:])
        elif number == _ESTOP_ACK:
            body = EstopAck(values[6], values[7], values[8], values[9], values[10:])
        else:
            body = _TYPES[number][0](*values[6:])
        return Frame(values[3], values[4], values[5], body)

    def _reason(self, data: bytes) -> str:
        """Return why data is no frame that can be trusted; nothing where it is one."""
        if len(data) < 4:
            return "short"
        if data[0] != MAGIC & 0xFF or data[1] != MAGIC >> 8:
            return "magic"
        # the seal first: what it does not vouch for is not looked at
        if len(data) < self._overhead + 4 or zlib.crc32(data) != _SEALED:
            return "crc"
        if data[2] != VERSION:
            self.version_met = data[2]
            return "version"
        shape = _STRUCTS.get(data[3])
        if shape is None:
            return "type"
        if len(data) != shape.size + self._overhead:
            return "length"
        if self._seal is not None:
            end = len(data) - self._overhead
            if not hmac.compare_digest(data[end : end + TAG], self._seal.tag(data[:end])):
                return "tag"
        return ""


def newer(one: int, other: int) -> bool:
    """Return whether a sequence number comes after another, by serial arithmetic on 32 bits.

    Source: RFC 1982.
    """
    return 0 < ((one - other) & 0xFFFFFFFF) < 0x80000000
