"""Arm behind Haply's Inverse service: its numbers and messages; as a plant, with limits and guards of the host.

Source: docs.haply.co/inverseSDK, service 3.x, pages "websocket protocol" and "control commands".
"""

from __future__ import annotations

import hmac
import json
import math
import os
import re
import socket
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, NoReturn, Self
from urllib.parse import parse_qsl

from maglev_mj.bridge.links import Link, LinkError
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError, PlantError, require
from maglev_mj.frames import Command, Sample, rotation_vector
from maglev_mj.keywords import checked, every_tick
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

_PATIENCE, _NO_FORCE, _NO_ROTATION = 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
_URL = re.compile(r"haply://([\w.-]+):(\d{1,5})(?:\?(.+))?", re.ASCII)
_QUERY = {"rate": r"\d{1,5}(?:\.\d+)?", "device": r"[^\s&]+", "grip": r"[^\s&]+"}
_ADDRESS = "haply://HOST:PORT, optionally with ?rate=HZ, device=ID and grip=ID, joined by &"

_CONDITIONS = {
    "connected": "not connected",
    "power_supply": "no power supply",
    "awake": "not awake",
    "calibrated": "not calibrated",
    "ready": "not ready",
}
"""Values of a status that must not be false, and what it means if one is.

A message need not hold them all: versions of the service differ. Nothing documents `in_use` and `started`, so they are
not judged; an idle arm reports in_use false. `connected` and `awake` are not verified with a service.
"""

_UNIT = 0.9, 1.1
"""Bounds of the norm of an orientation; a grip that has not measured one may report zeros."""


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


def _entries(data: str | bytes, section: str) -> list[tuple[str, dict[str, Any]]]:
    """Return device and entry of each entry in a message's section, "" for one without device; [] if it is invalid."""
    try:
        listed = json.loads(data)[section]
        return [(str(entry.get("device_id", "")), entry) for entry in listed if isinstance(entry, dict)]
    except (ValueError, LookupError, TypeError, RecursionError):  # the last if it is nested too deep
        return []


def devices(data: str | bytes, section: str = "inverse3") -> dict[str, Any]:
    """Return the entries of a message's section by device; {} if it is invalid."""
    return dict(_entries(data, section))


def numbers_at(entry: Any, *path: str, names: str = "xyz") -> list[float] | None:
    """Return the named numbers at a path of keys, which may be NaN; None if one is missing or not a number."""
    try:
        for key in path:
            entry = entry[key]
        values = [entry[name] for name in names]
        return list(map(float, values)) if {*map(type, values)} <= {int, float} else None
    except (LookupError, TypeError, OverflowError):
        return None


def _only(entries: Sequence[tuple[str, Any]], wanted: str | None, kind: str) -> tuple[str, Any]:
    """Return the wanted entry of a section, or the only one.

    Args:
        entries: Devices and their entries.
        wanted: Device; None for the only one.
        kind: "device" or "grip", as in an address.

    Raises:
        PlantError: If there is no such entry, or more than one; the devices are listed.
    """
    matches = [pair for pair in entries if wanted is None or pair[0] == wanted]
    if len(matches) == 1:
        return matches[0]
    names = ", ".join(repr(name) for name, _ in entries) or "none"
    if not matches:
        missing = kind if wanted is None else f"{kind} {wanted!r}"
        raise PlantError(f"the service reports no {missing} (connected: {names})")
    if len({name for name, _ in matches}) < len(matches):
        raise PlantError(f"identifiers must differ, but the service reports {names}: disconnect a {kind}")
    raise PlantError(f"the service reports {len(matches)} {kind}s, {names}: choose one by ?{kind}=ID in the address")


class ArmState(NamedTuple):
    """State of an arm in a message of the service, valid: the arm reports nothing that forbids a force.

    Attributes:
        position: Position of the tip in the service's coordinates [m], (3,).
        rotation: Rotation of the grip [rad], (3,); 0 without a grip.
    """

    position: list[float]
    rotation: tuple[float, float, float]

    @classmethod
    def of(cls, message: str | bytes, device: str, grip: str | None) -> Self:
        """Return the state of an arm.

        Args:
            message: Inventory, or a state update.
            device: Identifier of the arm.
            grip: Identifier of its grip; None for none.

        Raises:
            PlantError: If the arm or the grip is missing, the arm reports that it cannot be used, or a number is not
                finite.
        """
        _, entry = _only(_entries(message, "inverse3"), device, "device")
        status = entry.get("status", {})  # optional in an update, as the configuration is
        if not isinstance(status, dict):
            raise PlantError(f"the service reports no valid status of {device!r} (got {status!r})")
        if faults := [words for name, words in _CONDITIONS.items() if status.get(name, True) is not True]:
            remedy = "check its cable and power, and calibrate it with Haply's software"
            raise PlantError(f"the service reports of {device!r}: {', '.join(faults)}; {remedy}")
        position = numbers_at(entry, "state", "cursor_position")
        if position is None or not math.isfinite(sum(position)):
            raise PlantError(f"the service reports no finite cursor_position (got {position})")
        if grip is None:
            return cls(position, _NO_ROTATION)
        turn = numbers_at(
            _only(_entries(message, "wireless_verse_grip"), grip, "grip")[1], "state", "orientation", names="wxyz"
        )
        if turn is None or not _UNIT[0] < math.hypot(*turn) < _UNIT[1]:  # false for NaN
            raise PlantError(f"the service reports no orientation of grip {grip!r} as a unit quaternion (got {turn})")
        w, x, y, z = turn
        return cls(position, rotation_vector(w, x, y, z))


