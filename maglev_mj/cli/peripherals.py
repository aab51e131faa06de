"""Options of the page and the hand's device."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from maglev_mj.cli.declare import Parser, Shared, option
from maglev_mj.cli.options import parameters
from maglev_mj.errors import ParameterError, require
from maglev_mj.lazy import loaded
from maglev_mj.terminal import say

if TYPE_CHECKING:
    from maglev_mj.interop.hand_devices import AxisMapping, HandDevice
    from maglev_mj.plants.hand import SpringHand
    from maglev_mj.session import SnapshotSource
    from maglev_mj.views.viewer_process import Front, ShowReport

PORT = 8123
"""Default port of the page."""

_TOKEN = re.compile(r"[\w-]{16,}", re.ASCII)
_OWN = "port", "no_open", "host", "token"


_PAGE = "page in a browser"


def _origin(text: str) -> str:
    from maglev_mj.session.access import check_origin

    try:
        return check_origin(text)
    except ParameterError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


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
    allow_origin: Annotated[
        list[str],
        option(
            "let pages of this origin connect to the page, such as http://192.168.0.5:8080, file:// or null; may be "
            "given several times",
            _PAGE,
            "URL",
            kind=_origin,
        ),
    ] = field(default_factory=list)
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
        door = Door(host, listener.getsockname()[1], token, self.allow_origin)
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
        from maglev_mj.views.viewer_process import show_remotely

        return show_remotely(source, page, duration)
    # imported here: it loads the library that opens windows
    from maglev_mj.views.window.window import show

    return show(source, folder=folder, duration=duration)


def _has_screen() -> bool:
    """Return True if a graphical browser can open.

    A browser in the terminal would occupy it.
    """
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


_HAND = "gamepad or 3D mouse as the hand"
_hand_mapping = partial(loaded, "maglev_mj.interop.hand_devices:HAND_MAPPING")
_HandMapping: TypeAlias = Annotated["AxisMapping", parameters(_hand_mapping, _HAND, "hand-")]


class _Device(argparse.Action):
    """Keep a name, or print the devices and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: str | None = None) -> None:
        """See `argparse.Action`."""
        if values != "list":
            setattr(namespace, self.dest, values)
            return
        from maglev_mj.interop.hand_devices import described_devices

        for line in described_devices() or ["no 3D mouse and no gamepad"]:
            print(f"  {line}")
        parser.exit()


_AUTO = "auto"
"""Name that selects the first device: that of `maglev_mj.interop.hand_devices`, which loads arrays."""


def _add_hand_device(parser: Parser) -> None:
    parser.group(_HAND).add_argument(
        "--hand-device",
        nargs="?",
        action=_Device,
        const=_AUTO,
        metavar="NAME",
        help="a gamepad or 3D mouse as the hand: part of its name, spacenav, a socket's path, or auto for the first; "
        "list prints all",
    )


@dataclass(frozen=True, kw_only=True)
class HandOptions:
    """Chosen gamepad or 3D mouse as the hand."""

    name: Annotated[str | None, Shared(_add_hand_device, lambda options: options.hand_device)] = None
    mapping: _HandMapping

    @contextmanager
    def open(self, hand: SpringHand, tell: Callable[[str], object] = say) -> Iterator[list[HandDevice]]:
        """Open the chosen device; close it at the end.

        Empty without a choice.

        Args:
            hand: The hand moved by the device.
            tell: Function that prints the device's name.

        Raises:
            ParameterError: If an option is given without --hand-device, or the device is not there.
        """
        if self.name is None:
            if self.mapping != _hand_mapping():
                raise ParameterError("hand-gain and the like are for --hand-device")
            yield []
            return
        from maglev_mj.interop.hand_devices import HandDevice, open_device

        device = open_device(self.name)
        tell(f"  the hand: {device.name}")
        with closing(HandDevice(device, hand, self.mapping)) as opened:
            yield [opened]
