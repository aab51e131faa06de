"""Arm behind Haply's Inverse service as a plant, with limits and guards of the host."""

from __future__ import annotations

import math
import re
import socket
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NoReturn, Protocol, Self

from maglev_mj.bridge.haply.arm import XYZ, Arm, entries, finite, force_message, numbers_at, parsed, token_of
from maglev_mj.bridge.links import LinkError
from maglev_mj.errors import ParameterError, PlantError, require
from maglev_mj.frames import ZERO, Command, Sample, rotation_vector
from maglev_mj.parameters import SAMPLE_PERIOD, number
from maglev_mj.session.access import resolve

STALE = 0.02
"""Longest age of a sample whose answer is still sent [s], or two periods if that is longer."""

_FADE, _LANDING = 0.02, 0.1
"""Times in which the force fades after a fault and in a landing [s]."""

_LATE, _MOST_LATE = 1.5, 3
"""Age of a late sample in periods, and number of late samples in a row that ends a flight."""

_FARTHEST = 1.0
"""Largest coordinate of a position in metres [m]; an Inverse3 reaches 0.3 m."""

_PATIENCE = 1.0
_URL = re.compile(r"haply://([\w.-]+):(\d{1,5})(?:\?rate=(\d{1,5}(?:\.\d+)?))?", re.ASCII)


class JsonLink(Protocol):
    """Interface of a link to a service; `receive` and `send` raise LinkError once it is closed."""

    def send(self, text: str) -> None:
        """Send one message."""

    def receive(self, timeout: float) -> str | bytes | None:
        """Return the oldest received message, or None after `timeout` [s]."""

    def now(self) -> int:
        """Return the link's monotonic clock [ns]."""

    def close(self) -> None:
        """Close the link; idempotent."""


class WebSocketLink:
    """Link to a service over a WebSocket.

    Args:
        host: Name or IPv4 address of the service.
        port: Its port.
        key: Key of a twin; None for a service, which has none.

    Raises:
        ParameterError: If the host has no IPv4 address.
        LinkError: If no service answers.
        MissingPackageError: If websockets is not installed.
    """

    def __init__(self, host: str, port: int, key: bytes | None = None) -> None:
        require(("websockets",), "haply", "haply:// requires websockets")
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        self._failures = (WebSocketException, OSError)
        path = f"?token={token}" if (token := token_of(key)) else ""
        try:
            # opened here: websockets may connect through a proxy
            opened = socket.create_connection((resolve(host), port), _PATIENCE)
            opened.settimeout(None)
            options: Any = {"compression": None, "open_timeout": _PATIENCE, "close_timeout": _FADE}
            self._socket = connect(f"ws://{host}:{port}/{path}", sock=opened, **options)
        except self._failures as error:
            raise LinkError(f"cannot reach an Inverse service at {host}:{port}: {error}") from None

    def send(self, text: str) -> None:
        """See `JsonLink`."""
        try:
            self._socket.send(text)
        except self._failures as error:
            raise LinkError(f"the service closed the connection ({error})") from None

    def receive(self, timeout: float) -> str | bytes | None:
        """See `JsonLink`."""
        try:
            return self._socket.recv(timeout)
        except TimeoutError:
            return None
        except self._failures as error:
            raise LinkError(f"the service closed the connection ({error})") from None

    now = staticmethod(time.monotonic_ns)

    def close(self) -> None:
        """See `JsonLink`."""
        self._socket.close()


def _opened(address: str, key: bytes | None) -> tuple[JsonLink, float | None]:
    """Return the link to an address, and the rate in it [Hz]."""
    if not (url := _URL.fullmatch(address)) or not 0 < int(url[2]) <= 65535:
        raise ParameterError(f"address must be haply://HOST:PORT or haply://HOST:PORT?rate=HZ (got {address!r})")
    rate = None if url[3] is None else 1.0 / number("period", 1.0 / (float(url[3]) or math.inf), **SAMPLE_PERIOD)
    return WebSocketLink(url[1], int(url[2]), key), rate


