"""Laws that no linearisation describes are found by probes, and others are not doubted."""

from __future__ import annotations

import re
from typing import Any, ClassVar

import numpy as np
import pytest

from maglev_mj import AxisLaw, Controller, compare, diagnose, gain, hold
from maglev_mj.control import AdaptiveWindow, Gains, Law
from maglev_mj.errors import KeywordError, ParameterError, TooManyCallsError
from maglev_mj.frames import AXES
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.stability_check import stability_warning, wall_loops
from maglev_mj.studies.compare import _chosen, _with_law, sweep_laws
from maglev_mj.theory.doubts import doubts
from maglev_mj.theory.loop import Doubt
from maglev_mj.theory.loop_array import is_linear
from maglev_mj.theory.verdict import judge, stability
from tests.all_of import VELOCITIES


class Own(AxisLaw):
    """Wall."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")

    def pd(self, x: Any, v: Any, gains: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v) * (x < 0.0)


class Plain(Own):
    """PD."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return self.pd(x, v, gains)


class OneWay(Own):
    """Damper on the way in."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v * (v < 0.0)) * (x < 0.0)


class Constant(Own):
    """12 N inside."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return 12.0 * (x < 0.0) - 40.0 * v * (x < 0.0)


class Play(Own):
    """Spring behind a play of 20 µm."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        y = x if state is None else np.clip(state, x - 1e-5, x + 1e-5)
        return -(gains.stiffness * y + gains.damping * v) * (x < 0.0), y


class EverySecond(Own):
    """Force at every second sample."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        count = 0.0 * x if state is None else state
        return 2.0 * self.pd(x, v, gains) * (count % 2 < 0.5), count + 1.0


class Fast(Own):
    """No damping above 5 mm/s."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v * (abs(v) < 5e-3)) * (x < 0.0)


class Dahl(Own):
    """Friction of a bristle, of 1 N and 1e6 N/m."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        before, bristle = (x, 0.0 * x) if state is None else state
        bristle = np.clip(bristle + x - before, -1e-6, 1e-6)
        return self.pd(x, v, gains) - 1e6 * bristle * (x < 0.0), (x, bristle)


class Ratchet(Own):
    """Force of the deepest position so far."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        deepest = x if state is None else np.minimum(state, x)
        return -(gains.stiffness * deepest + gains.damping * v) * (x < 0.0), np.where(x < 0.0, deepest, 0.0)


class Rounded(Own):
    """Position in steps of 5 µm."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * np.floor(x / 5e-6) * 5e-6 + gains.damping * v) * (x < 0.0)


class Timer(Own):
    """Twice the stiffness after 100 samples inside."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        inside = ((0.0 * x if state is None else state) + 1.0) * (x < 0.0)
        return self.pd(x, v, gains) * np.where(inside > 100.0, 2.0, 1.0), inside


class Drag(Own):
    """Damping that grows with the speed."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v * (1.0 + abs(v) / 3e-3)) * (x < 0.0)


class Burst(Own):
    """Twenty times the damping in the first 30 samples inside."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        inside = ((0.0 * x if state is None else state) + 1.0) * (x < 0.0)
        return self.pd(x, v, gains) - 19.0 * gains.damping * v * ((inside > 0.0) & (inside < 30.0)), inside


class Fatigue(Own):
    """No damping after 0.5 s inside."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        inside = ((0.0 * x if state is None else state) + 1.0) * (x < 0.0)
        return -(gains.stiffness * x + gains.damping * v * (inside < 500.0)) * (x < 0.0), inside


class Median(Own):
    """Spring at the median of three positions."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        one, two = (x, x) if state is None else state
        middle = np.maximum(np.minimum(one, two), np.minimum(np.maximum(one, two), x))
        return -(gains.stiffness * middle + gains.damping * v) * (x < 0.0), (x, one)


class Gated(Own):
    """Damping if one of the last five samples was at rest: none in a longer motion."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        speeds = (abs(v),) * 4 if state is None else state
        least = np.minimum.reduce([abs(v), *speeds])
        return -(gains.stiffness * x + gains.damping * v * (least < 1e-9)) * (x < 0.0), (abs(v), *speeds[:-1])


