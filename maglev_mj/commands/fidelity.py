"""`maglev-mj fidelity`: what each piece of the device changes in a scene, and the cheapest model that will do."""

from __future__ import annotations

import argparse
from typing import Any

from maglev_mj.errors import ParameterError
from maglev_mj.experiments.fidelity import measure_fidelity, measure_rungs
from maglev_mj.experiments.ladder import FIDELITY_SCENES
from maglev_mj.options import number_option
from maglev_mj.output import check_outputs, write_json
from maglev_mj.progress import Progress
from maglev_mj.tables import fidelity_table, ladder_table

__all__ = ["add_command"]


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    parser = commands.add_parser(
        "fidelity", help="what each piece of the device changes in a scene, and the cheapest model that will do"
    )
    parser.add_argument("scene", help=f"{', '.join(FIDELITY_SCENES)}, or all for one table of them")
    parser.add_argument(
        "--tolerance",
        type=number_option,
        metavar="X",
        help="greatest displacement of a coil that does not matter [m] (default: the scene's own)",
    )
    parser.add_argument("--json", metavar="FILE", help="write the figures as JSON; - for standard output")
    parser.set_defaults(run=_fidelity)


def _fidelity(options: argparse.Namespace) -> int:
    check_outputs(json=options.json)
    if options.scene == "all":
        return _all(options)
    progress = Progress("fidelity")
    try:
        result = measure_fidelity(options.scene, options.tolerance, progress=progress)
    finally:
        progress.close()
    if options.json is not None:
        write_json(options.json, result.as_json())
    if options.json != "-":
        print(fidelity_table(result))
    return 0


def _all(options: argparse.Namespace) -> int:
    if options.tolerance is not None:
        raise ParameterError(
            f"tolerance must be left out for all scenes, for each has its own, not {options.tolerance:g}"
        )
    progress, ladders = Progress("fidelity"), {}
    try:
        for place, (name, scene) in enumerate(FIDELITY_SCENES.items()):
            ladders[name] = measure_rungs(scene, repeats=3)
            progress(place + 1, len(FIDELITY_SCENES))
    finally:
        progress.close()
    if options.json is not None:
        write_json(options.json, {name: [row._asdict() for row in rows] for name, rows in ladders.items()})
    if options.json != "-":
        print(ladder_table(ladders))
    return 0
