"""Settings that other programs ask for: walls of their own, and whether they would be stable."""

import json
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES
from maglev_mj.errors import ParameterError
from maglev_mj.laws import Hold, StickSlip
from maglev_mj.scenes import find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import InteractiveScene
from maglev_mj.scenes.joystick import Joystick
from maglev_mj.scenes.parts import INERTIA, MASS
from maglev_mj.scenes.table import Table
from maglev_mj.session import Pacer, Session, refusal
from maglev_mj.theory import largest_stable_stiffness


@pytest.mark.parametrize(
    ("walls", "says"),
    [
        (5, "walls must be a list"),
        ({}, "walls must be a list"),
        (["z"], "a wall must be an axis, a normal and an edge, not 'z'"),
        ([["q", 1, 0.0]], "a wall's axis must be one of x, y, z, rx, ry, rz, not 'q'"),
        ([["z", 2, 0.0]], "a wall's normal must be 1 or -1, not 2"),
        ([["z", 1, "low"]], "a wall's edge must be a finite number"),
        ([["z", 1, 0.0], ["z", 1, 0.1]], "not two of normal 1 on z"),
        ([["z", 1, 0.002], ["z", -1, 0.001]], "walls must leave room between them, not 0.002 to 0.001 on z"),
    ],
)
def test_walls_that_are_none_are_refused(walls: Any, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        Joystick.from_json({"walls": walls})


@pytest.mark.parametrize("name", ["joystick", "table", "box", "corner"])
def test_walls_of_the_settings_take_the_place_of_the_scenes_own(name: str) -> None:
    cls, walls = find_scene(name), [("x", 1, -0.002), ("rz", -1, 0.03), ("z", 1, 0.001), ("z", -1, 0.003)]
    scene = cls().replace(wall=True, friction=False, walls=walls)
    faces = scene.controller().faces
    assert sorted(faces) == sorted((AXES.index(axis), float(normal), edge) for axis, normal, edge in walls)
    assert scene.replace(wall=False).controller().faces == ()
    assert scene.replace(walls=[]).controller().faces == ()
    assert cls.from_json(json.loads(json.dumps(scene.as_json()))) == scene


def test_breakaway_is_where_friction_lets_go() -> None:
    for breakaway in (1.0, 4.0):
        (law,) = (law for law in Table(breakaway=breakaway).laws() if isinstance(law, StickSlip))
        assert np.max(law.breakaway) == breakaway


@pytest.mark.parametrize("period", [0.005, 0.001])
@pytest.mark.parametrize("delay", [0.0, 0.0015, 0.004])
@pytest.mark.parametrize("name", ["joystick", "table", "box", "corner"])
def test_settings_are_refused_from_the_boundary_of_theory_on(name: str, period: float, delay: float) -> None:
    """Just below the largest stable stiffness they may be had, just above they may not, with the figures of theory."""
    chosen = find_scene(name)().replace(period=period, delay=delay, pulse=False)
    assert isinstance(chosen, InteractiveScene)
    on = "friction" if chosen.friction else "walls"
    held = [law for law in chosen.laws() if isinstance(law, Hold)]
    springs = max(float(np.max(law.stiffness)) for law in held if "x" in law.axes) if name != "table" else 0.0
    dampers = max(float(np.max(law.damping)) for law in held if "x" in law.axes) if name != "table" else 0.0
    bound = float(largest_stable_stiffness(chosen.damping + dampers, period=period, delay=delay, mass=MASS))
    assert refusal(chosen.replace(stiffness=0.999 * (bound - springs))) is None
    refused = refusal(chosen.replace(stiffness=1.001 * (bound - springs)))
    assert refused is not None and refused.acting == on and refused.modulus > 1.0
    share = 1.0 if refused.axis in AXES[:3] else INERTIA[AXES.index(refused.axis)] / MASS
    assert refused.largest_stable == pytest.approx(bound * share, rel=1e-6)
    assert refused.largest_stable is not None and refused.stiffness > refused.largest_stable
    assert "must be below 1" in str(refused) and "stable up to" in str(refused)


@pytest.mark.parametrize("above", [False, True])
def test_what_is_refused_makes_energy_and_what_is_not_does_not(above: bool) -> None:
    """In the simulation, at 1.3 and 0.8 of the boundary, pressed against the wall."""
    chosen = Drop(pulse=0.0)
    bound = float(largest_stable_stiffness(chosen.damping, period=chosen.period, delay=chosen.delay, mass=MASS))
    scene = chosen.replace(stiffness=(1.3 if above else 0.8) * bound)
    assert (refusal(scene) is not None) is above
    session = Session(scene, pacer=Pacer(budget=60.0, patience=3600.0))
    for _ in range(180):
        session.tick(1.0 / 60.0)
    assert any("unstable" in note for note in session.snapshot().notes) is above
