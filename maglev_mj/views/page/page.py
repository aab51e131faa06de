"""Browser page of a running scene, in its own process.

viser serves it.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import viser
from viser._messages import ShareUrlRequest

from maglev_mj.errors import MaglevError
from maglev_mj.parameters import flag
from maglev_mj.session import Due, SnapshotSource, real_time
from maglev_mj.views.inbox import Inbox
from maglev_mj.views.page.grab import Grab
from maglev_mj.views.page.guard import Door, guarded
from maglev_mj.views.page.panel import Panel
from maglev_mj.views.page.plots import Plots
from maglev_mj.views.page.stage import VIEWS, Stage, look
from maglev_mj.views.remote import Front

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
        flag("drag", drag)
        flag("settings", settings)
        self._server, self._source = server, source
        self._inbox = Inbox()
        snapshot, gui = source.snapshot(), server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.main_panel.dock_right()
        self._stage = Stage(server, snapshot)
        self._grab = Grab(server, self._stage.knob, partial(self._inbox.put, "hand")) if drag else None
        self._panel = Panel(server, snapshot, self._inbox.put, settings)
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
            self._grab.pose = snapshot.pose
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
    sys.stdout = open(os.devnull, "w")  # what viser says is not for the terminal, nor what browsers do wrong
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    server = PageServer(door, listener)
    try:
        Page(server, source, **options).run()
    except MaglevError:
        pass  # the source has ended, and says why
    finally:
        server.stop()
