"""Versions of the code in every JSON, recording and record."""

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

from maglev_mj.bridge.fault import BlackBox
from maglev_mj.bridge.wire import Fault
from maglev_mj.cli import main
from maglev_mj.recording import Recording
from maglev_mj.scenes.drop import Drop
from maglev_mj.session.replay import write_run
from maglev_mj.studies.cells import Record
from maglev_mj.versions import differences, versions

ROOT = Path(__file__).resolve().parent.parent
NAMES = ["maglev_mj", "sources", "python", "mujoco", "numpy"]


def test_this_process_has_its_versions() -> None:
    found = versions()
    assert list(found) == NAMES
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["numpy"] == np.__version__
    found["sources"] = "others"
    assert versions()["sources"] != "others"


def test_a_copy_has_the_same_sources_and_one_changed_byte_gives_others(tmp_path: Path) -> None:
    # As a wheel has them: the models inside the package.
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

    assert told() == versions()
    drop = tmp_path / "maglev_mj" / "model" / "drop.xml"
    drop.write_bytes(drop.read_bytes().replace(b"\n", b"\r\n"))
    assert told()["sources"] == versions()["sources"]
    drop.write_bytes(drop.read_bytes() + b" ")
    assert told()["sources"] != versions()["sources"]


@pytest.mark.parametrize("name", NAMES)
def test_any_difference_is_named_with_both_values(name: str) -> None:
    ours = versions()
    assert differences(ours, dict(ours)) == ""
    assert differences({**ours, name: "theirs"}, ours) == f"{name} theirs (here {ours[name]})"
    assert differences({}, ours) == "no versions"
    assert differences({"numpy": "1"}, ours).count("unknown (here") == 4


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
