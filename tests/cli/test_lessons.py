"""Form of the lessons; the documentation's build runs them and compares their outputs."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.cli.lessons import without_solutions
from maglev_mj.cli.program import main

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "lessons"
LESSONS = ["why_stiff_walls_buzz", "braking_pulse", "friction", "integrator_step", "model_to_device"]


def cells(name: str) -> list[dict[str, Any]]:
    """Return the cells of a lesson."""
    found: list[dict[str, Any]] = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    return [cell | {"source": "".join(cell["source"])} for cell in found]


def text(name: str) -> str:
    """Return the text of a lesson."""
    return "\n".join(cell["source"] for cell in cells(name) if cell["cell_type"] == "markdown")


@pytest.mark.parametrize("name", LESSONS)
def test_a_lesson_is_saved_with_its_outputs_and_nothing_of_a_machine(name: str) -> None:
    code = [cell for cell in cells(name) if cell["cell_type"] == "code"]
    assert len(code) > 10
    outputs = [output for cell in code for output in cell["outputs"]]
    kinds = {kind for output in outputs for kind in output.get("data", ())}
    assert "image/png" in kinds and any(output["output_type"] == "stream" for output in outputs)
    assert not any(output["output_type"] == "error" or output.get("name") == "stderr" for output in outputs)
    for cell in code:
        ast.parse(cell["source"])
        assert "execution" not in cell["metadata"]  # times
    whole = (FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")
    assert not re.search(r"(/home|/root|/work|/tmp|/Users|ipykernel|[A-Z]:\\\\)[/_\\\\]", whole)


@pytest.mark.parametrize("name", LESSONS)
def test_a_students_version_has_no_solution_(name: str) -> None:
    notebook = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    made = without_solutions(notebook)
    whole = json.dumps(made)
    assert "Solution" not in whole and "details>" not in whole and "**Question 1.**" in whole
    assert "What to remember" not in whole and whole.count("More: [") == json.dumps(notebook).count("More: [")
    changed = [after for before, after in zip(notebook["cells"], made["cells"], strict=True) if before != after]
    solved = [cell for cell in changed if cell["cell_type"] == "code"]
    assert len(solved) == sum("hide-cell" in cell["metadata"].get("tags", ()) for cell in notebook["cells"])
    assert all(cell["outputs"] == [] and cell["source"] == ["# your own answer\n"] for cell in solved)


def undefined_names(folder: Path) -> str:
    """Return what the linter says of names in the notebooks of a folder that no cell before defines."""
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--quiet", "--select", "F821,F823", str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def test_a_students_version_needs_no_name_of_a_solution(tmp_path: Path) -> None:
    for name in LESSONS:
        made = without_solutions(json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8")))
        (tmp_path / f"{name}.ipynb").write_text(json.dumps(made))
    assert undefined_names(tmp_path) == ""
    code = [cell for cell in made["cells"] if cell["cell_type"] == "code"]
    code[-1]["source"] = ["named_in_a_solution + 1\n"]
    (tmp_path / "other.ipynb").write_text(json.dumps(made))
    assert "named_in_a_solution" in undefined_names(tmp_path)


def test_lessons_are_written_to_a_folder_and_never_over_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "class"
    assert main(["lessons", str(folder), "--students"]) == 0
    assert f"jupyter lab {folder}" in " ".join(capsys.readouterr().out.split())
    assert sorted(path.stem for path in folder.glob("*.ipynb")) == sorted(LESSONS)
    link = "](https://github.com/maglev-mj/maglev_mj/blob/main/docs/explanation/stability.md)"
    mine = folder / "why_stiff_walls_buzz.ipynb"
    assert link in mine.read_text(encoding="utf-8") and "../" not in "".join(re.findall(r"\]\([^)]+", mine.read_text()))
    mine.write_text("my work")
    (folder / "braking_pulse.ipynb").unlink()
    assert main(["lessons", str(folder)]) == 2 and "choose another folder" in capsys.readouterr().err
    assert mine.read_text() == "my work" and not (folder / "braking_pulse.ipynb").exists()


@pytest.mark.parametrize("name", LESSONS)
def test_every_link_of_a_lesson_leads_somewhere(name: str) -> None:
    links = re.findall(r"\]\(([^)#\s]+)", text(name))
    assert len(links) >= 2
    for link in links:
        assert (FOLDER / link).exists(), f"{name}: {link}"
