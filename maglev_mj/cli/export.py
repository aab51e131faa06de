"""`maglev-mj export`: a recording as a table."""

from __future__ import annotations

import argparse
from pathlib import Path

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.writable import check_outputs
from maglev_mj.recording import EXPORTS, Recording
from maglev_mj.recording.recording import export
from maglev_mj.terminal import say


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.add_argument("file", metavar="FILE", type=Path, help="a recording, .mcap or .npz")
    output = parser.group("output")
    output.add_argument("--to", required=True, choices=tuple(EXPORTS), help="what kind of table")
    output.add_argument("--out", metavar="FILE", type=Path, help="where to (default: beside the recording)")
    parser.set_defaults(run=_export)


def _export(options: argparse.Namespace) -> int:
    options.out = path = options.out or options.file.with_suffix(f".{options.to}")
    check_outputs(options)
    with Progress("export"):
        recording = Recording.load(options.file)
        export(recording, options.to, path)
    if recording.damage:
        say(f"  {options.file}: {recording.damage}")
    print(f"  wrote {path}: {recording.ticks} samples")
    return 0