class OnChange(Own):
    """Spring at the last position that differed by 3 µm."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        last = x if state is None else np.where(abs(x - state) > 3e-6, x, state)
        return -(gains.stiffness * last + gains.damping * v) * (x < 0.0), last


class Swell(Own):
    """Stiffness that changes by 10 % at 0.7 Hz, by a counter."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        count = 0.0 * x if state is None else state
        return self.pd(x, v, gains) * (1.0 + 0.1 * np.sin(0.0044 * count)), count + 1.0


class Random(Own):
    """Noise of 1 %."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return self.pd(x, v, gains) * (1.0 + 0.01 * np.random.default_rng().normal())


class HuntCrossley(Own):
    """Force and damping grow with the depth."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return (gains.stiffness * 30.0 * abs(x) ** 1.5 - gains.damping * 300.0 * abs(x) * v) * (x < 0.0)


class Layers(Own):
    """Five times as stiff below 1 mm."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return self.pd(x, v, gains) - 4.0 * gains.stiffness * (x + 1e-3) * (x < -1e-3)


class Preloaded(Own):
    """Jump of 3 N at the edge, less than the weight."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return self.pd(x, v, gains) + 3.0 * (x < 0.0)


class Lead(Own):
    """Difference of the position's low-pass, as a lead."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        slow = x if state is None else state
        slow = slow + 0.2 * (x - slow)
        return -(gains.stiffness * (x + 0.5 * (x - slow)) + gains.damping * v) * (x < 0.0), slow


class Ceiling(Own):
    """Wall above 2 mm."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * (x - 2e-3) + gains.damping * v) * (x > 2e-3)


class Damper(Own):
    """Damper everywhere."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -gains.damping * v


class Sticky(Own):
    """Wall that never pulls."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return np.maximum(self.pd(x, v, gains), 0.0)


class Integral(Own):
    """Spring, damper and integral."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        total = ((0.0 * x if state is None else state) + 1e-3 * x) * (x < 0.0)
        return self.pd(x, v, gains) - 0.5 * gains.stiffness * total, total


class Leaky(Own):
    """Spring, damper and leaky integral, slower than the rest before a probe."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        total = x if state is None else 0.98 * state + x
        return -(gains.stiffness * (x + 4e-3 * total) + gains.damping * v) * (x < 0.0), total


class Resonant(Own):
    """Spring, damper and a lightly damped resonance at 150 Hz."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        one, two = (0.0 * x, 0.0 * x) if state is None else state
        y = 0.02 * x + 1.154 * one - 0.963 * two
        return -(gains.stiffness * (x + 0.3 * y) + gains.damping * v) * (x < 0.0), (y, one)


class Floats(Own):
    """Wall for one device alone."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v) if x < 0.0 else 0.0


DOUBTED: dict[Any, str] = {
    OneWay: "direction of the smallest motion",
    Constant: "the weight is carried by a jump of force, 12 N at 0 mm",
    Play: "hysteresis",
    EverySecond: "number of samples at rest",
    Fast: "damping changes above (4.9[0-9]|5) mm/s",
    Dahl: "hysteresis|direction|changes above",
    Ratchet: "hysteresis|direction",
    Rounded: "dead band: the force changes in steps of 5 µm alone",
    Timer: "number of samples at rest",
    Drag: "damping changes above",
    Random: "does not repeat",
    Burst: r"samples at rest \(40 or 3\)",
    Fatigue: r"samples at rest \(40 or 512\)",
    Median: "not the sum of those of its samples|direction of the smallest motion",
    Gated: "not the sum of those of its samples",
    OnChange: "does not follow the smallest motion",
    Swell: "number of samples at rest",
}
NOT_DOUBTED = [Plain, HuntCrossley, Layers, Preloaded, Lead, Ceiling, Damper, Sticky, Integral, Leaky, Resonant, Floats]


def scene(law: Any, stiffness: float, on: str = "z", **values: Any) -> Drop:
    class Scene(Drop):
        """Drop."""

        def laws(self) -> list[Any]:
            own = law(axes=on, stiffness=self.stiffness, damping=self.damping)
            return [own, hold(self, [axis for axis in AXES if axis != on])]

    own: Any = Scene
    result: Drop = own(**{"period": 1e-3, "delay": 8e-4, "damping": 80.0, "stiffness": stiffness} | values)
    return result


def found(one: Drop) -> dict[int, Doubt]:
    body = one.body.bounded
    return doubts([one.controller()], pose=one.start().pose, reach=body.range, load=body.load)[0]


