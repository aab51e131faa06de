"""MuJoCo's profiler: stopped by programs, left alone by the package; results equal with and without."""

from __future__ import annotations

import subprocess
import sys

import pytest

STEP = """
import mujoco
from maglev_mj import Command, MuJoCoPlant
from maglev_mj.plants import stop_profiler
def timed():
    plant = MuJoCoPlant()
    for _ in range(20):
        plant.read()
        plant.write(Command([0.1, 0.2, 9.0, 0.01, 0.02, 0.03]))
    print(plant.read().position)
    print("timed", sum(timer.duration for timer in plant._data.timer) > 0.0)
calls = []
def clock():
    calls.append(0)
    return float(len(calls))
"""
OWN = "mujoco.set_mjcb_time(clock)\n"
CASES = {
    "the package leaves it": ("timed()\n", [True]),
    "stopped before a plant": ("stop_profiler()\ntimed()\n", [False]),
    "stopped after a plant": ("timed()\nstop_profiler()\ntimed()\n", [True, False]),
    "an own timer set before is used": (OWN + "stop_profiler()\ntimed()\nassert calls\n", [True]),
    "an own timer set after is used": ("stop_profiler()\n" + OWN + "timed()\nassert calls\n", [True]),
    "the default can be brought back": (
        "stop_profiler()\ntimed()\nmujoco.set_mjcb_time(None)\ntimed()\n",
        [False, True],
    ),
    "no symbol, no effect": (
        "import ctypes\ndef none(name): raise OSError(name)\nctypes.CDLL = none\nstop_profiler()\ntimed()\n",
        [True],
    ),
}


@pytest.mark.machine
def test_a_program_stops_it_and_the_package_does_not() -> None:
    """One pose in all cases, to the last bit."""
    poses = set()
    for case, (words, expected) in CASES.items():
        done = subprocess.run([sys.executable, "-c", STEP + words], capture_output=True, text=True, check=True)
        lines = done.stdout.splitlines()
        assert [line == "timed True" for line in lines if line.startswith("timed")] == expected, case
        poses |= {line for line in lines if not line.startswith("timed")}
    assert len(poses) == 1


COMMAND = """
import atexit, sys
sys.argv = ["maglev-mj", *sys.argv[1:]]
def told():
    import mujoco
    from maglev_mj import Command, MuJoCoPlant
    assert "maglev_mj.plants.mujoco" in sys.modules  # the command has loaded the engine itself
    plant = MuJoCoPlant()
    plant.read(); plant.write(Command([0.0] * 6)); plant.read()
    print("timed", sum(timer.duration for timer in plant._data.timer) > 0.0)
from maglev_mj.__main__ import main
main()
told()
"""


@pytest.mark.machine
def test_a_command_stops_it() -> None:
    words = [sys.executable, "-c", COMMAND, "drop", "--plant", "mujoco"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "timed False", done.stdout


def _timed() -> bool:
    from maglev_mj import Command, MuJoCoPlant

    plant = MuJoCoPlant()
    plant.read()
    plant.write(Command([0.0] * 6))
    plant.read()
    return bool(sum(timer.duration for timer in plant._data.timer) > 0.0)


@pytest.mark.machine
def test_a_worker_stops_it() -> None:
    from maglev_mj.studies.cells import local_workers

    with local_workers(1).make() as executor:
        assert not executor.submit(_timed).result()
