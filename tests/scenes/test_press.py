"""Hits and presses by a scripted hand, against a second implementation and closed forms."""

from __future__ import annotations

import json
import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from maglev_mj.frames import Array
from maglev_mj.plants.trace import Trace
from maglev_mj.scenes.figures import HIT_FIGURES, summarise_press
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import Phases, RunResult
from maglev_mj.scenes.run import run, run_phases

SHORT = Press(hits=2, duration=1.6)
ARM_MASS, ARM_DAMPING, ARM_STIFFNESS = 0.554, 6.45, 135.0


def exact(press: Press, phase: float = 0.0) -> RunResult:
    return run(press, plant="exact", phase=phase)


@cache
def swept(press: Press, phases: int) -> Phases:
    return run_phases(press, phases, plant="exact")


def drawn_to(p: Press, phase: float, time: float) -> float:
    """Return the hand's target, written out: up, down and up every interval, down to stay."""
    since = time - (1.0 - phase) * p.period - 0.5 * p.interval
    stroke = min(math.floor(since / p.interval), p.hits)
    way = max(since - stroke * p.interval, 0.0) / (0.25 * p.interval) if stroke >= 0 else 0.0
    down = min(way, 1.0) if stroke == p.hits else way if way < 1.0 else max(2.0 - way, 0.0)
    return p.height + (down**3 * (10.0 - 15.0 * down + 6.0 * down**2)) * (p.resting_point - p.height)


def reference(p: Press, phase: float) -> tuple[Array, Array]:
    """Return z and force every 0.5 ms, computed independently; switches are multiples of that."""
    step, ticks, late, wide = 5e-4, 10, 3, 6
    total = p.mass + ARM_MASS
    values, vectors = np.linalg.eig(
        np.array([[0.0, 1.0, 0.0], [-ARM_STIFFNESS / total, -ARM_DAMPING / total, 1 / total], [0, 0, 0]])
    )
    carry = (vectors @ np.diag(np.exp(values * step)) @ np.linalg.inv(vectors)).real
    z, v, pull, before = p.height, 0.0, 0.0, math.nan
    count = round(p.end / step)
    force = np.zeros(count + ticks + late + 1)
    places = []
    for k in range(count + 1):
        if k % ticks == 0:
            speed = 0.0 if k == 0 else (z - before) / p.period
            force[k + late :] = -p.stiffness * z - p.damping * speed if z <= 0.0 else 0.0
            if before > 0.0 >= z and p.pulse > 0.0 and speed <= -p.pulse_gate:
                force[k + late : k + late + wide] = -(p.pulse + p.damping) * speed
            before = z
            pull = ARM_STIFFNESS * drawn_to(p, phase, k * step)
        places.append(z)
        z, v, _ = carry @ [z, v, pull + force[k]]
    return np.array(places), force[: count + 1]


