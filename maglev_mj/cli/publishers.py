"""Options of connections to other programs: live server, 3D mouse."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import count, number_option
from maglev_mj.cli.spacenav import add_spacenav, chosen_spacenav
from maglev_mj.errors import ParameterError
from maglev_mj.interop.foxglove import PORT, LiveServer
from maglev_mj.parameters import number
from maglev_mj.session import STEP_FORCE, Publisher
from maglev_mj.session.access import check_port
from maglev_mj.terminal import say


class OpenPublishers(NamedTuple):
    """Opened connections to other programs.

    Attributes:
        publishers: All publishers.
        live: The live server; None for none.
    """

    publishers: list[Publisher]
    live: LiveServer | None


def add_foxglove(parser: Parser) -> None:
    """Add --foxglove."""
    parser.group("other programs").add_argument(
        "--foxglove",
        nargs="?",
        type=_port,
        const=PORT,
        metavar="PORT",
        help=f"serve every sample to programs on this machine that read the Foxglove protocol (default {PORT})",
    )


def _port(text: str) -> int:
    try:
        return check_port(count(text))
    except ParameterError as error:  # before a window is asked for
        raise argparse.ArgumentTypeError(str(error)) from None


def chosen_foxglove(options: argparse.Namespace) -> LiveServer | None:
    """Start and return the chosen live server, or None.

    Raises:
        LiveServerError: See `LiveServer`.
    """
    if options.foxglove is None:
        return None
    live = LiveServer(options.foxglove)
    say(f"  live at ws://127.0.0.1:{live.port}, as Foxglove opens it")
    return live


def add_publishers(parser: Parser) -> None:
    """Add --foxglove, --step-force, and the options of a 3D mouse."""
    add_foxglove(parser)
    parser.group("other programs").add_argument(
        "--step-force",
        type=number_option,
        default=STEP_FORCE,
        metavar="X",
        help=f"largest step of force where the flotor is that new settings may make [N] (default {STEP_FORCE:g})",
    )
    add_spacenav(parser)


@contextmanager
def chosen_publishers(options: argparse.Namespace) -> Iterator[OpenPublishers]:
    """Open the chosen publishers; close them at the end.

    Raises:
        ParameterError: If an option is wrong.
        MaglevError: If a port or a socket cannot be opened.
    """
    number("step-force", options.step_force, above=0.0)
    with ExitStack() as open_ones:
        publishers: list[Publisher] = []
        for server in chosen_spacenav(options, say):
            open_ones.callback(server.close)
            publishers.append(server)
        if (live := chosen_foxglove(options)) is not None:
            open_ones.callback(live.close)
            publishers.append(live)
        yield OpenPublishers(publishers, live)
