"""Versions of the code in every JSON, recording and record."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge.fault import LastCycles
from maglev_mj.bridge.wire import Fault
from maglev_mj.cli import main
from maglev_mj.recording import Recording
from maglev_mj.recording.journal import open_journal
from maglev_mj.scenes.drop import Drop
from maglev_mj.session.replay import write_run
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


TWICE = """
import json, sys
from maglev_mj import versions
print(json.dumps(versions.versions()))
with open(sys.argv[1], "a") as file:
    file.write(" ")
versions._versions.cache_clear()
print(json.dumps(versions.versions()))
"""


@pytest.mark.parametrize("name", ["drop.xml", "devices/stage.toml"])
def test_a_copy_has_the_same_sources_and_one_changed_byte_gives_others(tmp_path: Path, name: str) -> None:
    # As a wheel has them: the models inside the package.
    shutil.copytree(ROOT / "maglev_mj", tmp_path / "maglev_mj")
    shutil.copytree(ROOT / "model", tmp_path / "maglev_mj" / "model")

    drop = tmp_path / "maglev_mj" / "model" / name
    drop.write_bytes(drop.read_bytes().replace(b"\n", b"\r\n"))
    told = subprocess.run(
        [sys.executable, "-c", TWICE, str(drop)],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    same, other = map(json.loads, told.stdout.splitlines())
    assert same == versions() and other["sources"] != same["sources"]


def test_any_difference_is_named_with_both_values() -> None:
    ours = versions()
    assert differences(ours, dict(ours)) == ""
    for name in NAMES:
        assert differences({**ours, name: "theirs"}, ours) == f"{name} theirs (here {ours[name]})"
    assert differences({}, ours) == "no versions"
    assert differences({"numpy": "1"}, ours).count("unknown (here") == 4


COMMANDS = [
    ["drop", "--plant", "exact"],
    ["drop", "--delay", "0.005", "--duration", "3"],  # diverges
    ["map", "--grid", "2"],
    ["sweep", "drop", "--vary", "plant=exact", "--workers", "0"],
    ["card", "--table1"],
]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_json_names_its_code(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    where = "out.json" if COMMANDS.index(command) % 2 else "-"
    main([*command, "--json", where])
    said = capsys.readouterr().out if where == "-" else (tmp_path / where).read_text()
    assert json.loads(said)["versions"] == versions()


def test_every_recording_names_its_code(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "run.maglev"
    write_run(path, Drop(), plant="exact")
    assert Recording.load(path).segments[0].setup["versions"] == versions()
    other = tmp_path / "other.maglev"  # also once it is saved anew
    Recording.load(path).save(other)
    assert Recording.load(other).segments[0].setup["versions"] == versions()
    assert main(["analyse", str(other), "--no-compare", "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["versions"] == told["segments"][0]["versions"] == versions()


def test_a_file_of_last_cycles_names_its_code(tmp_path: Path) -> None:
    kept = LastCycles(tmp_path)
    path = kept.write(kept.mark(Fault.HOST, "a test", {}))
    assert path is not None and open_journal(path).header["versions"] == versions()


SWEEP = ["sweep", "drop", "--vary", "phase=0:0.5:2", "--set", "plant=exact", "--workers", "0"]
MAP = ["map", "--grid", "2", "--of", "exact"]


THEIRS: list[tuple[Any, str]] = [
    ({"numpy": "1.0"}, f"numpy 1.0 (here {np.__version__})"),
    ({"sources": "f" * 16}, f"sources {'f' * 16} (here"),
    (None, "no versions"),
    ("nonsense", "no versions"),
    ({"numpy": "\x1b[2J"}, "no versions"),
]


@pytest.mark.parametrize(("command", "cases"), [(SWEEP, THEIRS), (MAP, THEIRS[:1])], ids=["sweep", "map"])
def test_cells_of_other_code_are_not_continued(
    command: list[str], cases: list[tuple[Any, str]], tmp_path: Path, capsys: Any
) -> None:
    plan = tmp_path / "record" / "plan.json"
    arguments = [*command, "--record", str(plan.parent)]
    assert main(arguments) == 0
    found = json.loads(plan.read_text())
    assert found["versions"] == versions() and capsys.readouterr().err == ""
    for theirs, words in cases:
        other = {**versions(), **theirs} if isinstance(theirs, dict) else theirs
        plan.write_text(json.dumps(found | {"versions": other}))
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert len(said.splitlines()) == 1
        assert f"record must be of this code (got {str(plan.parent)!r}): {words}" in said
