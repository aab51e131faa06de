"""Web page of a running scene: a viser server in its own process, with access control."""

from __future__ import annotations

import hmac
import json
import logging
import os
import re
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import viser
import websockets.asyncio.server as websockets_server
from viser._messages import ShareUrlRequest
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from maglev_mj.colours import BAD, DEVICE, HAND, WALL, hex_of, on_page, on_white
from maglev_mj.errors import MaglevError
from maglev_mj.parameters import flag
from maglev_mj.session import FrameClock, SnapshotSource, real_time
from maglev_mj.session.access import Access, local_access
from maglev_mj.views.page.live import contact, knob
from maglev_mj.views.page.panel import Panel, Plots
from maglev_mj.views.page.stage import VIEWS, Grab, Stage, look, update
from maglev_mj.views.pages import FOLDER
from maglev_mj.views.readings import Charts
from maglev_mj.views.viewer_process import Inbox, ViewerFunction

# embedded by notebooks on this machine; other origins could be used for clickjacking
_FRAMES = "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*"
_HEADERS = {"Content-Security-Policy": _FRAMES, "Referrer-Policy": "no-referrer"}

_TITLE = b"<title>Viser</title>"
_INSERTS = {
    "STOP_COLOUR": hex_of(on_white(BAD)),
    "STOP_TEXT": on_page(BAD),
    "DEVICE_TEXT": on_page(DEVICE),
    "PULL_LINE": hex_of(on_white(HAND)),
    "WALL_FILL": f"{hex_of(WALL)}33",
    "SOUND_SCRIPT": (FOLDER / "sound.js").read_text("utf-8"),
    "LIVE_SCRIPT": Path(__file__).with_name("live.js").read_text("utf-8"),
}


def _head() -> str:
    text = Path(__file__).with_name("head.html").read_text("utf-8")
    return re.sub("|".join(_INSERTS), lambda name: _INSERTS[name[0]], text)


_HEAD = _head()
"""Replacement of the title of viser's page: title, icon, styles, scripts."""

Process = Callable[[Any, Request], Response | None]


@dataclass(frozen=True)
class Endpoint:
    """Address and access control of the page.

    Args:
        host: IPv4 address or host name to listen on.
        port: Port to listen on.
        token: Access token; None for none.
        origins: Other origins that may connect.
    """

    host: str
    port: int
    token: str | None = None
    origins: Sequence[str] = ()

    @property
    def url(self) -> str:
        """URL for a browser, with the access token if any."""
        return f"http://{self.host}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    @property
    def cookie(self) -> str:
        """Name of the cookie; contains the port, because browsers share cookies between ports."""
        return f"maglev_mj_{self.port}"

    def refusal(self, path: str, headers: Headers) -> str:
        """Return the reason for rejecting a request; empty if accepted."""
        hosts, origins, jar = (headers.get_all(name) for name in ("Host", "Origin", "Cookie"))
        upgrade = "Upgrade" in headers
        if reason := self._access.refusal(hosts, origins or [""] * upgrade):
            return reason
        if self.token is None:
            return ""
        tokens = re.findall(rf"(?:^|;)\s*{self.cookie}=([\w-]+)", "; ".join(jar), re.ASCII)
        if not upgrade:
            tokens += parse_qs(urlsplit(path).query).get("token", [])
        valid = [hmac.compare_digest(token.encode(), self.token.encode()) for token in tokens]
        return "" if any(valid) else "access token missing or invalid: open the URL printed at startup (?token=...)"

    def answer(self, process: Process, connection: Any, request: Request) -> Response | None:
        """Return the response to a request; None to accept a WebSocket.

        Args:
            process: viser's function that returns it.
            connection: Connection of the request.
            request: The request.
        """
        if reason := self.refusal(request.path, request.headers):
            refused: Response = connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            return refused
        page = "Upgrade" not in request.headers
        # without headers the response is uncompressed, so that its head can be replaced
        answer = process(connection, Request(request.path, Headers()) if page else request)
        if answer is not None:
            answer.body = answer.body.replace(_TITLE, _HEAD.encode(), 1)
            del answer.headers["Content-Length"]
            answer.headers.update(_HEADERS, **{"Content-Length": str(len(answer.body))})
            if self.token is not None:
                attributes = "HttpOnly; SameSite=Strict; Path=/"
                answer.headers["Set-Cookie"] = f"{self.cookie}={self.token}; {attributes}"
        return answer

    @cached_property
    def _access(self) -> Access:
        return local_access(self.host, self.origins)


_STRIP, _PANEL, _PLOT = 1.0 / 30.0, 1.0 / 12.0, 1.0 / 8.0
"""Intervals at which strip, panel and plots are sent [s]; the 3D view is sent as often as snapshots arrive, 60 Hz."""

_NAP = 0.002
_PLOTS_WIDTH = 304.0


