"""Terminal use: help, suggestions, completion, tables and bars.

All within 80 columns.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from importlib.metadata import EntryPoint, EntryPoints
from inspect import getdoc
from pathlib import Path
from typing import Any

import pytest

import maglev_mj
from maglev_mj import cli
from maglev_mj.cli import program
from maglev_mj.cli.output import Progress
from maglev_mj.cli.program import COMMANDS, GROUPS
from maglev_mj.scenes import find_scene
from maglev_mj.scenes.names import BUILT_IN
from tests.golden.outputs import cases, kept

PROGRAM = [sys.executable, "-m", "maglev_mj"]
SCENES_OF = ("view", "render", "run", "stability", "design", "sweep", "fidelity")


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Run a command; return status, output and errors."""
    try:
        status = cli.main(words)
    except SystemExit as ended:
        status = int(ended.code or 0)
    out, err = capsys.readouterr()
    return status, out, err


@pytest.mark.parametrize("command", COMMANDS)
def test_a_help_says_each_default_once(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = said(capsys, command, "--help")[1]
    for option in re.split(r"\n  (?=-)", text):
        assert len(re.findall(r"\(default\b", " ".join(option.split("\n\n")[0].split()))) <= 1, option


@pytest.mark.parametrize("command", COMMANDS)
def test_the_lines_of_a_paragraph_in_a_help_are_full(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = said(capsys, command, "--help")[1].splitlines()
    for line, following in itertools.pairwise(lines[lines.index("") :]):  # after the usage
        if line[:1].strip() and following[:1].strip() and not line.endswith((":", ".")):
            assert len(line) + 1 + len(following.split()[0]) > 78, line


def test_every_kept_table_fits_80_columns() -> None:
    groups = {name.split("/")[0] for name in cases()}
    lines = [line for group in groups for one in kept(group).values() for line in one["stdout"]]
    assert len(lines) > 200
    assert max(map(len, lines)) <= 80


def test_the_command_alone_prints_help_of_all_commands_in_groups(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = said(capsys)
    assert (status, err) == (0, "") and out == said(capsys, "--help")[1]
    places = [out.index(f"\n{title}:\n") for title in GROUPS]
    assert list(GROUPS) == ["interactive", "compute", "device", "recordings"] and places == sorted(places)
    assert re.findall(r"^  (\w[a-z-]*)  +\S", out, re.MULTILINE) == [*COMMANDS]
    assert places[0] < 120 and out.count("\n") <= 45  # it fits a screen, and begins with the commands
    assert "diagnose is for any axis" in out[:120]
    assert max(map(len, out.splitlines())) <= 80 and not ({*dir(maglev_mj)} - {*COMMANDS}) & {*out.split()}
    assert "--rate [Hz]" in out and "help(maglev_mj)" in out


@pytest.mark.parametrize("more", [["--help"], ["--duration", "0.01", "--plant", "exact"], ["--stifness", "3"]])
@pytest.mark.parametrize("scene", BUILT_IN)
def test_the_name_of_a_scene_is_short_for_run(scene: str, more: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    short = said(capsys, scene, *more)
    assert short == said(capsys, "run", scene, *more)
    if more == ["--help"]:
        first = " ".join(str(getdoc(find_scene(scene))).split("\n\n")[0].split())
        assert short[0] == 0 and first in " ".join(short[1].split())


def test_there_are_20_commands_besides_the_scenes() -> None:
    choices: Any = program.program_parser()._actions[-1].choices
    assert [*choices] == [*COMMANDS, *BUILT_IN] and len(COMMANDS) == 20


def test_no_scene_has_the_name_of_a_command_and_the_help_lists_them_in_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert not {*COMMANDS} & {*BUILT_IN}
    assert f"\n  {' '.join(BUILT_IN)}\n" in said(capsys, "--help")[1]


def test_the_scene_of_another_package_is_short_for_run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    entries = [EntryPoint(name, "maglev_mj.scenes.free:Twist", "maglev_mj.scenes") for name in ("own", "view")]
    for module in ("names", "find"):
        monkeypatch.setattr(f"maglev_mj.scenes.{module}.installed_scenes", lambda: EntryPoints(entries))
    words = "--duration", "0.01", "--plant", "exact"
    short = said(capsys, "own", *words)
    assert short[0] == 0 and short == said(capsys, "run", "own", *words) == said(capsys, "twist", *words)
    assert cli.parse(["view"]).command == "view"


def test_the_package_runs_as_the_command_does() -> None:
    done = subprocess.run([*PROGRAM, "--version"], capture_output=True, text=True, check=True)
    assert re.fullmatch(r"maglev-mj \d+\.\d+\.\d+\n", done.stdout)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_fits_80_columns_and_ends_with_an_example(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    for scene in ("", *(BUILT_IN if command == "run" else ["drop"] if command in SCENES_OF else ())):
        status, out, err = said(capsys, command, *scene.split(), "--help")
        assert (status, err) == (0, "")
        lines = out.splitlines()
        assert max(map(len, lines)) <= 80
        assert lines[-2:] == ["Example:", f"  maglev-mj {command} {COMMANDS[command].example}"]
    assert out.index("\n  --") < out.index("\noptions:\n")  # the command's own come first
    (ungrouped,) = re.findall(r"(?ms)^options:\n(.*?)\n\n", out)
    assert re.findall(r"^  (-.*?)  ", ungrouped, re.MULTILINE) == ["-h, --help"]


def test_examples_are_understood() -> None:
    for name, one in COMMANDS.items():
        assert cli.parse([name, *shlex.split(one.example)]).command == name


ASK = """
import os, sys
from maglev_mj.cli import main
leave = os._exit
def tell(status):
    print("numpy" in sys.modules, flush=True)
    leave(status)
os._exit = tell  # as argcomplete ends a process
for place, line in enumerate(sys.stdin.read().splitlines()):
    if os.fork() == 0:
        asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_STDOUT_FILENAME": f"answer {place}"}
        os.environ.update(asked, _ARGCOMPLETE="1", _ARGCOMPLETE_IFS=",")
        main()
        leave(9)
    assert os.wait()[1] == 0, line
"""


OFFERED = {
    "maglev-mj ": [*COMMANDS, *BUILT_IN],
    "maglev-mj st": ["stability", "stick-slip"],
    "maglev-mj view ": [*BUILT_IN, "mine.py"],
    "maglev-mj run press --h": ["--help", "--hand-path", "--hand", "--hits", "--height"],
    "maglev-mj stick-slip --law l": ["lugre"],
    "maglev-mj drop --period ": [],
    "maglev-mj view --stiffness 4e3 --seconds ": [],
    "maglev-mj replay ru": ["run.maglev"],
    "maglev-mj bridge udp://127.0.0.1:1 --scene bo": ["box"],
    "maglev-mj bridge udp://127.0.0.1:1 --scene none.py --vi": ["--view"],
}


@pytest.mark.machine
def test_a_shell_is_offered_commands_options_scenes_and_values(tmp_path: Path) -> None:
    here = tmp_path / "here"
    here.mkdir()
    for name in ("mine.py", "run.maglev"):
        (here / name).touch()
    asked, lines = [sys.executable, "-c", ASK], [*OFFERED]
    done = subprocess.run(asked, input="\n".join(lines), text=True, cwd=here, capture_output=True, check=True)
    for index, line in enumerate(lines):
        answer = (here / f"answer {index}").read_text()
        assert [word.strip() for word in answer.split(",") if word] == OFFERED[line], line
    assert done.stdout.split()[:2] == ["False"] * 2  # commands are offered without loading numpy


@pytest.mark.machine
def test_a_shell_that_shows_descriptions_gets_those_of_commands_and_options(tmp_path: Path) -> None:
    lines = ["maglev-mj vi", "maglev-mj drop --stif"]
    environment = {**os.environ, "_ARGCOMPLETE_SHELL": "zsh", "_ARGCOMPLETE_SUPPRESS_SPACE": "1"}
    subprocess.run(
        [sys.executable, "-c", ASK], input="\n".join(lines), text=True, cwd=tmp_path, env=environment, check=True
    )
    answers = [(tmp_path / f"answer {index}").read_text() for index in range(len(lines))]
    assert answers == [f"view:{COMMANDS['view'].summary}", "--stiffness:wall stiffness [N/m] (default 6000)"]


BASH = """
eval "$(register-python-argcomplete maglev-mj)"
complete -p maglev-mj >/dev/null || exit 3
COMP_WORDS=(maglev-mj drop --stif); COMP_CWORD=2; COMP_LINE="maglev-mj drop --stif"; COMP_POINT=${#COMP_LINE}
COMP_TYPE=9; COMP_WORDBREAKS=$' \\t\\n'
_python_argcomplete maglev-mj --stif drop
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.machine
def test_bash_itself_completes(tmp_path: Path) -> None:
    program = tmp_path / "maglev-mj"
    program.write_text(f'#!/bin/sh\nexec {shlex.join(PROGRAM)} "$@"\n')
    program.chmod(0o755)
    path = f"{tmp_path}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", BASH],
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
    )
    assert (done.stdout.split(), done.returncode) == (["--stiffness"], 0), done.stderr


class Screen:
    """Stream that is a terminal, or not."""

    def __init__(self, terminal: bool) -> None:
        self.text, self.terminal = "", terminal

    def isatty(self) -> bool:
        return self.terminal

    def write(self, text: str) -> None:
        self.text += text

    def flush(self) -> None: ...


def until(screen: Screen, text: str) -> None:
    """Wait for a text on a screen."""
    end = time.perf_counter() + 60.0
    while text not in screen.text:
        assert time.perf_counter() < end, screen.text
        time.sleep(0.005)


def test_a_bar_shows_on_a_terminal_alone_and_goes_away(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    for terminal in (True, False):
        screen: Any = Screen(terminal)
        now = 0.0
        with Progress("map", screen, quiet=0.0, every=0.01) as progress:
            if terminal:
                until(screen, "] map: 0 s")  # how much there is to do is not known yet
            now = 10.0
            progress(1, 4)
            now = 13.0
            progress(2, 4)
            if terminal:
                until(screen, "[###############...............] map: 2 of 4, 6 s left")
            with progress.aside():
                assert not screen.text or screen.text.endswith("\r\x1b[K")
                before = screen.text
                time.sleep(0.05)
                assert screen.text == before  # nobody draws over what is printed
            if terminal:
                until(screen, before + "\r\x1b[K[####")
        assert screen.text.endswith("\r\x1b[K") if terminal else screen.text == ""
    screen = Screen(True)
    with Progress("map", screen) as progress:
        progress(1, 2)
    assert screen.text == ""  # of a short run


def test_a_run_has_its_bar_on_standard_error_and_its_result_on_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    screen: Any = Screen(True)
    monkeypatch.chdir(tmp_path)  # for the sweep's record
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setattr(Progress.__init__, "__kwdefaults__", {"quiet": 0.0, "every": 0.001})
    assert cli.main("sweep drop --vary phase=0:0.8:2 --set plant=exact --workers 0 --json -".split()) == 0
    assert "] sweep drop" in screen.text and screen.text.endswith("\r\x1b[K")
    assert len(json.loads(capsys.readouterr().out)["results"]) == 2


@pytest.mark.needs("pty")
def test_what_is_written_to_a_terminal_that_has_closed_is_discarded() -> None:
    master, slave = os.openpty()
    with open(slave, "w", encoding="utf-8", errors="replace") as opened:
        stream = program._on_terminal(opened)
        assert stream.isatty() and stream.encoding == "utf-8"
        print("before, 1 µs", file=stream, flush=True)
        assert os.read(master, 99) == "before, 1 µs\r\n".encode()
        os.close(master)
        for _ in range(3):
            print("landing", file=stream, flush=True)
        assert not stream.isatty()  # no bars from here on
    with open("/dev/full", "w", encoding="utf-8") as full, pytest.raises(OSError, match="No space left"):
        print("landing", file=program._on_terminal(full), flush=True)


@pytest.mark.machine
@pytest.mark.needs("pty", "linux")
@pytest.mark.parametrize("ignored", [False, True])
def test_a_terminal_that_closes_ends_no_job_under_nohup(ignored: bool, tmp_path: Path) -> None:
    import fcntl
    import termios

    master, slave = os.openpty()
    act = signal.SIG_IGN if ignored else signal.SIG_DFL
    words = [*PROGRAM, "drop", "--plant", "exact", "--record", "run.maglev", "--out", "figures"]
    job = subprocess.Popen(
        words,
        cwd=tmp_path,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        preexec_fn=lambda: (signal.signal(signal.SIGHUP, act), fcntl.ioctl(0, termios.TIOCSCTTY, 0)),
    )
    os.close(slave)
    os.close(master)  # the terminal's window
    assert job.wait(60.0) == (0 if ignored else -signal.SIGHUP)
    assert (tmp_path / "run.maglev").exists() is ignored
