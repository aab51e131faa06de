"""Twin of a three-axis arm behind the JSON of Haply's Inverse service, and its WebSocket server."""

from __future__ import annotations

import hmac
import json
import logging
import threading
import time
from collections import deque
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from maglev_mj.bridge.haply.arm import Arm, entries, finite, numbers_at, parsed, token_of, vector
from maglev_mj.bridge.links import LinkError
from maglev_mj.errors import require
from maglev_mj.frames import ZERO, Command, Six, quaternion
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.plants.hand import HandForce
from maglev_mj.session.access import check_host, listen, local_access

_STALE = 50_000_000
"""Age at which a force becomes zero [ns]; assumed, the service states none."""

_LONGEST = 1_000_000_000
"""Longest simulated time of one message [ns]; during longer silences simulated time stands still."""

_STOP = 400.0, 8.0
"""Stiffness [N/m] and damping [N s/m] of the ends of the range; stable at 200 Hz."""

_STATUS = {"calibrated": True, "in_use": True, "power_supply": True, "ready": True, "started": True}
_GRIP_STATUS = {"connected": True, "awake": True, "ready": True}
_CONFIG = {"type": "inverse3", "port": "twin", "handedness": "right", "preset": "defaults"}


class HaplyTwin:
    """Arm in simulated time behind the service's JSON.

    In real time, simulated time follows the clock of the messages. In lockstep, each message with a force command
    advances it by one period, the exchange's own delay. A force acts until a message without one, for at most 50 ms.

    Args:
        arm: Numbers of the arm; its rate is that of the device, in lockstep that of the host.
        lockstep: True to wait for each force command.
        start: Position of the tip at the start [m], (3,).
        twist: Its velocity [m/s], (3,).
        hand_force: Force of a hand; its torques have no effect.
        device: Identifier of the arm.

    Attributes:
        force: Acting force, limited [N], (3,).
        clipped: Number of forces that were above the limit.
        invalid: Number of messages that were no JSON object.

    Example:
        >>> from maglev_mj.bridge import HaplyTwin
        >>> twin = HaplyTwin(start=(0.0, 0.0, 0.01))
        >>> '"z": 0.01' in twin.receive('{"inverse3": []}', now=0)
        True
    """

    def __init__(
        self,
        arm: Arm | None = None,
        *,
        lockstep: bool = False,
        start: Sequence[float] = (0.0, 0.0, 0.0),
        twist: Sequence[float] = (0.0, 0.0, 0.0),
        hand_force: HandForce | None = None,
        device: str = "TWIN",
    ) -> None:
        self.arm, self.device, self.lockstep, self._hand = arm or Arm(), device, lockstep, hand_force
        period = 1.0 / self.arm.rate
        self.plant = ExactPlant(
            Timing(period=period, delay=self.arm.delay + period * lockstep),
            mass=self.arm.mass,
            gravity=0.0,
            pose=(*start, 0.0, 0.0, 0.0),
            twist=(*twist, 0.0, 0.0, 0.0),
            hand_force=self._pushed,
            escape=(10.0, 10.0),
        )
        self._period = round(period * 1e9)
        self._time: int | None = None
        self._taken, self.clipped, self.invalid = 0, 0, 0
        self.force: Sequence[float] = ZERO[:3]
        self.plant.read()

    def receive(self, data: str | bytes, now: int) -> str:
        """Take one message at `now` [ns]; return the state update."""
        self._advance(now)
        message = parsed(data)
        self.invalid += not message
        own = [entry for entry in entries(message, "inverse3") if entry.get("device_id", self.device) == self.device]
        commands = [entry.get("commands") for entry in own]
        forces = [numbers_at(command, "set_cursor_force", key) for command in commands for key in ("vector", "values")]
        force = next((force for force in forces if force is not None), None)
        asked = force if force is not None and finite(force) else ZERO[:3]
        self.force, self._taken = self.arm.limited(asked), now
        self.clipped += list(asked) != self.force
        if self.lockstep and force is not None:
            self._step()
        return self.update(full="force_render_full_state" in str(message.get("session")))

    def release(self) -> None:
        """Set the force to zero, as when a client disconnects."""
        self.force = ZERO[:3]

    def update(self, *, full: bool = False) -> str:
        """Return a state update; with `full`, the inventory with configurations."""
        pose, twist = self.plant.state()
        state = {
            "cursor_position": vector(pose[:3]),
            "cursor_velocity": vector(twist[:3]),
            "current_cursor_force": vector(self.force),
            "control_mode": "force",
            "control_domain": "cartesian",
        }
        arm = {"device_id": self.device, "state": state, "status": _STATUS}
        buttons = dict.fromkeys(("a", "b", "c", "button_0", "button_1", "button_2", "button_3"), False)
        held = {"orientation": dict(zip("wxyz", quaternion(ZERO[:3]))), "buttons": buttons, "battery_level": 1.0}
        grip = {"device_id": "GRIP", "state": held, "status": _GRIP_STATUS}
        if full:
            arm["config"] = {**_CONFIG, "basis": {"permutation": "XYZ"}}
            grip["config"] = {"type": "wireless_verse_grip", "port": "twin"}
        return json.dumps({"session_id": 1, "inverse3": [arm], "wireless_verse_grip": [grip]})

    def link(self, latency: float = 0.0) -> VirtualLink:
        """Return a link to this twin in simulated time, with a latency of each reply [s]."""
        return VirtualLink(self, latency)

    def _advance(self, now: int) -> None:
        """Advance to `now` [ns], unless in lockstep."""
        self._time = now if self._time is None else max(self._time, now - _LONGEST)
        while not self.lockstep and self._time + self._period <= now:
            self._time += self._period
            if self._time - self._taken > _STALE:
                self.release()
            self._step()

    def _step(self) -> None:
        self.plant.write(Command([*self.force, 0.0, 0.0, 0.0]))
        self.plant.read()

    def _pushed(self, tick: int, time: float, state: Any) -> Six:
        """Return the force of the hand and of the ends of the range."""
        hand = ZERO if self._hand is None else self._hand(tick, time, state)
        pose, twist = state()
        over = pose[:3] - np.clip(pose[:3], -np.array(self.arm.range), self.arm.range)
        stops = _STOP[0] * over + _STOP[1] * twist[:3] * (over != 0.0)
        return [*(push - stop for push, stop in zip(hand, stops.tolist())), 0.0, 0.0, 0.0]


