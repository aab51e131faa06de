"""Process of the live server between control loop and clients, behind a guard."""

from __future__ import annotations

import asyncio
import json
import logging
import pickle
import re
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from typing import Any

import foxglove
from foxglove import MessageSchema, Parameter, Schema, Service, ServiceRequest, ServiceSchema, StatusLevel
from foxglove.websocket import Capability, ChannelView, Client, ServerListener

from maglev_mj.errors import MaglevError
from maglev_mj.interop.foxglove.settings import Answer, Requests, State, Verdict, checked, values_of
from maglev_mj.process import SideAnswers
from maglev_mj.recording.messages import Messages
from maglev_mj.recording.ring import ROWS, RowReader
from maglev_mj.recording.writer import log_in_order
from maglev_mj.scenes import Scene
from maglev_mj.session import UNKNOWN, UnstableLoop
from maglev_mj.session.access import LOOPBACK, Access

PATIENCE = 5.0
"""Longest time for a request to arrive [s]."""

MOST = 64
"""Largest number of connections.

Each takes three open files, a limited resource of a process.
"""

_LONGEST, _CHUNK = 8192, 1 << 16
_QUICKACK: int | None = getattr(socket, "TCP_QUICKACK", None)  # of Linux only
_ACCESS = Access(
    LOOPBACK,
    "localhost or 127.0.0.1",
    (rf"https?://{LOOPBACK}|https://app\.foxglove\.dev", "this machine or https://app.foxglove.dev"),
)
_FIELD = re.compile(r"([\w-]+):[ \t]*([^\r\n]*?)[ \t]*", re.ASCII)


def refusal(request: str, access: Access = _ACCESS) -> str:
    """Return the reason to refuse a request, or "".

    Args:
        request: First line and header, without the empty line at the end.
        access: The permission.
    """
    first, *lines = request.split("\r\n")
    fields: dict[str, list[str]] = {"host": [], "origin": [], "upgrade": []}
    for line in lines:
        if (found := _FIELD.fullmatch(line)) is None:
            return f"no header field: {line!r}"
        fields.setdefault(found[1].lower(), []).append(found[2])
    if not first.startswith("GET ") or [one.lower() for one in fields["upgrade"]] != ["websocket"]:
        return "only WebSockets are served here"
    return access.refusal(fields["host"], fields["origin"])


# of the ports that browsers do not open (https://fetch.spec.whatwg.org/#port-blocking) those that Chromium refuses too
_BLOCKED = 1719, 1720, 1723, 2049, 3659, 4045, 5060, 5061, 6000, 6566, *range(6665, 6670), 6697, 10080


def hidden_address() -> tuple[str, int]:
    """Return host and port for a server that no page in a browser can open.

    The host is one of 2^24, with any port (0), where all of 127.0.0.0/8 is this machine; elsewhere, as on macOS, it is
    127.0.0.1, with a port that browsers refuse to open.

    Raises:
        OSError: If all of these ports are taken.
    """
    host = f"127.{1 + secrets.randbelow(254)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"
    for address in [(host, 0), *(("127.0.0.1", port) for port in _BLOCKED)]:
        with suppress(OSError), socket.create_server(address):
            return address
    raise OSError(f"ports {', '.join(map(str, _BLOCKED))} of 127.0.0.1 are taken")


def forward(listener: socket.socket, server: tuple[str, int], access: Access = _ACCESS) -> None:
    """Forward accepted connections to a server, without end.

    It needs a thread of its own.

    Connections beyond MOST are closed at once.

    Args:
        listener: The public port.
        server: Host and port of the server.
        access: The permission.
    """

    async def run() -> None:
        room = asyncio.Semaphore(MOST)

        async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            if not room.locked():
                with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
                    async with room:
                        await _accept(reader, writer, server, access)
            writer.close()

        await (await asyncio.start_server(accept, sock=listener, limit=_LONGEST)).serve_forever()

    asyncio.run(run())


async def _accept(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, server: tuple[str, int], access: Access
) -> None:
    async with asyncio.timeout(PATIENCE):
        request = await reader.readuntil(b"\r\n\r\n")
        if why := refusal(request[:-4].decode("latin-1"), access):
            said = f"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: {len(why) + 1}\r\n\r\n{why}\n"
            writer.write(said.encode("latin-1"))
            await writer.drain()
            return
        back, forth = await asyncio.open_connection(*server, limit=_LONGEST)
    forth.write(request)
    ways = [asyncio.create_task(_pass(reader, writer, forth)), asyncio.create_task(_pass(back, forth, writer))]
    await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    for way in ways:
        way.cancel()
    forth.close()


async def _pass(reader: asyncio.StreamReader, source: asyncio.StreamWriter, writer: asyncio.StreamWriter) -> None:
    """Forward bytes until either end is closed."""
    with suppress(OSError):
        writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := await reader.read(_CHUNK):
            writer.write(data)
            if _QUICKACK is not None:  # the server's next message waits for it, 40 ms by default; it does not last
                source.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, _QUICKACK, 1)
            await writer.drain()


_LOOK = 1.0 / 120.0
_PAUSE = 1.0  # from one process that checks to the next [s]
_PATIENCE = 60.0
_MOST_REASON = 300  # it may repeat a client's request
_SET = "/maglev/set"
_JSON = MessageSchema(encoding="json", schema=Schema(name=_SET, encoding="jsonschema", data=b'{"type": "object"}'))
_SCHEMA = ServiceSchema(name=_SET, request=_JSON, response=_JSON)


