"""First lines of docstrings are short and plain."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MOST_WORDS = 16
CODE = re.compile(r"`[^`]*`")  # names of the program are no words
RULES = {
    "a clause": re.compile(r"\bthat which\b", re.IGNORECASE),
    "a literary word": re.compile(
        r"\b(nobody|for ever|lets? go|likewise|askew|reckon(s|ed)?|came to|is none|for a person)\b", re.IGNORECASE
    ),
}


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Yield line number and text of each docstring, attributes' too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, cleandoc(node.value.value)


def faults(text: str) -> list[str]:
    """Return the broken rules of a docstring's first line."""
    first, *rest = text.split("\n")
    words, plain = len(first.split()), CODE.sub("", first)
    found = [f"{words} words, at most {MOST_WORDS}"] if words > MOST_WORDS else []
    found += [f"{kind} ({match[0]})" for kind, rule in RULES.items() if (match := rule.search(plain))]
    return found + ["a second line without a blank one between"] * bool(rest and rest[0])


@pytest.mark.parametrize("folder", ["docs", "maglev_mj", "scripts", "tests"])
def test_first_lines_are_short_and_plain(folder: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {', '.join(broken)}: {text.splitlines()[0]}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, text in docstrings(path.read_text(encoding="utf-8"))
        if (broken := faults(text))
    ]
    assert not found, "\n".join([f"{len(found)} first lines", *found])


@pytest.mark.parametrize(
    ("text", "broken"),
    [
        ("Return the largest stable stiffness.", []),
        ("Return one line of sixteen words, as many as a first line of one sentence has.", []),
        (
            "Return one line of the seventeen words that a first line of one sentence must not have.",
            ["17 words, at most 16"],
        ),
        ("Return where the flotor sticks.", []),
        ("Return the wrench of that which is held.", ["a clause (that which)"]),
        ("Hand that lets go of the flotor.", ["a literary word (lets go)"]),
        ("Recording status, for a person.", ["a literary word (for a person)"]),
        ("Return the option `--at WHERE`.", []),
        ("Return the mass\nof the flotor.", ["a second line without a blank one between"]),
        ("Return the mass.\n\nIt is what a scale shows.", []),
    ],
)
def test_each_rule_has_an_example(text: str, broken: list[str]) -> None:
    assert faults(text) == broken


def test_docstrings_of_modules_classes_functions_and_attributes_are_found() -> None:
    source = (
        '"""Module."""\nA = 1\n"""Attribute."""\nclass B:\n    """Class."""\n    def c(self):\n        """Method."""\n'
    )
    assert sorted(docstrings(source)) == [(1, "Module."), (3, "Attribute."), (5, "Class."), (7, "Method.")]
