"""Sweep of a scene over a grid of parameters.

Each point is a cell, kept in a record and run by workers.
"""

from __future__ import annotations

import inspect
import itertools
import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib.util import find_spec
from operator import itemgetter
from pathlib import Path
from typing import Any, ClassVar, SupportsIndex, TypeAlias

import numpy as np
from numpy.typing import NDArray

import maglev_mj
from maglev_mj.control.stack import computed_together
from maglev_mj.errors import MaglevError, MissingPackageError, ParameterError, check_instance, check_one_of, file_path
from maglev_mj.frames import Array, unit_of
from maglev_mj.keywords import checked, with_period
from maglev_mj.parameters import parsed_number
from maglev_mj.result import Result, Table, capitalised, plain, with_unit
from maglev_mj.scenes.batch import figures_together
from maglev_mj.scenes.find import (
    SceneLike,
    get_scene,
    hash_of_code,
    object_of_text,
    reference_of,
    scene_from_reference,
    text_of,
)
from maglev_mj.scenes.names import installed_scenes
from maglev_mj.scenes.results import Figure, RunResult, figure_head, parameters_json, prefixed, scene_conditions
from maglev_mj.scenes.run import chaos_warning, checked_phase, checked_plant, figures_of, run, sensitivity
from maglev_mj.scenes.scene import PLANTS, OneDevice, Scene
from maglev_mj.scenes.stability_check import UNKNOWN, marks
from maglev_mj.studies.cells import Study, Workers, chosen_workers, grid_columns
from maglev_mj.studies.record import Cell, Record

MOST_CELLS = 100_000_000
"""Largest number of cells in a sweep."""

_SHARES = 0.0, 50.0, 100.0
_JOBS, _LEAST_TOGETHER, _MOST_TOGETHER = 8, 4, 50
_MOST_IN_BATCHES = 1024  # more would make a job long to wait for, and to lose
_CHAOS = 5  # cells, of two runs each; with `STARTS`, 16 runs
_CHECKED = 1000  # cells computed to check a grid

_Run: TypeAlias = tuple[Scene, str, float]
"""Scene, plant name, and phase."""

_UNKNOWN = Figure("", lambda result: None)


