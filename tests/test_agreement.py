"""MuJoCo against the exact plant: translations to rounding, rotations to a microradian."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES, Controller, ExactPlant, Hold, MuJoCoPlant, Timing, Wall, run
from maglev_mj.experiments.drop import DropParameters, run_drop
from maglev_mj.frames import Array
from maglev_mj.plants import SampledPlant
from tests.closed_loop import largest_modulus

HEIGHTS = (0.5e-3, 1.5e-3, 2.5e-3, 3.5e-3, 4.5e-3)
PHASES = tuple(k / 20 for k in range(20))
# gains stable at each delay; the test itself checks that they are
GAINS = {0.0: (12000.0, 110.0), 0.0015: (6000.0, 80.0), 0.005: (3000.0, 55.0)}


@pytest.mark.parametrize("delay", GAINS)
@pytest.mark.parametrize("pulse", [0.0, 220.0])
@pytest.mark.parametrize("limit", [None, 60.0])
@pytest.mark.parametrize("phases", [PHASES[3::7], pytest.param(PHASES, marks=pytest.mark.study)], ids=len)
def test_drops_agree_within_a_nanometre(
    delay: float, pulse: float, limit: float | None, phases: tuple[float, ...]
) -> None:
    """Heights 0.5-4.5 mm, 20 phases, three delays, pulse on and off, clipped and unclipped: 1200 drops in all."""
    stiffness, damping = GAINS[delay]
    assert largest_modulus(stiffness, damping, period=0.005, delay=delay, mass=0.7) < 1.0
    worst = 0.0
    for height in HEIGHTS:
        for phase in phases:
            drop = DropParameters(
                height=height,
                phase=phase,
                delay=delay,
                stiffness=stiffness,
                damping=damping,
                pulse=pulse,
                force_limit=limit,
                carry=limit is not None,
            )
            engine, exact = (run_drop(replace(drop, plant=plant)).series()[1] for plant in ("mujoco", "exact"))
            worst = max(worst, float(np.abs(engine - exact).max()))
    assert worst < 1e-9
    assert worst < 1e-14  # what RK4 with a step boundary at every switch really gives


def cross(plant: SampledPlant, axis: str, side: int, size: float, inertia: float) -> Array:
    """Throw the flotor at a wall at 0 along one axis, the others held; return that axis over time."""
    # the same dimensionless wall for every inertia
    gains = {"stiffness": 6000.0 * inertia / 0.7, "damping": 80.0 * inertia / 0.7, "pulse": 220.0 * inertia / 0.7}
    edge = {"lower": 0.0} if side > 0 else {"upper": 0.0}
    wall = Wall(axes=axis, pulse_width=0.003, **gains, **edge)
    others = [name for name in AXES if name != axis]
    moments = np.delete([0.7] * 3 + [9.2669e-4] * 2 + [8.16e-4], AXES.index(axis))
    hold = Hold.critically_damped(others, inertia=moments, period=0.005, delay=0.0015)
    # a weak spring pulls the flotor into the wall, again and again
    spring = Hold(axes=axis, stiffness=600.0 * inertia / 0.7, damping=0.0)
    run(plant, Controller([wall, hold, spring], period=0.005), 80)
    times = np.arange(400) * 1e-3
    motion: Array = plant.trace().at(times)[0][:, AXES.index(axis)] / size
    return motion


def start(axis: str, side: int, size: float) -> dict[str, Any]:
    """Return a pose `size` away from the wall, at rest."""
    pose = np.zeros(6)
    pose[AXES.index(axis)] = side * size
    return {"pose": pose, "gravity": 0.0, "record": True}


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("axis", AXES)
def test_every_axis_and_side_behaves_as_z_does(axis: str, side: int) -> None:
    """In units of the start and of the inertia, all twelve walls give one curve."""
    size = 1e-3 if AXES.index(axis) < 3 else math.radians(1.0)
    moments = [9.2669e-4, 9.2669e-4, 8.16e-4]
    inertia = ([0.7] * 3 + moments)[AXES.index(axis)]
    plant = ExactPlant(Timing(phase=0.2), mass=0.7, inertia=moments, **start(axis, side, size))
    reference = ExactPlant(Timing(phase=0.2), mass=0.7, inertia=moments, **start("z", 1, 1e-3))
    motion = cross(plant, axis, side, side * size, inertia)
    np.testing.assert_allclose(motion, cross(reference, "z", 1, 1e-3, 0.7), atol=1e-12)
    assert motion.min() < -0.02  # it does go into the wall


@pytest.mark.parametrize("coils", [True, False])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("axis", ["rx", "ry", "rz"])
def test_rotations_agree_within_a_microradian_at_one_degree(axis: str, side: int, coils: bool) -> None:
    size = math.radians(1.0)
    engine = MuJoCoPlant(Timing(phase=0.2), coils=coils, **start(axis, side, size))
    inertia = engine.device.inertia
    exact = ExactPlant(Timing(phase=0.2), inertia=inertia, **start(axis, side, size))
    moment = float(inertia[AXES.index(axis) - 3])
    gap = np.abs(cross(engine, axis, side, 1.0, moment) - cross(exact, axis, side, 1.0, moment)).max()
    assert gap < (1e-6 if coils else 1e-14)


def test_rotations_about_several_axes_differ_by_the_second_order_of_the_angle() -> None:
    """The exact plant decouples the rotations: held against the engine, its error falls with the angle squared."""
    gaps = []
    for size in np.radians([1.0, 0.5, 0.25]):
        pose = np.array([0.0, 0.0, 0.0, size, -0.8 * size, 0.6 * size])
        plants = (
            MuJoCoPlant(pose=pose, gravity=0.0, coils=False, record=True),
            ExactPlant(pose=pose, gravity=0.0, inertia=[9.2669e-4, 9.2669e-4, 8.16e-4], record=True),
        )
        motions = []
        for plant in plants:
            springs = Hold(stiffness=[600.0] * 3 + [0.8] * 3, damping=0.0)
            run(plant, Controller([springs], period=0.005), 40)
            motions.append(np.stack([plant.trace().at(t)[0][0] for t in np.arange(40) * 0.005]))
        gaps.append(np.abs(motions[0] - motions[1]).max())
    slopes = np.diff(np.log(gaps)) / np.log(0.5)
    assert gaps[0] < 5e-5
    assert (slopes > 1.8).all(), (gaps, slopes)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_translations_agree_to_rounding_on_every_axis(axis: str) -> None:
    engine, exact = (plant(Timing(phase=0.2), **start(axis, 1, 2e-3)) for plant in (MuJoCoPlant, ExactPlant))
    gap = np.abs(cross(engine, axis, 1, 1.0, 0.7) - cross(exact, axis, 1, 1.0, 0.7)).max()
    assert gap < 1e-14
