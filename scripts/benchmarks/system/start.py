"""Start of commands, completion and imports, beside the libraries that they need.

Times of whole processes, on the wall and of the processor, which a busy machine changes less; medians over rounds in
which each has its turn. Byte code is compiled and completions are kept beforehand.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory

import maglev_mj
from system import Table
from timing import Run, columns, in_turns

FLOOR = "import numpy, mujoco"
PROGRAM = "-m", "maglev_mj"
COMMANDS = {FLOOR: ("-c", FLOOR), "--help": (*PROGRAM, "--help"), "drop": (*PROGRAM, "drop")}
LINES = {"complete a command": "maglev-mj st", "complete an option": "maglev-mj drop --stif"}


def _started(arguments: tuple[str, ...], environment: dict[str, str]) -> tuple[Run, float]:
    """Return wall and processor time of a process [s]."""
    elsewhere = environment["XDG_CACHE_HOME"]  # -m would import a package from the working directory
    start, before = time.perf_counter(), getrusage(RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], env=environment, cwd=elsewhere, stdout=subprocess.DEVNULL, check=True)
    wall, after = time.perf_counter() - start, getrusage(RUSAGE_CHILDREN)
    return Run(wall, None, 1), sum(after[:2]) - sum(before[:2])


def measure(quick: bool) -> dict[str, Table]:
    """Return wall and processor time of each start, medians of rounds, and ratios to the libraries'."""
    with TemporaryDirectory() as folder:
        here = {**os.environ, "XDG_CACHE_HOME": folder, "PYTHONPATH": str(Path(maglev_mj.__file__).parent.parent)}
        if not quick:
            here["PYTHONPYCACHEPREFIX"] = str(Path(folder) / "code")
        here.pop("PYTHONDONTWRITEBYTECODE", None)
        work = {name: partial(_started, arguments, here) for name, arguments in COMMANDS.items()}
        if find_spec("argcomplete") is not None:
            asking = {**here, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(Path(folder) / "answer")}
            for name, line in LINES.items():
                work[name] = partial(_started, PROGRAM, {**asking, "COMP_LINE": line, "COMP_POINT": str(len(line))})
        if not quick:
            in_turns(work, 1)
        starts = in_turns(work, 1 if quick else 5)
    table = columns({name: [run for run, _ in some] for name, some in starts.items()}, "start")
    table["processor seconds"] = {name: statistics.median(used for _, used in some) for name, some in starts.items()}
    for head in ("seconds", "processor seconds"):
        table[f"{head}, over the libraries"] = {name: value / table[head][FLOOR] for name, value in table[head].items()}
    return {"start": table}