@dataclass(frozen=True, eq=False)
class Sweep(Result):
    """Results of a scene over a grid.

    Attributes:
        scene: Class of the scene.
        varied: Values of the varied parameters, by name, as passed.
        cells: Parameters of each run, the last one varying fastest; computed on access.
        results: Figures of each cell by name, or {"error": ...} for a failed run; stored in columns.
        resumed: Number of cells whose results were in the record before.
        record: Folder of the record; None for none.
        chaos: Warning about chaotic cells among up to 5 of the grid; empty for none.
    """

    scene: type[Scene]
    varied: Mapping[str, Sequence[Any]]
    cells: Grid
    results: Record
    resumed: int = field(repr=False)  # JSON must not depend on the record
    record: str | None = field(repr=False)
    chaos: str = field(default="", repr=False)
    pictures: ClassVar = {"sweep": "maglev_mj.studies.pictures:sweep"}

    def _headline(self) -> str:
        failed, count = self.results.failed, len(self.results)
        done, ends = count - len(failed), self.ended
        finding = self._finding() if done else f"all {count} cells {ends}" if count > 1 else ends
        others = f"; {len(failed)} of {count} cells {ends}" if failed and done else ""
        return f"{capitalised(self.scene.name)}: {finding}{others}"

    def _finding(self) -> str:
        """Return the first figure that varies, with the cell of its smallest value if there is one such cell."""
        columns, units, single = self.columns(), self.units, list[str]()
        for name in filter(self.is_number, self.names):
            one, values = self.shown(name), columns[name]
            unit = self.unit_along(one.unit, one.along)
            if not np.isfinite(values).any():
                continue
            least, most = (one.text(end.reduce(values)) for end in (np.fmin, np.fmax))
            single.append(f"{figure_head(name)} {least} {unit}".rstrip())
            if least != most:
                alike = [one.text(value) == least for value in values]
                cell = alike.index(True)
                at = " and ".join(chosen_text(key, columns[key][cell], units.get(key, "")) for key in self.varied)
                return f"{figure_head(name)} {least} to {most} {unit}".rstrip() + f", smallest at {at}" * (
                    sum(alike) == 1
                )
        done = len(self.results) - len(self.results.failed)
        same = f" in all {done} cells" * (done > 1)
        return f"{', '.join(single[:3])}{same}" if single else f"no figure{same}"

    @property
    def ended(self) -> str:
        """How failed cells ended: "diverged" if all did, else "failed"."""
        errors = [self.results[index]["error"] for index in self.results.failed]
        return "diverged" if all("diverged" in error for error in errors) else "failed"

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return varied values and figures, a row for each cell.

        Figures are in SI units, NaN if missing; those of several hits are left out. `error` is there if a cell failed,
        `warnings` if one is unstable, not judged, or exceeds the device's force or range.
        """
        columns = grid_columns(self.varied)
        columns |= {name: self.figure(name).ravel() for name in self.names if self.is_number(name)}
        if any(self._marks):
            columns["warnings"] = np.array(self._marks, dtype=object)
        if self.results.failed:
            columns["error"] = np.array([result.get("error", "") for result in self.results], dtype=object)
        return columns

    def to_pandas(self, *, indexed: bool = False) -> Any:
        """Return the columns as a data frame, their units in its `attrs["units"]`.

        Args:
            indexed: True for an index by parameter.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        frame = super().to_pandas()
        return frame.set_index([*self.varied]) if indexed else frame

    def to_xarray(self) -> Any:
        """Return the figures as an `xarray.Dataset` over the parameters, each variable with its `units`.

        Raises:
            MissingPackageError: If xarray or pandas is not installed.
        """
        if find_spec("xarray") is None:
            raise MissingPackageError("a data set needs xarray: pip install xarray")
        data = self.to_pandas(indexed=True).to_xarray()
        for name in self.units.keys() & data.variables.keys():
            data[name].attrs["units"] = self.units[name]
        return data

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        parameters = [self.scene.parameter(name) for name in self.varied if name not in ("plant", "phase")]
        named = {name: self.scene.figures[name] for name in self.names if name in self.scene.figures}
        units = {one.name: self.unit_along(one.unit, one.along) for one in parameters}
        return units | {name: self.unit_along(one.si_unit, one.along) for name, one in named.items()}

    def unit_along(self, unit: str, along: bool) -> str:
        """Return a quantity's unit on the axes of the cells; see `unit_of`."""
        axes = self.varied.get("axis", [self.cells[0].get("axis", self.scene.shown_axis)])
        return " or ".join(dict.fromkeys(unit_of(unit, axis, along) for axis in axes))

    @property
    def reasons(self) -> Sequence[str]:
        """Reasons for cells without a value, a line each in charts; those of failed runs are errors."""
        return ()

    @property
    def conditions(self) -> str:
        """See `Result`; of varied parameters axis, rate and delay alone."""
        axes = self.cells.axes
        scene = self.cells.scene.replace(
            **{name: values[0] for name, values in axes.items() if name not in ("plant", "phase")}
        )
        over = {name: values for name, values in axes.items() if len(values) > 1}
        if "delay" not in over and len({*axes.get("period", ())}) > 1:  # it may follow the period
            over["delay"] = [self.cells.scene.replace(period=value).delay for value in axes["period"]]
        plants = [str(name) for name in axes["plant"]]
        return scene_conditions(scene, f"plant{'s' * (len(plants) > 1)} {' and '.join(plants)}", over)

    def table(self) -> Table:
        """Return the spread of each figure over the cells; without numbers to vary, the figures of each cell."""
        over = ", ".join(f"{name} ({len(values)})" for name, values in self.varied.items())
        failed = self.results.failed
        choices = [name for name, values in self.varied.items() if any(isinstance(value, str) for value in values)]
        kinds = [", ".join(map(str, row)) for row in itertools.product(*(self.varied[name] for name in choices))]
        first = [[*self.varied].index(name) for name in choices]
        rows = list[tuple[Any, ...]]()
        for name in filter(self.is_number, self.names):
            one, values = self.shown(name), np.moveaxis(self.figure(name), first, range(len(first)))
            for kind, some in zip(kinds, values.reshape(len(kinds), -1), strict=True):
                if (finite := some[np.isfinite(some)] * one.scale).size:
                    spread, unit = np.percentile(finite, _SHARES).tolist(), self.unit_along(one.unit, one.along)
                    rows.append((figure_head(name), *[kind] * bool(choices), *spread, unit, finite.size))
        notes = []
        if self.record:
            total = _count(len(self.results))
            place = f"in {self.record}, {self.resumed} resumed" if self.resumed else f"written to {self.record}"
            notes.append(f"{total} {place}")
        notes += [f"{_count(len(failed))} failed, first error: {self.results[failed[0]]['error']}"] if failed else []
        head = ["", *[", ".join(choices)] * bool(choices), "min", "median", "max", "unit", "cells"]
        if len(kinds) == len(self.results):
            head, rows = self._each_cell()
        title = f"Sweep of {self.scene.name} over {over}: {_count(len(self.results))}"
        return Table(title, tuple(head), rows, "\n".join(notes), warnings=self.warnings)

    def _each_cell(self) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Return the head and a row for each cell: varied values and figures."""
        head, columns, units = [*self.varied], [*zip(*itertools.product(*self.varied.values()))], self.units
        for name in filter(self.is_number, self.names):
            one = self.shown(name)
            head.append(figure_head(name))
            units[head[-1]] = self.unit_along(one.unit, one.along)
            columns.append(tuple(map(one.text, self.figure(name).ravel())))
        return [with_unit(name, units.get(name)) for name in head], [*zip(*columns)]

    @property
    def warnings(self) -> Sequence[str]:
        """See `Result`."""
        counts, reasons = Counter[str](), dict[str, list[str]]()
        for text in self._marks:
            others, unknown, reason = text.partition(UNKNOWN)
            place, _, reason = reason.partition(": ")
            counts.update(filter(None, [*others.split(", "), unknown + place]))
            reasons.setdefault(unknown + place, []).append(reason)
        verdicts = [f"{count} of {_count(len(self._marks))}: {mark}" for mark, count in counts.items()]
        for index, mark in enumerate(counts):
            if mark.startswith(UNKNOWN):
                each = [*dict.fromkeys(reasons[mark])]
                verdicts[index] += f": {each[0]}{', or alike' * (len(each) > 1)}"
        return [*verdicts, *filter(None, [self.chaos])]

    @cached_property
    def _marks(self) -> list[str]:
        return [result.get("warnings", "") for result in self.results] if "warnings" in self.results.columns else []

    @property
    def names(self) -> list[str]:
        """Names of the figures of the cells."""
        return [name for name in self.results.columns if name not in ("error", "warnings")] or list(self.scene.figures)

    def shown(self, name: str) -> Figure:
        """Return a figure with its unit, without one for an undeclared name."""
        named: Mapping[str, Figure] = self.scene.figures
        return named.get(name, _UNKNOWN)

    def is_number(self, name: str) -> bool:
        """Return whether a figure is one number a cell."""
        return self.results.numbers(name) is not None

    def figure(self, name: str) -> Array:
        """Return a figure over the grid.

        It has a dimension for each varied parameter, and NaN for missing values.

        Raises:
            ParameterError: If the scene has no such figure.
        """
        check_one_of("figure", self.names, name)
        if (values := self.results.numbers(name)) is None:
            raise ParameterError(f"figure must be one number per cell (got {name})")
        return values.reshape([len(one) for one in self.varied.values()])


@checked(own="scene vary")
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
        vary: Values by parameter; "plant", "phase" and "rate" vary too.
        plant: Name from PLANTS; the scene's default by default.
        phase: Phase of the samples, in [0, 1).
        workers: Number of processes on this machine, or `dask_workers`; None for this process.
        record: Folder for the results; cells found in it are not run again.
        progress: Function called with the number of cells done and the number of all.

    Raises:
        ParameterError: If nothing varies, there is no such parameter, a value is outside its bounds, the grid is too
            large, or the record is of another grid or code.
        StudyInterrupted: On Ctrl-C; the cells done are in the record.
        WorkersError: If a cluster is gone, or one of its workers has other code.
    """
    chosen = get_scene(scene)
    check_instance("vary", vary, Mapping, "a mapping of parameters to lists of values")
    vary = with_period([one.name for one in chosen.parameters()], vary)
    if not vary:
        raise ParameterError("vary must give a list of values for at least one parameter, not {}; see run()")
    cells = Grid(chosen, vary, plant=plant, phase=phase)
    executor, function = chosen_workers(workers), partial(run_scene_cells, text=_text(type(chosen)))
    study = Study(function, cells, Record(None if record is None else file_path(record)), executor, progress)
    resumed, file = study.done, None if record is None else str(record)
    # by the total number of cells, so that a resumed sweep has the same batches
    results = study.run(_cells_a_job(len(cells), executor.window, {*cells.axes["plant"]} == {"exact"}))
    varied = {name: list(values) for name, values in vary.items()}
    return Sweep(type(chosen), varied, cells, results, resumed, file, _chaos(cells, _text(type(chosen))))


