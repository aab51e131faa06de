"""Versions of the code in every result.

In every JSON, recording and record.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import versions as module
from maglev_mj.bridge.fault import BlackBox
from maglev_mj.bridge.wire import Fault
from maglev_mj.cli import main
from maglev_mj.recording import Recording
from maglev_mj.replay import write_run
from maglev_mj.scenes.drop import Drop
from maglev_mj.studies.cells import Record
from maglev_mj.versions import differences, versions

ROOT = Path(__file__).resolve().parent.parent
NAMES = ["maglev_mj", "revision", "changed", "sources", "python", "mujoco", "numpy"]


def git(folder: Path, *arguments: str) -> str:
    named = ["-c", "user.name=A", "-c", "user.email=a@b.c", "-c", "init.defaultBranch=main"]
    return subprocess.run(["git", *named, *arguments], cwd=folder, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a checkout of a project of this name.

    With one commit.
    """
    folder = tmp_path / "checkout"
    for name in ("maglev_mj", "model", "scripts", "docs"):
        (folder / name).mkdir(parents=True)
        (folder / name / "a.py").write_text("a = 1\n")
    (folder / "pyproject.toml").write_text('[project]\nname = "maglev-mj"\n')
    git(folder, "init")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "one")
    return folder


def test_a_checkout_tells_its_revision_and_whether_its_code_was_changed(checkout: Path) -> None:
    revision = git(checkout, "rev-parse", "HEAD").strip()
    assert module._revision(checkout) == (revision, False)
    (checkout / "docs" / "a.py").write_text("a = 2\n")
    (checkout / "drop-sweep.jsonl").write_text("a result\n")
    assert module._revision(checkout) == (revision, False)
    for change in ("maglev_mj/a.py", "maglev_mj/new.py", "model/a.py", "scripts/a.py"):
        (checkout / change).write_text("a = 2\n")
        assert module._revision(checkout) == (revision, True), change
        git(checkout, "stash", "--include-untracked")
    git(checkout, "worktree", "add", "../other")
    assert module._revision(checkout.parent / "other") == (revision, False)


