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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag
from typing import Annotated, Any, NamedTuple, TypeAlias, get_type_hints

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


class Ending(Enum):
    """Ways to end a flight early, the gentlest first."""

    LAND = "landing"  # of the host, without a fault
    STOP = "controlled stop"  # of the device: it fades the hover currents out
    CUT = "cut"


_WORKS, _BLIND = "sensor and coils work", "a controlled stop is damped by the spots"

ENDINGS: Mapping[Fault, tuple[Ending, str]] = {
    Fault.SENSOR_OUT_OF_RANGE: (Ending.CUT, _BLIND),
    Fault.COIL_OVERTEMP: (Ending.CUT, "walls on the device would go on heating the coil"),
    Fault.COIL_OVERCURRENT: (
        Ending.CUT,
        "the amplifier does not follow; the device stops if only a CMD was too large",
    ),
    Fault.FLOTOR_OVERSPEED: (Ending.CUT, f"the spots may have jumped: {_BLIND}"),
    Fault.BOUNDARY: (Ending.CUT, f"diodes may be swapped: {_BLIND}"),
    Fault.WATCHDOG: (Ending.STOP, f"{_WORKS}; the device cuts if the enable line opened"),
    Fault.INVALID_COMMAND: (Ending.STOP, _WORKS),
    Fault.ESTOP: (Ending.CUT, "someone asks for it"),
    Fault.COIL_NOT_FOLLOWING: (Ending.CUT, "coils do not carry the currents of a controlled stop"),
    Fault.SENSOR_FROZEN: (Ending.CUT, _BLIND),
    Fault.CLOCK: (Ending.STOP, "a controlled stop counts samples, not time"),
    Fault.NOT_FOLLOWING: (Ending.CUT, f"diodes or signs may be wrong: {_BLIND}"),
    Fault.HOST: (Ending.STOP, _WORKS),
    Fault.SENSOR_STOPPED: (Ending.CUT, _BLIND),
    Fault.COIL_NOT_OFF: (Ending.CUT, "the currents are cut already"),
    Fault.WALL_ENERGY: (Ending.STOP, f"{_WORKS}; the walls are removed"),
}
"""How a flight ends by each fault, and why; docs/explanation/faults.md has the same table."""


def ending_of(faults: int) -> Ending:
    """Return how faults end a flight: as the one that needs the most."""
    endings = [ending for fault, (ending, _) in ENDINGS.items() if faults & fault]
    return max(endings, key=list(Ending).index, default=Ending.LAND)


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


class Outcome(IntEnum):
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

VERSION = 5

MOST_WALLS = 12
"""Largest number of walls in a CMD: the faces of a box in six axes."""

WRAP = NEVER = 0xFFFFFFFF
"""Largest sequence number; sentinel for 'no command' in its number and age."""

CUT = (0.0,) * 8
"""Parameters of a controlled stop that cuts the currents instead."""

_HEADER = "<HBBIIQ"
_CRC = struct.Struct("<I")
_CRC_RESIDUE = 0x2144DF1C
"""CRC-32 of any data followed by its own CRC."""


FORMATS = {"u8": "B", "i8": "b", "u16": "H", "u32": "I", "u64": "Q", "f32": "f", "f64": "d", "bytes": "s", "zeros": "x"}
"""Types of the page, as `struct` writes them."""

Six: TypeAlias = tuple[float, ...]


@dataclass(frozen=True)
class On:
    """Declaration of a value on the wire, with its text on the page.

    `make protocol` copies it to the firmware in C and to docs/reference/protocol.md.
    """

    kind: str  # type, or count and type: "u8", "6 f64", "16 bytes"
    text: str = ""
    gap: int = 0  # zero bytes before the value

    @property
    def type(self) -> str:
        """Type of a single number, a key of `FORMATS`."""
        return self.kind.rpartition(" ")[2]

    @property
    def count(self) -> int:
        """Count of numbers, or of bytes."""
        return int(self.kind.rpartition(" ")[0] or 1)

    @property
    def values(self) -> int:
        """Count of values of `struct`, where bytes are one."""
        return 1 if self.type == "bytes" else self.count