@pytest.mark.parametrize(
    ("phase", "changes"), [(0.0, {}), (0.37, {}), (0.8, {"pulse": 0.0}), (0.5, {"pulse_gate": 0.15, "press": 3.0})]
)
def test_press_means_what_it_says(phase: float, changes: dict[str, Any]) -> None:
    press = SHORT.replace(**changes)
    series = exact(press, phase).series(5e-4)
    z, force = reference(press, phase)
    np.testing.assert_allclose(series["z"], z, rtol=0.0, atol=1e-9)
    # the sample at the end is answered after it
    np.testing.assert_allclose(series["force"][:-1], force[:-1], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize(
    ("hand", "press", "stiffness", "springs"),
    [
        ("stylus", 3.0, 4000.0, (271.7, 769.9)),
        ("0.3,20,500,3,2000", 8.0, 5000.0, (500.0, 2000.0)),
    ],
)
def test_the_press_is_as_hard_as_asked(hand: str, press: float, stiffness: float, springs: tuple[float, ...]) -> None:
    """Wall, grip and arm are springs in a row."""
    scene = Press(hand=hand, press=press, stiffness=stiffness, hits=1, duration=4.0)
    point = -press * (1.0 / stiffness + sum(1.0 / spring for spring in springs))
    assert scene.resting_point == pytest.approx(point, rel=1e-12)
    figures = exact(scene, 0.4).figures
    assert figures["final_force"] == pytest.approx(press, abs=1e-6)
    assert figures["final_depth"] == pytest.approx(press / stiffness, abs=1e-9)
    assert figures["force_ripple"] < 1e-6
    assert figures["ripple"] < 1e-9


def test_energy_adds_up() -> None:
    phase = 0.6
    # What the muscles give is what wall, arm's spring, arm's damper and the masses have at the end.
    p, result = SHORT, exact(SHORT, phase)
    samples = np.append(np.arange(p.end / p.period), p.end / p.period) * p.period
    places = result.trace.at(samples)[0][:, 2]
    pulls = [ARM_STIFFNESS * drawn_to(p, phase, float(time)) for time in samples[:-1]]
    muscles = float(np.dot(pulls, np.diff(places)))
    speed, steps = result.trace.twist[:, 2], np.diff(result.trace.time)
    middle = result.trace.at(0.5 * (result.trace.time[1:] + result.trace.time[:-1]))[1][:, 2]
    damper = ARM_DAMPING * float(np.dot(steps, speed[:-1] ** 2 + 4.0 * middle**2 + speed[1:] ** 2)) / 6.0
    spring = 0.5 * ARM_STIFFNESS * (places[-1] ** 2 - places[0] ** 2)
    masses = 0.5 * (p.mass + ARM_MASS) * speed[-1] ** 2
    absorbed = result.figures["absorbed"]
    assert absorbed == pytest.approx(muscles - damper - spring - masses, rel=1e-6)
    assert absorbed > 0.5 * p.press**2 / p.stiffness  # a passive wall: more than its spring stores


def test_the_figures_are_those_of_the_curve() -> None:
    # A parabola through the edge, from -0.2 m/s at 1 mm under 15 m/s² upward, twice over.
    v, h, a, m = 0.2, 1e-3, 15.0, 0.7
    lasts = 2.0 * v / a  # back at the height it came from
    entry = math.sqrt(v * v - 2.0 * a * h)
    time = np.array([0.0, 0.5 * lasts, lasts, lasts, 1.5 * lasts, 2.0 * lasts])
    pose, twist, wrench = (np.zeros((6, 6)) for _ in range(3))
    pose[:, 2] = [h, h - 0.5 * v * v / a, h] * 2
    twist[:, 2] = [-v, 0.0, v] * 2
    wrench[:, 2] = [m * a, m * a, 0.0, m * a, m * a, 0.0]
    trace = Trace(time, pose, twist, wrench)
    figures = summarise_press(trace, [0.0, lasts, 2.0 * lasts, 3.0 * lasts], 3.0 * lasts, 4.0 * lasts)
    np.testing.assert_allclose(figures.penetration[:2], 0.5 * v * v / a - h, rtol=1e-9)
    np.testing.assert_allclose(figures.approach_speed[:2], entry, rtol=1e-9)
    np.testing.assert_allclose(figures.peak_force[:2], m * a, rtol=1e-12)
    np.testing.assert_allclose(figures.contact_time[:2], 2.0 * entry / a, rtol=1e-4)
    assert figures.contacts[:2].tolist() == [1.0, 1.0]
    # the run ends before the third hit and the press
    assert all(math.isnan(getattr(figures, name)[2]) for name in HIT_FIGURES)
    assert math.isnan(float(figures.final_force)) and math.isnan(float(figures.ripple))
    assert figures.absorbed == pytest.approx(0.0, abs=1e-15)


def test_every_hit_counts_and_bounces_are_not_hits() -> None:
    clean = exact(SHORT.replace(hits=3, duration=2.2))
    figures = clean.figures
    assert figures["contacts"].tolist() == [1.0, 1.0, 1.0]
    assert exact(SHORT.replace(hand="stylus")).figures["contacts"].tolist() == [2.0, 2.0]
    series, strokes = clean.series(2e-5), clean.scene.strokes(0.0)
    for place, (start, end) in enumerate(pairwise(strokes)):
        window = (series["time"] >= start) & (series["time"] < end)
        assert figures["penetration"][place] == pytest.approx(-series["z"][window].min(), abs=1e-8)
        assert figures["peak_force"][place] == pytest.approx(np.abs(series["force"][window]).max(), rel=1e-12)
        assert figures["contact_time"][place] == pytest.approx((series["z"][window] <= 0.0).sum() * 2e-5, abs=5e-5)


def test_a_stroke_that_does_not_reach_the_wall_says_so() -> None:
    far = exact(SHORT.replace(height=0.02, press=0.1))
    assert [far.figures[name][0] for name in ("penetration", "contacts", "peak_force")] == [0.0] * 3
    assert math.isnan(far.figures["approach_speed"][0])
    data = json.loads(json.dumps(far.as_json(), allow_nan=False))
    assert data["summary"]["approach_speed"][0] is None
    assert data["summary"]["penetration"][0] == 0.0


@pytest.mark.parametrize("phases", [3, pytest.param(100, marks=pytest.mark.study)])
def test_the_pulse_lessens_every_hit_of_an_arm(phases: int) -> None:
    # Over many phases and four hits; of the paper's 220 N s/m as further damping, not with the damping in it.
    with_pulse, without = (swept(Press(pulse=pulse, hits=3), phases).figures for pulse in (220.0, 0.0))
    assert (with_pulse["penetration"] < without["penetration"]).all()
    assert (with_pulse["absorbed"] > without["absorbed"]).all()
    for figures in (with_pulse, without):
        np.testing.assert_allclose(figures["final_force"], 5.0, rtol=0.0, atol=1e-6)


SOFT = Press(hand="stylus", hits=2, duration=1.6)


@pytest.mark.parametrize("phases", [5, pytest.param(40, marks=pytest.mark.study)])
def test_in_a_soft_grip_the_pulse_throws_the_flotor_back_unless_it_just_stops_it(phases: int) -> None:
    # 220 N s/m as further damping, and with the damping in it
    further, stopping, without = (swept(SOFT.replace(pulse=pulse), phases).figures for pulse in (220.0, 140.0, 0.0))
    assert (further["contacts"] > 1.0).all()
    assert (stopping["contacts"] == 1.0).all() and (without["contacts"] == 1.0).all()
    for figures in (further, stopping):
        assert 0.0 < (figures["penetration"] > without["penetration"]).mean() < 0.2
    assert np.median(further["penetration"]) < 0.7 * np.median(without["penetration"])
