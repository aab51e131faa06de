"""A field that is stated in place of a loop's own acts, or is refused; a verdict that is not known says so."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from maglev_mj import device_card, diagnose, judge
from maglev_mj.control import Hold, Wall
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.cell_verdicts import cell_verdicts
from maglev_mj.scenes.drop import Drop
from maglev_mj.theory.loop import Loop, Loops
from maglev_mj.theory.loop_parameters import LoopParameters
from maglev_mj.theory.verdict import Verdict, critical_stiffness_of
from tests.studies.test_verdict_properties import Linearised

NUMBERS: dict[str, Any] = {"stiffness": 6000.0, "damping": 20.0, "period": 5e-3, "delay": 1.5e-3, "inertia": 0.7}


def test_a_hand_can_be_removed() -> None:
    held = Loop.of(hand="arm", **NUMBERS)
    free = judge(**NUMBERS).spectral_radius
    assert judge(held).spectral_radius != pytest.approx(free, abs=1e-3)
    for nothing in (None, "none"):
        assert judge(held, hand=nothing).spectral_radius == pytest.approx(free, abs=1e-12)
        assert judge(held[0], hand=nothing).spectral_radius == pytest.approx(free, abs=1e-12)


@pytest.mark.parametrize(
    "name", ["stiffness", "damping", "inertia", "own_damping", "period", "mode", "velocity", "law"]
)
def test_a_field_that_a_linearised_law_contains_is_refused(name: str) -> None:
    (loop, *_) = [one for one in Loop.of(Linearised(stiffness=5000.0)) if one.linear is not None and one.axis == "z"]
    before = judge(loop).spectral_radius
    assert judge(loop, driver_lag=1e-3).spectral_radius != pytest.approx(before, abs=1e-6)
    with pytest.raises(ParameterError, match="delay, driver_lag"):
        judge(loop, **{name: 1.0})


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"axis": "q"}, "axis must be one of"),
        ({"stiffness": np.array([1.0, 2.0])}, "stiffness must be a finite number"),
        ({"damping": "a"}, "damping must be a finite number"),
    ],
)
@pytest.mark.parametrize("device", [{}, {"device": "stage"}])
def test_a_wrong_field_is_named(values: dict[str, Any], device: dict[str, Any], says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        judge(**NUMBERS | values | device)


def test_the_critical_gain_of_a_host_law_beside_a_stiffer_device_is_its_own() -> None:
    class Both(Drop):
        def laws(self) -> list[Any]:
            wall = Wall(axes="z", lower=0.0, stiffness=5000.0, damping=30.0, on="device")
            return [wall, Hold(axes="z", stiffness=self.stiffness, damping=20.0)]

    loops = Loop.of(Both(stiffness=100.0))
    (loop,) = [one for one in loops if one.axis == "z" and one.state == ("contact",) and one.hand is None]
    found = critical_stiffness_of(loops, loop).ratio
    assert loops.grown is not None and not found.beyond
    below, above = (loops.grown(loop, share * found).spectral_radius for share in (0.999, 1.001))
    assert below < 1.0 < above


def test_delays_that_were_not_searched_are_unknown() -> None:
    verdict = judge("twist")
    assert verdict.stable and math.isnan(verdict.stable_delays.bound) and verdict.stable_delays.text == "-"


def test_a_law_that_fails_leaves_the_other_cells() -> None:
    class Broken(Drop):
        def laws(self) -> list[Any]:
            class Bad(Wall):
                def gains(self) -> Any:
                    raise ValueError("boom")

            return [Bad(axes="z", lower=0.0, stiffness=self.stiffness, damping=self.damping)]

    error, verdict = cell_verdicts([Broken(), Drop()])
    assert str(error) == "boom" and isinstance(verdict, Verdict) and verdict.stable


@pytest.mark.parametrize(
    ("scene", "values", "says"),
    [
        ("twist", {"on_axis": "x"}, "renders no stiffness"),
        ("drop", {"inertia": 0.01}, "inertia must not be given on axis z of drop: state its mass"),
    ],
)
def test_a_question_that_a_scene_does_not_answer_is_refused(scene: str, values: dict[str, Any], says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        diagnose(scene, **values)


def test_a_stated_lag_limits_the_bandwidth_of_a_force() -> None:
    slow, own, fast = (device_card(Drop(), LoopParameters(driver_lag=lag)) for lag in (2e-3, None, 0.0))
    assert slow.force_bandwidth < 80.0 < own.force_bandwidth < fast.force_bandwidth


def test_loops_keep_their_order_when_fields_change() -> None:
    loops = Loop.of("drop")
    changed = loops.replace(delay=2e-3)
    assert isinstance(changed, Loops) and [one.axis for one in changed] == [one.axis for one in loops]
    assert {one.delay for one in changed} == {2e-3}
