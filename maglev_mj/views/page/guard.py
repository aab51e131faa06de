"""Access control of the page, ahead of every byte served.

viser checks neither Origin nor Host (see `Access`), and would listen at every address. Its server is therefore given a
socket that listens already, and each request is checked first. A forwarder in front would leave that server behind it
open to other programs of this machine, whatever the token.
"""

from __future__ import annotations

import hmac
import http
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server as websockets_server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from maglev_mj.errors import MaglevError
from maglev_mj.session.access import LOOPBACK, Access, is_loopback

_FRAMES = "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*"
"""Pages that may frame this one: notebooks on this machine.

Another page could lure a click to it.
"""


@dataclass(frozen=True)
class Door:
    """Address of the page and the key to it.

    Args:
        host: IPv4 address, or name of one, where it listens.
        port: Where it listens.
        token: Text that a browser must show once; None for none.
    """

    host: str
    port: int
    token: str | None = None

    @property
    def url(self) -> str:
        """Address for a browser, with the token, if any."""
        return f"http://{self.host}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    @property
    def cookie(self) -> str:
        """Name of the cookie.

        It holds the port, by which browsers do not keep cookies apart.
        """
        return f"maglev_mj_{self.port}"

    def refusal(self, path: str, headers: Headers) -> str:
        """Return the reason for refusing a request; empty if allowed."""
        hosts, origins, jar = (headers.get_all(name) for name in ("Host", "Origin", "Cookie"))
        upgrade = "Upgrade" in headers
        if why := self._access.refusal(hosts, origins or [""] * upgrade):
            return why
        if self.token is None:
            return ""
        shown = re.findall(rf"(?:^|;)\s*{self.cookie}=([\w-]+)", "; ".join(jar), re.ASCII)
        if not upgrade:
            shown += parse_qs(urlsplit(path).query).get("token", [])
        right = [hmac.compare_digest(one.encode(), self.token.encode()) for one in shown]
        return "" if any(right) else "the address must have the token that was printed at the start: ?token=..."

    @cached_property
    def _access(self) -> Access:
        """Access by the host asked for, and this machine's names if they lead here."""
        # at every address any number is right, but no name: those are what an attacker can have
        own = r"(?:\d{1,3}\.){3}\d{1,3}" if self.host == "0.0.0.0" else re.escape(self.host)
        hosts = rf"{own}(?::\d{{1,5}})?" + (f"|{LOOPBACK}" if is_loopback(self.host) else "")
        return Access(hosts, self.host)


@contextmanager
def guarded(door: Door, listener: socket.socket) -> Iterator[None]:
    """Put websocket servers that start meanwhile behind a door.

    Args:
        door: The door.
        listener: Socket that listens; in place of any host and port that the server would choose.

    Raises:
        MaglevError: If no server has started: one that starts in another way has no door.
    """
    real, started = websockets_server.serve, False

    def serve(handler: Any, host: Any, port: Any, *, process_request: Callable[..., Any], **options: Any) -> Any:
        nonlocal started
        started = True

        def check(connection: Any, request: Request) -> Response | None:
            if why := door.refusal(request.path, request.headers):
                text = Headers({"Content-Type": "text/plain; charset=utf-8"})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", text, f"{why}\n".encode())
            answer: Response | None = process_request(connection, request)
            if answer is not None:
                answer.headers["Content-Security-Policy"] = _FRAMES
                answer.headers["Referrer-Policy"] = "no-referrer"
                if door.token is not None:
                    kept = "HttpOnly; SameSite=Strict; Path=/"
                    answer.headers["Set-Cookie"] = f"{door.cookie}={door.token}; {kept}"
            return answer

        return real(handler, sock=listener, process_request=check, **options)

    websockets_server.serve = serve  # type: ignore[misc, assignment]
    try:
        yield
    finally:
        websockets_server.serve = real  # type: ignore[misc]
    if not started:
        raise MaglevError("the page's server starts in a way that is not known here, without its door")
