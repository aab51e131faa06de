"""Designed walls against dense samples, theory and simulation."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import HANDS
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run_phases
from maglev_mj.spec import GRAVITY
from maglev_mj.studies.designed_wall import ContactParameters, hardest_contact
from maglev_mj.theory import DesignedWall, WallRequirements, design_wall, is_stable, worst_case
from maglev_mj.theory.boundary import ranges_of
from tests.sweeps import further

SLACK = "0.3,10,500,2,3000"
EVERYTHING: dict[str, Any] = {"mass": (0.56, 0.84), "delay": (0.0012, 0.0018), "hand": tuple(HANDS)}
BOXES: list[dict[str, Any]] = [
    EVERYTHING,
    {**EVERYTHING, "spectral_radius": 0.9},
    {"period": 0.001, "delay": (0.0008, 0.0012), "mass": (0.6, 0.8), "hand": ("none", "stylus"), "driver_lag": 8e-5},
    {"mass": (0.3, 1.4), "delay": (0.004, 0.006), "hand": ("none", "fingertip", SLACK), "spectral_radius": 0.99},
    # walls of an island keep to this spectral radius
    {
        "period": 8.5065e-3,
        "mass": (0.3067,) * 2,
        "delay": (1.6242e-3,) * 2,
        "hand": ("1.70343,5.66451,363.848,23.7146,7005.97",),
        "spectral_radius": 0.999,
    },
]


def densely(wall: DesignedWall, seed: int, count: int = 1000) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the spectral radii of random cases unknown to the design, with edges of the ranges."""
    random, needs = np.random.default_rng(seed), wall.requirements
    spectral_radii = []
    for hand in needs.hands:
        mass, delay = (
            np.clip(low + (high - low) * random.uniform(-0.2, 1.2, count), low, high)
            for low, high in (needs.bodies, needs.delay)
        )
        loop = needs.loop(inertia=1.0, hand=needs.holding(hand)).array(inertia=mass, delay=delay)
        spectral_radii.append(loop.spectral_radius(wall.stiffness, wall.damping))
    return np.concatenate(spectral_radii)


def test_without_uncertainty_it_is_the_stiffest_wall() -> None:
    wall = design_wall(WallRequirements(spectral_radius=1.0))
    assert wall.stiffness == pytest.approx(10173.44, rel=1e-5)
    assert wall.damping == pytest.approx(87.57, rel=1e-2)


@pytest.mark.parametrize("box", [2, *further(0, 1, 3, 4)])
def test_every_case_of_the_product_keeps_to_the_spectral_radius(box: int) -> None:
    wall = design_wall(WallRequirements(**BOXES[box]))
    allowed = wall.requirements.spectral_radius
    assert densely(wall, seed=3).max() <= allowed * (1.0 + 1e-6)
    assert wall.spectral_radius == pytest.approx(allowed, rel=1e-3)  # and none of it is given away
    # softer walls are stable too, at the corners and elsewhere
    for _, loop in wall.requirements.loops(wall.requirements.random(10, seed=9)):
        for place in range(loop.shape[0]):
            low, high = ranges_of(loop.part(loop.shape, place), wall.damping)[0]
            assert low == 0.0 and high >= wall.stiffness


@pytest.mark.parametrize("count", [2000, pytest.param(20000, marks=pytest.mark.study)])
def test_the_worst_case_is_searched_for_between_the_points_of_a_grid(count: int) -> None:
    hands = ("1.0,3,300,1,9000", "none")
    needs = WallRequirements(period=0.00588, mass=(0.8638, 0.8896), delay=(0.0061, 0.00945), hand=hands)
    wall = replace(design_wall(WallRequirements()), requirements=needs)
    spectral_radius, case = worst_case(needs, 1817.0, 77.3)
    assert spectral_radius >= densely(replace(wall, stiffness=1817.0, damping=77.3), seed=2, count=count).max()
    assert needs.spectral_radii([case], 1817.0, 77.3) == pytest.approx(spectral_radius, rel=1e-12)


LIGHT = "1.5,8,300,0.4,30000"
SEVERAL = (*HANDS, "none", LIGHT, SLACK, "1,3,300,1,9000", "5,10,100,20,100000", "0.1,0.3,100,0.2,2000")


def random_needs(seed: int) -> WallRequirements:
    random = np.random.default_rng(seed)
    period, mass = 10.0 ** random.uniform(-3.3, -2.0), 10.0 ** random.uniform(-0.7, 0.3)
    delay = random.uniform(0.0, 1.5) * period
    return WallRequirements(
        period=period,
        mass=(mass, mass * random.uniform(1.0, 2.0)),
        delay=(delay, delay * random.uniform(1.0, 1.5)),
        hand=list(dict.fromkeys(map(str, random.choice(SEVERAL, random.integers(1, 3), replace=False)))),
        spectral_radius=float(random.choice([0.9, 0.97, 0.99, 0.999, 1.0])),
    )


def scanned(needs: WallRequirements, stiffness: float, count: int) -> float:
    """Return the largest stiffness that a dense scan over both gains admits; `stiffness` is among them."""
    unit = needs.nominal[0] / needs.period
    dampings = np.array([0.0, *np.geomspace(1e-4, 8.0, count)]) * unit
    gains = np.sort([stiffness, *np.geomspace(1e-6, 2.0, 60) * unit / needs.period])[:, None]
    most = np.zeros((gains.size, dampings.size))
    for _, loops in needs.loops(needs.grid(4)):
        for place in range(loops.shape[0]):
            np.maximum(most, loops.part(loops.shape, place).spectral_radius(gains, dampings), out=most)
    borne = np.logical_and.accumulate(is_stable(most), axis=0) & (most <= needs.spectral_radius)
    return float((gains * borne).max())