class HaplyPlant:
    """Three-axis arm as a plant, paced by the host.

    `read` sends the last command at absolute deadlines and receives the state after it, so a force answers a state that
    is one period old. Every fault fades the force to zero within 20 ms and raises; afterwards only `close` works. A
    fault is: a force for a sample older than 20 ms (or two periods), or for the third sample in a row older than 1.5
    periods; a closed connection; a reply without a finite position of the device; a command that is not finite; a tip
    above the speed limit.

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
        centre: Position of the tip at the start, which counts as 0 [m], (3,).
        age: Time from the last sample to its answer [s].
        round_trip: Duration of the last exchange [s].
        hand_wrench: NaN: not measured.

    Raises:
        ParameterError: If an argument is outside its bounds.
        LinkError: If no service answers.
        PlantError: If no such arm is connected, or its position is invalid.

    Example:
        >>> from maglev_mj import Controller, Hold, drive
        >>> from maglev_mj.bridge import Arm, HaplyPlant, HaplyTwin
        >>> arm = Arm(rate=200.0)
        >>> spring = Controller([Hold(axes=("x", "y", "z"), stiffness=300.0, damping=8.0)], period=0.005)
        >>> twin = HaplyTwin(arm, lockstep=True, twist=(0.01, 0.0, 0.0))
        >>> with HaplyPlant(twin.link(), arm=arm) as plant:
        ...     last = drive(plant, spring, 400)
        >>> max(abs(part) for part in last.position) < 1e-6
        True
    """

    hand_wrench = (math.nan,) * 6

    def __init__(
        self,
        link: str | JsonLink,
        *,
        arm: Arm | None = None,
        period: float | None = None,
        device: str | None = None,
        key: bytes | None = None,
    ) -> None:
        self.arm = arm or Arm()
        self._link, rate = _opened(link, key) if isinstance(link, str) else (link, None)
        self.period = 1.0 / (rate or self.arm.rate) if period is None else number("period", period, **SAMPLE_PERIOD)
        self.delay, self._stale = self.period + self.arm.delay, max(STALE, 2.0 * self.period)
        self.age = self.round_trip = 0.0
        self._tick, self._late, self._fault, self._closed = -1, 0, "", False
        self._force: Sequence[float] = ZERO[:3]
        try:
            message = parsed(self._link.receive(_PATIENCE) or "")
            names = [str(entry.get("device_id")) for entry in entries(message, "inverse3")]
            if not names or device not in (None, *names):
                raise PlantError(f"the service reports no Inverse3 {device or ''}(connected: {names or 'none'})")
            self.device = device or names[0]
            self.centre = self._position = self._position_in(message)
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
            message = self._exchange()
            position = self._position_in(message)
        except (LinkError, PlantError) as error:
            self._trip(str(error))
        speed = math.dist(position, self._position) / max(self.age, self.period) if self._tick >= 0 else 0.0
        if speed > self.arm.speed_limit:
            self._trip(f"the tip moves at {speed:.3g} m/s, above the limit of {self.arm.speed_limit:g} m/s")
        self._position = position
        self._tick = max(self._tick + 1, round((self._sent - self._start) * 1e-9 / self.period))
        grip = next(iter(entries(message, "wireless_verse_grip")), {})
        turn = numbers_at(grip, "state", "orientation", names=("w", *XYZ)) or (1.0, 0.0, 0.0, 0.0)
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
        if not finite(force):
            self._trip(f"the command is not finite ({', '.join(f'{part:g}' for part in force)})")
        self._force = self.arm.limited(force)
        return Command([*self._force, 0.0, 0.0, 0.0])

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
                self._link.send(force_message(self.device, ZERO[:3]))
            self._link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _require(self) -> None:
        if self._closed or self._fault:
            raise PlantError(f"the force is off: {self._fault}" if self._fault else "the plant is closed")

    def _exchange(self) -> dict[str, Any]:
        """Send the force when it is due, and return the reply."""
        link, period = self._link, round(self.period * 1e9)
        self._due += period
        while (remaining := self._due - link.now()) > 0:
            link.receive(remaining * 1e-9)  # detects a closed connection; nothing else arrives between two samples
        now = link.now()
        if self._tick < 0:
            self._start, self._sent = now, now - period
        self.age, self._sent = (now - self._sent) * 1e-9, now
        self._due = max(self._due, now - period)  # after a stall, do not catch up
        acting = any(self._force)
        self._late = self._late + 1 if acting and self.age > _LATE * self.period else 0
        if acting and self.age > self._stale:
            self._force = ZERO[:3]  # the service has dropped the force: do not fade from it
            raise PlantError(f"the sample was {self.age * 1e3:.0f} ms old when its answer was sent")
        if self._late >= _MOST_LATE:
            raise PlantError(
                f"{self._late} samples in a row were late, the last {self.age * 1e3:.1f} ms old: lower ?rate="
            )
        link.send(force_message(self.device, self._force))
        reply = link.receive(self._stale - self.period if acting else _PATIENCE)
        self.round_trip = (link.now() - now) * 1e-9
        if reply is None:
            raise PlantError(f"no reply of the service within {self.round_trip * 1e3:.0f} ms")
        return parsed(reply)

    def _position_in(self, message: dict[str, Any]) -> list[float]:
        """Return the arm's position in a message [m].

        Raises:
            PlantError: If it is missing or not finite.
        """
        names = [entry.get("device_id") for entry in entries(message, "inverse3")]
        if self.device not in names:
            raise PlantError(f"device {self.device!r} is missing in the reply (connected: {names or 'none'})")
        position = numbers_at(entries(message, "inverse3")[names.index(self.device)], "state", "cursor_position")
        if position is None or not finite(position):
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
            while (remaining := due - self._link.now()) > 0:
                self._link.receive(remaining * 1e-9)
        self._force = ZERO[:3]
