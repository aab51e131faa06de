"""Command lines of earlier versions: each runs as its new line, which a note on standard error states."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

_OF_DROPS = "--height", "--pulse", "--pulse-width", "--force-limit", "--quantize"
"""Options that made a map one of drops."""

RENAMED: Sequence[tuple[str, str]] = (
    ("tour", "view --tour"),
    ("fault FILE", "analyse FILE --cycles"),
    ("fault", "analyse"),
    ("info --device X --header", "card X"),
    ("info --device X", "card X --table1"),
    ("info", "card --table1"),
    ("export FILE --to KIND --out OUT", "convert FILE OUT --to KIND"),
    ("export FILE --to KIND", "convert FILE FILE.KIND"),
    ("export", "convert"),
    ("import FILE --out OUT", "convert FILE OUT"),
    ("import FILE", "convert FILE FILE.maglev"),
    ("import", "convert"),
    ("stability --help", ""),
    ("stability -h", ""),
    ("stability --damping NUMBER --stiffness NUMBER", ""),
    *((f"stability --plant exact {name}", "map --of drops") for name in _OF_DROPS),
    *((f"stability {name}", "map --of drops") for name in _OF_DROPS),
    ("stability --plant none", "map"),
    ("stability --plant PLANT", "map --of PLANT"),
    ("stability", "map"),
)
"""Lines of version 0.3 and the new ones, which run in versions 0.4 and 0.5; the first that fits is taken.

A word in capitals stands for the value of the option before it, or for the positional argument; the new line may
repeat it, also with another suffix (FILE.csv); NUMBER stands for one number. An option with another value must have it,
and goes; one without a value must be there, and stays. All other options are appended; another positional argument
fits no line. A line whose new one is empty is not an old one.
"""

_SEVERAL = frozenset(("--damping", "--stiffness", "--columns", "--units", "--scale", "--face"))
"""Options of the old commands with several values."""

_FLAGS = frozenset(("-h", "--help", "--web", "--no-open", "--all", "--bare", "--header", "--resample"))
"""Options of the old commands without a value."""


class _Part(NamedTuple):
    """An option with its values, or a positional argument, whose option is ""; and all their words."""

    option: str
    values: list[str]
    words: list[str]


def renewed(words: Sequence[str]) -> list[str] | None:
    """Return the new line of an old one, both without the name of the program; None if the line is not an old one."""
    for old, new in RENAMED:
        command, *pattern = old.split()
        if list(words[:1]) == [command] and (fit := _fit(pattern, words[1:])) is not None:
            values, rest = fit
            return None if not new else [*(_filled(word, values) for word in new.split()), *rest]
    return None


def note(words: Sequence[str], new: Sequence[str]) -> str:
    """Return the note on an old line."""
    return f"maglev-mj: {words[0]} was renamed to: maglev-mj {shlex.join(new)}"


def _parts(words: Sequence[str]) -> list[_Part]:
    parts: list[_Part] = []
    for word in words:
        option, equals, value = word.partition("=")
        last = parts[-1] if parts else _Part("", [], [])
        if re.match(r"--?[a-z]", word):
            parts.append(_Part(option, [value] if equals else [], [word]))
        elif last.option and last.option not in _FLAGS and (not last.values or _is_further(last.option, word)):
            last.values.append(word)
            last.words.append(word)
        else:
            parts.append(_Part("", [word], [word]))
    return parts


def _is_further(option: str, word: str) -> bool:
    """Return True if a word is a further value of an option: a number, NAME=VALUE or AXIS:EDGE:SIDE, not a file."""
    return option in _SEVERAL and re.match(r"[-+.\d]|[^:]*=|\w+:[-.\d]", word) is not None


def _fit(pattern: Sequence[str], words: Sequence[str]) -> tuple[Mapping[str, str], list[str]] | None:
    """Return the values of the words in capitals, and all other words; None if the words do not fit."""
    parts, values = _parts(words), dict[str, str]()
    for wanted in _parts(pattern):
        part = next((part for part in parts if part.option == wanted.option), None)
        if part is None or not all(_stands_for(value, part.values) for value in wanted.values):
            return None
        for value in wanted.values:
            values[value] = part.values[0]
            parts.remove(part)
    if any(not part.option for part in parts):
        return None
    return values, [word for part in parts for word in part.words]


def _stands_for(wanted: str, values: Sequence[str]) -> bool:
    """Return True if a word of a pattern stands for the values of an option."""
    if wanted == "NUMBER":
        return len(values) == 1 and re.fullmatch(r"[-+.\deE]+", values[0]) is not None
    return bool(values) and (wanted.isupper() or [wanted] == list(values))


def _filled(word: str, values: Mapping[str, str]) -> str:
    """Return a word of a new line with the values of its capitals."""
    name, _, suffix = word.partition(".")
    if not suffix:
        return values.get(word, word)
    return str(Path(values[name]).with_suffix(f".{values.get(suffix, suffix)}"))
