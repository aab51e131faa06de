"""Outputs of the commands against stored ones, number by number.

tests/golden/README.md describes changes.
"""

from __future__ import annotations

import math
from copy import deepcopy
from functools import cache
from typing import Any

import pytest

from tests.golden.outputs import HERE, KEYS, as_kept, cases, differences, kept, outcome, pressed

kept_once = cache(kept)


@pytest.mark.parametrize("name", cases())
def test_a_command_says_what_it_said(name: str) -> None:
    group, found = name.split("/")[0], as_kept(outcome(cases()[name]))
    lines = differences(group, kept_once(group)[name], found)
    failed = [*found["stdout"], *found["stderr"]] if found["status"] != kept_once(group)[name]["status"] else []
    advice = f"if they are wanted: python -m tests.golden.make {group}"
    assert not lines, f"{len(lines)} differences, {advice}:\n" + "\n".join([*lines[:10], *failed])


def test_keys_pressed_at_random_have_the_same_effects() -> None:
    lines = differences(KEYS, kept_once(KEYS)["pressed"], as_kept(pressed()))
    assert not lines, "\n".join(lines[:10])


def test_every_case_and_every_recording_is_used() -> None:
    groups = {file.name.removesuffix(".json.gz") for file in (HERE / "expected").iterdir()}
    assert {name for group in groups for name in kept_once(group)} == {*cases(), "pressed"}
    assert all(f"@{path.name}" in " ".join(cases().values()) for path in (HERE / "recordings").iterdir())


CHANGES: list[tuple[str, Any, bool]] = [
    ("files.out_json.z.some.3", lambda z: math.nextafter(z, 1.0), True),
    ("files.out_json.z.some.3", lambda z: z * (1.0 + 1e-8), False),
    ("files.out_json.z.sum", lambda total: total * (1.0 + 1e-8), False),
    ("files.out_json.parameters.force_limit", 59.0, False),
    ("files.out_json.force.length", lambda count: count - 1, False),
    ("stdout.7", lambda line: line.replace("2.98", "2.99"), True),
    ("stdout.7", lambda line: line.replace("mm", "m"), False),
    ("stdout", lambda lines: [*lines, ""], False),
    ("stderr", ["a warning"], False),
    ("status", 1, False),
]
WALL = "files.out_json.segments.0.identified.walls.0.stiffness."
FITTED: list[tuple[str, Any, bool]] = [
    (f"{WALL}value", lambda value: value * (1.0 + 1e-6), True),
    (f"{WALL}value", lambda value: value * (1.0 + 1e-4), False),
    (f"{WALL}standard_error", 1.0, True),
    (f"{WALL}why", "it never moves", False),
]


@pytest.mark.parametrize(
    ("name", "changes"), [("drop/default", CHANGES), ("analyse/kept drop-exact.maglev", FITTED)], ids=["run", "fit"]
)
def test_one_change_is_seen_and_rounding_is_none(name: str, changes: list[tuple[str, Any, bool]]) -> None:
    group = name.split("/")[0]
    old = kept_once(group)[name]
    assert not differences(group, old, deepcopy(old))
    for where, new, near in changes:
        found = deepcopy(old)
        *way, last = (int(part) if part.isdigit() else part.replace("_json", ".json") for part in where.split("."))
        inner = found
        for part in way:
            inner = inner[part]
        inner[last] = new(inner[last]) if callable(new) else new
        assert bool(differences(group, old, found)) != near, where
