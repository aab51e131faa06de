"""`maglev-mj stability` and `maglev-mj sweep` as a person types them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import theory
from maglev_mj.cli import main


@pytest.mark.study  # `stability/exact` of the kept outputs is the small case
def test_stability_json_is_the_map(tmp_path: Path) -> None:
    out = tmp_path / "map.json"
    arguments = ["stability", "--damping", "10:110", "--stiffness", "500", "12500", "--grid", "7", "--plant", "exact"]
    assert main([*arguments, "--json", str(out), "--out", str(tmp_path)]) == 0
    data = json.loads(out.read_text())
    assert data["parameters"]["delay"] == 0.0015 and data["parameters"]["hand"] == "none"
    assert data["damping"] == pytest.approx(np.linspace(10.0, 110.0, 7).tolist())
    assert data["stiffness"] == pytest.approx(np.linspace(500.0, 12500.0, 7).tolist())
    rows = np.array(data["stiffness"])[:, None]
    modulus, stable = np.array(data["modulus"]), np.array(data["simulated"])
    expected = theory.largest_modulus(np.array(data["stiffness"])[:, None], data["damping"], period=0.005, delay=0.0015)
    np.testing.assert_allclose(modulus, expected)
    np.testing.assert_array_equal(stable, modulus < 1.0)
    np.testing.assert_array_equal(stable, rows <= np.array(data["boundary"]))
    assert data["maximum"]["stiffness"] == pytest.approx(10173, rel=1e-3)
    assert (tmp_path / "stability.png").is_file()


def test_stability_by_theory_alone_simulates_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--grid", "5", "--hand", "0.3,5,200", "--json", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["simulated"] is None and data["parameters"]["hand"] == "0.3,5,200"


def test_stability_goes_on_from_its_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "cells"
    arguments = ["stability", "--grid", "2", "--plant", "exact", "--record", str(record)]
    assert main([*arguments, "--json", "-"]) == 0
    first = capsys.readouterr().out
    (shard,) = record.glob("cells-*")
    whole = shard.read_bytes()
    assert main([*arguments, "--json", "-"]) == 0
    assert capsys.readouterr().out == first and [*record.glob("cells-*")] == [shard]  # nothing is done again
    shard.write_bytes(whole[:100])
    assert main([*arguments, "--json", "-"]) == 0
    assert capsys.readouterr().out == first and len([*record.glob("cells-*")]) == 2


def test_sweep_covers_the_grid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "cells"
    arguments = ["sweep", "drop", "--vary", "height=0.001:0.003:3", "--vary", "plant=exact,mujoco", "--set", "pulse=0"]
    assert main([*arguments, "--record", str(record), "--workers", "0", "--json", str(tmp_path / "all.json")]) == 0
    assert (
        "Sweep of drop over height (3), plant (2): 6 cells\n" in (said := capsys.readouterr().out)
        and "\n  0 of them already in" in said
    )
    data = json.loads((tmp_path / "all.json").read_text())
    assert [(cell["height"], cell["plant"]) for cell in data["cells"]] == [
        (height, plant) for height in (0.001, 0.002, 0.003) for plant in ("exact", "mujoco")
    ]
    for exact, engine in zip(data["results"][::2], data["results"][1::2], strict=True):
        assert exact["penetration"] == pytest.approx(engine["penetration"], abs=1e-12)


def test_each_grid_has_a_record_of_its_own_and_is_found_again(
    tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    heights = ["sweep", "drop", "--set", "plant=exact", "--workers", "0", "--vary", "height=0.001,0.002"]
    for words, resumed in ((heights, 0), ([*heights, "--set", "pulse=0"], 0), (heights, 2)):
        assert main(words) == 0
        assert f"\n  {resumed} of them already in drop-sweep-" in capsys.readouterr().out
    one, _ = tmp_path.iterdir()
    assert main([*heights, "--set", "mass=0.6", "--record", one.name]) == 2
    assert f"record must be of this study, not '{one.name}', which has other mass, " in capsys.readouterr().err


def test_hands_can_be_varied_by_their_numbers(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "wall", "--vary", "hand=0.2,18,271;none", "--workers", "0", "--json", "all.json"]) == 0
    data = json.loads((tmp_path / "all.json").read_text())
    assert [cell["hand"] for cell in data["cells"]] == ["0.2,18,271", "none"]
    assert data["results"][0]["stiffest_wall"] > data["results"][1]["stiffest_wall"]


@pytest.mark.study
def test_a_map_that_begins_at_no_stiffness_agrees_with_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--stiffness", "0:10000", "--damping", "0:200", "--grid", "21", "--plant", "exact"]) == 0
    assert "0 verdicts differ" in capsys.readouterr().out


def test_a_map_without_a_stable_wall_is_still_a_map(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--hand", "0,0,5e4", "--grid", "3"]) == 0
    assert "no wall is stable" in capsys.readouterr().out
