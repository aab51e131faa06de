"""The options by which a command lets other programs in: a pose stream, a 3D mouse."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from maglev_mj.errors import ParameterError
from maglev_mj.options import chosen_key
from maglev_mj.session import Outlet
from maglev_mj.spacenav import add_spacenav, chosen_spacenav
from maglev_mj.stream import PoseStream
from maglev_mj.stream.stream import URL

__all__ = ["add_outlets", "chosen_outlets"]


def add_outlets(parser: argparse.ArgumentParser) -> None:
    """Add --stream, --stream-key, --spacenav, --socket and --axes."""
    parser.add_argument(
        "--stream",
        nargs="?",
        const=URL,
        metavar="ADDRESS",
        help=f"tell graphical hosts of every frame, and take settings from them (default {URL})",
    )
    parser.add_argument(
        "--stream-key",
        metavar="FILE",
        type=Path,
        help="secret of 16 to 32 bytes as hexadecimal digits, for hosts on other machines",
    )
    add_spacenav(parser)


@contextmanager
def chosen_outlets(options: argparse.Namespace) -> Iterator[list[Outlet]]:
    """Open what was asked for, and close it at the end.

    Raises:
        ParameterError: If an option is wrong.
        MaglevError: If an address or a socket is not to be had.
    """
    if options.stream is None and options.stream_key is not None:
        raise ParameterError("stream-key is for --stream")
    if options.stream is not None and not options.stream.startswith("udp://"):
        raise ParameterError(f"stream must be udp://HOST:PORT, not {options.stream!r}")
    key = chosen_key(options.stream_key, "stream-key")
    with ExitStack() as open_ones:
        outlets: list[Outlet] = []

        def add(outlet: Outlet) -> None:
            open_ones.callback(outlet.close)
            outlets.append(outlet)

        for server in chosen_spacenav(options, _say):
            add(server)
        if options.stream is not None:
            stream = PoseStream(options.stream, key=key)
            add(stream)
            host, port = stream.address
            _say(f"  a pose stream at udp://{host}:{port}")
        yield outlets


def _say(text: str) -> None:
    print(text, flush=True)
