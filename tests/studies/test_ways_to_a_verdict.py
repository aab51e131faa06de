"""The table of what enters each verdict is true: each effect is raised alone in each front end."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import compare, device_card, diagnose, hold, judge, param, stability
from maglev_mj.bridge.preflight import _critical_delay
from maglev_mj.control import Hold, Law, LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.interop.teleoperation import _limit
from maglev_mj.scenes.cell_verdicts import cell_verdicts
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.stability_check import marks, stability_warning
from maglev_mj.session.margin import margin
from maglev_mj.session.tour import Tour
from maglev_mj.studies.compare import sweep_laws
from maglev_mj.studies.stability_map import StabilityParameters
from maglev_mj.theory.boundary import boundary_of
from maglev_mj.theory.design import WallRequirements, design_wall
from maglev_mj.theory.loop_parameters import LoopParameters
from tests.studies.test_one_verdict import Notch, lagging
from tests.sweeps import further
from tests.theory.test_doubts import Play

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "stability.md"
YES, NO, NONE = "yes", "left out", "-"


def table() -> dict[tuple[str, str], str]:
    """Return the cells of the page's table by front end and effect."""
    part = PAGE.read_text("utf-8").split("## What enters each verdict")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in part.splitlines() if line.startswith("|")]
    head, _, *body = rows
    return {(row[0], effect): cell for row in body for effect, cell in zip(head[1:], row[1:], strict=True)}


TABLE = table()


class Across(Law):
    """Wall on z that leans on x, and is pushed by x."""

    def __init__(self, *, axes: str = "z", stiffness: float, damping: float) -> None:
        del axes
        self.stiffness, self.damping = stiffness, damping

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: list[Any]) -> Any:
        inside = position[2] < 0.0
        force = -(self.stiffness * position[2] + self.damping * velocity[2]) * inside
        wrench[2] = wrench[2] + force - 0.4 * self.stiffness * position[0] * inside
        wrench[0] = wrench[0] + 0.4 * self.stiffness * position[2] * inside
        return state, None


class Plain(Across):
    """The same without it."""

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: list[Any]) -> Any:
        force = -(self.stiffness * position[2] + self.damping * velocity[2]) * (position[2] < 0.0)
        wrench[2] = wrench[2] + force
        return state, None


class Case(Press):
    """Press with all effects that a scene may have."""

    own: str = param("law", default="pd", choices=("pd", "memory", "across", "plain", "play"))
    cutoff: float = param("cutoff of the velocity", "Hz", default=0.0)
    turning: float = param("stiffness of rx", "N m/rad", default=0.0)

    def laws(self) -> list[Any]:
        wall, *others = super().laws()
        gains: Any = {"stiffness": self.stiffness, "damping": self.damping}
        if self.turning:
            others = [hold(self, ["x", "y", "ry", "rz"]), Hold(axes="rx", stiffness=self.turning, damping=0.05)]
        if self.own == "memory":
            wall = Notch(axes="z", period=self.period, **gains)
        elif self.own != "pd":
            wall = {"across": Across, "plain": Plain, "play": Play}[self.own](axes="z", **gains)
        return [wall, *others]

    def velocity_estimator(self) -> Any:
        return LowPass(cutoff=self.cutoff) if self.cutoff else super().velocity_estimator()


GAINS: dict[str, Any] = {"stiffness": 60_000.0, "damping": 120.0}
SCENE: dict[str, Any] = {**GAINS, "pulse": 0.0, "hits": 1, "period": 1e-3, "delay": 8e-4}
LAWS = {"memory": Notch, "across": Across, "plain": Plain, "play": Play, "pd": "pd"}


def compared(scene: Case) -> float:
    base = scene.replace(own="pd")
    return compare(base, {"own": LAWS[scene.own]}, phases=1).margins["own"]["spectral_radius"]


def mapped(scene: Case) -> float:
    base = scene.replace(own="pd")
    found = sweep_laws(base, {"own": LAWS[scene.own]}, "damping", [scene.damping], figure="critical_stiffness")
    return float(found.figure("critical_stiffness")[0, 0])


def radii(scene: Case) -> Any:
    verdict = stability(scene)
    return math.nan if verdict.stable is None else sorted(loop.spectral_radius for loop in verdict.loops)


