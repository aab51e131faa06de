"""The scripts run as they stand."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.scenes.stick_slip import LAWS
from tests.rows import check_rows
from tests.studies.test_charts import complaints

ROOT = Path(__file__).resolve().parents[2]

Script = Callable[..., str]
STUDY = pytest.mark.study


@pytest.fixture(autouse=True)
def readable(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Check that all charts of a script are readable; only a study writes their pixels."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        yield
        return
    drawn: list[Any] = []
    save, pixels = Figure.savefig, request.node.get_closest_marker("study") is not None

    def keep(figure: Any, path: Path, **options: Any) -> None:
        drawn.append(figure)
        if pixels:
            save(figure, path, **options)
        else:
            path.write_bytes(b"drawn")

    monkeypatch.setattr(Figure, "savefig", keep)
    yield
    assert [complaints(figure) for figure in drawn] == [[]] * len(drawn)


@pytest.fixture
def run_script(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Script:
    """Return a function that runs a script.

    In this process; it returns the output.
    """

    def run(name: str, *arguments: str) -> str:
        path = str(ROOT / "scripts" / name)
        monkeypatch.setattr(sys, "argv", [path, *arguments])
        runpy.run_path(path, run_name="__main__")
        return capsys.readouterr().out

    return run


FIGURES = {
    "2": ("fig2_stability", r"the device: at most 10173 N/m, at 87.6 N s/m"),
    "3": ("fig3_drop", r"no pulse: 2.95 mm deep"),
    "4": ("fig4_phase_plane", "wrote"),
    "6": ("fig6_press", r"(pressed 0.833 mm deep with 5.000 N\s.*){2}"),
    "8": ("fig8_stick_slip", r"transitions +2 +2\n"),
    "9": ("fig9_six_axes", r"1500 N/m .* \d+ of \d+\n"),
}
COMPUTED_HERE = {"2", "9"}
"""Figures whose numbers the script computes; the others' are those of scenes, which have tests of their own."""


@pytest.mark.parametrize(
    ("number", "options"),
    [
        *(pytest.param(one, ["--quick"], marks=[STUDY] * (one not in COMPUTED_HERE)) for one in FIGURES),
        *(pytest.param(one, [], marks=STUDY) for one in FIGURES),
    ],
)
def test_figures(number: str, options: list[str], tmp_path: Path, run_script: Script) -> None:
    name, claim = FIGURES[number]
    out = run_script("figures/paper.py", "--figure", number, *options, "--out", str(tmp_path))
    assert re.search(claim, out) and [path.stem for path in tmp_path.iterdir()] == [name]


