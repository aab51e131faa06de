"""How long commands, completion and imports take to start, beside the libraries that they need.

    python scripts/benchmarks/start.py [--quick]

Wall times of whole processes, medians over rounds in which each has its turn; byte code is compiled beforehand, as an
installer does. Options are completed from what the first press of a key has kept.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import maglev_mj

FLOOR, MUJOCO = "import numpy, mujoco", "import mujoco"
PROGRAM = "-m", "maglev_mj"
COMMANDS: Mapping[str, Sequence[str]] = {
    "python": ("-c", "pass"),
    FLOOR: ("-c", FLOOR),
    MUJOCO: ("-c", MUJOCO),
    "import maglev_mj": ("-c", "import maglev_mj"),
    "from maglev_mj import *": ("-c", "from maglev_mj import *"),
    "--help": (*PROGRAM, "--help"),
    "drop --help": (*PROGRAM, "drop", "--help"),
    "drop": (*PROGRAM, "drop"),
}
LINES = {"complete a command": "maglev-mj st", "complete an option": "maglev-mj drop --stif"}


def _took(arguments: Sequence[str], environment: Mapping[str, str]) -> float:
    start = time.perf_counter()
    nowhere = environment["XDG_CACHE_HOME"]  # for -m takes a package from where it is
    subprocess.run([sys.executable, *arguments], env=environment, cwd=nowhere, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def measure(quick: bool) -> dict[str, Any]:
    """Return times [s], and their ratios to what they are held against.

    Args:
        quick: One round in place of five.
    """
    with TemporaryDirectory() as folder:
        here = {**os.environ, "PYTHONPYCACHEPREFIX": str(Path(folder) / "code"), "XDG_CACHE_HOME": folder}
        here["PYTHONPATH"] = str(Path(maglev_mj.__file__).parent.parent)
        here.pop("PYTHONDONTWRITEBYTECODE", None)
        turns = {name: (arguments, here) for name, arguments in COMMANDS.items()}
        if find_spec("argcomplete") is not None:
            asking = {**here, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(Path(folder) / "answer")}
            for name, line in LINES.items():
                turns[name] = (PROGRAM, {**asking, "COMP_LINE": line, "COMP_POINT": str(len(line))})
        times: dict[str, list[float]] = {name: [] for name in turns}
        for once in range(2 if quick else 6):
            for name, turn in turns.items():
                took = _took(*turn)
                if once:
                    times[name].append(took)
    found = {name: statistics.median(kept) for name, kept in times.items()}
    return {
        "seconds": found,
        "drop over numpy and mujoco": found["drop"] / found[FLOOR],
        "maglev_mj over mujoco": found["import maglev_mj"] / found[MUJOCO],
        "all names over mujoco": found["from maglev_mj import *"] / found[MUJOCO],
    }


def main() -> None:
    """Print the times and ratios."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one round")
    found = measure(parser.parse_args().quick)
    for name, seconds in found.pop("seconds").items():
        print(f"  {name:28s}{seconds * 1e3:6.0f} ms")
    for name, ratio in found.items():
        print(f"  {name:28s}{ratio:6.2f}")


if __name__ == "__main__":
    main()