def cell(scene: Case) -> Any:
    (verdict,) = cell_verdicts([scene])
    assert marks([scene]) == [{True: "", False: "unstable"}.get(verdict.stable, f"stability {verdict}")]  # type: ignore[union-attr,arg-type]
    return math.nan if verdict.stable is None else sorted(loop.spectral_radius for loop in verdict.loops)  # type: ignore[union-attr]


def page(scene: Case) -> Any:
    found = margin(scene)
    return math.nan if found.stable is None else (found.words, found.loop)


def warned(scene: Case) -> Any:
    stiffer = scene.replace(stiffness=scene.stiffness * (1.0 if scene.device == "ubc" else 5.0))
    text = stability_warning(stiffer) or ""
    return math.nan if "may be unstable" in text else text


def diagnosed(scene: Case) -> float:
    try:
        return diagnose(scene).spectral_radius
    except ParameterError:  # no loop
        return math.nan


def toured(scene: Case) -> Any:
    """Return the delay up to which the tour's step is passed, relative to that of the scene."""
    if stability(scene).stable is None:
        return math.nan
    tour, low, high = object.__new__(Tour), 0.0, 4.0
    for _ in range(12):
        tour._stability = None
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tour._stable(scene.replace(delay=middle * scene.delay)) else (low, middle)
    return low


HELD: dict[str, Any] = {"device": "ubc", "stiffness": 6000.0, "damping": 80.0, "period": 5e-3, "delay": 3.2e-3}
"""Wall that is stable free and in the arm, and not in the stylus."""
PREFLIGHT = "preflight, changes in flight"


def flown(scene: Case) -> float:
    """Return the critical delay, in every published hand; of `HELD` the free one."""
    free = scene.hand == "arm" and scene.device == "ubc"
    return float(judge(scene, hand="none").critical_delay if free else _critical_delay(scene, scene.body.inertia))


SCENES: dict[str, Callable[[Case], Any]] = {
    "`stability SCENE`": radii,
    "`diagnose SCENE`": diagnosed,
    "warning of `run`": warned,
    "`sweep`": cell,
    "`compare`": compared,
    "`compare --map`": mapped,
    "page and window": page,
    PREFLIGHT: flown,
    "tour": toured,
}
EFFECTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "driver lag": ({}, {"lag": 1e-3}),
    "device law": ({}, {"device_damping": 60.0}),
    "its filter": ({"device_damping": 60.0}, {"device_damping": 60.0, "device_cutoff": 30.0}),
    "hand": (HELD, {**HELD, "hand": "stylus"}),
    "host filter": ({}, {"cutoff": 60.0}),
    "memory": ({"own": "plain"}, {"own": "memory"}),
    "coupling": ({"own": "plain"}, {"own": "across"}),
    "rotary": ({"turning": 1.0}, {"turning": 2000.0}),
    "not judged": ({}, {"own": "play"}),
}
SLOW = {("`diagnose SCENE`", "device law"), ("`diagnose SCENE`", "its filter"), ("tour", "device law")}
SLOW |= {("tour", effect) for effect in EFFECTS if effect != "driver lag"}
SLOW |= {
    (front, effect)
    for front in (PREFLIGHT, "`sweep`", "`compare`", "warning of `run`")
    for effect in ("memory", "coupling")
}
SLOW |= {("`diagnose SCENE`", effect) for effect in ("memory", "coupling")}
SLOW |= {(front, "its filter") for front in SCENES} | {("page and window", "device law")}
CELLS = [(front, effect) for front in SCENES for effect in EFFECTS]