def serve(line: Connection, rows: RowReader, listener: socket.socket, origins: Sequence[str] = ()) -> None:
    """Serve until the line ends, in an own process.

    The first message is the reason of a failure, or empty.
    """
    try:
        service = _Service(line, rows, listener, origins)
    except Exception as error:  # any error that keeps the package from starting
        line.send(f"{type(error).__name__}: {error}")
        return
    line.send("")
    service.run()


class _Service(ServerListener):
    """Server that logs rows and events and has requests checked."""

    def __init__(self, line: Connection, rows: RowReader, listener: socket.socket, origins: Sequence[str] = ()) -> None:
        foxglove.set_log_level(logging.CRITICAL)  # errors of clients are not for the user's terminal
        self._line, self._rows, self._requests, self._greet = line, rows, Requests(), False
        self._orders: deque[Sequence[Any]] = deque()
        self._place = 0
        self._set_state(State())
        self._checker, self._next_checker = SideAnswers(checked, UNKNOWN), 0.0
        self._over = False
        self._context = foxglove.Context()  # the server does not keep it
        self._messages = Messages(self._context)
        host, port = hidden_address()
        self._server = foxglove.start_server(
            name="maglev-mj",
            host=host,
            port=port,
            capabilities=[Capability.Parameters, Capability.Services],
            server_listener=self,
            services=[Service(name=_SET, schema=_SCHEMA, handler=self._call)],
            context=self._context,
            message_backlog_size=ROWS,
        )
        self._checker.line.poll(_PATIENCE)
        guard = listener, (host, self._server.port), replace(_ACCESS, allowed=origins)
        threading.Thread(target=forward, args=guard, daemon=True).start()

    def run(self) -> None:
        """Serve until the control loop closes its end."""
        while not self._over:
            self._turn()
        self._checker.close(0.0)
        self._server.stop()

    def _turn(self) -> None:
        """Wait for the next event and handle it."""
        checking = [] if self._checker.ended else [self._checker.line, self._requests.arrived]
        wait([self._line, *checking], _LOOK)
        rows = list(self._rows.rows())  # rows first: a message about a row arrives before the row
        while not self._over and self._line.poll():
            self._receive()
        if self._greet:
            self._greet = False
            self._messages.greet()
        self._place = log_in_order(self._messages, rows, self._orders, self._place)
        self._check()

    def _receive(self) -> None:
        try:
            message = self._line.recv_bytes()
        except (EOFError, OSError):
            self._over = True
            return
        try:
            place, what, *arguments = pickle.loads(message)
        except Exception as error:  # a class of the user's own that this process does not find
            self._set_state(State(state=f"the scene is not known here: {type(error).__name__}: {error}"))
            return
        if what == "show":
            self._show(*arguments)
        else:
            self._orders.append((place, what, *arguments))

    def _show(self, state: State, answer: Answer | None) -> None:
        """Publish the present scene and the control loop's answer."""
        self._set_state(state)
        if answer is not None:
            self._answer(answer)
        self._server.publish_parameter_values(self._parameters)

    def _set_state(self, state: State) -> None:
        self._state = state
        self._parameters = [Parameter(name, value=value) for name, value in values_of(state).items()]

    def _check(self) -> None:
        """Handle checked requests and start the next check."""
        if not self._checker.ended and (given := self._requests.next()) is not None:
            self._checker.ask(self._state, given)
        try:
            if (verdict := self._checker.answer()) is not None:
                self._conclude(verdict)
        except MaglevError as error:
            self._checker.close(0.0)
            self._conclude(str(error))
        if self._checker.ended:
            self._replace_checker()

    def _replace_checker(self) -> None:
        """Restart the checking process, at intervals."""
        if (now := time.monotonic()) < self._next_checker:
            return
        self._next_checker = now + _PAUSE
        self._checker.close(0.0)
        try:
            self._checker = SideAnswers(checked, UNKNOWN)
        except OSError as error:  # too many processes, or open files
            if self._requests.next() is not None:
                self._conclude(f"{UNKNOWN}: the process that checks them does not start: {error}")

    def _conclude(self, verdict: Verdict) -> None:
        """Send a checked scene to the loop, or refuse it."""
        if isinstance(verdict, Scene):
            with suppress(OSError):  # that it has ended is heard
                self._line.send(verdict)
        else:
            figures = verdict._asdict() if isinstance(verdict, UnstableLoop) else None
            self._answer(Answer(None, str(verdict)[:_MOST_REASON], figures))

    def _answer(self, answer: Answer) -> None:
        """Answer a request; report a refusal to all clients."""
        self._requests.settle(answer)
        if answer.reason:
            self._server.publish_status(answer.reason, StatusLevel.Warning, "set")
            self._messages.event("refused", answer.reason)
        else:
            self._server.remove_status(["set"])

    # --- called by the package, in threads of its own --------------------------------------------

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Request the drawing for a new subscriber."""
        self._greet = True

    def on_get_parameters(self, client: Client, names: list[str], request: str | None = None) -> list[Parameter]:
        """Return the parameters in force."""
        return [one for one in self._parameters if one.name in names or not names]

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request: str | None = None
    ) -> list[Parameter]:
        """Queue a request; return the parameters in force.

        Waiting here would block other clients.
        """
        self._requests.put({one.name: one.get_value() for one in parameters})
        return self._parameters

    def _call(self, call: ServiceRequest) -> bytes:
        """Answer a service call once in force or refused."""
        try:
            given = json.loads(bytes(call.payload))
        except (ValueError, RecursionError):
            given = None
        if not isinstance(given, dict):
            raise ValueError("a request must be a JSON object of names and values")
        return json.dumps(self._requests.put(given).result()._asdict()).encode()
