"""Cost of a sweep's parent over the number of cells, and sweeps killed at random moments.

An empty cell has the figures of a drop and takes no time, so that all that is left is the parent's and the workers'
handing out. Each row is a process of its own.

    python scripts/benchmarks/cells.py --empty 1e5 1e6 --drops 1e4 --kills 20
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from maglev_mj import find_scene, local_workers
from maglev_mj.studies import sweep as sweeping
from maglev_mj.versions import hash_of, versions


def empty(cells: Any, text: str | None = None) -> list[dict[str, Any]]:
    """Return figures that take no time."""
    names = "penetration", "rebound", "peak_force", "settling_time", "final_z"
    return [{name: cell["stiffness"] / (cell["damping"] + place) for place, name in enumerate(names)} for cell in cells]


def run(kind: str, count: int, workers: int, record: Path) -> dict[str, Any]:
    """Return time and memory of a sweep's parent, and bytes of its record."""
    if kind == "empty":
        sweeping.run_scene_cells = empty
    rows = round(count**0.5)
    vary = {
        "stiffness": [1000.0 + 8000.0 * k / rows for k in range(rows)],
        "damping": [40.0 + 60.0 * k * rows / count for k in range(count // rows)],
    }
    start = time.perf_counter()
    found = sweeping.sweep(find_scene("drop"), vary, plant="exact", workers=local_workers(workers), record=record)
    str(found.table())
    own = resource.getrusage(resource.RUSAGE_SELF)
    files = record.iterdir() if record.is_dir() else [record]  # a file before there were folders
    return {
        "kind": kind,
        "cells": len(found.cells),
        "seconds": time.perf_counter() - start,
        "own seconds": own.ru_utime + own.ru_stime,
        "peak MB": own.ru_maxrss / 1e3,
        "bytes a cell": sum(path.stat().st_size for path in files) / len(found.cells),
        "resumed": found.resumed,
        "figures": hash_of("".join(found.figure(name).tobytes().hex() for name in found.names)),
    }


def start(*words: object) -> subprocess.Popen[str]:
    """Start a row in a process, and a group, of its own."""
    command = [sys.executable, __file__, "--row", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)


def row(*words: object) -> dict[str, Any]:
    """Return a finished row."""
    process = start(*words)
    out, _ = process.communicate()
    found: dict[str, Any] = json.loads(out)
    return found


def kills(number: int, count: int, workers: int, folder: Path) -> None:
    """Kill sweeps at random moments, and compare what goes on with what was never killed."""
    whole = row("drop", count, workers, folder / "whole")
    draw, same = random.Random(0), 0
    for turn in range(number):
        process = start("drop", count, workers, folder / f"kill-{turn}")
        time.sleep(draw.uniform(0.0, whole["seconds"] + 1.0))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        again = row("drop", count, workers, folder / f"kill-{turn}")
        once = row("drop", count, workers, folder / f"kill-{turn}")
        same += whole["figures"] == again["figures"] == once["figures"] and once["resumed"] == once["cells"]
        print(
            f"killed: {again['resumed']} of {again['cells']} cells were kept; equal so far: {same} of {turn + 1}",
            flush=True,
        )


def main() -> None:
    """Print a table, or its rows as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--empty", nargs="*", type=float, default=[], help="sweeps of so many empty cells")
    parser.add_argument("--drops", nargs="*", type=float, default=[], help="sweeps of so many drops")
    parser.add_argument("--kills", type=int, default=0, help="sweeps of 20 000 drops that are killed")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--row", nargs=4, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.row:
        kind, count, workers, record = given.row
        print(json.dumps(run(kind, int(count), int(workers), Path(record))))
        return
    with tempfile.TemporaryDirectory() as folder:
        for kind, counts in (("empty", given.empty), ("drop", given.drops)):
            for count in counts:
                print(json.dumps(row(kind, int(count), given.workers, Path(folder) / f"{kind}-{count:g}")), flush=True)
        if given.kills:
            kills(given.kills, 20_000, given.workers, Path(folder))
    print(json.dumps({"versions": versions()}))


if __name__ == "__main__":
    main()
