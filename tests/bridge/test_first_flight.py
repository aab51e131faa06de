"""The command lines of the guides, as written, in real time: every flight takes off and lands."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from maglev_mj.versions import MODELS
from tests.processes import ADDRESS, COMMAND, run, started

DOCS = Path(__file__).parents[2] / "docs"
FLIGHTS, MISSES = 5, 10
"""Flights in a row, and flights that may end before: a machine that stalls for 50 ms ends one, rightly."""


def lines(page: str, command: str) -> list[list[str]]:
    """Return the command lines of a page that begin with a command of maglev-mj, without their comments."""
    found = re.findall(rf"^ +maglev-mj ({command} .*|{command})$", (DOCS / page).read_text(), re.MULTILINE)
    return [shlex.split(line, comments=True) for line in found]


def line(page: str, command: str, word: str = "") -> list[str]:
    """Return the first such line with a word."""
    return next(words for words in lines(page, command) if not word or word in words)


FIRST = line("howto/fly.md", "bridge")


def of_scene(name: str) -> list[str]:
    """Return the line of the first flight with another scene."""
    return [name if word == "joystick" else word for word in FIRST]


CASES = {
    "first flight": ([], FIRST),
    "table": ([], of_scene("table")),
    "stick-slip": ([], of_scene("stick-slip")),
    "drop": ([], of_scene("drop")),
    "joystick at 1 kHz": (["--rate", "1000"], FIRST),
    "walls on the device": ([], line("howto/wall_on_the_device.md", "bridge")),
    "own device": (["--device", "mine.toml"], line("howto/describe_your_device.md", "bridge")),
}


def fly(words: list[str], address: str, landed: str, folder: Path) -> None:
    """Fly a line for 1 s with another address until it has landed five times in a row."""
    words = [address if "://" in word else word for word in words]
    device = words[words.index("--device") :][:2] if "--device" in words else []
    count, others = 0, list[str]()
    while count < FLIGHTS and len(others) < MISSES:
        ended = run(*COMMAND, *words, "--seconds", "1", cwd=folder)
        if ended.status == 0 and re.search(landed, ended.output):
            count += 1
            continue
        count, others = 0, [*others, ended.output + ended.errors]
        if address.startswith("udp"):
            run(*COMMAND, "bridge", address, *device, "--reset", cwd=folder)
    assert count == FLIGHTS, "\n".join(others)


@pytest.mark.machine
@pytest.mark.parametrize("name", CASES)
def test_the_flights_of_the_guides_take_off_and_land(name: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_bytes((MODELS / "devices" / "stage.toml").read_bytes())
    twin, host = CASES[name]
    assert "--anyway" not in host
    with started("twin", "--listen", "udp://127.0.0.1:0", *twin, cwd=tmp_path) as device:
        landed = r"keep hands off[\s\S]*landed 0\.\d\d mm from its takeoff position, at rest"
        fly(host, device.wait_for(ADDRESS), landed, tmp_path)


@pytest.mark.machine
def test_the_flight_of_an_arm_lasts_to_its_end(tmp_path: Path) -> None:
    page = "howto/drive_an_inverse3.md"
    host = line(page, "bridge")
    assert "--anyway" not in host
    with started(*line(page, "twin"), "0", cwd=tmp_path) as arm:
        address = f"haply://{arm.wait_for(r'ws://([^/]+)/')}?rate=200"
        fly(host, address, r"1\.0 s, 200 samples; the force has faded to zero\n", tmp_path)
