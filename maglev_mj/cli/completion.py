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
    """Print the completions that a shell requests through argcomplete, and exit.

    Args:
        parser: Parser of the program; its last action is the command.
        command: Function that returns the parser of a command line with its options; None without a command.
    """
    start = int(os.environ["_ARGCOMPLETE"])  # number of words before the arguments
    _, _, _, words, _ = split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))
    commands: Any = parser._actions[-1]
    commands.completer = lambda **_: {name: row.summary for name, row in commands.choices.items()}
    if (selected := command(words[start:])) is not None:
        os.environ["_ARGCOMPLETE"] = str(start + 1)  # treat "maglev-mj COMMAND" as the program
        parser = selected
        for action in parser._actions:
            if action.help != argparse.SUPPRESS:
                action.help = help_of(action).replace("%", "%%")  # some shells show the help
    completer: Any = _values  # argcomplete annotates its own class, but takes any callable
    argcomplete.autocomplete(parser, always_complete_options=False, default_completer=completer)


def _values(prefix: str, action: argparse.Action, **_: Any) -> list[str]:
    """Return the choices, files or scenes that start with the prefix."""
    if offered := getattr(action, "offered", ()):
        return [value for value in offered if value.startswith(prefix)]
    if action.metavar in _FILES:
        return list(FilesCompleter()(prefix))
    if action.metavar != "SCENE":
        return []
    names = [name for name in scene_names() if name.startswith(prefix)]
    return [*names, *FilesCompleter(["py"])(prefix)]