@pytest.mark.parametrize("law", DOUBTED)
@pytest.mark.parametrize(("stiffness", "on"), [(2e4, "z"), (4e4, "z"), (2e4, "x")])
def test_a_law_that_is_not_linear_is_doubted(law: Any, stiffness: float, on: str) -> None:
    ((axis, doubt),) = found(scene(law, stiffness, on)).items()
    assert AXES[axis] == on
    words = DOUBTED[law].replace("the weight", "a load") if on == "x" else DOUBTED[law]
    assert re.search(words, doubt.reason)


@pytest.mark.parametrize("law", NOT_DOUBTED)
@pytest.mark.parametrize("stiffness", [2e3, 2e4, 2e5])
def test_a_law_that_is_linear_for_small_motion_is_not_doubted(law: Any, stiffness: float) -> None:
    (doubt,) = found(scene(law, stiffness)).values()
    assert not doubt.reason, doubt


BUILT_IN = ["pd", "pulse", "half-sample", "virtual-coupling", "filtered"]


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize(("stiffness", "period", "delay"), [(8e3, 5e-3, 1.5e-3), (5e4, 2.5e-4, 2e-4)])
def test_laws_of_the_table_are_not_doubted(name: str, stiffness: float, period: float, delay: float) -> None:
    drop: Any = find_scene("drop")
    chosen, rows = _chosen(drop(stiffness=stiffness, period=period, delay=delay), [name])
    controller = _with_law(chosen, name, rows[name], "exact").controller()
    undeclared = [Undeclared(law) for law in controller.laws]
    body = chosen.body.bounded
    around: Any = {"pose": chosen.start().pose, "reach": body.range, "load": body.load, "axes": [2]}
    for laws in (controller.laws, undeclared):
        own = Controller(laws, period=period, velocity=controller.velocity)
        assert all(not doubt.reason for doubt in doubts([own], **around)[0].values())


class Undeclared(Law):
    """Law without its declared gains."""

    def __init__(self, law: Law) -> None:
        self.law = law
        self.pulse_width = law.pulse_width

    def start(self) -> Any:
        return self.law.start()

    def __call__(self, *args: Any) -> Any:
        return self.law(*args)


@pytest.mark.parametrize("name", ["passivity", "passivity-2002"])
def test_passivity_controllers_are_doubted(name: str) -> None:
    chosen, rows = _chosen(find_scene("drop")(), [name])
    controller = _with_law(chosen, name, rows[name], "exact").controller()
    own = Controller([Undeclared(law) for law in controller.laws], period=chosen.period)
    body = chosen.body.bounded
    (doubt,) = doubts([own], pose=chosen.start().pose, reach=body.range, load=body.load, axes=[2])[0].values()
    assert doubt.reason


@pytest.mark.parametrize("law", [Fast, Floats])
def test_several_controllers_are_probed_together(law: Any) -> None:
    scenes = [scene(law, stiffness) for stiffness in (1e4, 2e4, 4e4)]
    body = scenes[0].body.bounded
    around: Any = {"pose": scenes[0].start().pose, "reach": body.range, "load": body.load}
    together = doubts([one.controller() for one in scenes], **around)
    for one, single in zip(together, map(found, scenes), strict=True):
        assert [doubt.reason for doubt in one.values()] == [doubt.reason for doubt in single.values()]
        assert [float(x.valid_to) for x in one.values()] == pytest.approx([float(x.valid_to) for x in single.values()])


def test_calls_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.theory.linearise._MOST_CALLS", 500)
    with pytest.raises(TooManyCallsError, match="needs more than 500 calls"):
        found(scene(Floats, 2e4))


@pytest.mark.parametrize("law", [OneWay, Constant, Play, EverySecond, Fast, Drag, Timer])
def test_a_doubted_law_is_not_called_stable(law: Any) -> None:
    one = scene(law, 2e4)
    verdict = stability(one)
    assert verdict.stable is not True and (verdict.stable is False or verdict.unjudged == ("z",))
    if verdict.stable is None:
        assert verdict.as_json()["doubts"] == dict(verdict.doubts) and str(verdict).endswith(verdict.doubts["z"])
    if law is Fast:
        assert verdict.stable is None and verdict.spectral_radius < 1.0
        assert verdict.doubts["z"].startswith("stable for slower motion only: the damping changes above 4.9")


