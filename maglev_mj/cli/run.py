"""`maglev-mj run SCENE`, and `drop`, `press` and `stick-slip`: a scene run, its variants and phases beside it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np

from maglev_mj import plots
from maglev_mj.cli.options import Parser, add_outputs, add_parameters, add_recording, count, number_option
from maglev_mj.cli.output import check_outputs, check_recording, keep_partial, write_results
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene, chosen_scene, warn_of_instability
from maglev_mj.errors import DivergenceError
from maglev_mj.replay import write_run
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.run import Phases, Result, run, run_phases
from maglev_mj.scenes.scene import PLANTS, Scene
from maglev_mj.tables import run_table

__all__ = ["add_command"]

_BY_NAME = "drop", "press", "stick-slip"


def add_command(commands: Any) -> None:
    """Add `run`, and a command for each scene of the paper."""
    parser = commands.add_parser("run", help="run any scene: one of this package, or a file of your own")
    add_scene(parser, more=_add_plant)
    _add_outputs(parser)
    for name in _BY_NAME:
        cls = find_scene(name)
        own = commands.add_parser(name, help=str(cls.__doc__).split("\n")[0].rstrip("."))
        own.epilog = "\n".join(str(cls.__doc__).split("\n")[2:])
        own.set_defaults(scene_class=cls)
        add_parameters(own, cls)
        _add_plant(own, cls)
        _add_outputs(own)


def _add_plant(parser: Parser, cls: type[Scene]) -> None:
    plants = cls.plants
    parser.add_argument("--plant", default=plants[0], metavar="NAME", help=f"{', '.join(plants)} (default {plants[0]})")
    if cls.takes_phase:
        parser.add_argument(
            "--phase",
            type=number_option,
            default=0.0,
            metavar="X",
            help="the samples are at (k + phase) period, in [0, 1) (default 0)",
        )
        parser.add_argument(
            "--phases", type=count, metavar="N", help="also sweep N phases, evenly spread over a period"
        )
    else:
        parser.set_defaults(phase=0.0, phases=None)


def _add_outputs(parser: Parser) -> None:
    add_outputs(parser)
    add_recording(parser)
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    scene = chosen_scene(options)
    check_recording(options.record)
    if options.out is not None:
        plots.require()
    check_outputs(json=options.json, out=options.out)
    warn_of_instability(scene)
    recorded = []
    if options.record is not None:
        recorded = write_run(options.record, scene, plant=options.plant, phase=options.phase)
    alone = options.json == "-" and options.out is None
    variants = dict(list(scene.variants().items())[: 1 if alone else None])
    try:
        results, sweeps = _results(scene, variants, options)
    except DivergenceError as error:
        keep_partial(error, options)
        raise
    first = next(iter(results.values()))
    swept = {"sweep": next(iter(sweeps.values())).as_json()} if sweeps else {}
    write_results(
        options,
        lambda: first.as_json() | swept,
        lambda: run_table(results, sweeps, _gap(first)),
        lambda folder: [
            draw(results, sweeps, folder / name) for name, draw in plots.pictures_of(scene, sweeps).items()
        ],
        recorded,
    )
    return 0


def _results(
    scene: Scene, variants: Mapping[str, Scene], options: argparse.Namespace
) -> tuple[dict[str, Result], dict[str, Phases]]:
    results: dict[str, Result] = {}
    sweeps: dict[str, Phases] = {}
    progress = Progress(scene.name)
    try:
        for label, variant in variants.items():
            results[label] = run(variant, plant=options.plant, phase=options.phase)
        if options.phases is not None:
            for label, variant in variants.items():
                sweeps[label] = run_phases(variant, options.phases, plant=options.plant, progress=progress)
    except DivergenceError as error:
        if results:
            error.partial = next(iter(results.values()))  # the run itself is worth keeping
        raise
    finally:
        progress.close()
    return results, sweeps


def _gap(result: Result) -> float | None:
    """Return how far the two plants are apart on a run [m, rad]; None where the scene runs on one."""
    others = [name for name in result.scene.plants if name in PLANTS and name != result.plant]
    if not others:
        return None
    twin = run(result.scene, plant=others[0], phase=result.phase)
    time = result.times()
    return float(np.abs(result.motion(time)[0] - twin.motion(time)[0]).max())