def token_of(key: bytes | None) -> str:
    """Return the query with the access token derived from a shared key; empty without."""
    return "" if key is None else f"?token={hmac.digest(key, b'haply', 'sha256').hex()}"


def _query(text: str | None) -> dict[str, str] | None:
    """Return the values in an address after ?; None if one is invalid, unknown or repeated."""
    pairs = parse_qsl(text or "", keep_blank_values=True)
    if len({name for name, _ in pairs}) < len(pairs) or bool(text) != bool(pairs):
        return None
    if not all(name in _QUERY and re.fullmatch(_QUERY[name], value, re.ASCII) for name, value in pairs):
        return None
    query = dict(pairs)
    return query if float(query.get("rate", 1.0)) else None


class WebSocketLink:
    """Link to a service at haply://HOST:PORT, optionally with ?rate=HZ, device=ID and grip=ID, joined by &.

    Args:
        address: The address.
        key: Key of a twin; None for a service, which has none.

    Attributes:
        rate: Rate in the address [Hz], or None.
        device: Identifier of an arm in the address, or None.
        grip: Identifier of a grip in the address, or None.

    Raises:
        ParameterError: If the address is invalid.
        LinkError: If no service answers.
        MissingPackageError: If websockets is not installed.
    """

    def __init__(self, address: str, key: bytes | None = None) -> None:
        if not (url := _URL.fullmatch(address)) or not 0 < int(url[2]) <= 65535 or (query := _query(url[3])) is None:
            raise ParameterError(f"address must be {_ADDRESS} (got {address!r})")
        require(("websockets",), "haply", "haply:// requires websockets")
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        self.rate = float(query["rate"]) if "rate" in query else None
        self.device, self.grip, self._failures = query.get("device"), query.get("grip"), (WebSocketException, OSError)
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


@checked
class HaplyPlant(AbstractContextManager["HaplyPlant"]):
    """Three-axis arm as a plant, paced by the host.

    `read` sends the last command at absolute deadlines and receives the state after it, so a force answers a state that
    is one period old. Every fault fades the force to zero within 20 ms and raises; afterwards only `close` works. A
    fault is: a force for a sample older than 20 ms (or two periods), or for the third sample in a row older than 1.5
    periods; a closed connection; a reply without a valid state of the arm (see `ArmState`); a command that is not
    finite; a tip above the speed limit while a force acts.

    Args:
        link: Address haply://HOST:PORT, optionally with ?rate=HZ, device=ID and grip=ID, joined by &; or an open link,
            closed with the plant.
        arm: Numbers of the arm.
        period: Sample period [s]; by default the address's, or else the arm's.
        device: Identifier of the arm; by default the address's, or else the only one's.
        grip: Identifier of the grip; by default the address's, or else the only one's.
        key: Key of a twin on another machine.

    Attributes:
        period: Sample period [s].
        delay: Delay from a sample to its command's effect [s].
        device: Identifier of the arm.
        grip: Identifier of its grip, whose rotation the samples have; None without one at the start.
        centre: Position of the tip that counts as 0 [m], (3,); at first that at the start.
        age: Time from the last sample to its answer [s].
        round_trip: Duration of the last exchange [s].
        hand_wrench: NaN: not measured.

    Raises:
        ParameterError: If an argument is outside its bounds.
        LinkError: If no service answers.
        PlantError: If no such arm is connected, or several are and none is named; or if its state is invalid.
    """

    hand_wrench = (math.nan,) * 6

    def __init__(
        self,
        link: str | Link,
        *,
        arm: Arm | None = None,
        period: float | None = None,
        device: str | None = None,
        grip: str | None = None,
        key: bytes | None = None,
    ) -> None:
        self.arm = arm or Arm()
        self._link: Link = WebSocketLink(link, key) if isinstance(link, str) else link
        own = 1.0 / (getattr(self._link, "rate", None) or self.arm.rate)
        self.period = number("period", own if period is None else period, **SAMPLE_PERIOD)
        self.delay, self._stale = self.period + self.arm.delay, max(STALE, 2.0 * self.period)
        self.age = self.round_trip = 0.0
        self._tick, self._late, self._fault, self._closed, self._process = -1, 0, "", False, os.getpid()
        self._force: Sequence[float] = _NO_FORCE
        try:
            inventory = self._link.receive(_PATIENCE) or b""
            named = device or getattr(self._link, "device", None), grip or getattr(self._link, "grip", None)
            self.device, entry = _only(_entries(inventory, "inverse3"), named[0], "device")
            if "status" not in entry:  # only updates may leave it out
                raise PlantError(f"the service reports no status of {self.device!r}: it must be of version 3 or later")
            grips = _entries(inventory, "wireless_verse_grip")
            self.grip = _only(grips, named[1], "grip")[0] if grips or named[1] else None
            self.centre = self._position = ArmState.of(inventory, self.device, self.grip).position
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
            position, rotation = ArmState.of(self._exchange(), self.device, self.grip)
        except (LinkError, PlantError) as error:
            self._trip(str(error))
        speed = math.dist(position, self._position) / max(self.age, self.period)
        if any(self._force) and speed > self.arm.speed_limit:  # a hand may move a free arm faster
            self._trip(f"the tip moves at {speed:.3g} m/s, above the limit of {self.arm.speed_limit:g} m/s")
        self._position = position
        self._tick = max(self._tick + 1, round((self._sent - self._start) * 1e-9 / self.period))
        place = [part - centre for part, centre in zip(position, self.centre)]
        return Sample(self._tick, self._tick * self.period, [*place, *rotation])

    @every_tick
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
        """Send a zero force and close the link; idempotent. In a forked process the arm is its parent's."""
        if not self._closed:
            self._closed = True
            if self._process != os.getpid():
                return
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