def layout(body: type[Body | WallMessage]) -> dict[str, On]:
    """Return the declarations of a body by name, in the order on the wire, without the walls of a CMD."""
    hints = get_type_hints(body, include_extras=True)
    return {name: hints[name].__metadata__[0] for name in body._fields if hasattr(hints[name], "__metadata__")}


class Hello(NamedTuple):
    """Request for a session; the same nonce gets the same session."""

    nonce: Annotated[int, On("u64", "drawn at random by the host for each new session")]
    calibration: Annotated[bytes, On("16 bytes", "digest of the host's calibration")]


class HelloAck(NamedTuple):
    """Answer to HELLO with the device's properties."""

    nonce: Annotated[int, On("u64", "of the HELLO; 0 if its version differs")]
    status: Annotated[int, On("u8", "0 WELCOME, 1 VERSION, 2 BUSY, 3 CALIBRATION")]
    lockstep: Annotated[int, On("u8", "1 if simulated time waits for each answer")]
    version: Annotated[int, On("u8", "of the device")]
    state: Annotated[int, On("u8", "0 INACTIVE, 1 ACTIVE, 2 FAULT")]
    device: Annotated[int, On("u32", "device number")]
    calibration: Annotated[bytes, On("16 bytes", "digest that the device requires")]
    period: Annotated[int, On("u64", "between samples [ns]")]
    delay: Annotated[int, On("u64", "from a command's arrival to its effect [ns]")]
    latency: Annotated[int, On("u64", "age of the spots at the time of their sample [ns]")]
    watchdog: Annotated[int, On("u64", "longest time without a command [ns]")]
    enable: Annotated[
        int, On("u64", "longest time without a change of the enable line before the amplifier board opens [ns]")
    ]
    stale: Annotated[int, On("u64", "largest age of a sample whose answer is accepted [ns]")]
    fault_time: Annotated[int, On("u64", "time of the first latched fault by the device's clock [ns]; 0 for none")]
    faults: Annotated[int, On("u32", "latched faults")]
    first: Annotated[int, On("u32", "faults latched by the first trip, all of them if several were found at once")]
    frozen: Annotated[
        int,
        On(
            "u32",
            "number of equal consecutive readings that the sensor's noise rules out; 0: no noise, readings may repeat",
        ),
    ]
    current_limit: Annotated[float, On("f64", "largest current in any coil [A]")]
    continuous_current: Annotated[float, On("f64", "continuous current rating of a coil [A]")]
    hover_limit: Annotated[float, On("f64", "largest hover current in any coil at ARM [A]")]
    thermal_time: Annotated[float, On("f64", "thermal time constant of a coil [s]")]
    spot_limit: Annotated[float, On("f64", "largest coordinate of a spot on its diode [m]")]
    spot_speed: Annotated[float, On("f64", "largest speed of a spot, for each coordinate [m/s]")]
    wall_period: Annotated[int, On("u64", "between samples of [walls](#walls) [ns]; 0 if the device renders none")]
    wall_delay: Annotated[int, On("u64", "from such a sample to its effect [ns]")]
    stiffness_limit: Annotated[float, On("f64", "largest stiffness of a wall [N/m]")]
    damping_limit: Annotated[float, On("f64", "largest damping of a wall [N s/m]")]
    edge_speed: Annotated[float, On("f64", "largest speed of a wall's edge [m/s]")]
    wall_count: Annotated[int, On("u32", "largest number of walls in a CMD, at most 12")]
    lever: Annotated[
        float,
        On(
            "f64",
            "lever arm of the limits of a wall on a rotation [m]: squared for gains, inverse for the edge's speed",
        ),
    ]
    energy: Annotated[float, On("f64", "energy that the walls may return beyond what they took [J]")]
    recede: Annotated[float, On("f64", "speed at which the walls' edges recede in a controlled stop [m/s]")]
    off_current: Annotated[float, On("f64", "largest measured current of a coil that counts as off [A]")]


