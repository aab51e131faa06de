"""Options of what draws: a folder for pictures, and their format."""

from __future__ import annotations

import argparse
from pathlib import Path

from maglev_mj.cli.options import Container, Parser
from maglev_mj.plots.drawing import FORMATS, PictureFolder

__all__ = ["add_pictures", "script_options"]


def add_pictures(parser: Container, default: Path | None = None) -> None:
    """Add --out and --format.

    Args:
        parser: Of the command.
        default: Folder where none is given; None for no pictures.
    """
    also = "" if default is None else f" (default {default})"
    parser.add_argument("--out", metavar="DIR", type=Path, default=default, help=f"write pictures to this folder{also}")
    parser.add_argument("--format", choices=FORMATS, default=FORMATS[0], help=f"of pictures (default {FORMATS[0]})")


def script_options(description: str | None, quick: str | None = None) -> argparse.Namespace:
    """Return the options of a script that draws.

    Args:
        description: Of the script.
        quick: Help of `--quick`; None for a script without.

    Returns:
        `pictures`, a `PictureFolder`, and `quick`.
    """
    parser = Parser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_pictures(parser, Path("figures"))
    if quick is not None:
        parser.add_argument("--quick", action="store_true", help=quick)
    options = parser.parse_args()
    options.pictures = PictureFolder(options.out, options.format)
    return options
