"""`maglev-mj stability`: stable walls by theory and simulation."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.cells import add_workers, cells_kept, chosen_workers, tell_of_others
from maglev_mj.cli.options import add_json, add_parameters, chosen, given, range_of
from maglev_mj.cli.output import write_result, write_results
from maglev_mj.cli.pictures import add_pictures, chosen_pictures
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.cells import Record
from maglev_mj.studies.drop_map import PART, DropMapParameters, run_drop_map
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.terminal import wrapped
from maglev_mj.theory import stability

_RANGES = "damping", "stiffness"
_WALL = "parameters of a wall"
_DROP = "a map of drops instead, where one of these is given"
_FALLBACK = Path("stability-cells.jsonl")


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = "Where a wall is stable, by theory and by simulation (figure 2); or whether a scene is."
    add_scene(parser, instead=_add_map)
    parser.group(_WALL)
    add_json(parser)
    parser.set_defaults(run=_stability)


def _add_map(parser: Parser) -> None:
    """Add the options of a stability map."""
    group = parser.group(_WALL)
    for name in _RANGES:
        one = StabilityParameters.parameter(name)
        told = f"{one.help} [{one.unit}]: LOW HIGH, LOW:HIGH, or one value (default: what shows the stable region)"
        group.add_argument(f"--{name}", nargs="+", metavar="X", help=told)
    add_parameters(group, StabilityParameters)
    add_parameters(parser.group(_DROP), DropMapParameters)
    add_pictures(parser, "write the picture to this folder")
    add_workers(parser, "cells done are kept here and not done again")


def _stability(options: argparse.Namespace) -> int:
    return _map(options) if options.scene_class is None else _verdict(options)


def _verdict(options: argparse.Namespace) -> int:
    """Print the stability of a scene's closed loop."""
    scene: Scene = chosen(options, options.scene_class)
    found = stability(scene)
    data = {"scene": scene.name, "parameters": scene.as_json(), **found.as_json()}
    heading = "\n".join(wrapped(f"{scene.name}: {scene.describe()}", "", "  "))
    write_results(options, lambda: data, lambda: f"{heading}\n{found.table()}")
    return 0


def _map(options: argparse.Namespace) -> int:
    """Print a map of stable walls, or of settling drops."""
    ranges = {name: range_of(name, getattr(options, name)) for name in _RANGES}
    drops = bool(given(options, DropMapParameters) - given(options, StabilityParameters))
    parameters = chosen(options, DropMapParameters if drops else StabilityParameters, **ranges)
    if chosen_pictures(options) is not None:
        for name in ("damping", "stiffness"):
            if (limits := getattr(parameters, name)) is not None and limits[0] == limits[1]:
                raise ParameterError(f"{name} must be a range for a picture, not {limits[0]:g} alone")
    # a map of drops is simulated on every core where it has more than one part
    workers = chosen_workers(options, default=None if drops and parameters.grid**2 > PART else 0)
    run: Any = run_drop_map if drops else run_stability
    with cells_kept(options.record, _FALLBACK), Progress("stability") as progress:
        result = run(parameters, record=Record(options.record), workers=workers, progress=progress)
    tell_of_others("stability", result.other_versions)
    write_result(options, result, "stability_drops" if drops else "stability")
    return 0
