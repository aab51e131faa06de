"""Faults that a simulated device can be given: one table of what each does, and when it begins."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from maglev_mj.bridge.firmware import Reading
from maglev_mj.bridge.wire import StateReport
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import number

__all__ = ["INJECTED_FAULTS", "Effect", "InjectedFault"]

_MS = 1_000_000
_NAN = float("nan")


class Effect(NamedTuple):
    """A kind of fault.

    Attributes:
        words: What goes wrong.
        largest: K.
        begin: Done once, to a `Twin`, with K.
        read: Returns what the device reads instead, from that, the reading at which it began, and K.
        report: Returns what the device reports instead, from that and K.
    """

    words: str
    largest: int
    begin: Callable[[Any, int], None] | None = None
    read: Callable[[Reading, Reading, int], Reading] | None = None
    report: Callable[[StateReport, int], StateReport] | None = None


def _with(values: Sequence[float], first: int, *others: float) -> tuple[float, ...]:
    """Return values with others from a place on."""
    return (*values[:first], *others, *values[first + len(others) :])


def _dead_coil(twin: Any, coil: int) -> None:
    twin.plant.open_coil(coil)


def _stuck_diode(now: Reading, first: Reading, diode: int) -> Reading:
    return now._replace(spots=_with(now.spots, 2 * diode, *first.spots[2 * diode : 2 * diode + 2]))


def _swapped_diodes(now: Reading, _: Reading, diode: int) -> Reading:
    one, other = 2 * diode, 2 * ((diode + 1) % 3)
    spots = _with(now.spots, one, *now.spots[other : other + 2])
    return now._replace(spots=_with(spots, other, *now.spots[one : one + 2]))


def _clock_jump(twin: Any, milliseconds: int) -> None:
    twin.ahead += milliseconds * _MS


def _silence(twin: Any, milliseconds: int) -> None:
    twin.silent_until = twin.board.now + milliseconds * _MS


def _stuck_amplifier(twin: Any, coil: int) -> None:
    twin.board.stuck[coil] = float(twin.plant.currents[coil])


def _hung_firmware(twin: Any, _: int) -> None:
    twin.hung = True


INJECTED_FAULTS = {
    "dead-coil": Effect(
        "coil K gives no current", 5, _dead_coil, lambda now, _, k: now._replace(measured=_with(now.measured, k, 0.0))
    ),
    "stuck-amplifier": Effect("coil K keeps its current, whatever is asked for", 5, _stuck_amplifier),
    "stuck-diode": Effect("diode K repeats its last spot", 2, read=_stuck_diode),
    "stuck-diodes": Effect(
        "all diodes repeat their last spots (K is 0)", 0, read=lambda now, first, _: now._replace(spots=first.spots)
    ),
    "stuck-counter": Effect(
        "the conversion counter stands (K is 0)",
        0,
        read=lambda now, first, _: now._replace(conversions=first.conversions),
    ),
    "invalid-diode": Effect(
        "diode K says that its spot cannot be trusted",
        2,
        read=lambda now, _, k: now._replace(valid=now.valid & ~(1 << k)),
    ),
    "swapped-diodes": Effect("the cables of diode K and the next are exchanged", 2, read=_swapped_diodes),
    "nan-spot": Effect(
        "coordinate K is not a number", 5, read=lambda now, _, k: now._replace(spots=_with(now.spots, k, _NAN))
    ),
    "nan-current": Effect(
        "the measured current of coil K is not a number",
        5,
        read=lambda now, _, k: now._replace(measured=_with(now.measured, k, _NAN)),
    ),
    "nan-temperature": Effect(
        "the temperature of coil K is reported as not a number",
        5,
        report=lambda now, k: now._replace(temperatures=_with(now.temperatures, k, _NAN)),
    ),
    "hot-report": Effect(
        "the temperature of coil K is reported as 5",
        5,
        report=lambda now, k: now._replace(temperatures=_with(now.temperatures, k, 5.0)),
    ),
    "clock-jump": Effect("the device's clock jumps ahead by K milliseconds", 10_000, _clock_jump),
    "silence": Effect("nothing comes or goes for K milliseconds", 60_000, _silence),
    "hung-firmware": Effect("the firmware hangs, the amplifier board does not (K is 0)", 0, _hung_firmware),
}
"""Faults of a device by name."""


@dataclass(frozen=True, kw_only=True)
class InjectedFault:
    """A fault of a twin, and when it begins.

    Args:
        kind: One of INJECTED_FAULTS.
        which: Its K.
        at: When, in simulated time [s].

    Raises:
        ParameterError: If there is no such fault, or a number is outside its bounds.
    """

    kind: str
    which: int
    at: float

    def __post_init__(self) -> None:
        if self.kind not in INJECTED_FAULTS:
            raise ParameterError(f"fault must be one of {', '.join(INJECTED_FAULTS)}, not {self.kind!r}")
        most = INJECTED_FAULTS[self.kind].largest
        if not 0 <= self.which <= most:
            raise ParameterError(f"{self.kind} must be of 0 to {most}, not {self.which}")
        number("fault time", self.at, at_least=0.0)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return what NAME:K@SECONDS says.

        Raises:
            ParameterError: If it says nothing.
        """
        found = re.fullmatch(r"([a-z-]+):(\d+)@(\d+\.?\d*)", text)
        if not found:
            raise ParameterError(
                f"fault must be NAME:K@SECONDS with a name of {', '.join(INJECTED_FAULTS)}, not {text!r}"
            )
        return cls(kind=found[1], which=int(found[2]), at=float(found[3]))
