"""Command that writes the lesson notebooks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

from maglev_mj.cli.declare import option
from maglev_mj.errors import ParameterError
from maglev_mj.files import write_text

_PACKAGE = Path(__file__).resolve().parent.parent
LESSONS = _PACKAGE / "lessons" if (_PACKAGE / "lessons").is_dir() else _PACKAGE.parent / "docs" / "lessons"
"""Folder of the notebooks: in the installed package, or docs/lessons in a clone."""

_REPOSITORY = "https://github.com/maglev-mj/maglev_mj/blob/main/"
_SOLUTION = re.compile(r"\n*<details>.*?</details>|## What to remember\n.*?\n(?=More:)", re.DOTALL)


def lessons(
    out: Annotated[Path, option("output folder; created if missing", "", "DIR")],
    *,
    students: Annotated[bool, option("notebooks without solutions")] = False,
) -> int:
    """Write the lessons to a folder as Jupyter notebooks."""
    notebooks = sorted(LESSONS.glob("*.ipynb"))
    out.mkdir(parents=True, exist_ok=True)
    if existing := [path.name for path in notebooks if (out / path.name).exists()]:
        raise ParameterError(f"{out / existing[0]} already exists and may contain your work; choose another folder")
    for path in notebooks:
        text = path.read_text(encoding="utf-8").replace("](../../", f"]({_REPOSITORY}")
        notebook = json.loads(text.replace("](../", f"]({_REPOSITORY}docs/"))
        content = without_solutions(notebook) if students else notebook
        write_text(out / path.name, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    print(f"  wrote {len(notebooks)} notebooks to {out}; next: jupyter lab {out}")
    return 0


def without_solutions(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return a notebook without solutions, and without conclusions, which answer the questions.

    Cells of solutions are emptied.
    """
    return notebook | {"cells": [_for_students(cell) for cell in notebook["cells"]]}


def _for_students(cell: dict[str, Any]) -> dict[str, Any]:
    if cell["cell_type"] == "markdown":
        return cell | {"source": _SOLUTION.sub("", "".join(cell["source"])).splitlines(keepends=True)}
    if "hide-cell" in cell["metadata"].get("tags", ()):
        return cell | {"source": ["# your own answer\n"], "metadata": {}, "outputs": [], "execution_count": None}
    return cell
