"""Bad words of scenes, studies and recordings on the command line: one line each, status 2."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.processes import run_here

REFUSED: dict[str, str] = {
    "render pub --out a.png": "scene must be one of joystick",
    "render box --out a.bmp": "out must end in .png, .gif or .mp4, not 'a.bmp'",
    "render box --out nowhere/a.png": "out must be a file in a folder that is there",
    "render box --out a.png --size 1x1": "size must be WxH.* of 160 to 4000 pixels",
    "render box --out a.png --stiffness -1": "stiffness must be",
    "view pub": "scene must be one of joystick",
    "view box --seconds 0": "seconds must be .* above 0",
    "view box --hand-stiffness -5": "hand stiffness must be",
    "drop --record nowhere/a.npz": "record must be a file in a folder that is there",
    "fidelity moon": "scene must be one of joystick, drop, press, ",
    "fidelity drop --tolerance 0": "tolerance must be a finite number above 0, not 0",
    "fidelity drop --boundary-tolerance 0": "boundary must be a finite number above 0, not 0",
    "fidelity all --tolerance 1e-3": "unrecognized arguments: --tolerance 1e-3",
    "fidelity stick-slip --height 1e-3": "unrecognized arguments: --height 1e-3",
    "fidelity drop --json no/such/folder.json": "json",
    "design --mass a:b": "mass must be LOW HIGH, LOW:HIGH, or one value, not 'a:b'",
    "design --hand fist": "hand must be one of none, arm, stylus, fingertip",
    "design --held": "hands must be one or more different ones, not none at all",
    "design --modulus 0.4": r"modulus must be above 0\.4 here",
    "design --law observer --pulse": "pulse must be left out for the observer",
    "design --out x": "mass or delay must be a range for a picture",
    "stability --grid 3 --pulse -1": r"pulse must be a finite number at least 0 and at most 1e\+06, not -1",
    "stability --grid 3 --force-limit 0": r"force_limit must be a finite number above 0 and at most 1e\+06, not 0",
    "stability --grid 3 --quantize 2": "quantize must be a finite number at least 0 and at most 1, not 2",
    "stability --grid 3 --height -0.001": r"height must be a finite number at least 0 and at most 1, not -0\.001",
    "stability --grid 3 --height 0 --plant mujoco": "plant must be one of exact, not 'mujoco'",
    "stability --grid 3 --pulse 220 --damping 50 --out .": "damping must be a range for a picture, not 50 alone",
}
"""Command lines, and what is said of each, as a pattern."""


@pytest.mark.parametrize("line", REFUSED)
def test_bad_input_is_one_line_and_status_2(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    status, said = run_here(*line.split(" "))
    assert status == 2 and said.count("\n") == 1 and re.search(REFUSED[line], said), said
    assert not list(tmp_path.iterdir())
