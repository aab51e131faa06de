"""Tables of sweeps: a row for each cell where nothing but choices vary, else the spread of each figure."""

from __future__ import annotations

from typing import Any

import pytest

from maglev_mj import find_scene, sweep
from maglev_mj.scenes.results import figure_head


@pytest.mark.parametrize(
    ("scene", "vary"),
    [
        ("drop", {"wall_on": ["host", "device"], "pulse": [0.0]}),
        ("stick-slip", {"law": ["stick-slip", "dahl", "lugre"], "velocity": ["difference", "low-pass"]}),
        ("twist", {"plant": ["exact", "mujoco"]}),
    ],
)
def test_a_sweep_of_choices_has_a_row_for_each_cell(scene: str, vary: dict[str, list[Any]]) -> None:
    brief = find_scene(scene)().replace(duration=0.03)
    swept = sweep(brief, vary)
    table, columns = swept.table(), swept.columns()
    names = [name for name in swept.names if swept.is_number(name)]
    assert [head.partition(" [")[0] for head in table.head] == [*vary, *map(figure_head, names)]
    for index, row in enumerate(table.rows):
        assert [*row[: len(vary)]] == [columns[name][index] for name in vary]
        assert [*row[len(vary) :]] == [swept.shown(name).text(columns[name][index]) for name in names]
    assert len(table.rows) == len(swept.results)
    more = sweep(brief, {**vary, "delay": [0.001, 0.002]}).table()
    assert {"min", "median", "max"} <= {*more.head} and not {"min", "median", "max"} & {*table.head}
