"""`maglev-mj fidelity`: what each piece of the device changes in a scene, and the cheapest model that will do."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from typing import Any

from maglev_mj.cli.drop import DROP_HELPS
from maglev_mj.cli.options import add_options, count, number_option
from maglev_mj.cli.output import check_outputs, write_json
from maglev_mj.cli.press import PRESS_HANDS, PRESS_HELPS
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.stick_slip import STICK_SLIP_HELPS
from maglev_mj.frames import AXES
from maglev_mj.scenes.choices import LAWS
from maglev_mj.studies.fidelity import MARGIN, Range, measure_fidelity
from maglev_mj.studies.fidelity_levels import measure_levels
from maglev_mj.studies.fidelity_scenes import FIDELITY_SCENES
from maglev_mj.tables import fidelity_table, levels_table

__all__ = ["add_command"]

_FREE = {name: STICK_SLIP_HELPS[name] for name in ("period", "delay", "duration")}
_GAINS = {"stiffness": "stiffness of the hold [N/m]", "damping": "damping of the hold [N s/m]"}

_OPTIONS: Mapping[str, tuple[Mapping[str, Iterable[str]], Mapping[str, str]]] = {
    "drop": ({}, DROP_HELPS),
    "drop-no-pulse": ({}, DROP_HELPS),
    "press": ({"hand": PRESS_HANDS}, PRESS_HELPS),
    "stick-slip": ({"law": tuple(LAWS), "axis": AXES}, STICK_SLIP_HELPS),
    "twist": ({}, _FREE),
    "six-axes": ({}, {**_FREE, **_GAINS}),
    "let-go": ({}, _FREE),
}
"""Options of each scene: those of its own command."""

_BY_LEVEL = "quantize"
"""The sensor's steps are a model level here."""


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    text = "what each piece of the device changes in a scene, and the cheapest model that will do"
    parser = commands.add_parser("fidelity", help=text, description=text)
    scenes = parser.add_subparsers(dest="scene", required=True, metavar="scene")
    for name, scene in FIDELITY_SCENES.items():
        own = scenes.add_parser(name, help=scene.describe(scene.parameters))
        _add_range(own, scene.tolerance)
        names, helps = _OPTIONS[name]
        helps = {option: text for option, text in helps.items() if option != _BY_LEVEL}
        add_options(own, names, helps, scene.parameters)
        # an option that is not given keeps what depends on others derived
        own.set_defaults(run=_fidelity, parameters=[*names, *helps], **dict.fromkeys([*names, *helps]))
        own.add_argument("--json", metavar="FILE", help="write the figures as JSON; - for standard output")
    every = scenes.add_parser("all", help="what each piece changes in every scene, as one table")
    every.add_argument("--json", metavar="FILE", help="write the figures as JSON; - for standard output")
    every.set_defaults(run=_all)


def _add_range(parser: argparse.ArgumentParser, tolerance: float) -> None:
    """Add the options of what the answer is to hold for."""
    usual = Range()
    parser.epilog = (
        "Figures are the worst over phases, jitter seeds and gains of the whole device, and over 4096 cases more on "
        f"the exact plant. A model keeps a tolerance if {MARGIN:g} times its figure does, in all cases of the former "
        "and a share of the latter: the margin for cases not looked at."
    )
    parser.add_argument(
        "--tolerance",
        type=number_option,
        metavar="X",
        help=f"largest displacement of a coil that does not matter [m] (default {tolerance:g})",
    )
    parser.add_argument(
        "--boundary-tolerance",
        type=number_option,
        default=usual.boundary,
        metavar="X",
        help="largest shift of the stiffest stable wall by the integrator, as a share of it, at this period, delay, "
        f"mass and hand: 0.01 takes an unstable wall for stable up to 1 %% beyond (default {usual.boundary:g})",
    )
    parser.add_argument(
        "--phases",
        type=count,
        default=usual.phases,
        metavar="N",
        help="phases of the samples, evenly spread over a period, each with a jitter seed of its own "
        f"(default {usual.phases})",
    )
    parser.add_argument(
        "--around",
        type=number_option,
        default=usual.around,
        metavar="X",
        help=f"stiffness and damping each also so much smaller and larger, as a share (default {usual.around:g})",
    )
    parser.add_argument(
        "--share",
        type=number_option,
        default=usual.share,
        metavar="X",
        help="share of the cases on the exact plant that must keep the tolerance: where a sample just meets the wall "
        f"or just misses it, a few go far in any model (default {usual.share:g})",
    )


def _fidelity(options: argparse.Namespace) -> int:
    check_outputs(json=options.json)
    given = {name: value for name in options.parameters if (value := getattr(options, name)) is not None}
    scene = FIDELITY_SCENES[options.scene].changed(**given)
    over = Range(options.phases, options.around, options.share, options.boundary_tolerance)
    progress = Progress("fidelity")
    try:
        result = measure_fidelity(scene, options.tolerance, over, progress=progress)
    finally:
        progress.close()
    if options.json is not None:
        write_json(options.json, result.as_json())
    if options.json != "-":
        print(fidelity_table(result))
    return 0


def _all(options: argparse.Namespace) -> int:
    check_outputs(json=options.json)
    progress, found = Progress("fidelity"), {}
    try:
        for place, (name, scene) in enumerate(FIDELITY_SCENES.items()):
            found[name] = measure_levels(scene)
            progress(place + 1, len(FIDELITY_SCENES))
    finally:
        progress.close()
    if options.json is not None:
        write_json(options.json, {name: [row.as_json() for row in rows] for name, rows in found.items()})
    if options.json != "-":
        print(levels_table(found))
    return 0
