"""Sweeps of a user's scene by processes and a cluster that lack its file."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from functools import partial
from importlib.metadata import EntryPoint
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.errors import ParameterError
from maglev_mj.process import SideProcess
from maglev_mj.scenes.find import find_scene, text_of
from maglev_mj.scenes.names import GROUP
from maglev_mj.studies import sweep as sweeping
from maglev_mj.studies.cells import dask_workers, local_workers, run_cells
from maglev_mj.studies.record import Record
from maglev_mj.studies.sweep import Grid, run_scene_cells, sweep

FILE = '''
"""A magnet that pulls back by the cube of the distance."""

from typing import ClassVar

from maglev_mj.control import AxisLaw, gain
from maglev_mj.parameters import param
from maglev_mj.scenes.results import figure
from maglev_mj.scenes.scene import Scene, Start


class Cubic(AxisLaw):
    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")

    def force(self, x, v, gains, state):
        return -gains.stiffness * x - 1e9 * x * x * x - gains.damping * v


@figure("mm", "distance at the end")
def left(result):
    return float(abs(result.line.pose[-1, 0])) FURTHER


class Magnet(Scene):
    """Let the flotor go beside a magnet."""

    shown_axis: ClassVar = "x"
    figures: ClassVar = (left, "peak_speed")
    stiffness: float = param("stiffness", "N/m", default=1000.0, above=0.0)
    damping: float = param("damping", "N s/m", default=30.0, at_least=0.0)
    duration: float = param("time", "s", default=0.05, above=0.0)

    def laws(self):
        return [Cubic(axes="x", stiffness=self.stiffness, damping=self.damping)]

    def start(self):
        return Start(pose=(0.002, 0.0, 0.0, 0.0, 0.0, 0.0), gravity=0.0)
'''
DECLARED = """def gains(self):
        return (Gains("always", self.on_axes(self.stiffness), self.on_axes(self.damping)),)

