"""Runs that start one MuJoCo plant again equal runs of new ones bit for bit."""

from typing import Any

import numpy as np
import pytest

from maglev_mj.plants import MuJoCoPlant
from maglev_mj.scenes import scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.run import figures_of, run, run_phases
from maglev_mj.studies.sweep import sweep


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the plants that a `OneDevice` makes from here on."""
    plants: list[Any] = []

    def make(*timing: Any, **options: Any) -> MuJoCoPlant:
        plant = MuJoCoPlant(*timing, **options)
        plants.append(plant)
        return plant

    monkeypatch.setattr(scene, "MuJoCoPlant", make)
    return plants


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("drop", {"wall_on": "device", "quantize": 5e-6, "duration": 0.06}),
        ("press", {"duration": 1.91}),
        ("stick-slip", {"duration": 0.06}),
    ],
)
def test_phases_one_by_one(name: str, values: Any, made: list[Any]) -> None:
    one = find_scene(name)(**values)
    phases = [0.7, 0.2]
    together = run_phases(one, phases, plant="mujoco")
    assert len(made) == 1 and made[0]._closed
    for index, phase in enumerate(phases):
        figures = run(one, plant="mujoco", phase=phase).figures
        for key, figure in together.figures.items():
            np.testing.assert_array_equal(figure[index], figures[key])


def test_cells_of_a_sweep(made: list[Any]) -> None:
    drop = Drop(duration=0.06)
    vary: Any = {"mass": [0.7, 0.9], "stiffness": [2000.0, 5000.0], "height": [1e-3, 2e-3]}
    found = sweep(drop, vary, plant="mujoco", workers=0).figure("penetration")
    assert len(made) == 2  # one for each mass
    for index in np.ndindex(found.shape):
        values = {name: some[place] for (name, some), place in zip(vary.items(), index, strict=True)}
        assert found[index] == figures_of(drop.replace(**values), "mujoco")["penetration"]
