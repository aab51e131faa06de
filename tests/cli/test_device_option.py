"""Commands with a device: each works with every device of the package, or refuses it in one line."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from maglev_mj import cli
from maglev_mj.cli import program
from maglev_mj.cli.program import COMMANDS, in_full
from maglev_mj.device import devices
from maglev_mj.recording import Recording
from tests.cli.test_options import NEEDED
from tests.published import EIGHT

LINES = {
    "drop": "drop --plant exact --duration 0.05",
    "press": "press --plant exact --hits 1 --interval 0.1",
    "stick-slip": "stick-slip --plant exact --duration 0.05",
    "run": "run six-axes --plant exact --duration 0.05",
    "diagnose": "diagnose drop",
    "stability": "stability box",
    "map": "map --grid 3",
    "compare": "compare drop --plant exact --law pd --phases 1 --duration 0.05",
    "card": "card --table1",
    "convert": "convert a.csv a.maglev --columns time=t z=z fz=f --units time=s length=m force=N",
}
COILS = {"twin", "bridge", "commission", "conform"}
SLOW = {"design", "fidelity", "view", "render"}  # the same options, with a long computation or a screen


def test_every_command_of_a_device_takes_the_option() -> None:
    taking = set()
    for command in COMMANDS:
        with suppress(SystemExit):
            options: Any = vars(program.parse([command, *NEEDED.get(command, "").split(), "--device", "stage"]))
            taking.add(command)
            assert "stage" in map(str, options.values()), command
    assert taking == {in_full(line.split())[0] for line in LINES.values()} | COILS | SLOW


@pytest.mark.parametrize("device", [*devices(), "eight.toml"])
@pytest.mark.parametrize("line", LINES.values())
def test_a_command_works_with_each_device(
    line: str, device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("eight.toml").write_text(EIGHT.toml())
    rows = (f"{0.005 * tick},{1e-6 * tick * tick},0.1" for tick in range(32))
    Path("a.csv").write_text("\n".join(["t,z,f", *rows]))
    assert cli.main([*line.split(), "--device", device]) == 0, capsys.readouterr()
    if line.startswith("convert"):
        (segment,) = Recording.load("a.maglev").segments
        assert segment.metadata.inertia[0] == {"arm": 0.15, "ubc": 0.7}.get(device, 0.3)


@pytest.mark.parametrize("device", ["arm", "eight.toml"])
@pytest.mark.parametrize("command", [*sorted(COILS), "card --header"])
def test_a_command_for_coils_refuses_a_device_without_any_or_with_more_than_six(
    command: str, device: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("eight.toml").write_text(EIGHT.toml())
    assert cli.main([*command.split(), *NEEDED.get(command, "").split(), "--device", device]) == 2
    out, error = capsys.readouterr()
    why = "no coils, which flights and their twin need"
    if device != "arm":
        why = "8 coils, but a frame of the protocol carries six currents: simulate it without twin and bridge"
    text = f"maglev-mj {command.split()[0]}: device '{device.removesuffix('.toml')}' has {why}"
    assert not out and " ".join(error.split()) == text