@pytest.mark.parametrize(
    ("front", "effect"), [*(one for one in CELLS if one not in SLOW), *further(*(one for one in CELLS if one in SLOW))]
)
def test_an_effect_on_a_scene_enters_as_the_table_says(
    front: str, effect: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("maglev_mj.studies.compare._TICKS", 20)  # in less time
    base = SCENE | ({"stiffness": 20_000.0} if front == PREFLIGHT else {})
    each = [{"device": lagging(values.get("lag", 0.0), tmp_path), **base, **values} for values in EFFECTS[effect]]
    before, after = (
        SCENES[front](Case(**{name: value for name, value in one.items() if name != "lag"})) for one in each
    )
    if effect == "not judged":
        assert (isinstance(after, float) and math.isnan(after)) == (TABLE[front, effect] == YES)
    elif isinstance(before, list) and len(before) == len(after):
        assert np.allclose(before, after, rtol=0.0, atol=1e-9) == (TABLE[front, effect] == NO)
    elif isinstance(before, float):
        assert (before == pytest.approx(after, rel=1e-9)) == (TABLE[front, effect] == NO)
    else:
        assert (before == after) == (TABLE[front, effect] == NO)


NUMBERS: dict[str, Any] = {"period": 1e-3, "delay": 8e-4, "mass": 0.3}


def of_map(damping: float = 120.0, **values: Any) -> float:
    loop = StabilityParameters(**{**NUMBERS, **values}).loop()
    return float(boundary_of(loop.array(), np.asarray(damping)))


def of_design(**values: Any) -> float:
    own: dict[str, Any] = {**NUMBERS, **values}
    ranges = {name: (own[name],) * 2 for name in ("mass", "inertia", "delay") if own.get(name)}
    return float(design_wall(WallRequirements(**own | ranges)).stiffness)


def of_card(**values: Any) -> float:
    device = LoopParameters(**{name: value for name, value in values.items() if name != "hand"})
    walls = device_card(Press(**SCENE), device).walls  # of all hands
    return float(walls[0].stiffness) if "hand" not in values else float(walls[1].stiffness)


FRONTS: dict[str, Callable[..., float]] = {
    "`map`": of_map,
    "`diagnose`": lambda **values: diagnose(**{**NUMBERS, **GAINS, **values}).spectral_radius,
    "`design`": of_design,
    "`card`": of_card,
    "teleoperation": lambda driver_lag=0.0: _limit(1e-3, 8e-4, 0.3, driver_lag)[0],
}
STATED: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "driver lag": ({}, {"driver_lag": 1e-3}),
    "own damping": ({}, {"own_damping": 5.0}),
    "mode": ({}, {"mode": "120,0.05,0.3"}),
    "device law": ({}, {"device_damping": 60.0, "device_delay": 2e-4}),
    "its filter": (
        {"device_damping": 60.0, "device_delay": 2e-4},
        {"device_damping": 60.0, "device_delay": 2e-4, "device_cutoff": 60.0},
    ),
    "hand": ({}, {"hand": "arm"}),
    "host filter": ({}, {"cutoff": 60.0}),
    "rotary": ({}, {"mass": None, "inertia": 0.2}),
}
LONG = {("`diagnose`", "device law"), ("`diagnose`", "its filter"), ("`design`", "device law")}
LONG |= {("`design`", "its filter"), ("`card`", "device law"), ("`card`", "its filter"), ("`card`", "mode")}
STATES = [(front, effect) for front in FRONTS for effect in STATED]


@pytest.mark.parametrize(
    ("front", "effect"),
    [*(one for one in STATES if one not in LONG), *further(*(one for one in STATES if one in LONG))],
)
def test_an_effect_on_numbers_enters_as_the_table_says(front: str, effect: str) -> None:
    before, after = STATED[effect]
    if TABLE[front, effect] in (NONE, NO):
        with pytest.raises((ParameterError, TypeError), match=r"must be|unexpected"):
            FRONTS[front](**after)
    else:
        assert FRONTS[front](**before) != pytest.approx(FRONTS[front](**after), rel=1e-9)


def test_delays_above_ten_periods_have_a_verdict_where_the_table_says() -> None:
    late: Any = {**NUMBERS, "delay": 0.02}
    soft: Any = {"stiffness": 100.0, "damping": 8.0}
    scene = Case(**{**SCENE, **soft, "delay": 0.02})
    assert of_map(5.0, **late) > 0.0 and diagnose(**late, **soft).stable
    assert stability(scene).stable and margin(scene).stable
    assert _critical_delay(scene, scene.body.inertia) > 0.02
    for front in ("`map`", "`diagnose`", "`stability SCENE`", "page and window", PREFLIGHT):
        assert TABLE[front, "any delay"] == YES


def test_the_table_has_a_cell_for_each_front_end_and_effect() -> None:
    fronts = {front for front, _ in TABLE}
    assert fronts >= {*SCENES, *FRONTS} and {*EFFECTS, *STATED, "any delay"} == {effect for _, effect in TABLE}
    assert {*TABLE.values()} == {YES, NO, NONE} and len(AXES) == 6
    assert all(TABLE[front, effect] == NONE for front in SCENES for effect in STATED if effect not in EFFECTS)
