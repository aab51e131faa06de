"""Results of a scene: figures, one run, many sampling phases, variants side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError, check_instance
from maglev_mj.frames import AXES, Array, distances, unit_of
from maglev_mj.keywords import checked
from maglev_mj.lazy import loaded
from maglev_mj.parameters import flag, number
from maglev_mj.plants.limits import LIMITS, excess_of, peaks_of, verdicts
from maglev_mj.plants.trace import Trace
from maglev_mj.result import Result, Table, capitalised, conditions_text, number_text, plain

_MOST_SHOWN = 4
_FAR = 1.1  # ranges, from which a run is outside: a wall at the end of the range yields
_SHARES = 50.0, 5.0, 95.0
_PREFIXES = {1e-3: "k", 1.0: "", 1e3: "m", 1e6: "µ"}
_STEP = 1e-3
_UNITS = {"time": "s", "position": "m", "velocity": "m/s", "force": "N", "z": "m", "target": "m", "stick_position": "m"}
_HEADS = {"final_z": "final height"}


@dataclass(frozen=True)
class Figure:
    """One figure of a run.

    Attributes:
        name: Key in JSON.
        function: Function of a `RunResult` that returns a number, or a list of them; for a batch (..., N).
        unit: Unit in tables.
        help: Short description.
        scale: Factor from SI units to that unit.
        batched: True if the function accepts a batch of devices, with results equal to the last bit.
        nan_is_largest: True if NaN counts as the largest value in percentiles; otherwise it is ignored.
        along: True for a figure along the scene's axis: the unit is that of a translation; see `unit_of`.
        missing: Meaning of NaN, for charts.

    Example:
        >>> from maglev_mj import find_scene, run
        >>> from maglev_mj.scenes.results import Figure
        >>> lowest = Figure("lowest", lambda result: result.motion(result.times())[0].min(), "m")
        >>> round(float(lowest.function(run(find_scene("drop")(duration=0.1), plant="exact"))), 4)  # [m]
        -0.003
    """

    name: str
    function: Callable[[RunResult], Any]
    unit: str = ""
    help: str = ""
    scale: float = 1.0
    batched: bool = True
    nan_is_largest: bool = False
    along: bool = False
    missing: str = "no value"

    def __post_init__(self) -> None:
        flag("batched", self.batched)
        flag("nan_is_largest", self.nan_is_largest)
        flag("along", self.along)

    def __call__(self, result: RunResult) -> Any:
        """Return the figure of a result."""
        return self.function(result)

    @property
    def si_unit(self) -> str:
        """SI unit of the function's values; empty for a scale that is not a power of 1000."""
        prefix = _PREFIXES.get(self.scale)
        return "" if prefix is None else self.unit.removeprefix(prefix)

    def text(self, value: Any, *bounds: Any) -> str:
        """Return one or several values, or a median with bounds if they differ."""
        values = np.atleast_1d(np.asarray(value, dtype=np.float64))
        if values.size > _MOST_SHOWN:
            return f"{self._number(values.min())} to {self._number(values.max())}"
        text = "/".join(self._number(x) for x in values)
        ends = [self._number(bound) for bound in bounds]
        return f"{text} ({ends[0]} to {ends[1]})" if len(set(ends)) > 1 else text

    def spread(self, values: Any, shares: Iterable[float] = _SHARES) -> str:
        """Return the median with 5th and 95th percentile, or other percentiles; several hits are pooled."""
        return self.text(*(self.percentile(np.ravel(values), share) for share in shares))

    def _number(self, value: float) -> str:
        return number_text(value * self.scale, 3, 2) if self.unit else number_text(value, 6)

    def percentile(self, values: Array, share: float) -> Array:
        """Return a percentile over the runs, the first dimension.

        Args:
            values: Figures of N runs, (N, ...).
            share: Percentile, 0 to 100.
        """
        if self.nan_is_largest:
            ranked = np.where(np.isnan(values), np.inf, values)
            if np.isinf(np.percentile(ranked, share, method="higher")):
                return np.array(np.nan)
            # finite, because infinity would make the interpolation NaN
            return np.asarray(np.percentile(np.where(np.isinf(ranked), np.finfo(float).max, ranked), share))

        def finite_percentile(column: Array) -> float:
            finite = column[np.isfinite(column)]
            return float(np.percentile(finite, share)) if finite.size else np.nan

        return np.asarray(np.apply_along_axis(finite_percentile, 0, np.asarray(values, dtype=np.float64)))


