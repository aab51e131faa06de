"""Files of users: every writer onto every kind of existing path, every reader of every kind of foreign file."""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from matplotlib.figure import Figure

import maglev_mj
from maglev_mj import HostLimits, MaglevError, Recording, export, find_scene, record_run
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.fault import load_fault
from maglev_mj.cli import main
from maglev_mj.cli.output import write_json
from maglev_mj.device import Device
from maglev_mj.pictures import FORMATS, save
from maglev_mj.plants.model import load_model
from maglev_mj.scenes.drop import Drop
from maglev_mj.session.replay import write_run
from maglev_mj.versions import MODELS
from tests.all_of import FORMATS as EXPORTS

RUN = partial(record_run, Drop(duration=0.05), plant="exact")
WRITERS: dict[str, Callable[[Path], Any]] = {
    "x.maglev": lambda path: RUN().save(path),
    "live.maglev": lambda path: write_run(path, Drop(duration=0.05), plant="exact"),
    **{f"x.{kind}": lambda path, kind=kind: export(RUN(), kind, path) for kind in EXPORTS},  # type: ignore[misc]
    **{f"chart.{kind}": partial(save, Figure()) for kind in FORMATS},
    "x.toml": Calibration.nominal().save,
    "result.json": lambda path: write_json(str(path), {}),
}
MAKERS: dict[str, Callable[[Path], Any]] = {
    "new": lambda path: None,
    "regular": lambda path: path.touch(0o640),
    "link": lambda path: path.symlink_to("target" * bool(path.with_name("target").write_text("old"))),
    "dangling link": lambda path: path.symlink_to("target"),
    "FIFO": os.mkfifo,
    "device": lambda path: os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 3)),
    "folder": Path.mkdir,
}


@pytest.mark.needs("linux")
@pytest.mark.parametrize("name", WRITERS)
def test_a_written_path_stays_what_it_is(name: str, tmp_path: Path) -> None:
    for kind, make in MAKERS.items():
        (path := tmp_path / kind / name).parent.mkdir()
        try:
            make(path)
        except PermissionError:  # a device needs rights
            continue
        before, files = path.lstat().st_mode if kind != "new" else 0, {path, *path.parent.iterdir()}
        refused = kind == "folder" or (name == "live.maglev" and kind in ("FIFO", "device"))
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK) if kind == "FIFO" else None
        with pytest.raises((MaglevError, OSError)) if refused else nullcontext():
            WRITERS[name](path)
        if not (refused or kind == "device"):
            assert path.read_bytes() if reader is None else os.read(reader, 1), kind
        assert path.lstat().st_mode == before or not before, kind
        files |= {path.with_name("target")} if kind == "dangling link" else set()
        assert {*path.parent.iterdir()} <= files | {path.with_name(f"{name}.json")}, kind


@pytest.mark.needs("linux")
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_reported_with_the_file(name: str, tmp_path: Path) -> None:
    (tmp_path / name).symlink_to("/dev/full")
    with pytest.raises((MaglevError, OSError), match=name):
        WRITERS[name](tmp_path / name)


FAILURES: dict[str, Callable[..., object]] = {
    "access": lambda *_: False,
    "replace": lambda *_: os.readlink("/"),
    "chmod": Mock(side_effect=KeyboardInterrupt),
}


@pytest.mark.parametrize("fails", FAILURES)
@pytest.mark.parametrize("name", [name for name in WRITERS if name.startswith(("x", "chart"))])
def test_a_failed_or_interrupted_write_keeps_the_old_file(
    name: str, fails: str, tmp_path: Path, monkeypatch: Any
) -> None:
    (tmp_path / name).write_bytes(b"old")
    monkeypatch.setattr(os, fails, FAILURES[fails])
    with pytest.raises((MaglevError, OSError, KeyboardInterrupt), match=r"Permission denied|Invalid argument|^$"):
        WRITERS[name](tmp_path / name)
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert kept.keys() <= {name, f"{name}.json"} and kept[name] == b"old"  # a table's context is a file of its own


def test_files_are_renamed_in_one_place() -> None:
    rename = re.compile(r"\.(rename|replace)\([\w.]+\)|os\.(rename|replace)\(")
    package = Path(maglev_mj.__file__).parent
    renaming = {path.name for path in package.rglob("*.py") if rename.search(path.read_text(encoding="utf-8"))}
    assert renaming == {"files.py", "journal.py"}


READERS: dict[str, tuple[Callable[[str], Any], bytes]] = {
    "x.toml": (Device.load, Device.load("ubc").toml().encode()),
    "profile.json": (HostLimits.load, b'{"max_current": 5.0, "envelope": 0.003}'),
    "x.xml": (load_model, (MODELS / "maglev.xml").read_bytes()),
    "x.maglev": (Recording.load, b""),
    "fault.maglev": (load_fault, b""),
    "x.py": (find_scene, b"from maglev_mj.scenes.drop import Drop\nclass Mine(Drop):\n    pass\n"),
    "x.key": (lambda path: main(["estop", "udp://127.0.0.1:9", "--key", path]), b"00" * 16),
}


@pytest.mark.parametrize("name", READERS)
def test_a_foreign_file_is_refused_in_one_line_that_names_it(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (read, valid), path = READERS[name], tmp_path / name
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"
    mcap = b"\x89MCAP0\r\n\x01" + (8).to_bytes(8, "little") + (4).to_bytes(4, "little") + b"ros2" + bytes(4)
    for content in (b"", valid[: len(valid) * 2 // 3], b"[" * 100_000, b"[1, 2]", mcap, pointer, None):
        path.mkdir() if content is None else path.write_bytes(content)
        try:
            said = capsys.readouterr().err if read(str(path)) == 2 else ""
        except MaglevError as refused:
            said = str(refused)
        assert name in said and "\n" not in said[:-1] and len(said) < 500, content
        assert content != pointer or name in ("x.py", "x.key") or said.endswith("a Git LFS pointer: run git lfs pull")
        assert content != mcap or path.suffix != ".maglev" or said.endswith("of another program (MCAP profile ros2)")
        path.rmdir() if content is None else path.unlink()
    os.mkfifo(path)
    assert name != "x.key" or read(str(path)) == 2


@pytest.mark.parametrize("name", ["x.toml", "profile.json", "x.xml", "x.py"])
def test_a_byte_order_mark_is_skipped(name: str, tmp_path: Path) -> None:
    (read, valid), path = READERS[name], tmp_path / name
    path.write_bytes(b"\xef\xbb\xbf" + valid.replace(b"\n", b"\r\n"))
    read(str(path))


@pytest.mark.parametrize("name", ["profile.json"])
def test_each_entry_of_json_is_checked(name: str, tmp_path: Path) -> None:
    (read, valid), path = READERS[name], tmp_path / name
    for key in [*json.loads(valid), "other"]:
        for wrong in (f'1, "{key}": 1', "NaN", "1e400", "{}", "[[]]"):
            path.write_text(json.dumps(json.loads(valid) | {key: "?"}).replace('"?"', wrong))
            with pytest.raises(MaglevError, match=rf"^[^\n]*{name}'[^\n]*{key}[^\n]*$"):
                read(str(path))
