"""Faults that can be injected into a simulated device."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from maglev_mj.errors import ParameterError, check_one_of

if TYPE_CHECKING:
    from maglev_mj.bridge.twin.firmware import Reading
    from maglev_mj.bridge.wire import StateReport

_MS = 1_000_000


class Effect(NamedTuple):
    """Effect of one kind of fault with argument K.

    `begin` acts once on a `Twin`; `read` and `report` change its readings and reports.
    """

    words: str
    largest: int  # K
    begin: Callable[[Any, int], None] | None = None
    read: Callable[[Reading, Reading, int], Reading] | None = None  # current reading, reading at the start, K
    report: Callable[[StateReport, int], StateReport] | None = None


def _with(values: Sequence[float], first: int, *others: float) -> tuple[float, ...]:
    """Return values with those from index `first` on replaced by others."""
    return (*values[:first], *others, *values[first + len(others) :])


def _put(name: str, value: float) -> Callable[..., Any]:
    """Return a function that sets entry K of a field."""
    return lambda now, *others: now._replace(**{name: _with(getattr(now, name), others[-1], value)})


def _keep(name: str) -> Callable[..., Any]:
    """Return a function that freezes a field."""
    return lambda now, first, _: now._replace(**{name: getattr(first, name)})


def _stuck_diode(now: Reading, first: Reading, diode: int) -> Reading:
    return now._replace(spots=_with(now.spots, 2 * diode, *first.spots[2 * diode : 2 * diode + 2]))


def _swapped_diodes(now: Reading, _: Reading, diode: int) -> Reading:
    first, second = 2 * diode, 2 * ((diode + 1) % 3)
    spots = _with(now.spots, first, *now.spots[second : second + 2])
    return now._replace(spots=_with(spots, second, *now.spots[first : first + 2]))


def _invalid_diode(now: Reading, _: Reading, diode: int) -> Reading:
    return now._replace(valid=now.valid & ~(1 << diode))


def _clock_jump(twin: Any, milliseconds: int) -> None:
    twin.ahead += milliseconds * _MS


def _silence(twin: Any, milliseconds: int) -> None:
    twin.silent_until = twin.board.now + milliseconds * _MS


def _late_sensor(twin: Any, milliseconds: int) -> None:
    twin.sensor_delay = milliseconds * _MS


def _stuck_amplifier(twin: Any, coil: int) -> None:
    twin.board.stuck[coil] = float(twin.plant.currents[coil])


def _hung_firmware(twin: Any, _: int) -> None:
    twin.hung = True


_NAN, _HOT = _put("temperatures", math.nan), _put("temperatures", 5.0)
INJECTED_FAULTS = {
    "dead-coil": Effect("coil K gives no current", 5, lambda twin, k: twin.plant.open_coil(k), _put("measured", 0.0)),
    "stuck-amplifier": Effect("coil K keeps its current, whatever is commanded", 5, _stuck_amplifier),
    "stuck-diode": Effect("diode K repeats its last spot", 2, read=_stuck_diode),
    "stuck-diodes": Effect("all diodes repeat their last spots (K is 0)", 0, read=_keep("spots")),
    "stuck-counter": Effect("the conversion counter stops (K is 0)", 0, read=_keep("conversions")),
    "invalid-diode": Effect("diode K reports its spot as invalid", 2, read=_invalid_diode),
    "swapped-diodes": Effect("the cables of diodes K and (K + 1) mod 3 are swapped", 2, read=_swapped_diodes),
    "nan-spot": Effect("spot coordinate K is NaN", 5, read=_put("spots", math.nan)),
    "nan-current": Effect("the measured current of coil K is NaN", 5, read=_put("measured", math.nan)),
    "nan-temperature": Effect("the reported temperature of coil K is NaN", 5, report=_NAN),
    "hot-report": Effect("coil K reports five times its temperature limit", 5, report=_HOT),
    "clock-jump": Effect("the device's clock jumps ahead by K milliseconds", 10_000, _clock_jump),
    "silence": Effect("no frame is sent or received for K milliseconds", 60_000, _silence),
    "late-sensor": Effect("the diodes are read K milliseconds late", 100, _late_sensor),
    "hung-firmware": Effect("the firmware hangs, the amplifier board works (K is 0)", 0, _hung_firmware),
}
"""Faults of a device by name."""


@dataclass(frozen=True, kw_only=True)
class InjectedFault:
    """Fault of a twin with its start time.

    Raises:
        ParameterError: If there is no such fault, or a number is outside its bounds.
    """

    kind: str  # one of INJECTED_FAULTS
    which: int  # its K
    at: float  # in simulated time [s]

    def __post_init__(self) -> None:
        check_one_of("fault", INJECTED_FAULTS, self.kind)
        most = INJECTED_FAULTS[self.kind].largest
        if not 0 <= self.which <= most:
            raise ParameterError(f"K of {self.kind} must be 0 to {most} (got {self.which})")
        from maglev_mj.parameters import number  # imports NumPy, which --help does not need

        number("fault time", self.at, at_least=0.0)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse NAME:K@SECONDS.

        Raises:
            ParameterError: If the text does not match.
        """
        match = re.fullmatch(r"([a-z-]+):(\d+)@(\d+\.?\d*)", text)
        if not match:
            names = ", ".join(INJECTED_FAULTS)
            raise ParameterError(f"fault must be NAME:K@SECONDS with NAME one of {names} (got {text!r})")
        return cls(kind=match[1], which=int(match[2]), at=float(match[3]))
