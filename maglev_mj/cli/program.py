"""Entry point of the command line, and table of commands."""

from __future__ import annotations

import argparse
import atexit
import errno
import gc
import io
import os
import select
import signal
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any, NamedTuple, TextIO

import maglev_mj
from maglev_mj.cli.declare import Parser, joined
from maglev_mj.cli.renamed import note, renewed
from maglev_mj.errors import MaglevError, ParameterError, PlantError
from maglev_mj.lazy import stop_profiler
from maglev_mj.scenes.names import BUILT_IN, scene_names
from maglev_mj.terminal import printable, say, wrapped


class CommandEntry(NamedTuple):
    """Command; see `declare`.

    Attributes:
        summary: Summary in the list of commands.
        example: Arguments of an example.
    """

    summary: str
    example: str


GROUPS: Mapping[str, Mapping[str, CommandEntry]] = {
    "interactive": {
        "view": CommandEntry("scene in a window or browser, or a guided tour", "box --stiffness 4000 --friction"),
        "lessons": CommandEntry("Jupyter notebooks, with or without solutions", "lessons --students"),
        "render": CommandEntry(
            "image or video of a scene, rendered off-screen", "corner --out corner.png --size 800x500"
        ),
    },
    "compute": {
        "run": CommandEntry("any scene, built-in or from your own file", "drop --pulse 0 --phases 20 --out figures"),
        "diagnose": CommandEntry(
            "why any wall or axis shakes, and what helps most", "drop --stiffness 20000 --out figures"
        ),
        "stability": CommandEntry("stability of a scene, or of one wall", "drop --delay 0.002"),
        "map": CommandEntry("stable walls by theory or simulation (figure 2)", "--hand arm --delay 0.002 --grid 20"),
        "design": CommandEntry(
            "stiffest wall for uncertain mass, delay and hand", "--mass 0.56:0.84 --hand arm,stylus"
        ),
        "compare": CommandEntry(
            "comparison of wall laws, published and your own", "drop --law pd --law pulse --out figures"
        ),
        "sweep": CommandEntry("parameter sweep of any scene", "drop --vary height=1e-3:4e-3:4 --workers 2"),
        "fidelity": CommandEntry("cheapest sufficient model for a scene", "let-go --duration 0.02 --phases 2"),
        "card": CommandEntry(
            "data sheet of a device: Z-width, transparency, force; Table 1", "ubc --rate 1000 --out figures"
        ),
    },
    "device": {
        "twin": CommandEntry(
            "simulated device with the protocol of a real one", "--rate 1000 --fault dead-coil:2@3 --view"
        ),
        "bridge": CommandEntry("scene on a device", "udp://127.0.0.1:5678 --scene box --view --record f.maglev"),
        "estop": CommandEntry("emergency stop of a device, from any host", "udp://192.168.1.20:5678 --key lab.key"),
        "commission": CommandEntry(
            "sensor and coil checks of a new device, before it hovers", "udp://127.0.0.1:5678 coils"
        ),
        "conform": CommandEntry("protocol conformance test of a device", "udp://127.0.0.1:5678 --json report.json"),
    },
    "recordings": {
        "replay": CommandEntry("playback of a recording, or bit-for-bit check", "run.maglev --check"),
        "analyse": CommandEntry(
            "recording compared with its simulation; cause of a fault", "run.maglev --from 0.1 --out figures"
        ),
        "convert": CommandEntry("recording or text table to recording, table, MCAP or sound", "run.maglev run.mcap"),
    },
}
"""Commands in the order of the help."""

COMMANDS: Mapping[str, CommandEntry] = {name: command for group in GROUPS.values() for name, command in group.items()}

MODULES: Mapping[str, str] = {
    name: module
    for module, names in {
        "scenes": "view render run",
        "diagnose": "diagnose",
        "studies": "stability map design compare card sweep fidelity",
        "twin": "twin",
        "bridge": "bridge",
        "device": "estop commission conform",
        "lessons": "lessons",
        "recordings": "replay analyse",
        "convert": "convert",
    }.items()
    for name in names.split()
}
"""Module of each command's function."""


