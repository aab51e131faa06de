"""Laws in fixed point: linearised at several amplitudes, as they have no slope at the smallest one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from maglev_mj import (
    AxisLaw,
    Controller,
    ExactPlant,
    Hold,
    ParameterError,
    Timing,
    compare,
    diagnose,
    drive,
    gain,
    judge,
    linearise,
)
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.wall_scene import hold, others

T, DELAY = 0.005, 0.0015
INSIDE = np.array([-1e-3, 0.0, 0.0, 0.0, 0.0, 0.0])


class Fixed(AxisLaw):
    """Spring and damper in fixed point: counts of 1 µm, a difference filtered with `>> 2`, force in 1/256 N."""

    stiffness: float = gain("", "N/m", default=3000.0)
    damping: float = gain("", "N s/m per sample rate", default=8000.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        count = np.floor(x * 1e6 + 0.5)
        last, speed = (count, 0.0 * count) if state is None else state
        speed = speed + np.floor(((count - last) * 256.0 - speed) / 4.0)
        force = np.trunc(-gains.stiffness * count * 256.0 / 1e6) - np.trunc(gains.damping * speed / 1e6)
        return force / 256.0, (count, speed)


FIXED = Controller([Fixed(axes="x")], period=T)


def test_gains_by_amplitude_are_those_computed_without_the_package() -> None:
    """Stiffness and damping as in a loop over samples, with 64 random positions within a count."""
    random, found = np.random.default_rng(0), []
    for amplitude in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        random.uniform(0.0, 1e-6)  # of a single position, before
        poses = np.tile(INSIDE, (64, 1))
        poses[:, 0] += random.uniform(0.0, 1e-6, 64)
        each = linearise(FIXED, poses, axes="x", amplitude=amplitude)
        assert all((near.amplitude == amplitude).all() for near in each)
        means = (float(np.mean([getattr(near, name)[0, 0] for near in each])) for name in ("stiffness", "damping"))
        found.append(tuple(round(mean, 2) for mean in means))
    assert found == [(3051.76, 0.0), (3051.76, 0.0), (4492.19, 1.95), (3272.09, 27.34), (3034.06, 37.38)]


@pytest.mark.parametrize(("amplitude", "stiffness"), [(1e-5, 4492.1875), (1e-4, 3271.484375), (1e-3, 3034.1796875)])
def test_a_resolution_gives_the_mean_over_a_count(amplitude: float, stiffness: float) -> None:
    poses = INSIDE + np.eye(6)[0] * 1e-6 * (np.arange(0.5, 64.0) / 64.0)[:, None]
    mean = np.mean([near.response[:20] for near in linearise(FIXED, poses, amplitude=amplitude)], axis=0)
    (near,) = linearise(FIXED, INSIDE, amplitude=amplitude, resolution=1e-6)
    np.testing.assert_allclose(near.response, mean[: len(near.response)], rtol=0.0, atol=1e-9 * np.abs(mean).max())
    assert near.stiffness[0, 0] == pytest.approx(stiffness, rel=1e-12) and (near.pose == INSIDE).all()


def test_a_linear_law_is_the_same_at_any_amplitude() -> None:
    """That of a law with memory, to the rounding of a difference of forces."""

    class Filtered(AxisLaw):
        def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
            speed = 0.0 if state is None else state
            speed = speed + 0.3 * (v - speed)
            return -3000.0 * x - 40.0 * speed, speed

    controller = Controller([Filtered(axes="x")], period=T)
    (least,) = linearise(controller, INSIDE)
    for amplitude in (1e-5, 1e-3):
        (near,) = linearise(controller, INSIDE, amplitude=amplitude, resolution=1e-6)
        assert near.stiffness[0, 0] == pytest.approx(least.stiffness[0, 0], rel=1e-6)
        assert near.damping[0, 0] == pytest.approx(least.damping[0, 0], rel=1e-6)


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ({"amplitude": 0.0}, "amplitude must be above 0 m, rad"),
        ({"amplitude": [1e-3] * 3}, "amplitude must "),
        ({"resolution": -1e-6}, "resolution must be at least 0 m, rad"),
    ],
)
def test_wrong_sizes_are_refused(sizes: Any, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        linearise(FIXED, INSIDE, **sizes)


FAST, SHORT = 1e-3, 5e-4


def controller(damping: float) -> Controller:
    rest = Hold.critically_damped(others("x"), period=FAST, delay=SHORT)
    return Controller([Fixed(axes="x", damping=damping), rest], period=FAST)


def left_after(damping: float, speed: float) -> float:
    """Return the amplitude of the motion that is left after 3 s under a constant force of 3 N [m]."""
    positions = list[float]()
    around: Any = {"gravity": (-3.0 / 0.7, 0.0, 0.0), "pose": INSIDE, "twist": (speed, *[0.0] * 5)}
    with ExactPlant(Timing(period=FAST, delay=SHORT), **around) as plant:
        drive(plant, controller(damping), 4000, observe=lambda sample, _: positions.append(sample.position[0]))
    return 0.5 * float(np.ptp(positions[3000:]))


def test_a_law_in_fixed_point_is_never_stable() -> None:
    """Enough damping: stable for larger motion, and what is left is within two counts."""
    verdict = judge(controller(30_000.0), delay=SHORT)
    reason = "stable for larger motion only: dead band: the force changes in steps of 1 µm alone"
    assert verdict.stable is None and verdict.doubts == {"x": reason} and reason in str(verdict)
    rows = {round(1e6 * one.amplitude): one for one in verdict.amplitudes}
    assert [*rows] == [1, 10, 100, 400]
    assert [one.judged for one in rows.values()] == [False, True, True, True]
    assert [one.spectral_radius < 1.0 for one in rows.values()] == [False, True, True, True]
    assert (round(rows[10].stiffness), round(rows[10].damping, 1)) == (5273, 13.7)
    assert max(left_after(30_000.0, speed) for speed in (0.05, 5e-4)) < 2e-6


def test_a_law_that_rings_for_small_motion_is_unstable() -> None:
    """Too little damping of small motion: a limit cycle of several counts, whatever the amplitude at first."""
    verdict = judge(controller(8000.0), delay=SHORT)
    assert verdict.stable is False and verdict.loop is not None and verdict.loop.at_amplitude == pytest.approx(1e-5)
    assert verdict.headline.endswith("motion of 10 µm)")
    assert {round(1e6 * one.amplitude): one.spectral_radius < 1.0 for one in verdict.amplitudes} == {
        1: False,
        10: False,
        100: True,
        400: True,
    }
    text = " ".join(str(verdict.table()).split())
    assert "x, motion of 10 µm: 4492 N/m, 0.391 N s/m, unstable, spectral radius 1.003 x, motion of 1 µm" in text
    assert len(verdict.as_json()["amplitudes"]) == 4
    for speed in (0.05, 5e-4):
        assert 5e-6 < left_after(8000.0, speed) < 2e-5


class Counted(Drop):
    """Drop on a law in fixed point."""

    def laws(self) -> list[Any]:
        return [Fixed(axes="z", stiffness=self.stiffness, damping=100.0 * self.damping), hold(self, others("z"))]


def test_a_scene_is_diagnosed_at_the_worst_amplitude() -> None:
    scene = Counted(stiffness=3000.0, damping=80.0, period=FAST, delay=SHORT)
    verdict, found = judge(scene), diagnose(scene)
    assert verdict.stable is False and verdict.axes == ("z",)
    assert round(verdict.gains[0]) == 4492 and "4492.19 N/m" in str(found)
    assert any("law linearised at the worst pose for motion of 10 µm" in one for one in found.assumptions)
    assert verdict.loops.grown is not None and verdict.loop is not None
    softer = scene.replace(stiffness=1500.0).controller()
    (near,) = linearise(softer, verdict.pose, axes="z", amplitude=verdict.loop.at_amplitude, resolution=1e-6)
    assert verdict.loops.grown(verdict.loop, 0.5).stiffness == pytest.approx(near.stiffness[2, 2], rel=1e-6)
    assert near.stiffness[2, 2] > 1000.0


def test_counts_that_are_too_small_to_see_are_none() -> None:
    """A linear law rounds, too: its steps are at each position."""

    class Plain(AxisLaw):
        def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
            return -3000.0 * x - 60.0 * v

    verdict = judge(Controller([Plain(axes="x")], period=FAST), delay=SHORT)
    assert verdict.stable is True and verdict.amplitudes == ()


class Truncated(Fixed):
    """The same with a filter and a force that round towards zero: up to 3/256 count of speed is kept for good."""

    integral: float = gain("", "N/m per sample", default=0.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        count = np.floor(x * 1e6 + 0.5)
        last, speed, total = (count, 0.0 * count, 0.0 * count) if state is None else state
        speed, total = speed + np.trunc(((count - last) * 256.0 - speed) / 4.0), total + count
        force = -gains.stiffness * count * 256.0 - gains.damping * speed - gains.integral * total
        return np.trunc(force / 1e6) / 256.0, (count, speed, total)


@pytest.mark.parametrize("amplitude", [1e-5, 1e-4, 1e-3])
def test_what_a_filter_keeps_is_no_integral_action(amplitude: float) -> None:
    (near,) = linearise(Controller([Truncated(axes="x", damping=40_000.0)], period=FAST), INSIDE, amplitude=amplitude)
    assert not near.settled[0]
    around: Any = {"amplitude": amplitude, "resolution": 1e-6}
    (near,) = linearise(Controller([Truncated(axes="x", damping=40_000.0)], period=FAST), INSIDE, **around)
    assert near.settled.all() and len(near.response) < 64
    step = 1.0 / 256.0 / amplitude  # of the force
    assert near.stiffness[0, 0] == pytest.approx(3000.0, abs=2.0 * step)
    assert near.damping[0, 0] == pytest.approx(40.0, rel=0.35 if amplitude < 5e-5 else 0.05)
    (near,) = linearise(Controller([Truncated(axes="x", integral=256.0 * 300.0)], period=FAST), INSIDE, **around)
    assert not near.settled[0] and near.response[-1, 0, 0] == pytest.approx(-300.0, abs=step)


class FixedWall(Fixed):
    """Below 0 alone."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        force, state = super().force(x, v, gains, state)
        return force * (x < 0.0), state


def test_a_comparison_has_the_stiffness_in_use() -> None:
    scene = Drop(stiffness=3000.0, damping=8000.0, pulse=0.0, period=FAST, delay=SHORT)
    columns = compare(scene, {"fixed": FixedWall}, phases=2).columns()
    assert columns["stiffness"][0] == pytest.approx(3000.0, rel=0.02)