_OF_THE_MOMENT = "nonce", "status", "version", "state", "fault_time", "faults", "first"
PROPERTIES = {name: on for name, on in layout(HelloAck).items() if name not in _OF_THE_MOMENT}
"""Values of HELLO_ACK that never change: those of `Profile`, and of the firmware's `struct maglev_profile`."""


class ControlRequest(NamedTuple):
    """Request for an `Operation`; `faults` for TRIP, `hover` currents [A] and `stop` for ARM."""

    request: Annotated[int, On("u32", "request number, counted by the host")]
    operation: Annotated[int, On("u8", "1 ARM, 2 DISARM, 4 RESET, 5 TRIP, 6 BYE")]
    faults: Annotated[int, On("u32", "for TRIP: faults detected by the host", gap=3)]
    hover: Annotated[Six, On("6 f64", "for ARM: currents that hold the flotor while commands are missing [A]")]
    stop: Annotated[
        Six,
        On(
            "8 f64",
            "for ARM: [controlled stop](#controlled-stop): `damping` by the velocity of each spot, six [s/m]; "
            "`duration`, 0 to 1 [s], 0 to cut instead; `lift`, largest multiple of the hover currents, 0 or more",
        ),
    ] = CUT


class ControlAck(NamedTuple):
    """Answer to CTRL: request, operation and `Outcome`, with the resulting state and faults."""

    request: Annotated[int, On("u32", "of the CTRL")]
    operation: Annotated[int, On("u8", "of the CTRL")]
    result: Annotated[int, On("u8", "0 DONE, 1 REFUSED")]
    state: Annotated[int, On("u8", "resulting")]
    faults: Annotated[int, On("u32", "resulting", gap=1)]


class StateReport(NamedTuple):
    """Measurements of a device at one sample, whose number is the frame's sequence number."""

    spots: Annotated[Six, On("6 f64", "x and y on diodes 0, 1 and 2 [m]")]
    currents: Annotated[Six, On("6 f32", "measured [A]")]
    temperatures: Annotated[Six, On("6 f32", "temperature rise of each coil as a fraction of its limit; trips at 1")]
    state: Annotated[int, On("u8")]
    valid: Annotated[int, On("u8", "bit k: spot of diode k is valid")]
    flags: Annotated[
        int,
        On(
            "u16",
            "1 HOLDING: commands are missing, hover currents are on; 2 ENABLED: the amplifier board reports that its "
            "enable line toggles and currents can flow; 4 STOPPING: a controlled stop, currents flow in FAULT; set up "
            "to the sample at which they are cut",
        ),
    ]
    faults: Annotated[int, On("u32")]
    answered: Annotated[
        int,
        On(
            "u32",
            "`answers` of the last command applied since ARM, in INACTIVE of the last one accepted; 0xFFFFFFFF for "
            "none, as at the start of a session",
        ),
    ]
    age: Annotated[
        int,
        On(
            "u32",
            "time since its arrival [us], at most 0xFFFFFFFE, and 0 if it arrived after the sample; "
            "0xFFFFFFFF for none",
        ),
    ]
    conversions: Annotated[int, On("u32", "counter of the sensor interface; wraps")]


class WallMessage(NamedTuple):
    """Wall that the device renders at its own rate; fields as in `DeviceWall`, and a cutoff of 0 for none."""

    axis: Annotated[int, On("u8", "0 to 5: x, y, z, rotations about them")]
    side: Annotated[int, On("i8", "1: the wall fills x <= `edge`; -1: x >= `edge`; 0: both sides")]
    edge: Annotated[float, On("f64", "in the device's [linearised pose](#walls) [m, rad]", gap=2)]
    stiffness: Annotated[float, On("f64", "[N/m, N m/rad]")]
    damping: Annotated[float, On("f64", "[N s/m, N m s/rad]")]
    cutoff: Annotated[float, On("f64", "of the velocity's low-pass filter [Hz]; 0 for none")]


