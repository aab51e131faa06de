"""`maglev-mj info`: Table 1 of the paper beside model values."""

from __future__ import annotations

import argparse

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_json
from maglev_mj.cli.output import write_result
from maglev_mj.plants.shapes import device_report


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    add_json(parser)
    parser.set_defaults(run=_info)


def _info(options: argparse.Namespace) -> int:
    write_result(options, device_report())
    return 0
