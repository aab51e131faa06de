"""Numbers of a three-axis arm, and the JSON messages of its service.

Source: docs.haply.co/inverseSDK, service 3.x, pages "websocket protocol" and "control commands".
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.parameters import numbers

XYZ = AXES[:3]


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
    speed_limit: float = 0.5  # of the tip [m/s]
    rate: float = 1000.0  # of the device's samples [Hz]
    delay: float = 0.001  # from a force's arrival to its effect [s]

    def __post_init__(self) -> None:
        for name in ("mass", "speed_limit", "rate"):
            numbers(name, getattr(self, name), shape="()", above=0.0)
        for name in ("force_limit", "range"):
            numbers(name, getattr(self, name), shape="(3,)", above=0.0)
        numbers("delay", self.delay, shape="()", at_least=0.0)

    def limited(self, force: Sequence[float]) -> list[float]:
        """Return a force scaled to the limits, (3,) [N]."""
        excess = max(abs(part) / limit for part, limit in zip(force, self.force_limit))
        return [part / max(excess, 1.0) for part in force]


def vector(values: Iterable[float]) -> dict[str, float]:
    """Return three components as a JSON object."""
    return dict(zip(XYZ, map(float, values)))


def force_message(device: str, force: Sequence[float]) -> str:
    """Return the message that commands a force [N]: both keys, since versions of the service differ."""
    commands = {"set_cursor_force": {"vector": vector(force), "values": vector(force)}}
    return json.dumps({"inverse3": [{"device_id": device, "commands": commands}]})


def parsed(data: str | bytes) -> dict[str, Any]:
    """Return a message; {} if it is not a JSON object."""
    try:
        message = json.loads(data)
    except ValueError:  # UnicodeDecodeError too
        return {}
    return message if isinstance(message, dict) else {}


def entries(message: dict[str, Any], section: str) -> list[dict[str, Any]]:
    """Return the entries of a message's section."""
    listed = message.get(section)
    return [entry for entry in listed if isinstance(entry, dict)] if isinstance(listed, list) else []


def numbers_at(entry: Any, *path: str, names: Sequence[str] = XYZ) -> list[float] | None:
    """Return the named numbers at a path of keys, which may be NaN; None if one is missing or no number."""
    try:
        for key in path:
            entry = entry[key]
        return [float(entry[name]) for name in names]
    except (KeyError, TypeError, ValueError):
        return None


def finite(values: Sequence[float]) -> bool:
    """Return True if all values are finite."""
    return bool(np.isfinite(values).all())


def token_of(key: bytes | None) -> str:
    """Return the access token in the service's URL, derived from a shared key; empty without."""
    return "" if key is None else hmac.digest(key, b"haply", "sha256").hex()
