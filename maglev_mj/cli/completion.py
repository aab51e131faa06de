"""Shell completion of commands, options and values by argcomplete.

A shell asks at each key press. The options of a command are therefore kept in the user's cache folder, as long
as no file of this package changes: loading the libraries of the command takes four times as long.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import maglev_mj
from maglev_mj.cli.declare import Parser, offer
from maglev_mj.scenes.names import BUILT_IN, scene_names

_FILES = "FILE", "DIR", "PATH"
_KEPT = "dest", "nargs", "metavar", "choices", "help"
_NO_SCENE = r"-(?!-scene).*|[\d.]+(e-?\d+)?"
"""Pattern of an option or a number."""


def complete(parser: Parser) -> None:
    """Answer a shell's request for completions, and exit.

    Args:
        parser: Parser of all commands.
    """
    import argcomplete
    from argcomplete.lexers import split_line

    _, _, _, words, _ = split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))
    (commands,) = (one.choices for one in parser._actions if isinstance(one, argparse._SubParsersAction))
    parser.before = None
    if len(words) > 1 and words[1] in commands:
        with suppress(SystemExit):  # of a scene that is none
            _add_options(commands[words[1]], words[1], words[2:])
    values: Any = _values  # any callable will do
    argcomplete.autocomplete(parser, always_complete_options=False, default_completer=values)


def _values(prefix: str, action: argparse.Action, **_: Any) -> list[str]:
    """Return completions: offered values, files or scenes."""
    from argcomplete.completers import FilesCompleter

    if offered := getattr(action, "offered", ()):
        return [one for one in offered if one.startswith(prefix)]
    if action.metavar in _FILES:
        return list(FilesCompleter()(prefix))
    if action.metavar != "SCENE":
        return []
    names = [name for name in scene_names() if name.startswith(prefix)]
    return [*names, *FilesCompleter(["py"])(prefix)]


def _add_options(parser: Parser, command: str, arguments: Sequence[str]) -> None:
    """Add a command's options, from the cache if possible.

    The cache holds options of commands without a scene, or with a scene of this package
    as first argument.
    """
    scene = _scene_in(arguments)
    names = [command, f"{command} {scene}"] if scene else [command]
    code = _code()
    for kept in filter(None, map(_read, names)):
        if kept.get("code") == code and kept["scene"] in ("any", scene):
            _recall(parser, kept["actions"])
            return
    before, parser.before = parser.before, None
    assert before is not None
    before(arguments)
    depends = parser.before is not None
    parser.prepare(arguments)
    if not depends or scene is not None:
        kept = {"code": code, "scene": scene if depends else "any", "actions": _told(parser)}
        _write(names[-1] if depends else command, kept)


def _scene_in(arguments: Sequence[str]) -> str | None:
    """Return the scene among arguments; "" for none.

    None if only the command itself can decide.
    """
    if arguments and arguments[0] in BUILT_IN:
        return arguments[0]
    return "" if all(re.fullmatch(_NO_SCENE, one) for one in arguments) else None


def _told(parser: Parser) -> list[dict[str, Any]]:
    """Return a parser's arguments except help, ready for JSON."""
    told = []
    for one in parser._actions:
        if one.dest != "help":
            about = {name: getattr(one, name) for name in _KEPT}
            about["choices"] = one.choices and [*one.choices]
            told.append({**about, "options": one.option_strings, "offered": getattr(one, "offered", [])})
    return told


def _recall(parser: Parser, actions: Sequence[Mapping[str, Any]]) -> None:
    """Add arguments of the cache."""
    parser.before = None
    for told in actions:
        about = {name: value for name in _KEPT if (value := told[name]) is not None}
        if isinstance(about.get("metavar"), list):
            about["metavar"] = tuple(about["metavar"])
        if told["options"] and about.get("nargs") == 0:
            about = {"dest": about["dest"], "help": about.get("help"), "action": "store_true"}
        named = [about.pop("dest")] if not told["options"] else told["options"]
        offer(parser.add_argument(*named, **about), told["offered"])


def _code() -> str:
    """Return a text that changes with this package's files."""
    written = [
        os.stat(os.path.join(folder, name)).st_mtime_ns
        for folder, _, names in os.walk(os.path.dirname(maglev_mj.__file__))
        for name in names
        if name.endswith(".py")
    ]
    return f"{maglev_mj.__version__} {len(written)} {max(written)}"


def _path(name: str) -> str:
    """Return the cache file of a name.

    Raises:
        OSError: If there is no cache folder: a relative one would be another in each folder.
    """
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if not os.path.isabs(cache):
        raise FileNotFoundError(cache)
    return os.path.join(cache, "maglev-mj", "completion", f"{name}.json")


def _read(name: str) -> dict[str, Any] | None:
    """Return the cached entry of a name, or None."""
    with suppress(OSError, ValueError), open(_path(name), encoding="utf-8") as file:
        kept = json.load(file)
        return kept if isinstance(kept, dict) else None
    return None


def _write(name: str, kept: Mapping[str, Any]) -> None:
    """Write a cache entry atomically; ignore failures."""
    with suppress(OSError):
        path = _path(name)
        partial = f"{path}.{os.getpid()}"
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(partial, "w", encoding="utf-8") as file:
            json.dump(kept, file)
        os.replace(partial, path)
