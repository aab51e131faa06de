"""Drop experiment against a second implementation, and its figures."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest

from maglev_mj.plants.trace import Trace
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.figures import BounceSummary, perceived_hardness
from maglev_mj.scenes.run import run, run_phases
from tests.sweeps import sweep

G = 9.81


def reference(p: Drop, phase: float, times: list[float]) -> tuple[list[float], list[float]]:
    """Return z and force at given times, computed independently from a list of switches."""
    switches: list[tuple[float, float]] = [(0.0, 0.0)]

    def state(at: float) -> tuple[float, float, float]:
        z, v, f = p.height, 0.0, 0.0
        for place, (start, force) in enumerate(switches):
            if start > at:
                break
            end = min(switches[place + 1][0] if place + 1 < len(switches) else at, at)
            step, a, f = end - start, force / p.mass - G, force
            z, v = z + v * step + 0.5 * a * step * step, v + a * step
        return z, v, f

    def clip(force: float) -> float:
        return force if not p.force_limit else min(max(force, -p.force_limit), p.force_limit)

    before = math.nan
    for k in range(int(p.duration / p.period) + 1):
        at = (k + phase) * p.period
        z = state(at)[0]
        if p.quantize:
            z = round(z / p.quantize) * p.quantize
        moved = 0.0 if k == 0 else z - before
        held = -p.stiffness * z - p.damping / p.period * moved if z <= 0.0 else 0.0
        effect = at + p.delay
        while switches[-1][0] >= effect:  # the next command ends what is left of a pulse
            switches.pop()
        if k > 0 and before > 0.0 >= z and p.pulse > 0.0:
            switches.append((effect, clip(-(p.pulse + p.damping) / p.period * moved)))
            effect += p.pulse_width
        switches.append((effect, clip(held)))
        before = z
    rows = [state(at + 1e-13) for at in times]
    return [row[0] for row in rows], [row[2] for row in rows]


CASES: list[dict[str, Any]] = [
    {},
    {"phase": 0.37, "height": 3e-3},
    {"pulse": 0.0, "phase": 0.9},
    {"force_limit": 60.0},
    {"delay": 0.0, "phase": 0.21},
    {"delay": 0.005, "stiffness": 3000.0, "damping": 55.0, "phase": 0.6},
    {"delay": 0.004, "stiffness": 3000.0, "damping": 55.0, "phase": 0.6},
    {"delay": 0.007, "stiffness": 1500.0, "damping": 35.0, "pulse": 50.0},
    {"quantize": 5e-6, "phase": 0.13},
    {"period": 0.001, "delay": 0.0005, "pulse_width": 0.0009, "mass": 0.65},
    {"period": 0.002, "delay": 0.0015, "pulse_width": 0.01, "duration": 0.2},
]


@pytest.mark.parametrize(("changes", "plant"), sweep(CASES, ["exact", "mujoco"], every=2))
def test_drop_means_what_it_says(changes: dict[str, Any], plant: str) -> None:
    drop, phase = Drop(**{name: value for name, value in changes.items() if name != "phase"}), changes.get("phase", 0.0)
    series = run(drop, plant=plant, phase=phase).series()
    expected_z, expected_force = reference(drop, phase, series["time"].tolist())
    np.testing.assert_allclose(series["z"], expected_z, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(series["force"], expected_force, rtol=0.0, atol=1e-6)


def test_summary_is_that_of_a_fine_grid() -> None:
    for phase in (0.0, 0.3, 0.7):
        result = run(Drop(), plant="exact", phase=phase)
        figures = result.figures
        time, z, force = (result.series(1e-5)[name] for name in ("time", "z", "force"))
        assert figures["penetration"] == pytest.approx(-z.min(), abs=1e-8)
        assert figures["penetration"] >= -z.min()
        assert figures["peak_force"] == pytest.approx(np.abs(force).max(), rel=1e-12)
        contact = int(np.argmax(z <= 0.0))
        assert figures["rebound"] == pytest.approx(max(z[contact:].max(), 0.0), abs=1e-8)
        rest = result.scene.rest
        outside = np.flatnonzero(np.abs(z - rest) > 0.02 * (0.0045 - rest))
        assert figures["settling_time"] == pytest.approx(time[outside[-1]], abs=2e-4)


def test_a_drop_that_does_not_settle_says_so() -> None:
    result = run(Drop(duration=0.05), plant="exact")
    assert math.isnan(result.figures["settling_time"])
    assert result.as_json()["summary"]["settling_time"] is None
    bare = run(Drop(stiffness=0.0, damping=0.0, pulse=0.0, duration=0.02), plant="exact")
    assert math.isnan(bare.figures["settling_time"])
    assert bare.figures["penetration"] == 0.0


FURTHER, IN_ALL, NONE = 220.0, 140.0, 0.0  # the paper's 220 N s/m as further damping, and with the damping in it
HEIGHTS = sweep((4.5e-3, 3.6e-3, 3e-3, 2.6e-3, 1.7e-3, 1e-3), every=6)
PHASES, FEW = np.random.default_rng(15).uniform(0.0, 1.0, 100), np.arange(0.5, 30.0) / 30.0


@functools.cache
def pulsed(pulse: float, height: float = 4.5e-3, many: bool = False, **options: Any) -> BounceSummary:
    drop, phases = Drop(height=height, pulse=pulse, **{"force_limit": 0.0} | options), PHASES if many else FEW
    return BounceSummary(**run_phases(drop, phases, plant="exact").figures)


@pytest.mark.parametrize("height", HEIGHTS)
def test_both_readings_of_the_pulse_lessen_penetration_at_every_phase(height: float) -> None:
    plain = pulsed(NONE, height)
    assert (plain.peak_force < 60.0).all()  # so that the limit changes nothing without a pulse
    for pulse in (FURTHER, IN_ALL):
        for limit in (0.0, 60.0):
            assert (pulsed(pulse, height, force_limit=limit).penetration < plain.penetration).all()


@pytest.mark.parametrize("height", HEIGHTS)
def test_the_pulse_in_all_fits_the_figure_of_the_paper_at_every_phase(height: float) -> None:
    # Figure 3: a force axis from -20 to 80 N, and less oscillation with the pulse.
    in_all, plain = pulsed(IN_ALL, height), pulsed(NONE, height)
    assert (in_all.peak_force < 71.0).all()
    assert (in_all.settling_time < plain.settling_time).all()
    assert (in_all.rebound < plain.rebound + 0.04e-3).all()
    further = pulsed(FURTHER, height)
    if height >= 3.6e-3:
        assert (further.peak_force > 80.0).any()
        assert (further.rebound > plain.rebound).mean() > 0.95
    if 2e-3 <= height <= 3e-3:
        assert not (further.settling_time < plain.settling_time).all()


def test_at_the_limit_of_the_device_both_readings_are_one_drop() -> None:
    # From 4.5 mm; unless the braking that is cut off follows later.
    in_all, further = pulsed(IN_ALL, force_limit=60.0), pulsed(FURTHER, force_limit=60.0)
    np.testing.assert_allclose(in_all.penetration, further.penetration, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(in_all.rebound, further.rebound, rtol=0.0, atol=1e-6)
    later = [pulsed(pulse, many=True, force_limit=60.0, carry=True).rebound for pulse in (IN_ALL, FURTHER)]
    assert (later[1] > later[0]).all()
    assert np.median(later[0]) == 0.0 and np.median(later[1]) > 1e-3


@pytest.mark.parametrize("height", HEIGHTS)
def test_hardness_of_a_pulse_is_its_damping_over_the_window(height: float) -> None:
    # How many times as hard a pulse is, is a choice of its size and of the window.
    def hard(pulse: float, **options: Any) -> list[Any]:
        drop = Drop(height=height, pulse=pulse, **{"force_limit": 0.0} | options)
        trace = run(drop, plant="exact", phase=FEW).trace
        return [perceived_hardness(trace, window).extended for window in windows]

    windows = (0.005, 0.01)
    plain = hard(NONE)
    for pulse in (FURTHER, IN_ALL):
        for window, free, limited, bare in zip(windows, hard(pulse), hard(pulse, force_limit=60.0), plain, strict=True):
            assert np.median(free) == pytest.approx((pulse + 80.0) / window, rel=0.02)
            assert (free > bare).all() and (limited > bare).all()
            assert (limited < 1.01 * 60.0 / window / math.sqrt(2.0 * G * height)).all()


@pytest.mark.parametrize(
    ("changes", "labels"),
    [
        ({"pulse": 140.0}, ["+140 N s/m (220 total)", "no pulse"]),
        ({"damping": 0.0}, ["+220 N s/m (220 total)", "no pulse"]),
        ({"damping": 220.0}, ["+220 N s/m (440 total)", "no pulse"]),
        ({"damping": 60.0}, ["+220 N s/m (280 total)", "220 N s/m total", "no pulse"]),
        ({"pulse": 0.0}, ["no pulse"]),
    ],
)
def test_a_pulse_of_ones_own_has_one_reading(changes: dict[str, float], labels: list[str]) -> None:
    drop = Drop(**changes)  # type: ignore[arg-type]
    variants = drop.variants()
    assert list(variants) == labels
    assert next(iter(variants.values())) == drop


def test_unsettled_phases_count_as_late() -> None:
    sweep = run_phases(Drop(force_limit=0.0, duration=0.13), 20, plant="exact")
    data = sweep.as_json()
    assert data["settled"] == 19
    times = sweep.figures["settling_time"]
    finite = np.sort(times[np.isfinite(times)])
    assert data["median"]["settling_time"] == pytest.approx((finite[9] + finite[10]) / 2)
    assert data["percentile_95"]["settling_time"] is None


def test_hardness_is_that_of_the_first_contact_however_hard_later_ones_are() -> None:
    # By hand: a soft contact, away, and one of ten times the force.
    time = 0.01 * np.arange(7)
    pose, twist, wrench = (np.zeros((7, 6)) for _ in range(3))
    pose[:, 2] = [1e-3, -1e-3, 1e-3, 1e-3, -1e-3, 1e-3, 1e-3]
    twist[:, 2] = [-0.2, 0.0, 0.2, -0.2, 0.0, 0.2, 0.0]
    wrench[:, 2] = [0.0, 2.0, 0.0, 0.0, 20.0, 0.0, 0.0]
    whole, first, later = (
        perceived_hardness(Trace(time[part] - time[part][0], pose[part], twist[part], wrench[part]), 0.005).extended
        for part in (slice(None), slice(4), slice(3, None))
    )
    assert whole == first > 0.0
    assert later == pytest.approx(10.0 * first)


@pytest.mark.parametrize(("device", "still"), [("arm", True), ("ubc", False), ("stage", False)])
def test_a_device_without_gravity_is_said_not_to_fall(device: str, still: bool) -> None:
    warnings = run(Drop(device=device), plant="exact").warnings
    assert any("nothing moves" in text and "no gravity" in text for text in warnings) == still
