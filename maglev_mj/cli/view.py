"""`maglev-mj view`: the joystick on the screen, moved by mouse."""

from __future__ import annotations

import argparse
from pathlib import Path

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.hand_device import add_hand_device, chosen_hand_device
from maglev_mj.cli.options import add_recording, number_option
from maglev_mj.cli.publishers import add_publishers, chosen_publishers
from maglev_mj.cli.scenes import add_scene, chosen_scene, warn_of_instability
from maglev_mj.cli.web import add_web, chosen_page, show_session
from maglev_mj.parameters import number
from maglev_mj.plants.hand import SpringHand
from maglev_mj.session import Session


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    add_scene(parser, default="joystick")
    group, output = parser.group("run"), parser.group("output")
    group.add_argument(
        "--hand-stiffness",
        type=number_option,
        default=SpringHand.stiffness,
        metavar="X",
        help=f"of the spring by which the hand pulls [N/m] (default {SpringHand.stiffness:g})",
    )
    group.add_argument("--seconds", type=number_option, metavar="X", help="close the window after so long [s]")
    add_web(parser)
    add_hand_device(parser.group("gamepad or 3D mouse as the hand"))
    add_recording(parser)
    output.add_argument(
        "--out", metavar="DIR", type=Path, default=Path(), help="folder for recordings and screenshots (default .)"
    )
    add_publishers(parser)
    parser.set_defaults(run=_view)


def _view(options: argparse.Namespace) -> int:
    scene = chosen_scene(options)
    hand = SpringHand(stiffness=options.hand_stiffness)
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    warn_of_instability(scene)  # and errors of a user's scene, before a page is opened
    page = chosen_page(options)
    if page is None:
        # imported here: it loads the library that opens windows
        from maglev_mj.views.window.window import require_display

        require_display()
    options.out.mkdir(parents=True, exist_ok=True)
    # the device first: a 3D mouse of our own is none for this hand
    with chosen_hand_device(options, hand) as devices, chosen_publishers(options) as (publishers, live):
        session = Session(
            scene,
            hand=hand,
            folder=options.out,
            record=options.record,
            file=live,
            publishers=[*publishers, *devices],
            step_force=options.step_force,
        )
        for device in devices:
            device.act = session.act
        try:
            print(show_session(session, page, options.out, seconds))
        finally:
            for path in session.recordings:  # after any error the user needs their paths
                print(f"  wrote {path}")
    return 0
