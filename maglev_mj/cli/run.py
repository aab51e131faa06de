"""Commands `run`, `drop`, `press`, `stick-slip`: a scene, variants, phases."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import AbstractContextManager
from inspect import getdoc
from pathlib import Path
from typing import Annotated, NamedTuple

from maglev_mj.cli.arguments import Parser, count, offer
from maglev_mj.cli.declare import Shared
from maglev_mj.cli.kinds import Pictures, Record, json_of
from maglev_mj.cli.options import add_parameters
from maglev_mj.cli.output import keep_partial, write_results
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_phase, add_scene, chosen_scene, warn_of_instability
from maglev_mj.errors import DivergenceError
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.run import Begin, run_variants
from maglev_mj.scenes.scene import Scene


class _Sampling(NamedTuple):
    """Chosen plant and phases of the samples."""

    plant: str
    phase: float
    phases: int | None


def _add_sampling(parser: Parser, cls: type[Scene]) -> None:
    plants, group = cls.plants, parser.group("run")
    described = f"{', '.join(plants)} (default {plants[0]})"
    offer(group.add_argument("--plant", default=plants[0], metavar="NAME", help=described), plants)
    if cls.takes_phase:
        add_phase(parser, "run", 0.0)
        group.add_argument("--phases", type=count, metavar="N", help="also sweep N phases, evenly spread over a period")
    else:
        parser.set_defaults(phase=0.0, phases=None)


def _chosen_sampling(options: argparse.Namespace) -> _Sampling:
    return _Sampling(options.plant, options.phase, options.phases)


def _add_scene(parser: Parser) -> None:
    """Add the options of any scene, or of the one that the command is named by."""
    name = parser.prog.split()[-1]
    if name == "run":
        add_scene(parser, more=_add_sampling)
        return
    cls = find_scene(name)
    parser.description, _, parser.epilog = str(getdoc(cls)).partition("\n\n")
    parser.set_defaults(scene_class=cls)
    add_parameters(parser.group("parameters of the scene"), cls)
    _add_sampling(parser, cls)


def run(
    *,
    scene: Annotated[Scene, Shared(_add_scene, chosen_scene)],
    sampling: Annotated[_Sampling, Shared(None, _chosen_sampling)],
    json: Annotated[str | None, json_of("parameters, motion and figures")] = None,
    pictures: Pictures,
    record: Record = None,
) -> int:
    """Run any scene: of this package, or a file of yours."""
    warn_of_instability(scene)
    alone = json == "-" and pictures is None
    variants = dict(list(scene.variants().items())[: 1 if alone else None])
    banded = pictures is not None and scene.drawn_phases and "exact" in scene.plants
    bands = (sampling.phases or scene.drawn_phases) if banded else None
    written = list[Path]()
    recording: AbstractContextManager[Begin] | None = None
    if record is not None:
        from maglev_mj.session.replay import recorded_to  # with all that reads and writes recordings

        recording = recorded_to(record, written)
    try:
        with Progress(scene.name) as progress:
            results = run_variants(
                variants,
                plant=sampling.plant,
                phase=sampling.phase,
                phases=sampling.phases,
                bands=bands,
                recording=recording,
                compare=json != "-",
                progress=progress,
            )
    except DivergenceError as error:
        keep_partial(error, json)
        raise

    def draw() -> Sequence[Path]:
        if pictures is None:
            return ()
        return [results.plot(pictures.path(name), picture=name) for name in results.pictures]

    write_results(json, results.as_json, lambda: str(results.table()), draw, written)
    return 0
