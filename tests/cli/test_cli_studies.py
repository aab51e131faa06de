"""`maglev-mj map` and `maglev-mj sweep` as a person types them."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.cli import main


def test_stability_goes_on_from_its_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "cells"
    arguments = ["map", "--grid", "2", "--of", "exact", "--record", str(record)]
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
        and "\n  6 cells written to" in said
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
    for words, resumed in ((heights, False), ([*heights, "--set", "pulse=0"], False), (heights, True)):
        assert main(words) == 0
        note = r"2 cells in drop-sweep-\w+, 2 resumed" if resumed else r"2 cells written to drop-sweep-\w+"
        assert re.search(rf"\n  {note}\n", capsys.readouterr().out)
    one, _ = tmp_path.iterdir()
    assert main([*heights, "--set", "mass=0.6", "--record", one.name]) == 2
    assert f"record must be of this study (got '{one.name}', which differs in mass, " in capsys.readouterr().err


def test_a_map_without_a_stable_wall_is_still_a_map(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "--hand", "0,0,5e4", "--grid", "3"]) == 0
    assert "no wall is stable" in capsys.readouterr().out
