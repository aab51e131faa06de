"""Drops on walls with pulse, force limit and quantized sensor."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.studies.cells import local_workers
from maglev_mj.studies.drop_map import SAMPLES, DropEnding, DropMapParameters, _Quarters, drop_endings, run_drop_map
from maglev_mj.studies.record import Record
from maglev_mj.theory import is_stable
from tests.studies.test_charts import details
from tests.sweeps import sweep

ALL: dict[str, Any] = {"pulse": 220.0, "force_limit": 60.0, "quantize": 5e-6}


@pytest.mark.parametrize(("delay", "hand"), sweep([0.0, 0.0015, 0.005], ["none", "arm"], every=3))
def test_released_at_the_edge_a_wall_settles_where_theory_has_it_stable(delay: float, hand: str) -> None:
    # In every cell whose spectral radius is further than 0.005 from 1: it changes by a factor of 1.6 over a quarter.
    found = run_drop_map(DropMapParameters(grid=40, height=0.0, delay=delay, hand=hand))
    radius = found.parameters.loop().array().spectral_radius(found.stiffness[:, None], found.damping)
    away = np.abs(radius - 1.0) > 0.005
    assert away.mean() > 0.9 and 0.3 < found.settles.mean() < 0.7
    assert (found.settles == is_stable(radius))[away].all()
    # what leaves the wall by itself has gained energy
    assert ((found.ending == DropEnding.RISES) | ~away | found.settles).mean() > 0.97


def test_a_map_of_drops_states_loop_and_drop() -> None:
    found = run_drop_map(DropMapParameters(grid=4, height=0.001, force_limit=60.0, hand="arm"))
    stated = "PD wall along z, 200 Hz, delay 1.5 ms, mass 0.7 kg, hand arm, released at 1 mm, 60 N"
    assert found.table().title == f"Drops on a {stated}"
    assert details(found.plot()) == stated


def ending(stiffness: float, damping: float, **values: Any) -> tuple[float, DropEnding]:
    swing, found = drop_endings(np.array([stiffness]), np.array([damping]), DropMapParameters(**values))
    return float(swing[0]), DropEnding(found[0])


def test_endings_of_drops_with_known_answers() -> None:
    # The paper's wall settles, hums within a few steps of the sensor, bounces on where the damping is too low.
    swing, found = ending(6000.0, 80.0)
    assert found is DropEnding.SETTLES and swing < 1e-12
    swing, found = ending(6000.0, 80.0, **ALL)
    assert found is DropEnding.SETTLES and 0.0 < swing <= 5 * 5e-6
    # a sampled spring without damping makes energy at each bounce: with nothing to stop it, it rises ever higher
    swing, found = ending(6000.0, 0.0)
    assert found is DropEnding.RISES and swing > 0.1
    # under 60 N it cannot be thrown so far
    assert ending(6000.0, 0.0, force_limit=60.0)[0] < 0.7 * swing
    # far above the boundary at its damping, the limit leaves a cycle below the height of release
    swing, found = ending(12000.0, 88.0, **ALL)
    assert found is DropEnding.PERSISTS and 50e-6 < swing < 4.5e-3
    # 0.2 % below the boundary it still rings, ever less and within the wall
    assert ending(10000.0, 87.6, height=0.0)[1] is DropEnding.SETTLES


def test_steps_keep_walls_of_much_damping_from_resting_that_theory_has_stable() -> None:
    # A step is much force where the damping is high: a hum of ten steps and more.
    k, b = (part.ravel() for part in np.meshgrid(np.linspace(3000.0, 8000.0, 60), np.linspace(120.0, 165.0, 30)))
    p = DropMapParameters(height=0.0)
    stable = p.loop().array().spectral_radius(k, b) < 0.99
    assert stable.sum() > 250 and (drop_endings(k, b, p)[1][stable] == DropEnding.SETTLES).all()
    swing, found = drop_endings(k, b, DropMapParameters(height=0.0, quantize=5e-6))
    hums = stable & (found != DropEnding.SETTLES)
    assert 0 < hums.sum() < 0.05 * stable.sum() and (swing[hums] > 50e-6).all() and (swing[hums] < 200e-6).all()


def test_what_grows_without_bound_stays_finite_and_ends_no_other() -> None:
    # An arm pushes the flotor back into a wall that throws it further out each time.
    gains: dict[str, Any] = {"stiffness": (1e3, 1e8), "damping": (0.0, 1e6)}
    found = run_drop_map(DropMapParameters(grid=12, height=0.0, mass=1e-3, hand="0,0,1e6", **gains))
    assert np.isfinite(found.swing).all() and (found.ending == DropEnding.RISES).any()


@pytest.mark.parametrize("count", [0, pytest.param(2, marks=pytest.mark.machine)])
def test_parts_and_workers_do_not_matter(count: int, tmp_path: Path) -> None:
    # To the last bit without pulses; with them where it settles, for a neighbour's pulse splits a period: rounding.
    still = DropMapParameters(grid=8, quantize=5e-6, force_limit=60.0)
    whole, told = run_drop_map(still), list[tuple[int, int]]()
    for _ in range(2):  # the second from the record
        parts = run_drop_map(
            still,
            part=30,
            workers=local_workers(count),
            record=Record(tmp_path / "parts"),
            progress=lambda *both: told.append(both),
        )
        assert (parts.swing == whole.swing).all() and (parts.ending == whole.ending).all()
        assert told == [(30, 64), (60, 64), (64, 64)] or (count and told[-1] == (64, 64) and len(told) == 3)
    pulsed = DropMapParameters(grid=8, pulse=220.0, force_limit=60.0)
    whole, parts = run_drop_map(pulsed), run_drop_map(pulsed, part=30)
    assert (parts.settles == whole.settles).all()
    np.testing.assert_allclose(parts.swing[whole.settles], whole.swing[whole.settles], rtol=1e-9, atol=1e-12)


def test_the_boundary_of_settling_passes_over_walls_too_soft_to_come_to_rest() -> None:
    grid: dict[str, Any] = {"grid": 30, "stiffness": (10.0, 12000.0), "damping": (60.0, 100.0)}
    found = run_drop_map(DropMapParameters(height=0.0, **grid))
    assert not found.settles[0].all()
    share = found.settles_up_to / found.boundary
    assert (share > 0.93).all() and (share <= 1.0).all()


def test_the_command_maps_drops_where_an_option_of_theirs_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["map", "--of", "drops", "--grid", "6", "--pulse", "220", "--force-limit", "60", "--quantize", "5e-6"]
    assert main([*arguments, "--json", "map.json", "--out", "."]) == 0
    said = capsys.readouterr().out
    assert "Drops on a PD wall along z, 200 Hz" in said and "sensor 5 µm" in said and "stability_drops.png" in said
    assert (tmp_path / "stability_drops.png").exists()
    assert json.loads((tmp_path / "map.json").read_text())["endings"] == ["settles", "persists", "rises"]


def test_an_ending_is_that_of_the_last_quarter() -> None:
    # From one quarter to the next: dying in the wall, dying but leaving it, lower than before, higher than released.
    ranges = [[(-2e-3, -1e-3), (-1e-3, 2e-3), (-1e-3, 5e-3), (-1e-3, 4e-3)]]
    ranges += [[(-1.6e-3, -1.5e-3), (-1e-3, 1e-4), (-1e-3, 4e-3), (-1e-3, 5e-3)]]
    quarters = _Quarters(4)
    for tick in range(SAMPLES):
        late = tick - SAMPLES // 2
        heights = np.array(ranges[late // (SAMPLES // 4)]).T[tick % 2] if late >= 0 else np.full(4, 9e-3)
        quarters(Sample(tick, 0.005 * tick, [0.0, 0.0, heights, 0.0, 0.0, 0.0]), Command(ZERO))
    swing, ending = quarters.endings(DropMapParameters(height=4.5e-3))
    assert swing == pytest.approx([1e-4, 1.1e-3, 5e-3, 6e-3])
    assert ending.tolist() == [DropEnding.SETTLES, DropEnding.PERSISTS, DropEnding.PERSISTS, DropEnding.RISES]
