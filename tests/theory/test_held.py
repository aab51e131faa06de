"""Verdict free and in each hand, and the time until a released handle leaves its range."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maglev_mj.control import LowPass
from maglev_mj.plants.hand import HANDS, Hand, Mode, get_hand
from maglev_mj.spec import LEVER_ARM, RANGE
from maglev_mj.theory.held import FORCE, FREE, OWN, Held, Release, held_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.two_rates import DeviceLaw

REACH = RANGE[0]


def loop_of(mass: float, stiffness: float, damping: float, period: float, delay: float, **values: Any) -> Loop:
    times: Any = {"period": 1e-3 * period, "delay": 1e-3 * delay}
    return Loop(stiffness=stiffness, damping=damping, inertia=mass, **times, **values)


# mass, gains, period and delay [ms]; radius free, arm, stylus, fingertip; critical delays [ms] where below ten periods;
# time to leave [s]: by matrices and events of another program
KNOWN = [
    ((0.7, 6000, 80, 5, 1.5), (0.877085, 0.852530, 0.889859, 0.867886), (3.2572, 6.2957, 3.1144, 3.4429), None),
    ((0.7, 6000, 80, 5, 5), (1.082124, 0.963943, 1.086092, 1.071753), (3.2572, 6.2957, 3.1144, 3.4429), 0.241),
    ((0.15, 500, 0.1, 1, 1), (1.002162, 0.995891, 0.989505, 0.998972), (0.0, None, None, 1.7036), 0.375),
    ((0.15, 500, 1, 5, 5), (1.045876, 0.987072, 0.979891, 1.025803), (0.0, 12.6390, 10.0094, 1.3992), 0.089),
    ((0.3, 2000, 5, 5, 5), (1.086929, 1.011019, 1.056493, 1.073522), (0.0, 3.0985, 1.3546, 0.2786), 0.131),
    ((0.7, 11000, 90, 5, 1.5), (1.020050, 0.924164, 1.024030, 1.009017), (1.2744, 3.1867, 1.2264, 1.3955), 1.084),
    ((0.203046, 845.927, 20.6975, 8.08187, 2.42456), (0.960963, None, 1.017058, None), (None,) * 4, None),
]
LINES = [
    ("held    arm stable, stylus stable, fingertip stable; free stable",),
    (
        "held    arm stable, stylus unstable, fingertip unstable; free unstable",
        "Stable only while held (arm): released with 1 N it rings at 20.5 Hz and passes 4.5 mm after about 0.24 s",
    ),
    (
        "held    arm stable, stylus stable, fingertip stable; free unstable",
        "Stable only while held (arm, stylus, fingertip): released with 1 N it rings at 9.17 Hz and passes 4.5 mm "
        "after about 0.38 s",
    ),
    (
        "held    arm stable, stylus stable, fingertip unstable; free unstable",
        "Stable only while held (arm, stylus): released with 1 N it rings at 8.92 Hz and passes 4.5 mm after about "
        "89 ms",
    ),
    ("held    arm unstable, stylus unstable, fingertip unstable; free unstable",),
    (
        "held    arm stable, stylus unstable, fingertip unstable; free unstable",
        "Stable only while held (arm): released with 1 N it rings at 27.7 Hz and passes 4.5 mm after about 1.1 s",
    ),
    (
        "held    arm stable, stylus unstable, fingertip stable; free stable",
        "Unstable only while held (stylus): spectral radius 1.0171; released it settles",
    ),
]


@pytest.mark.parametrize(("case", "radii", "delays", "time", "lines"), [(*one, t) for one, t in zip(KNOWN, LINES)])
def test_known_loops(case: Any, radii: Any, delays: Any, time: float | None, lines: tuple[str, ...]) -> None:
    found = held_of(loop_of(*case))
    assert found.lines == lines and str(found) == "\n".join(lines)
    assert [*found.parts] == [FREE, "arm", "stylus", "fingertip"]
    for part, radius, delay in zip(found.parts.values(), radii, delays, strict=True):
        assert radius is None or part.radius == pytest.approx(radius, abs=6e-7)
        assert delay is None or 1e3 * (part.critical_delay or 0.0) == pytest.approx(delay, abs=6e-5)
    assert found.leaves_after == (None if time is None else pytest.approx(time, abs=6e-4))
    data = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert data["arm"].keys() == {"stable", "radius", "critical_delay"}
    assert [one["stable"] for one in data.values()] == [part.radius < 1.0 for part in found.parts.values()]


def flown(loop: Loop, force: float, reach: float, longest: float) -> float:
    """Return the time of the first sample outside the range, by ballistic motion from event to event."""
    rest = force / loop.stiffness
    whole, later = divmod(loop.delay / loop.period, 1.0)
    x, v, last, command = rest, 0.0, rest, -force
    pending, parts = [-force] * int(whole), (later * loop.period, (1.0 - later) * loop.period)
    for tick in range(int(longest / loop.period)):
        if abs(x) >= reach:
            return tick * loop.period
        newest = -loop.stiffness * x - loop.damping * (x - last) / loop.period
        pending, last = [*pending, newest], x
        for index, part in enumerate(parts):
            command = pending.pop(0) if index else command
            a = command / loop.inertia
            x, v = x + v * part + 0.5 * a * part * part, v + a * part
    return math.inf


def random_loop(random: np.random.Generator) -> Loop:
    period, mass = 10.0 ** random.uniform(-3.0, -2.0), 10.0 ** random.uniform(-1.5, 0.0)
    w = 10.0 ** random.uniform(-1.5, -0.3) / period
    gains: Any = {"stiffness": mass * w * w, "damping": 2.0 * random.uniform(0.0, 0.3) * mass * w}
    return Loop(period=period, delay=period * random.choice([0.0, 0.3, 0.5, 1.0, 1.5]), inertia=mass, **gains)


def test_the_released_handle_leaves_when_it_does_in_a_simulation() -> None:
    """Within half a period of the ringing, at the next peak."""
    random, late, outside = np.random.default_rng(7), list[float](), 0
    while len(late) < 60:
        loop = random_loop(random)
        release = held_of(loop).release
        if release is None:
            continue
        assert release.force == FORCE and release.rest == pytest.approx(FORCE / loop.stiffness)
        assert held_of(loop, reach=[release.rest] * 6).leaves_after == 0.0
        if outside_now := release.rest >= REACH:
            outside += 1
            assert release.time == 0.0 and "outside its range of 4.5 mm" in release.words
        # all is linear: a hand of 2 % of the force that moves it to the end
        share = 0.02 * REACH / release.rest
        small = held_of(loop, reach=[REACH / share] * 6).release
        assert small is not None
        if (outside_now and small.rest >= small.reach) or not 0.0 < small.time < 1.0:
            continue
        late.append((flown(loop, share * FORCE, REACH, 3.0) - small.time) / small.uncertainty)
    assert 0.0 < min(late) and max(late) < 1.03 and outside


def test_verdicts_of_random_loops_are_those_of_their_matrices() -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        loop, hand = random_loop(random), str(random.choice(["arm", "stylus", "fingertip"]))
        values: Any = {"mode": Mode(900.0, 0.05, -0.4), "driver_lag": 2e-4, "own_damping": 0.3}
        values |= {"device": DeviceLaw(10.0, 0.2, loop.period / 4.0, 2e-4), "velocity": LowPass(cutoff=90.0)}
        for name in random.permutation([*values])[:2]:
            loop = replace(loop, **{name: values[name]})
        found = held_of(replace(loop, hand=get_hand(hand)))
        for name, part in found.parts.items():
            radius = replace(loop, hand=get_hand("none" if name == FREE else name)).spectral_radius
            assert part.radius == radius and part.stable == (radius < 1.0)
        release = found.release
        assert (release is None) == (found.parts[FREE].stable is True)
        if release is not None:
            static = loop.stiffness + (loop.device.stiffness if loop.device else 0.0)
            assert release.rest == pytest.approx(FORCE / static, rel=0.02)  # a mode's deflection aside


def test_a_rotary_handle_is_held_by_a_torque() -> None:
    turned = Loop(stiffness=20.0, damping=0.02, period=5e-3, delay=5e-3, inertia=1e-3, axis="rx")
    found = held_of(turned)
    release = found.release
    assert release is not None and release.force == FORCE * LEVER_ARM and release.reach == RANGE[3]
    assert release.rest == pytest.approx(0.05 / 20.0)
    assert "0.05 N m" in release.words and "mrad" in release.words
    assert len({part.radius for part in found.parts.values()}) == 1  # the published hands do not turn it
    assert len(found.lines) == 1


def test_a_hand_of_the_loop_is_a_part() -> None:
    loop = loop_of(0.7, 6000, 80, 5, 5)
    own = Hand(mass=0.3, damping=40.0, stiffness=60.0)
    found = held_of(loop, own=own)
    assert [*found.parts] == [FREE, *(name for name in HANDS if name != "none"), OWN]
    assert found.parts[OWN].radius == replace(loop, hand=own).spectral_radius
    assert "own hand" in found.lines[0]
    assert held_of(replace(loop, hand=own)).lines == found.lines
    assert OWN not in held_of(loop, own=get_hand("stylus")).parts  # a published one by name


def test_a_motion_that_does_not_ring_moves_away() -> None:
    words = Release("z", 1.0, 1e-3, 4.5e-3, 0.0, 0.3, 0.0).words
    assert words == "released with 1 N it moves away without ringing and passes 4.5 mm after about 0.3 s"
    assert "at once" in Release("z", 1.0, 1e-3, 4.5e-3, 9.0, 0.0, 0.05).words


def test_what_is_not_judged_is_not_called_stable() -> None:
    assert Held((), judged=False).lines == ("held    not computed",)
    assert Held((), judged=False).as_json()["arm"] == {"stable": None, "radius": None, "critical_delay": None}
    partly = replace(held_of(loop_of(0.7, 6000, 80, 5, 5)), judged=False)
    assert partly.lines[0] == "held    arm not computed, stylus unstable, fingertip unstable; free unstable"
    assert len(partly.lines) == 1