"""
GRID = {"stiffness": [500.0, 1000.0, 2000.0], "damping": [20.0, 40.0]}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "magnet.py"
    path.write_text(FILE.replace("FURTHER", ""))
    return path


def test_a_changed_file_is_not_what_the_record_has(file: Path, tmp_path: Path) -> None:
    record, cells = tmp_path / "cells", Grid(find_scene(str(file))(), GRID, plant="exact")
    assert len(cells) == 6 and all(cell["scene"].startswith("magnet.py:Magnet@") for cell in cells)
    assert cells[1] == cells[0] | {"damping": 40.0}
    first = sweep(find_scene(str(file)), GRID, plant="exact", record=record)
    file.write_text(FILE.replace("FURTHER", "* 2.0"))
    with pytest.raises(
        ParameterError, match=r"record must be of this study [(]got '.*cells', which differs in scene[)]$"
    ):
        sweep(find_scene(str(file)), GRID, plant="exact", record=record)
    changed = sweep(find_scene(str(file)), GRID, plant="exact")
    assert first.figure("left").shape == (3, 2)
    np.testing.assert_array_equal(changed.figure("left"), 2.0 * first.figure("left"))
    elsewhere = file.parent / "other" / "magnet.py"
    elsewhere.parent.mkdir()
    elsewhere.write_text(FILE.replace("FURTHER", ""))
    again = sweep(find_scene(str(elsewhere)), GRID, plant="exact", record=record)
    assert (first.resumed, again.resumed) == (0, 6) and again.results == first.results
    file.write_text(FILE.replace("FURTHER", "+ 1 / 0"))
    found = sweep(find_scene(str(file)), {"damping": [20.0]}, plant="exact")
    assert found.results[0]["error"] == "ZeroDivisionError: division by zero" and np.isnan(found.figure("left")).all()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "where", ["1", pytest.param("2", marks=pytest.mark.machine), pytest.param("cluster", marks=pytest.mark.machine)]
)
def test_workers_run_a_scene_whose_file_is_gone(where: str, file: Path) -> None:
    cls = find_scene(str(file))
    cells, text = Grid(cls(), GRID, plant="exact"), text_of(cls)
    here = sweep(cls, GRID, plant="exact").results
    assert len({result["left"] for result in here}) == 6
    file.unlink()
    with ExitStack() as stack:
        if where == "cluster":
            from distributed import LocalCluster

            options: Any = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
            workers = dask_workers(stack.enter_context(LocalCluster(**options)).scheduler_address)
        else:
            workers = local_workers(int(where))
        assert run_cells(partial(run_scene_cells, text=text), cells, workers=workers, together=2) == here


@pytest.mark.parametrize("count", ["0", pytest.param("2", marks=pytest.mark.machine)])
def test_the_command_sweeps_a_file_on_processes(file: Path, count: str, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.chdir(file.parent)
    command = ["sweep", "magnet.py", "--vary", "stiffness=500,1000", "--set", "damping=20", "--set", "plant=exact"]
    assert main([*command, "--workers", count, "--json", "all.json"]) == 0
    said = capsys.readouterr().out
    assert "Sweep of magnet over stiffness (2): 2 cells\n" in said
    assert "\n  2 cells written to magnet-sweep-" in said
    data = json.loads((file.parent / "all.json").read_text())
    assert data["scene"] == "magnet" and data["varied"] == {"stiffness": [500.0, 1000.0]}
    assert [cell["damping"] for cell in data["cells"]] == [20.0, 20.0]


@pytest.fixture
def crowd(file: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Move beside a folder of a scene and modules that it needs, both with files named as the standard library's."""
    law = FILE[FILE.index("from maglev_mj.control") : FILE.index("@figure")]
    scene = FILE.replace(law, "import beside_it\nfrom maglev_mj import Scene, Start, figure, param\n")
    scene = scene.replace("        return [Cubic", "        from cubic_laws import Cubic\n\n        return [Cubic")
    texts = {file.name: scene.replace("FURTHER", "* beside_it.pitch"), "beside_it.py": "pitch = 1.0\n"}
    texts |= {"cubic_laws/__init__.py": "from .cubic import Cubic\n", "cubic_laws/cubic.py": law}
    names = [f"{folder}/{name}.py" for folder in (".", "here") for name in sys.stdlib_module_names]
    texts |= dict.fromkeys(names, "raise ImportError\n")
    for name, text in texts.items():
        (path := file.parent / name).parent.mkdir(exist_ok=True)
        path.write_text(text)
    monkeypatch.chdir(file.parent / "here")
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield Path("..", file.name)
    for name in ("beside_it", "cubic_laws", "cubic_laws.cubic"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("line", ["run FILE", "stability FILE", "sweep FILE --vary damping=20 --workers 1"])
def test_a_file_finds_modules_beside_it_in_a_crowd_of_others(line: str, crowd: Path) -> None:
    assert main(line.replace("FILE", str(crowd)).split()) == 0


def test_a_side_process_starts_in_a_crowd_of_modules(crowd: Path) -> None:
    with closing(SideProcess(Connection.send, "hello")) as process:
        assert process.line.poll(60.0) and process.line.recv() == "hello"


def test_a_sweep_without_a_finished_cell_has_failed(file: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.chdir(file.parent)
    file.write_text(FILE.replace("FURTHER", "+ 1 / 0"))
    assert main(["sweep", str(file), "--vary", "damping=20,40", "--workers", "0"]) == 1
    assert capsys.readouterr().err == "maglev-mj sweep: no cell finished: ZeroDivisionError: division by zero\n"
    with pytest.raises(ParameterError, match=r"^file magnet\.py cannot be read: ModuleNotFoundError"):
        run_scene_cells(Grid(find_scene(str(file))(), {}, plant="exact")[:], text="import nowhere_at_all")


def test_a_scene_of_another_package_goes_by_its_place_and_a_hash(file: Path, monkeypatch: Any) -> None:
    monkeypatch.syspath_prepend(file.parent)
    monkeypatch.setattr(sweeping, "installed_scenes", lambda: [EntryPoint("magnet", "magnet:Magnet", GROUP)])
    import magnet  # type: ignore[import-not-found]

    (cell,) = Grid(magnet.Magnet(), {}, plant="exact")
    assert cell["scene"].startswith("magnet:Magnet@") and len(cell["scene"]) == len("magnet:Magnet@") + 16
    assert sweep(magnet.Magnet, {"phase": [0.0]}, plant="exact").results == run_scene_cells([cell])


def test_a_large_grid_is_refused_at_its_corners_at_once_and_inside_by_the_worker(file: Path, tmp_path: Path) -> None:
    vary: dict[str, list[float]] = {"delay": np.linspace(0.0, 0.0501, 100).tolist(), "mass": [0.6] * 50}
    with pytest.raises(ParameterError, match=r"delay must be .*\(got 0\.0501"):
        Grid(find_scene("wall")(), vary | {"period": np.linspace(0.005, 0.006, 100).tolist()}, plant="exact")
    Grid(find_scene("wall")(), {"delay": [0.0, 0.0501]}, plant="none")  # theory alone
    file.write_text(
        FILE.replace("FURTHER", "")
        .replace("- 1e9 * x * x * x ", "")
        .replace("def force", f"{DECLARED}    def force")
        .replace("import AxisLaw, gain", "import AxisLaw, Gains, gain")
        + """
    def check(self):
        if (self.stiffness, self.damping) == (1350.0, 57.0):
            raise ValueError("stiffness must be another")
"""
    )
    with pytest.raises(ValueError, match="stiffness must be another"):  # in the middle of a small one
        Grid(find_scene(str(file))(), {"stiffness": [1340.0, 1350.0, 1360.0], "damping": [56.0, 57.0, 58.0]})
    grid = {"stiffness": [1000.0 + 10.0 * k for k in range(40)], "damping": [40.0 + k for k in range(30)]}
    record = tmp_path / "record"
    with pytest.raises(ValueError, match="stiffness must be another"):
        sweep(find_scene(str(file)), grid, plant="exact", record=record)
    kept = Record(record)
    kept.begin(Grid(find_scene(str(file))(), grid, plant="exact"))
    assert 0 < kept.done.sum() < 1200


@pytest.mark.parametrize(
    ("vary", "words"),
    [
        (
            {"phase": [0.1]},
            r"parameter of twist must be one of plant, device, period, delay, duration, rate \(got 'phase'\)",
        ),
        ({"plant": ["moon"]}, r"plant must be one of exact, mujoco \(got 'moon'\)"),
        ({"duration": [0.1, -1.0]}, "duration must be above 0"),
        ({"duration": [0.1] * 10010, "period": [0.005] * 10000}, "at most 100000000 cells [(]got 100100000"),
    ],
)
def test_a_grid_is_refused_before_anything_runs(vary: dict[str, list[Any]], words: str) -> None:
    twist = find_scene("twist")
    with pytest.raises(ParameterError, match=words):
        sweep(twist, vary)
    with pytest.raises(ParameterError, match="must be at the top level of a file, so that others"):
        sweep(type("Local", (twist,), {"__qualname__": "in.<locals>.Local"}), {"duration": [0.1]})


def test_cells_of_a_slice_run_as_those_by_index_derived_parameters_too() -> None:
    vary: dict[str, list[Any]] = {
        "axis": ["x", "rx"],
        "stiffness": [None, 500.0],
        "plant": ["exact"],
        "duration": [0.05],
    }
    grid = Grid(find_scene("stick-slip")(), vary)
    cells = list(grid)
    assert cells[0]["stiffness"] != cells[2]["stiffness"] and cells[1]["stiffness"] == cells[3]["stiffness"] == 500.0
    assert [grid[-1], *grid[1:3]][0] == cells[3] and len(grid[1:3]) == 2
    assert run_scene_cells(grid[0:4]) == run_scene_cells(cells)


def test_help_and_refusals_know_the_parameters_of_the_scene(file: Path, capsys: Any) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["sweep", str(file), "--help"])
    said = capsys.readouterr().out
    assert re.search(r"^  stiffness +stiffness \[N/m\] \(default 1000\)$", said, re.MULTILINE)
    assert re.search(r"^  phase +sampling phase", said, re.MULTILINE)
    file.write_text(FILE.replace("FURTHER", "").replace("damping: float = param", "share: float = param"))
    with pytest.raises(SystemExit, match="2"):
        main(["fidelity", str(file)])
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "scene magnet is not supported by this command: argument --share" in said
