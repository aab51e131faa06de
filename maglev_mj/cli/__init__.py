"""Command line: `maglev-mj` and its commands, one per module."""

from maglev_mj.cli.program import main, parser

__all__ = ["main", "parser"]
