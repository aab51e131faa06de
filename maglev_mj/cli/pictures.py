"""Options of commands that draw: folder and format."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.output import check_folder
from maglev_mj.errors import ParameterError

if TYPE_CHECKING:
    from maglev_mj.pictures import PictureFolder

FORMATS = "png", "pdf", "svg"
"""Formats of pictures: those of `maglev_mj.pictures`, which loads arrays."""


def add_pictures(parser: Parser, told: str = "write pictures to this folder", default: Path | None = None) -> None:
    """Add --out and --format.

    Args:
        parser: Parser of the command.
        told: Help of --out.
        default: Default folder; None for no pictures.
    """
    output = parser.group("output")
    output.add_argument("--out", metavar="DIR", type=Path, default=default, help=told)
    output.add_argument(
        "--format", metavar="NAME", choices=FORMATS, help=f"of pictures: {', '.join(FORMATS)} (default {FORMATS[0]})"
    )


def chosen_pictures(options: argparse.Namespace) -> PictureFolder | None:
    """Return the chosen picture folder; None for no pictures.

    Raises:
        ParameterError: If a format is given without a folder, or the folder is a file.
        MissingPackageError: If matplotlib is not installed.
    """
    folder = options.out
    if folder is None:
        if options.format is not None:
            raise ParameterError(f"format must be given with out, the folder of pictures, not {options.format!r} alone")
        return None
    from maglev_mj.pictures import PictureFolder, require  # with arrays, which a help does not need

    require()
    check_folder(folder)
    return PictureFolder(folder, options.format or FORMATS[0])


def script_options(
    description: str | None, quick: str | None = None, more: Callable[[Parser], object] = lambda parser: None
) -> argparse.Namespace:
    """Return the options of a script that draws.

    Args:
        description: Description of the script.
        quick: Help of `--quick`; None for a script without it.
        more: Called with the parser, for options of its own.

    Returns:
        `pictures`, a `PictureFolder`, and `quick`.
    """
    parser = Parser(description=description)
    add_pictures(parser, "write files to this folder (default figures)", Path("figures"))
    if quick is not None:
        parser.add_argument("--quick", action="store_true", help=quick)
    more(parser)
    options = parser.parse_args()
    try:
        options.pictures = chosen_pictures(options)
    except ParameterError as error:
        parser.error(str(error))
    return options
