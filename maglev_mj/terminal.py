"""Text output on a terminal; control characters from files and other programs are escaped."""

from __future__ import annotations

import os
import re
import sys
from textwrap import wrap
from typing import TextIO

WIDTH = 80
"""Maximum width of a table in a file, a pipe or a notebook [characters]."""

_NARROWEST, _WIDEST = 60, 120


def width() -> int:
    """Return the maximum width of a table [characters]: that of the terminal, within 60 and 120, or 80 without one."""
    try:
        columns = os.get_terminal_size(sys.stdout.fileno()).columns
    except (AttributeError, OSError, ValueError):  # no terminal, or no file at all
        return WIDTH
    return min(max(columns, _NARROWEST), _WIDEST) if columns else WIDTH


def printable(text: str) -> str:
    """Escape the control characters of a text, line ends included."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def say(line: str, file: TextIO | None = None) -> None:
    """Print one line with control characters escaped.

    Args:
        line: The line.
        file: Output file; None for standard output.
    """
    print(printable(line), file=file, flush=True)


_WITHIN = re.compile(r"(?<=\d) (?=[^\W\d])|(?<=\bN) (?=s/|m\b)")


def wrapped(text: str, indent: str = "  ", further: str | None = None) -> list[str]:
    """Wrap a text to the width of a table, without separating a number from its unit.

    Args:
        text: One paragraph.
        indent: Indentation of the first line.
        further: Indentation of the other lines; None for the same.
    """
    lines = wrap(
        joined(text),
        width(),
        initial_indent=indent,
        subsequent_indent=indent if further is None else further,
        break_long_words=False,  # keep file names intact
        break_on_hyphens=False,
    )
    return [line.replace("\0", " ") for line in lines]


def joined(text: str) -> str:
    """Return a text with NUL in place of the spaces between a number and its unit, and inside the unit."""
    return _WITHIN.sub("\0", text)
