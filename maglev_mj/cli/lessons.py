"""Command for the lessons, which are notebooks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

from maglev_mj.cli.declare import option
from maglev_mj.errors import ParameterError

_PACKAGE = Path(__file__).resolve().parent.parent
LESSONS = _PACKAGE / "lessons" if (_PACKAGE / "lessons").is_dir() else _PACKAGE.parent / "docs" / "lessons"
"""Folder of the notebooks.

It is inside the installed package, or with the documents of the repository.
"""

_PAGES = "https://github.com/maglev-mj/maglev_mj/blob/main/docs/"
_SOLUTION = re.compile(r"\n*<details>.*?</details>", re.DOTALL)


def lessons(
    out: Annotated[Path, option("folder to write to; it is made", "", "DIR")],
    *,
    students: Annotated[bool, option("without the solutions")] = False,
) -> int:
    """Write the lessons, notebooks for Jupyter, to a folder."""
    notebooks = sorted(LESSONS.glob("*.ipynb"))
    out.mkdir(parents=True, exist_ok=True)
    if taken := [path.name for path in notebooks if (out / path.name).exists()]:
        raise ParameterError(f"{out / taken[0]} is there already, and may hold your work; name another folder")
    for path in notebooks:
        notebook = json.loads(path.read_text(encoding="utf-8").replace("](../", f"]({_PAGES}"))
        made = without_solutions(notebook) if students else notebook
        (out / path.name).write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"  wrote {len(notebooks)} notebooks to {out}; next: jupyter lab {out}")
    return 0


def without_solutions(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return a notebook without solutions: an empty cell in place of each that computes one."""
    return notebook | {"cells": [_for_students(cell) for cell in notebook["cells"]]}


def _for_students(cell: dict[str, Any]) -> dict[str, Any]:
    if cell["cell_type"] == "markdown":
        return cell | {"source": _SOLUTION.sub("", "".join(cell["source"])).splitlines(keepends=True)}
    if "hide-cell" in cell["metadata"].get("tags", ()):
        return cell | {"source": ["# your own answer\n"], "metadata": {}, "outputs": [], "execution_count": None}
    return cell
