"""Laws, theory, exact plants, studies, twins where no engine can be imported, as in browsers."""

import json
import re
import sys
from pathlib import Path

import pytest

from tests.processes import run
from tests.sweeps import sweep

BLOCKED = """
import sys
browser = ("fcntl", "grp", "pwd", "resource", "syslog", "termios")  # has none of these
for name in ("mujoco", "glfw", "multiprocessing", "_multiprocessing", *browser):
    sys.modules[name] = None  # importing it fails
"""
COMMAND = BLOCKED + "from maglev_mj.cli import main\nsys.exit(main(sys.argv[1:]))"
MANY = (
    BLOCKED
    + """
import io, json, shlex
from contextlib import redirect_stderr, redirect_stdout
from maglev_mj import find_scene, record_run, sweep
from maglev_mj.cli import main
from maglev_mj.theory.verdict import judge

answers = []
for line in sys.argv[1:]:
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as errors:
        try:
            status = main(shlex.split(line)[1:]) if line.startswith("maglev-mj ") else exec(line) or 0
        except SystemExit as ended:
            status = ended.code
    answers.append([line, status, errors.getvalue()])
print(json.dumps(answers))
"""
)
DONE = [
    "find_scene('drop')().controller()",
    "record_run(find_scene('drop')(duration=0.1), plant='exact')",
    "assert 0.002 < judge(find_scene('joystick')().controller(), delay=0.0, hand='arm').critical_delay < 0.004",
    "sweep(find_scene('drop'), {'height': [0.001, 0.002]}, plant='exact')",
    "maglev-mj drop --plant exact",
    "maglev-mj stick-slip --plant exact --json -",
    "maglev-mj stability drop",
    "maglev-mj design --quantize 0",
    "maglev-mj sweep drop --vary height=1e-3:4e-3:2 --vary plant=exact --workers 0 --record cells",
]
LACKING = {
    "maglev-mj drop": "mujoco, which cannot be imported; without it, use `--plant exact`.*",
    "maglev-mj sweep drop --vary height=1e-3:2e-3:2": "multiprocessing, .*`--workers 0`.*",
    "maglev-mj view --web": "multiprocessing, which cannot .*",
}
OWN = "maglev-mj stability own.py"
FLIGHT = """
import signal, socket, threading
threading.Thread.start = socket.socket.__init__ = signal.signal = None  # calling it fails

from maglev_mj import Calibration, RemotePlant, Twin, TwinParameters, find_scene
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.preflight import preflight
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import State

known = Calibration.nominal()
twin = Twin(TwinParameters(calibration=known, plant="exact"), hand_force=hand)
with RemotePlant(VirtualLink(twin), calibration=known) as plant:
    found = preflight(plant, find_scene(scene)().replace(period=plant.period, delay=plant.delay))
    assert not found.problem, found
    report = Flight(plant, found.scene, critical_delay=found.critical_delay).run(1.0)
    assert report.landing.at_rest and not report.landing.reason and report.ticks == 200, report
assert twin.firmware.state == State.INACTIVE and not twin.firmware.faults and twin.pose[2] == -0.0045, twin.pose
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """Return status and errors of each line, all in one process without an engine."""
    folder = tmp_path_factory.mktemp("browser")
    (folder / "own.py").write_text("import nothing_like_it\n")
    done = run(sys.executable, "-c", MANY, *DONE, *LACKING, OWN, cwd=folder)
    assert done.status == 0, done
    return {line: (status, errors) for line, status, errors in json.loads(done.output)}


def test_commands_and_python_need_no_engine(answers: dict[str, tuple[int, str]]) -> None:
    assert {line: answers[line] for line in DONE if answers[line][0] != 0} == {}


def test_what_is_lacking_is_one_line(answers: dict[str, tuple[int, str]]) -> None:
    for line, said in LACKING.items():
        status, errors = answers[line]
        assert status == 1 and re.fullmatch(f"maglev-mj: requires {said}\n", errors), (line, errors)


def test_what_a_file_of_one_s_own_lacks_is_told_as_any_error(answers: dict[str, tuple[int, str]]) -> None:
    status, errors = answers[OWN]
    assert status == 2 and "nothing_like_it" in errors and "this needs" not in errors


@pytest.mark.machine
@pytest.mark.parametrize(("scene", "force"), sweep(["joystick", "drop"], [-3.0, 0.0], every=3))
def test_a_twin_is_flown_without_an_engine(scene: str, force: float, tmp_path: Path) -> None:
    hand = f"scene, hand = {scene!r}, lambda tick, time, state: [0, 0, {force} * (2.2 < time < 2.7), 0, 0, 0]\n"
    done = run(sys.executable, "-c", BLOCKED + hand + FLIGHT, cwd=tmp_path)
    assert done.status == 0, done


@pytest.mark.machine
def test_the_command_of_a_twin_needs_no_engine(tmp_path: Path) -> None:
    words = "twin --plant exact --listen udp://127.0.0.1:0 --seconds 0.2"
    done = run(sys.executable, "-c", COMMAND, *words.split(), cwd=tmp_path)
    assert done.status == 0 and "final state: inactive, no faults" in done.output, done
