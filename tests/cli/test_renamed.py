"""Command lines of earlier versions: each gives what its new line gives, and a note that names the new line."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.cli import main
from maglev_mj.cli.program import COMMANDS
from maglev_mj.cli.renamed import RENAMED, renewed
from maglev_mj.device import Device
from tests.bridge.test_black_box import recorded

DROPS = "height 0", "pulse 220", "pulse-width 0.002", "force-limit 60", "quantize 5e-6"
LINES = {
    "tour": "view --tour",
    "tour --web --out made --seconds=3": "view --tour --web --out made --seconds=3",
    "tour --port 5680": "view --tour --port 5680",
    "fault fault.maglev": "analyse fault.maglev --cycles",
    "fault --all --out figures fault.maglev": "analyse fault.maglev --cycles --all --out figures",
    "fault flight.maglev": "analyse flight.maglev --cycles",
    "fault drop-exact.maglev": "analyse drop-exact.maglev --cycles",
    "fault --help": "analyse --help",
    "export flight.maglev --to csv": "convert flight.maglev flight.csv",
    "export --to npz drop-exact.maglev --out made.npz": "convert drop-exact.maglev made.npz --to npz",
    "export drop-exact.maglev --out=table.txt --to=csv": "convert drop-exact.maglev table.txt --to csv",
    "export nosuch.maglev --to wav": "convert nosuch.maglev nosuch.wav",
    "export --help": "convert --help",
    "import rig.csv --columns time=t z=z --units time=s length=m --mass 1": (
        "convert rig.csv rig.maglev --columns time=t z=z --units time=s length=m --mass 1"
    ),
    "import --mass 1 --resample rig.csv --out made.csv --units time=s length=m": (
        "convert rig.csv made.csv --mass 1 --resample --units time=s length=m"
    ),
    "import --help": "convert --help",
    "stability": "map",
    "stability --grid 3 --hand arm --json -": "map --grid 3 --hand arm --json -",
    "stability --damping 80 --stiffness 3000:9000 --grid 3": "map --damping 80 --stiffness 3000:9000 --grid 3",
    "stability --plant none --grid 3": "map --grid 3",
    "stability --grid 3 --plant=exact --out figures": "map --of exact --grid 3 --out figures",
    **{f"stability --{name} --grid 2": f"map --of drops --{name} --grid 2" for name in DROPS},
    **{f"stability --plant exact --grid 2 --{name}": f"map --of drops --grid 2 --{name}" for name in DROPS},
    "info": "card --table1",
    "info --json -": "card --table1 --json -",
    "info --json out.json": "card --table1 --json out.json",
    "info --device ubc": "card ubc --table1",
    "info --json=- --device=own.toml": "card own.toml --table1 --json=-",
    "info --device stage --model nosuch.xml": "card stage --table1 --model nosuch.xml",
    "info --device ubc --header": "card ubc --header",
    "info --header --device arm": "card arm --header",
    "info --device nosuch.toml": "card nosuch.toml --table1",
}
"""Old lines and the new ones."""

KEPT = [
    *("view", "view --tour", "drop", "--help", "", "stability drop", "stability --damping 50 drop --plant exact"),
    *("stability --help", "stability -h", "stability --stiffness=6e3 --damping 80 --rate 1000"),
]
"""Lines that are no old ones."""


RECORDINGS = Path(__file__).parents[1] / "golden/recordings"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return the files that lines read."""
    folder = tmp_path_factory.mktemp("files")
    flight, fault = recorded(folder, hurt=True)
    assert fault is not None
    files = flight.rename(folder / "flight.maglev"), fault.rename(folder / "fault.maglev")
    own = folder / "own.toml"
    own.write_text(Device.load("stage").toml())
    table = folder / "rig.csv"
    table.write_text("\n".join(["t,z", *(f"{0.005 * tick},{1e-6 * tick * tick}" for tick in range(32))]))
    return [*files, own, table, RECORDINGS / "drop-exact.maglev"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder to run lines in, without window and page."""
    monkeypatch.setattr("maglev_mj.cli.peripherals.PageOptions.open", lambda self: id if self.web else None)
    monkeypatch.setattr("maglev_mj.cli.scenes._show", lambda source, *rest: print(type(source).__name__, rest[3]))
    monkeypatch.setattr("maglev_mj.views.window.window.require_display", lambda: None)
    return tmp_path


def outcome(
    line: str, files: list[Path], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[Any, ...]:
    """Run a line in a new folder with the files; return status, output, errors, and what is there then."""
    folder.mkdir()
    for path in files:
        shutil.copy(path, folder)
    monkeypatch.chdir(folder)
    try:
        status = main(shlex.split(line))
    except SystemExit as ended:
        status = int(ended.code or 0)
    out, errors = capsys.readouterr()
    return status, out, errors, {str(path): path.is_file() and path.stat().st_size for path in Path().rglob("*")}


@pytest.mark.parametrize(("old", "new"), LINES.items())
def test_an_old_line_gives_what_its_new_line_gives_and_a_note(
    old: str,
    new: str,
    files: list[Path],
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, errors, written = outcome(old, files, here / "old", monkeypatch, capsys)
    told, _, errors = errors.partition("\n")
    assert told == f"maglev-mj: {old.split()[0]} was renamed to: maglev-mj {new}"
    assert (status, out, errors, written) == outcome(new, files, here / "new", monkeypatch, capsys)
    assert new.split()[0] in COMMANDS and renewed(shlex.split(new)) is None


def test_every_row_of_the_table_is_the_first_that_fits_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not [line for line in KEPT if renewed(line.split()) is not None]
    for row in RENAMED:
        monkeypatch.setattr("maglev_mj.cli.renamed.RENAMED", [other for other in RENAMED if other != row])
        changed = [old for old, new in LINES.items() if renewed(shlex.split(old)) != shlex.split(new)]
        assert changed or [line for line in KEPT if renewed(line.split()) is not None], row


def test_the_content_of_a_file_decides_how_it_is_analysed(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def shown(line: str) -> tuple[Any, ...]:
        return outcome(line, files, tmp_path / str(len([*tmp_path.iterdir()])), monkeypatch, capsys)

    cause = shown("analyse fault.maglev")
    assert cause[0] == 0 and "COIL_NOT_FOLLOWING" in cause[1]
    assert cause == shown("analyse fault.maglev --cycles")
    assert len(shown("analyse fault.maglev --all")[1].splitlines()) > len(cause[1].splitlines())
    assert json.loads(shown("analyse fault.maglev --json -")[1])["faults"] == "COIL_NOT_FOLLOWING"
    status, _, errors, _ = shown("analyse fault.maglev --axis z")
    assert (status, errors) == (2, "maglev-mj analyse: axis applies to samples, not to device cycles (got z)\n")
    assert cause == shown("analyse flight.maglev --cycles")
    assert "COIL_NOT_FOLLOWING" not in shown("analyse flight.maglev --no-compare")[1].splitlines()[0]


def test_one_wall_is_judged_by_stability_as_by_diagnose(capsys: pytest.CaptureFixture[str]) -> None:
    assert main("stability --damping 80 --stiffness 6000".split()) == 0
    wall = capsys.readouterr()
    assert main("diagnose --damping 80 --stiffness 6000 --rate 200 --delay 0.0015 --mass 0.7".split()) == 0
    assert wall == capsys.readouterr() and wall.err == ""