@pytest.mark.needs("drawing")
def test_render_device_runs_in_a_process_of_its_own(tmp_path: Path) -> None:
    from matplotlib import image

    script, target = ROOT / "scripts" / "figures" / "render_device.py", tmp_path / "device.png"
    command = [sys.executable, str(script), str(target), "560x420"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0 and "device.png" in done.stdout, done.stderr
    picture = image.imread(target)
    assert picture.shape[:2] == (420, 560)
    assert picture[..., :3].std() > 0.1  # a device, not an empty sky


def test_friction_laws_stick_slip_is_nearest_exact_friction_and_does_not_creep(
    tmp_path: Path, run_script: Script
) -> None:
    out = run_script("studies/friction_laws.py", "--quick", "--out", str(tmp_path))
    data = json.loads((tmp_path / "friction_laws.json").read_text())
    assert len(data["spring"]) == len(LAWS) * 4
    assert len(data["hard"]) == len(LAWS) * 2 and out.count("kikuuwe") == 3
    best = [row["error"] for row in data["spring"] if row["law"] == "stick-slip"]
    assert 2.0 * max(best) < min(row["error"] for row in data["spring"] if row["law"] != "stick-slip")
    creep = {law: [abs(row["creep"]) for row in data["hard"] if row["law"] == law] for law in ("stick-slip", "dahl")}
    assert max(creep["stick-slip"]) < 1e-9 and min(creep["dahl"]) > 1e-4


@STUDY
def test_stability_steps_names_the_integrators_that_are_optimistic(tmp_path: Path, run_script: Script) -> None:
    out = run_script("studies/stability_steps.py", "--quick", "--out", str(tmp_path))
    data = json.loads((tmp_path / "stability_steps.json").read_text())
    assert len(data["integrators"]) == 5 + 2
    assert out.count("euler") == 2
    excess = {(row["integrator"], row["aligned"]): row["percent"][0] for row in data["integrators"]}
    assert excess["rk4", True] == pytest.approx(0.0, abs=0.01) and excess["euler", True] > 15.0


PANELS = ["timing", "pulse", "limits", "hands"]


@STUDY
@pytest.mark.parametrize("names", [["timing"], PANELS], ids=["one", "all"])
def test_where_methods_fail_draws_its_panels(names: list[str], tmp_path: Path, run_script: Script) -> None:
    one = ["--figure", *names] if len(names) == 1 else []
    run_script("studies/where_methods_fail.py", "--quick", *one, "--out", str(tmp_path))
    panels = json.loads((tmp_path / "where_methods_fail.json").read_text())["panels"]
    assert len(panels) == 2 * len(names)
    curves = [{label: y for label, _, y in panel["curves"]} for panel in panels]
    predicted, exact, engine = curves[0].values()  # samples to grow, near the boundary
    assert exact == engine == pytest.approx(predicted, rel=0.15)
    if names == PANELS:
        gated = [pulses for label, pulses in curves[2].items() if "gate 5" in label]
        assert gated == [[0.0, 0.0]] and all(y[0] > 0.0 for label, y in curves[2].items() if "no gate" in label)
        assert all(swing[0] > 2.0 and swing[-1] == 0.0 for swing in curves[5].values())  # friction ends the hum
    assert {path.stem for path in tmp_path.glob("*.png")} == {f"where_methods_fail_{name}" for name in names}


@STUDY  # of the script; the claims are those of test_nonlinear_walls.py
def test_nonlinear_walls_are_drawn(tmp_path: Path, run_script: Script) -> None:
    out = run_script("studies/nonlinear_walls.py", "--quick", "--out", str(tmp_path))
    assert out.count("settles up to, over theory's boundary") == 6
    cases = json.loads((tmp_path / "stability_nonlinear.json").read_text())["cases"]
    assert cases["force limit 60 N"]["largest_swing"] < 0.5 * cases["drop from 4.5 mm"]["largest_swing"]


@STUDY
def test_measured_walls_are_compared_and_drawn(tmp_path: Path, run_script: Script) -> None:
    out = run_script("studies/measured_walls.py", "--out", str(tmp_path))
    assert out.count("theory meets the points with damping") == 4
    assert re.search(r" 10000 +10173 +0.98 +12169 +8662", out)
    assert [path.name for path in tmp_path.iterdir()] == ["measured_walls.png"]
    with pytest.raises(SystemExit, match="cannot be read"):
        run_script("studies/measured_walls.py", str(tmp_path / "none.toml"))


def test_two_walls_prints_draws_and_writes_where_they_rattle(tmp_path: Path, run_script: Script) -> None:
    out = run_script("studies/two_walls.py", "--quick", "--out", str(tmp_path))
    rows = json.loads((tmp_path / "two_walls.json").read_text())["rows"]
    assert [row["delay"] for row in rows] == [0.0, 0.003] and out.count("\npulse 220") == 1
    assert [row["share"] for row in rows] == [[0.0] * 4, [1.0] * 4]


@STUDY
def test_flight_safety_goes_on_where_it_ended_and_prints_its_tables(tmp_path: Path, run_script: Script) -> None:
    def run(*arguments: str) -> str:
        return run_script("studies/flights.py", *arguments, "--out", str(tmp_path))

    for number in ("1", "3"):
        run("product", "--number", number)
        assert len((tmp_path / "product.jsonl").read_text().splitlines()) == int(number)
    run("laws", "--number", "1")
    (tmp_path / "delays.json").write_text(json.dumps({"busy 200": [400, 900], "quiet 200": [400, 900]}))
    run("good", "--number", "1", "--seconds", "0.4")
    for takeoffs in (1, 2):
        run("takeoffs", "--number", str(takeoffs))
        rows = [json.loads(line) for line in (tmp_path / "takeoffs.jsonl").read_text().splitlines()]
        assert [row["cell"]["seed"] for row in rows] == [110_000, 110_001][:takeoffs]
    out = run("tables")
    assert "3 flights, 0 exceed" in out and "| sign error |" in out and "| good | 200 | 0.4 | 2 | 0 | 0 |" in out
    assert "0 refused; 1 flights, 0 reduced, 0.00 hours; {'landed': 1}" in out
    assert "| attack |" in run("attacks")


@STUDY  # in real time: a stall of a second ends the flight before its emergency stop
def test_an_emergency_stop_is_heard_through_every_flood() -> None:
    command = [sys.executable, str(ROOT / "scripts" / "studies" / "flights.py"), "flood", "--number", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0 and done.stdout.count("| 1 |") == 4, done.stderr


@pytest.mark.parametrize("wrong", [("--repeats", "0"), ("--tables", "no.json"), ("--tables", __file__)])
def test_bench_refuses_what_it_cannot_do(
    wrong: tuple[str, str], run_script: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as done:
        run_script("benchmarks/bench.py", *wrong)
    assert done.value.code == 2 and len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.machine
@pytest.mark.parametrize("sections", [["loop"], pytest.param(["loop", "others"], marks=STUDY)], ids=["one", "two"])
def test_bench_measures_sections_and_writes_one_file(
    sections: list[str], tmp_path: Path, run_script: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as done:
        arguments = "--quick", "--repeats", "2", "--only", *sections, "--before", "no-such-revision"
        run_script("benchmarks/bench.py", *arguments, "--out", str(tmp_path))
    out = capsys.readouterr().out
    assert done.value.code == 0 and "no-such-revision is not here" in out and "exact plant" in out
    found = json.loads((tmp_path / "bench.json").read_text())
    assert list(found["sections"]) == sections
    loop = found["sections"]["loop"]["figures"]
    ratio = loop["ratio: corrected, body: over by hand"]["after"]
    assert len(ratio["runs"]) == 2 and ratio["least"] <= ratio["median"] <= ratio["greatest"]
    assert "before" not in loop["ratio: corrected, body: over by hand"]
    with pytest.raises(SystemExit) as done:
        run_script("benchmarks/bench.py", "--tables", str(tmp_path / "bench.json"))
    assert done.value.code == 0 and "| corrected, body: over by hand |" in capsys.readouterr().out


SMALL: dict[str, dict[str, Any]] = {
    "answers": {},
    "start": {},
    "recorder": {},
    "cells": {"empty": (100.0,), "drops": (16.0,)},
    "bridge": {},
    "web": {"alone": True},
}
"""Sections of `system` but the window, by their options of a small case."""


@pytest.mark.machine
@pytest.mark.parametrize("name", SMALL)
def test_a_row_of_system_counts_what_it_ran(name: str) -> None:
    tables = import_module(f"system.{name}").measure(True, **SMALL[name])
    for table in tables.values():
        check_rows(table)
    if name == "answers":
        assert tables["answers"]["devices"] == dict.fromkeys(tables["answers"]["seconds"], 1) | {
            "map of 6 x 6 in MuJoCo": 36,
            "critical stiffness of 100 loops": 100,
            "all columns of 100 loops": 100,
        }
    if name == "cells":
        assert tables["sweeps"]["cells"] == {"100 empty": 100, "16 drop": 16}
        assert min(tables["sweeps"]["bytes a cell"].values()) > 8.0
    if name == "recorder":
        assert set(tables["tick"]["ticks"].values()) == {200} and set(tables["file"]["samples"].values()) == {600}


@pytest.mark.machine
def test_system_prints_a_line_for_each_row(run_script: Script) -> None:
    heads, *rows = run_script("benchmarks/system", "cells", "--empty", "100", "25").split("\n\n")[0].splitlines()
    assert heads.split()[:3] == ["sweeps", "seconds", "cells"]
    assert [row.split()[0] for row in rows] == [row.split()[3] for row in rows] == ["100", "25"]
