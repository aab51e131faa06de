"""Pages that a browser opens from a file: a wall, friction and a braking pulse, without Python or a network."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).parent
"""Folder of the pages and of the scripts and styles that they share."""

NAMES = "wall", "friction", "pulse"
"""Names of the pages."""


def one_file(name: str) -> str:
    """Return a page as one file, with its scripts and styles inside and without links to the other pages.

    Args:
        name: Name of the page, of `NAMES`.
    """
    text = _text(f"{name}.html")
    text = re.sub(r"<nav.*?</nav>\n", "", text, flags=re.DOTALL)
    text = re.sub(r'<link rel="stylesheet" href="(.*?)">', lambda link: f"<style>\n{_text(link[1])}</style>", text)
    return re.sub(r'<script src="(.*?)">', lambda link: f"<script>\n{_text(link[1])}", text)


def _text(name: str) -> str:
    return (FOLDER / name).read_text("utf-8")