_CLOSED_PIPE = 141  # as shells report SIGPIPE: 128 + 13


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        Exit status: 0 success, 1 failed, 2 invalid input, 130 Ctrl-C, 141 closed pipe
    """
    for name in ("stdin", "stdout", "stderr"):  # a closed one: nothing else must get its file number
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))
    if arguments is None:  # as a program
        stop_profiler()
        atexit.register(gc.freeze)  # skip garbage collection at exit, which takes 25 ms
        for name in ("stdout", "stderr"):
            if isinstance(stream := getattr(sys, name), io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # some system encodings lack the unit symbols
                setattr(sys, name, _on_terminal(stream))
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
            sys.stdout.flush()  # fail here instead of with a traceback at interpreter exit
    except OSError as error:  # from standard output or standard error
        _drop_unwritten()
        if isinstance(error, BrokenPipeError):
            return _CLOSED_PIPE
        print(f"maglev-mj: {_line(error)}", file=sys.stderr)
        return 1
    except ImportError as error:
        missing = str(error.name).partition(".")[0]
        if missing not in _WITHOUT:
            raise
        print(f"maglev-mj: requires {missing}, which cannot be imported{_WITHOUT[missing]}", file=sys.stderr)
        return 1


class _Terminal(io.FileIO):
    """Terminal that may close; what is written then is discarded, so that a flight lands and a job without it ends."""

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return len(data)


def _on_terminal(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    """Return a stream in place of one on a terminal, which may be closed already; others are returned unchanged."""
    try:
        if os.name != "posix" or not stat.S_ISCHR(os.fstat(stream.fileno()).st_mode):
            return stream
    except OSError:  # not a file
        return stream
    raw = _Terminal(stream.fileno(), "w", closefd=False)
    return io.TextIOWrapper(io.BufferedWriter(raw), stream.encoding, "replace", line_buffering=stream.line_buffering)


_WITHOUT = {
    "mujoco": "; without it, use `--plant exact` for scenes, `twin --plant exact` for devices",
    "multiprocessing": "; without it, use `--workers 0` for sweeps",
    "glfw": "",
}
"""Alternatives to modules that some systems lack, such as Python in a browser."""


def _run(options: argparse.Namespace) -> int:
    from maglev_mj.cli.output import check_outputs  # imported here: --help does not need it

    try:
        with _interruptible():
            check_outputs(options)
            status: int = options.run(options)
        return status
    except KeyboardInterrupt as stopped:
        return _stopped(options, str(stopped) or "stopped")
    except ParameterError as error:
        say(f"maglev-mj {options.command}: {_line_of(error)}{error}", sys.stderr)
        return 2
    except (MaglevError, OSError) as error:
        if isinstance(error, BrokenPipeError) and _is_unread(sys.stdout):
            raise
        text = printable(f"maglev-mj {options.command}: {_line(error)}")  # commands to copy stay on one line
        print(
            *(wrapped(text, "", "") if isinstance(error, PlantError) else [text]), sep="\n", file=sys.stderr, flush=True
        )
        _drop_unwritten()
        return 1
    except Exception as error:
        if not (line := _line_of(error)):
            raise
        say(f"maglev-mj {options.command}: {line}{type(error).__name__}: {error}", sys.stderr)
        return 2


def _line(error: Exception) -> str:
    """Return the message of an error; every file is named, so that a full disk without a name is standard output."""
    full = isinstance(error, OSError) and error.errno == errno.ENOSPC and error.filename is None
    return f"standard output: {error}" if full else str(error)


def _line_of(error: Exception) -> str:
    from maglev_mj.scenes.find import line_of  # imported here: --help does not need it

    line = line_of(error)
    return f"{line}: " if line else ""


@contextmanager
def _interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C during a command; outside it, Ctrl-C exits immediately.

    An inherited SIG_IGN is kept.
    """
    before, replaced = signal.getsignal(signal.SIGINT), False
    with suppress(ValueError):  # only the main thread receives signals
        if replaced := before not in (signal.SIG_IGN, None):
            signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        with suppress(ValueError):
            if replaced:
                signal.signal(signal.SIGINT, before)


def _stopped(options: argparse.Namespace, reason: str) -> int:
    print(f"maglev-mj {options.command}: {reason}", file=sys.stderr)
    return 130


