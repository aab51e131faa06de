"""Entry point of the command line, and the table of its commands."""

from __future__ import annotations

import argparse
import atexit
import gc
import io
import os
import select
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import NamedTuple, TextIO

import maglev_mj
from maglev_mj.cli.declare import Parser, joined
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.terminal import say


class Command(NamedTuple):
    """Command, which is a function; see `declare`.

    Attributes:
        summary: Purpose in a few words.
        example: Arguments of an example.
        function: Name of the function; empty if it is that of the command.
    """

    summary: str
    example: str
    function: str = ""


GROUPS: Mapping[str, Mapping[str, Command]] = {
    "feel it": {
        "view": Command("feel a scene in a window: pull with the mouse", "box --stiffness 4000 --friction"),
        "tour": Command("walls and friction in eight steps, guided", "--out tour"),
        "lessons": Command("notebooks to learn from, with or without solutions", "lessons --students"),
        "render": Command("a picture or a clip of a scene, without a window", "corner --out corner.png --size 800x500"),
    },
    "compute": {
        "drop": Command("drop the flotor on a stiff wall (figures 3, 4)", "--pulse 0 --phases 20 --out figures", "run"),
        "press": Command("a hand hits a wall, then presses (figure 6)", "--hand stylus --hits 2 --json -", "run"),
        "stick-slip": Command("pull out of rendered friction (figure 8)", "--law lugre --record run.maglev", "run"),
        "run": Command("run any scene: of this package, or a file of yours", "twist --plant exact --json run.json"),
        "stability": Command("where a wall is stable (figure 2), or a scene", "--hand arm --delay 0.002 --grid 20"),
        "design": Command("the stiffest wall for what is uncertain", "--mass 0.56:0.84 --hand arm,stylus"),
        "compare": Command("your law of a wall beside published ones", "drop --law pd --law observer --out figures"),
        "sweep": Command("any scene over a grid of its parameters", "drop --vary height=1e-3:4e-3:4 --workers 2"),
        "fidelity": Command("the cheapest model that will do for a scene", "let-go --duration 0.02 --phases 2"),
        "card": Command("what a device renders: Z-width, transparency, mass, force", "drop --rate 1000 --out figures"),
        "info": Command("Table 1 of the paper, and what the model yields", "--json table1.json"),
    },
    "device": {
        "twin": Command("a simulated device behind the wire of a real one", "--rate 1000 --fault dead-coil:2@3 --view"),
        "bridge": Command("a scene on a device", "udp://127.0.0.1:5678 --scene box --view --record f.maglev"),
        "estop": Command("stop a device, also in the session of another host", "udp://192.168.1.20:5678 --key lab.key"),
        "commission": Command("diodes and coils of a new device, before it hovers", "udp://127.0.0.1:5678 coils"),
        "conform": Command("test a device's side of the protocol", "udp://127.0.0.1:5678 --json report.json"),
        "fault": Command("what happened before a fault, from its file", "fault-20260101-120000.maglev --all"),
    },
    "recordings": {
        "replay": Command("show a recording, or check it bit for bit", "run.maglev --check"),
        "analyse": Command("figures of a recording beside its simulation", "run.maglev --from 0.1 --out figures"),
        "export": Command("a recording for other programs: MCAP, table, arrays, sound", "run.maglev --to mcap"),
    },
}
"""Commands in the order of the help."""

COMMANDS: Mapping[str, Command] = {name: command for group in GROUPS.values() for name, command in group.items()}

MODULES: Mapping[str, str] = {
    name: module
    for module, names in {
        "scenes": "view tour render drop press stick-slip run",
        "studies": "stability design compare card sweep fidelity",
        "twin": "twin",
        "bridge": "bridge",
        "device": "info estop commission conform",
        "lessons": "lessons",
        "recordings": "fault replay analyse export",
    }.items()
    for name in names.split()
}
"""Module of this package that has the function of each command."""


