"""`maglev-mj render`: a picture or clip of a scene."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import count, number_option
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene, chosen_scene
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import number

_LEAST, _MOST = 160, 4000


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    add_scene(parser, default="joystick")
    output = parser.group("output")
    output.add_argument("--out", metavar="FILE", type=Path, required=True, help="a .png, .gif or .mp4")
    output.add_argument(
        "--seconds",
        type=number_option,
        metavar="X",
        help="length of a clip, or when a picture is taken [s] (default: as long as the scene lasts, or half)",
    )
    output.add_argument("--size", default="1200x750", metavar="WxH", help="pixels (default 1200x750)")
    output.add_argument("--fps", type=count, default=20, metavar="N", help="pictures a second (default 20)")
    output.add_argument("--plain", action="store_true", help="leave plots and words out")
    parser.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> int:
    scene = chosen_scene(options)
    width, height = _pixels(options.size)
    number("fps", options.fps, at_least=1, at_most=50)
    if options.seconds is not None:
        number("seconds", options.seconds, at_least=0.0, at_most=600.0)
    # imported here: it loads the libraries that draw
    from maglev_mj.views.window.clip import checked_name
    from maglev_mj.views.window.render import render

    checked_name(options.out)
    with Progress(f"render {scene.name}") as progress:
        frames = render(
            scene,
            options.out,
            seconds=options.seconds,
            width=width,
            height=height,
            rate=options.fps,
            plots=not options.plain,
            progress=progress,
        )
    print(f"wrote {options.out}" + (f", {frames} pictures" if frames > 1 else ""))
    return 0


def _pixels(size: str) -> tuple[int, int]:
    """Return width and height of a text such as 1200x750.

    Raises:
        ParameterError: If the text has another form, or a size is outside its bounds.
    """
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if found is None or not all(_LEAST <= int(part) <= _MOST for part in found.groups()):
        raise ParameterError(f"size must be WxH, such as 1200x750, of {_LEAST} to {_MOST} pixels each, not {size!r}")
    return int(found[1]), int(found[2])
