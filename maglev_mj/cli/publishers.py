"""The options by which a command lets other programs in: a pose stream, a 3D mouse."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from maglev_mj.cli.options import Container, chosen_key, number_option
from maglev_mj.cli.spacenav import add_spacenav, chosen_spacenav
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import number
from maglev_mj.session import STEP_FORCE, Publisher
from maglev_mj.stream import URL, PoseStream
from maglev_mj.terminal import say

__all__ = ["add_publishers", "chosen_publishers"]


def add_publishers(parser: Container) -> None:
    """Add --stream, --stream-key, --step-force, --spacenav, --socket and --axes."""
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
    parser.add_argument(
        "--step-force",
        type=number_option,
        default=STEP_FORCE,
        metavar="X",
        help=f"largest step of force where the flotor is that new settings may make [N] (default {STEP_FORCE:g})",
    )
    add_spacenav(parser)


@contextmanager
def chosen_publishers(options: argparse.Namespace) -> Iterator[list[Publisher]]:
    """Open what was asked for, and close it at the end.

    Raises:
        ParameterError: If an option is wrong.
        MaglevError: If an address or a socket is not to be had.
    """
    if options.stream is None and options.stream_key is not None:
        raise ParameterError("stream-key is for --stream")
    if options.stream is not None and not options.stream.startswith("udp://"):
        raise ParameterError(f"stream must be udp://HOST:PORT, not {options.stream!r}")
    number("step-force", options.step_force, above=0.0)
    key = chosen_key(options.stream_key, "stream-key")
    with ExitStack() as open_ones:
        publishers: list[Publisher] = []

        def add(publisher: Publisher) -> None:
            open_ones.callback(publisher.close)
            publishers.append(publisher)

        for server in chosen_spacenav(options, say):
            add(server)
        if options.stream is not None:
            stream = PoseStream(options.stream, key=key)
            add(stream)
            host, port = stream.address
            say(f"  a pose stream at udp://{host}:{port}")
        yield publishers
