"""Ranges and remedies of a loop: the same from a verdict and a diagnosis, searched from the present value outward."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maglev_mj import ParameterError, Wall, diagnose, judge, param
from maglev_mj.control import LowPass
from maglev_mj.frames import AXES
from maglev_mj.plants.hand import get_hand, get_mode
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Corner
from maglev_mj.studies.diagnosed_loops import DiagnosedLoop
from maglev_mj.theory import DeviceLaw
from maglev_mj.theory.loop import Bound, Loop, StableRange
from maglev_mj.theory.remedies import MOST_DAMPING, _nearest, critical_of
from maglev_mj.theory.verdict import nearest
from tests.studies.test_recorded_loops import random_loop
from tests.sweeps import further

SHARED = (
    *("stable", "spectral_radius", "frequency", "doubling_time", "ratio", "damping_range", "rate_range"),
    *("rate_in_periods", "stable_delays"),
)


def loop_of(values: dict[str, Any]) -> Loop:
    """Return the loop of keywords of `diagnose`."""
    own = {name: value for name, value in values.items() if name in ("stiffness", "damping", "period", "delay")}
    own |= {name: values[name] for name in ("driver_lag", "own_damping") if name in values}
    rotary = "inertia" in values
    own |= {"inertia": values["inertia" if rotary else "mass"], "axis": "rx" if rotary else "z"}
    hand = get_hand(values.get("hand"))
    if hand is not None and rotary:
        hand = replace(hand, axes=AXES[3:])
    own |= {"hand": hand, "mode": get_mode(values.get("mode"))}
    own["velocity"] = LowPass(cutoff=values["cutoff"]) if "cutoff" in values else None
    law = {name.removeprefix("device_"): values[name] for name in values if name.startswith("device_")}
    return Loop(**own, device=DeviceLaw(**law) if law else None)


def equal(one: Any, other: Any) -> bool:
    """Return True for equal figures, nested ones too."""
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(equal, one, other))
    if isinstance(one, float):
        return bool(one == pytest.approx(float(other), rel=1e-9, abs=1e-12, nan_ok=True))
    return bool(one == other)


def drawn(seed: int, least: int) -> dict[str, Any]:
    """Return values of a random loop; of two rates, which takes seconds, from a seed on."""
    values = random_loop(np.random.default_rng(seed))
    return {name: value for name, value in values.items() if seed >= least or not name.startswith("device_")}


@pytest.mark.parametrize("seed", [*range(10), *further(*range(10, 100))])
def test_a_verdict_and_a_diagnosis_have_equal_figures(seed: int) -> None:
    values = drawn(seed, 10)
    verdict, found = judge(loop_of(values)), diagnose(**values)
    for name in SHARED:
        assert equal(getattr(verdict, name), getattr(found, name)), name
    beside = values.get("device_stiffness", 0.0)
    assert equal(float(verdict.critical_stiffness) - beside, float(found.critical_stiffness))
    assert equal(float(verdict.critical_delay), float(found.critical_delay))
    assert verdict.critical_delay.beyond == found.critical_delay.beyond


@pytest.mark.parametrize("seed", [*range(2), *further(*range(2, 60))])
def test_a_verdict_and_a_diagnosis_have_equal_remedies(seed: int) -> None:
    values = drawn(seed, 10)
    ours, theirs = judge(loop_of(values)).remedies(), diagnose(**values).remedies
    assert [(one.words, one.cost, one.change) for one in ours] == [(one.words, one.cost, one.change) for one in theirs]
    assert equal(tuple(one.ratio for one in ours), tuple(one.ratio for one in theirs))


@pytest.mark.parametrize("stiffness", [3e4, 4e5])
def test_a_wall_on_the_device_alone_is_judged_as_it_is_diagnosed(stiffness: float) -> None:
    values: dict[str, Any] = {"stiffness": 0.0, "damping": 0.0, "period": 5e-3, "delay": 1.5e-3, "mass": 0.7}
    values |= {"device_stiffness": stiffness, "device_damping": 200.0}
    verdict, found = judge(loop_of(values)), diagnose(**values)
    for name in (*SHARED, "critical_stiffness"):
        assert equal(getattr(verdict, name), getattr(found, name)), name
    assert found.critical_stiffness == pytest.approx(211_773.8, rel=1e-6)
    assert [one.words for one in verdict.remedies(8.0)] == [
        one.words for one in diagnose(**values, target=8.0).remedies
    ]


def test_a_verdict_without_stiffness_or_of_coupled_axes_has_no_ranges() -> None:
    free = judge(period=1e-3, delay=0.0, inertia=0.7, stiffness=0.0, damping=5.0)
    assert free.frequency == 0.0 and free.doubling_time < 0.0 and not free.remedies()
    for name in ("damping_range", "rate_range", "rate_in_periods"):
        assert getattr(free, name).text("Hz") == "-" and getattr(free, name).as_json() != [None, None]
    assert np.isnan(free.critical_gain) and np.isnan(free.best.stiffness) and not free.stable_delays.intervals


def test_the_largest_damping_of_a_remedy_is_that_of_the_options() -> None:
    bounds = {item.name: item.bounds for item in DiagnosedLoop.parameters() if item.name.endswith("damping")}
    assert len(bounds) == 3 and all(bound["at_most"] == MOST_DAMPING for bound in bounds.values())


@pytest.mark.parametrize("seed", range(60))
def test_a_range_is_that_of_a_search_of_all_values(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.theory.remedies._VALUES_AT_ONCE", 2)
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 200))
    values = np.cumsum(random.uniform(0.5, 1.5, count))
    flips = random.random(count) < random.choice([0.01, 0.1, 0.5])
    rare = random.random(count) < 0.04
    good = rare if seed % 2 else np.logical_xor.accumulate(flips) ^ bool(random.integers(2))
    present, asked = float(random.uniform(values[0], values[-1])), list[float]()

    def stable(some: Any) -> Any:
        asked.extend(np.ravel(some))
        return good[np.searchsorted(values, some)]  # between two values: as at the upper one

    found = _nearest(stable, values, present, refine=False)
    places = np.flatnonzero(good)
    if not len(places):
        assert found is None
        return
    middle = int(np.searchsorted(values, present))
    nearest = places[np.abs(places - middle).argmin()]
    runs = np.split(places, 1 + np.flatnonzero(np.diff(places) > 1))
    (run,) = (run for run in runs if nearest in run)
    assert found is not None
    lower, upper = found
    assert found == (values[run[0]], values[run[-1]])
    assert (lower.beyond, upper.beyond) == (run[0] == 0, run[-1] == count - 1)
    assert len(asked) == len({*asked})  # none twice


def test_a_range_says_where_its_search_ended() -> None:
    inside, end = Bound(30.0), Bound(2000.0, True)
    texts = {
        StableRange(inside, Bound(300.0)): ("30 to 300 Hz", [30.0, 300.0]),
        StableRange(inside, end): ("from 30 Hz (searched to 2000 Hz)", [30.0, {"more_than": 2000.0}]),
        StableRange(Bound(10.0, True), inside): ("up to 30 Hz (searched from 10 Hz)", [{"less_than": 10.0}, 30.0]),
        StableRange(Bound(10.0, True), end): (
            "no limit found from 10 to 2000 Hz",
            [{"less_than": 10.0}, {"more_than": 2000.0}],
        ),
        StableRange(Bound(0.0), inside): ("up to 30 Hz", [0.0, 30.0]),
    }
    for found, (text, data) in texts.items():
        assert found.text("Hz") == text and found.as_json() == data


# scenes


class TwoWalls(Drop):
    """Drop on a wall, beside another wall on the host along x."""

    stiff_beside: float = param("stiffness of the wall along x", "N/m", default=1000.0)
    drag: float = param("its damping", "N s/m", default=50.0)

    def laws(self) -> list[Any]:
        return [*super().laws(), Wall(axes="x", lower=1e-3, stiffness=self.stiff_beside, damping=self.drag)]


def walls_of(seed: int) -> Drop | Corner:
    """Return a random scene with walls on the host or the device, and a hold of the other axes."""
    random = np.random.default_rng(seed)
    values: dict[str, Any] = {"stiffness": 10.0 ** random.uniform(3.2, 5.3), "damping": random.uniform(10.0, 300.0)}
    values |= {"wall_on": str(random.choice(["host", "device"])), "delay": random.uniform(1e-4, 4e-3)}
    kind: Any = random.choice([Drop, TwoWalls, Corner])  # type: ignore[arg-type]
    if kind is TwoWalls:
        values |= {"stiff_beside": 10.0 ** random.uniform(3.2, 4.7), "drag": random.uniform(10.0, 300.0)}
    made: Drop | Corner = kind(**values)
    return made


@pytest.mark.parametrize("seed", [*range(16), *further(*range(16, 150))])
def test_a_scene_is_diagnosed_on_the_loop_that_stability_names(seed: int) -> None:
    scene = walls_of(seed)
    verdict, found = judge(scene), diagnose(scene)
    assert found.stable is verdict.stable
    loop, _ = verdict.marginal
    assert loop is not None and loop.in_question.array().shape == ()
    assert any(f"axis {loop.axis} of " in text for text in found.assumptions)
    if not verdict.stable:
        assert verdict.axes == (loop.axis,) and verdict.acting == loop.state
        assert found.spectral_radius == pytest.approx(verdict.spectral_radius, abs=1e-9)
        return
    others = [one for one in verdict.loops if one.total[0] > 0.0]
    ratios = [float(critical_of(one)) / one.in_question.stiffness for one in dict.fromkeys(others)]
    assert found.ratio == pytest.approx(min(ratios), rel=1e-6)


def test_of_two_unstable_walls_the_less_stable_one_is_diagnosed() -> None:
    # no wall along x is stable with its damping, but the one along z grows faster
    scene = TwoWalls(stiffness=40_000.0, damping=80.0, stiff_beside=1000.0, drag=260.0)
    verdict, found = judge(scene), diagnose(scene)
    assert verdict.axes == ("z",) and not judge(scene, stiffness=1000.0).stable
    assert nearest(verdict.loops).axis == "x" and "axis z of " in " ".join(found.assumptions)
    assert diagnose(scene, on_axis="x").critical_stiffness == 0.0


def test_an_axis_that_is_asked_for_is_diagnosed() -> None:
    scene = Drop(wall_on="device")
    assert diagnose(scene).loop.whole.on_host  # the hold is nearer to its boundary
    wall = diagnose(scene, on_axis="z")
    assert not wall.loop.whole.on_host and wall.loop.device_stiffness == scene.stiffness
    assert "axis x of drop" in " ".join(diagnose("drop", stiffness=2e4, on_axis="x").assumptions)
    for wrong, says in (({"on_axis": "w"}, "on_axis must be one of"), ({"on_axis": "z", "scene": None}, "of a scene")):
        with pytest.raises(ParameterError, match=says):
            diagnose(**{"scene": scene, **wrong})  # type: ignore[arg-type]
