"""Rows of the benchmarks' tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest


def check_rows(table: Mapping[str, Mapping[Any, float]]) -> None:
    """Check that the time of each row is its total divided by what it counts."""
    (each,) = (head for head in table if head.startswith("µs a "))
    counted = each.removeprefix("µs a ").removesuffix(" and device") + "s"
    for name, seconds in table["seconds"].items():
        things = table[counted][name] * table.get("devices", {}).get(name, 1)
        assert things >= 1 and table[each][name] == pytest.approx(1e6 * seconds / things, rel=1e-9)
