"""The command line: `maglev-mj` and its commands."""

from __future__ import annotations

import argparse
import os
import select
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TextIO

import maglev_mj
from maglev_mj.cli.options import Parser, joined
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.scenes.find import line_of
from maglev_mj.terminal import say

__all__ = ["main", "parser"]

COMMANDS = {
    **dict.fromkeys(("run", "drop", "press", "stick-slip"), "run"),
    **{name: name.replace("-", "_") for name in ("view", "render", "serve-spacenav", "replay", "analyse", "export")},
    **{name: name for name in ("stability", "design", "sweep", "fidelity", "info")},
    **{name: name for name in ("twin", "bridge", "estop", "fault", "commission", "conform")},
}
"""Commands in the order in which the help lists them, and the module of each."""

_UNREAD = 141  # as a shell gives for a program that a closed pipe ends


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        Exit status: 0, 1 for a run that failed, 2 for bad input, 130 for Ctrl-C, 141 for an output that nobody reads.
    """
    try:
        try:
            words = joined(sys.argv[1:] if arguments is None else arguments)
            return _run(parser(words[0] if words else None).parse_args(words))
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()  # a failure at the interpreter's end would be a traceback
    except OSError as error:  # of standard output or standard error
        _drop_unwritten()
        if isinstance(error, BrokenPipeError):
            return _UNREAD
        print(f"maglev-mj: {error}", file=sys.stderr)
        return 1


def _run(options: argparse.Namespace) -> int:
    try:
        status: int = options.run(options)
        return status
    except KeyboardInterrupt as stopped:
        print(f"maglev-mj {options.command}: {str(stopped) or 'stopped'}", file=sys.stderr)
        return 130
    except ParameterError as error:
        say(f"maglev-mj {options.command}: {error}", sys.stderr)
        return 2
    except (MaglevError, OSError) as error:
        if isinstance(error, BrokenPipeError) and _is_unread(sys.stdout):
            raise
        say(f"maglev-mj {options.command}: {error}", sys.stderr)
        _drop_unwritten()
        return 1
    except Exception as error:
        if (line := line_of(error)) is None:
            raise
        say(f"maglev-mj {options.command}: {line}: {type(error).__name__}: {error}", sys.stderr)
        return 2


def _is_unread(stream: TextIO) -> bool:
    """Return whether a stream is a pipe whose other end is closed."""
    try:
        poll = select.poll()
        poll.register(stream, 0)
    except (AttributeError, TypeError, ValueError):  # not on this system, or no file
        return False
    return bool(poll.poll(0))


def _drop_unwritten() -> None:
    """Send to nowhere what the streams cannot write, for the interpreter would try again."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def parser(command: str | None = None) -> Parser:
    """Return the parser of a command; of every command where it is none of them."""
    made = Parser(prog="maglev-mj", description=maglev_mj.__doc__)
    made.add_argument("--version", action="version", version=f"maglev-mj {maglev_mj.__version__}")
    made.epilog = (
        "Exit status: 0; 1 for a run that failed, 2 for bad input, 130 for Ctrl-C, 141 for an output that nobody reads."
    )
    commands = made.add_subparsers(dest="command", required=True, metavar="command")
    # a command loads what it needs, and no other's libraries
    needed = {command: COMMANDS[command]} if command in COMMANDS else COMMANDS
    for module in dict.fromkeys(needed.values()):
        import_module(f"maglev_mj.cli.{module}").add_command(commands)
    return made
