"""Options of the page in a browser, and of the live server."""

from __future__ import annotations

import argparse
import os
import re
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from maglev_mj.cli.arguments import count
from maglev_mj.cli.declare import Shared, option
from maglev_mj.errors import ParameterError, require
from maglev_mj.terminal import say

if TYPE_CHECKING:
    from maglev_mj.interop.foxglove import LiveServer
    from maglev_mj.session import SnapshotSource
    from maglev_mj.views.remote import Front, ShowReport

PORT = 8123
"""Default port of the page."""

LIVE_PORT = 8765
"""Default port of the live server: that of `maglev_mj.interop.foxglove`, which loads arrays."""

_TOKEN = re.compile(r"[\w-]{16,}", re.ASCII)
_OWN = "port", "no_open", "host", "token"


_PAGE = "page in a browser"


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Chosen page in a browser."""

    web: Annotated[bool, option("a page for any browser", _PAGE)] = False
    port: Annotated[int | None, option(f"port of the page; 0 for any (default {PORT})", _PAGE)] = None
    no_open: Annotated[bool, option("open no browser", _PAGE)] = False
    host: Annotated[str | None, option("address of the page, with --token (default 127.0.0.1)", _PAGE, "H")] = None
    token: Annotated[
        str | None,
        option(
            "text that the page's address must have, at least 16 characters; a new one where none is given",
            _PAGE,
            "T",
            const="",
        ),
    ] = None
    listens: Annotated[bool, Shared(None, lambda options: "listen" in options)] = False
    """True if the command has an address of its own."""

    def open(self, *, drag: bool = True, settings: bool = True) -> Front | None:
        """Start, announce and open the chosen page; None without choice.

        Args:
            drag: True if the knob can be pulled.
            settings: True if parameters can be changed.

        Raises:
            ParameterError: If an option is wrong, or is incompatible with another.
            MissingPackageError: If viser is not installed.
            ListenError: If the port is taken, or the host is not of this machine.
        """
        if not self.web:
            if wrong := [name for name in _OWN if getattr(self, name) not in (None, False)]:
                # a device's own port is another
                more = "; a device's address is given by --listen" if wrong[0] == "port" and self.listens else ""
                raise ParameterError(f"{wrong[0].replace('_', '-')} is for --web{more}")
            return None
        # imported here: it takes a fifth of a second
        import secrets

        from maglev_mj.session.access import is_loopback, listen

        host = self.host or "127.0.0.1"
        # every user of this machine can read a token on the command line in the list of processes
        token = secrets.token_urlsafe() if self.token == "" else self.token
        if token is None and not is_loopback(host):
            raise ParameterError(f"token must be given for a host that is not this machine, {host!r}: see --token")
        if token is not None and not _TOKEN.fullmatch(token):
            raise ParameterError("token must be 16 or more letters, digits, - and _")
        require(("viser",), "web", "a page needs viser")
        from maglev_mj.views.page.page import Door, page

        listener = listen(PORT if self.port is None else self.port, host)
        door = Door(host, listener.getsockname()[1], token)
        print(f"  the page is at {door.url}", flush=True)
        if not self.no_open and (os.name == "nt" or sys.platform == "darwin" or _has_screen()):
            _open_browser(door.url)
        return page(door, listener, drag=drag, settings=settings)

    def front(self, view: bool, folder: Path = Path(), *, watch: bool = False) -> Front | None:
        """Return the chosen viewer: window, page, or None for neither.

        For a device that is not simulated by this process alone.

        Args:
            view: True for a window.
            folder: Folder for a window's screenshots.
            watch: True if a page can only be looked at; its parameters are the host's in any case.

        Raises:
            DisplayError: If a window cannot be opened.
            MaglevError: See `open`.
        """
        if view and self.web:
            raise ParameterError("view and web are two ways to show it: give one")
        if (front := self.open(drag=not watch, settings=False)) is not None or not view:
            return front
        # imported here: it loads the library that opens windows
        from maglev_mj.views.window.window import require_display, show

        require_display()
        return partial(show, folder=folder)


def _port(text: str) -> int:
    from maglev_mj.session.access import check_port

    try:
        return check_port(count(text))
    except ParameterError as error:  # before a window is asked for
        raise argparse.ArgumentTypeError(str(error)) from None


Foxglove: TypeAlias = Annotated[
    int | None,
    option(
        f"serve every sample to programs on this machine that read the Foxglove protocol (default {LIVE_PORT})",
        "other programs",
        "PORT",
        kind=_port,
        const=LIVE_PORT,
    ),
]


def open_foxglove(port: int | None) -> LiveServer | None:
    """Start and return the live server at a port; None without one.

    Raises:
        LiveServerError: See `LiveServer`.
    """
    if port is None:
        return None
    from maglev_mj.interop.foxglove import LiveServer

    live = LiveServer(port)
    say(f"  live at ws://127.0.0.1:{live.port}, as Foxglove opens it")
    return live


def _open_browser(url: str) -> None:
    import threading
    import webbrowser

    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


def show_session(
    source: SnapshotSource, page: Front | None, folder: Path = Path(), duration: float | None = None
) -> ShowReport:
    """Show a running scene on a page or window.

    Args:
        source: The scene to show.
        page: The page; None for a window.
        folder: Folder for a window's screenshots.
        duration: Real time until the end [s]; None waits for the user.

    Raises:
        DisplayError: If a window cannot be opened.
        MaglevError: If the page's process ends early.
    """
    if page is not None:
        from maglev_mj.views.remote import show_remotely

        return show_remotely(source, page, duration)
    # imported here: it loads the library that opens windows
    from maglev_mj.views.window.window import show

    return show(source, folder=folder, duration=duration)


def _has_screen() -> bool:
    """Return True if a graphical browser can open.

    A browser in the terminal would occupy it.
    """
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
