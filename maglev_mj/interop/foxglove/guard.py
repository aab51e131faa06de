"""Guard of the live server's public port against web pages.

The server behind checks neither Origin nor Host; see `Access`.
"""

from __future__ import annotations

import asyncio
import re
import socket
from contextlib import suppress

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


def refusal(request: str) -> str:
    """Return the reason to refuse a request, or "".

    Args:
        request: First line and header, without the empty line at the end.
    """
    first, *lines = request.split("\r\n")
    fields: dict[str, list[str]] = {"host": [], "origin": [], "upgrade": []}
    for line in lines:
        if (found := _FIELD.fullmatch(line)) is None:
            return f"no header field: {line!r}"
        fields.setdefault(found[1].lower(), []).append(found[2])
    if not first.startswith("GET ") or [one.lower() for one in fields["upgrade"]] != ["websocket"]:
        return "only WebSockets are served here"
    return _ACCESS.refusal(fields["host"], fields["origin"])


def forward(listener: socket.socket, server: tuple[str, int]) -> None:
    """Forward accepted connections to a server, without end.

    It needs a thread of its own.

    Connections beyond MOST are closed at once.

    Args:
        listener: The public port.
        server: Host and port of the server.
    """

    async def run() -> None:
        room = asyncio.Semaphore(MOST)

        async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            if not room.locked():
                with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
                    async with room:
                        await _accept(reader, writer, server)
            writer.close()

        await (await asyncio.start_server(accept, sock=listener, limit=_LONGEST)).serve_forever()

    asyncio.run(run())


async def _accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, server: tuple[str, int]) -> None:
    async with asyncio.timeout(PATIENCE):
        request = await reader.readuntil(b"\r\n\r\n")
        if why := refusal(request[:-4].decode("latin-1")):
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
