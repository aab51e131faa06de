"""Run the benchmarks: a revision and this checkout in turn; every section runs in fresh processes.

    python scripts/benchmarks/bench.py [--before REV] [--only SECTION ...] [--repeats N] [--quick] [--out DIR]
    python scripts/benchmarks/bench.py --tables figures/bench.json        the tables of docs/explanation/speed.md

A section is a module beside this one, or in `system`, with `measure(quick)`, which returns numbers by name, nested or
not. All figures of a run go to bench.json: of each number median, least and greatest, and the ratio after over before
pair by pair.
"""

from __future__ import annotations

import io
import json
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import growth
import realism
import speed_accuracy
import speed_tables
import system
from maglev_mj.cli.declare import Parser
from maglev_mj.cli.output import script_options
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import number
from maglev_mj.versions import versions

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
REPEATS = 5


@dataclass(frozen=True)
class Section:
    """One module of benchmarks.

    Attributes:
        title: What it measures.
        compared: Whether it is also run with the revision before.
        repeats: Processes of each; None for as many as asked for.
    """

    title: str
    compared: bool = True
    repeats: int | None = None


SECTIONS = {
    "loop": Section("the closed loop"),
    "options": Section("what each option costs"),
    "walls": Section("walls simulated at once"),
    "answers": Section(system.SECTIONS["answers"]),
    "start": Section(system.SECTIONS["start"]),
    "flat": Section("what must not grow with a run, a grid or the engine's profiler"),
    "recorder": Section(system.SECTIONS["recorder"]),
    "observer": Section("the observer of a flight in each sample", compared=False),
    "others": Section("what a user would take instead", compared=False),
    "realism": Section("what each piece of realism costs and changes", compared=False, repeats=1),
    "speed_accuracy": Section("speed against accuracy", compared=False, repeats=1),
    "growth": Section("growth with devices, rate and workers", compared=False, repeats=1),
}
"""Sections by module name, in the order of the run."""

DRAWN = {"speed_accuracy": speed_accuracy.draw, "realism": realism.draw, "growth": growth.draw}
"""Pictures of sections."""

_CHILD = """import importlib, json, sys
sys.path.insert(0, sys.argv[1])
import maglev_mj
if hasattr(maglev_mj.lazy, "stop_profiler"):  # as the command does; not before version 0.4
    maglev_mj.lazy.stop_profiler()
figures = importlib.import_module(sys.argv[2]).measure(sys.argv[3] == "quick")
print()
print(json.dumps({"package": maglev_mj.__file__, "figures": figures}))
"""


class SectionFailedError(Exception):
    """A section's process ended with an error."""