class VirtualLink:
    """Link to a twin in the same process and in simulated time, which passes only while the host waits.

    Attributes:
        time: Simulated time [ns].
        latency: Latency of each reply [ns].
        open: False once the service is gone.
    """

    def __init__(self, twin: HaplyTwin, latency: float = 0.0) -> None:
        self._twin, self.time, self.latency, self.open = twin, 0, round(latency * 1e9), True
        self._replies = deque([(0, twin.update(full=True))])

    def send(self, text: str) -> None:
        """See `JsonLink`."""
        if not self.open:
            raise LinkError("the service closed the connection")
        self._replies.append((self.time + self.latency, self._twin.receive(text, self.time)))

    def receive(self, timeout: float) -> str | None:
        """See `JsonLink`."""
        end = self.time + round(timeout * 1e9)
        if not self.open:
            raise LinkError("the service closed the connection")
        if not self._replies or self._replies[0][0] > end:
            self.time = end
            return None
        due, reply = self._replies.popleft()
        self.time = max(self.time, due)
        return reply

    def now(self) -> int:
        """See `JsonLink`."""
        return self.time

    def close(self) -> None:
        """See `JsonLink`."""
        self.open = False
        self._twin.release()


class HaplyServer:
    """WebSocket server of a twin; a request needs a permitted Host and Origin, and a key's token if there is a key.

    Args:
        twin: The arm.
        port: Port; 0 for any free port.
        host: Address to listen on; loopback only, unless there is a key.
        key: Shared key, whose token a client sends as ?token=...
        origins: Permitted origins of pages.

    Attributes:
        address: Host and port.

    Raises:
        ParameterError: If the host is not permitted, or the port is invalid.
        ListenError: If the port is in use.
        MissingPackageError: If websockets is not installed.
    """

    def __init__(
        self,
        twin: HaplyTwin,
        port: int = 10001,
        host: str = "127.0.0.1",
        *,
        key: bytes | None = None,
        origins: Sequence[str] = (),
    ) -> None:
        require(("websockets",), "haply", "twin --haply requires websockets")
        from websockets.sync.server import serve

        logging.getLogger("websockets").setLevel(logging.CRITICAL)  # no failed handshakes on the terminal
        self.twin, self._lock, self._token = twin, threading.Lock(), token_of(key)
        self._access, self._stopped = local_access(host, origins), threading.Event()
        listener = listen(port, check_host(host, key))
        self.address: tuple[str, int] = host, listener.getsockname()[1]
        options: Any = {"compression": None, "process_request": self._checked}
        self._server = serve(self._client, sock=listener, **options)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def run(self, duration: float | None = None) -> None:
        """Serve for a duration [s], or until `stop`."""
        self._stopped.wait(duration)

    def stop(self) -> None:
        """Stop `run`, from any thread."""
        self._stopped.set()

    def close(self) -> None:
        """Close all connections and the port; idempotent."""
        self.stop()
        self._server.shutdown()
        self._thread.join()

    @property
    def query(self) -> str:
        """Query of a client's URL, with the access token; empty without a key."""
        return f"/?token={self._token}" if self._token else ""

    def _checked(self, connection: Any, request: Any) -> Any:
        """Return the response that refuses a request; None to accept it."""
        reason = self._access.refusal(*(request.headers.get_all(name) for name in ("Host", "Origin")))
        tokens = parse_qs(urlsplit(request.path).query).get("token", [""])
        if not hmac.compare_digest(tokens[0].encode(), self._token.encode()) and self._token:
            reason = reason or "access token missing or invalid: connect to the URL printed at startup (?token=...)"
        return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n") if reason else None

    def _client(self, socket: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        try:
            with self._lock:
                inventory = self.twin.update(full=True)
            socket.send(inventory)
            for data in socket:
                with self._lock:
                    update = self.twin.receive(data, time.monotonic_ns())
                socket.send(update)
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self.twin.release()
