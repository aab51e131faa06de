"""Twin of a three-axis arm behind the JSON of Haply's Inverse service, and its WebSocket server."""

from __future__ import annotations

import hmac
import json
import logging
import math
import threading
import time
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any

import numpy as np

from maglev_mj.bridge.haply.plant import Arm, devices, numbers_at, token_of, vector
from maglev_mj.errors import require
from maglev_mj.frames import ZERO, Command, Six, quaternion
from maglev_mj.keywords import checked, explained
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.plants.hand import HandForce
from maglev_mj.session.access import check_host, listen, local_access

_STALE = 50_000_000
"""Age at which a force becomes zero [ns]; assumed, the service states none."""

_LONGEST = 1_000_000_000
"""Longest simulated time of one message [ns]; during longer silences simulated time stands still."""

_STOP = 400.0, 8.0
"""Stiffness [N/m] and damping [N s/m] of the ends of the range; stable at 200 Hz."""

_DEVICE = "TWIN"
"""Identifier of the arm."""

_STATUS = dict.fromkeys(("calibrated", "in_use", "power_supply", "ready", "started", "connected", "awake"), True)
_BUTTONS = "a", "b", "c", "button_0", "button_1", "button_2", "button_3"


@checked
class HaplyTwin:
    """Arm in simulated time behind the service's JSON.

    In real time, simulated time follows the clock of the messages. In lockstep, each message with a force command
    advances it by one period, the exchange's own delay. A force acts until a message without one, for at most 50 ms.

    Args:
        arm: Numbers of the arm; its rate is that of the device, in lockstep that of the host.
        lockstep: True to wait for each force command.
        start: Position of the tip at the start [m], (3,).
        hand_force: Force of a hand; its torques have no effect.

    Attributes:
        force: Acting force, limited [N], (3,).
        clipped: Number of forces that were above the limit.

    Example:
        >>> from maglev_mj.bridge import HaplyTwin
        >>> twin = HaplyTwin(start=(0.0, 0.0, 0.01))
        >>> '"z": 0.01}' in twin.receive('{"inverse3": []}', now=0)
        True
    """

    def __init__(
        self,
        arm: Arm | None = None,
        *,
        lockstep: bool = False,
        start: Sequence[float] = (0.0, 0.0, 0.0),
        hand_force: HandForce | None = None,
    ) -> None:
        self.arm, self.lockstep, self._hand = arm or Arm(), lockstep, hand_force
        period = 1.0 / self.arm.rate
        self.plant = ExactPlant(
            Timing(period=period, delay=self.arm.delay + period * lockstep),
            mass=self.arm.mass,
            gravity=0.0,
            pose=(*start, 0.0, 0.0, 0.0),
            hand_force=self._pushed,
            escape=(10.0, 10.0),
        )
        self._period = round(period * 1e9)
        self._time: int | None = None
        self._taken = self.clipped = 0
        self.force = [0.0, 0.0, 0.0]
        self.plant.read()

    @explained
    def receive(self, data: str | bytes, now: int) -> str:
        """Take one message at `now` [ns]; return the state update."""
        self._advance(now)
        named = devices(data)
        commands = named.get(_DEVICE, named.get("", {})).get("commands")
        forces = (numbers_at(commands, "set_cursor_force", key) for key in ("vector", "values"))
        force = next(filter(None, forces), None)
        asked = force if force and math.isfinite(sum(force)) else [0.0, 0.0, 0.0]
        self.force, self._taken = self.arm.limited(asked), now
        self.clipped += asked != self.force
        if self.lockstep and force:
            self._step()
        return self.update(full="force_render_full_state" in str(data))

    def release(self) -> None:
        """Set the force to zero, as when a client disconnects."""
        self.force = [0.0, 0.0, 0.0]

    def update(self, *, full: bool = False) -> str:
        """Return a state update; with `full`, the inventory with configurations."""
        pose, twist = self.plant.state()
        state = {"cursor_position": vector(pose), "cursor_velocity": vector(twist)}
        state["current_cursor_force"] = vector(self.force)
        held = {"orientation": vector(quaternion(ZERO[:3]), "wxyz"), "buttons": dict.fromkeys(_BUTTONS, False)}
        message: dict[str, Any] = {"session_id": 1}
        for kind, device, values in (("inverse3", _DEVICE, state), ("wireless_verse_grip", "GRIP", held)):
            config = {"config": {"type": kind, "port": "twin", "basis": {"permutation": "XYZ"}}} if full else {}
            message[kind] = [{"device_id": device, "state": values, "status": _STATUS, **config}]
        return json.dumps(message)

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


@checked
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
        query: Query of a client's URL with the access token; empty without a key.

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
        self.twin, self._lock, self.query = twin, threading.Lock(), token_of(key)
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

    def _checked(self, connection: Any, request: Any) -> Any:
        """Return the response that refuses a request; None to accept it."""
        reason = self._access.refusal(*(request.headers.get_all(name) for name in ("Host", "Origin")))
        if not reason and not hmac.compare_digest(request.path.encode(), f"/{self.query}".encode()) and self.query:
            reason = "access token missing or invalid: connect to the URL printed at startup (?token=...)"
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
