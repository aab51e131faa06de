"""Entry point of the command line."""

from __future__ import annotations

import argparse
import atexit
import gc
import os
import select
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import TextIO

import maglev_mj
from maglev_mj.cli.arguments import Parser, joined
from maglev_mj.cli.commands import GROUPS, MODULES, Command
from maglev_mj.cli.completion import complete
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.terminal import say

_UNREAD = 141  # as a shell gives for a program that a closed pipe ends


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        Exit status: 0, 1 for a run that failed, 2 for bad input, 130 for Ctrl-C, 141 for an output closed by its
        reader.
    """
    if arguments is None:  # a program: its end need not look through all that was loaded, which takes 25 ms
        atexit.register(gc.freeze)
    try:
        try:
            made = parser()
            complete(made)
            options = made.parse_args(joined(sys.argv[1:] if arguments is None else arguments))
            if options.command is None:
                made.print_help()
                return 0
            return _run(options)
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
    from maglev_mj.cli.output import check_outputs  # a help needs neither
    from maglev_mj.process import Interrupts

    interrupts = Interrupts()
    try:
        with interrupts:
            check_outputs(options)
            status: int = options.run(options)
        return status
    except KeyboardInterrupt as stopped:
        return _stopped(options, str(stopped) or "stopped")
    except ParameterError as error:
        say(f"maglev-mj {options.command}: {error}", sys.stderr)
        return 2
    except (MaglevError, OSError) as error:
        if isinstance(error, BrokenPipeError) and _is_unread(sys.stdout):
            raise
        say(f"maglev-mj {options.command}: {error}", sys.stderr)
        _drop_unwritten()
        return 130 if interrupts.seen else 1  # a library's loading may have failed by it
    except Exception as error:
        from maglev_mj.scenes.find import line_of  # which the help does not need

        if interrupts.seen:
            return _stopped(options, "stopped")
        if (line := line_of(error)) is None:
            raise
        say(f"maglev-mj {options.command}: {line}: {type(error).__name__}: {error}", sys.stderr)
        return 2


def _stopped(options: argparse.Namespace, why: str) -> int:
    print(f"maglev-mj {options.command}: {why}", file=sys.stderr)
    exec("pass")  # after an interrupt in `exec`, as dataclasses use it, the interpreter would end by the signal
    return 130


def _is_unread(stream: TextIO) -> bool:
    """Return True for a pipe closed at its other end."""
    try:
        poll = select.poll()
        poll.register(stream, 0)
    except (AttributeError, TypeError, ValueError):  # not on this system, or no file
        return False
    return bool(poll.poll(0))


def _drop_unwritten() -> None:
    """Discard unwritten output, which the interpreter would write again."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def parser() -> Parser:
    """Return the parser of all commands.

    A command's module is loaded with its first arguments.
    """
    made = Parser(prog="maglev-mj", description=f"{str(maglev_mj.__doc__).partition(':')[0]}.")
    made.add_argument("--version", action="version", version=f"maglev-mj {maglev_mj.__version__}")
    made.epilog = (
        "maglev-mj COMMAND --help lists the options of one, with an example. For a --period [s] a --rate [Hz] is "
        "understood too, and the reverse. In Python, help(maglev_mj) lists all names.\n\n"
        "Exit status: 0; 1 for a run that failed, 2 for bad input, 130 for Ctrl-C, 141 for an output that nobody reads."
    )
    made.set_defaults(command=None)
    commands = made.add_subparsers(dest="command", metavar="COMMAND", prog="maglev-mj", help=argparse.SUPPRESS)
    for title, group in GROUPS.items():
        made.add_argument_group(title, "\n".join(f"  {name:<16}{one.summary}" for name, one in group.items()))
        for name, one in group.items():
            own = commands.add_parser(name, example=f"maglev-mj {name} {one.example}")
            own.before = partial(_add_options, own, name, one)
    made.before = partial(_prepare, commands.choices)
    return made


def _prepare(commands: Mapping[str, Parser], words: Sequence[str]) -> None:
    if words and words[0] in commands:
        from maglev_mj.views.window.backend import check_mujoco_gl

        try:
            check_mujoco_gl()  # before the engine is loaded, which refuses it with a traceback
        except ParameterError as error:
            commands[words[0]].error(str(error))
        commands[words[0]].prepare(words[1:])


def _add_options(parser: Parser, name: str, command: Command, _: Sequence[str]) -> None:
    from maglev_mj.cli.declare import declare  # which the help of all commands does not need

    module = import_module(f"maglev_mj.cli.{MODULES[name]}")  # a command loads its own libraries only
    declare(getattr(module, command.function or name.replace("-", "_")), parser)
