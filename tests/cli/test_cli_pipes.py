"""Closed output pipes: no message, and status 141.

As a shell gives for any program that a closed pipe ends.
"""

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import TextIO

import pytest

from maglev_mj.cli import main
from maglev_mj.cli.program import COMMANDS
from maglev_mj.scenes.drop import Drop
from maglev_mj.session.replay import write_run


def outcome(stream: TextIO, *words: str, both: bool = False) -> tuple[int, str]:
    """Run a command that prints to a stream, also its errors if `both`; return status and error messages."""
    errors = io.StringIO()
    with stream, redirect_stdout(stream), redirect_stderr(stream if both else errors):
        return main(words), errors.getvalue()


@pytest.mark.parametrize(("lines", "both"), [(False, False), (True, True)])
def test_a_table_that_nobody_reads_is_silent(lines: bool, both: bool) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    pipe = os.fdopen(writer, "w", buffering=1 if lines else -1)  # written at once, or at the end
    assert outcome(pipe, "drop", "--plant", "exact", both=both) == (141, "")


ONE_BY_ONE = """
import os, sys
from maglev_mj.cli import main
told = os.fdopen(os.dup(2), "w")
for line in sys.stdin:
    reader, writer = os.pipe()
    os.dup2(writer, 1)
    os.close(reader), os.close(writer)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    try:
        status = main(line.split())
    except SystemExit as ending:
        status = ending.code
    print(status, line.strip(), file=told, flush=True)
"""


@pytest.mark.machine
def test_every_command_is_silent_where_nobody_reads(tmp_path: Path) -> None:
    """Every command is silent on a closed pipe.

    In one process, each with a pipe of its own. Long commands and those with a window run with --help.
    """
    write_run(tmp_path / "run.maglev", Drop(), plant="exact")
    lines = [
        "drop --json -",
        "press --plant exact",
        "stick-slip --json -",
        "map --of exact --grid 4 --json -",
        "sweep drop --vary phase=0:0.5:2 --set plant=exact --workers 0 --json -",
        "analyse run.maglev",
        "replay run.maglev --check",
        "convert run.maglev run.csv",
        "card --table1",
        "twin --seconds 0.1",
        "--version",
        "--help",
        *(f"{command} --help" for command in COMMANDS),
    ]
    program = [sys.executable, "-c", ONE_BY_ONE]
    done = subprocess.run(program, input="\n".join(lines), capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert done.stderr.splitlines() == [f"141 {line}" for line in lines]


@pytest.mark.needs("linux")
@pytest.mark.parametrize("buffering", [-1, 1])
def test_a_full_disk_is_one_line(buffering: int) -> None:
    status, errors = outcome(open("/dev/full", "w", buffering=buffering), "card", "--table1")
    assert status == 1
    assert len(errors.splitlines()) == 1 and "No space left on device" in errors


def test_another_broken_pipe_is_an_error_like_any(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken() -> None:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("maglev_mj.plants.shapes.device_report", broken)
    assert main(["card", "--table1"]) == 1
    assert capsys.readouterr().err == "maglev-mj card: [Errno 32] Broken pipe\n"


@pytest.mark.parametrize("encoding", ["cp932", "ascii:surrogateescape"])
def test_a_sign_that_an_encoding_lacks_is_a_question_mark(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # as where a Japanese Windows writes to a file, or in a POSIX locale
    for words in (["card", "--table1"], ["µΩ"], *([command, "--help"] for command in COMMANDS)):
        monkeypatch.setattr(sys, "argv", ["maglev-mj", *words])
        name, _, errors = encoding.partition(":")
        for stream in ("stdout", "stderr"):
            monkeypatch.setattr(sys, stream, io.TextIOWrapper(io.BytesIO(), name, errors or "strict"))
        with suppress(SystemExit):
            main()
        sys.stdout.seek(0)
        assert "?m" in sys.stdout.read() or words != ["card", "--table1"]


@pytest.mark.parametrize("closed", ["stdin", "stdout", "stderr"])
def test_a_closed_stream_is_none(
    closed: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    grid = "--vary phase=0,0.5 --set plant=exact --set duration=0.1 --workers 0"
    runs = ["drop --plant exact --duration 0.1", f"sweep drop {grid}", "map --of exact --grid 2"]
    for line in [*runs, *(f"{command} --help" for command in COMMANDS)]:
        monkeypatch.setattr(sys, closed, None)
        try:
            status = main(line.split())
        except SystemExit as ending:
            status = int(ending.code or 0)
        getattr(sys, closed).close()
        shown = capsys.readouterr()
        assert (status, bool(shown.out), shown.err) == (0, closed != "stdout", ""), line
