"""Cells of a sweep of a user's law are judged as those of a built-in one."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from maglev_mj import AxisLaw, gain, hold, param, stability
from maglev_mj.frames import AXES
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import marks as cell_marks
from maglev_mj.studies.sweep import sweep
from maglev_mj.theory.read import probed_at
from tests.cells import unstable
from tests.sweeps import further
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
    scenes = scenes if name == "Plain" else scenes[:1]
    found = unstable(scenes)
    for scene, mark in zip(scenes, found, strict=True):
        stable = stability(scene).stable
        assert mark == (None if stable is None else not stable)


def test_cells_of_a_pd_wall_written_by_hand_are_marked_as_those_of_drop() -> None:
    random = np.random.default_rng(3)
    values = {"delay": [2e-4, 1.2e-3], "stiffness": [1e4, *(10.0 ** random.uniform(3.5, 5.0, 1)).tolist(), 9e4]}
    cells = [{"stiffness": k, "delay": late} for late in values["delay"] for k in values["stiffness"]]
    marks = ["unstable" in text for text in sweep(Own(**LOOP), values).columns()["warnings"]]
    assert marks == unstable([Drop(**LOOP | cell) for cell in cells]) and any(marks) and not all(marks)


def test_cells_that_are_not_judged_have_a_mark_with_the_reason() -> None:
    found = sweep(Own(**LOOP), {"law": ["Plain", "Play"]})
    reason = "stability not computed on z: the force at rest depends on the way there (hysteresis)"
    assert found.columns()["warnings"].tolist() == ["", reason]
    assert f"1 of 2 cells: {reason}" in str(found).replace("\n    ", " ")
    assert unstable([Windowed()]) == [None]


class Stiffer(AxisLaw):
    """Wall that is stiffer from a place on, by any function of the position."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")
    more: float = gain("stiffness", "N/m")
    place: float = gain("position", "m", at_least=-1.0)
    side: float = gain("side", "", at_least=-1.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        further = gains.side * (x - gains.place)
        wall = -gains.stiffness * x * (x < 0.0) - gains.damping * v
        return wall - gains.side * gains.more * further * (further > 0.0)


class Function(Stiffer):
    """The same as a law of all axes."""

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
        return super().__call__(position, velocity, state, wrench)


PLACES: dict[str, tuple[str, float, float]] = {
    "at the end of the range": ("z", -4.3e-3, -1.0),
    "at the start": ("z", 2.9e-3, 1.0),
    "in the wall": ("z", -1e-3, -1.0),
    "in a rotation": ("rx", 0.05, 1.0),
    "on another axis": ("y", 3e-3, 1.0),
}


class Somewhere(Drop):
    """Drop on it."""

    where: str = param("place", default=next(iter(PLACES)), choices=tuple(PLACES))
    more: float = param("stiffness there", "N/m", default=0.0)
    alone: bool = param("as a law of each axis", default=True)

    def laws(self) -> list[Any]:
        axis, place, side = PLACES[self.where]
        turns = 1e-3 if axis.startswith("r") else 1.0  # N m/rad
        gains: Any = {"stiffness": turns * self.stiffness, "damping": turns * self.damping, "more": turns * self.more}
        law = (Stiffer if self.alone else Function)(axes=axis, place=place, side=side, **gains)
        return [law, hold(self, [one for one in AXES if one != axis])]


@pytest.mark.parametrize(("seed", "where"), [*enumerate(PLACES), *further(*product(range(5, 25), PLACES))])
def test_the_mark_of_a_cell_is_the_verdict_of_stability(seed: int, where: str) -> None:
    random = np.random.default_rng(seed)
    values: Any = {**LOOP, "where": where, "alone": bool(seed % 2), "delay": random.uniform(0.0, 1e-3)}
    values |= {"stiffness": 10.0 ** random.uniform(3.3, 3.9), "duration": 0.01}
    soft, stiff = 10.0 ** random.uniform(2.0, 3.0), 10.0 ** random.uniform(5.5, 6.5)
    found = sweep(Somewhere(**values), {"more": [soft, stiff]}, plant="exact").columns()  # in one batch
    marks = [text.split(", ")[0] for text in found.get("warnings", np.array(["", ""]))]
    for more, mark in zip((soft, stiff), marks, strict=True):
        verdict = stability(Somewhere(**values, more=more))
        assert mark == {True: "", False: "unstable", None: f"stability {verdict}"}[verdict.stable]
    assert marks == ["", "unstable"]


def test_a_cell_that_fails_is_marked_as_stability_fails_and_no_other_cell_is() -> None:
    class Failing(Own):
        def laws(self) -> list[Any]:
            if self.stiffness > 2e4:
                raise ZeroDivisionError("at this stiffness")
            return super().laws()

    scenes = [Failing(**LOOP), Failing(**LOOP | {"stiffness": 3e4})]
    assert cell_marks(scenes) == ["", "stability not computed: ZeroDivisionError('at this stiffness')"]


def test_cells_that_differ_in_gains_alone_are_linearised_together(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def counted(controllers: Any, **keywords: Any) -> Any:
        asked.append(len(controllers))
        return probed_at(controllers, **keywords)

    monkeypatch.setattr("maglev_mj.scenes.cell_verdicts.probed_at", counted)
    unstable([Own(height=height, **LOOP | {"stiffness": k}) for k in (1e4, 2e4, 3e4) for height in (3e-3, 4e-3)])
    assert asked == [3, 3]  # of each start
