"""Sweep of a scene over a grid of parameters.

Each point is a cell, kept in a record and run by workers.
"""

from __future__ import annotations

import inspect
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

import maglev_mj
from maglev_mj.errors import MaglevError, ParameterError, check_instance, check_one_of
from maglev_mj.frames import Array, unit_of
from maglev_mj.parameters import parsed_number
from maglev_mj.result import Result, Table, plain
from maglev_mj.scenes.find import SceneLike, get_scene, reference_of, scene_again, scene_of_text, text_of
from maglev_mj.scenes.names import installed_scenes
from maglev_mj.scenes.results import Figure, parameters_json
from maglev_mj.scenes.run import checked_phase, checked_plant, figures_of
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.together import figures_together
from maglev_mj.studies.cells import Cell, Record, Workers, chosen_workers, run_cells
from maglev_mj.versions import hash_of

MOST_CELLS = 1_000_000
"""Largest number of cells in a sweep."""

_SHARES = 0.0, 50.0, 100.0
_JOBS, _MOST_TOGETHER = 8, 50
_LEAST_IN_BATCHES, _MOST_IN_BATCHES = 64, 512

_Run: TypeAlias = tuple[Scene, str, float]
"""Scene, plant name, and phase."""

_UNKNOWN = Figure("", lambda result: None)


@dataclass(frozen=True, eq=False)
class Sweep(Result):
    """Results of a scene over a grid.

    Attributes:
        scene: Class of the scene.
        varied: Values of the parameters that vary, by name, as given.
        cells: Parameters of each run, the last one varying fastest.
        results: Figures of each cell by name, or {"error": ...} of a run that failed.
        resumed: Number of cells whose results were in the record before.
        record: File of the record; None for none.
        other_versions: Other code behind cells of the record; see `Record.others`.
    """

    scene: type[Scene]
    varied: Mapping[str, Sequence[Any]]
    cells: Sequence[Cell]
    results: Sequence[Mapping[str, Any]]
    resumed: int = field(repr=False)  # JSON is the same whatever the record had
    record: str | None = field(repr=False)
    other_versions: Sequence[Mapping[str, Any]]
    drawn_by: ClassVar = "maglev_mj.studies.pictures:sweep"

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return varied values and figures, a row for each cell.

        Figures are in SI units, NaN if missing; those of several hits are left out. `error` is there if a cell failed.
        """
        rows = list(itertools.product(*self.varied.values()))
        columns: dict[str, NDArray[Any]] = {
            name: np.array([row[place] for row in rows]) for place, name in enumerate(self.varied)
        }
        columns |= {name: self.figure(name).ravel() for name in self.names if self.is_number(name)}
        if any("error" in result for result in self.results):
            columns["error"] = np.array([result.get("error", "") for result in self.results])
        return columns

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        parameters = [self.scene.parameter(name) for name in self.varied if name not in ("plant", "phase")]
        named = {name: self.scene.figures[name] for name in self.names if name in self.scene.figures}
        units = {one.name: self.unit_along(one.unit, one.along) for one in parameters}
        return units | {name: self.unit_along(one.si_unit, one.along) for name, one in named.items()}

    def unit_along(self, unit: str, along: bool) -> str:
        """Return a quantity's unit on the axes of the cells; see `unit_of`."""
        axes = dict.fromkeys(cell.get("axis", self.scene.shown_axis) for cell in self.cells)
        return " or ".join(dict.fromkeys(unit_of(unit, axis, along) for axis in axes))

    def table(self) -> Table:
        """Return the spread of each figure over the cells."""
        over = ", ".join(f"{name} ({len(values)})" for name, values in self.varied.items())
        failed = [result["error"] for result in self.results if "error" in result]
        choices = [name for name, values in self.varied.items() if any(isinstance(value, str) for value in values)]
        cells = [dict(zip(self.varied, row)) for row in itertools.product(*self.varied.values())]
        kinds = np.array([", ".join(str(cell[name]) for name in choices) for cell in cells])
        rows = []
        for name, kind in itertools.product(filter(self.is_number, self.names), dict.fromkeys(kinds.tolist())):
            one, values = self.shown(name), self.figure(name).ravel()[kinds == kind]
            if (finite := values[np.isfinite(values)] * one.scale).size:
                spread = np.percentile(finite, _SHARES).tolist()
                rows.append((name, *[kind] * bool(choices), *spread, self.unit_along(one.unit, one.along), finite.size))
        notes = [f"{self.resumed} of them already in {self.record}"] if self.record else []
        count = "1 cell" if len(failed) == 1 else f"{len(failed)} cells"
        notes += [f"{count} failed, the first because {failed[0]}"] if failed else []
        head = "", *([", ".join(choices)] if choices else []), "least", "median", "greatest", "unit", "cells"
        title = f"Sweep of {self.scene.name} over {over}: {len(self.results)} cells"
        return Table(title, head, rows, "\n".join(notes))

    @property
    def names(self) -> list[str]:
        """Names of the figures of the cells."""
        names = dict.fromkeys(name for result in self.results if "error" not in result for name in result)
        return list(names or self.scene.figures)

    def shown(self, name: str) -> Figure:
        """Return a figure with its unit, without one for an undeclared name."""
        named: Mapping[str, Figure] = self.scene.figures
        return named.get(name, _UNKNOWN)

    def is_number(self, name: str) -> bool:
        """Return whether a figure is one number a cell."""
        return not any(isinstance(result.get(name), Sequence) for result in self.results)

    def figure(self, name: str) -> Array:
        """Return a figure over the grid.

        It has a dimension for each varied parameter, and NaN for missing values.

        Raises:
            ParameterError: If the scene has no such figure.
        """
        check_one_of("figure", self.names, name)
        results = [result.get(name) for result in self.results]
        values = np.array([math.nan if value is None else value for value in results], dtype=np.float64)
        return values.reshape([len(one) for one in self.varied.values()])


