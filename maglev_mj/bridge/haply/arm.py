"""Numbers of a three-axis arm, and the JSON messages of its service.

Source: docs.haply.co/inverseSDK, service 3.x, pages "websocket protocol" and "control commands".
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Self

from maglev_mj.device import Device
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import numbers


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Numbers of a three-axis arm; the defaults are assumed for a Haply Inverse3, which publishes none.

    Raises:
        ParameterError: If a value is outside its bounds.

    Example:
        >>> from maglev_mj.bridge import Arm
        >>> Arm().limited([0.0, 16.0, 4.0])  # scaled, so that the direction stays
        [0.0, 8.0, 2.0]
    """

    mass: float = 0.15  # apparent mass at the tip [kg]; gravity is compensated
    force_limit: Sequence[float] = (8.0, 8.0, 8.0)  # by axis [N]
    range: Sequence[float] = (0.1, 0.1, 0.08)  # to either side of the centre, by axis [m]
    speed_limit: float = 0.5  # of the tip while a force acts [m/s]
    rate: float = 1000.0  # of the device's samples [Hz]
    delay: float = 0.001  # from a force's arrival to its effect [s]

    def __post_init__(self) -> None:
        for name in ("mass", "speed_limit", "rate", "force_limit", "range"):
            numbers(name, getattr(self, name), shape="(3,)" if name in ("force_limit", "range") else "()", above=0.0)
        numbers("delay", self.delay, shape="()", at_least=0.0)

    @classmethod
    def of(cls, device: Device) -> Self:
        """Return the numbers that a device file states; the defaults for the published joystick, which is no arm.

        Raises:
            ParameterError: If the device has coils.
        """
        if device.published:
            return cls()
        if device.force is None:
            raise ParameterError(f"device must take a force, [force] in its file (got {device.name!r}, with coils)")
        force, reach = device.force.limit, device.range.translation
        return cls(mass=device.mass, force_limit=force, range=reach, rate=1.0 / device.period, delay=device.delay)

    def limited(self, force: Sequence[float]) -> list[float]:
        """Return a force scaled to the limits, (3,) [N]."""
        excess = max(1.0, *(abs(part) / limit for part, limit in zip(force, self.force_limit)))
        return [part / excess for part in force]


def vector(values: Iterable[float], names: str = "xyz") -> dict[str, float]:
    """Return components as a JSON object."""
    return dict(zip(names, map(float, values)))


def force_message(device: str, force: Sequence[float]) -> bytes:
    """Return the message that commands a force [N]: with both keys, since versions of the service differ."""
    commands = {"set_cursor_force": {"vector": vector(force), "values": vector(force)}}
    return json.dumps({"inverse3": [{"device_id": device, "commands": commands}]}).encode()


def devices(data: str | bytes, section: str = "inverse3") -> dict[str, Any]:
    """Return the entries of a message's section by device, "" for one that names none; {} if they are invalid."""
    try:
        return {entry.get("device_id", ""): entry for entry in json.loads(data)[section]}
    except (ValueError, LookupError, TypeError, AttributeError):
        return {}


def numbers_at(entry: Any, *path: str, names: str = "xyz") -> list[float] | None:
    """Return the named numbers at a path of keys, which may be NaN; None if they are missing."""
    try:
        for key in path:
            entry = entry[key]
        return [float(entry[name]) for name in names]
    except (LookupError, TypeError, ValueError):
        return None


def token_of(key: bytes | None) -> str:
    """Return the query with the access token derived from a shared key; empty without."""
    return "" if key is None else f"?token={hmac.digest(key, b'haply', 'sha256').hex()}"
