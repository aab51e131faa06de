"""`maglev-mj info`: Table 1 of the paper beside what the model yields."""

from __future__ import annotations

import argparse
from typing import Any

from maglev_mj.cli.output import write_results
from maglev_mj.report import device_report, device_table

__all__ = ["add_command"]


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    info = commands.add_parser("info", help="Table 1 of the paper beside what the model yields")
    info.add_argument("--json", metavar="FILE", help="write the figures as JSON; - for standard output")
    info.set_defaults(run=_info)


def _info(options: argparse.Namespace) -> int:
    report = device_report()
    data = {"figures": report.figures, "contradictions": report.contradictions}
    write_results(options, lambda: data, lambda: device_table(report))
    return 0
