"""Shell completion of commands, options and values by argcomplete."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from typing import Any

import argcomplete
from argcomplete.completers import FilesCompleter
from argcomplete.lexers import split_line

from maglev_mj.cli.declare import Parser
from maglev_mj.scenes.names import scene_names

_FILES = "FILE", "DIR", "PATH"


def complete(parser: Parser) -> None:
    """Answer a shell's request for completions, and exit.

    Args:
        parser: Parser of all commands; the options of the typed command and scene are added to it first.
    """
    _, _, _, words, _ = split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))
    with suppress(SystemExit):  # the scene's name is incomplete
        parser.prepare(words[1:])
    parser.before = None
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
