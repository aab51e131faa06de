"""Arm behind Haply's Inverse service: its numbers and messages; as a plant, with limits and guards of the host.

Source: docs.haply.co/inverseSDK, service 3.x, pages "websocket protocol" and "control commands".
"""

from __future__ import annotations

import hmac
import json
import math
import re
import socket
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import Any, NoReturn, Self

from maglev_mj.bridge.links import Link, LinkError
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError, PlantError, require
from maglev_mj.frames import Command, Sample, rotation_vector
from maglev_mj.parameters import SAMPLE_PERIOD, number, numbers
from maglev_mj.session.access import resolve

STALE = 0.02
"""Longest age of a sample whose answer is still sent [s], or two periods if that is longer."""

_FADE, _LANDING = 0.02, 0.1
"""Times in which the force fades after a fault and in a landing [s]."""

_LATE, _MOST_LATE = 1.5, 3
"""Age of a late sample in periods, and number of late samples in a row that ends a flight."""

_FARTHEST = 1.0
"""Largest coordinate of a position in metres [m]; an Inverse3 reaches 0.3 m."""

_PATIENCE, _NO_FORCE = 1.0, (0.0, 0.0, 0.0)
_URL = re.compile(r"haply://([\w.-]+):(\d{1,5})(?:\?rate=(\d{1,5}(?:\.\d+)?))?", re.ASCII)


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


