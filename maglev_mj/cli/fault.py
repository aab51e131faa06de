"""`maglev-mj fault`: the last cycles before a fault."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from maglev_mj import plots
from maglev_mj.bridge.fault import load_black_box
from maglev_mj.cli.output import check_outputs
from maglev_mj.tables import fault_table

__all__ = ["add_command"]


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    command = commands.add_parser("fault", help="what happened, when, and the last cycles, from a fault's file")
    command.add_argument("file", metavar="FILE", type=Path, help="maglev-fault-DATE.json, which a flight has left")
    command.add_argument("--all", action="store_true", help="show all 200 cycles, not the last 20")
    command.add_argument("--out", metavar="DIR", type=Path, help="write a picture to this folder")
    command.set_defaults(run=_fault)


def _fault(options: argparse.Namespace) -> int:
    check_outputs(out=options.out)
    if options.out is not None:
        plots.require()
    record = load_black_box(options.file)
    print(fault_table(record, whole=options.all))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        print(f"  wrote {plots.last_cycles(record, options.out / f'{options.file.stem}.png')}")
    return 0
