"""`maglev-mj run`, `drop`, `press`, `stick-slip`: a scene, variants, phases."""

from __future__ import annotations

import argparse
from contextlib import AbstractContextManager
from inspect import getdoc
from pathlib import Path

from maglev_mj.cli.arguments import Parser, offer
from maglev_mj.cli.options import add_outputs, add_parameters, add_recording, count, number_option
from maglev_mj.cli.output import keep_partial, write_results
from maglev_mj.cli.pictures import chosen_pictures
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene, chosen_scene, warn_of_instability
from maglev_mj.errors import DivergenceError
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.run import Begin, run_variants
from maglev_mj.scenes.scene import Scene


def add_options(parser: Parser) -> None:
    """Add the options of `run` or a scene's own command."""
    name = parser.prog.split()[-1]
    if name == "run":
        add_scene(parser, more=_add_plant)
    else:
        cls = find_scene(name)
        parser.description, _, parser.epilog = str(getdoc(cls)).partition("\n\n")
        parser.set_defaults(scene_class=cls)
        add_parameters(parser.group("parameters of the scene"), cls)
        _add_plant(parser, cls)
    add_outputs(parser)
    add_recording(parser)
    parser.set_defaults(run=_run)


def _add_plant(parser: Parser, cls: type[Scene]) -> None:
    plants, group = cls.plants, parser.group("run")
    described = f"{', '.join(plants)} (default {plants[0]})"
    offer(group.add_argument("--plant", default=plants[0], metavar="NAME", help=described), plants)
    if cls.takes_phase:
        group.add_argument(
            "--phase",
            type=number_option,
            default=0.0,
            metavar="X",
            help="the samples are at (k + phase) period, in [0, 1) (default 0)",
        )
        group.add_argument("--phases", type=count, metavar="N", help="also sweep N phases, evenly spread over a period")
    else:
        parser.set_defaults(phase=0.0, phases=None)


def _run(options: argparse.Namespace) -> int:
    scene = chosen_scene(options)
    pictures = chosen_pictures(options)
    warn_of_instability(scene)
    alone = options.json == "-" and pictures is None
    variants = dict(list(scene.variants().items())[: 1 if alone else None])
    banded = pictures is not None and scene.drawn_phases and "exact" in scene.plants
    bands = (options.phases or scene.drawn_phases) if banded else None
    written = list[Path]()
    recording: AbstractContextManager[Begin] | None = None
    if options.record is not None:
        from maglev_mj.session.replay import recorded_to  # with all that reads and writes recordings

        recording = recorded_to(options.record, written)
    try:
        with Progress(scene.name) as progress:
            results = run_variants(
                variants,
                plant=options.plant,
                phase=options.phase,
                phases=options.phases,
                bands=bands,
                recording=recording,
                compare=options.json != "-",
                progress=progress,
            )
    except DivergenceError as error:
        keep_partial(error, options)
        raise
    write_results(
        options,
        results.as_json,
        lambda: str(results.table()),
        lambda folder: [results.plot(folder.path(name), picture=name) for name in results.pictures],
        written,
    )
    return 0
