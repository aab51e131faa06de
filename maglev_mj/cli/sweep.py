"""`maglev-mj sweep`: any scene over a grid of its parameters, on this machine or on a cluster."""

from __future__ import annotations

import argparse
import itertools
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.cli.options import add_workers, chosen_workers
from maglev_mj.cli.output import cells_kept, check_outputs, tell_of_others, write_json
from maglev_mj.cli.progress import Progress
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import parsed_number
from maglev_mj.studies.cells import Cell, Record, run_cells
from maglev_mj.studies.swept import SCENES, cell_of, run_scene_cells, value_of
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
        help="its values: LOW:HIGH:COUNT evenly spread, A,B,C, or A;B;C where values have commas; repeat for a grid",
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
    scene = options.scene
    fixed = {name: value_of(scene, name, text) for name, text in _assignments(options.set).items()}
    varied = {name: _values(scene, name, text) for name, text in _assignments(options.vary).items()}
    if both := sorted(set(fixed) & set(varied)):
        raise ParameterError(f"{both[0]} must be either set or varied, not both")
    cells = _cells(scene, fixed, varied)
    path = options.record or Path(f"{scene}-sweep.jsonl")
    check_outputs(json=options.json, record=path)
    record = Record(path)
    known = sum(cell in record for cell in cells)
    others = record.others(cells)
    workers = chosen_workers(options, default=None)
    tell_of_others("sweep", others)
    progress = Progress(f"sweep {scene}")
    # enough jobs for every worker to get several, few enough that handing them out costs nothing
    together = max(min((len(cells) - known) // (8 * workers.window), 50), 1)
    with cells_kept(path, path), closing(progress):
        results = run_cells(
            run_scene_cells, cells, record=record, workers=workers, together=together, progress=progress
        )
    if options.json is not None:
        rows = [{"cell": cell, "result": result} for cell, result in zip(cells, results, strict=True)]
        write_json(options.json, {"scene": scene, "varied": varied, "cells": rows, "other_versions": others})
    if options.json != "-":
        print(sweep_table(scene, varied, results, known, str(path)))
    return 0


def _cells(scene: str, fixed: dict[str, Any], varied: dict[str, list[Any]]) -> list[Cell]:
    count = int(np.prod([len(values) for values in varied.values()], dtype=float))
    if count > _MOST_CELLS:
        raise ParameterError(f"a sweep must have at most {_MOST_CELLS} cells, not {count}")
    return [
        cell_of(scene, {**fixed, **dict(zip(varied, values, strict=True))})
        for values in itertools.product(*varied.values())
    ]


def _assignments(words: list[str]) -> dict[str, str]:
    """Return parameters and the text of their values."""
    result: dict[str, str] = {}
    for word in words:
        name, equals, text = word.partition("=")
        name = name.replace("-", "_")
        if not (name and equals and text):
            raise ParameterError(f"a parameter must be given as NAME=VALUE, not {word!r}")
        if name in result:
            raise ParameterError(f"{name} must be given once, not as {result[name]} and {text}")
        result[name] = text
    return result


def _values(scene: str, name: str, text: str) -> list[Any]:
    """Return the values of a parameter that varies."""
    parts = text.split(":")
    if len(parts) == 1:
        return [value_of(scene, name, part) for part in text.split(";" if ";" in text else ",")]
    try:
        low, high, count = parsed_number(name, parts[0]), parsed_number(name, parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = 0
    if len(parts) != 3 or not 1 <= count <= _MOST_CELLS:
        raise ParameterError(f"{name} must vary as LOW:HIGH:COUNT, A,B,C or A;B;C, not {text!r}")
    value_of(scene, name, parts[0])  # is there such a parameter, and is it a number?
    return [float(value) for value in np.linspace(low, high, count)]
