"""`maglev-mj render`: a picture or a clip of a scene, without a window."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from maglev_mj.cli.options import add_settings, chosen_settings, count, number_option
from maglev_mj.cli.output import check_file
from maglev_mj.parameters import number
from maglev_mj.scenes import SCENES, scene_called

__all__ = ["add_command"]

_LEAST, _MOST = 160, 4000


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    render = commands.add_parser("render", help="a picture or a clip of a scene, without a window")
    render.add_argument("scene", metavar="SCENE", help=f"one of {', '.join(SCENES)}")
    render.add_argument("--out", metavar="FILE", type=Path, required=True, help="a .png, .gif or .mp4")
    render.add_argument(
        "--seconds",
        type=number_option,
        metavar="X",
        help="length of a clip, or when a picture is taken [s] (default: as long as the scripted hand moves, or half)",
    )
    render.add_argument("--width", type=count, default=1200, metavar="N", help="pixels (default 1200)")
    render.add_argument("--height", type=count, default=750, metavar="N", help="pixels (default 750)")
    render.add_argument("--rate", type=count, default=20, metavar="N", help="pictures a second (default 20)")
    render.add_argument("--plain", action="store_true", help="leave plots and words out")
    add_settings(render)
    render.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> int:
    scene = scene_called(options.scene)
    settings = chosen_settings(options, scene.settings)
    size = {name: number(name, getattr(options, name), at_least=_LEAST, at_most=_MOST) for name in ("width", "height")}
    number("rate", options.rate, at_least=1, at_most=50)
    if options.seconds is not None:
        number("seconds", options.seconds, at_least=0.0, at_most=600.0)
    # imported here: it loads the libraries that draw
    from maglev_mj.viewer.clip import checked_name
    from maglev_mj.viewer.render import render

    check_file("out", checked_name(options.out))
    frames = render(
        scene,
        settings,
        options.out,
        seconds=options.seconds,
        width=int(size["width"]),
        height=int(size["height"]),
        rate=options.rate,
        plots=not options.plain,
    )
    print(f"wrote {options.out}" + (f", {frames} pictures" if frames > 1 else ""))
    return 0
