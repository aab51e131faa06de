"""`maglev-mj sweep`: a scene over a grid of parameters.

On this machine or on a cluster.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.cells import add_workers, cells_kept, chosen_workers, tell_of_others
from maglev_mj.cli.options import add_json, described
from maglev_mj.cli.output import write_result
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene
from maglev_mj.cli.writable import check_outputs
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import parsed_number
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.sweep import MOST_CELLS, sweep, value_of
from maglev_mj.terminal import wrapped


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    add_scene(parser, more=_tell_parameters, options=False)
    grid = parser.group("grid")
    grid.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME=VALUES",
        help="its values: LOW:HIGH:COUNT evenly spread, A,B,C, or A;B;C where values have commas; repeat for a grid",
    )
    grid.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter that is not its default"
    )
    add_json(parser, "all cells and figures")
    add_workers(parser, "results land here as they come, and what is here is not done again (SCENE-sweep.jsonl)")
    parser.set_defaults(run=_sweep)


def _tell_parameters(parser: Parser, cls: type[Scene]) -> None:
    """List a scene's parameters in the help."""
    told = {"plant": f"{', '.join(cls.plants)} (default {cls.plants[0]})"}
    if cls.takes_phase:
        told["phase"] = "of the samples, in [0, 1) (default 0)"
    told |= {one.name: described(one, getattr(cls(), one.name)) for one in cls.parameters()}
    lines = [line for name, text in told.items() for line in wrapped(text, f"  {name:<15}", " " * 17)]
    parser.epilog = "\n".join([f"parameters of {cls.name}:", *lines])


def _sweep(options: argparse.Namespace) -> int:
    cls: type[Scene] = options.scene_class
    fixed = {name: [value_of(cls, name, text)] for name, text in _assignments(options.set).items()}
    varied = {name: _values(cls, name, text) for name, text in _assignments(options.vary).items()}
    if not varied:
        raise ParameterError(f"a sweep needs --vary NAME=VALUES; for one run: maglev-mj run {options.scene}")
    if both := sorted(set(fixed) & set(varied)):
        raise ParameterError(f"{both[0]} must be either set or varied, not both")
    options.record = path = options.record or Path(f"{cls.name}-sweep.jsonl")
    check_outputs(options)
    workers = chosen_workers(options, default=None)
    with cells_kept(path, path), Progress(f"sweep {cls.name}") as progress:
        result = sweep(cls, fixed | varied, workers=workers, record=path, progress=progress)
    result = replace(result, varied=varied)  # a set parameter is no dimension of the grid
    tell_of_others("sweep", result.other_versions)
    write_result(options, result)
    return 0


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


def _values(cls: type[Scene], name: str, text: str) -> list[Any]:
    """Return the values of a swept parameter."""
    parts = text.split(":")
    if len(parts) == 1:
        return [value_of(cls, name, part) for part in text.split(";" if ";" in text else ",")]
    try:
        low, high, count = parsed_number(name, parts[0]), parsed_number(name, parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = 0
    if len(parts) != 3 or not 1 <= count <= MOST_CELLS:
        raise ParameterError(f"{name} must vary as LOW:HIGH:COUNT, A,B,C or A;B;C, not {text!r}")
    value_of(cls, name, parts[0])  # is there such a parameter, and is it a number?
    return [float(value) for value in np.linspace(low, high, count)]