class PageServer(viser.ViserServer):
    """viser's server with access control and without public share URLs.

    viser calls `websockets.asyncio.server.serve` and accepts neither a listening socket nor a check of requests before
    the handshake, without which any web page could control a device on this machine. Therefore this replaces `serve`
    while viser starts.

    Args:
        endpoint: Address and access control.
        listener: Listening socket, in place of the server's host and port.

    Raises:
        MaglevError: If no server has started through `serve`: it would have no access control.
    """

    def __init__(self, endpoint: Endpoint, listener: socket.socket) -> None:
        real, started = websockets_server.serve, False

        def serve(handler: Any, host: Any, port: Any, *, process_request: Process, **options: Any) -> Any:
            nonlocal started
            started = True
            return real(handler, sock=listener, process_request=partial(endpoint.answer, process_request), **options)

        websockets_server.serve = serve  # type: ignore[misc, assignment]
        try:
            super().__init__(host=endpoint.host, port=endpoint.port, label="maglev-mj", verbose=False)
        finally:
            websockets_server.serve = real  # type: ignore[misc]
        if not started:
            raise MaglevError("the server did not start through websockets.serve, access control would be missing")
        self._websock_server.unregister_handler(ShareUrlRequest)

    def request_share_url(self, verbose: Any = True) -> str | None:
        """Return None: share URLs are disabled."""
        return None


class Page:
    """Page of a source.

    Args:
        server: Server of the page.
        source: Source to show.
        drag: True to let the user pull the knob.
        settings: True to let the user change parameters.
    """

    def __init__(
        self, server: viser.ViserServer, source: SnapshotSource, *, drag: bool = True, settings: bool = True
    ) -> None:
        self._server, self._source = server, source
        self._inbox = Inbox()
        self._strip, self._panel_due, self._plot = FrameClock(_STRIP), FrameClock(_PANEL), FrameClock(_PLOT)
        snapshot, gui = source.snapshot(), server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        self._stage = Stage(server, snapshot)
        self._grab = Grab(server, self._stage.knob, partial(self._inbox.put, "hand"), snapshot.scene) if drag else None
        if self._grab is not None:
            gui.add_button_group("keys", ("",), visible=False).on_click(self._grab.push)
        self._stage.hint = "drag the knob" if drag else ""
        self._panel = Panel(server, snapshot, self._inbox.put, settings)
        panel = gui.add_panel()
        with panel.add_tab("plots"):
            self._plots = Plots(gui, snapshot.scene)
        panel.dock_left()
        panel.set_width(_PLOTS_WIDTH)  # each browser replaces it
        self._live, self._scales = gui.add_text("live", "", visible=False), Charts(0)
        self._beats, self._pose = 0, snapshot.pose
        server.on_client_connect(_greet)

    def run(self) -> None:
        """Show the source until it raises."""
        for elapsed, _ in real_time(None, _NAP):
            self._source.tick(elapsed)
            self._apply()
            self._show()

    def _apply(self) -> None:
        for kind, value in self._inbox.take():
            if kind == "hand":
                self._source.hand.target = value
            else:
                (self._source.act if kind == "act" else self._source.change)(value)

    def _show(self) -> None:
        """Show a snapshot that has arrived."""
        snapshot = self._source.snapshot()
        if snapshot.pose is self._pose:  # every snapshot received has its own arrays
            return
        self._pose, self._beats = snapshot.pose, self._beats + 1
        if self._grab is not None:
            self._grab.pose, self._grab.scene = snapshot.pose, snapshot.scene
        if snapshot.target is not None:
            self._stage.hint = ""
        if not self._server.get_clients():  # a new client gets the full state
            return
        with self._server.atomic():
            self._stage.show(snapshot)
            strip = {"strip": contact(snapshot, self._scales)} if self._strip() else {}
            # the number is the sign of life that the page waits for
            update(self._live, value=json.dumps({"beat": self._beats, "knob": knob(snapshot), **strip}))
            if self._panel_due():
                self._panel.show(snapshot)
            if self._plot():
                self._plots.show(snapshot)
        self._server.flush()


async def _greet(client: viser.ClientHandle) -> None:
    """Fit the device into a browser's view while its camera is at the default position."""

    async def fit(camera: viser.CameraHandle) -> None:
        if np.allclose(camera.position, VIEWS["home"][0], atol=1e-4):
            look(client, "home")

    client.camera.on_update(fit)


def page(endpoint: Endpoint, listener: socket.socket, *, drag: bool = True, settings: bool = True) -> ViewerFunction:
    """Return the viewer function of a page.

    Args:
        endpoint: Address and access control.
        listener: Listening socket.
        drag: True to let the user pull the knob.
        settings: True to let the user change parameters.
    """
    return partial(_serve, endpoint, listener, {"drag": flag("drag", drag), "settings": flag("settings", settings)})


def _serve(endpoint: Endpoint, listener: socket.socket, options: Mapping[str, bool], source: SnapshotSource) -> None:
    # no messages of viser or of failed handshakes on the terminal
    sys.stdout = open(os.devnull, "w", encoding="utf-8")
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    server = PageServer(endpoint, listener)
    try:
        Page(server, source, **options).run()
    finally:
        server.stop()
