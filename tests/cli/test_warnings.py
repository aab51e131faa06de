"""One unstable wall in every command: each says so, in its text and its JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.cli import main
from maglev_mj.cli.peripherals import PageOptions
from maglev_mj.errors import ParameterError
from maglev_mj.studies.stability_map import StabilityParameters, single_wall
from maglev_mj.theory import spectral_radius
from tests.all_of import COMMANDS

LOOP = ["--rate", "1000", "--delay", "0.0008", "--stiffness", "70000"]
GRID = ["--set", "period=0.001", "--set", "delay=0.0008", "--set", "damping=80", "--workers", "0"]
GRID += ["--record", "cells", "--vary"]
LINES = {
    "drop": ["drop", *LOOP],
    "press": ["press", *LOOP, "--hits", "1"],
    "run": ["run", "drop", *LOOP, "--plant", "exact", "--phases", "2"],
    "compare": ["compare", "drop", "--law", "pd", *LOOP, "--phases", "2"],
    "sweep": ["sweep", "drop", "--set", "plant=exact", *GRID, "stiffness=50000,70000"],
    "sweep, batch": ["sweep", "drop", "--set", "plant=exact", *GRID, "stiffness=50000:70000:8"],
    "sweep, wall": ["sweep", "wall", *GRID, "stiffness=50000,70000"],
    "stability": ["stability", *LOOP, "--damping", "80"],
    "stability, drops": ["stability", *LOOP, "--damping", "80", "--height", "0.001"],
    "stability, scene": ["stability", "drop", *LOOP],
    "card": ["card", "drop", *LOOP],
    "fidelity": ["fidelity", "drop", *LOOP, "--phases", "1"],
    "view": ["view", "drop", *LOOP],
}
OTHERS = "tour render stick-slip design twin bridge info estop commission conform lessons fault replay analyse export"
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


@pytest.mark.parametrize(
    ("wall", "ends"),
    [
        ((60_000.0, 80.0, 1e-3, 8e-4, "none"), 5),
        ((6_000.0, 80.0, 5e-3, 1.5e-3, "arm"), 5),
        ((500.0, 0.0, 5e-3, 0.0, "none"), 2),
    ],
)
def test_the_margins_of_one_wall_are_those_of_its_loop(wall: Any, ends: int) -> None:
    stiffness, damping, period, delay, hand = wall
    p = StabilityParameters(period=period, delay=delay, hand=hand)
    found = single_wall(p, stiffness, damping)
    assert found.stable == (spectral_radius(stiffness, damping, **p.loop) < 1.0)
    limits = [(name, end) for name, pair in found.ranges.items() for end in pair or () if math.isfinite(end)]
    for name, end in limits:
        present = {"stiffness": stiffness, "damping": damping, "delay": delay, "rate": 1.0 / period}
        k, b, late, rate = (present | {name: end}).values()
        loop: Any = {**p.loop, "delay": late, "period": 1.0 / rate}
        assert spectral_radius(k, b, **loop) == pytest.approx(1.0, abs=1e-6)
    assert len(limits) == ends
