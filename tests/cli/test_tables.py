"""Tables of all results in terminals of several widths."""

from __future__ import annotations

import os
import random
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from maglev_mj import terminal
from maglev_mj.result import Table
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.studies.sweep import sweep
from tests.cli.test_result import of_each_kind
from tests.studies.test_charts_of_all import CASES, result_of

pytestmark = pytest.mark.xdist_group("tabular")

WIDTHS = 60, 80, 120


@pytest.fixture(params=WIDTHS)
def columns(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Set the width of the terminal."""
    monkeypatch.setattr("maglev_mj.result.width", lambda: request.param)
    monkeypatch.setattr(terminal, "width", lambda: request.param)
    return int(request.param)


def tables_of(table: Table) -> list[Table]:
    """Return a table and all below it."""
    return [table, *(one for below in table.below for one in tables_of(below))]


def check(table: Table, columns: int) -> int:
    """Check a table without those below: it fits, blocks stand apart; return the number of its blocks."""
    alone = table._replace(title="", headline="", note="", warnings=(), below=())
    text = str(alone)
    assert max(map(len, text.splitlines()), default=0) <= columns
    blocks = text.split("\n\n") if text else []
    for block in blocks:
        assert all(line.startswith("  ") for line in block.splitlines())
    words = " ".join(text.split())
    heads = [str(name).partition(" [")[0] for name in table.head]
    if table.rows and all(len(head) < 12 for head in heads):
        assert all(head in words for head in heads)
    return len(blocks)


NAMES = [kind.__name__ for kind in of_each_kind()]


@pytest.mark.parametrize("name", [*NAMES, *CASES])
def test_a_table_fits_and_its_blocks_stand_apart(name: str, columns: int) -> None:
    result = result_of(name)
    for table in tables_of(result.table()):
        check(table, columns)
    assert max(map(len, str(result.table()).splitlines())) <= columns


def test_any_table_is_wrapped_with_blank_lines_between_its_blocks(columns: int) -> None:
    draw, counts = random.Random(5), set[int]()
    for _ in range(150):
        sizes = [draw.randint(3, 14) for _ in range(draw.randint(2, 12))]
        head = ["figure", *(f"c{'x' * size}" for size in sizes)]
        rows = [[f"name {row}", *(draw.uniform(0.0, 99.0) for _ in sizes)] for row in range(draw.randint(1, 4))]
        table = Table("", head, rows)
        counts.add(check(table, columns))
        cells = [word for line in str(table).splitlines() for word in line.split()]
        assert all(cells.count(name) == 1 for name in head[1:] if head.count(name) == 1)  # none is lost, none is double
    assert max(counts) > 1


def test_one_cell_has_a_value_and_no_statistics() -> None:
    for vary in ({"law": ["stick-slip", "dahl"]}, {"stiffness": [6000.0]}):
        table = sweep(Pull(), vary, plant="exact").table()
        assert not {"min", "median", "max", "cells"} & {*table.head} and len(table.rows) == len(*vary.values())
        assert all(len(row) == len(table.head) for row in table.rows)
    several = sweep(Pull(), {"law": ["stick-slip", "dahl"], "breakaway": [1.0, 2.0]}, plant="exact").table()
    assert {"min", "median", "max", "cells"} <= {*several.head}


def test_a_table_is_as_wide_as_its_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert terminal.width() == 80  # of no terminal
    monkeypatch.setattr(sys, "stdout", SimpleNamespace(fileno=lambda: 1))
    for columns, wanted in ((20, 60), (60, 60), (100, 100), (300, 120), (0, 80)):
        size: Any = os.terminal_size((columns, 24))
        monkeypatch.setattr(os, "get_terminal_size", lambda _, size=size: size)
        assert terminal.width() == wanted
