"""Start time of commands, completion and imports, beside the libraries that they need.

    python scripts/benchmarks/start.py [--quick]

Times of whole processes, on the wall and of the processor, which a busy machine changes less; medians over rounds in
which each has its turn. Byte code is compiled beforehand, as an installer does. Options are completed from what the
first press of a key has kept.
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
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from typing import Any

import maglev_mj

FLOOR = "import numpy, mujoco"
PROGRAM = "-m", "maglev_mj"
COMMANDS: Mapping[str, Sequence[str]] = {
    FLOOR: ("-c", FLOOR),
    "--help": (*PROGRAM, "--help"),
    "drop": (*PROGRAM, "drop"),
}
LINES = {"complete a command": "maglev-mj st", "complete an option": "maglev-mj drop --stif"}


def _took(arguments: Sequence[str], environment: Mapping[str, str]) -> tuple[float, float]:
    """Return wall and processor time of a process [s]."""
    nowhere = environment["XDG_CACHE_HOME"]  # for -m takes a package from where it is
    start, before = time.perf_counter(), getrusage(RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], env=environment, cwd=nowhere, stdout=subprocess.DEVNULL, check=True)
    took, after = time.perf_counter() - start, getrusage(RUSAGE_CHILDREN)
    return took, sum(after[:2]) - sum(before[:2])


def measure(quick: bool) -> dict[str, Any]:
    """Return times [s] and ratios to their references."""
    with TemporaryDirectory() as folder:
        here = {**os.environ, "XDG_CACHE_HOME": folder}
        if not quick:
            here["PYTHONPYCACHEPREFIX"] = str(Path(folder) / "code")
        here["PYTHONPATH"] = str(Path(maglev_mj.__file__).parent.parent)
        here.pop("PYTHONDONTWRITEBYTECODE", None)
        turns = {name: (arguments, here) for name, arguments in COMMANDS.items()}
        if find_spec("argcomplete") is not None:
            asking = {**here, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(Path(folder) / "answer")}
            for name, line in LINES.items():
                turns[name] = (PROGRAM, {**asking, "COMP_LINE": line, "COMP_POINT": str(len(line))})
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in turns}
        for once in range(0 if quick else -1, 1 if quick else 5):
            for name, turn in turns.items():
                took = _took(*turn)
                if once >= 0:
                    times[name].append(took)
    found: dict[str, Any] = {}
    for index, kind in enumerate(("seconds", "processor")):
        found[kind] = {name: statistics.median(one[index] for one in kept) for name, kept in times.items()}
        found[f"ratios, {kind}"] = {"drop over numpy and mujoco": found[kind]["drop"] / found[kind][FLOOR]}
    return found


def main() -> None:
    """Print the times and ratios."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one round")
    found = measure(parser.parse_args().quick)
    print("                                 wall  processor")
    for name, seconds in found["seconds"].items():
        print(f"  {name:30s}{seconds * 1e3:5.0f}{found['processor'][name] * 1e3:7.0f} ms")
    for name, ratio in found["ratios, seconds"].items():
        print(f"  {name:30s}{ratio:5.2f}{found['ratios, processor'][name]:7.2f}")


if __name__ == "__main__":
    main()
