"""What can go wrong with a device, to be tried on a twin."""

from __future__ import annotations

import re
from dataclasses import dataclass

from maglev_mj.errors import ParameterError
from maglev_mj.parameters import number

__all__ = ["MISFORTUNES", "Misfortune"]

MISFORTUNES = {
    "dead-coil": ("coil K gives no current", 5),
    "stuck-diode": ("diode K repeats its last spot", 2),
    "invalid-diode": ("diode K says that its spot cannot be trusted", 2),
    "swapped-diodes": ("the cables of diode K and the next are exchanged", 2),
    "clock-jump": ("the device's clock jumps ahead by K milliseconds", 10_000),
    "silence": ("nothing comes or goes for K milliseconds", 60_000),
}
"""Each by name: what it is, and the largest K."""


@dataclass(frozen=True, kw_only=True)
class Misfortune:
    """One of them, and when it happens.

    Args:
        kind: One of MISFORTUNES.
        which: Its K.
        at: When, in simulated time [s].

    Raises:
        ParameterError: If there is no such misfortune, or a number is outside its bounds.
    """

    kind: str
    which: int
    at: float

    def __post_init__(self) -> None:
        if self.kind not in MISFORTUNES:
            raise ParameterError(f"fault must be one of {', '.join(MISFORTUNES)}, not {self.kind!r}")
        most = MISFORTUNES[self.kind][1]
        if not 0 <= self.which <= most:
            raise ParameterError(f"{self.kind} must be of 0 to {most}, not {self.which}")
        number("fault time", self.at, at_least=0.0)

    @classmethod
    def parse(cls, text: str) -> Misfortune:
        """Return what NAME:K@SECONDS says.

        Raises:
            ParameterError: If it says nothing.
        """
        found = re.fullmatch(r"([a-z-]+):(\d+)@(\d+\.?\d*)", text)
        if not found:
            raise ParameterError(f"fault must be NAME:K@SECONDS with a name of {', '.join(MISFORTUNES)}, not {text!r}")
        return cls(kind=found[1], which=int(found[2]), at=float(found[3]))