def test_a_verdict_on_small_motion_says_up_to_which_speed() -> None:
    verdict = stability(scene(Sticky, 2e3))
    assert verdict.stable is True and verdict.valid_to is not None and 0.05 < verdict.valid_to < 0.2
    (line,) = (text for text in verdict.remarks if "small motion" in text)
    assert re.fullmatch(r"valid for small motion: linear on z up to .* mm/s \(.* µm in a sample\); a fall .*", line)
    assert verdict.as_json()["valid_to"] == verdict.valid_to
    plain = stability(scene(Plain, 2e4))
    assert plain.stable is True and plain.valid_to is not None and plain.valid_to.beyond
    assert "more_than" in plain.as_json()["valid_to"] and not any("small motion" in text for text in plain.remarks)
    assert stability(Drop()).valid_to is None


class Faded(Own):
    """Damping that is halved at 50 mm/s."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v / (1.0 + (v / 0.05) ** 2)) * (x < 0.0)


@pytest.mark.parametrize("stiffness", [2e3, 5e4])
@pytest.mark.parametrize("law", [Faded, Plain, Leaky, Resonant])
def test_speeds_up_to_that_of_a_fall_are_probed_in_a_wall_of_any_stiffness(law: Any, stiffness: float) -> None:
    (doubt,) = found(scene(law, stiffness)).values()
    assert not doubt.reason and doubt.valid_to.beyond is (law is not Faded)
    if law is Faded:
        assert doubt.valid_to == pytest.approx(0.0288, rel=0.02)
    else:
        assert doubt.valid_to > 0.29  # a fall reaches 0.297 m/s


def test_a_verdict_says_that_the_damping_fades_at_the_speed_of_a_fall() -> None:
    verdict = stability(scene(Faded, 5e4))
    assert verdict.stable is True and any("small motion" in text for text in verdict.remarks)


class StiffLayer(Own):
    """Thirty times as stiff between 1.42 and 1.50 mm."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return self.pd(x, v, gains) + 29.0 * gains.stiffness * np.clip(-x - 1.42e-3, 0.0, 8e-5) * (x < 0.0)


class BareLayer(Own):
    """No damping between 0.70 and 0.76 mm."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        inside = (x < -7e-4) & (x > -7.6e-4)
        return -(gains.stiffness * x + gains.damping * v * ~inside) * (x < 0.0)


@pytest.mark.parametrize(("law", "least", "most"), [(StiffLayer, 1.42e-3, 1.50e-3), (BareLayer, 0.70e-3, 0.76e-3)])
@pytest.mark.parametrize("stiffness", [3e3, 2e4])
def test_a_thin_layer_between_the_poses_is_judged(law: Any, least: float, most: float, stiffness: float) -> None:
    verdict = stability(scene(law, stiffness))
    assert verdict.stable is False and least < -verdict.pose[2] < most


class FloatLayer(StiffLayer):
    """The layer, for one device alone."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return super().force(x, v, gains, state) if x < 0.0 else 0.0


def test_the_pose_at_which_a_law_carries_the_weight_is_judged() -> None:
    verdict = stability(scene(FloatLayer, 2e3))  # the weight rests in the layer, at 60 kN/m
    assert verdict.stable is False and 1.42e-3 < -verdict.pose[2] < 1.5e-3


class Declared(Fast):
    """Law that declares its linear part."""

    def gains(self) -> Any:
        return (Gains("contact", self.on_axes(self.stiffness), self.on_axes(self.damping)),)


def test_declared_gains_are_the_linear_part_of_a_law() -> None:
    verdict = stability(scene(Declared, 2e4))
    assert verdict.stable is True and verdict.remarks == ("Declared as declared, without the rest",)
    assert not stability(Drop()).remarks


class Windowed(Drop):
    """Drop with an estimator that is not linear."""

    estimator: ClassVar[Any] = AdaptiveWindow()

    def velocity_estimator(self) -> Any:
        return self.estimator


@pytest.mark.parametrize("estimator", [one for one in VELOCITIES if not is_linear(one)])
def test_an_estimator_that_is_not_linear_is_judged_nowhere(estimator: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Windowed, "estimator", estimator)
    verdict, warning = stability(Windowed()), stability_warning(Windowed())
    assert verdict.stable is None and verdict.unjudged == AXES
    reason = f"rz: the velocity estimator {type(estimator).__name__} is not linear"
    assert warning is not None and warning.endswith(reason)