def sweep(
    scene: SceneLike,
    vary: Mapping[str, Sequence[Any]],
    *,
    plant: str | None = None,
    phase: float = 0.0,
    workers: Workers | int | None = None,
    record: Path | str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Run a scene over the product of parameters' values.

    Example:
        >>> from maglev_mj import find_scene, sweep
        >>> found = sweep(find_scene("drop"), {"height": [0.001, 0.002], "damping": [60.0, 80.0]}, plant="exact")
        >>> found.figure("penetration").shape
        (2, 2)

    Args:
        scene: The scene, its class, or a text for `find_scene`. On other machines a user's own scene file cannot
            import files beside it.
        vary: Values by parameter; "plant" and "phase" vary too.
        plant: Name from PLANTS; the scene's default by default.
        phase: Phase of the samples, in [0, 1).
        workers: Number of processes on this machine, or `dask_workers`; None for this process.
        record: File of JSON lines for the results; cells found in it are not run again.
        progress: Function called with the number of cells done and the number of all.

    Raises:
        ParameterError: If nothing varies, there is no such parameter, a value is outside its bounds, or the grid is too
            large.
        StudyInterrupted: On Ctrl-C; the cells done are in the record.
        WorkersError: If a cluster is gone, or one of its workers has other code.
    """
    chosen = get_scene(scene)
    if not vary:
        raise ParameterError("vary must give a list of values for at least one parameter, not {}; run() does one run")
    cells = swept_cells(chosen, vary, plant=plant, phase=phase)
    file = None if record is None else str(record)
    kept_cells = Record(None if record is None else Path(record))
    resumed = 0 if record is None else sum(cell in kept_cells for cell in cells)
    executor = chosen_workers(workers)
    function = partial(run_scene_cells, text=_text(type(chosen)))
    together = _cells_a_job(len(cells) - resumed, executor.window, all(cell["plant"] == "exact" for cell in cells))
    others = kept_cells.others(cells)
    results = run_cells(function, cells, record=kept_cells, workers=executor, together=together, progress=progress)
    varied = {name: list(values) for name, values in vary.items()}
    return Sweep(type(chosen), varied, cells, results, resumed, file, others)


def _cells_a_job(missing: int, window: int, batches: bool) -> int:
    """Return the number of cells in a job.

    There are enough jobs for every worker to get several, and few enough that their overhead is negligible. Small
    batches are expensive: their jobs are not much smaller than a worker's total share, or 64.
    """
    several = missing // (_JOBS * window)
    if batches:
        return max(min(several, _MOST_IN_BATCHES), min(-(-2 * missing // max(window, 2)), _LEAST_IN_BATCHES), 1)
    return max(min(several, _MOST_TOGETHER), 1)


def swept_cells(
    scene: Scene, vary: Mapping[str, Sequence[Any]], *, plant: str | None = None, phase: float = 0.0
) -> list[Cell]:
    """Return the checked cells of a sweep.

    Each has every parameter and everything that makes its result reproducible.

    Raises:
        ParameterError: If there is no such parameter, a value is outside its bounds, or the grid is too large.
    """
    check_instance("vary", vary, Mapping, "lists of values by parameter")
    for name, values in vary.items():
        if isinstance(values, str) or not isinstance(values, Collection) or not len(values):
            raise ParameterError(f"vary must give a list of values for {name}, not {values!r}")
    count = math.prod(len(values) for values in vary.values())
    if count > MOST_CELLS:
        raise ParameterError(f"a sweep must have at most {MOST_CELLS} cells, not {count}")
    for name in vary:
        _check_name(type(scene), name)
    head = {"scene": _name(type(scene)), "version": maglev_mj.__version__}
    cells = []
    for values in itertools.product(*vary.values()):
        changes = {"plant": plant, "phase": phase, **dict(zip(vary, values, strict=True))}
        chosen, at = checked_plant(scene, changes.pop("plant")), checked_phase(changes.pop("phase"))
        cells.append(head | parameters_json(scene.replace(**changes), chosen, at))
    return cells


def run_scene_cells(cells: Sequence[Cell], text: str | None = None) -> list[dict[str, Any]]:
    """Return the figures of each cell.

    {"error": ...} for a run that failed, such as by divergence.

    Args:
        cells: Cells of one scene.
        text: Text of the scene's file; None for a scene of a package.

    Raises:
        ParameterError: If there is no such scene, or its file fails.
    """
    runs = [_made(dict(cell), text) for cell in cells]
    results: list[Mapping[str, Any] | None] = [None] * len(runs)
    plants = defaultdict(list)
    for index, (scene, plant, _) in enumerate(runs):
        plants[type(scene), plant].append(index)
    for (cls, plant), indices in plants.items():
        together = _together(cls, plant, [runs[index] for index in indices])
        for index, figures in zip(indices, together, strict=True):
            results[index] = figures
    return [
        _alone(one, text is not None) if figures is None else plain(figures)
        for one, figures in zip(runs, results, strict=True)
    ]


def _made(cell: Cell, text: str | None) -> _Run:
    name, plant, phase = cell.pop("scene"), cell.pop("plant"), cell.pop("phase", 0.0)
    cell.pop("version")
    if text is None:
        return scene_again(name.partition("@")[0], cell), plant, phase
    return scene_of_text(text, name.rpartition(":")[2].partition("@")[0]).from_json(cell), plant, phase


def _together(cls: type[Scene], plant: str, runs: Sequence[_Run]) -> Sequence[Mapping[str, Any] | None]:
    """Return the figures of runs made as batches.

    None for those that must be made alone.
    """
    try:
        together = figures_together([scene for scene, _, _ in runs], plant, [phase for _, _, phase in runs])
    except MaglevError:  # of any of them: its own run reports the error
        return [None] * len(runs)
    done = [index for index, figures in enumerate(together) if figures is not None]
    # a user's law may mix devices, which its interface forbids: two separate runs must give the same
    for index in () if _is_ours(cls) else {*done[:1], *done[-1:]}:
        if not _same(together[index], _alone(runs[index], True)):
            return [None] * len(runs)
    return together


def _same(figures: Mapping[str, Any] | None, alone: Mapping[str, Any]) -> bool:
    """Return True for figures equal except for rounding.

    They are compared with those of a run alone.
    """
    if figures is None or figures.keys() != alone.keys():
        return False
    pairs = [(np.array(one, dtype=float), np.array(alone[name], dtype=float)) for name, one in plain(figures).items()]
    return all(a.shape == b.shape and np.allclose(a, b, 1e-6, 1e-12, equal_nan=True) for a, b in pairs)


def _alone(one: _Run, catches: bool) -> dict[str, Any]:
    """Return the figures of one run, or its error.

    Any error is caught if `catches`, as for a user's own code.
    """
    scene, plant, phase = one
    try:
        figures: dict[str, Any] = plain(figures_of(scene, plant, phase))
        return figures
    except MaglevError as error:
        return {"error": str(error)}
    except Exception as error:
        if not catches:
            raise
        return {"error": f"{type(error).__name__}: {error}"}


def _name(cls: type[Scene]) -> str:
    """Return the name of a scene in cells.

    It is the reference, with a hash of the file for another package's scene.
    """
    if _is_ours(cls):
        return reference_of(cls)
    place = f"{Path(inspect.getfile(cls)).name}:{cls.__name__}" if _text(cls) else _place(cls)
    return f"{place}@{hash_of(text_of(cls))}"


def _text(cls: type[Scene]) -> str | None:
    """Return a scene's text for workers, or None.

    None is for a scene of a package, which the workers have.
    """
    if _is_ours(cls) or any(entry.value == _place(cls) for entry in installed_scenes()):
        return None
    return text_of(cls)


def _place(cls: type[Scene]) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _is_ours(cls: type[Scene]) -> bool:
    return cls.__module__.partition(".")[0] == "maglev_mj"


def value_of(cls: type[Scene], name: str, text: str) -> Any:
    """Return a parameter's value from its text.

    The parameter may be "plant" or "phase".

    Raises:
        ParameterError: If there is no such parameter, or the text is not of its kind.
    """
    _check_name(cls, name)
    if name == "plant":
        return text
    return parsed_number(name, text) if name == "phase" else cls.parameter(name).from_text(text)


def _check_name(cls: type[Scene], name: str) -> None:
    names = ["plant", *(["phase"] if cls.takes_phase else []), *(one.name for one in cls.parameters())]
    check_one_of(f"parameter of {cls.name}", names, name)
