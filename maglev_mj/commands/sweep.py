"""`maglev-mj sweep`: any scene over a grid of its parameters, on this machine or on a cluster."""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.experiments.scenes import SCENES, cell_of, run_scene_cells
from maglev_mj.options import add_workers, chosen_workers
from maglev_mj.output import keep_landed, write_json
from maglev_mj.progress import Progress
from maglev_mj.study import Cell, Record, StudyInterrupted, run_cells
from maglev_mj.tables import sweep_table

__all__ = ["add_command"]

_MOST_CELLS = 1_000_000


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    parser = commands.add_parser("sweep", help="any scene over a grid of its parameters, on many workers")
    parser.add_argument("scene", help="; ".join(f"{name}: {scene.help}" for name, scene in SCENES.items()))
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME=VALUES",
        help="a parameter and its values: LOW:HIGH:COUNT evenly spread, or A,B,C; repeat for a grid",
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter that is not its default"
    )
    parser.add_argument("--json", metavar="FILE", help="write all cells and figures as JSON; - for standard output")
    add_workers(parser, "results land here as they come, and what is here is not done again (SCENE-sweep.jsonl)")
    parser.epilog = (
        "Parameters are those of the scene's own command with _ for -; for wall: plant, stiffness, damping, period, "
        "delay, mass, hand."
    )
    parser.set_defaults(run=_sweep)


def _sweep(options: argparse.Namespace) -> int:
    fixed = dict(_assignment(word) for word in options.set)
    varied = {name: _values(name, text) for name, text in map(_assignment, options.vary)}
    if both := sorted(set(fixed) & set(varied)):
        raise ParameterError(f"{both[0]} must be either set or varied, not both")
    cells = _cells(options.scene, {name: _value(text) for name, text in fixed.items()}, varied)
    path = options.record or Path(f"{options.scene}-sweep.jsonl")
    record = Record(path)
    known = sum(cell in record for cell in cells)
    workers = chosen_workers(options, default=None)
    progress = Progress(f"sweep {options.scene}")
    # enough jobs for every worker to get several, few enough that handing them out costs nothing
    together = max(min((len(cells) - known) // (8 * workers.window), 50), 1)
    try:
        results = run_cells(
            run_scene_cells, cells, record=record, workers=workers, together=together, progress=progress
        )
    except StudyInterrupted as stopped:
        progress.close()
        keep_landed("sweep", stopped, path, path)
        raise
    progress.close()
    if options.json is not None:
        rows = [{"cell": cell, "result": result} for cell, result in zip(cells, results, strict=True)]
        write_json(options.json, {"scene": options.scene, "varied": varied, "cells": rows})
    if options.json != "-":
        print(sweep_table(options.scene, varied, results, known, str(path)))
    return 0


def _cells(scene: str, fixed: dict[str, Any], varied: dict[str, list[Any]]) -> list[Cell]:
    count = int(np.prod([len(values) for values in varied.values()], dtype=float))
    if count > _MOST_CELLS:
        raise ParameterError(f"a sweep must have at most {_MOST_CELLS} cells, not {count}")
    return [
        cell_of(scene, {**fixed, **dict(zip(varied, values, strict=True))})
        for values in itertools.product(*varied.values())
    ]


def _assignment(word: str) -> tuple[str, str]:
    name, equals, text = word.partition("=")
    if not (name and equals and text):
        raise ParameterError(f"a parameter must be given as NAME=VALUE, not {word!r}")
    return name.replace("-", "_"), text


def _values(name: str, text: str) -> list[Any]:
    """Return the values of a parameter that varies."""
    parts = text.split(":")
    if len(parts) == 1:
        return [_value(part) for part in text.split(",")]
    try:
        low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = 0
    if len(parts) != 3 or count < 1:
        raise ParameterError(f"{name} must vary as LOW:HIGH:COUNT or A,B,C, not {text!r}")
    return [float(value) for value in np.linspace(low, high, count)]


def _value(text: str) -> Any:
    """Return a number, a truth value, or the word itself."""
    try:
        return float(text)
    except ValueError:
        return {"true": True, "false": False}.get(text.lower(), text)