def _chaos(cells: Grid, text: str | None) -> str:
    """Return a warning about chaotic cells among some, evenly spaced; empty for none."""
    checked: list[tuple[float, int, RunResult]] = []
    for index in np.unique(np.linspace(0, len(cells) - 1, _CHAOS, dtype=np.int64)).tolist():
        with suppress(Exception):  # a failed cell reports its error
            scene, plant, phase = _run_of(dict(cells[index]), text)
            if scene.has_pulses:
                result = run(scene, plant=plant, phase=phase)
                checked.append((sensitivity(result), index, result))
    if not (count := sum(moved > 0.0 for moved, _, _ in checked)):
        return ""
    moved, index, result = max(checked, key=itemgetter(0))
    return chaos_warning(f"{count} of {_count(len(checked))} checked, most in row {index}", result, moved)


def chosen_text(name: str, value: Any, unit: str) -> str:
    """Return a parameter with its value and unit."""
    text = str(value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        if name == "period":
            name, value, unit = "rate", 1.0 / value, "Hz"
        factor, unit = prefixed(unit, abs(value))
        text = f"{factor * value:g}"
    return f"{name.replace('_', ' ')} {text} {unit}".rstrip()


def _count(cells: int) -> str:
    return "1 cell" if cells == 1 else f"{cells} cells"


def _cells_a_job(missing: int, window: int, batches: bool) -> int:
    """Return the number of cells per job: several jobs per worker, but negligible overhead.

    A batch costs nearly the same whatever its size: a job is a worker's share of the cells. Verdicts on single laws of
    a user are expensive too: without batches a job has at least half of that share, up to 4.
    """
    if batches:
        return max(min(-(-2 * missing // max(window, 2)), _MOST_IN_BATCHES), 1)
    several = missing // (_JOBS * window)
    return max(min(several, _MOST_TOGETHER), min(-(-missing // (2 * max(window, 1))), _LEAST_TOGETHER), 1)


class Grid(Sequence[Cell]):
    """Checked cells of a sweep, each computed on access.

    A cell has every parameter and everything that makes its result reproducible. Those of a slice, which a worker gets,
    lack derived parameters, which follow from the others. Each value is checked, and combinations at the corners and in
    between; a worker checks those that it makes.

    Args:
        scene: Scene with the parameters that do not vary.
        vary: Values of those that do, "plant" and "phase" among them.
        plant: Plant; the scene's default by default.
        phase: Phase of the samples, in [0, 1).

    Attributes:
        scene: The scene with the parameters that do not vary.
        axes: Values of what varies, of plant and phase.
        plan: All that the cells are made of, ready for JSON.

    Raises:
        ParameterError: If there is no such parameter, a value is outside its bounds, or the grid is too large.
    """

    def __init__(
        self, scene: Scene, vary: Mapping[str, Sequence[Any]], *, plant: str | None = None, phase: float = 0.0
    ) -> None:
        for name, values in vary.items():
            if isinstance(values, str) or not isinstance(values, Collection) or not len(values):
                raise ParameterError(f"vary must give a list of values for {name} (got {values!r})")
            _check_name(type(scene), name)
        if (count := math.prod(len(values) for values in vary.values())) > MOST_CELLS:
            raise ParameterError(f"a sweep must have at most {MOST_CELLS} cells (got {count})")
        checks: dict[str, Callable[[Any], Any]] = {one.name: one.checked for one in scene.parameters()}
        checks |= {"plant": partial(checked_plant, scene), "phase": checked_phase}
        derived = {one.name for one in scene.parameters() if one.derive}  # computed from others if None
        axes = {**vary, "plant": vary.get("plant", [plant]), "phase": vary.get("phase", [phase])}
        self.axes = {
            name: [one if one is None and name in derived else checks[name](one) for one in values]
            for name, values in axes.items()
        }
        self._shape, self.scene = tuple(map(len, self.axes.values())), scene
        self._head = {"scene": _name(type(scene)), "version": maglev_mj.__version__}
        fixed = {name: value for name, value in scene.independent_values().items() if name not in vary}
        self.plan = {"scene": self._head["scene"], **fixed, **self.axes, "vary": [*self.axes]}
        self._fixed = self._head | fixed
        ends = itertools.islice(itertools.product(*({0, length - 1} for length in self._shape)), _CHECKED)
        corners = np.ravel_multi_index(tuple(zip(*ends)), self._shape).tolist()
        for index in sorted({*corners, *np.linspace(0, count - 1, min(count, _CHECKED), dtype=np.int64).tolist()}):
            self[index]

    def __len__(self) -> int:
        return math.prod(self._shape)

    def __getitem__(self, index: SupportsIndex | slice) -> Any:
        """Return a cell, or the cells of a slice."""
        rows = range(len(self))[index]
        if isinstance(rows, range):
            return [self._fixed | changes for changes in self._changes(rows)]
        (changes,) = self._changes(range(rows, rows + 1))
        plant, phase = changes.pop("plant"), changes.pop("phase")
        scene = self.scene.replace(**changes)
        if plant in PLANTS:
            scene.timing()  # no plant simulates a longer delay
        return self._head | parameters_json(scene, plant, phase)

    def _changes(self, rows: range) -> list[Cell]:
        """Return the varied values of some cells."""
        pairs = zip(self.axes.values(), np.unravel_index(rows, self._shape), strict=True)
        columns = [[values[index] for index in indices.tolist()] for values, indices in pairs]
        return [dict(zip(self.axes, row)) for row in zip(*columns, strict=True)]


def run_scene_cells(cells: Sequence[Cell], text: str | None = None) -> list[dict[str, Any]]:
    """Return the figures of each cell, or {"error": ...} for a failed run, such as a divergence.

    Args:
        cells: Cells of one scene.
        text: Text of the scene's file; None for a scene of a package.

    Raises:
        ParameterError: If there is no such scene, or its file fails.
    """
    runs = [_run_of(dict(cell), text) for cell in cells]
    results = computed_together(runs, [(type(scene), plant) for scene, plant, _ in runs], _run_batch)
    with closing(OneDevice()) as make:
        done = [
            _run_single(run, text is not None, make) if figures is None else plain(figures)
            for run, figures in zip(runs, results, strict=True)
        ]
    for result, mark in zip(done, marks([scene for scene, _, _ in runs]), strict=True):
        judged = not mark.startswith(UNKNOWN)
        if mark and (judged or "error" not in result):
            both = [mark, result.get("warnings")] if judged else [result.get("warnings"), mark]
            result["warnings"] = ", ".join(filter(None, both))
    return done


def _run_of(cell: Cell, text: str | None) -> _Run:
    name, plant, phase = cell.pop("scene"), cell.pop("plant"), cell.pop("phase", 0.0)
    cell.pop("version")
    if text is None:
        return scene_from_reference(name.partition("@")[0], cell), plant, phase
    file, _, cls = name.partition("@")[0].rpartition(":")
    return object_of_text(text, cls, file).from_json(cell), plant, phase


def _run_batch(runs: Sequence[_Run]) -> Sequence[Mapping[str, Any] | None]:
    """Return the figures of runs of one class and plant in batches; None for those that need single runs."""
    cls, plant = type(runs[0][0]), runs[0][1]
    try:
        batch = figures_together([scene for scene, _, _ in runs], plant, [phase for _, _, phase in runs])
    except MaglevError:  # in any of them: its single run reports the error
        return [None] * len(runs)
    done = [index for index, figures in enumerate(batch) if figures is not None]
    # a user's law may mix devices, which its interface forbids: compare with two single runs
    for index in () if _is_ours(cls) else {*done[:1], *done[-1:]}:
        if not _same(batch[index], _run_single(runs[index], True)):
            return [None] * len(runs)
    return batch


def _same(figures: Mapping[str, Any] | None, single: Mapping[str, Any]) -> bool:
    """Return True if figures equal those of a single run, except for rounding."""
    if figures is None or figures.keys() != single.keys():
        return False
    numbers = {name: value for name, value in plain(figures).items() if name != "warnings"}
    pairs = [(np.array(value, float), np.array(single[name], float)) for name, value in numbers.items()]
    return all(a.shape == b.shape and np.allclose(a, b, 1e-6, 1e-12, equal_nan=True) for a, b in pairs)


def _run_single(run: _Run, catches: bool, make: OneDevice | None = None) -> dict[str, Any]:
    """Return the figures of one run, or its error; `catches` catches any error, as of user code."""
    scene, plant, phase = run
    try:
        figures: dict[str, Any] = plain(figures_of(scene, plant, phase, make))
        return figures
    except MaglevError as error:
        return {"error": str(error)}
    except Exception as error:
        if not catches:
            raise
        return {"error": f"{type(error).__name__}: {error}"}


def _name(cls: type[Scene]) -> str:
    """Return a scene's reference in cells, with a hash of its file unless it is in this package."""
    if _is_ours(cls):
        return reference_of(cls)
    reference = f"{Path(inspect.getfile(cls)).name}:{cls.__name__}" if _text(cls) else _import_path(cls)
    return f"{reference}@{hash_of_code(cls)}"


def _text(cls: type[Scene]) -> str | None:
    """Return a scene's text for workers; None for an installed package's scene, which they have."""
    if _is_ours(cls) or any(entry.value == _import_path(cls) for entry in installed_scenes()):
        return None
    return text_of(cls)


def _import_path(cls: type[Scene]) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _is_ours(cls: type[Scene]) -> bool:
    return cls.__module__.partition(".")[0] == "maglev_mj"


def value_of(cls: type[Scene], name: str, text: str) -> Any:
    """Return a parameter's value from its text.

    The parameter may be "plant", "phase" or "rate".

    Raises:
        ParameterError: If there is no such parameter, or the text is not of its kind.
    """
    _check_name(cls, name)
    if name == "plant":
        return text
    return parsed_number(name, text) if name in ("phase", "rate") else cls.parameter(name).from_text(text)


def _check_name(cls: type[Scene], name: str) -> None:
    names = ["plant", *(["phase"] if cls.takes_phase else []), *(one.name for one in cls.parameters()), "rate"]
    check_one_of(f"parameter of {cls.name}", names, name)