class WebSocketLink:
    """Link to a service at haply://HOST:PORT, optionally with ?rate=HZ.

    Args:
        address: The address.
        key: Key of a twin; None for a service, which has none.

    Attributes:
        rate: Rate in the address [Hz], or None.

    Raises:
        ParameterError: If the address is invalid.
        LinkError: If no service answers.
        MissingPackageError: If websockets is not installed.
    """

    def __init__(self, address: str, key: bytes | None = None) -> None:
        if not (url := _URL.fullmatch(address)) or not 0 < int(url[2]) <= 65535 or not float(url[3] or 1.0):
            raise ParameterError(f"address must be haply://HOST:PORT or haply://HOST:PORT?rate=HZ (got {address!r})")
        require(("websockets",), "haply", "haply:// requires websockets")
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        self.rate, self._failures = url[3] and float(url[3]), (WebSocketException, OSError)
        try:
            # opened here: websockets may connect through a proxy
            opened = socket.create_connection((resolve(url[1]), int(url[2])), _PATIENCE)
            opened.settimeout(None)
            times: Any = {"open_timeout": _PATIENCE, "close_timeout": _FADE}
            self._socket = connect(f"ws://{url[1]}:{url[2]}/{token_of(key)}", sock=opened, compression=None, **times)
        except self._failures as error:
            raise LinkError(f"cannot reach an Inverse service at {url[1]}:{url[2]} ({error})") from None

    def send(self, data: bytes) -> None:
        """Send one message, as text."""
        self._try(self._socket.send, data.decode())

    def receive(self, timeout: float) -> bytes | None:
        """See `Link.receive`."""
        message: str | bytes | None = self._try(self._socket.recv, timeout)
        return message.encode() if isinstance(message, str) else message

    now = staticmethod(time.monotonic_ns)

    def close(self) -> None:
        """Close the link; idempotent."""
        self._socket.close()

    def _try(self, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except TimeoutError:
            return None
        except self._failures as error:
            raise LinkError(f"the service closed the connection ({error})") from None


class HaplyPlant(AbstractContextManager["HaplyPlant"]):
    """Three-axis arm as a plant, paced by the host.

    `read` sends the last command at absolute deadlines and receives the state after it, so a force answers a state that
    is one period old. Every fault fades the force to zero within 20 ms and raises; afterwards only `close` works. A
    fault is: a force for a sample older than 20 ms (or two periods), or for the third sample in a row older than 1.5
    periods; a closed connection; a reply without a finite position of the device; a command that is not finite; a tip
    above the speed limit while a force acts.

    Args:
        link: Address haply://HOST:PORT or haply://HOST:PORT?rate=HZ, or an open link; closed with the plant.
        arm: Numbers of the arm.
        period: Sample period [s]; by default the address's, or else the arm's.
        device: Identifier of the arm; by default the first.
        key: Key of a twin on another machine.

    Attributes:
        period: Sample period [s].
        delay: Delay from a sample to its command's effect [s].
        device: Identifier of the arm.
        centre: Position of the tip that counts as 0 [m], (3,); at first that at the start.
        age: Time from the last sample to its answer [s].
        round_trip: Duration of the last exchange [s].
        hand_wrench: NaN: not measured.

    Raises:
        ParameterError: If an argument is outside its bounds.
        LinkError: If no service answers.
        PlantError: If no such arm is connected, or its position is invalid.
    """

    hand_wrench = (math.nan,) * 6

    def __init__(
        self,
        link: str | Link,
        *,
        arm: Arm | None = None,
        period: float | None = None,
        device: str | None = None,
        key: bytes | None = None,
    ) -> None:
        self.arm = arm or Arm()
        self._link: Link = WebSocketLink(link, key) if isinstance(link, str) else link
        own = 1.0 / (getattr(self._link, "rate", None) or self.arm.rate)
        self.period = number("period", own if period is None else period, **SAMPLE_PERIOD)
        self.delay, self._stale = self.period + self.arm.delay, max(STALE, 2.0 * self.period)
        self.age = self.round_trip = 0.0
        self._tick, self._late, self._fault, self._closed = -1, 0, "", False
        self._force: Sequence[float] = _NO_FORCE
        try:
            inventory = self._link.receive(_PATIENCE) or b""
            self.device = device or next(iter(devices(inventory)), "arm")
            self.centre = self._position = self._position_in(inventory)
            if max(map(abs, self.centre)) > _FARTHEST:
                place = ", ".join(f"{part:g}" for part in self.centre)
                raise PlantError(f"cursor_position must be within {_FARTHEST:g} m (got {place}): is it in millimetres?")
        except BaseException:
            self._link.close()
            raise
        self._due = self._sent = self._start = self._link.now()

    def read(self) -> Sample:
        """Send the last command when the next sample is due; return the state after it.

        Raises:
            PlantError: If the arm or the link has a fault; the force is off.
        """
        self._require()
        try:
            reply = self._exchange()
            position = self._position_in(reply)
        except (LinkError, PlantError) as error:
            self._trip(str(error))
        speed = math.dist(position, self._position) / max(self.age, self.period)
        if any(self._force) and speed > self.arm.speed_limit:  # a hand may move a free arm faster
            self._trip(f"the tip moves at {speed:.3g} m/s, above the limit of {self.arm.speed_limit:g} m/s")
        self._position = position
        self._tick = max(self._tick + 1, round((self._sent - self._start) * 1e-9 / self.period))
        grip = next(iter(devices(reply, "wireless_verse_grip").values()), None)
        turn = numbers_at(grip, "state", "orientation", names="wxyz") or (1.0, 0.0, 0.0, 0.0)
        place = [part - centre for part, centre in zip(position, self.centre)]
        return Sample(self._tick, self._tick * self.period, [*place, *rotation_vector(*turn)])

    def write(self, command: Command) -> Command:
        """Set the force that the next `read` sends; return it as limited.

        Raises:
            PlantError: If it has torques, pulses or device walls, which the arm does not render (nothing changes); if
                it is not finite (the force is off).
        """
        self._require()
        force = [float(part) for part in command.force[:3]]
        if any(command.force[3:]) or any(command.extra or ()) or command.walls:
            raise PlantError("the arm renders forces only: torques, pulses and device walls must be zero")
        if not math.isfinite(sum(force)):
            self._trip(f"the command is not finite ({', '.join(f'{part:g}' for part in force)})")
        self._force = self.arm.limited(force)
        return Command([*self._force, 0.0, 0.0, 0.0])

    def recentre(self, place: Sequence[float] = _NO_FORCE) -> None:
        """Read a sample, and count its position as `place` from now on, (3,) [m]."""
        self.read()
        self.centre = [part - target for part, target in zip(self._position, place)]

    def land(self) -> None:
        """Fade the force to zero within 0.1 s, and close."""
        with suppress(LinkError):
            self._fade(_LANDING)
        self.close()

    def close(self) -> None:
        """Send a zero force and close the link; idempotent."""
        if not self._closed:
            self._closed = True
            with suppress(LinkError):
                self._link.send(force_message(self.device, _NO_FORCE))
            self._link.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _require(self) -> None:
        if self._closed or self._fault:
            raise PlantError(f"the force is off: {self._fault}" if self._fault else "the plant is closed")

    def _exchange(self) -> bytes:
        """Send the force when it is due, and return the reply."""
        link, period = self._link, round(self.period * 1e9)
        self._due += period
        self._wait(self._due)
        now = link.now()
        if self._tick < 0:
            self._start, self._sent = now, now - period
        self.age, self._sent = (now - self._sent) * 1e-9, now
        self._due = max(self._due, now - period)  # after a stall, do not catch up
        acting = any(self._force)
        self._late = self._late + 1 if acting and self.age > _LATE * self.period else 0
        if acting and self.age > self._stale:
            self._force = _NO_FORCE  # the service has dropped the force: do not fade from it
            raise PlantError(f"the sample was {self.age * 1e3:.0f} ms old when its answer was sent")
        if self._late >= _MOST_LATE:
            age = f"{self.age * 1e3:.1f} ms old"
            raise PlantError(f"{self._late} samples in a row were late, the last {age}: lower ?rate=")
        link.send(force_message(self.device, self._force))
        reply = link.receive(self._stale - self.period if acting else _PATIENCE)
        self.round_trip = (link.now() - now) * 1e-9
        if reply is None:
            raise PlantError(f"no reply of the service within {self.round_trip * 1e3:.0f} ms")
        return reply

    def _position_in(self, message: bytes) -> list[float]:
        """Return the arm's position in a message [m]; raise PlantError if it is missing or not finite."""
        if (entry := (connected := devices(message)).get(self.device)) is None:
            names = ", ".join(map(repr, connected)) or "none"
            raise PlantError(f"the service reports no device {self.device!r} (connected: {names})")
        position = numbers_at(entry, "state", "cursor_position")
        if position is None or not math.isfinite(sum(position)):
            raise PlantError(f"the service reports no finite cursor_position (got {position})")
        return position

    def _trip(self, reason: str) -> NoReturn:
        """Fade the force to zero and raise."""
        self._fault = reason
        with suppress(LinkError):
            self._fade(_FADE)
        raise PlantError(f"the force is off: {reason}")

    def _fade(self, duration: float) -> None:
        """Send a force that decreases to zero [s], whatever the service replies."""
        steps, last = max(round(duration / self.period), 1), self._force
        for step in range(1, steps + 1):
            due = self._link.now() + round(self.period * 1e9)
            self._link.send(force_message(self.device, [part * (1.0 - step / steps) for part in last]))
            self._wait(due)
        self._force = _NO_FORCE

    def _wait(self, due: int) -> None:
        """Wait until a time [ns]; detects a closed connection and discards late replies."""
        while (remaining := due - self._link.now()) > 0:
            self._link.receive(remaining * 1e-9)