def test_the_revision_of_another_repository_is_never_taken(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    revision, _ = module._revision(checkout)
    installed = checkout / ".venv" / "lib" / "site-packages"
    installed.mkdir(parents=True)
    assert module._revision(installed) == (None, None)  # a wheel, in this very project
    another = checkout.parent / "another"
    shutil.copytree(checkout, another)
    (another / "pyproject.toml").write_text('[project]\nname = "another"\n')
    assert module._revision(another) == (None, None)  # the package copied into a project
    (another / "pyproject.toml").unlink()
    assert module._revision(another) == (None, None)
    git(another, "commit", "--all", "-m", "two")
    monkeypatch.setenv("GIT_DIR", str(another / ".git"))  # as in a hook of it
    assert module._revision(checkout) == (revision, False)


def test_without_git_or_a_commit_the_revision_is_unknown(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.rmtree(checkout / ".git")
    git(checkout, "init")
    assert module._revision(checkout)[0] is None
    (checkout / ".git" / "HEAD").write_text("nonsense")
    assert module._revision(checkout) == (None, None)
    monkeypatch.setenv("PATH", "")
    assert module._revision(checkout) == (None, None)


def test_this_process_has_its_versions() -> None:
    found = versions()
    assert list(found) == NAMES
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["numpy"] == np.__version__
    if (ROOT / ".git").exists():
        assert found["revision"] == git(ROOT, "rev-parse", "HEAD").strip()
    found["revision"] = "another"
    assert versions()["revision"] != "another"


def test_a_copy_has_the_same_sources_and_one_changed_byte_gives_others(tmp_path: Path) -> None:
    # As a wheel has them: the models inside the package, no git.
    shutil.copytree(ROOT / "maglev_mj", tmp_path / "maglev_mj")
    shutil.copytree(ROOT / "model", tmp_path / "maglev_mj" / "model")

    def told() -> dict[str, Any]:
        done = subprocess.run(
            [sys.executable, "-c", "import json, maglev_mj.versions as v; print(json.dumps(v.versions()))"],
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    assert told() == {**versions(), "revision": None, "changed": None}
    drop = tmp_path / "maglev_mj" / "model" / "drop.xml"
    drop.write_bytes(drop.read_bytes().replace(b"\n", b"\r\n"))
    assert told()["sources"] == versions()["sources"]
    drop.write_bytes(drop.read_bytes() + b" ")
    assert told()["sources"] != versions()["sources"]


@pytest.mark.parametrize("name", [name for name in NAMES if name != "changed"])
def test_any_difference_is_named_with_both_values(name: str) -> None:
    ours = {**versions(), "revision": "a" * 40}
    assert differences(ours, dict(ours)) == ""
    assert differences({**ours, name: "theirs"}, ours) == f"{name} theirs (here {ours[name]})"
    assert differences({}, ours) == "no versions"
    assert differences({"numpy": "1"}, ours).count("unknown (here") == 4


def test_a_revision_that_one_side_does_not_know_is_left_to_the_sources() -> None:
    checkout = {**versions(), "revision": "a" * 40, "changed": True}
    wheel = {**checkout, "revision": None, "changed": None}
    assert differences(wheel, checkout) == differences(checkout, wheel) == ""


COMMANDS = [
    ["drop", "--plant", "exact"],
    ["drop", "--plant", "exact", "--phases", "2"],
    ["drop", "--delay", "0.005", "--duration", "3"],  # diverges
    ["press", "--plant", "exact"],
    ["stick-slip", "--plant", "exact"],
    ["stability", "--grid", "3"],
    ["sweep", "drop", "--vary", "plant=exact", "--workers", "0"],
    ["info"],
]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("where", ["-", "out.json"])
def test_every_json_names_its_code(
    command: list[str], where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    main([*command, "--json", where])
    said = capsys.readouterr().out if where == "-" else (tmp_path / where).read_text()
    assert json.loads(said)["versions"] == versions()


@pytest.mark.parametrize("suffix", [".npz", ".mcap"])
def test_every_recording_names_its_code(suffix: str, tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / f"run{suffix}"
    write_run(path, Drop(), plant="exact")
    assert Recording.load(path).stretches[0].setup["versions"] == versions()
    # also once it is another file
    other = tmp_path / "other.npz"
    assert main(["export", str(path), "--to", "npz", "--out", str(other)]) == 0
    assert Recording.load(other).stretches[0].setup["versions"] == versions()
    capsys.readouterr()
    assert main(["analyse", str(other), "--no-compare", "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["versions"] == told["stretches"][0]["versions"] == versions()


def test_a_black_box_names_its_code(tmp_path: Path) -> None:
    path = BlackBox(tmp_path).write(Fault.HOST, "a test", {})
    assert path is not None and json.loads(path.read_text())["versions"] == versions()


def test_every_script_that_writes_json_names_its_code() -> None:
    writers = [
        path
        for path in (ROOT / "scripts").rglob("*.py")
        if re.search(r'\.json|, "json"\)', text := path.read_text()) and "dumps" in text
    ]
    assert len(writers) >= 5
    assert [path.name for path in writers if '"versions": versions()' not in path.read_text()] == []


def test_each_line_of_a_record_names_its_code(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    Record(path).add([({"x": 1}, 2), ({"x": 2}, 4)])
    assert [json.loads(line)["versions"] for line in path.read_text().splitlines()] == [versions()] * 2


SWEEP = ["sweep", "drop", "--vary", "phase=0:0.9:6", "--set", "plant=exact", "--workers", "0"]


@pytest.mark.parametrize(
    ("theirs", "words"),
    [
        ({"numpy": "1.0"}, f"4 cells have numpy 1.0 (here {np.__version__})"),
        ({"sources": "f" * 16}, f"4 cells have sources {'f' * 16} (here"),
        (None, "4 cells have no versions"),  # of a record from before
        ("nonsense", "4 cells have no versions"),
        ({"numpy": "\x1b[2J"}, "4 cells have no versions"),
        ({"numpy": [float("nan")]}, "4 cells have no versions"),
    ],
)
def test_cells_of_other_code_are_kept_and_named(theirs: Any, words: str, tmp_path: Path, capsys: Any) -> None:
    record, out = tmp_path / "record.jsonl", tmp_path / "out.json"
    arguments = [*SWEEP, "--record", str(record), "--json", str(out)]
    assert main(arguments) == 0
    assert capsys.readouterr().err == "" and json.loads(out.read_text())["other_versions"] == []
    lines = [json.loads(line) for line in record.read_text().splitlines()]
    made = {**versions(), **theirs} if isinstance(theirs, dict) else theirs
    changed = [{**line, "versions": made} if place < 4 else line for place, line in enumerate(lines)]
    text = "".join(json.dumps(line) + "\n" for line in changed[:5])
    record.write_text(text)
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert len(said.err.splitlines()) == 1 and words in said.err
    assert "6 cells\n" in said.out and "\n  5 of them already in" in said.out
    assert record.read_text().startswith(text) and len(record.read_text().splitlines()) == 6
    known = {} if "no versions" in words else made
    assert json.loads(out.read_text())["other_versions"] == [{"cells": 4, "versions": known}]


def test_a_map_names_other_code_too(tmp_path: Path, capsys: Any) -> None:
    record = tmp_path / "cells.jsonl"
    arguments = ["stability", "--grid", "3", "--plant", "exact", "--record", str(record), "--json", "-"]
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out)["other_versions"] == []
    record.write_text(record.read_text().replace(str(versions()["sources"]), "f" * 16))
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert "9 cells have sources ffffffffffffffff" in said.err
    assert json.loads(said.out)["other_versions"][0]["cells"] == 9
