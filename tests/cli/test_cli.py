"""The command line as a person types it."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from maglev_mj import cli
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.run import run
from maglev_mj.versions import versions


def test_drop_prints_one_screen(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["drop", "--phases", "5"]) == 0
    out = capsys.readouterr().out
    for words in (
        "penetration",
        "rebound",
        "peak force",
        "settling time",
        "final z",
        "pulse 220 further",
        "pulse 220 in all",
        "no pulse",
        "plant mujoco, phase 0:",
        "median (5 to 95 %) over 5 phases",
        "penetration above that of 80 % of the phases",
        "differ by at most",
    ):
        assert words in out
    assert len(out.splitlines()) <= 24


def test_drop_json_on_standard_output_is_nothing_but_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["drop", "--plant", "exact", "--json", "-", "--phases", "3", "--force-limit", "60"]) == 0
    data = json.loads(capsys.readouterr().out)
    drop = Drop(force_limit=60.0)
    assert data["parameters"] == {"plant": "exact", "phase": 0.0, **drop.as_json()}
    assert data["z"] == run(drop, plant="exact").series()["z"].tolist()
    assert max(data["force"]) <= 60.0
    assert [row["phase"] for row in data["sweep"]["phases"]] == [0.0, 1 / 3, 2 / 3]


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pictures be empty files."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, path, **__: Path(path).touch())


@pytest.mark.usefixtures("undrawn")
def test_drop_writes_json_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["drop", "--plant", "exact", "--phases", "2", "--json", str(tmp_path / "drop.json")]
    assert cli.main([*arguments, "--out", str(tmp_path / "new" / "folder")]) == 0
    assert json.loads((tmp_path / "drop.json").read_text())["summary"]["penetration"] > 0.0
    pictures = sorted((tmp_path / "new" / "folder").glob("*.png"))
    assert [picture.name for picture in pictures] == ["drop_phase_plane.png", "drop_phases.png", "drop_time.png"]
    out = capsys.readouterr().out
    assert all(f"wrote {picture}" in out for picture in pictures)


@pytest.mark.parametrize(
    ("arguments", "rows"),
    [
        ("drop --delay 0.005 --duration 3", 300),
        ("press --hand fingertip --delay 0.005", 500),
        ("stick-slip --spring 30000 --duration 2", 50),
    ],
)
def test_a_diverging_run_says_so_and_keeps_its_record(
    arguments: str, rows: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "run.json"
    assert cli.main([*arguments.split(), "--json", str(target)]) == 1
    assert "a run has diverged" in capsys.readouterr().err
    data = json.loads(target.read_text())
    assert "diverged" in data and len(data["time"]) > rows


def test_where_a_compared_drop_diverges_the_record_is_the_one_asked_for(tmp_path: Path) -> None:
    target = tmp_path / "drop.json"
    arguments = ["--plant", "exact", "--delay", "0.006", "--duration", "0.48", "--json", str(target)]
    assert cli.main(["drop", *arguments]) == 1
    data = json.loads(target.read_text())
    assert data["parameters"]["pulse"] == 220.0
    assert len(data["z"]) == 481


@pytest.mark.parametrize(
    "arguments",
    [
        ["--mass", "0.001", "--stiffness", "1e8"],
        ["--stiffness", "1e8", "--plant", "exact"],
        ["--damping", "1e6", "--period", "1", "--duration", "20"],
    ],
)
def test_a_wild_run_says_one_line_and_leaves_no_log(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["drop", *arguments]) in (0, 1)
    warned, *ended = capfd.readouterr().err.splitlines()
    assert warned.startswith("  warning: drop is unstable: walls on z") and len(ended) <= 1
    assert not list(tmp_path.iterdir())


def test_the_table_says_when_the_device_could_not_do_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["drop", "--plant", "exact"]) == 0
    assert "Above the device's 60 N (z): pulse 220 further 95.6, pulse 220 in all 70.1" in capsys.readouterr().out
    assert cli.main(["drop", "--plant", "exact", "--force-limit", "60"]) == 0
    assert "Above the device" not in capsys.readouterr().out


def test_the_table_counts_the_phases_that_have_a_figure(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["drop", "--plant", "exact", "--phases", "20", "--duration", "0.13"]) == 0
    assert "pulse 220 further: settling time is there at 19 of 20 phases" in capsys.readouterr().out


@pytest.mark.usefixtures("undrawn")
def test_stick_slip_prints_one_screen_and_writes_json_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "run.json"
    assert cli.main(["stick-slip", "--json", str(target), "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for words in ("peak speed", "transitions", "Karnopp, exact", "stick_slip.png"):
        assert words in out
    (stick,) = [line.split() for line in out.splitlines() if "stick time" in line]
    assert stick == ["stick", "time", "165", "161", "ms"]  # rendered, and exact: 161.18
    assert len(out.splitlines()) <= 24
    data = json.loads(target.read_text())
    series = ("time", "position", "velocity", "stick_position", "state", "force")
    assert list(data) == ["parameters", *series, "events", "summary", "versions"]
    assert all(len(data[name]) == 301 for name in series)
    assert [(event["kind"], set(event)) for event in data["events"]] == [
        ("slip", {"time", "kind", "position"}),
        ("stick", {"time", "kind", "position"}),
    ]
    assert set(data["summary"]) == {
        "peak_speed",
        "stick_time",
        "stick_position",
        "final_position",
        "transitions",
        "ripple",
    }
    assert data["parameters"]["spring"] == 1000.0
    assert data["state"][0] == "stuck"
    assert "sliding" in data["state"]
    assert (tmp_path / "stick_slip.png").is_file()


@pytest.mark.usefixtures("undrawn")
def test_press_prints_one_screen_and_writes_json_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "press.json"
    words = ["press", "--plant", "exact", "--hits", "2", "--phases", "2", "--json", str(target), "--out", str(tmp_path)]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    for part in ("approach speed", "contacts", "over 2 phases", "absorbed", "without pulse", "differ by at most"):
        assert part in out
    assert f"wrote {tmp_path / 'press.png'}" in out and (tmp_path / "press.png").is_file()
    assert max(map(len, out.partition("wrote ")[0].splitlines())) <= 80
    data = json.loads(target.read_text())
    assert data["parameters"] == {"plant": "exact", "phase": 0.0, **Press(hits=2).as_json()}
    assert len(data["summary"]["penetration"]) == len(data["sweep"]["phases"]) == 2


def test_press_json_on_standard_output_is_nothing_but_json(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["press", "--plant", "exact", "--hand", "0.3,20,500,3,2000", "--hits", "2", "--pulse", "0"]
    assert cli.main([*arguments, "--force-limit", "60", "--json", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    expected = run(Press(hand="0.3,20,500,3,2000", hits=2, pulse=0.0, force_limit=60.0), plant="exact")
    assert data == {**json.loads(json.dumps(expected.as_json())), "versions": versions()}


def test_the_press_table_says_what_the_device_could_not_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["press", "--plant", "exact", "--height", "0.006", "--hits", "8", "--interval", "0.3"]) == 0
    out = capsys.readouterr().out
    assert "Above the device's 60 N (z): with pulse 85.7" in out
    assert "Beyond the range of 4.5 mm: with pulse" in out
    (depths,) = [line for line in out.splitlines() if "penetration" in line]
    assert re.findall(r"\S+ to \S+", depths) == ["1.59 to 2.21", "2.35 to 3.25"]  # of eight hits
    assert cli.main(["press", "--plant", "exact", "--hits", "1"]) == 0
    assert "device" not in capsys.readouterr().out


def test_info(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info"]) == 0
    assert "where the paper contradicts itself" in capsys.readouterr().out
    assert cli.main(["info", "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["hover_current"] == pytest.approx(1.14, abs=5e-3)


def test_without_matplotlib_pictures_say_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("maglev_mj.errors.find_spec", lambda name: None)
    assert cli.main(["drop", "--out", str(tmp_path)]) == 1
    assert f"{shlex.quote(sys.executable)} -m pip install 'matplotlib>=" in capsys.readouterr().err


def test_core_needs_no_matplotlib() -> None:
    """Nothing imports it until a picture is asked for."""
    code = "import sys, maglev_mj.cli; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
