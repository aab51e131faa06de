"""Command lines of earlier versions: each gives what its new line gives, and a note that names the new line."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.cli import main
from maglev_mj.cli.program import COMMANDS
from maglev_mj.cli.renamed import RENAMED, renewed

LINES = {
    "tour": "view --tour",
    "tour --web --out made --seconds=3": "view --tour --web --out made --seconds=3",
    "tour --port 5680": "view --tour --port 5680",
}
"""Old lines and the new ones."""

KEPT = ["view", "view --tour", "drop", "--help", ""]
"""Lines that are no old ones."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder to run lines in, without window and page."""
    monkeypatch.setattr("maglev_mj.cli.peripherals.PageOptions.open", lambda self: id if self.web else None)
    monkeypatch.setattr("maglev_mj.cli.scenes._show", lambda source, *rest: print(type(source).__name__, rest[3]))
    monkeypatch.setattr("maglev_mj.views.window.window.require_display", lambda: None)
    return tmp_path


def outcome(line: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> tuple[Any, ...]:
    """Run a line in a new folder; return status, output, errors, and what it wrote."""
    folder.mkdir()
    monkeypatch.chdir(folder)
    try:
        status = main(shlex.split(line))
    except SystemExit as ended:
        status = int(ended.code or 0)
    out, errors = capsys.readouterr()
    return status, out, errors, {str(path): path.is_file() and path.stat().st_size for path in Path().rglob("*")}


@pytest.mark.parametrize(("old", "new"), LINES.items())
def test_an_old_line_gives_what_its_new_line_gives_and_a_note(
    old: str, new: str, here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, errors, written = outcome(old, here / "old", monkeypatch, capsys)
    told, _, errors = errors.partition("\n")
    assert told == f"maglev-mj: {old.split()[0]} has another name now: maglev-mj {new}"
    assert (status, out, errors, written) == outcome(new, here / "new", monkeypatch, capsys)
    assert new.split()[0] in COMMANDS and renewed(shlex.split(new)) is None


def test_every_row_of_the_table_is_the_first_that_fits_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not [line for line in KEPT if renewed(line.split()) is not None]
    for row in RENAMED:
        monkeypatch.setattr("maglev_mj.cli.renamed.RENAMED", [other for other in RENAMED if other != row])
        changed = [old for old, new in LINES.items() if renewed(shlex.split(old)) != shlex.split(new)]
        assert changed, row
