"""Outputs that cannot be written: refused before any work."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from maglev_mj import cli
from maglev_mj.cli import output, program
from maglev_mj.cli.program import COMMANDS
from tests.cli.test_options import NEEDED

INPUTS = {"--device", "--hand-path", "--key", "--model", "--profile", "--truth"}


def outputs() -> list[tuple[str, str, str]]:
    """Return command, option and kind of each output in the help."""
    found = []
    for command in COMMANDS:
        parser = program.command_parser(command, NEEDED.get(command, "").split())
        program.add_options(parser, command)
        for action in parser._actions:
            option = action.option_strings[0] if action.option_strings else ""
            if option and action.metavar in ("FILE", "DIR") and option not in INPUTS:
                found.append((command, option, str(action.metavar)))
    return found


OUTPUTS = [*outputs(), ("commission", "--write", "FILE")]


@pytest.fixture
def closed(tmp_path: Path) -> Path:
    """Return a folder that takes no files, of root either."""
    if Path("/proc/self").is_dir():
        return Path("/proc")
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o500)
    return folder


def words_of(command: str, option: str, path: Path) -> list[str]:
    """Return a command line whose other arguments are right."""
    needed = NEEDED.get(command, "").split()
    if command == "commission":
        needed = ["udp://127.0.0.1:9", "offsets"]
    if command == "render":
        needed = []
    return [command, *needed, option, str(path)]


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that is refused; return its message."""
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1, captured
    return captured.err


@pytest.mark.parametrize(("command", "option", "kind"), OUTPUTS)
def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    command: str,
    option: str,
    kind: str,
    closed: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    name, what = option.removeprefix("--"), "file" if kind == "FILE" else "folder"
    path = closed / "new.maglev"
    told = refused(words_of(command, option, path), capsys)
    assert told.endswith(f": {name} must be a writable {what} (got {str(path)!r})\n")
    held = tmp_path / "held"
    held.write_text("")
    told = refused(words_of(command, option, held / "new.maglev" if what == "file" else held / "below"), capsys)
    assert f": {name} must be a {what}" in told and str(held) in told
    assert [*tmp_path.iterdir()] == [held] and not held.read_text()


def test_every_output_is_known() -> None:
    assert {option.removeprefix("--") for _, option, _ in OUTPUTS} == {*output._OUTPUTS}
    files = {command for command, option, kind in OUTPUTS if (option, kind) == ("--out", "FILE")}
    assert files | {"convert"} == {*output._FILES}  # whose output is no option
    assert len(OUTPUTS) >= 30


def test_an_output_without_an_option_is_checked_too(
    closed: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = closed / "flight.maglev"
    told = refused(["convert", str(recording), str(closed / "flight.csv")], capsys)
    assert told == f"maglev-mj convert: out must be a writable file (got '{closed}/flight.csv')\n"
    monkeypatch.chdir(closed)
    told = refused(["sweep", "drop", "--vary", "height=0.001,0.002"], capsys)
    assert re.fullmatch(r"maglev-mj sweep: record must be a writable folder \(got 'drop-sweep-\w{8}'\)\n", told)
    told = refused(["drop", "--out", "."], capsys)
    assert told == "maglev-mj run: out must be a writable folder (got '.')\n"


def test_a_session_starts_in_a_folder_that_takes_no_files(closed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(closed)
    output.check_outputs(program.parse(["view"]))  # its recordings have a second place
