"""Completion of commands, options and their values in a shell, by argcomplete where it is installed."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from typing import Any

from maglev_mj.cli.arguments import Parser
from maglev_mj.scenes.find import scene_names

__all__ = ["complete"]

_FILES = "FILE", "DIR", "PATH"


def complete(parser: Parser) -> None:
    """Answer a shell that asks for completions, and end; return at once where none asks.

    Args:
        parser: Of all commands.
    """
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete
    from argcomplete.lexers import split_line

    _, _, _, words, _ = split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))
    with suppress(SystemExit):  # of a scene that is none
        parser.prepare(words[1:])
    values: Any = _values  # any callable will do
    argcomplete.autocomplete(parser, always_complete_options=False, default_completer=values)


def _values(prefix: str, action: argparse.Action, **_: Any) -> list[str]:
    """Return files and scenes where they are asked for; nothing for a number."""
    from argcomplete.completers import FilesCompleter

    if action.metavar in _FILES:
        return list(FilesCompleter()(prefix))
    if action.metavar != "SCENE":
        return []
    names = [name for name in scene_names() if name.startswith(prefix)]
    return [*names, *FilesCompleter(["py"])(prefix)]
