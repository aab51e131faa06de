"""Cost of a sweep's parent over the number of cells, and sweeps killed at random moments.

An empty cell has the figures of a drop and takes no time, so that all that is left is the parent's and the workers'
handing out. Each row is a process of its own.
"""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from maglev_mj import find_scene, local_workers
from maglev_mj.studies import sweep as sweeping
from maglev_mj.versions import hash_of
from system import Table, beside, child
from timing import Run, columns

KILLED = 20_000
BESIDE = "parent, s of processor", "peak MB", "bytes a cell"


def no_work(cells: Any, text: str | None = None) -> list[dict[str, Any]]:
    """Return figures that take no time."""
    names = "penetration", "rebound", "peak_force", "settling_time", "final_z"
    return [{name: cell["stiffness"] / (cell["damping"] + place) for place, name in enumerate(names)} for cell in cells]


def run(kind: str, count: int, workers: int, record: Path) -> dict[str, Any]:
    """Return time and memory of a sweep's parent, and bytes of its record."""
    if kind == "empty":
        sweeping.run_scene_cells = no_work
    rows = round(count**0.5)
    vary = {
        "stiffness": [1000.0 + 8000.0 * k / rows for k in range(rows)],
        "damping": [40.0 + 60.0 * k * rows / count for k in range(count // rows)],
    }
    began = time.perf_counter()
    swept = sweeping.sweep(find_scene("drop"), vary, plant="exact", workers=local_workers(workers), record=record)
    str(swept.table())
    own = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "seconds": time.perf_counter() - began,
        "cells": len(swept.cells),
        "parent, s of processor": own.ru_utime + own.ru_stime,
        "peak MB": own.ru_maxrss / 1e3,
        "bytes a cell": sum(path.stat().st_size for path in record.iterdir()) / len(swept.cells),
        "resumed": swept.resumed,
        "figures": hash_of("".join(swept.figure(name).tobytes().hex() for name in swept.names)),
    }


def row(*words: object) -> dict[str, Any]:
    """Return `run` of a process of its own."""
    report: dict[str, Any] = json.loads(child("cells", *words).communicate()[0])
    return report


def killed(number: int, count: int, workers: int, folder: Path) -> Table:
    """Kill sweeps at random moments, resume them, and compare their figures with those of a whole one."""
    draw, whole = random.Random(0), row("drop", count, workers, folder / "whole")
    runs, rows = {}, {}
    for turn in range(number):
        words = "drop", count, workers, folder / f"kill-{turn}"
        process = child("cells", *words)
        time.sleep(draw.uniform(0.0, whole["seconds"] + 1.0))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        again, once = row(*words), row(*words)
        same = whole["figures"] == again["figures"] == once["figures"] and once["resumed"] == once["cells"]
        runs[f"kill {turn + 1}"] = Run(again["seconds"], None, again["cells"])
        rows[f"kill {turn + 1}"] = {"kept": again["resumed"], "equal": same}
    return columns(runs, "cell") | beside(rows)


def measure(
    quick: bool, empty: tuple[float, ...] = (1e4,), drops: Sequence[float] = (), kills: int = 0, workers: int = 2
) -> dict[str, Table]:
    """Return the cost of sweeps of `empty` cells and of `drops`, and what killed sweeps of 20 000 drops kept."""
    with tempfile.TemporaryDirectory() as name:
        folder, sizes = Path(name), [("empty", round(count)) for count in empty]
        sizes += [("drop", round(count)) for count in drops]
        rows = {f"{count} {kind}": row(kind, count, workers, folder / f"{kind}-{count}") for kind, count in sizes}
        runs = {name: Run(one["seconds"], None, one["cells"]) for name, one in rows.items()}
        more = {name: {head: one[head] for head in BESIDE} for name, one in rows.items()}
        tables = {"sweeps": columns(runs, "cell") | beside(more)}
        return tables | ({"kills": killed(kills, 200 if quick else KILLED, workers, folder)} if kills else {})


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))))
