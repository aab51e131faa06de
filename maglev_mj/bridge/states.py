"""The words that both ends of the wire share: states of a device, its faults, and how it answers."""

from __future__ import annotations

from enum import IntEnum, IntFlag

__all__ = ["Fault", "Flag", "HelloStatus", "Operation", "Result", "State", "fault_names"]


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
    """A diode repeats itself while the others do not."""
    CLOCK = 1024
    """The device's timestamps jumped."""
    NOT_FOLLOWING = 2048
    """The flotor does not go where it is led: wrong signs, diodes exchanged, or something holds it."""
    HOST = 4096
    """The host's program failed, or lost the device's samples."""


class Flag(IntFlag):
    """In a STATE frame."""

    HOLDING = 1
    """Commands are missing: the currents agreed at arming are on."""


class Operation(IntEnum):
    """What a host asks for in a CTRL frame."""

    ARM = 1
    DISARM = 2
    ESTOP = 3
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
