"""Pictures of the documentation: every file has its command, and none shows an older product."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import pictures

ROOT = Path(__file__).parents[2]


def test_every_picture_is_made_by_a_command_and_shown() -> None:
    stored = {path.name for path in pictures.IMAGES.iterdir() if path.suffix in (".png", ".gif")}
    by_hand = {name for name in stored if name.startswith("speed_")}  # of `make bench`
    assert stored - by_hand == set(pictures.PICTURES)
    pages = "".join(path.read_text("utf-8") for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
    assert stored <= set(re.findall(r"images/([\w-]+\.\w+)", pages + (ROOT / "scripts/README.md").read_text("utf-8")))


def test_renders_and_pages_show_the_product_as_it_is() -> None:
    assert not pictures.outdated(), "make pictures"


@pytest.mark.parametrize("shows", pictures.INPUTS)
def test_a_change_of_what_pictures_show_makes_them_outdated(shows: str, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = [name for name, picture in pictures.PICTURES.items() if picture.shows == shows]
    monkeypatch.setitem(pictures.INPUTS, shows, [*pictures.INPUTS[shows], "README.md"])
    assert shown and pictures.outdated() == shown
