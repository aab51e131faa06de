"""Runs of a scene: on one device, as a batch, over many sampling phases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from functools import partial
from numbers import Integral
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record, drive
from maglev_mj.errors import DivergenceError, ParameterError, check_one_of, choice_message
from maglev_mj.frames import Array, Command, Component, Sample, unit_of
from maglev_mj.keywords import checked
from maglev_mj.lazy import has_engine
from maglev_mj.parameters import number, numbers
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.trace import BLOCK, Trace
from maglev_mj.scenes.find import SceneLike, get_scene
from maglev_mj.scenes.results import Phases, RunResult, Variants, scene_conditions
from maglev_mj.scenes.scene import PLANTS, OneDevice, Scene
from maglev_mj.scenes.stack import SceneStack, stacked_scenes

_MOST_PHASES = 10_000
_CHUNK = 64
_NUDGE = 1e-12

STARTS = 6
"""Runs that show the spread of a chaotic one."""

Observe: TypeAlias = Callable[[Sample, Command], object]

Begin: TypeAlias = Callable[[Scene, Any, Controller, int], Record]
"""Function of scene, plant, controller and number of samples that begins a recording."""


@checked(own="scene")
def run(
    scene: SceneLike,
    *,
    plant: str | None = None,
    phase: ArrayLike = 0.0,
    observe: Observe | None = None,
    begin: Begin | None = None,
) -> RunResult:
    """Run a scene on one device, or at N sampling phases on N devices.

    Args:
        scene: The scene, its class, or a text for `find_scene`.
        plant: Name from PLANTS; the scene's first one by default.
        phase: Sampling phase in [0, 1): samples are at (k + phase) period; (N,) for N devices, on the exact plant.
        observe: Function called with each sample and the applied command.
        begin: Begins a recording of a run on one device; see `maglev_mj.session.replay.recorded`.

    Raises:
        ParameterError: If there is no such plant, or a phase is outside its bounds.
        DivergenceError: If a flotor leaves its range by a wide margin; for one device its `partial` attribute is the
            `RunResult` up to then.

    Example:
        >>> from maglev_mj import find_scene, run
        >>> result = run(find_scene("drop")(height=0.002), plant="exact")
        >>> round(float(result.figures["penetration"]), 5)  # [m]
        0.0019
    """
    return _run(get_scene(scene), plant, phase, observe, begin)


def _run(
    scene: Scene,
    plant: str | None,
    phase: ArrayLike,
    observe: Observe | None = None,
    begin: Begin | None = None,
    make: OneDevice | None = None,
) -> RunResult:
    """Run a scene; see `run`. With `make`, on its plant, which stays open."""
    plant = checked_plant(scene, plant)
    check_one_of("plant", PLANTS, plant, f" to run {scene.name}")
    single = np.ndim(phase) == 0
    if not single and plant != "exact":
        raise ParameterError(f"phase must be a number on {plant}; use run_phases for several")
    at: Component = checked_phase(phase) if single else _phases(phase)
    controller, timing = scene.controller(), scene.timing(at)
    whole = single or isinstance(scene, SceneStack)
    source: Any = scene if whole else stacked_scenes([(scene, each) for each in np.asarray(at).tolist()])
    own: dict[str, Any] = {}
    if make is not None and plant == "mujoco" and type(scene).plant is Scene.plant:  # a user's may have no `make`
        own["make"] = make
    made = source.plant(plant, phase=at, timing=timing, record=True, **own)
    with nullcontext(made) if own else made as device, engine_warnings_silenced():
        signals = _SignalLog(controller, observe, () if single else (np.size(at),))
        ticks = scene.ticks(timing)
        record = None if begin is None else begin(scene, device, controller, ticks)
        try:
            drive(device, controller, ticks, observe=signals.observe, record=record)
        except DivergenceError as error:
            trace = _trace(device, scene, plant)
            if not _escaped_later(trace, scene.end, scene.hardware.escape):
                if single:
                    error.partial = signals.result(scene, plant, at, trace)
                raise
        return signals.result(scene, plant, at, _trace(device, scene, plant).until(scene.end))


def figures_of(scene: Scene, plant: str, phase: float = 0.0, make: OneDevice | None = None) -> Mapping[str, Any]:
    """Return the figures of one run by name, from the scene's `run_figures` if defined; and any `warnings`.

    A run in MuJoCo is on the plant of `make`, if any.
    """
    if scene.run_figures is None:
        result = _run(scene, plant, phase, make=make)
        return {**result.figures, **({"warnings": text} if (text := result.verdicts()[0]) else {})}
    figures: Mapping[str, Any] = scene.run_figures(plant, phase)
    return figures


@checked
def run_phases(
    scene: SceneLike,
    phases: int | ArrayLike,
    *,
    plant: str | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Phases:
    """Run a scene at many sampling phases, in batches on the exact plant, otherwise one by one.

    Args:
        scene: See `run`.
        phases: Number of phases, evenly spaced over a period, or the phases themselves.
        plant: Name from PLANTS; the scene's first one by default.
        progress: Function called with the numbers of finished and of all phases.

    Raises:
        ParameterError: If there is no phase, or a phase is outside [0, 1).
        DivergenceError: If a flotor leaves its range by a wide margin.

    Example:
        >>> from maglev_mj import find_scene, run_phases
        >>> phases = run_phases(find_scene("drop")(duration=0.1), 8, plant="exact")
        >>> phases.figures["penetration"].shape
        (8,)
    """
    scene = get_scene(scene)
    chosen, plant = _phases(phases), checked_plant(scene, plant)
    size = _CHUNK if plant == "exact" else 1
    parts: list[Phases] = []  # figures only: traces are large
    with closing(OneDevice()) as make:
        for start in range(0, chosen.size, size):
            chunk = chosen[start : start + size]
            if plant == "exact":
                result = run(scene, plant=plant, phase=chunk)
            else:
                result = _run(scene, plant, float(chunk[0]), make=make)
            parts.append(result.over_phases())
            if progress is not None:
                progress(start + chunk.size, chosen.size)
    together = {name: np.concatenate([part.figures[name] for part in parts]) for name in parts[0].figures}
    return Phases(scene, plant, chosen, together, np.concatenate([part.peaks for part in parts]))


def run_variants(
    variants: Mapping[str, Scene],
    *,
    plant: str | None = None,
    phase: float = 0.0,
    phases: int | ArrayLike | None = None,
    bands: int | ArrayLike | None = None,
    recording: AbstractContextManager[Begin | None] | None = None,
    compare: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> Variants:
    """Run a scene and its variants at one sampling phase, and optionally at many.

    Args:
        variants: Scenes by label, such as those of `Scene.variants`; the scene itself first.
        plant: See `run`.
        phase: See `run`.
        phases: Additional phases for the figures, see `run_phases`; None for none.
        bands: Additional phases for the motion on the exact plant, for pictures; None for none.
        recording: Context of the function that begins a recording of the first run; see `run`.
        compare: True to run the first scene on its other plant too, for `gap`.
        progress: See `run_phases`.

    Raises:
        DivergenceError: If a flotor leaves its range by a wide margin; `partial` is the first run, up to its end.
    """
    runs: dict[str, RunResult] = {}
    swept: dict[str, Phases] = {}
    drawn: dict[str, RunResult] = {}
    gap, label = None, ""
    try:
        for label, variant in variants.items():
            with (not runs and recording) or nullcontext() as begin:  # only the first run is recorded
                runs[label] = run(variant, plant=plant, phase=phase, begin=begin)
        for label, variant in variants.items():
            if phases is not None:
                swept[label] = run_phases(variant, phases, plant=plant, progress=progress)
            if bands is not None:
                drawn[label] = run(variant, plant="exact", phase=_phases(bands))
        if compare:
            label = next(iter(runs))
            gap = _plant_deviation(runs[label])
    except DivergenceError as error:
        if len(variants) > 1:
            error.args = (f"{label}: {error}",)
        if runs:
            error.partial = next(iter(runs.values()))
        raise
    chaotic = [chaos_warning(label, one, moved) for label, one in runs.items() if (moved := sensitivity(one))]
    return Variants(runs, swept, drawn, gap, chaotic)


def sensitivity(result: RunResult) -> float:
    """Return the deviation of a run with pulses if its phase changes by 1e-12 [m, rad]; 0 below a sensor step."""
    scene: Scene = result.scene
    if not (scene.has_pulses and scene.takes_phase):
        return 0.0
    step = getattr(scene, "quantize", 0.0) or scene.hardware.sensor.resolution[scene.axis_index]
    try:
        moved = _deviation(result, result.plant, abs(result.phase - _NUDGE))
    except DivergenceError:
        moved = scene.hardware.escape
    return moved if moved > step else 0.0


def chaos_warning(subject: str, result: RunResult, moved: float) -> str:
    """Return the warning about a chaotic run, with the spread of its figures over starts that differ by rounding."""
    scene: Scene = result.scene
    try:
        starts = run_phases(scene, [abs(result.phase - k * _NUDGE) for k in range(STARTS)], plant=result.plant)
        spread = ", ".join(starts.spreads()) or "no figure differs"
    except DivergenceError:
        spread = "not every run stays in range"
    return (
        f"{subject}: chaotic, single figures are not reproducible: {spread} over {STARTS} starts {_NUDGE:g} periods "
        f"apart (motion differs by up to {moved:.2g} {unit_of('m', scene.axis)}); use many phases"
    )


def _plant_deviation(result: RunResult) -> float | None:
    """Return the maximum deviation from the other plant [m, rad]; None without another plant or MuJoCo."""
    others = [name for name in result.scene.plants if name in PLANTS and name != result.plant]
    if not others or not has_engine():
        return None
    return _deviation(result, others[0], result.phase)


def _deviation(result: RunResult, plant: str, phase: float) -> float:
    other, time = run(result.scene, plant=plant, phase=phase), result.times()
    return float(np.abs(result.motion(time)[0] - other.motion(time)[0]).max())


def checked_plant(scene: Scene, plant: str | None) -> str:
    """Return the checked name of a scene's plant.

    Raises:
        ParameterError: If the scene does not run on it.
    """
    chosen = scene.plants[0] if plant is None else plant
    if chosen not in scene.plants:
        raise ParameterError(choice_message("plant", sorted(scene.plants), plant))
    return chosen


def checked_phase(phase: object) -> float:
    """Return a checked phase."""
    return number("phase", phase, at_least=0.0, below=1.0)


def _phases(phases: Any) -> Array:
    if isinstance(phases, Integral):
        if not 1 <= int(phases) <= _MOST_PHASES:
            raise ParameterError(f"phases must be at least 1 and at most {_MOST_PHASES} (got {phases})")
        return np.arange(int(phases)) / int(phases)
    chosen = numbers("phases", phases, at_least=0.0)
    if chosen.ndim != 1 or not chosen.size:
        raise ParameterError(f"phases must be an integer or a list of phases (got {phases!r})")
    if not (chosen < 1.0).all():
        raise ParameterError(f"phases must all be below 1 (got {chosen.max():g})")
    return chosen


class _SignalLog:
    """Log of the laws' signals at each sample."""

    def __init__(self, controller: Controller, observe: Observe | None, batch: tuple[int, ...]) -> None:
        self._controller, self._observe, self._batch = controller, observe, batch
        self._rows: list[dict[str, Any]] = []
        self._blocks: list[dict[str, Array]] = []

    def observe(self, sample: Sample, command: Command) -> None:
        """Store the laws' signals of a sample."""
        if signals := self._controller.signals:
            row = {name: self._copied(parts) for name, parts in (("position", sample.position), *signals.items())}
            self._rows.append({"time": sample.time, **row})
            if len(self._rows) == BLOCK:
                self._blocks.append(self._packed())
                self._rows = []
        if self._observe is not None:
            self._observe(sample, command)

    def _copied(self, parts: Sequence[Any]) -> Any:
        if not self._batch:
            return list(parts)
        return [np.broadcast_to(part, self._batch) for part in parts]

    def result(self, scene: Scene, plant: str, phase: Any, trace: Trace) -> RunResult:
        """Return the result up to the end of a trace."""
        blocks = [*self._blocks, self._packed()] if self._rows else self._blocks
        columns = {name: np.concatenate([block[name] for block in blocks]) for block in blocks[:1] for name in block}
        time = columns.pop("time", np.array([]))
        within = time <= float(trace.time[-1]) if time.ndim == 1 and trace.time.ndim == 1 else slice(None)
        return RunResult(
            scene, plant, phase, trace, time[within], {name: column[within] for name, column in columns.items()}
        )

    def _packed(self) -> dict[str, Array]:
        """Return the rows as columns."""
        return {name: np.array([row[name] for row in self._rows]) for name in self._rows[0]}


def _trace(device: Any, scene: Scene, plant: str) -> Trace:
    """Return the motion of a run, which charts name by its scene."""
    trace: Trace = device.trace()
    return replace(trace, origin=partial(scene_conditions, scene, f"plant {plant}"))


def _escaped_later(trace: Trace, end: float, escape: float) -> bool:
    """Return True if a run diverged after its end [s], because escape is detected at the sample after it."""
    if float(trace.time[-1].min()) < end:
        return False
    return bool((np.linalg.norm(trace.until(end).pose[..., :3], axis=-1) < escape).all())