@checked
def figure(
    unit: str = "",
    help: str = "",
    *,
    scale: float = 1.0,
    batched: bool = False,
    nan_is_largest: bool = False,
    along: bool = False,
) -> Callable[[Callable[[RunResult], Any]], Figure]:
    """Return a decorator that makes a `Figure` from a function.

    Example:
        >>> from maglev_mj import figure, find_scene, run
        >>> @figure("mm", "lowest point", scale=1e3)
        ... def lowest(result):
        ...     return result.motion(result.times())[0].min()
        >>> round(float(lowest.function(run(find_scene("drop")(duration=0.1), plant="exact"))), 4)  # [m]
        -0.003
    """

    def make(function: Callable[[RunResult], Any]) -> Figure:
        check_instance("function", function, Callable, "a function of a RunResult")
        return Figure(function.__name__, function, unit, help, scale, batched, nan_is_largest, along)

    return make


@checked
@dataclass(frozen=True, eq=False)
class RunResult(Result):
    """Result of one run, or of a batch of N devices.

    Attributes:
        scene: The scene.
        plant: Name of the plant.
        phase: Sampling phase, a number or (N,).
        trace: Motion on all axes.
        sample_time: Time of each sample with a command [s], (K,) or (K, N).
        samples: Law signals after each sample, by name, (K, ...).

    Example:
        >>> from maglev_mj import find_scene, run
        >>> result = run(find_scene("drop")(duration=0.1), plant="exact")
        >>> position, velocity, force = result.motion(result.times())
        >>> round(float(position.min()), 4), round(float(force.max()), 1)  # [m], [N]
        (-0.003, 60.0)
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
        """Motion along the scene's axis; the last dimension is 1."""
        return self.trace.along(AXES.index(self.scene.axis))

    @cached_property
    def figures(self) -> Mapping[str, Any]:
        """The scene's figures by name."""
        return {name: figure(self) for name, figure in self.scene.figures.items()}

    def once(self, name: str, make: Callable[[RunResult], Any]) -> Any:
        """Return an intermediate result shared by several figures, computed once."""
        if name not in self._known:
            self._known[name] = make(self)
        return self._known[name]

    def motion(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and force along the scene's axis at times (M,), (M, ...) each."""
        pose, twist, wrench = self.line.at(time)
        return pose[..., 0], twist[..., 0], wrench[..., 0]

    def times(self, step: float = _STEP) -> Array:
        """Return a time grid over the run [s], (M,).

        Raises:
            ParameterError: If the step is not above 0, or the result is a batch.
        """
        if np.ndim(self.phase):
            raise ParameterError(f"result must be of one sampling phase, such as result[0] (got {len(self.phase)})")
        count = math.floor(float(self.trace.time[-1]) / number("step", step, above=0.0) + 1e-9) + 1
        return np.arange(count, dtype=np.float64) * step

    def series(self, step: float = _STEP) -> dict[str, Array]:
        """Return time and the scene's series by name on a grid of `step` [s], (M,) each."""
        time = self.times(step)
        return {"time": time, **self.scene.series(self, time)}

    def columns(self) -> dict[str, Array]:
        """Return time and series every millisecond; see `times`."""
        return self.series()

    @property
    def units(self) -> dict[str, str]:
        """Unit of each predefined column."""
        return {name: unit_of(unit, self.scene.axis) for name, unit in _UNITS.items()}

    @property
    def pictures(self) -> Mapping[str, str]:
        """Plots of the scene; see `Result`."""
        self.times()  # raises for a batch, whose runs share no time grid
        return self._shown.pictures

    def _draw(self, function: Callable[..., Any]) -> Any:
        return function(self._shown)

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return self._shown.conditions

    def table(self) -> Table:
        """Return the figures; for a batch, the table of its `Phases`."""
        return self._shown.table()

    def _headline(self) -> str:
        return self._shown.headline

    @property
    def warnings(self) -> Sequence[str]:
        """See `Result`."""
        return self._shown.warnings

    @cached_property
    def _shown(self) -> Phases | Variants:
        return self.over_phases() if np.ndim(self.phase) else Variants({self.scene.name: self})

    @cached_property
    def peaks(self) -> Array:
        """Peaks of each device, see `peaks_of`, (N, 7); a single run has one row."""
        return np.atleast_2d(peaks_of(self.trace))

    def verdicts(self) -> list[str]:
        """Return what each device exceeds, such as "peak force above limit, motion out of range"; empty for nothing."""
        return verdicts(excess_of(self.peaks, self.scene.body))

    def over_phases(self) -> Phases:
        """Return the figures at each phase; a single run has one phase."""
        each = figures_of_each(self) if np.ndim(self.phase) else {name: [x] for name, x in self.figures.items()}
        figures = {name: np.asarray(values) for name, values in each.items()}
        return Phases(self.scene, self.plant, np.atleast_1d(self.phase), figures, self.peaks)

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
        """Return one device's run from a batch, or a batch for an array of indices."""
        scene = self.scene[device] if hasattr(type(self.scene), "__getitem__") else self.scene
        phase = self.phase[device]
        parts = (part[:, device] for part in (self.trace.time, self.trace.pose, self.trace.twist, self.trace.wrench))
        samples = {name: values[..., device] for name, values in self.samples.items()}
        time = self.sample_time[..., device] if self.sample_time.ndim > 1 else self.sample_time
        return RunResult(scene, self.plant, phase if np.ndim(phase) else float(phase), Trace(*parts), time, samples)


@checked
@dataclass(frozen=True, eq=False)
class Phases(Result):
    """Results of a scene at several sampling phases.

    Attributes:
        scene: The scene.
        plant: Name of the plant.
        phases: Sampling phases, (N,).
        figures: The scene's figures by name, (N, ...) each.
        peaks: Largest force along z [N] and distance from the centre on each axis [m, rad], (N, 7).

    Example:
        >>> from maglev_mj import find_scene, run_phases
        >>> phases = run_phases(find_scene("drop")(duration=0.1), 8, plant="exact")
        >>> round(float(phases.percentile(50.0)["penetration"]), 5)  # [m]
        0.00213
    """

    scene: Any
    plant: str
    phases: Array
    figures: Mapping[str, Array]
    peaks: Array

    def columns(self) -> dict[str, Array]:
        """Return phases and figures in SI units, (N,) each; a figure of several hits has a column per hit."""
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
        units = {name: unit_of(figure.si_unit, self.scene.axis, figure.along) for name, figure in named.items()}
        return {column: units[column.partition(".")[0]] for column in self.columns() if column != "phase"}

    @property
    def pictures(self) -> Mapping[str, str]:
        """See `Result`."""
        return {f"{self.scene.name}_phases": "maglev_mj.scenes.pictures:spread"}

    def _draw(self, function: Callable[..., Any]) -> Any:
        return function(self._alone)

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return self._alone.conditions

    def table(self) -> Table:
        """Return median, 5th and 95th percentile of each figure."""
        return self._alone.table()

    def _headline(self) -> str:
        return self._alone.headline

    @property
    def warnings(self) -> Sequence[str]:
        """See `Result`."""
        return self._alone.warnings

    @property
    def _alone(self) -> Variants:
        return Variants({}, {self.scene.name: self})

    @property
    def ended(self) -> str:
        """How a run ended whose figures say nothing, in words: "diverged", or far outside the range; empty for none."""
        escape = np.repeat(self.scene.device_options().get("escape", (self.scene.hardware.escape, 1.0)), 3)
        if not bool((self.peaks[:, 1:] <= escape).all()):  # NaN too
            return "diverged"
        far = _FAR * np.array(self.scene.body.range)
        return "left the range of motion" if bool((self.peaks[:, 1:] > far).any()) else ""

    def percentile(self, share: float) -> dict[str, Array]:
        """Return a percentile of each figure over the sampling phases.

        Args:
            share: Percentile, 0 to 100.

        Raises:
            ParameterError: If it is outside its bounds.
        """
        number("share", share, at_least=0.0, at_most=100.0)
        named: Mapping[str, Figure] = self.scene.figures
        return {name: named[name].percentile(values, share) for name, values in self.figures.items()}

    def spreads(self) -> list[str]:
        """Return the extremes of each figure that differs between the phases; of several hits, the least alike."""
        texts = []
        for name, values in self.figures.items():
            figure, columns = self.scene.figures[name], values.reshape(len(values), -1).astype(np.float64)
            ends = np.array([np.fmin.reduce(columns), np.fmax.reduce(columns)])
            with np.errstate(invalid="ignore"):  # of infinite figures
                low, high = ends[:, np.argmax(np.nan_to_num(ends[1] - ends[0]))]
            if (first := figure.text(low)) != (last := figure.text(high)):
                unit = unit_of(figure.unit, self.scene.axis, figure.along)
                texts.append(f"{figure_head(name)} {first} to {last} {unit}".rstrip())
        return texts

    def as_json(self) -> dict[str, Any]:
        """Return the figures at each phase with their median, 5th and 95th percentile, ready for JSON."""
        rows = [{name: values[index] for name, values in self.figures.items()} for index in range(len(self.phases))]
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
    """Runs of a scene and its variants, side by side.

    Attributes:
        runs: Run for each label, the scene itself first; empty for phases alone.
        phases: Figures at many sampling phases by label; may be empty.
        bands: Motion at many sampling phases by label, drawn around the runs; may be empty.
        gap: Maximum deviation between the two plants in the first run [m, rad]; None if not compared.
        chaotic: Warnings about chaotic runs, with the spread of their figures.
    """

    runs: Mapping[str, RunResult]
    phases: Mapping[str, Phases] = field(default_factory=dict)
    bands: Mapping[str, RunResult] = field(default_factory=dict)
    gap: float | None = None
    chaotic: Sequence[str] = ()

    @property
    def first(self) -> Any:
        """Run of the scene itself, or its phases without a single run."""
        return next(iter((self.runs or self.phases).values()))

    def _headline(self) -> str:
        scene = self.first.scene
        on = f" on {scene.stiffness:g} {unit_of('N/m', scene.axis)}" if hasattr(type(scene), "wall") else ""
        every = self.phases or {label: result.over_phases() for label, result in self.runs.items()}
        ended = {label.partition(" (")[0]: phases.ended for label, phases in every.items() if phases.ended}
        each = {label: phases for label, phases in every.items() if not phases.ended}
        finding = [self._finding(each)] if each else []
        for words in dict.fromkeys(ended.values()):
            finding.append(f"{' and '.join(label for label in ended if ended[label] == words)} " * bool(each) + words)
        return f"{capitalised(scene.name)}{on}: {'; '.join(finding)}"

    def _finding(self, each: Mapping[str, Phases]) -> str:
        """Return the figures of runs in words: the first that differs between them, or some of one run."""
        scene, texts = self.first.scene, list[str]()
        over = f", median of {len(next(iter(each.values())).phases)} phases" if self.phases else ""
        for name, one in scene.figures.items():
            medians = [(float(one.percentile(np.ravel(x.figures[name]), 50.0)), label) for label, x in each.items()]
            ranked = [median for median in sorted(medians) if math.isfinite(median[0])]
            values = [f"{one.text(x)} {unit_of(one.unit, scene.axis, one.along)}".rstrip() for x, _ in ranked]
            texts += [f"{figure_head(name)} {value}" for value in values[:1]]
            if len(ranked) > 1:
                least, most = (label.partition(" (")[0] for _, label in (ranked[0], ranked[-1]))
                return f"{texts[-1]} ({least}) to {values[-1]} ({most}){over}"
        reach = distances(np.vstack([phases.peaks for phases in each.values()]).max(axis=0)[1:])
        motion = f"moves up to {reach} from the centre" if reach != "0 mm" else "nothing moves"
        return f"{', '.join(texts[:3]) or motion}{over}"

    @property
    def conditions(self) -> str:
        """See `Result`; parameters that differ between the runs are left out."""
        scenes = [one.scene for one in (self.runs or self.phases).values()]
        names = [one.name for one in scenes[0].parameters()]
        each = {name: [getattr(one, name, None) for one in scenes] for name in names}
        over = {name: values for name, values in each.items() if any(value != values[0] for value in values)}
        return scene_conditions(scenes[0], f"plant {self.first.plant}", over)

    @property
    def pictures(self) -> Mapping[str, str]:
        """Drawing functions as "module:function", by file name without suffix."""
        scene = self.first.scene
        general = {scene.name: "maglev_mj.scenes.pictures:series"} if self.runs else {}
        if self.phases and scene.figures:
            general[f"{scene.name}_phases"] = "maglev_mj.scenes.pictures:spread"
        return scene.plots or general

    def columns(self) -> dict[str, Array]:
        """Return the columns of the first run."""
        columns: dict[str, Array] = self.first.columns()
        return columns

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        units: Mapping[str, str] = self.first.units
        return units

    def as_json(self) -> dict[str, Any]:
        """Return the first run and its phases, ready for JSON."""
        phases = [{"sweep": swept.as_json()} for swept in self.phases.values()]
        return {**(self.first.as_json() if self.runs else {}), **(phases[0] if phases else {})}

    def table(self) -> Table:
        """Return the figures of each run and their spread over the phases."""
        scene = self.first.scene
        runs: dict[str, Mapping[str, Any]] = {label: result.figures for label, result in self.runs.items()}
        runs |= scene.compared(self.first) if runs else {}
        spreads = {label: swept.figures for label, swept in self.phases.items()}
        over = f"median (5 to 95 %) over {len(next(iter(self.phases.values())).phases)} phases" if spreads else ""
        at = f"phase {self.first.phase:g}" if runs and scene.takes_phase else ""
        plant = ", ".join(filter(None, [f"plant {self.first.plant}", at if runs else over]))
        title = f"{scene.title or scene.name}, {plant}: {', '.join(parameter_texts(scene))}"
        note, warnings = "\n".join(self._remarks()), self.warnings
        if not runs:
            return _figures_table(title, scene, spreads, Figure.spread)._replace(note=note, warnings=warnings)
        table = _figures_table(title, scene, runs, Figure.text)._replace(warnings=warnings)
        if not spreads:
            return table._replace(note=note)
        spread = _figures_table(over, scene, spreads, Figure.spread, brief=True)
        return table._replace(below=[spread._replace(note=note)])

    def _remarks(self) -> Iterator[str]:
        yield from self._rank()
        yield from self._missing()
        if self.gap is not None:
            yield f"max. deviation, MuJoCo vs exact plant: {self.gap:.1e} {unit_of('m', self.first.scene.axis)}"

    def _rank(self) -> Iterator[str]:
        for label, name in zip([x for x in self.runs if x in self.phases], list(self.first.scene.figures)[:1]):
            if (values := self.phases[label].figures[name]).ndim == 1:
                rank = rank_text(values, self.runs[label].figures[name])
                yield f"{label}: {figure_head(name)} at phase {self.runs[label].phase:g} {rank} of the phases"

    def _missing(self) -> Iterator[str]:
        for label, swept in self.phases.items():
            for name, values in swept.figures.items():
                count = int(np.isfinite(values).reshape(len(values), -1).all(axis=1).sum())
                if count < len(values):
                    yield f"{label}: {figure_head(name)} defined at {count} of {len(values)} phases"

    @cached_property
    def warnings(self) -> Sequence[str]:
        """See `Result`."""
        check, labels = loaded("maglev_mj.scenes.stability_check:stability_warning"), dict[str | None, list[str]]()
        for label in dict.fromkeys([*self.runs, *self.phases]):
            scene = (self.runs[label] if label in self.runs else self.phases[label]).scene
            labels.setdefault(check(scene), []).append(label)
        several = len(labels) > 1
        unstable = [f"{', '.join(names)}: " * several + text for text, names in labels.items() if text]
        traces = [result.trace for result in self.runs.values()]
        still = traces and not any(trace.twist.any() or trace.wrench.any() for trace in traces)
        idle = [f"{self.first.scene.name}: nothing moves, as no force acts: the device has no gravity"] if still else []
        return [*idle, *unstable, *self._excesses(), *self.chaotic]

    def _excesses(self) -> Iterator[str]:
        """Yield a warning for each limit of the device that a run exceeds."""
        scene, rows = self.first.scene, dict[str, tuple[Array, Array]]()
        for label in dict.fromkeys([*self.runs, *self.phases]):
            parts = [group[label].peaks if label in group else np.empty((0, 7)) for group in (self.runs, self.phases)]
            rows[label] = excess_of(parts[0], scene.body), excess_of(parts[1], scene.body)
        largest = np.vstack([*chain(*rows.values())]).max(axis=0)
        texts = {"axis": "" if scene.axis == "z" else " along z"}
        if hasattr(scene, "force_limit"):
            texts["remedy"] = f"; --force-limit {scene.body.force_limit:.4g} applies it"
        for limit in LIMITS:
            runs = []
            for label, (alone, swept) in rows.items():
                if (most := np.vstack([alone, swept])[:, limit.part].max(axis=0)).any():
                    count = int(swept[:, limit.part].any(axis=1).sum())
                    runs.append(f"{label} {limit.text(most, 4)}" + f" ({count} of {len(swept)} phases)" * (count > 0))
            if runs:
                yield limit.warning(largest, scene.body, runs=", ".join(runs), **texts)


def _figures_table(
    title: str,
    scene: Any,
    figures: Mapping[str, Mapping[str, Any]],
    show: Callable[[Figure, Any], str],
    *,
    brief: bool = False,
) -> Table:
    """Return a row for each figure, with its meaning if there is a single label."""
    named: Mapping[str, Figure] = scene.figures
    meaning = len(figures) == 1 and not brief
    rows = [
        (
            figure_head(name),
            *(show(figure, values.get(name, math.nan)) for values in figures.values()),
            unit_of(figure.unit, scene.axis, figure.along),
            *([figure.help] if meaning else []),
        )
        for name, figure in named.items()
    ]
    return Table(title, ("figure", *figures, "unit", *(["meaning"] if meaning else [])), rows)


_SCALED = "s", "m", "m/s", "rad", "rad/s"
"""Units of parameters that are written with a prefix if small."""
_MILLI, _MICRO = 0.1, 1e-4


def scene_conditions(scene: Any, plant: str, over: Mapping[str, Sequence[Any]] = {}) -> str:
    """Return scene, axis, rate, delay, plant and parameters in words; see `conditions_text`.

    Args:
        scene: The scene.
        plant: Plant in words; empty for none.
        over: Values of parameters that differ between runs, by name.
    """
    own = {name: over.get(name, [getattr(scene, name)]) for name in ("axis", "period", "delay")}
    texts = parameter_texts(scene, without={*own, *over}, brief=True)
    return conditions_text(scene.name, own["axis"], own["period"], own["delay"], plant, *texts)


def _matters(scene: Any, parameter: Any, value: Any) -> bool:
    """Return False for a parameter that is off, as a pulse of 0 with its width, or for a choice that is the default."""
    if parameter.name.startswith("pulse_") and not getattr(scene, "pulse", 1.0):
        return False
    return bool(value) and not (parameter.kind is str and value == parameter.default)


def parameter_texts(scene: Any, *, without: Collection[str] = (), brief: bool = False) -> list[str]:
    """Return rate, delay and parameters with their units, `without` some by name; if `brief`, those in effect."""
    texts = [] if "period" in without else [f"{1.0 / scene.period:g} Hz"]
    texts += [] if "delay" in without else [f"delay {scene.delay * 1e3:g} ms"]
    for parameter in scene.parameters():
        name, value = parameter.name, getattr(scene, parameter.name)
        value = float(scene.body.inertia[2]) if name == "mass" else value  # of the device in use
        if name in ("period", "delay", *without) or parameter.kind in (object, bool) or value is None:
            continue
        if name == "force_limit" and not value:  # "0 N" would read as no force
            texts.append("no force limit")
            continue
        if brief and not _matters(scene, parameter, value):
            continue
        if name == "device" and hasattr(scene, "hardware"):
            texts += [] if scene.hardware.published else [f"device {scene.hardware.name}"]
            continue
        unit = unit_of(parameter.unit, scene.axis, parameter.along)
        if parameter.kind in (int, float):
            factor, unit = prefixed(unit, abs(value))
            value = factor * value
        text = f"{value:.5g}" if parameter.kind in (int, float) else str(value)
        texts.append(f"{name.replace('_', ' ')} {text} {unit}".rstrip())
    return texts


def prefixed(unit: str, largest: float) -> tuple[float, str]:
    """Return the factor and prefixed unit in which a parameter is written, by its largest magnitude."""
    if unit not in _SCALED or not 0.0 < largest < _MILLI:
        return 1.0, unit
    return (1e3, f"m{unit}") if largest >= _MICRO else (1e6, f"µ{unit}")


def figure_head(name: str) -> str:
    """Return the name of a figure in tables and pictures."""
    return _HEADS.get(name, name.replace("_", " "))


def share_below(values: Array, value: float) -> float:
    """Return the fraction of values below another by more than the rounding between plants."""
    return float(np.mean(values < value - 1e-9))


def rank_text(values: Array, value: float) -> str:
    """Return the share of values below another, such as "exceeds 94 %"."""
    return f"exceeds {100.0 * share_below(values, value):.0f} %"


def parameters_json(scene: Any, plant: str, phase: Any) -> dict[str, Any]:
    """Return parameters of the run and the scene, ready for JSON."""
    head: dict[str, Any] = {"plant": plant}
    if scene.takes_phase:
        head["phase"] = phase
    return {**head, **scene.as_json()}


def figures_of_each(result: RunResult) -> dict[str, Array | list[Any]]:
    """Return the figures of N devices by name, N each, as a batch where a figure accepts one."""
    named: Mapping[str, Figure] = result.scene.figures
    batched = all(figure.batched for figure in named.values())
    devices = [] if batched else [result[k] for k in range(np.size(result.phase))]
    return {
        name: np.asarray(figure(result)) if figure.batched else [figure(device) for device in devices]
        for name, figure in named.items()
    }
