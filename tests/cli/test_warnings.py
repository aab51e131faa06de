"""One unstable wall in every command: each says so, in its text and its JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.cli import main
from maglev_mj.cli.peripherals import PageOptions
from maglev_mj.errors import ParameterError
from tests.all_of import COMMANDS

LOOP = ["--rate", "1000", "--delay", "0.0008", "--stiffness", "70000"]
GRID = ["--set", "period=0.001", "--set", "delay=0.0008", "--set", "damping=80", "--workers", "0"]
GRID += ["--record", "cells", "--vary"]
LINES = {
    "run, drop": ["drop", *LOOP],
    "run, press": ["press", *LOOP, "--hits", "1"],
    "run": ["run", "drop", *LOOP, "--plant", "exact", "--phases", "2"],
    "compare": ["compare", "drop", "--law", "pd", *LOOP, "--phases", "2"],
    "sweep": ["sweep", "drop", "--set", "plant=exact", *GRID, "stiffness=50000,70000"],
    "sweep, batch": ["sweep", "drop", "--set", "plant=exact", *GRID, "stiffness=50000:70000:8"],
    "sweep, wall": ["sweep", "wall", *GRID, "stiffness=50000,70000"],
    "stability": ["stability", "drop", *LOOP],
    "card": ["card", "drop", *LOOP],
    "fidelity": ["fidelity", "drop", *LOOP, "--phases", "1"],
    "view": ["view", "drop", *LOOP],
}
OTHERS = "render design twin bridge estop commission conform lessons replay analyse convert"
OTHERS += " diagnose map"  # which is the verdict
SLOW = {name: pytest.mark.study for name in ("card", "fidelity")}


def test_every_command_that_shows_a_wall_is_here() -> None:
    assert {name.partition(",")[0] for name in LINES} | set(OTHERS.split()) == set(COMMANDS)


@pytest.mark.parametrize("name", [pytest.param(name, marks=SLOW.get(name, ())) for name in LINES])
def test_an_unstable_wall_is_said(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(*_: Any) -> None:
        raise ParameterError("no page")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(PageOptions, "open", stopped)
    status = main(LINES[name])
    printed = capsys.readouterr()
    assert "unstable" in (printed.err if name == "view" else printed.out) and status == (2 if name == "view" else 0)
    assert all(len(line) <= 80 for line in (printed.out + printed.err).splitlines())
    if name != "view":
        assert main([*LINES[name], "--json", "-"]) == 0
        data = json.loads(capsys.readouterr().out)
        assert data.get("stable") is False or any("unstable" in text for text in data["warnings"])
