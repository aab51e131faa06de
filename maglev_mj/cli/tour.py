"""`maglev-mj tour`: a guided tour of the joystick, step by step."""

from __future__ import annotations

import argparse
from pathlib import Path

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import number_option
from maglev_mj.cli.output import check_outputs
from maglev_mj.cli.web import add_web, chosen_page
from maglev_mj.display.remote import show_remotely
from maglev_mj.parameters import number
from maglev_mj.session import Session
from maglev_mj.tables import show_table
from maglev_mj.tour import Tour

__all__ = ["add_options"]


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    add_web(parser)
    parser.group("run").add_argument(
        "--seconds", type=number_option, metavar="X", help="close the window after so long [s]"
    )
    parser.group("output").add_argument(
        "--out", metavar="DIR", type=Path, default=Path(), help="folder for recordings and screenshots (default .)"
    )
    parser.set_defaults(run=_tour)


def _tour(options: argparse.Namespace) -> int:
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    check_outputs(out=options.out)
    page = chosen_page(options)
    if page is None:
        # imported here: it loads the library that opens windows
        from maglev_mj.viewer.window import require_display, show

        require_display()
    options.out.mkdir(parents=True, exist_ok=True)
    session = Session(folder=options.out)
    tour = Tour(session)
    try:
        if page is None:
            report = show(tour, folder=options.out, duration=seconds)
        else:
            report = show_remotely(tour, page, duration=seconds)
        print(show_table(report))
    finally:
        for path in session.recordings:
            print(f"  wrote {path}")
    return 0
