"""Benchmark runner: sections, paired ratios, tables, pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

import bench
import growth
import loop
import options
import realism
import speed_tables
import timing
import walls
from maglev_mj import ExactPlant
from tests.rows import check_rows

ROOT = Path(__file__).resolve().parents[2]


def test_tables_of_the_documentation_have_every_number_with_its_range() -> None:
    pair = {"before": [{"x": 2.0}, {"x": 2.0}], "after": [{"x": 1.0}, {"x": 3.0}]}
    sides = {
        "after": [{"cost": {"a": 1.0, "b": 2.0}, "error": {"a": 0.0}}, {"cost": {"a": 3.0, "b": 2.0}, "error": {}}]
    }
    lines = speed_tables.compared_table(bench.summary(pair))
    assert lines[2:] == ["| x | 2 | 2 | 1 to 3 | 1 | 0.5 to 1.5 |"]
    assert speed_tables.side_by_side(bench.summary(sides))[2:] == ["| a | 2 (1 to 3) | 0 |", "| b | 2 |  |"]
    apart = speed_tables.side_by_side(bench.summary({"after": [{"one": {"a": 1.0}, "other": {"b": 2.0}}]}))
    assert apart[2:] == ["| *one* | |", "| a | 1 |", "| *other* | |", "| b | 2 |"]


def test_a_section_that_fails_is_named_with_its_error(tmp_path: Path) -> None:
    with pytest.raises(bench.SectionFailedError, match="no_such_section failed: ModuleNotFoundError"):
        bench.run_section("no_such_section", ROOT, quick=True)
    (tmp_path / "empty_section.py").write_text("def measure(quick):\n    return {}\n")
    with pytest.raises(bench.SectionFailedError, match="not the package in"):  # what is measured is what was asked for
        bench.run_section("empty_section", tmp_path, quick=True)


def test_each_row_of_the_loop_counts_what_it_ran_and_every_drop_ends_alike() -> None:
    runs = {name: work() for name, work in loop.WORK.items()}
    many, alone = "exact plant, 1000 at once: closed loop", "six-axis controller"
    assert {name: run.devices for name, run in runs.items()} == dict.fromkeys(runs, 1) | {many: 1000}
    assert {name: run.ticks for name, run in runs.items()} == dict.fromkeys(runs, 400) | {alone: 1000}
    assert runs[many]._replace(seconds=2.0).each == 2.0 / 400 / 1000
    assert runs[many].pose.shape == (1000, 6)
    loop.compare_ends(runs)
    elsewhere = runs[many].pose.copy()
    elsewhere[-1, 2] += 1e-6  # one device of them
    with pytest.raises(ValueError, match=f"{many}: its drop ends at"):
        loop.compare_ends(runs | {many: runs[many]._replace(pose=elsewhere)})


def test_options_and_growth_count_what_they_ran(monkeypatch: pytest.MonkeyPatch) -> None:
    few = options.Loop(ExactPlant, {options.PLAIN: {}, "recording": {"record": True}}, options.many(3, 1e-4), 4, 1)
    found = options.over_plain(few, quick=False)
    assert found["devices"] == dict.fromkeys(few.options, 3) and found["ticks"] == dict.fromkeys(few.options, 4)
    assert list(found["over plain"]) == list(few.options)
    check_rows(found)
    assert growth.cheapest_run(ExactPlant, 10).devices == 10
    run = options.run
    monkeypatch.setattr(options, "run", lambda one, name, ticks: run(one, name, ticks - (name != options.PLAIN)))
    with pytest.raises(ValueError, match="the same for each option"):
        options.over_plain(few, quick=False)


def test_a_row_divides_its_total_by_what_it_counts_and_runs_of_a_row_count_the_same() -> None:
    runs = [timing.Run(seconds, 10, 4) for seconds in (8.0, 2.0, 4.0)]
    found = timing.columns({"many": runs, "one": timing.Run(3.0, 1, 6)})
    assert found["seconds"] == {"many": 4.0, "one": 3.0} and found["devices"] == {"many": 10, "one": 1}
    check_rows(found)
    assert found["µs a tick and device"] == pytest.approx({"many": 1e5, "one": 5e5})
    with pytest.raises(ValueError, match="many: runs must count the same devices and ticks"):
        timing.columns({"many": [*runs, runs[0]._replace(devices=1)]})


def test_walls_realism_and_growth_count_what_they_ran(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walls, "PART", 20)
    found = walls.walls(50)
    assert list(found["devices"].values()) == [50] and list(found["ticks"].values()) == [walls.SAMPLES]
    check_rows(found)
    cells = walls.sweeps(quick=True)
    assert cells["cells"] == {"drop, 64": 64}
    check_rows(cells)
    plain = realism.Piece(realism.EXACT, {})
    assert realism.cost(plain, 2)[1:3] == (1, realism.parts(plain)[2])
    runs = {count: growth.cheapest_run(ExactPlant, count) for count in (1, 10)}
    table = growth.nested({"exact plant": runs})
    assert table["devices"] == {"exact plant": {1: 1, 10: 10}} and set(table["ticks"]["exact plant"].values()) == {60}
    check_rows({head: column["exact plant"] for head, column in table.items()})


def test_an_estimate_is_bounded_by_the_workers_and_by_what_hands_out() -> None:
    row = {"start (s)": 0.5, "cells a second": 100.0}
    found = {"1 worker": row, "2 workers": {**row, "cells a second": 160.0}}
    found["Dask, 2 workers"] = {**row, "cells a second": 180.0, "empty jobs a second": 500.0}
    few, many = growth.estimate(found, 100, 3200), growth.estimate(found, 100, 100_000)
    # the slowest of a worker alone, half of two, half of two on the cluster
    assert few["cells a second and worker"] == 80.0
    assert few["cells a second"] == 500.0  # a cell a job
    assert many["cells a second"] == 8000.0 and many["cells a second, by the scheduler"] == 31 * 500.0
    assert many["seconds"] == pytest.approx(0.5 + 100_000 / 8000.0)