class CommandFrame(NamedTuple):
    """Commanded currents [A], six each: `pulsed` for the first `width` seconds, then `held`; and all walls."""

    answers: Annotated[int, On("u32", "number of the sample answered")]
    flags: Annotated[int, On("u32", "0")]
    held: Annotated[Six, On("6 f64", "currents [A]")]
    pulsed: Annotated[Six, On("6 f64", "replace `held` for the first `width` seconds after taking effect [A]")]
    width: Annotated[float, On("f64", "0 to 1 [s]; 0 for no pulse")]
    walls: tuple[WallMessage, ...] = ()  # after these values, in the length of the frame


class Estop(NamedTuple):
    """Request for an emergency stop, from any host; repetitions keep the request number."""

    request: Annotated[int, On("u64", "drawn at random by the sender; unchanged in repetitions")]


class EstopAck(NamedTuple):
    """Answer to an emergency stop, with the last sample; a host without a session knows nothing else of the device."""

    request: Annotated[int, On("u64", "of the ESTOP")]
    state: Annotated[int, On("u8", "resulting")]
    lockstep: Annotated[int, On("u8", "as in HELLO_ACK: no sample follows without an answer")]
    faults: Annotated[int, On("u32", "resulting", gap=2)]
    sampled: Annotated[int, On("u64", "time of the last sample [ns]; 0 before the first")]
    currents: Annotated[Six, On("6 f32", "measured at that sample [A]")]
    off_current: Annotated[float, On("f64", "as in HELLO_ACK [A]")]


Body: TypeAlias = Hello | HelloAck | ControlRequest | ControlAck | StateReport | CommandFrame | Estop | EstopAck

BODIES: Sequence[type[Body]] = (
    *(Hello, HelloAck, ControlRequest, ControlAck),
    *(StateReport, CommandFrame, Estop, EstopAck),
)
"""Bodies in the order of their types on the wire, from 1."""


def _format(body: type[Body | WallMessage]) -> str:
    """Return the format of a body for `struct`."""
    return "".join(
        "x" * on.gap + f"{on.count if on.count > 1 else ''}{FORMATS[on.type]}" for on in layout(body).values()
    )


def _flat(body: type[Body]) -> Callable[[Any], Sequence[Any]]:
    """Return a function from a body to flat values."""
    parts = [f"{'*' if on.values > 1 else ''}body[{index}]" for index, on in enumerate(layout(body).values())]
    return eval(f"lambda body: [{', '.join(parts)}]")  # type: ignore[no-any-return]  # on every frame: no loop


def _nested(body: type[Body], start: int = 6) -> Callable[[tuple[Any, ...]], Body]:
    """Return the inverse, from the values of header and body."""
    parts = []
    for on in layout(body).values():
        parts.append(f"values[{start}:{start + on.values}]" if on.values > 1 else f"values[{start}]")
        start += on.values
    return eval(f"lambda values: body({', '.join(parts)})", {"body": body})  # type: ignore[no-any-return]


def blank(body: type[Body]) -> Any:
    """Return a declared body with all values 0."""
    shape = struct.Struct(f"<{_format(body)}")
    return _nested(body, 0)(shape.unpack(bytes(shape.size)))


_NUMBERS = {body: number for number, body in enumerate(BODIES, 1)}
_STRUCTS = {number: struct.Struct(_HEADER + _format(body)) for body, number in _NUMBERS.items()}
_FLAT = {number: _flat(body) for body, number in _NUMBERS.items()}
_NESTED = {number: _nested(body) for body, number in _NUMBERS.items()}
_COMMAND, _WALL = _NUMBERS[CommandFrame], struct.Struct(f"<{_format(WallMessage)}")
_WALLED = [_STRUCTS[_COMMAND].size + _WALL.size * count for count in range(MOST_WALLS + 1)]
"""Lengths of header and body of a CMD, by the number of its walls."""


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
        data = _STRUCTS[number].pack(MAGIC, VERSION, number, session, sequence & WRAP, time, *_FLAT[number](body))
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
        body = _NESTED[number](values)
        if number == _COMMAND and (end := len(data) - self._overhead) > _WALLED[0]:
            walls = tuple(map(WallMessage._make, _WALL.iter_unpack(data[_WALLED[0] : end])))
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
