"""Form of the lessons; the documentation runs them."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "lessons"
LESSONS = ["why_stiff_walls_buzz", "braking_pulse", "friction", "integrator_step", "model_to_device"]
MOST_LINES = 16


def cells(name: str) -> list[dict[str, Any]]:
    """Return the cells of a lesson."""
    found: list[dict[str, Any]] = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    return [cell | {"source": "".join(cell["source"])} for cell in found]


def text(name: str) -> str:
    """Return the text of a lesson."""
    return "\n".join(cell["source"] for cell in cells(name) if cell["cell_type"] == "markdown")


def test_every_lesson_is_here() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.ipynb")) == sorted(LESSONS)


@pytest.mark.parametrize("name", LESSONS)
def test_a_lesson_is_saved_without_outputs(name: str) -> None:
    code = [cell for cell in cells(name) if cell["cell_type"] == "code"]
    assert len(code) > 10
    for cell in code:
        assert cell["outputs"] == [] and cell["execution_count"] is None
        assert 0 < len(cell["source"].splitlines()) <= MOST_LINES
        ast.parse(cell["source"])


@pytest.mark.parametrize("name", LESSONS)
def test_a_lesson_begins_with_its_goals_and_ends_with_what_to_remember(name: str) -> None:
    first, *_, last = cells(name)
    assert all(word in first["source"] for word in ("# ", "**Goals.**", "**Time.**", "**You need**", ".[lessons]"))
    assert last["source"].startswith("## What to remember") and "../explanation/" in last["source"]


@pytest.mark.parametrize("name", LESSONS)
def test_each_question_has_a_solution_that_is_collapsed_and_computed(name: str) -> None:
    count = len(re.findall(r"^## \d", text(name), re.MULTILINE))
    numbers = [str(number) for number in range(1, count + 1)]
    assert 4 <= count <= 6
    assert re.findall(r"\*\*Question (\d)\.\*\*", text(name)) == numbers
    assert re.findall(r"<details>\n<summary>Solution (\d)</summary>\n\n", text(name)) == numbers
    assert text(name).count("</details>") == count
    hidden = [cell for cell in cells(name) if "hide-cell" in cell["metadata"].get("tags", ())]
    assert len(hidden) == count
    for cell in hidden:  # in Jupyter too, and each holds the solution's claims against what it computes
        assert cell["metadata"]["jupyter"]["source_hidden"] is True
        assert "assert " in cell["source"] and "print(" in cell["source"]


@pytest.mark.parametrize("name", LESSONS)
def test_every_link_of_a_lesson_leads_somewhere(name: str) -> None:
    links = re.findall(r"\]\(([^)#\s]+)", text(name))
    assert len(links) >= 2
    for link in links:
        assert (FOLDER / link).exists(), f"{name}: {link}"


@pytest.mark.parametrize("name", LESSONS)
def test_a_slider_computes_where_it_is_released_and_not_on_its_way(name: str) -> None:
    code = [cell["source"] for cell in cells(name) if cell["cell_type"] == "code"]
    for source in code:
        if re.search(r"^@?interact\(", source, re.MULTILINE):
            assert not re.search(r"=\(", source)  # a range alone is a slider that computes all the way
            assert "slide = partial(FloatSlider, continuous_update=False)" in "\n".join(code)
