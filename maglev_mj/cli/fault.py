"""`maglev-mj fault`: the last cycles before a fault."""

from __future__ import annotations

import argparse
from pathlib import Path

from maglev_mj.bridge.fault import load_black_box
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.pictures import add_pictures, chosen_pictures


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = "What happened, when, and the last cycles, from a fault's file."
    parser.add_argument("file", metavar="FILE", type=Path, help="maglev-fault-DATE.json, which a flight has left")
    output = parser.group("output")
    output.add_argument("--all", action="store_true", help="show all 200 cycles, not the last 20")
    add_pictures(parser, "write a picture to this folder")
    parser.set_defaults(run=_fault)


def _fault(options: argparse.Namespace) -> int:
    pictures = chosen_pictures(options)
    record = load_black_box(options.file)
    print(record.table(whole=options.all))
    if pictures is not None:
        print(f"  wrote {record.plot(path=pictures.path(options.file.stem))}")
    return 0
