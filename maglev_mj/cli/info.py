"""`maglev-mj info`: Table 1 of the paper beside what the model yields."""

from __future__ import annotations

import argparse
from typing import Any

from maglev_mj.cli.output import write_json
from maglev_mj.report import device_report, device_table

__all__ = ["add_command"]


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    info = commands.add_parser("info", help="Table 1 of the paper beside what the model yields")
    info.add_argument("--json", metavar="FILE", help="write the figures as JSON; - for standard output")
    info.set_defaults(run=_info)


def _info(options: argparse.Namespace) -> int:
    report = device_report()
    if options.json is not None:
        write_json(options.json, {"figures": report.figures, "contradictions": report.contradictions})
    if options.json != "-":
        print(device_table(report))
    return 0
