"""Map of a wall: stable, passive with the device's own damping, quiet on a quantized sensor with friction."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, Hold, Sensor, Timing, diagnose, theory
from maglev_mj.cli import main
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import ParameterError
from maglev_mj.studies.stability_map import RestingWall, StabilityMap, StabilityParameters, run_stability
from maglev_mj.studies.sweep import Grid


def test_a_quiet_wall_comes_to_rest_wherever_it_is() -> None:
    """Below the bound of friction and sensor resolution all flotors do; far above it some never do."""
    generator, count, period, quantum = np.random.default_rng(11), 600, 0.005, 5e-6
    delay = period * generator.choice([0.0, 0.2, 0.5, 0.9], count)
    stiffness = 0.5 / period**2 * 10.0 ** generator.uniform(-2.0, -0.7, count)
    damping = 0.5 / period * generator.uniform(0.05, 0.7, count)
    settles = theory.spectral_radius(stiffness, damping, period=period, delay=delay, mass=0.5) < 0.95
    delay, stiffness, damping = delay[settles], stiffness[settles], damping[settles]
    share = np.where(generator.random(len(delay)) < 0.5, 0.99, 10.0)  # of the bound
    friction = np.full((len(delay), 6), 1e-9)
    friction[:, 0] = (stiffness + 2.0 * damping / period) * quantum / (2.0 * share)
    for force in friction[:3, 0]:  # as the map says
        one = StabilityParameters(period=period, friction=float(force), quantum=quantum, grid=2)
        row = int(np.flatnonzero(friction[:, 0] == force)[0])
        bound = replace(_map(), parameters=one).quiet_stiffness(damping[row : row + 1])
        assert (stiffness[row] < bound[0]) == (share[row] < 1.0)
    target, pose = quantum * (200.0 + generator.choice([0.5, 0.49, 0.25], (len(delay), 1))), np.zeros((len(delay), 6))
    pose[:, :1] = target + 2e-4
    law = Hold(axes="x", stiffness=stiffness[:, None], damping=damping[:, None], target=target)
    sensor, places = Sensor(quantum=[quantum, *[0.0] * 5]), list[Any]()
    with ExactPlant(
        Timing(period=period, delay=delay), mass=0.5, pose=pose, gravity=0.0, dry_friction=friction, sensor=sensor
    ) as plant:
        loop = ControlLoop(plant, Controller([law], period=period))
        loop.cycle(300)
        for _ in range(40):
            loop.cycle()
            places.append(plant.state()[0][:, 0])
    moves = np.ptp(places, axis=0) > 1e-6 * quantum
    assert not moves[share < 1.0].any() and moves[share > 1.0].sum() >= 5


def _map() -> StabilityMap:
    loop: dict[str, Any] = {"period": 1e-3, "delay": 5e-4}
    return run_stability(StabilityParameters(**loop, mass=0.15, own_damping=20.0, friction=0.6, quantum=1e-5, grid=12))


def test_a_map_of_stable_passive_and_quiet_walls() -> None:
    found = _map()
    cells = found.cells()
    least = theory.least_passive_damping(found.stiffness[:, None], found.damping, period=1e-3, delay=5e-4)
    assert (cells["passive"] == (least <= 20.0)).all() and cells["passive"].any() and not cells["passive"].all()
    stable = theory.is_stable(found.spectral_radius)
    assert (cells["quiet"] == (stable & (found.stiffness[:, None] <= 1.2e5 - 2e3 * found.damping))).all()
    assert cells["quiet"].any() and not (cells["passive"] & ~stable).any()
    alone = replace(found, parameters=StabilityParameters(period=1e-3, delay=5e-4))
    assert alone.cells().keys() == {"spectral_radius"}


@pytest.mark.parametrize(
    "effect", [{}, {"cutoff": 100.0}, {"driver_lag": 5e-4}, {"mode": "120,0.05,-1"}, {"hand": "arm"}]
)
def test_a_passive_wall_is_stable_and_none_is_called_passive_with_a_lag_or_a_mode(effect: dict[str, Any]) -> None:
    found = run_stability(StabilityParameters(own_damping=100.0, grid=14, **effect))
    passive = found.cells().get("passive")
    assert (passive is None) == bool(effect.keys() & {"driver_lag", "mode"})
    if passive is not None:
        assert passive.any() and not (passive & ~theory.is_stable(found.spectral_radius)).any()
    law: Any = {"stiffness": 6000.0, "damping": 80.0, "period": 5e-3, "delay": 1.5e-3, "mass": 0.7}
    assert np.isnan(diagnose(**law, **effect).passive_damping) == (passive is None)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"friction": 0.1}, "friction and quantum must be given together"),
        ({"quantum": 1e-6}, "friction and quantum must be given together"),
        ({"friction": 0.1, "quantum": 1e-6, "plant": "exact"}, "friction must be 0 on a simulated plant"),
    ],
)
def test_a_map_of_quiet_walls_is_theory_alone(given: dict[str, Any], says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        StabilityParameters(**given)


def test_a_map_has_the_points_that_its_ranges_count_as_a_sweep_has() -> None:
    p = StabilityParameters(stiffness=(1000.0, 9000.0, 3), damping=(20.0, 120.0), grid=4)
    found, swept = run_stability(p), Grid(RestingWall(), {"stiffness": [1000.0, 5000.0, 9000.0]})
    assert found.stiffness.tolist() == swept.axes["stiffness"] and p.count == found.spectral_radius.size == 12
    assert StabilityParameters(stiffness=(1000.0, 1000.0), grid=4).count == 4


def test_the_command_takes_the_same_grid_for_a_map_as_for_a_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main("stability --stiffness 1000:9000:3 --damping 20:80:2 --json map.json".split()) == 0
    line = "sweep wall --vary stiffness=1000:9000:3 --vary damping=20:80:2 --workers 0 --json cells.json"
    assert main(line.split()) == 0
    radii = json.loads(Path("map.json").read_text())["spectral_radius"]
    cells = json.loads(Path("cells.json").read_text())
    assert [one["spectral_radius"] for one in cells["results"]] == pytest.approx(np.ravel(radii).tolist(), rel=1e-9)