def _is_unread(stream: TextIO) -> bool:
    """Return True if the reader of a pipe has closed it."""
    try:
        poll = select.poll()
        poll.register(stream, 0)
    except (AttributeError, TypeError, ValueError):  # no poll on this system, or no file
        return False
    return bool(poll.poll(0))


def _drop_unwritten() -> None:
    """Discard unwritten output, which the interpreter would retry at exit."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options of a command line; `command` is None without one. Import only that command."""
    words: Sequence[str] = joined(arguments)
    if (new := renewed(words)) is not None:
        print(note(words, new), file=sys.stderr)
        words = new
    words = in_full(words)
    if words and words[0] in COMMANDS:
        return _parsed(*words)
    program = program_parser()  # the first word is an option of the program, or invalid
    names = {*COMMANDS, *BUILT_IN}
    later = [index for index, word in enumerate(words) if word in names and words[0].startswith("-")]
    if later and not {*words[: later[0]]} & {*program._option_string_actions}:
        import shlex

        given, name, rest = words[: later[0]], words[later[0]], words[later[0] + 1 :]
        program.error(f"options must follow the command: maglev-mj {shlex.join([name, *rest, *given])}")
    options, unknown = program.parse_known_args(words)
    if options.command is not None:
        options = _parsed(*in_full(options.command))
    program.refuse(unknown)
    return options


def in_full(words: Sequence[str]) -> Sequence[str]:
    """Return a command line whose first word is a command: a scene's name is short for `run` and that name."""
    name = words[0] if words else "-"
    if name in BUILT_IN or (not (name in COMMANDS or name.startswith("-")) and name in scene_names()):
        return ["run", *words]
    return words


def _parsed(name: str, *words: str) -> argparse.Namespace:
    parser = command_parser(name, words)
    add_options(parser, name)
    options: argparse.Namespace = parser.parse_args(words)
    return options


def _typed(words: Sequence[str]) -> Parser | None:
    """Return the parser of an incomplete command line; None without a command."""
    words = in_full(words)
    if not words or words[0] not in COMMANDS:
        return None
    parser = command_parser(words[0], words[1:])
    with suppress(SystemExit):  # the scene's name is incomplete
        add_options(parser, words[0])
    return parser


_FIRST = "Virtual levitated haptic joystick; diagnose is for any axis that shakes."


def program_parser() -> Parser:
    """Return the parser of the program, whose help lists all commands."""
    parser = Parser(prog="maglev-mj", description=_FIRST)
    parser.add_argument("--version", action="version", version=f"maglev-mj {maglev_mj.__version__}")
    parser.epilog = (
        "maglev-mj COMMAND --help lists its options, with an example; --rate [Hz] sets --period [s]. "
        "help(maglev_mj) lists names. Figures: Salcudean & Vlaar (1997).\n"
        "Exit status: 0 success, 1 failed, 2 invalid input, 130 Ctrl-C, 141 closed pipe"
    )
    scenes = {name: CommandEntry(f"scene, short for run {name}", "") for name in BUILT_IN}
    command = parser.add_argument(
        "command", metavar="COMMAND", nargs=argparse.PARSER, choices={**COMMANDS, **scenes}, help=argparse.SUPPRESS
    )
    command.required = False
    for title, group in GROUPS.items():
        parser.add_argument_group(title, "\n".join(f"  {name:<16}{row.summary}" for name, row in group.items()))
    parser.add_argument_group("scenes, each short for run SCENE", "\n".join(wrapped(" ".join(BUILT_IN))))
    return parser


def command_parser(name: str, words: Sequence[str]) -> Parser:
    """Return the parser of a command for these words, before its options are added."""
    parser = Parser(prog=f"maglev-mj {name}", example=f"maglev-mj {name} {COMMANDS[name].example}", words=words)
    parser.set_defaults(command=name)
    return parser


def add_options(parser: Parser, name: str) -> None:
    """Import a command and add its options, and those of the scene named in the parser's words."""
    from maglev_mj.cli.declare import declare  # imported here: the list of commands does not need it
    from maglev_mj.views.window.backend import check_mujoco_gl

    try:
        check_mujoco_gl()  # before MuJoCo is imported, which would fail with a traceback
    except ParameterError as error:
        parser.error(str(error))
    module = import_module(f"maglev_mj.cli.{MODULES[name]}")  # imports only what this command needs
    declare(getattr(module, name), parser)
