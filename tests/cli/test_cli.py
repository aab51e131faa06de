"""The command line as a person types it."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest

from maglev_mj import cli
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run


def test_drop_json_on_standard_output_is_nothing_but_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["drop", "--plant", "exact", "--json", "-", "--phases", "3", "--force-limit", "60"]) == 0
    data = json.loads(capsys.readouterr().out)
    drop = Drop(force_limit=60.0)
    assert data["parameters"] == {"plant": "exact", "phase": 0.0, **drop.as_json()}
    assert data["z"] == run(drop, plant="exact").series()["z"].tolist()
    assert max(data["force"]) <= 60.0
    assert [row["phase"] for row in data["sweep"]["phases"]] == [0.0, 1 / 3, 2 / 3]


PICTURES = {
    "drop --phases 2": ["drop_phase_plane.png", "drop_phases.png", "drop_time.png"],
    "press --hits 2 --phases 2": ["press.png"],
    "stick-slip": ["stick_slip.png"],
}


@pytest.mark.parametrize("command", PICTURES)
def test_a_scene_writes_json_and_pictures(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, path, **__: Path(path).touch())
    folder = tmp_path / "new" / "folder"
    assert cli.main([*command.split(), "--plant", "exact", "--json", f"{tmp_path}/a.json", "--out", str(folder)]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["summary"]
    assert sorted(picture.name for picture in folder.iterdir()) == PICTURES[command]
    out = capsys.readouterr().out
    assert all(f"wrote {picture}" in out for picture in folder.iterdir())


@pytest.mark.parametrize(
    ("arguments", "rows"),
    [("press --hand fingertip --delay 0.005", 500), ("stick-slip --spring 30000", 50)],
)
def test_a_diverging_run_says_so_and_keeps_its_record(
    arguments: str, rows: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "run.json"
    assert cli.main([*arguments.split(), "--json", str(target)]) == 1
    assert "diverged at" in capsys.readouterr().err
    data = json.loads(target.read_text())
    assert "diverged" in data and len(data["time"]) > rows


@pytest.mark.parametrize(
    "arguments",
    [
        ["--stiffness", "1e8", "--plant", "exact"],
        ["--damping", "1e6", "--period", "0.1", "--duration", "2"],
    ],
)
def test_a_wild_run_says_one_line_and_leaves_no_log(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["drop", *arguments]) in (0, 1)
    printed = capfd.readouterr()
    assert "  Warning: drop is unstable: walls on z" in printed.out + printed.err
    assert "Traceback" not in printed.err and printed.err.count("maglev-mj run: ") <= 1
    assert not list(tmp_path.iterdir())


def test_without_matplotlib_pictures_say_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("maglev_mj.errors.find_spec", lambda name: None)
    assert cli.main(["drop", "--out", str(tmp_path)]) == 1
    assert f"{shlex.quote(sys.executable)} -m pip install 'matplotlib>=" in capsys.readouterr().err
