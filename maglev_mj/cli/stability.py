"""`maglev-mj stability`: where a wall is stable, by theory and by simulation."""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path
from typing import Any

from maglev_mj import plots
from maglev_mj.cli.options import add_options, add_workers, chosen_workers, count, range_of
from maglev_mj.cli.output import cells_kept, check_outputs, tell_of_others, write_json
from maglev_mj.cli.progress import Progress
from maglev_mj.errors import ParameterError
from maglev_mj.hand import HANDS
from maglev_mj.scenes.choices import PLANTS
from maglev_mj.studies.cells import Record
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.tables import stability_table

__all__ = ["add_command"]

_FALLBACK = Path("stability-cells.jsonl")


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    parser = commands.add_parser("stability", help="where a wall is stable, by theory and by simulation (figure 2)")
    for name, unit in (("damping", "N s/m"), ("stiffness", "N/m")):
        parser.add_argument(
            f"--{name}",
            nargs="+",
            metavar="X",
            help=f"wall {name} [{unit}]: LOW HIGH, LOW:HIGH, or one value (default: what shows the stable region)",
        )
    made = StabilityParameters()
    parser.add_argument("--grid", type=count, default=made.grid, metavar="N", help=f"points an axis ({made.grid})")
    helps = {
        "period": "sample period [s]",
        "delay": "from a sample to its command taking effect [s]",
        "mass": "moving mass [kg]",
    }
    hands = (*HANDS, "or MASS,DAMPING,STIFFNESS[,GRIP_DAMPING,GRIP_STIFFNESS]")
    add_options(parser, {"plant": ("none", *PLANTS), "hand": hands}, helps, StabilityParameters)
    parser.add_argument("--json", metavar="FILE", help="write the map as JSON; - for standard output")
    parser.add_argument("--out", metavar="DIR", type=Path, help="write the picture to this folder")
    add_workers(parser, "cells done are kept here and not done again")
    parser.set_defaults(run=_stability)


def _stability(options: argparse.Namespace) -> int:
    parameters = StabilityParameters(
        damping=range_of("damping", options.damping),
        stiffness=range_of("stiffness", options.stiffness),
        **{name: getattr(options, name) for name in ("grid", "period", "delay", "mass", "hand", "plant")},
    )
    if options.out is not None:
        plots.require()
        for name in ("damping", "stiffness"):
            if (limits := getattr(parameters, name)) is not None and limits[0] == limits[1]:
                raise ParameterError(f"{name} must be a range for a picture, not {limits[0]:g} alone")
    check_outputs(json=options.json, record=options.record, out=options.out)
    workers = chosen_workers(options, default=0)
    progress = Progress("stability")
    with cells_kept(options.record, _FALLBACK), closing(progress):
        result = run_stability(parameters, record=Record(options.record), workers=workers, progress=progress)
    tell_of_others("stability", result.others)
    if options.json is not None:
        write_json(options.json, result.as_json())
    pictures = []
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        pictures.append(plots.stability_map(result, options.out / "stability.png"))
    if options.json != "-":
        print(stability_table(result))
        for path in pictures:
            print(f"  wrote {path}")
    return 0
