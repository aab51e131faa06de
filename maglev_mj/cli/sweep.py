"""Command `sweep`, and what studies share: workers, kept cells."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.declare import Option, Shared, option
from maglev_mj.cli.kinds import json_of
from maglev_mj.cli.options import described
from maglev_mj.cli.output import check_files, write_result
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene, scene_class
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import parsed_number
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.cells import Record, StudyInterrupted, Workers, WorkersError, dask_workers, local_workers
from maglev_mj.studies.sweep import MOST_CELLS, value_of
from maglev_mj.studies.sweep import sweep as run_sweep
from maglev_mj.terminal import wrapped
from maglev_mj.versions import differences, versions


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """Chosen workers of a study."""

    workers: Annotated[int | None, option("processes on this machine; 0 for this one alone", "workers")] = None
    scheduler: Annotated[
        str | None, option("run on the Dask cluster of this scheduler instead", "workers", "ADDRESS")
    ] = None
    command: Annotated[str, Shared(None, lambda options: options.command)]

    def open(self, default: int | None) -> Workers:
        """Return the workers.

        By default `default` processes; None for one per processor.
        """
        if self.scheduler is None:
            return local_workers(default if self.workers is None else self.workers)
        if self.workers is not None:
            raise ParameterError(f"workers must be left to the scheduler where there is one, not {self.workers}")
        with warnings.catch_warnings(record=True) as caught:
            workers = dask_workers(self.scheduler)
        for warning in caught:
            print(f"maglev-mj {self.command}: {warning.message}", file=sys.stderr)
        return workers


def cells_in(purpose: str) -> Option:
    """Declare the record of a study's cells."""
    return option(f"{purpose}; one JSON object a line", "output", "FILE")


@contextmanager
def cells_kept(path: Path | None, fallback: Path) -> Iterator[None]:
    """Write the cells of an interrupted study to a file.

    Only if they are not in a record yet; the error names the file.
    """
    try:
        yield
    except (StudyInterrupted, WorkersError) as stopped:
        if path is None:
            path = fallback
            kept = Record(path)
            kept.add([(cell, result) for cell, result in stopped.landed if cell not in kept])
        where = f"{len(stopped.landed)} cells are in {path}, the same command with --record {path} goes on from there"
        stopped.args = (f"{stopped}; {where}",)
        raise


def warn_of_versions(command: str, others: Sequence[Mapping[str, Any]]) -> None:
    """Print on standard error that other code computed some cells; see `Record.others`."""
    if others:
        ours = versions()
        kinds = [f"{other['cells']} cells have {differences(other['versions'], ours)}" for other in others]
        more = f"; and {len(kinds) - 1} more kinds" if len(kinds) > 1 else ""
        print(f"maglev-mj {command}: the record is also by other code: {kinds[0]}{more}", file=sys.stderr)


def _list_parameters(parser: Parser, cls: type[Scene]) -> None:
    """List a scene's parameters in the help."""
    texts = {"plant": f"{', '.join(cls.plants)} (default {cls.plants[0]})"}
    if cls.takes_phase:
        texts["phase"] = "of the samples, in [0, 1) (default 0)"
    texts |= {one.name: described(one, getattr(cls(), one.name)) for one in cls.parameters()}
    lines = [line for name, text in texts.items() for line in wrapped(text, f"  {name:<15}", " " * 17)]
    parser.epilog = "\n".join([f"parameters of {cls.name}:", *lines])


_SweptScene: TypeAlias = Annotated[
    type[Scene], Shared(partial(add_scene, more=_list_parameters, options=False), scene_class)
]
SceneName: TypeAlias = Annotated[str, Shared(None, lambda options: options.scene)]


def sweep(
    *,
    scene: _SweptScene,
    name: SceneName,
    vary: Annotated[
        list[str],
        option(
            "its values: LOW:HIGH:COUNT evenly spread, A,B,C, or A;B;C where values have commas; repeat for a grid",
            "grid",
            "NAME=VALUES",
        ),
    ],
    set: Annotated[list[str], option("a parameter that is not its default", "grid", "NAME=VALUE")],
    json: Annotated[str | None, json_of("all cells and figures")] = None,
    record: Annotated[
        Path | None,
        cells_in("results land here as they come, and what is here is not done again (SCENE-sweep.jsonl)"),
    ] = None,
    workers: WorkerOptions,
) -> int:
    """Any scene over a grid of its parameters."""
    fixed = {name: [value_of(scene, name, text)] for name, text in _assignments(set).items()}
    varied = {name: _values(scene, name, text) for name, text in _assignments(vary).items()}
    if not varied:
        raise ParameterError(f"a sweep needs --vary NAME=VALUES; for one run: maglev-mj run {name}")
    if both := sorted(fixed.keys() & varied.keys()):
        raise ParameterError(f"{both[0]} must be either set or varied, not both")
    path = record or Path(f"{scene.name}-sweep.jsonl")
    check_files({"record": path} if json in (None, "-") else {"json": Path(json), "record": path})
    running = workers.open(default=None)
    with cells_kept(path, path), Progress(f"sweep {scene.name}") as progress:
        result = run_sweep(scene, fixed | varied, workers=running, record=path, progress=progress)
    result = replace(result, varied=varied)  # a set parameter is no dimension of the grid
    warn_of_versions("sweep", result.other_versions)
    write_result(json, result)
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
