"""Options of the page in a browser, of all commands with a viewer."""

from __future__ import annotations

import argparse
import os
import re
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypeAlias

from maglev_mj.cli.arguments import Parser, count
from maglev_mj.cli.declare import Shared
from maglev_mj.errors import ParameterError, require

if TYPE_CHECKING:
    from maglev_mj.display.remote import Front, ShowReport
    from maglev_mj.session import SnapshotSource

PORT = 8123
"""Default port of the page."""

_TOKEN = re.compile(r"[\w-]{16,}", re.ASCII)
_OWN = "port", "no_open", "host", "token"


class PageOptions(NamedTuple):
    """Chosen page in a browser.

    Attributes:
        web: True if there is one.
        port: Its port; None for `PORT`.
        no_open: True if no browser is opened.
        host: Its address; None for this machine.
        token: Text that its address must have; "" for a new one, None for none.
        listens: True if the command has an address of its own.
    """

    web: bool = False
    port: int | None = None
    no_open: bool = False
    host: str | None = None
    token: str | None = None
    listens: bool = False

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

        from maglev_mj.net.addresses import is_loopback, listen

        host = self.host or "127.0.0.1"
        # every user of this machine can read a token on the command line in the list of processes
        token = secrets.token_urlsafe() if self.token == "" else self.token
        if token is None and not is_loopback(host):
            raise ParameterError(f"token must be given for a host that is not this machine, {host!r}: see --token")
        if token is not None and not _TOKEN.fullmatch(token):
            raise ParameterError("token must be 16 or more letters, digits, - and _")
        require(("viser",), "web", "a page needs viser")
        from maglev_mj.web.guard import Door
        from maglev_mj.web.page import page

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
        from maglev_mj.viewer.window import require_display, show

        require_display()
        return partial(show, folder=folder)


def _add_page(parser: Parser) -> None:
    group = parser.group("page in a browser")
    group.add_argument("--web", action="store_true", help="a page for any browser")
    group.add_argument("--port", type=count, metavar="N", help=f"port of the page; 0 for any (default {PORT})")
    group.add_argument("--no-open", action="store_true", help="open no browser")
    group.add_argument("--host", metavar="H", help="address of the page, with --token (default 127.0.0.1)")
    group.add_argument(
        "--token",
        nargs="?",
        const="",
        metavar="T",
        help="text that the page's address must have, at least 16 characters; a new one where none is given",
    )


def _chosen_page(options: argparse.Namespace) -> PageOptions:
    return PageOptions(
        options.web, options.port, options.no_open, options.host, options.token, listens="listen" in options
    )


Page: TypeAlias = Annotated[PageOptions, Shared(_add_page, _chosen_page)]


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
        from maglev_mj.display.remote import show_remotely

        return show_remotely(source, page, duration)
    # imported here: it loads the library that opens windows
    from maglev_mj.viewer.window import show

    return show(source, folder=folder, duration=duration)


def _has_screen() -> bool:
    """Return True if a graphical browser can open.

    A browser in the terminal would occupy it.
    """
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
