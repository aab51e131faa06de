"""MuJoCo against the exact plant: translations to rounding, rotations to a microradian."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES, Controller, ExactPlant, Hold, MuJoCoPlant, Timing, Wall, drive
from maglev_mj.frames import Array
from maglev_mj.plants import SampledPlant
from maglev_mj.spec import INERTIA
from tests.sweeps import sweep


def cross(plant: SampledPlant, axis: str, side: int, size: float, mass: float = INERTIA[0]) -> Array:
    """Return the axis over time as the flotor hits its wall, the other axes held."""
    body = np.array([mass] * 3 + [*INERTIA[3:]])
    share = body[AXES.index(axis)] / INERTIA[0]
    # the same dimensionless wall for every inertia
    gains: Any = {"stiffness": 6000.0 * share, "damping": 80.0 * share, "pulse": 220.0 * share}
    edge: Any = {"lower": 0.0} if side > 0 else {"upper": 0.0}
    wall = Wall(axes=axis, pulse_width=0.003, **gains, **edge)
    others = [name for name in AXES if name != axis]
    inertia = np.delete(body, AXES.index(axis))
    hold = Hold.critically_damped(others, inertia=inertia, period=0.005, delay=0.0015)
    # a weak spring pulls the flotor into the wall, again and again
    spring = Hold(axes=axis, stiffness=600.0 * share, damping=0.0)
    drive(plant, Controller([wall, hold, spring], period=0.005), 80)
    times = np.arange(400) * 1e-3
    motion: Array = plant.trace().at(times)[0][:, AXES.index(axis)] / size
    return motion


def start(axis: str, side: int, size: float) -> dict[str, Any]:
    """Return a pose `size` away from the wall, at rest."""
    pose = np.zeros(6)
    pose[AXES.index(axis)] = side * size
    return {"pose": pose, "gravity": 0.0, "record": True}


@pytest.mark.parametrize("phases", [2, pytest.param(8, marks=pytest.mark.study)])
@pytest.mark.parametrize("axis", sweep(AXES, every=2))
def test_the_plants_as_they_come_agree_on_every_axis(axis: str, phases: int) -> None:
    """Plants agree on throws at walls on every axis."""
    turns = AXES.index(axis) >= 3
    size = math.radians(1.0) if turns else 2e-3
    bounds = {"coils": 1e-14, "ideal": 1e-14, "corrected": 1e-14, "heavy": 1e-14}
    if turns:
        bounds |= {"coils": 1e-6, "corrected": 1e-9, "heavy": 1e-6}
    gaps = dict.fromkeys(bounds, 0.0)
    for side, phase in itertools.product((1, -1), np.arange(phases) / phases):
        timing, at = Timing(phase=float(phase)), start(axis, side, size)
        truth = cross(ExactPlant(timing, **at), axis, side, 1.0)
        engines = {
            "coils": MuJoCoPlant(timing, **at),
            "ideal": MuJoCoPlant(timing, coils=False, **at),
            "corrected": MuJoCoPlant(timing, integrator="corrected", coils=False, **at),
        }
        for name, engine in engines.items():
            gaps[name] = max(gaps[name], float(np.abs(cross(engine, axis, side, 1.0) - truth).max()))
        if side > 0:  # another mass, in the model with a handle of its own
            heavy = MuJoCoPlant(timing, model="maglev", mass=1.4, **at), ExactPlant(timing, mass=1.4, **at)
            one, other = (cross(plant, axis, side, 1.0, 1.4) for plant in heavy)
            gaps["heavy"] = max(gaps["heavy"], float(np.abs(one - other).max()))
    assert all(gaps[name] < bound for name, bound in bounds.items()), gaps


def test_rotations_about_several_axes_differ_by_the_second_order_of_the_angle() -> None:
    # The exact plant decouples the rotations: held against the engine, its error falls with the angle squared.
    gaps = []
    for size in np.radians([1.0, 0.5, 0.25]):
        pose = np.array([0.0, 0.0, 0.0, size, -0.8 * size, 0.6 * size])
        plants = (
            MuJoCoPlant(pose=pose, gravity=0.0, coils=False, record=True),
            ExactPlant(pose=pose, gravity=0.0, record=True),
        )
        motions = []
        for plant in plants:
            springs = Hold(stiffness=[600.0] * 3 + [0.8] * 3, damping=0.0)
            drive(plant, Controller([springs], period=0.005), 40)
            motions.append(np.stack([plant.trace().at(t)[0][0] for t in np.arange(40) * 0.005]))
        gaps.append(np.abs(motions[0] - motions[1]).max())
    slopes = np.diff(np.log(gaps)) / np.log(0.5)
    assert gaps[0] < 5e-5
    assert (slopes > 1.8).all(), (gaps, slopes)
