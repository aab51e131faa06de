"""Fragments of the changelog have the form that their README asks for."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "changelog.d"
MOST = 20
"""Words of a fragment, as its README says."""


def complaints(text: str) -> list[str]:
    """Return what is wrong with the text of a fragment."""
    words = len(text.split())
    return [
        complaint
        for complaint, holds in {
            "more than one line": text.count("\n") != 1 or not text.endswith("\n"),
            "not a sentence from a capital to a full stop": not re.fullmatch(r"[A-Z`][^\n]*[.`)]\n", text),
            f"{words} words": words > MOST,
        }.items()
        if holds
    ]


def test_every_fragment_is_one_short_sentence_without_a_mark_of_a_list() -> None:
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    kinds = re.findall(r"`NAME\.(\w+)\.md`", page)
    files = [path for path in FOLDER.iterdir() if path.name != "README.md"]
    assert [path.name for path in files if not re.fullmatch(rf"[\w-]+\.({'|'.join(kinds)})\.md", path.name)] == []
    wrong = {path.name: complaints(path.read_text(encoding="utf-8")) for path in files}
    assert {name: found for name, found in wrong.items() if found} == {} and f"at most {MOST} words" in " ".join(
        page.split()
    )


def test_a_fragment_of_another_form_is_found() -> None:
    assert complaints("- Add a thing.\n") and complaints("add a thing.\n") and complaints("Add a thing\n")
    assert complaints("Add a thing.\n\nAnd more.\n") and complaints("Add " + "a thing " * 10 + ".\n")
    assert not complaints("Accept 12.5 typed beside a slider as 12.5; it was read as 125.\n")
