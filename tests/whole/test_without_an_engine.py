"""Laws, theory, exact plants, studies, twins where no engine can be imported, as in browsers."""

import re
import sys
from pathlib import Path

import pytest

from maglev_mj import Calibration
from tests.processes import run
from tests.sweeps import sweep

BLOCKED = """
import sys
browser = ("fcntl", "grp", "pwd", "resource", "syslog", "termios")  # has none of these
for name in ("mujoco", "glfw", "multiprocessing", "_multiprocessing", *browser):
    sys.modules[name] = None  # importing it fails
"""
COMMAND = BLOCKED + "from maglev_mj.cli import main\nsys.exit(main(sys.argv[1:]))"
PYTHON = {
    "law": "find_scene('drop')().controller()",
    "recording": "record_run(find_scene('drop')(duration=0.1), plant='exact')",
    "margins": "assert 0.002 < min(delay_margins(find_scene('joystick')().controller(), ['arm']).values()) < 0.004",
    "sweep": "sweep(find_scene('drop'), {'height': [0.001, 0.002]}, plant='exact')",
}
FLIGHT = """
import signal, socket, threading
threading.Thread.start = socket.socket.__init__ = signal.signal = None  # calling it fails

from maglev_mj import Calibration, RemotePlant, Twin, TwinParameters, find_scene
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.line import preflight
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import State

known = Calibration.load("device.json")
twin = Twin(TwinParameters(calibration=known, plant="exact"), hand_force=hand)
with RemotePlant(VirtualLink(twin), calibration=known) as plant:
    found = preflight(plant, find_scene(scene)().replace(period=plant.period, delay=plant.delay))
    assert not found.problem, found
    report = Flight(plant, found.scene, bears=found.bears).run(1.0)
    assert report.landing.at_rest and not report.landing.reason and report.ticks == 200, report
assert twin.firmware.state == State.INACTIVE and not twin.firmware.faults and twin.pose[2] == -0.0045, twin.pose
"""
IMPORTS = """
from maglev_mj import find_scene, record_run, sweep
from maglev_mj.theory.verdict import delay_margins
"""


@pytest.mark.parametrize(
    "words",
    [
        "drop --plant exact",
        "press --plant exact --phases 2",
        "stick-slip --plant exact --json -",
        "stability drop",
        "stability --hand arm",
        "design --quantize 0",
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


@pytest.mark.machine
@pytest.mark.parametrize(("scene", "force"), sweep(["joystick", "drop"], [-3.0, 0.0], every=3))
def test_a_twin_is_flown_without_an_engine(scene: str, force: float, tmp_path: Path) -> None:
    Calibration.nominal().save(tmp_path / "device.json")
    hand = f"scene, hand = {scene!r}, lambda tick, time, state: [0, 0, {force} * (2.2 < time < 2.7), 0, 0, 0]\n"
    done = run(sys.executable, "-c", BLOCKED + hand + FLIGHT, cwd=tmp_path)
    assert done.status == 0, done


@pytest.mark.machine
def test_the_command_of_a_twin_needs_no_engine(tmp_path: Path) -> None:
    Calibration.nominal().save(tmp_path / "device.json")
    words = "twin --plant exact --calibration device.json --listen udp://127.0.0.1:0 --seconds 0.2"
    done = run(sys.executable, "-c", COMMAND, *words.split(), cwd=tmp_path)
    assert done.status == 0 and "inactive, faults: none" in done.output, done


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("drop", "mujoco, which cannot be imported here; scenes do without it by `--plant exact`.*"),
        ("twin --plant exact", "mujoco, which cannot be imported here; .*devices by `--calibration FILE`"),
        ("sweep drop --vary height=1e-3:2e-3:2", "multiprocessing, .*; sweeps do without it by `--workers 0`"),
        ("view --web", "multiprocessing, which cannot .*"),
    ],
)
def test_what_is_lacking_is_one_line(words: str, said: str, tmp_path: Path) -> None:
    done = run(sys.executable, "-c", COMMAND, *words.split(), cwd=tmp_path)
    assert done.status == 1 and re.fullmatch(f"maglev-mj: this needs {said}\n", done.errors), done


def test_what_a_file_of_one_s_own_lacks_is_told_as_any_error(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("import nothing_like_it\n")
    done = run(sys.executable, "-c", COMMAND, "stability", "own.py", cwd=tmp_path)
    assert done.status == 2 and "nothing_like_it" in done.errors and "this needs" not in done.errors