@pytest.mark.parametrize(
    ("seeds", "count"),
    [((6,), 40), *(pytest.param(range(first, 30, 6), 150, marks=pytest.mark.study) for first in range(6))],
)
def test_no_wall_of_a_dense_scan_is_stiffer_than_the_designed_one(seeds: Iterable[int], count: int) -> None:
    for seed in seeds:
        needs = random_needs(seed)
        try:
            wall = design_wall(needs)
        except ParameterError:
            assert scanned(needs, 0.0, count) == 0.0, seed
            continue
        assert scanned(needs, 1.01 * wall.stiffness, count) < 1.01 * wall.stiffness, seed
        assert densely(wall, seed, 300).max() <= needs.spectral_radius * (1.0 + 1e-6), seed


def test_a_wall_is_found_where_few_dampings_admit_one() -> None:
    # One of a grid of 1000 dampings admits a wall.
    around: dict[str, Any] = {"mass": (0.995006, 1.397408), "delay": (0.001809, 0.001892)}
    wall = design_wall(WallRequirements(period=1.0 / 1700.0, hand=["stylus"], **around))
    assert wall.stiffness == pytest.approx(7534.6, rel=2e-4)
    assert wall.spectral_radius <= 0.97 * (1.0 + 1e-9)


def test_a_pulse_stops_the_lightest_flotor_and_lessens_the_depth() -> None:
    wall = design_wall(WallRequirements(**{**EVERYTHING, "hand": ("none",)}))
    plain, braked = ContactParameters(force_limit=0.0), ContactParameters(force_limit=0.0, pulse=True)
    assert braked.pulse_of(wall) == pytest.approx(0.56 / 0.003 - wall.damping)
    assert plain.pulse_of(wall) == 0.0
    (deep, soft), (shallow, hard) = hardest_contact(wall, plain), hardest_contact(wall, braked)
    assert shallow < deep and hard > soft
    drop = Drop(height=0.2**2 / (2.0 * GRAVITY), stiffness=wall.stiffness, damping=wall.damping, pulse=0.0)
    drops = [drop.replace(mass=m, delay=d) for m, d in product(EVERYTHING["mass"], EVERYTHING["delay"])]
    deepest = max(run_phases(scene, 100, plant="exact").figures["penetration"].max() for scene in drops)
    assert deep == pytest.approx(deepest, rel=0.03)  # 8 phases of 100


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"delay": (0.0, 1.06)}, r"delay must be between 0 and 1 s \(got 1.06"),
        ({"hand": ("arm", "arm")}, "hand must be at least one, without duplicates .got arm, arm"),
        ({"spectral_radius": 1.01}, r"spectral_radius must be above 0 and at most 1.* \(got 1.01"),
    ],
)
def test_bad_requirements_are_refused_with_the_value(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        design_wall(WallRequirements(**options))


@pytest.mark.parametrize("drawn", [False, pytest.param(True, marks=pytest.mark.study)])
def test_the_command_prints_and_writes_a_design(drawn: bool, tmp_path: Any, capsys: Any) -> None:
    arguments = ["design", "--mass", "0.6:0.8", "--hand", "arm", "--pulse", *(["--out", str(tmp_path)] * drawn)]
    assert main([*arguments, "--json", str(tmp_path / "design.json")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "mass 0.6 to 0.8 kg, delay 1.5 ms" in said and "hand: none, arm" in said and "not settling: none" in said
    assert not drawn or (tmp_path / "design.png").read_bytes().startswith(b"\x89PNG")
    data = json.loads((tmp_path / "design.json").read_text())
    assert data["wall"]["requirements"]["hand"] == ["none", "arm"] and data["wall"]["spectral_radius"] <= 0.97 * (
        1.0 + 1e-9
    )
    assert len(data["cases"]) >= 200 and not any(data["grows"])
    assert np.max(data["map"]) <= data["wall"]["spectral_radius"] * (1.0 + 1e-6)


def test_a_wall_that_goes_on_ends_with_status_1(capsys: Any) -> None:
    assert main(["design", "--spectral-radius", "1"]) == 1
    said = capsys.readouterr().out
    assert "10173" in said and "not settling: " in said and "hand none" in said


def test_a_scene_gives_rate_delay_and_mass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Of a file too; what is given as an option goes before.
    (tmp_path / "fast.py").write_text(
        "from maglev_mj.scenes.drop import Drop\n\n\nclass Fast(Drop):\n"
        "    def plant_options(self):\n        return {'mass': 0.5}\n"
    )
    monkeypatch.chdir(tmp_path)
    asked: list[Any] = []

    def keep(needs: WallRequirements, *_: Any, **__: Any) -> None:
        asked.append(needs)
        raise ParameterError("needs must be kept")

    monkeypatch.setattr("maglev_mj.cli.studies.design_wall", keep)
    given = "--period 0.005 --delay 0.0015 --mass 0.5"
    for words in ("fast.py", given, "drop", "", "fast.py --mass 0.7 --period 0.004"):
        assert main(["design", *words.split(), "--json", "-"]) == 2
    file, options, drop, none, both = asked
    assert file == options != drop == none and both not in (file, drop)
