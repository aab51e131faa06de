"""Results of a scene: figures, one run, many phases, variants side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.lazy import loaded
from maglev_mj.parameters import flag, number
from maglev_mj.pictures import save
from maglev_mj.plants.trace import Trace
from maglev_mj.result import Result, Table, number_text, plain
from maglev_mj.spec import RANGE, Spec

_MOST_SHOWN = 4
_SHARES = 50.0, 5.0, 95.0
_PREFIXES = {1e-3: "k", 1.0: "", 1e3: "m", 1e6: "µ"}
_STEP = 1e-3
_ROUNDING = 1.0 + 1e-9
_UNITS = {"time": "s", "position": "m", "velocity": "m/s", "force": "N", "z": "m", "target": "m", "stick_position": "m"}


@dataclass(frozen=True)
class Figure:
    """One figure of a run.

    Attributes:
        name: Its name.
        function: Function of a `RunResult` that returns a number, or a list of them; for a batch (..., N).
        unit: Unit in tables.
        help: Short description.
        scale: Factor from SI units to that unit.
        batched: True if the function takes a batch of devices at once, with the same bits as one by one.
        late: True if a missing figure counts as the largest in percentiles; otherwise it is left out.
        along: True if it is along the scene's axis, with the unit of a translation; see `unit_of`.

    Example:
        >>> from maglev_mj import find_scene, run
        >>> from maglev_mj.scenes.results import Figure
        >>> lowest = Figure("lowest", lambda result: result.motion(result.times())[0].min(), "m")
        >>> round(float(lowest.function(run(find_scene("drop")(duration=0.1), plant="exact"))), 4)  # [m]
        -0.0025
    """

    name: str
    function: Callable[[RunResult], Any]
    unit: str = ""
    help: str = ""
    scale: float = 1.0
    batched: bool = True
    late: bool = False
    along: bool = False

    def __post_init__(self) -> None:
        flag("batched", self.batched)
        flag("late", self.late)
        flag("along", self.along)

    def __call__(self, result: RunResult) -> Any:
        """Return the figure of a result."""
        return self.function(result)

    @property
    def si_unit(self) -> str:
        """SI unit of the function's values; empty if not known."""
        prefix = _PREFIXES.get(self.scale)
        return "" if prefix is None else self.unit.removeprefix(prefix)

    def text(self, value: Any, *bounds: Any) -> str:
        """Return one or several values, or a median with bounds.

        Bounds only if they differ.
        """
        values = np.atleast_1d(np.asarray(value, dtype=np.float64))
        if values.size > _MOST_SHOWN:
            return f"{self._number(values.min())} to {self._number(values.max())}"
        text = "/".join(self._number(one) for one in values)
        around = [self._number(bound) for bound in bounds]
        return f"{text} ({around[0]} to {around[1]})" if len(set(around)) > 1 else text

    def spread(self, values: Any, shares: Iterable[float] = _SHARES) -> str:
        """Return median and 5 to 95 %, or other percentiles, over phases.

        Several hits are pooled.
        """
        return self.text(*(self.percentile(np.ravel(values), share) for share in shares))

    def _number(self, value: float) -> str:
        return number_text(value * self.scale, 3, 2) if self.unit else number_text(value, 6)

    def percentile(self, values: Array, share: float) -> Array:
        """Return a percentile over the runs, the first dimension.

        Args:
            values: Figures of N runs, (N, ...).
            share: Percentile in per cent.
        """
        if self.late:
            late = np.where(np.isnan(values), np.inf, values)
            if np.isinf(np.percentile(late, share, method="higher")):
                return np.array(np.nan)
            # a missing figure keeps its rank without an effect on the interpolation
            return np.asarray(np.percentile(np.where(np.isinf(late), np.finfo(float).max, late), share))

        def finite_percentile(column: Array) -> float:
            finite = column[np.isfinite(column)]
            return float(np.percentile(finite, share)) if finite.size else np.nan

        return np.asarray(np.apply_along_axis(finite_percentile, 0, np.asarray(values, dtype=np.float64)))


