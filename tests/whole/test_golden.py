"""Outputs of the commands against stored ones, number by number.

tests/golden/README.md describes changes.
"""

from __future__ import annotations

import math
from copy import deepcopy
from functools import cache
from typing import Any

import pytest

from tests.golden.outputs import HERE, KEYS, PRESSED, as_kept, cases, differences, kept, outcome, pressed

kept_once = cache(kept)


def case(name: str, line: str) -> Any:
    """Return a case; those that read the files of one earlier command share a worker, which runs it once."""
    earlier, joined, _ = line.rpartition(" && ")
    marks = [pytest.mark.xdist_group(earlier)] if joined else []
    return pytest.param(name, marks=[*marks, *[pytest.mark.study] * (name in cases("values"))])


@pytest.mark.parametrize("name", [case(*item) for item in cases().items()])
def test_a_command_says_what_it_said(name: str) -> None:
    group, found = name.split("/")[0], as_kept(outcome(cases()[name]))
    lines = differences(group, kept_once(group)[name], found)
    failed = [*found["stdout"], *found["stderr"]] if found["status"] != kept_once(group)[name]["status"] else []
    assert not lines, f"{len(lines)} differences:\n" + "\n".join([*lines[:10], *failed])


def test_an_earlier_command_that_fails_is_shown_with_its_errors() -> None:
    with pytest.raises(AssertionError, match=r"maglev-mj drop --rate 0: exit status 2\n.*argument --rate"):
        outcome("drop --rate 0 && replay run.maglev")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.study] * (name != "corner")) for name in PRESSED]
)
def test_keys_pressed_at_random_have_the_same_effects(name: str) -> None:
    results = pressed(name)
    first = len(results) * PRESSED.index(name)
    lines = differences(KEYS, kept_once(KEYS)["pressed"][first : first + len(results)], as_kept(results))
    assert not lines, "\n".join(lines[:10])


def test_every_case_is_kept_and_no_other() -> None:
    groups = {file.name.removesuffix(".json.gz") for file in (HERE / "expected").iterdir()}
    held = {name for group in groups for name in kept_once(group)}
    assert held == {*cases(), "pressed"}


def test_every_recording_is_used() -> None:
    lines = " ".join(cases().values())
    for path in (HERE / "recordings").rglob("*.*"):
        assert f"@{path.name}" in lines


def changed(said: Any, where: str, new: Any) -> Any:
    """Return a copy of an output with one value replaced.

    `where` has names and indices with dots between.
    """
    copy = deepcopy(said)
    *way, last = (int(part) if part.isdigit() else part.replace("_json", ".json") for part in where.split("."))
    inner = copy
    for part in way:
        inner = inner[part]
    inner[last] = new(inner[last]) if callable(new) else new
    return copy


@pytest.mark.parametrize(
    ("where", "new", "near"),
    [
        ("files.out_json.z.some.3", lambda z: math.nextafter(z, 1.0), True),
        ("files.out_json.z.some.3", lambda z: z * (1.0 + 1e-8), False),
        ("files.out_json.z.sum", lambda total: total * (1.0 + 1e-8), False),
        ("files.out_json.parameters.force_limit", 60.0, False),
        ("files.out_json.summary.peak_force", 95, False),
        ("files.out_json.force.length", lambda count: count - 1, False),
        ("stdout.6", lambda line: line.replace("2.54", "2.55"), True),
        ("stdout.6", lambda line: line.replace("mm", "m"), False),
        ("stdout", lambda lines: [*lines, ""], False),
        ("stderr", ["a warning"], False),
        ("status", 1, False),
    ],
)
def test_one_change_is_seen(where: str, new: Any, near: bool) -> None:
    old = kept_once("drop")["drop/default"]
    found = changed(old, where, new)
    assert bool(differences("drop", old, found)) != near
    assert not differences("drop", old, deepcopy(old))


@pytest.mark.parametrize(
    ("name", "new", "near"),
    [
        ("value", lambda value: value * (1.0 + 1e-6), True),
        ("value", lambda value: value * (1.0 + 1e-4), False),
        ("value", None, False),
        ("standard_error", 1.0, True),
        ("why", "it never moves", False),
    ],
)
def test_an_identified_value_that_changes_is_seen(name: str, new: Any, near: bool) -> None:
    old = kept_once("analyse")["analyse/kept drop-exact.maglev"]
    found = changed(old, f"files.out_json.stretches.0.identified.walls.0.stiffness.{name}", new)
    assert bool(differences("analyse", old, found)) != near
