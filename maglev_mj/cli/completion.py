"""Shell completion of commands, options and values by argcomplete."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from typing import Any

import argcomplete
from argcomplete.completers import FilesCompleter
from argcomplete.lexers import split_line

from maglev_mj.cli.declare import Parser, help_of
from maglev_mj.scenes.names import scene_names

_FILES = "FILE", "DIR", "PATH"


def complete(parser: Parser, command: Callable[[Sequence[str]], Parser | None]) -> None:
    """Answer a shell's request for completions of commands, or of a command's options and scene, and exit.

    Args:
        parser: Parser of the program; the choices of its last action are the commands.
        command: Function that returns the parser of a command line, with its options; None without a command.
    """
    start = int(os.environ["_ARGCOMPLETE"])  # number of words of the program
    _, _, _, words, _ = split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))
    commands: Any = parser._actions[-1]
    commands.completer = lambda **_: {name: one.summary for name, one in commands.choices.items()}
    if (typed := command(words[start:])) is not None:
        os.environ["_ARGCOMPLETE"] = str(start + 1)  # the command is the program whose arguments are completed
        parser = typed
        for action in parser._actions:
            if action.help != argparse.SUPPRESS:
                action.help = help_of(action).replace("%", "%%")  # which some shells show
    completer: Any = _values  # typed as argcomplete's own class; any callable will do
    argcomplete.autocomplete(parser, always_complete_options=False, default_completer=completer)


def _values(prefix: str, action: argparse.Action, **_: Any) -> list[str]:
    """Return completions: offered values, files or scenes."""
    if offered := getattr(action, "offered", ()):
        return [value for value in offered if value.startswith(prefix)]
    if action.metavar in _FILES:
        return list(FilesCompleter()(prefix))
    if action.metavar != "SCENE":
        return []
    names = [name for name in scene_names() if name.startswith(prefix)]
    return [*names, *FilesCompleter(["py"])(prefix)]