def figure(
    unit: str = "",
    help: str = "",
    *,
    scale: float = 1.0,
    batched: bool = False,
    late: bool = False,
    along: bool = False,
) -> Callable[[Callable[[RunResult], Any]], Figure]:
    """Make a figure of a function; see `Figure`.

    Example:
        >>> from maglev_mj import figure, find_scene, run
        >>> @figure("mm", "lowest point", scale=1e3)
        ... def lowest(result):
        ...     return result.motion(result.times())[0].min()
        >>> round(float(lowest.function(run(find_scene("drop")(duration=0.1), plant="exact"))), 4)  # [m]
        -0.0025
    """

    def make(function: Callable[[RunResult], Any]) -> Figure:
        return Figure(function.__name__, function, unit, help, scale, batched, late, along)

    return make


@dataclass(frozen=True, eq=False)
class RunResult(Result):
    """Result of one run or of a batch.

    Attributes:
        scene: The scene.
        plant: Name of the plant.
        phase: Phase of the samples, a number or (N,).
        trace: The motion along all axes.
        sample_time: Time of each answered sample [s], (K,) or (K, N).
        samples: Law signals from each sample on, by name, (K, ...).

    Example:
        >>> from maglev_mj import find_scene, run
        >>> result = run(find_scene("drop")(duration=0.1), plant="exact")
        >>> position, velocity, force = result.motion(result.times())
        >>> round(float(position.min()), 4), round(float(force.max()), 1)  # [m], [N]
        (-0.0025, 95.6)
    """

    scene: Any
    plant: str
    phase: Any
    trace: Trace
    sample_time: Array
    samples: Mapping[str, Array]
    _known: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def line(self) -> Trace:
        """Motion along the scene's axis: the last dimension is 1."""
        return self.trace.along(AXES.index(self.scene.axis))

    @cached_property
    def figures(self) -> Mapping[str, Any]:
        """The scene's figures by name."""
        return {name: one(self) for name, one in self.scene.figures.items()}

    def once(self, name: str, make: Callable[[RunResult], Any]) -> Any:
        """Return a cached intermediate result of several figures."""
        if name not in self._known:
            self._known[name] = make(self)
        return self._known[name]

    def motion(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and force along the scene's axis.

        At times (M,), (M, ...) each.
        """
        pose, twist, wrench = self.line.at(time)
        return pose[..., 0], twist[..., 0], wrench[..., 0]

    def times(self, step: float = _STEP) -> Array:
        """Return a time grid over the run [s], (M,).

        Raises:
            ParameterError: If the step is not above 0, or the run is of several phases.
        """
        if np.ndim(self.phase):
            raise ParameterError(f"result must be of one phase, as result[0] is, not of {len(self.phase)}")
        count = math.floor(float(self.trace.time[-1]) / number("step", step, above=0.0) + 1e-9) + 1
        return np.arange(count, dtype=np.float64) * step

    def series(self, step: float = _STEP) -> dict[str, Array]:
        """Return time and the scene's series, by name.

        On a grid of `step` [s], (M,) each.
        """
        time = self.times(step)
        return {"time": time, **self.scene.series(self, time)}

    def columns(self) -> dict[str, Array]:
        """Return time and series every millisecond; see `times`."""
        return self.series()

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column the package knows."""
        return {name: unit_of(unit, self.scene.axis) for name, unit in _UNITS.items()}

    def plot(self, path: Path | None = None, picture: str | None = None) -> Any:
        """Draw the run as its scene does; see `Variants.plot`.

        Raises:
            ParameterError: If there is no such picture, or the run is of several phases.
        """
        self.times()  # several phases have no grid in common
        return Variants({self.scene.name: self}).plot(path, picture)

    def table(self) -> Table:
        """Return the figures and what exceeds the device; those of several phases as `Phases` does."""
        return self.over_phases().table() if np.ndim(self.phase) else Variants({self.scene.name: self}).table()

    def over_phases(self) -> Phases:
        """Return the figures at each phase, a batch of one for a single phase."""
        each = figures_of_each(self) if np.ndim(self.phase) else {name: [one] for name, one in self.figures.items()}
        figures = {name: np.asarray(values) for name, values in each.items()}
        furthest = self.trace.furthest().reshape(-1, len(AXES))
        return Phases(self.scene, self.plant, np.atleast_1d(self.phase), figures, furthest)

    def as_json(self) -> dict[str, Any]:
        """Return parameters, series every millisecond and figures, ready for JSON."""
        series = self.series()
        series["time"] = np.round(series["time"], 9)
        return {
            "parameters": parameters_json(self.scene, self.plant, self.phase),
            **plain(series),
            **self.scene.extra_json(self),
            "summary": plain(self.figures),
        }

    def __getitem__(self, device: Any) -> RunResult:
        """Return one device's run from a batch.

        An array of indices returns the runs of several devices.
        """
        scene = self.scene[device] if hasattr(type(self.scene), "__getitem__") else self.scene
        phase = self.phase[device]
        parts = (part[:, device] for part in (self.trace.time, self.trace.pose, self.trace.twist, self.trace.wrench))
        kept = {name: values[..., device] for name, values in self.samples.items()}
        time = self.sample_time[..., device] if self.sample_time.ndim > 1 else self.sample_time
        return RunResult(scene, self.plant, phase if np.ndim(phase) else float(phase), Trace(*parts), time, kept)


@dataclass(frozen=True, eq=False)
class Phases(Result):
    """Results of a scene at several phases.

    Attributes:
        scene: The scene.
        plant: Name of the plant.
        phases: The phases, (N,).
        figures: The scene's figures by name, (N, ...) each.
        furthest: Greatest distance from the centre on each axis [m, rad], (N, 6).

    Example:
        >>> from maglev_mj import find_scene, run_phases
        >>> phases = run_phases(find_scene("drop")(duration=0.1), 8, plant="exact")
        >>> round(float(phases.percentile(50.0)["penetration"]), 5)  # [m]
        0.00176
    """

    scene: Any
    plant: str
    phases: Array
    figures: Mapping[str, Array]
    furthest: Array

    def columns(self) -> dict[str, Array]:
        """Return phases and figures in SI units, (N,) each.

        A figure of several hits has a column for each hit.
        """
        columns = {"phase": self.phases}
        for name, values in self.figures.items():
            rows = values.reshape(len(self.phases), -1)
            names = [name] if values.ndim == 1 else [f"{name}.{index}" for index in range(rows.shape[1])]
            columns |= dict(zip(names, rows.T, strict=True))
        return columns

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        named: Mapping[str, Figure] = self.scene.figures
        units = {name: unit_of(one.si_unit, self.scene.axis, one.along) for name, one in named.items()}
        return {column: units[column.partition(".")[0]] for column in self.columns() if column != "phase"}

    def plot(self, path: Path | None = None) -> Any:
        """Draw each figure over the phase; see `Result.plot`.

        Raises:
            ParameterError: If the scene has no figures.
        """
        from maglev_mj.scenes.pictures import spread

        return save(spread(Variants({}, {self.scene.name: self})), path)

    def table(self) -> Table:
        """Return median and 5 to 95 % of each figure."""
        return Variants({}, {self.scene.name: self}).table()

    def percentile(self, share: float) -> dict[str, Array]:
        """Return a percentile of each figure over the phases.

        Args:
            share: Percentile, 0 to 100.

        Raises:
            ParameterError: If it is outside its bounds.
        """
        number("share", share, at_least=0.0, at_most=100.0)
        named: Mapping[str, Figure] = self.scene.figures
        return {name: named[name].percentile(values, share) for name, values in self.figures.items()}

    def as_json(self) -> dict[str, Any]:
        """Return the figures at each phase, ready for JSON.

        Their median, 5th and 95th percentile are included.
        """
        rows = [{name: values[place] for name, values in self.figures.items()} for place in range(len(self.phases))]
        settled = self.figures.get("settling_time")
        return {
            **({} if settled is None else {"settled": int(np.isfinite(settled).sum())}),
            "phases": [{"phase": float(phase), **plain(row)} for phase, row in zip(self.phases, rows, strict=True)],
            "median": plain(self.percentile(50.0)),
            "percentile_5": plain(self.percentile(5.0)),
            "percentile_95": plain(self.percentile(95.0)),
        }


@dataclass(frozen=True, eq=False)
class Variants(Result):
    """Runs of a scene and of its variants, side by side.

    Attributes:
        runs: Run for each label, the scene itself first; empty for phases alone.
        phases: Their figures at many phases; may be empty.
        bands: Their motion at many phases, which pictures show around the runs; may be empty.
        gap: Largest distance between the two plants in the first run [m, rad]; None if not compared.
    """

    runs: Mapping[str, RunResult]
    phases: Mapping[str, Phases] = field(default_factory=dict)
    bands: Mapping[str, RunResult] = field(default_factory=dict)
    gap: float | None = None

    @property
    def first(self) -> Any:
        """Run of the scene itself, or its phases if it was not run alone."""
        return next(iter((self.runs or self.phases).values()))

    @property
    def pictures(self) -> Mapping[str, str]:
        """Pictures by file name without ending, each the function that draws it as "module:function"."""
        scene = self.first.scene
        general = {scene.name: "maglev_mj.scenes.pictures:series"} if self.runs else {}
        if self.phases and scene.figures:
            general[f"{scene.name}_phases"] = "maglev_mj.scenes.pictures:spread"
        return scene.plots or general

    def columns(self) -> dict[str, Array]:
        """Return the columns of the scene itself."""
        columns: dict[str, Array] = self.first.columns()
        return columns

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        units: Mapping[str, str] = self.first.units
        return units

    def as_json(self) -> dict[str, Any]:
        """Return the run of the scene itself and its phases, ready for JSON."""
        phases = [{"sweep": one.as_json()} for one in self.phases.values()]
        return {**(self.first.as_json() if self.runs else {}), **(phases[0] if phases else {})}

    def plot(self, path: Path | None = None, picture: str | None = None) -> Any:
        """Draw the runs, or their phases; see `Result.plot`.

        Args:
            path: File to write; None to return the figure.
            picture: One of `pictures` by name; the first by default.

        Raises:
            ParameterError: If there is no such picture.
        """
        names = self.pictures
        chosen = next(iter(names)) if picture is None else picture
        check_one_of("picture", names, chosen)
        return save(loaded(names[chosen])(self), path)

    def table(self) -> Table:
        """Return the figures of each run, their spread over the phases, and what exceeds the device."""
        scene = self.first.scene
        runs: dict[str, Mapping[str, Any]] = {label: one.figures for label, one in self.runs.items()}
        runs |= scene.compared(self.first) if runs else {}
        spreads = {label: one.figures for label, one in self.phases.items()}
        over = f"median (5 to 95 %) over {len(next(iter(self.phases.values())).phases)} phases" if spreads else ""
        at = f"phase {self.first.phase:g}" if runs and scene.takes_phase else ""
        where = ", ".join(filter(None, [f"plant {self.first.plant}", at if runs else over]))
        title = f"{scene.title or scene.name}, {where}: {', '.join(_parameter_texts(scene))}"
        note = "\n".join(self._remarks())
        if not runs:
            return _figures_table(title, scene, spreads, Figure.spread)._replace(note=note)
        table = _figures_table(title, scene, runs, Figure.text)
        if not spreads:
            return table._replace(note=note)
        return table._replace(
            below=[_figures_table(over, scene, spreads, Figure.spread, brief=True)._replace(note=note)]
        )

    def _remarks(self) -> Iterator[str]:
        """Yield a line for each rank, missing figure and excess over the device's limits."""
        yield from self._rank()
        yield from self._missing()
        yield from self._beyond_force()
        yield from self._beyond_range()
        if self.gap is not None:
            yield f"MuJoCo and the exact plant differ by at most {self.gap:.1e} {unit_of('m', self.first.scene.axis)}"

    def _rank(self) -> Iterator[str]:
        """Yield the rank of the first run among its phases; one phase alone says little."""
        for label, name in zip([one for one in self.runs if one in self.phases], list(self.first.scene.figures)[:1]):
            if (values := self.phases[label].figures[name]).ndim == 1:
                share = 100.0 * share_below(values, self.runs[label].figures[name])
                yield f"{label}: {name.replace('_', ' ')} above that of {share:.0f} % of the phases"

    def _missing(self) -> Iterator[str]:
        """Yield a line for each figure missing at some phases."""
        for label, one in self.phases.items():
            for name, values in one.figures.items():
                there = int(np.isfinite(values).reshape(len(values), -1).all(axis=1).sum())
                if there < len(values):
                    yield f"{label}: {name.replace('_', ' ')} is there at {there} of {len(values)} phases"

    def _beyond_force(self) -> Iterator[str]:
        """Yield any line on vertical forces beyond the device's."""
        most = Spec.largest_vertical_force.value
        # the last knot's force has not acted yet
        peaks = {label: float(np.abs(one.trace.wrench[:-1, 2]).max(initial=0.0)) for label, one in self.runs.items()}
        beyond = [f"{label} {peak:.3g}" for label, peak in peaks.items() if peak > most * _ROUNDING]
        if beyond:
            yield f"Above the device's {most:g} N (z): {', '.join(beyond)}"

    def _beyond_range(self) -> Iterator[str]:
        """Yield any line on motions beyond the device's range."""
        texts, limits, left = [], np.array(RANGE), np.zeros(len(RANGE))
        for label in dict.fromkeys([*self.runs, *self.phases]):
            alone = [self.runs[label].trace.furthest()] if label in self.runs else []
            swept = self.phases[label].furthest if label in self.phases else np.empty((0, len(RANGE)))
            furthest = np.vstack([*alone, swept])
            outside = np.where(furthest > limits * _ROUNDING, furthest, 0.0)
            if outside.any():
                left = np.where(outside.any(axis=0), limits, left)
                phases = int(outside[len(alone) :].any(axis=1).sum())
                count = f" ({phases} of {len(swept)} phases)" if phases else ""
                texts.append(f"{label} {_distances(outside.max(axis=0))}{count}")
        if texts:
            yield f"Beyond the range of {_distances(left)}: {', '.join(texts)}"


def _figures_table(
    title: str,
    scene: Any,
    figures: Mapping[str, Mapping[str, Any]],
    show: Callable[[Figure, Any], str],
    *,
    brief: bool = False,
) -> Table:
    """Return a row for each figure, and its meaning beside the column of a single label."""
    named: Mapping[str, Figure] = scene.figures
    meaning = len(figures) == 1 and not brief
    rows = [
        (
            name.replace("_", " "),
            *(show(one, values.get(name, math.nan)) for values in figures.values()),
            unit_of(one.unit, scene.axis, one.along),
            *([one.help] if meaning else []),
        )
        for name, one in named.items()
    ]
    return Table(title, ("figure", *figures, "unit", *(["meaning"] if meaning else [])), rows)


def _parameter_texts(scene: Any) -> list[str]:
    """Return rate, delay and parameters with their units."""
    texts = [f"{1.0 / scene.period:g} Hz", f"delay {scene.delay * 1e3:g} ms"]
    for one in scene.parameters():
        value = getattr(scene, one.name)
        if one.name in ("period", "delay") or one.kind in (object, bool) or value is None:
            continue
        text = f"{value:.6g}" if one.kind in (int, float) else str(value)
        texts.append(f"{one.name.replace('_', ' ')} {text} {unit_of(one.unit, scene.axis, one.along)}".rstrip())
    return texts


def _distances(furthest: Array) -> str:
    """Return the largest nonzero translation and rotation with units."""
    parts = [(furthest[:3].max() * 1e3, "mm"), (np.degrees(furthest[3:].max()), "deg")]
    return " and ".join(f"{value:.4g} {unit}" for value, unit in parts if value > 0.0)


def share_below(values: Array, value: float) -> float:
    """Return the share of values below another, but for the rounding of two plants."""
    return float(np.mean(values < value - 1e-9))


def parameters_json(scene: Any, plant: str, phase: Any) -> dict[str, Any]:
    """Return run and scene parameters, ready for JSON."""
    head: dict[str, Any] = {"plant": plant}
    if scene.takes_phase:
        head["phase"] = phase
    return {**head, **scene.as_json()}


def figures_of_each(result: RunResult) -> dict[str, Array | list[Any]]:
    """Return the figures of N devices by name, N of each.

    Figures that accept a batch are computed at once, the others device by device.
    """
    named: Mapping[str, Figure] = result.scene.figures
    devices = [] if all(one.batched for one in named.values()) else [result[k] for k in range(np.size(result.phase))]
    return {
        name: np.asarray(one(result)) if one.batched else [one(device) for device in devices]
        for name, one in named.items()
    }
