"""Text output on a terminal.

Control characters in text of files and other programs are escaped.
"""

from __future__ import annotations

import re
from textwrap import wrap
from typing import TextIO

WIDTH = 80
"""Largest number of columns in a table."""


def printable(text: str) -> str:
    """Return a text with its control characters escaped.

    Line ends are escaped too; a terminal would obey them.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text)


def say(line: str, file: TextIO | None = None) -> None:
    """Print one line, with control characters escaped.

    Args:
        line: The line.
        file: Output file; None for standard output.
    """
    print(printable(line), file=file, flush=True)


def wrapped(text: str, indent: str = "  ", further: str | None = None) -> list[str]:
    """Return a text as lines of at most 80 characters.

    A number stays on one line with its unit.

    Args:
        text: One paragraph.
        indent: Indentation of the first line.
        further: Indentation of the others; None for the same.
    """
    joined = re.sub(r"(?<=\d) (?=[^\W\d])", "\0", text)
    lines = wrap(
        joined,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent if further is None else further,
        break_long_words=False,  # a file's name
        break_on_hyphens=False,
    )
    return [line.replace("\0", " ") for line in lines]
