"""`maglev-mj stability` and `maglev-mj sweep` as a person types them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import theory
from maglev_mj.cli import main


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
    assert (tmp_path / "stability.png").stat().st_size > 10_000


def test_stability_by_theory_alone_simulates_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--grid", "5", "--hand", "0.3,5,200", "--json", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["simulated"] is None and data["parameters"]["hand"] == "0.3,5,200"


def test_stability_goes_on_from_its_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "cells.jsonl"
    arguments = ["stability", "--grid", "4", "--plant", "exact", "--record", str(record)]
    assert main([*arguments, "--json", "-"]) == 0
    first = capsys.readouterr().out
    lines = record.read_text().splitlines()
    assert len(lines) == 16
    record.write_text("\n".join(lines[:9]) + "\n")
    assert main([*arguments, "--json", "-"]) == 0
    assert capsys.readouterr().out == first
    assert sorted(record.read_text().splitlines()) == sorted(lines)


def test_sweep_covers_the_grid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "cells.jsonl"
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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["stability", "--damping", "a", "b"], "damping must be LOW HIGH, LOW:HIGH, or one value, not 'a b'"),
        (["stability", "--damping", "-5:3"], "damping must be a finite number at least 0 and at most 1e+06, not -5"),
        (["stability", "--stiffness", "9", "3"], "stiffness must be from a lower to a higher value, not 9 to 3"),
        (["stability", "--grid", "1"], "grid must be a finite number at least 2"),
        (["stability", "--plant", "moon"], "plant must be one of none, exact, mujoco, not 'moon'"),
        (
            ["stability", "--hand", "fist"],
            "hand must be one of none, arm, stylus, fingertip, or mass,damping,stiffness",
        ),
        (["stability", "--delay", "1"], "delay must be at most 10 periods of 0.005 s, not 1"),
        (["stability", "--damping", "20", "--out", "."], "damping must be a range for a picture, not 20 alone"),
        (["stability", "--workers", "-1", "--plant", "exact"], "workers must be at least 0, not -1"),
        (["sweep", "drop"], "a sweep needs --vary NAME=VALUES; for one run: maglev-mj run drop"),
        (["sweep", "drop", "--set", "mass=1"], "a sweep needs --vary NAME=VALUES"),
        (["sweep", "moon"], "scene must be one of joystick, drop, press, "),
        (["sweep", "moon.py"], "scene must be a file that is there, not 'moon.py'"),
        (
            ["sweep", "drop", "--vary", "colour=1"],
            "parameter of drop must be one of plant, phase, period, delay, stiffness",
        ),
        (["sweep", "drop", "--vary", "height=1:2"], "height must vary as LOW:HIGH:COUNT, A,B,C or A;B;C, not '1:2'"),
        (["sweep", "drop", "--vary", "height"], "a parameter must be given as NAME=VALUE, not 'height'"),
        (["sweep", "drop", "--vary", "phase=0", "--set", "mass=0"], "mass must be a finite number at least 0.001"),
        (["sweep", "drop", "--set", "mass=1", "--vary", "mass=1,2"], "mass must be either set or varied, not both"),
        (["sweep", "drop", "--vary", "height=0:1:2000", "--vary", "phase=0:1:2000"], "at most 1000000 cells"),
        (["sweep", "drop", "--vary", "height=0:1:100000000000"], "height must vary as LOW:HIGH:COUNT"),
        (["sweep", "drop", "--vary", "height=0:inf:3"], "height must vary as LOW:HIGH:COUNT"),
        (["sweep", "drop", "--set", "mass=1", "--set", "mass=2"], "mass must be given once, not as 1 and 2"),
        (["sweep", "drop", "--set", "mass=true"], "mass must be a finite number, not 'true'"),
        (["sweep", "drop", "--set", "carry=2"], "carry must be true or false, not '2'"),
        (["sweep", "wall", "--vary", "period=0.005", "--set", "hand=5"], "hand must be one of none, arm"),
        (
            ["sweep", "stick-slip", "--vary", "period=0.005", "--set", "axis=1"],
            "axis must be one of x, y, z, rx, ry, rz, not '1'",
        ),
        (["stability", "--hand", "1e-300,0,0,0,1e10"], "hand grip_stiffness must be at most 1e+07"),
        (["stability", "--hand", "0,0,1e300"], "hand stiffness must be at most 1e+07"),
        (["stability", "--hand", "0.2,0,0,1,0"], "grip_stiffness above 0 in a soft grip"),
        (
            ["stability", "--json", "missing/map.json"],
            "json must be a file in a folder that is there, not 'missing/map.json'",
        ),
        (["stability", "--record", "."], "record must be a file in a folder that is there, not '.'"),
        (["stability", "--record", "a", "--json", "./a"], "json and record must be two files, not 'a' for both"),
        (
            ["sweep", "wall", "--vary", "period=0.005", "--json", "wall-sweep.jsonl"],
            "json and record must be two files",
        ),
        (
            ["sweep", "wall", "--vary", "period=0.005", "--scheduler", "moon"],
            "scheduler must be the address of a Dask scheduler, not 'moon'",
        ),
        (
            ["sweep", "wall", "--vary", "period=0.005", "--workers", "2", "--scheduler", "tcp://x:1"],
            "workers must be left to the scheduler",
        ),
    ],
)
def test_bad_studies_are_one_line_and_status_2(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        status = main(arguments)
    except SystemExit as ended:  # of words that are no arguments
        status = int(str(ended.code))
    assert status == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1 and words in said.err
    assert not list(tmp_path.iterdir())


def test_hands_can_be_varied_by_their_numbers(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "wall", "--vary", "hand=0.2,18,271;none", "--workers", "0", "--json", "all.json"]) == 0
    data = json.loads((tmp_path / "all.json").read_text())
    assert [cell["hand"] for cell in data["cells"]] == ["0.2,18,271", "none"]
    assert data["results"][0]["stiffest_wall"] > data["results"][1]["stiffest_wall"]


def test_a_map_that_begins_at_no_stiffness_agrees_with_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--stiffness", "0:10000", "--damping", "0:200", "--grid", "21", "--plant", "exact"]) == 0
    assert "0 verdicts differ" in capsys.readouterr().out


def test_a_map_without_a_stable_wall_is_still_a_map(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "--hand", "0,0,5e4", "--grid", "3"]) == 0
    assert "no wall is stable" in capsys.readouterr().out
