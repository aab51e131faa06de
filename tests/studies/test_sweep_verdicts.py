"""Cells of a sweep of a user's law are judged as those of a built-in one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from maglev_mj import param, stability
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import unstable
from maglev_mj.studies.sweep import sweep
from tests.theory.test_doubts import Damper, Fast, Floats, HuntCrossley, Lead, Plain, Play, Sticky, Windowed

LAWS = {law.__name__: law for law in (Plain, Floats, Lead, Sticky, HuntCrossley, Damper, Play, Fast)}
LOOP: dict[str, Any] = {"period": 1e-3, "delay": 8e-4, "damping": 80.0, "stiffness": 2e4, "duration": 0.02}


class Own(Drop):
    """Drop on a law."""

    law: str = param("law", default="Plain", choices=tuple(LAWS))

    def laws(self) -> list[Any]:
        wall = LAWS[self.law](axes="z", stiffness=self.stiffness, damping=self.damping)
        return [wall, *super().laws()[1:]]


@pytest.mark.parametrize("name", LAWS)
def test_cells_are_judged_as_single_scenes_are(name: str) -> None:
    scenes = [Own(law=name, **LOOP | {"stiffness": stiffness}) for stiffness in (6e4, 2e4)]
    scenes = scenes[:1] if name == "Floats" else scenes  # one call after another: slow
    found = unstable(scenes)
    for index in (0, 1) if name == "Plain" else (0,):
        stable = stability(scenes[index]).stable
        assert found[index] == (None if stable is None else not stable)


def test_cells_of_a_pd_wall_written_by_hand_are_marked_as_those_of_drop() -> None:
    random = np.random.default_rng(3)
    values = {"delay": [2e-4, 1.2e-3], "stiffness": [1e4, *(10.0 ** random.uniform(3.5, 5.0, 3)).tolist(), 9e4]}
    cells = [{"stiffness": k, "delay": late} for late in values["delay"] for k in values["stiffness"]]
    marks = ["unstable" in text for text in sweep(Own(**LOOP), values).columns()["warnings"]]
    assert marks == unstable([Drop(**LOOP | cell) for cell in cells]) and any(marks) and not all(marks)


def test_cells_that_are_not_judged_have_a_mark() -> None:
    found = sweep(Own(**LOOP), {"law": ["Plain", "Play"]})
    assert found.columns()["warnings"].tolist() == ["", "stability not computed"]
    assert "1 of 2 cells: stability not computed" in str(found)
    assert unstable([Windowed()]) == [None]


def test_cells_that_differ_in_stiffness_share_a_linearisation(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def counted(*arguments: Any, **keywords: Any) -> Any:
        asked.append(arguments)
        return stability(*arguments, **keywords)

    monkeypatch.setattr("maglev_mj.scenes.cell_verdicts.stability", counted)
    unstable([Own(height=height, **LOOP | {"stiffness": k}) for k in (1e4, 2e4, 3e4) for height in (3e-3, 4e-3)])
    assert len(asked) == 1
