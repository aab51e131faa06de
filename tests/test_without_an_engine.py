"""Laws, theory, exact plants and studies where no engine can be imported, as in a browser."""

import sys
from pathlib import Path

import pytest

from tests.processes import run

BLOCKED = """
import sys
for name in ("mujoco", "glfw", "multiprocessing", "_multiprocessing"):
    sys.modules[name] = None  # importing it fails
"""
COMMAND = BLOCKED + "from maglev_mj.cli import main\nsys.exit(main(sys.argv[1:]))"
PYTHON = {
    "law": "find_scene('drop')().controller()",
    "recording": "record_run(find_scene('drop')(duration=0.1), plant='exact')",
    "margins": "assert 0.002 < min(delay_margins(find_scene('joystick')().controller(), ['arm']).values()) < 0.004",
    "sweep": "sweep(find_scene('drop'), {'height': [0.001, 0.002]}, plant='exact')",
}
IMPORTS = """
from maglev_mj import find_scene, record_run, sweep
from maglev_mj.theory.verdict import delay_margins
"""


@pytest.mark.parametrize(
    "words",
    [
        "drop --plant exact",
        "press --plant exact --phases 3",
        "stick-slip --plant exact --json -",
        "stability drop",
        "stability --hand arm",
        "design",
        "sweep drop --vary height=1e-3:4e-3:2 --vary plant=exact --workers 0 --record cells",
    ],
)
def test_a_command_needs_no_engine(words: str, tmp_path: Path) -> None:
    done = run(sys.executable, "-c", COMMAND, *words.split(), cwd=tmp_path)
    assert done.status == 0, done


@pytest.mark.parametrize("source", PYTHON.values(), ids=PYTHON)
def test_python_needs_no_engine(source: str, tmp_path: Path) -> None:
    done = run(sys.executable, "-c", BLOCKED + IMPORTS + source, cwd=tmp_path)
    assert done.status == 0, done


def test_what_needs_the_engine_fails_by_its_name(tmp_path: Path) -> None:
    assert "mujoco" in run(sys.executable, "-c", COMMAND, "drop", cwd=tmp_path).errors
