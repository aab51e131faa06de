"""Options of the web page and of the hand's input device."""

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
    from maglev_mj.views.viewer_process import ViewerFunction

PORT = 8123
"""Default TCP port of the page."""

_TOKEN = re.compile(r"[\w-]{16,}", re.ASCII)
_PAGE_OPTIONS = "port", "no_open", "host", "token"


_PAGE = "web page"


def _origin(text: str) -> str:
    from maglev_mj.session.access import check_origin

    try:
        return check_origin(text)
    except ParameterError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Web page and its options."""

    web: Annotated[bool, option("web page for a browser, instead of a window", _PAGE)] = False
    port: Annotated[int | None, option(f"TCP port of the page; 0 for any free port (default {PORT})", _PAGE)] = None
    no_open: Annotated[bool, option("do not open a browser", _PAGE)] = False
    host: Annotated[
        str | None, option("listen address (default 127.0.0.1); any other requires --token", _PAGE, "H")
    ] = None
    token: Annotated[
        str | None,
        option(
            "access token in the URL, at least 16 characters; random if omitted",
            _PAGE,
            "T",
            const="",
        ),
    ] = None
    allow_origin: Annotated[
        list[str],
        option(
            "allowed origin of pages that connect, e.g. http://192.168.0.5:8080, file:// or null; repeatable",
            _PAGE,
            "URL",
            kind=_origin,
        ),
    ] = field(default_factory=list)
    listens: Annotated[bool, Shared(None, lambda options: "listen" in options)] = False
    """True if the command has a --listen address."""

    def open(self, *, drag: bool = True, settings: bool = True) -> ViewerFunction | None:
        """Start the page, print its URL and open it; return None without --web.

        Args:
            drag: True if the handle can be dragged.
            settings: True if parameters can be changed.

        Raises:
            ParameterError: If an option is invalid or incompatible with another.
            MissingPackageError: If viser is not installed.
            ListenError: If the port is in use, or the host is not an address of this machine.
        """
        if not self.web:
            if extra := [name for name in _PAGE_OPTIONS if getattr(self, name) not in (None, False)]:
                # --port is easily confused with the device's address
                hint = "; set a device's address by --listen" if extra[0] == "port" and self.listens else ""
                raise ParameterError(f"{extra[0].replace('_', '-')} requires --web{hint}")
            return None
        # imported here: takes 0.2 s
        import secrets

        from maglev_mj.session.access import is_loopback, listen

        host = self.host or "127.0.0.1"
        # other users can read a token on the command line in the process list
        token = secrets.token_urlsafe() if self.token == "" else self.token
        if token is None and not is_loopback(host):
            raise ParameterError(f"host {host!r} is not this machine: add --token")
        if token is not None and not _TOKEN.fullmatch(token):
            raise ParameterError("token must be at least 16 characters of letters, digits, - and _")
        require(("viser",), "web", "the web page requires viser")
        from maglev_mj.views.page.page import Endpoint, page

        listener = listen(PORT if self.port is None else self.port, host)
        door = Endpoint(host, listener.getsockname()[1], token, self.allow_origin)
        print(f"  web page: {door.url}", flush=True)
        if not self.no_open and (os.name == "nt" or sys.platform == "darwin" or _has_screen()):
            _open_browser(door.url)
        return page(door, listener, drag=drag, settings=settings)

    def front(self, view: bool, folder: Path = Path(), *, watch: bool = False) -> ViewerFunction | None:
        """Return the viewer of a device: window, page, or None for neither.

        Args:
            view: True for a window.
            folder: Output folder for screenshots.
            watch: True for a read-only page; parameters cannot be changed in any case.

        Raises:
            DisplayError: If a window cannot be opened.
            MaglevError: See `open`.
        """
        if view and self.web:
            raise ParameterError("view and web are mutually exclusive")
        if (front := self.open(drag=not watch, settings=False)) is not None or not view:
            return front
        return window(folder)


def window(folder: Path = Path()) -> ViewerFunction:
    """Return the viewer function of a window.

    Args:
        folder: Output folder for screenshots.

    Raises:
        DisplayError: If a window cannot be opened.
    """
    # imported here: loads the window library
    from maglev_mj.views.window.window import require_display, show

    require_display()
    return partial(show, folder=folder)


def _open_browser(url: str) -> None:
    import threading
    import webbrowser

    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


def _has_screen() -> bool:
    """Return True if there is a display for a graphical browser; a text browser would block the terminal."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


_HAND = "gamepad or 3D mouse as the hand"
_hand_mapping = partial(loaded, "maglev_mj.interop.hand_devices:HAND_MAPPING")
_HandMapping: TypeAlias = Annotated["AxisMapping", parameters(_hand_mapping, _HAND, "hand-")]


class _Device(argparse.Action):
    """Store a device name, or list the devices and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: str | None = None) -> None:
        """See `argparse.Action`."""
        if values != "list":
            setattr(namespace, self.dest, values)
            return
        from maglev_mj.interop.hand_devices import described_devices

        for line in described_devices() or ["no 3D mouse or gamepad detected"]:
            print(f"  {line}")
        parser.exit()


_AUTO = "auto"
"""Name of the first device, as in `maglev_mj.interop.hand_devices`; repeated here because that imports NumPy."""


def _add_hand_device(parser: Parser) -> None:
    parser.group(_HAND).add_argument(
        "--hand-device",
        nargs="?",
        action=_Device,
        const=_AUTO,
        metavar="NAME",
        help="gamepad or 3D mouse: part of its name, spacenav, a socket path, or auto for the first; list prints all",
    )


@dataclass(frozen=True, kw_only=True)
class HandOptions:
    """Gamepad or 3D mouse as the hand."""

    name: Annotated[str | None, Shared(_add_hand_device, lambda options: options.hand_device)] = None
    mapping: _HandMapping

    @contextmanager
    def open(self, hand_force: SpringHand, tell: Callable[[str], object] = say) -> Iterator[list[HandDevice]]:
        """Open the device for the duration of the context; yield an empty list without --hand-device.

        Args:
            hand_force: Hand that the device moves.
            tell: Function that prints the device's name.

        Raises:
            ParameterError: If an option is given without --hand-device, or the device is not found.
        """
        if self.name is None:
            if self.mapping != _hand_mapping():
                raise ParameterError("hand-gain and other hand options require --hand-device")
            yield []
            return
        from maglev_mj.interop.hand_devices import HandDevice, open_device

        device = open_device(self.name)
        tell(f"  hand device: {device.name}")
        with closing(HandDevice(device, hand_force, self.mapping)) as opened:
            yield [opened]
