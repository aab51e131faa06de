"""`maglev-mj tour`: a guided tour of the joystick, step by step."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from maglev_mj.cli.options import number_option
from maglev_mj.cli.output import check_outputs
from maglev_mj.parameters import number
from maglev_mj.session import Session
from maglev_mj.tables import show_table
from maglev_mj.tour import Tour

__all__ = ["add_command"]


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    tour = commands.add_parser("tour", help="feel walls and friction in eight steps")
    tour.add_argument(
        "--out", metavar="DIR", type=Path, default=Path(), help="folder for recordings and screenshots (default .)"
    )
    tour.add_argument("--seconds", type=number_option, metavar="X", help="close the window after so long [s]")
    tour.set_defaults(run=_tour)


def _tour(options: argparse.Namespace) -> int:
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    check_outputs(out=options.out)
    # imported here: it loads the library that opens windows
    from maglev_mj.viewer.window import require_display, show

    require_display()
    options.out.mkdir(parents=True, exist_ok=True)
    session = Session(folder=options.out)
    try:
        print(show_table(show(Tour(session), folder=options.out, duration=seconds)))
    finally:
        for path in session.recordings:
            print(f"  wrote {path}")
    return 0