def test_diagnose_says_for_which_motion_it_holds() -> None:
    soft = diagnose(scene(Sticky, 2e3))
    assert soft.valid_to is not None and soft.as_json()["valid_to"] == soft.valid_to < 0.2
    assert "valid for small motion: linear on z up to" in " ".join(str(soft).split())
    assert diagnose(Drop()).valid_to is None
    with pytest.raises(ParameterError, match=r"not computed on z: .* does not repeat|hysteresis"):
        diagnose(scene(Play, 2e4))
    with pytest.raises(KeywordError, match="valid_to"):
        diagnose(stiffness=1.0, damping=1.0, mass=1.0, rate=100.0, valid_to=1.0)


@pytest.mark.parametrize(
    ("law", "verdict", "reason"),
    [
        (Play, "not computed", "stability not computed: the force at rest depends on the way there (hysteresis)"),
        (Damper, "stable", "no critical gain: the law has no stiffness at rest"),
        ("passivity", "stable", "PassivityController as declared, without the rest"),
    ],
)
def test_compare_gives_the_reason_of_each_missing_margin(law: Any, verdict: str, reason: str) -> None:
    one = Drop(period=1e-3, delay=8e-4, stiffness=2e4, damping=80.0, duration=0.03)
    found = compare(one, {"own": law}, phases=1)
    assert found.verdicts == {"own": verdict}
    assert found.reasons == found.as_json()["reasons"] == {"own": reason}
    assert f"own: {reason}" in " ".join(str(found).split())


class Tilt(Law):
    """Wall on z whose force turns the flotor about x."""

    def __init__(self, *, axes: str, stiffness: float, damping: float) -> None:
        del axes
        self.stiffness, self.damping = stiffness, damping

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: list[Any]) -> Any:
        force = -(self.stiffness * position[2] + self.damping * velocity[2]) * (position[2] < 0.0)
        wrench[2], wrench[3] = wrench[2] + force, wrench[3] + 0.01 * force
        return state, None


def test_compare_and_its_map_say_which_coupling_is_left_out_and_why_a_cell_is_empty(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("maglev_mj.studies.compare._TICKS", 20)  # in less time
    one = Drop(period=1e-3, delay=8e-4, stiffness=2e4, damping=80.0, duration=0.01, pulse=0.0)
    left_out, play = "coupling of z to rx left out", "the force at rest depends on the way there (hysteresis)"
    assert compare(one, {"tilt": Tilt, "pd": "pd"}, phases=1).reasons == {"tilt": left_out}
    laws: Any = {"tilt": Tilt, "pd": "pd", "play": Play, "damper": Damper}
    found = sweep_laws(one, laws, "damping", [80.0], figure="critical_stiffness")
    empty = [left_out, "", f"stability not computed: {play}", "no critical gain: the law has no stiffness at rest"]
    assert found.columns()["warnings"].tolist() == empty
    assert np.isnan(found.figure("critical_stiffness")[0]).tolist() == [False, False, True, True]
    lines = [f"{law}, 1 of 1 cells: {text}" for law, text in zip(laws, empty, strict=True) if text]
    assert found.warnings == found.reasons == lines
    assert "not computed for play and damper" in found.headline and all(
        line in " ".join(str(found).split()) for line in lines
    )


class SoftEdge(AxisLaw):
    """Wall whose damping grows with depth: unstable at its edge, stable at rest."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping at depth", "N s/m")

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + np.minimum(abs(x) / 1e-3, 1.0) * gains.damping * v) * (x < 0.0)


def test_compare_says_that_a_verdict_holds_at_rest_alone() -> None:
    note = "a verdict in this table holds at rest in the wall, a warning over the whole range"
    for law, warned in ((SoftEdge, True), ("pd", False)):
        found = compare(Drop(duration=0.03), {"own": law}, phases=1)
        assert found.verdicts == {"own": "stable"} and any("unstable" in text for text in found.warnings) is warned
        assert (note in " ".join(str(found).split())) is warned


@pytest.mark.parametrize("law", [Constant, EverySecond, Plain])
def test_the_margin_of_a_wall_needs_a_law_without_doubts(law: Any) -> None:
    assert (judge(wall_loops(scene(law, 2e4))).stable is None) == (law is not Plain)
