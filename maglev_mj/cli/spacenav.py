"""Options of a command as 3D mouse for other programs."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_parameters, chosen
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.interop.spacenav import PoseAxes, RateAxes, SpacenavMapping, SpacenavServer, Taps
from maglev_mj.parameters import flag

_AXES_TOLD: dict[str, Callable[..., Any]] = {"pose": PoseAxes, "rate": RateAxes}
"""Reported axes by name."""

_PREFIX = "spacenav-"


def add_spacenav(parser: Parser, *, always: bool = False) -> None:
    """Add the options of the 3D mouse.

    --spacenav, --socket, --axes, and an option for each parameter of `SpacenavMapping`.

    Args:
        parser: Parser of the command.
        always: True if the command always is a 3D mouse, without --spacenav.
    """
    group = parser.group("3D mouse of other programs")
    if flag("always", always):
        parser.set_defaults(spacenav=True)
    else:
        group.add_argument("--spacenav", action="store_true", help="be a 3D mouse to other programs")
    group.add_argument(
        "--socket",
        metavar="PATH",
        type=Path,
        help="where those find it (default: $SPNAV_SOCKET, or one in $XDG_RUNTIME_DIR)",
    )
    group.add_argument(
        "--axes",
        metavar="WHAT",
        help="what those are told: pose, the deflection; or rate, the motion of a slave (default pose)",
    )
    add_parameters(group, SpacenavMapping, _PREFIX)


def chosen_spacenav(options: argparse.Namespace, say: Callable[[str], object] = print) -> list[SpacenavServer]:
    """Start and return the chosen server, in a list.

    Empty without a choice.

    Args:
        options: Parsed options.
        say: Function that prints its address.

    Raises:
        ParameterError: If an option is wrong, or is given without --spacenav.
    """
    mapping = chosen(options, SpacenavMapping, _PREFIX)
    if not options.spacenav:
        for name in ("socket", "axes"):
            if getattr(options, name) is not None:
                raise ParameterError(f"{name} is for --spacenav")
        if mapping != SpacenavMapping():
            raise ParameterError(f"{_PREFIX}gain and the like are for --spacenav")
        return []
    axes = "pose" if options.axes is None else options.axes
    check_one_of("axes", _AXES_TOLD, axes)
    buttons = None if mapping.press is None else Taps(mapping.press)
    server = SpacenavServer(options.socket, axes=_AXES_TOLD[axes](mapping=mapping), buttons=buttons)
    say("  a 3D mouse; for the programs that are to have it:")
    say(f"    export SPNAV_SOCKET={server.path.resolve()}")
    return [server]
