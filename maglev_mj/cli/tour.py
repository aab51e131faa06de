"""`maglev-mj tour`: guided tour of the joystick."""

from __future__ import annotations

import argparse
from pathlib import Path

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.hand_device import add_hand_device, chosen_hand_device
from maglev_mj.cli.options import number_option
from maglev_mj.cli.web import add_web, chosen_page, show_session
from maglev_mj.parameters import number
from maglev_mj.plants.hand import SpringHand
from maglev_mj.session import Session
from maglev_mj.session.tour import Tour


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    add_hand_device(parser.group("gamepad or 3D mouse as the hand"))
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
    page, hand = chosen_page(options), SpringHand()
    options.out.mkdir(parents=True, exist_ok=True)
    with chosen_hand_device(options, hand) as devices:
        session = Session(hand=hand, folder=options.out, publishers=devices)
        for device in devices:
            device.act = session.act
        try:
            print(show_session(Tour(session), page, options.out, seconds))
        finally:
            for path in session.recordings:
                print(f"  wrote {path}")
    return 0
