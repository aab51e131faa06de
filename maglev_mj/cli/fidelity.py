"""`maglev-mj fidelity`: effect of each device part; cheapest sufficient model."""

from __future__ import annotations

import argparse

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_json, chosen, count, number_option
from maglev_mj.cli.output import write_result, write_results
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene
from maglev_mj.result import plain
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.fidelity import (
    COMPARED,
    MARGIN,
    Range,
    levels_table,
    measure_fidelity,
    measure_levels,
    preset_of,
)

_RANGE = "what the answer is to hold for"
_BY_LEVEL = ("quantize",)
"""Parameters that are a model level here: the sensor's steps."""


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = "What each piece of the device changes in a scene, and the cheapest model that will do."
    add_scene(parser, more=_add_range, find=_found, names=("drop-no-pulse", "all"), without=_BY_LEVEL)
    parser.group(_RANGE)
    add_json(parser)
    parser.set_defaults(run=_fidelity)


def _found(text: str) -> Scene | None:
    """Return a scene; None for "all"."""
    return None if text == "all" else preset_of(text).scene


def _add_range(parser: Parser, cls: type[Scene]) -> None:
    """Add the options of the range of validity."""
    usual, group = Range(), parser.group(_RANGE)
    parser.set_defaults(phase=0.0)
    if cls.takes_phase:
        group.add_argument(
            "--phase",
            type=number_option,
            metavar="X",
            help="the samples are at (k + phase) period, in [0, 1) (default 0)",
        )
    parser.epilog = (
        "Figures are the worst over phases, jitter seeds and gains of the whole device, and over 4096 cases more on "
        f"the exact plant. A model keeps a tolerance if {MARGIN:g} times its figure does, in all cases of the former "
        "and a share of the latter: the margin for cases not looked at."
    )
    group.add_argument(
        "--tolerance",
        type=number_option,
        metavar="X",
        help="largest displacement of a coil that does not matter [m] (default: the scene's own)",
    )
    group.add_argument(
        "--boundary-tolerance",
        type=number_option,
        default=usual.boundary,
        metavar="X",
        help="largest shift of the stiffest stable wall by the integrator, as a share of it, at this period, delay, "
        f"mass and hand: 0.01 takes an unstable wall for stable up to 1 %% beyond (default {usual.boundary:g})",
    )
    group.add_argument(
        "--phases",
        type=count,
        default=usual.phases,
        metavar="N",
        help="phases of the samples, evenly spread over a period, each with a jitter seed of its own "
        f"(default {usual.phases})",
    )
    group.add_argument(
        "--around",
        type=number_option,
        default=usual.around,
        metavar="X",
        help=f"stiffness and damping each also so much smaller and larger, as a share (default {usual.around:g})",
    )
    group.add_argument(
        "--share",
        type=number_option,
        default=usual.share,
        metavar="X",
        help="share of the cases on the exact plant that must keep the tolerance: where a sample just meets the wall "
        f"or just misses it, a few go far in any model (default {usual.share:g})",
    )


def _fidelity(options: argparse.Namespace) -> int:
    if options.scene_class is None:
        return _all(options)
    preset = preset_of(options.scene)._replace(scene=chosen(options, options.scene_class))
    over = Range(options.phases, options.around, options.share, options.boundary_tolerance)
    with Progress("fidelity") as progress:
        result = measure_fidelity(preset, options.tolerance, over, phase=options.phase, progress=progress)
    write_result(options, result)
    return 0


def _all(options: argparse.Namespace) -> int:
    found = {}
    with Progress("fidelity") as progress:
        for place, name in enumerate(COMPARED):
            found[name] = measure_levels(name)
            progress(place + 1, len(COMPARED))
    data = {name: plain(rows) for name, rows in found.items()}
    write_results(options, lambda: data, lambda: str(levels_table(found)))
    return 0
