"""Browser page of a running scene, in its own process, behind a guard; viser serves it."""

from __future__ import annotations

import hmac
import http
import logging
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import viser
import websockets.asyncio.server as websockets_server
from viser._messages import ShareUrlRequest
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from maglev_mj.errors import MaglevError
from maglev_mj.parameters import flag
from maglev_mj.session import Due, SnapshotSource, real_time
from maglev_mj.session.access import LOOPBACK, Access, is_loopback
from maglev_mj.views.page.panel import Panel
from maglev_mj.views.page.plots import Plots
from maglev_mj.views.page.stage import VIEWS, Grab, Stage, look
from maglev_mj.views.viewer_process import Front, Inbox

_FRAMES = "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*"
"""Pages that may frame this one: notebooks on this machine.

Another page could lure a click to it.
"""

_TITLE, _HEAD = b"<title>Viser</title>", Path(__file__).with_name("head.html").read_bytes()
"""Title of viser's page, and what stands in its place: title, icon, layout, and scripts."""


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
    origins: Sequence[str] = ()

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
        return Access(hosts, self.host, allowed=self.origins)


@contextmanager
def guarded(door: Door, listener: socket.socket) -> Iterator[None]:
    """Put websocket servers that start meanwhile behind a door.

    viser starts its server by `websockets.asyncio.server.serve`. It takes neither a socket that listens nor a check of
    requests before the handshake, so any web page could steer a device on this machine. Until it takes both, this
    replaces `serve` while viser starts, here alone.

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
            page = "Upgrade" not in request.headers
            # without its headers it is answered uncompressed, so that its head can be ours
            answer: Response | None = process_request(connection, Request(request.path, Headers()) if page else request)
            if answer is not None:
                answer.body = answer.body.replace(_TITLE, _HEAD, 1)
                del answer.headers["Content-Length"]
                answer.headers["Content-Length"] = str(len(answer.body))
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


_FRAME, _PLOT = 1.0 / 30.0, 1.0 / 8.0
_NAP = 0.005


class PageServer(viser.ViserServer):
    """viser's server behind a door.

    No browser can make it ask for a public address.

    Args:
        door: The door.
        listener: Socket that listens there.
    """

    def __init__(self, door: Door, listener: socket.socket) -> None:
        with guarded(door, listener):
            super().__init__(host=door.host, port=door.port, label="maglev-mj", verbose=False)
        self._websock_server.unregister_handler(ShareUrlRequest)

    def request_share_url(self, verbose: Any = True) -> str | None:
        """Return None: a device is not for the public."""
        return None


class Page:
    """The page of one source.

    Args:
        server: Its server.
        source: What it shows.
        drag: Whether the knob can be pulled.
        settings: Whether parameters can be changed.
    """

    def __init__(
        self, server: viser.ViserServer, source: SnapshotSource, *, drag: bool = True, settings: bool = True
    ) -> None:
        self._server, self._source = server, source
        self._inbox = Inbox()
        snapshot, gui = source.snapshot(), server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        self._stage = Stage(server, snapshot)
        self._grab = Grab(server, self._stage.knob, partial(self._inbox.put, "hand")) if drag else None
        self._stage.hint = "drag the knob" if drag else ""
        magnify = partial(setattr, self._stage, "factor")
        self._panel = Panel(server, snapshot, self._inbox.put, magnify, settings)
        panel = gui.add_panel()
        with panel.add_tab("plots"):
            self._plots = Plots(gui, snapshot.scene)
        panel.dock_left()
        self._frame, self._plot = Due(_FRAME), Due(_PLOT)
        server.on_client_connect(_greet)

    def run(self) -> None:
        """Show the source until it ends."""
        for elapsed, _ in real_time(None, _NAP):
            self._source.tick(elapsed)
            self._apply()
            if self._frame():
                self._show()

    def _apply(self) -> None:
        for kind, value in self._inbox.take():
            if kind == "hand":
                self._source.hand.target = value
            elif kind == "act":
                self._source.act(value)
            else:
                self._source.change(value)

    def _show(self) -> None:
        snapshot = self._source.snapshot()
        if self._grab is not None:
            self._grab.pose, self._grab.factor = snapshot.pose, self._stage.factor
        if snapshot.target is not None:
            self._stage.hint = ""
        if not self._server.get_clients():  # the next one is told all at once
            return
        with self._server.atomic():
            self._stage.show(snapshot)
            self._panel.show(snapshot)
            if self._plot():
                self._plots.show(snapshot)


async def _greet(client: viser.ClientHandle) -> None:
    """Fit the device into a browser with an unmoved camera.

    It is unmoved at first, and after a reset by the person.
    """
    view, (place, _) = next(iter(VIEWS.items()))

    async def fit(camera: viser.CameraHandle) -> None:
        if np.allclose(camera.position, place, atol=1e-4):
            look(client, view)

    client.camera.on_update(fit)


def page(door: Door, listener: socket.socket, *, drag: bool = True, settings: bool = True) -> Front:
    """Return the server of a page.

    Args:
        door: Where, and to whom.
        listener: Socket that listens there.
        drag: Whether the knob can be pulled.
        settings: Whether parameters can be changed.
    """
    return partial(_serve, door, listener, {"drag": flag("drag", drag), "settings": flag("settings", settings)})


def _serve(door: Door, listener: socket.socket, options: Mapping[str, bool], source: SnapshotSource) -> None:
    # what viser says is not for the terminal, nor what browsers do wrong
    sys.stdout = open(os.devnull, "w", encoding="utf-8")
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    server = PageServer(door, listener)
    try:
        Page(server, source, **options).run()
    finally:
        server.stop()
