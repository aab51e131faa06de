"""Run the lessons, and store their outputs in them; or check the stored ones.

    python scripts/lessons/store_outputs.py
    python scripts/lessons/store_outputs.py --check

Sliders draw nothing in a file: their outputs are left out. The students' versions are run too before outputs are
stored, and nothing is if one stops with an error. A check fails where the code prints other text, or draws more or
fewer pictures; that students' versions need no name of a solution is held by tests/cli/test_lessons.py.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import sys
from math import isclose
from typing import Any

import nbformat
from nbclient import NotebookClient

from maglev_mj.cli.lessons import LESSONS, without_solutions

Notebook = dict[str, Any]
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


async def executed(notebook: Notebook, turns: asyncio.Semaphore) -> Notebook:
    """Return a notebook with the outputs of its cells, and with nothing of this machine."""
    made = nbformat.reads(json.dumps(notebook), as_version=4)
    async with turns:
        await NotebookClient(made, timeout=120, record_timing=False).async_execute()
    for cell in made.cells:
        if "remove-output" in cell.metadata.get("tags", ()):
            cell.outputs = []
    made.metadata.language_info = {"name": "python"}
    made.metadata.pop("widgets", None)  # sliders need a kernel
    return dict(json.loads(nbformat.writes(made)))


async def all_executed(notebooks: list[Notebook]) -> list[Notebook]:
    """Return notebooks with their outputs; as many run at a time as there are processors."""
    turns = asyncio.Semaphore(os.cpu_count() or 1)
    return await asyncio.gather(*(executed(one, turns) for one in notebooks))


def visible_outputs(notebook: Notebook) -> list[tuple[str, list[str]]]:
    """Return the text that each cell gives, and the kinds of its other outputs."""
    cells = [cell.get("outputs", []) for cell in notebook["cells"]]
    texts_of_cells = [[one.get("text") or one["data"].get("text/plain", "") for one in outputs] for outputs in cells]
    kinds = [[kind for one in outputs for kind in one.get("data", ())] for outputs in cells]
    return [("".join(map("".join, texts)), others) for texts, others in zip(texts_of_cells, kinds)]


def alike(stored: list[tuple[str, list[str]]], now: list[tuple[str, list[str]]]) -> bool:
    """Return True if two notebooks say the same: their numbers to a thousandth, or to 1e-9."""

    def numbers(text: str) -> list[float]:
        return [float(number) for number in NUMBER.findall(text)]

    return all(
        (NUMBER.sub("#", one), kinds) == (NUMBER.sub("#", other), others)
        and all(isclose(*pair, rel_tol=1e-3, abs_tol=1e-9) for pair in zip(numbers(one), numbers(other)))
        for (one, kinds), (other, others) in zip(stored, now, strict=True)
    )


def main() -> int:
    """Store or check the outputs of all lessons."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 if any output differs")
    check = parser.parse_args().check
    paths = sorted(LESSONS.glob("*.ipynb"))
    stored = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
    executed_notebooks = asyncio.run(all_executed(stored if check else [*stored, *map(without_solutions, stored)]))
    if not check:
        for path, now in zip(paths, executed_notebooks):
            path.write_text(json.dumps(now, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    changed = [
        path.name
        for path, before, now in zip(paths, stored, executed_notebooks)
        if not alike(visible_outputs(before), visible_outputs(now))
    ]
    other = f"other outputs than stored: {', '.join(changed)}; make lessons stores them"
    print(other if changed else f"{len(paths)} lessons, as stored")
    return int(check and bool(changed))


if __name__ == "__main__":
    sys.exit(main())
