"""Lines on a terminal: what a file or another program says must not steer it."""

from __future__ import annotations

from typing import TextIO

__all__ = ["printable", "say"]


def printable(text: str) -> str:
    """Return a text with its control characters escaped, line ends too; a terminal would obey them."""
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text)


def say(line: str, file: TextIO | None = None) -> None:
    """Print one line, whatever is in it.

    Args:
        line: What to print.
        file: Where to; None for standard output.
    """
    print(printable(line), file=file, flush=True)