_UNREAD = 141  # as a shell gives for a program that a closed pipe ends


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        Exit status: 0, 1 for a run that failed, 2 for bad input, 130 for Ctrl-C, 141 for an output closed by its
        reader.
    """
    if arguments is None:  # a program: its end need not look through all that was loaded, which takes 25 ms
        atexit.register(gc.freeze)
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="replace")  # not every encoding of a system has all signs of units
    try:
        try:
            if "_ARGCOMPLETE" in os.environ:  # a shell asks for completions
                from maglev_mj.cli.completion import complete

                complete(program_parser(), _typed)
            options = parse(sys.argv[1:] if arguments is None else arguments)
            if options.command is None:
                program_parser().print_help()
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
    except ImportError as error:
        lacking = str(error.name).partition(".")[0]
        if lacking not in _WITHOUT:
            raise
        print(f"maglev-mj: this needs {lacking}, which cannot be imported here{_WITHOUT[lacking]}", file=sys.stderr)
        return 1


_WITHOUT = {
    "mujoco": "; scenes do without it by `--plant exact`, devices by `--calibration FILE`",
    "multiprocessing": "; sweeps do without it by `--workers 0`",
    "glfw": "",
}
"""What some systems, as a browser's Python, lack, and what does without it."""


def _run(options: argparse.Namespace) -> int:
    from maglev_mj.cli.output import check_outputs  # a help needs neither

    try:
        with _interruptible():
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
        return 1
    except Exception as error:
        from maglev_mj.scenes.find import line_of  # which the help does not need

        if (line := line_of(error)) is None:
            raise
        say(f"maglev-mj {options.command}: {line}: {type(error).__name__}: {error}", sys.stderr)
        return 2


@contextmanager
def _interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C during a command; while a program loads and ends, Ctrl-C exits at once.

    A signal that a shell lets the program ignore stays ignored.
    """
    before, replaced = signal.getsignal(signal.SIGINT), False
    with suppress(ValueError):  # not the main thread, which alone receives signals
        if replaced := before not in (signal.SIG_IGN, None):
            signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        with suppress(ValueError):
            if replaced:
                signal.signal(signal.SIGINT, before)


def _stopped(options: argparse.Namespace, why: str) -> int:
    print(f"maglev-mj {options.command}: {why}", file=sys.stderr)
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


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options of a command line; `command` is None without one.

    Of all commands only that of the line is loaded.
    """
    words = joined(arguments)
    if words and words[0] in COMMANDS:
        return _parsed(*words)
    program = program_parser()  # an option of the program comes first, or a wrong word
    options, unknown = program.parse_known_args(words)
    if options.command is not None:
        options = _parsed(*options.command)
    program.refuse(unknown)
    return options


def _parsed(name: str, *words: str) -> argparse.Namespace:
    parser = command_parser(name, words)
    add_options(parser, name)
    options: argparse.Namespace = parser.parse_args(words)
    return options


def _typed(words: Sequence[str]) -> Parser | None:
    """Return the parser of a command line that is not complete; None without a command."""
    if not words or words[0] not in COMMANDS:
        return None
    parser = command_parser(words[0], words[1:])
    with suppress(SystemExit):  # the scene's name is incomplete
        add_options(parser, words[0])
    return parser


def program_parser() -> Parser:
    """Return the parser of the program's own options; its help lists all commands."""
    parser = Parser(prog="maglev-mj", description=f"{str(maglev_mj.__doc__).partition(':')[0]}.")
    parser.add_argument("--version", action="version", version=f"maglev-mj {maglev_mj.__version__}")
    parser.epilog = (
        "maglev-mj COMMAND --help lists its options, with an example; --rate [Hz] does for --period [s]. "
        "In Python, help(maglev_mj) lists all names.\n\n"
        "Exit status: 0; 1 failed run, 2 bad input, 130 Ctrl-C, 141 unread output."
    )
    command = parser.add_argument(
        "command", metavar="COMMAND", nargs=argparse.PARSER, choices=COMMANDS, help=argparse.SUPPRESS
    )
    command.required = False
    for title, group in GROUPS.items():
        parser.add_argument_group(title, "\n".join(f"  {name:<16}{one.summary}" for name, one in group.items()))
    return parser


def command_parser(name: str, words: Sequence[str]) -> Parser:
    """Return the parser of a command for these words, without its options."""
    parser = Parser(prog=f"maglev-mj {name}", example=f"maglev-mj {name} {COMMANDS[name].example}", words=words)
    parser.set_defaults(command=name)
    return parser


def add_options(parser: Parser, name: str) -> None:
    """Load a command and add its options; those of a scene if the parser's words name one."""
    from maglev_mj.cli.declare import declare  # which the help of all commands does not need
    from maglev_mj.views.window.backend import check_mujoco_gl

    try:
        check_mujoco_gl()  # before the engine is loaded, which refuses it with a traceback
    except ParameterError as error:
        parser.error(str(error))
    module = import_module(f"maglev_mj.cli.{MODULES[name]}")  # a command loads its own libraries only
    declare(getattr(module, COMMANDS[name].function or name.replace("-", "_")), parser)