def run_section(name: str, package: Path, quick: bool) -> dict[str, Any]:
    """Return a section's figures from a fresh process.

    Raises:
        SectionFailedError: If it fails, or finds another package; it has the last line of the error.
    """
    # six by six matrices gain nothing from threads, and some peers lose much
    environment = os.environ | {"PYTHONPATH": str(package), "OPENBLAS_NUM_THREADS": "1"}
    module = f"system.{name}" if name in system.SECTIONS else name
    command = [sys.executable, "-c", _CHILD, str(HERE), module, "quick" if quick else "full"]
    done = subprocess.run(command, env=environment, cwd=package, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SectionFailedError(f"{name} failed: {(done.stderr.strip().splitlines() or ['no error told'])[-1]}")
    result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    if not Path(result["package"]).is_relative_to(package):
        raise SectionFailedError(f"{name} ran with {result['package']}, not the package in {package}")
    figures: dict[str, Any] = result["figures"]
    return figures


def flat(figures: dict[str, Any], head: str = "") -> dict[str, float]:
    """Return nested figures as one level, names joined by ": "."""
    result: dict[str, float] = {}
    for key, value in figures.items():
        name = f"{head}: {key}" if head else str(key)
        if isinstance(value, dict):
            result |= flat(value, name)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            result[name] = float(value)
    return result


def spread(values: Sequence[float]) -> dict[str, Any]:
    """Return median, least and greatest of several runs, and the runs themselves."""
    return {"median": statistics.median(values), "least": min(values), "greatest": max(values), "runs": list(values)}


def summary(runs: dict[str, list[dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Return spreads of both sides, and of after over before pair by pair.

    Args:
        runs: Figures of the runs of each side, "before" and "after".
    """
    sides = {side: [flat(figures) for figures in some] for side, some in runs.items()}
    names = dict.fromkeys(name for some in sides.values() for figures in some for name in figures)
    result: dict[str, dict[str, Any]] = {}
    for name in names:
        values = {side: [figures[name] for figures in some if name in figures] for side, some in sides.items()}
        result[name] = {side: spread(some) for side, some in values.items() if some}
        before, after = values.get("before", []), values.get("after", [])
        if before and len(before) == len(after) and min(map(abs, before)) > 0.0:
            result[name]["ratio"] = spread([new / old for new, old in zip(after, before, strict=True)])
    return result


def measured(name: str, packages: dict[str, Path], repeats: int, quick: bool) -> dict[str, Any]:
    """Return a section's figures, its sides in turn; one that fails is named and left out.

    Args:
        name: Of the section.
        packages: Folder of the package of each side.
        repeats: Runs of each side.
        quick: See `measure` of the sections.
    """
    start = time.perf_counter()
    runs: dict[str, list[dict[str, Any]]] = {side: [] for side in packages}
    failed: dict[str, str] = {}
    for turn in range(repeats):
        for side in list(packages) if turn % 2 else reversed(list(packages)):
            if side in failed:
                continue
            _tell(f"{name}: {side}, {turn + 1} of {repeats}")
            try:
                runs[side].append(run_section(name, packages[side], quick))
            except SectionFailedError as error:
                failed[side] = str(error)
    _tell("")
    whole = {side: some for side, some in runs.items() if side not in failed}
    details = whole["after"][-1] if whole.get("after") else {}
    return {
        "title": SECTIONS[name].title,
        "seconds": time.perf_counter() - start,
        "failed": failed,
        "figures": summary(whole),
        "details": details,
    }


def _tell(what: str) -> None:
    """Show progress on a terminal, on one changing line."""
    if sys.stderr.isatty():
        print(f"\r{what:<79}", end="\r", file=sys.stderr, flush=True)


@contextmanager
def package_of(revision: str | None) -> Iterator[dict[str, Path]]:
    """Unpack a revision; yield the folder of each side.

    "before" is left out if the revision is not in the repository.
    """
    with tempfile.TemporaryDirectory() as folder:
        sides: dict[str, Path] = {}
        if revision is not None:
            try:
                done = subprocess.run(["git", "archive", revision], cwd=ROOT, capture_output=True, check=True)
            except (OSError, subprocess.CalledProcessError):  # no git, no repository, no such revision
                print(f"revision {revision} is not here: nothing to compare with")
            else:
                with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
                    archive.extractall(folder, filter="data")
                sides["before"] = Path(folder).resolve()
        yield sides | {"after": ROOT}


def add_options(parser: Parser) -> None:
    """Add the options of the script."""
    there = list(SECTIONS)
    parser.add_argument("--before", metavar="REV", help="revision to compare with; none by default")
    parser.add_argument(
        "--only", nargs="+", choices=there, default=there, metavar="SECTION", help=f"some of {', '.join(there)}"
    )
    parser.add_argument("--repeats", type=int, default=REPEATS, metavar="N", help=f"runs of each ({REPEATS})")
    parser.add_argument("--tables", type=Path, metavar="FILE", help="print the tables of the documentation from a file")


def main() -> int:
    """Measure, print, write and draw; return 1 on failure."""
    options = script_options(__doc__, "little work, for a test", add_options)
    try:
        number("repeats", options.repeats, at_least=1)
        if options.tables is not None:
            print(speed_tables.markdown(json.loads(options.tables.read_text(encoding="utf-8"))))
            return 0
    except (ParameterError, OSError, ValueError, KeyError, TypeError) as error:
        print(
            f"bench.py: {error if options.tables is None else f'tables must be a bench.json: {error}'}", file=sys.stderr
        )
        return 2
    result: dict[str, Any] = {
        "before": options.before,
        "versions": versions(),
        "machine": speed_tables.machine(),
        "quick": options.quick,
        "repeats": options.repeats,
        "sections": {},
    }
    print(speed_tables.heading(result))
    with package_of(options.before) as packages:
        for name in options.only:
            section = SECTIONS[name]
            sides = packages if section.compared else {"after": packages["after"]}
            repeats = min(options.repeats, section.repeats or options.repeats)
            result["sections"][name] = measured(name, sides, repeats, options.quick)
            print(speed_tables.terminal(name, result["sections"][name]), flush=True)
    print(speed_tables.times(result["sections"]))
    path = options.pictures.path("bench", "json")
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {path}")
    for name, draw in DRAWN.items():
        if details := result["sections"].get(name, {}).get("details"):
            print(*(f"wrote {picture}" for picture in draw(options.pictures, details)), sep="\n")
    return int(any(section["failed"] for section in result["sections"].values()))


if __name__ == "__main__":
    sys.exit(main())
