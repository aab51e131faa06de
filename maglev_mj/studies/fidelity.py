"""Choice of model level and integrator step for a tolerance.

The least level and the cheapest step that keep it are measured over many cases, and over thousands more at once on
the exact plant.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.device import Device
from maglev_mj.errors import check_instance
from maglev_mj.frames import Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import number
from maglev_mj.result import Result, Table, capitalised, number_text
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import get_scene
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import scene_conditions
from maglev_mj.scenes.run import checked_phase
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stability_check import stability_warning
from maglev_mj.studies.levels import (
    LEVELS,
    Case,
    LevelMotion,
    boundary_shift,
    choice_cases,
    distance,
    has_gains,
    itself,
    level_index,
    level_parts,
    loop_of,
    measure_costs,
    run_case,
    screen_levels,
    step_of,
)
from maglev_mj.theory.loop_array import LoopArray

MARGIN = 1.25
"""Safety factor on the worst error, for cases not simulated."""

_JUMP = 100.0
_REFERENCE_STEP = 2e-5
_ROUNDING = 1e-12
_STEPS_SHOWN = 12

STEPPINGS: tuple[tuple[str, float | None], ...] = tuple(
    (integrator, step)
    for integrator in ("corrected", "euler", "implicitfast", "rk4")
    for step in (None, 1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5)
)
"""Integrators and longest steps [s].

None lets a step last as long as the force is constant and nothing else needs a shorter one.
"""

DEAR = level_index("filter")
"""Index of the first expensive level.

Levels from it on cost ten times as much as those below.
"""

DEAR_CASES = 4
"""Number of cases for the expensive levels."""

Motions: TypeAlias = Sequence[dict[int, LevelMotion | None]]
"""Motion of each level by case index.

None for a diverged one.
"""


class Preset(NamedTuple):
    """Scene with its tolerance.

    Attributes:
        name: Its name.
        scene: The scene.
        tolerance: Largest negligible displacement of a coil [m].
        reason: Reason for that value.
    """

    name: str
    scene: Scene
    tolerance: float
    reason: str


_PRESETS = (
    Preset("drop-no-pulse", Drop(pulse=0.0), 1e-4, "reading accuracy of the paper's figure 3"),
    Preset(
        "press",
        Press(hits=1, interval=0.2, height=0.001, press=1.0, pulse=0.0, duration=0.5),
        Press.tolerance,
        Press.tolerance_reason,
    ),
)

COMPARED = ("drop", "drop-no-pulse", "press", "stick-slip", "twist", "six-axes", "let-go")
"""Names of the scenes in the comparison table."""


def preset_of(scene: str | Scene | Preset) -> Preset:
    """Return a scene's preset.

    It is that of its class, except for two scenes that are compared with other values.

    Args:
        scene: The scene, or a text for `find_scene`, or "drop-no-pulse".

    Raises:
        ParameterError: If there is no such scene.
    """
    if isinstance(scene, Preset):
        return scene
    for preset in _PRESETS:
        if scene == preset.name:
            return preset
    made = get_scene(scene)
    return Preset(made.name, made, made.tolerance, made.tolerance_reason)


@checked
class Range(NamedTuple):
    """Validity range of a fidelity result.

    Attributes:
        phases: Phases of the samples, evenly spread over a period; jitter seeds alone in a scene that starts at rest.
        around: Largest relative change of stiffness and damping.
        share: Share of the cases that keep the tolerance, in (0, 1].
        boundary: Largest relative shift of the stability boundary by an integrator.

    Example:
        >>> from maglev_mj import Range
        >>> Range(phases=8).around
        0.1
    """

    phases: int = 4
    around: float = 0.1
    share: float = 0.99
    boundary: float = 0.01


class LevelResult(NamedTuple):
    """One model level in one scene.

    Attributes:
        level: Its name.
        adds: Description of what it adds.
        changes: Distance of its motion from that of the level below in the scene itself [m]; 0 for the lowest.
        worst: Distance from the motion of any level above in the worst case [m]; 0 for the highest.
        missing: The same in the worst case of the given share [m]; it decides the choice.
        keeps: Share of the cases that keep the tolerance with its margin.
        diverged: Cases that diverged.
        force: Change of the greatest force from the level below in the scene itself [N].
        cost: Computing time of a simulated second [s], the controller included.
    """

    level: str
    adds: str
    changes: float
    worst: float
    missing: float
    keeps: float
    diverged: int
    force: float
    cost: float


class StepResult(NamedTuple):
    """One integrator and step on one level.

    Attributes:
        integrator: Name; "closed form" for the lowest level.
        step: Longest step [s]; None for as long as the force is constant.
        error: Distance of its motion from that of RK4 with a step of 20 µs in the scene itself [m]; infinite if it
            diverges.
        cost: Computing time of a simulated second [s].
        shift: Relative shift of the stiffest stable wall; None if it was ruled out before.
        missing: Distance from the motion of its level and of any above [m], in the worst case of the given share;
            None if it was ruled out before.
    """

    integrator: str
    step: float | None
    error: float
    cost: float
    shift: float | None = None
    missing: float | None = None


@dataclass(frozen=True)
class FidelityResult(Result):
    """Model level and step needed by a scene.

    A data frame has a row for each level; see `LevelResult`.

    Attributes:
        preset: The scene with its tolerance.
        tolerance: Largest negligible displacement of a coil [m].
        over: Validity range of the answer.
        cases: Cases of the whole device.
        screened: Number of cases on the exact plant; 0 if the laws do not accept many devices at once.
        jump: Largest jump among them [m], from a sample that just meets or just misses the wall; 0 if none.
        met_stops: Number of cases with contact at the metal stops of the model.
        levels: From the least model to the most.
        level: The least level that keeps the tolerance, with the margin, against all above it; None if none does.
        steps: Integrators and steps on that level.
        cheapest: The cheapest of them that keeps the tolerance and the stability boundary; None if none does.
        unscreened: Reason why the cases on the exact plant say nothing about the level: there are none, or that plant
            does not tell it from those above. The share is then one of the few cases of the whole device. Empty
            otherwise.
    """

    preset: Preset
    tolerance: float
    over: Range
    cases: tuple[Case, ...]
    screened: int
    jump: float
    met_stops: int
    levels: tuple[LevelResult, ...]
    level: LevelResult | None
    steps: tuple[StepResult, ...]
    cheapest: StepResult | None
    unscreened: str = ""

    units: ClassVar = {**dict.fromkeys(("changes", "worst", "missing"), "m"), "force": "N", "cost": "s"}
    pictures: ClassVar = {"fidelity": "maglev_mj.studies.pictures:fidelity"}

    def _headline(self) -> str:
        level = "no model level" if self.level is None else f'model level "{self.level.level}"'
        return f"{capitalised(self.preset.name)}: {level} is within {_micro(self.tolerance):g} µm of the full device"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return scene_conditions(self.preset.scene, "")

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return the figures of each level."""
        rows = [row._asdict() for row in self.levels]
        return {name: np.array([row[name] for row in rows]) for name in LevelResult._fields if name != "adds"}

    def table(self) -> Table:
        """Return the levels, their additions, and the integrators and steps on the chosen level."""
        preset, chosen, last = self.preset, self.level, self.levels[-1]
        own = f" ({preset.reason})" if self.tolerance == preset.tolerance else ""
        title = (
            f"Fidelity of {preset.name}: {preset.scene.describe()}; tolerance: {_micro(self.tolerance):g} µm of coil "
        )
        remarks = {row.level: f"{row.diverged} diverged" if row.diverged else "" for row in self.levels}
        below = [_added(self.levels)]
        if chosen is None:
            unstable = "; the loop diverges on the exact plant at or near these gains"
            notes = [f"no level meets the tolerance{unstable if math.isinf(last.worst) else ''}"]
        else:
            remarks[chosen.level] = "chosen"
            notes = self._advice(chosen)
            below.append(self._steps_table(chosen))
        rows = [
            (
                row.level,
                *map(_micro, (row.changes, row.worst)),
                100.0 * (row.keeps if row.keeps == 1.0 else min(row.keeps, 0.9999)),
                round(row.force, 2),
                1e3 * row.cost,
                remarks[row.level],
            )
            for row in self.levels
        ]
        legend = (
            "each level includes all above it; change, force: against the level above it, in the scene itself; worst: "
            "max. deviation from any level below it, over all cases; within: cases within tolerance / margin; cost: "
            "computing time per simulated ms"
        )
        head = "level", "change [µm]", "worst [µm]", "within [%]", "force [N]", "cost [µs]", ""
        note = "\n".join([*self._range_lines(), legend, *notes])
        return Table(f"{title}displacement{own}", head, rows, note, below, self.warnings)

    @property
    def warnings(self) -> Sequence[str]:
        """See `Result`."""
        return [*filter(None, [stability_warning(self.preset.scene)])]

    def _range_lines(self) -> list[str]:
        """Return remarks about the cases: kinds, numbers, contact with stops."""
        over, count, scene = self.over, len(self.cases), self.preset.scene
        device = f"{count} cases of the whole device: {over.phases} "
        device += "sampling phases, each with its own jitter seed" if scene.takes_phase else "jitter seeds"
        if has_gains(scene) and over.around:
            device += f", times 5 gain pairs (nominal, and ±{100.0 * over.around:.3g} % of each)"
        exact = f"{self.screened} cases on the exact plant in the same range: lag, limit, sensor resolution, jitter"
        if not self.screened:
            exact = f"no cases on the exact plant, whose batches the laws must support: {self.unscreened}"
        criterion = f"criterion: {100.0 * over.share:.4g} % of cases within tolerance / {MARGIN:g} (margin for others)"
        stops = (
            f"Warning: metal stops reached in {self.met_stops} of {count} cases: levels without stops simulate a "
            "different motion"
        )
        return [device, exact, criterion, *([stops] if self.met_stops else [])]

    def _steps_table(self, chosen: LevelResult) -> Table:
        rows = [
            (
                step.integrator,
                math.nan if step.step is None else 1e3 * step.step,
                _micro(step.error),
                math.nan if step.shift is None else round(100.0 * step.shift, 1),
                math.nan if step.missing is None else _micro(step.missing),
                1e3 * step.cost,
                "chosen" if step is self.cheapest else "",
            )
            for step in self.steps[:_STEPS_SHOWN]
        ]
        diverged = sum(not math.isfinite(step.error) for step in self.steps)
        title = (
            f"Integrators on level {chosen.level}, cheapest first; step: longest (- for one per interval); error: "
            f"against RK4 at 20 µs; shift: of the stability boundary (at most {100.0 * self.over.boundary:.3g} %); "
            "worst: over all cases"
        )
        head = "integrator", "step [ms]", "error [µm]", "shift [%]", "worst [µm]", "cost [µs]", ""
        return Table(title, head, rows, f"{diverged} diverged" if diverged else "")

    def _advice(self, chosen: LevelResult) -> list[str]:
        """Return the step to take, and how far its model goes."""
        best = self.cheapest
        if best is None:
            return [f"no integrator meets tolerance and boundary on level {chosen.level}"]
        cases = "the cases"
        if self.unscreened:
            count = min(len(self.cases), DEAR_CASES) if level_index(chosen.level) >= DEAR else len(self.cases)
            cases = f"{count} cases of the whole device{f' only: {self.unscreened}' if self.screened else ''}"
        others = "no bound for the others"
        if self.furthest is not None:
            jumps = ", where a sample just meets or misses the wall" if self.jump else ""
            others = f"largest expected {_micro(self.furthest):.4g} µm{jumps}"
        return [
            f"use {chosen.level}, {stepping_name(best.integrator, best.step)}; {1e3 * best.cost:.1f} µs per ms",
            f"error, with the margin of {MARGIN:g}: at most {_micro(MARGIN * (best.missing or 0.0)):.3g} µm in "
            f"{100.0 * self.over.share:.4g} % of {cases}; {others}",
        ]

    @property
    def furthest(self) -> float | None:
        """Largest expected distance of the chosen model [m].

        The margin is included; None without a choice, without a screen, or for more than the flotor's range.
        """
        if self.level is None or self.cheapest is None or not self.screened:
            return None
        most = MARGIN * max(self.cheapest.missing or 0.0, self.level.worst, self.jump)
        return most if most <= float(self.preset.scene.hardware.reach[:3].max()) else None

    def as_json(self) -> dict[str, Any]:
        """Return every field, the margin and the furthest distance, ready for JSON."""
        return {**super().as_json(), "margin": MARGIN, "furthest": self.furthest}


def levels_table(found: Mapping[str, Sequence[LevelResult]]) -> Table:
    """Return the effect of each level in several scenes, by the scene's name."""
    rows = []
    for each in zip(*found.values(), strict=True):
        costs = [1e3 * row.cost for row in each]
        cost = f"{number_text(min(costs), 3, 2)} to {number_text(max(costs), 3, 2)}"
        rows.append((each[0].level, *(_micro(row.changes) for row in each), cost))
    title = (
        "Change by each level against the one above it, by scene: coil displacement [µm]; cost per simulated ms [µs]"
    )
    return Table(title, ("level", *found, "cost"), rows, below=[_added(next(iter(found.values())))])


def _added(levels: Sequence[LevelResult]) -> Table:
    return Table("", ("", ""), [(row.level, row.adds) for row in levels])


def _micro(value: float) -> float:
    """Return a length in micrometres, without those below a nanometre."""
    return round(1e6 * value, 3)


@checked(own="scene over")
def measure_fidelity(
    scene: str | Scene | Preset,
    tolerance: float | None = None,
    over: Range | None = None,
    *,
    phase: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> FidelityResult:
    """Choose the least model level and the cheapest step.

    Both keep a tolerance in a scene and around it.

    Every level runs in every case: phases of the samples times pairs of gains, each with a jitter seed of its own.
    The expensive levels, from the drivers' filter on, run in the scene itself and the three cases that are worst
    without them; `screen_levels` adds 4096 further cases on the exact plant. A level keeps the tolerance if `MARGIN`
    times its distance from every level above it does, in all cases of the whole device and the given share of the
    others. No model except the device itself keeps it in all cases: see `largest_jump`. Where the exact plant says
    nothing, because laws do not accept many devices at once or it lacks what the levels above add, the share is one of
    the cases of the whole device alone: `unscreened` is the reason.

    Args:
        scene: See `preset_of`.
        tolerance: Largest negligible displacement of a coil [m]; the scene's own by default.
        over: Validity range of the answer.
        phase: Phase of the samples in the scene itself, in [0, 1).
        progress: Function called with the number of motions done and the number of all.

    Raises:
        ParameterError: If there is no such scene, or a value is outside its bounds.

    Example:
        >>> from maglev_mj import Range, find_scene, measure_fidelity
        >>> fidelity = measure_fidelity(find_scene("let-go")(duration=0.005), over=Range(phases=1))
        >>> fidelity.level.level
        'axes'
    """
    preset, over = preset_of(scene), over or Range()
    scene = preset.scene
    check_instance("over", over, Range, "a Range, such as Range(phases=1)")
    number("share", over.share, above=0.0, at_most=1.0)
    number("boundary", over.boundary, above=0.0)
    allowed = preset.tolerance if tolerance is None else number("tolerance", tolerance, above=0.0)
    cases = choice_cases(scene, over.phases, over.around, checked_phase(phase))
    dear = (len(LEVELS) - DEAR) * min(DEAR_CASES, len(cases))
    total, counted = len(cases) * DEAR + dear + len(STEPPINGS), itertools.count(1)

    def done() -> None:
        if progress is not None:
            progress(next(counted), total)

    motions = run_levels(scene, cases, done=done)
    unscreened = ""
    try:
        screen = screen_levels(scene, over.around)
    except Exception as error:  # a user's law may fail on arrays in any way
        screen, unscreened = np.zeros((len(LEVELS), 1)), (str(error) or type(error).__name__).splitlines()[0]
    screened = 0 if unscreened else screen.shape[1]
    levels = level_results(scene, motions, screen, allowed / MARGIN, over.share)
    met_stops = sum(motion is not None and motion.met_stops for motion in motions[level_index("stops")].values())
    level = next((row for row in levels if MARGIN * row.missing <= allowed and not row.diverged), None)
    steps: tuple[StepResult, ...] = ()
    cheapest = None
    if level is not None:
        index = level_index(level.level)

        def distances_of(row: StepResult, level: str = level.level) -> list[float]:
            options: Any = {"integrator": row.integrator, "longest_step": row.step}
            stepped = {case: run_case(scene, level, cases[case], **options) for case in motions[index]}
            return list(distances_above([stepped, *motions[index:]], 0, scene.hardware).values())

        screened_error = worst_of(screen[index], over.share)
        if not unscreened and screen[index].max() < _ROUNDING:
            unscreened = f"the exact plant cannot assess level {level.level}"
            if jittered := float(np.mean(screen[level_index("jitter")] > allowed / MARGIN)):
                unscreened += f" (level jitter, which it includes, fails in {jittered:.2g} of its cases)"
        steps, cheapest = _choose(
            measure_steps(scene, level.level, phase=cases[0].phase, done=done),
            loop_of(scene, level.level),
            step_of(scene, level.level),
            lambda value: MARGIN * value <= allowed,
            over.boundary,
            lambda row: max(worst_of(distances_of(row), over.share), screened_error),
        )
    jump = largest_jump(screen)
    return FidelityResult(
        preset, allowed, over, cases, screened, jump, met_stops, levels, level, steps, cheapest, unscreened
    )


def run_levels(
    scene: Scene, cases: Sequence[Case], *, done: Callable[[], object] = lambda: None
) -> list[dict[int, LevelMotion | None]]:
    """Run every level in every case.

    The expensive levels run only in the first case and in the worst ones without them.

    Args:
        scene: The scene.
        cases: The cases.
        done: Function called after each motion.
    """
    motions: list[dict[int, LevelMotion | None]] = [{} for _ in LEVELS]

    def measure(index: int, case: int) -> None:
        motions[index][case] = run_case(scene, LEVELS[index].name, cases[case])
        done()

    for case in range(len(cases)):
        for index in range(DEAR):
            measure(index, case)
    # by the distances of the falloff level: those of lower levels sum up too many other effects
    errors = distances_above(motions, level_index("falloff"), scene.hardware)
    ordered = sorted(range(1, len(cases)), key=lambda case: -errors[case])
    for case in (0, *ordered[: DEAR_CASES - 1]):
        for index in range(DEAR, len(LEVELS)):
            measure(index, case)
    return motions


def measure_levels(scene: str | Scene | Preset, *, repeats: int = 3) -> tuple[LevelResult, ...]:
    """Return each level's effect, error and cost.

    They are those in the scene itself.

    Args:
        scene: See `preset_of`.
        repeats: Number of timings of each.
    """
    preset, none = preset_of(scene), np.zeros((len(LEVELS), 1))
    motions = run_levels(preset.scene, [itself()])
    return level_results(preset.scene, motions, none, preset.tolerance, repeats=repeats)


def distances_above(motions: Motions, index: int, device: Device) -> dict[int, float]:
    """Return a level's largest distance from those above in each case [m]."""
    return {
        case: max((distance(motion, up[case], device) for up in motions[index + 1 :] if case in up), default=0.0)
        for case, motion in motions[index].items()
    }


def worst_of(values: Sequence[float] | Array, share: float) -> float:
    """Return the largest value of a share of cases.

    The share has the smallest values.
    """
    return float(np.quantile(np.asarray(values), share, method="higher"))


def largest_jump(screen: Array) -> float:
    """Return the largest jump on the exact plant [m].

    0 if no case jumps.

    A sample that just meets or just misses the wall separates two levels by a fixed distance, for any small cause. A
    level jumps if a case exceeds a hundred times the median.

    Args:
        screen: Distances of each level from those above it [m], (levels, cases).
    """
    errors = screen[level_index("lag") :]
    largest = errors.max(axis=1)
    return float(np.max(largest, where=largest > _JUMP * np.median(errors, axis=1), initial=0.0))


def level_results(
    scene: Scene, motions: Motions, screen: Array, tolerance: float, share: float = 1.0, *, repeats: int = 3
) -> tuple[LevelResult, ...]:
    """Return each level's effect, error and cost.

    Each level has its own default step.

    Args:
        scene: The scene.
        motions: Motions of the levels.
        screen: Distances on the exact plant [m], (levels, cases).
        tolerance: Largest allowed distance [m].
        share: Share of the cases that counts.
        repeats: Number of timings of each.
    """
    firsts = [by_case[0] for by_case in motions]
    makers = [partial(level_parts, scene, level.name) for level in LEVELS]
    seconds = [min((m.seconds for m in by_case.values() if m is not None), default=1.0) for by_case in motions]
    costs = measure_costs(makers, seconds, repeats)
    rows = []
    for index, level in enumerate(LEVELS):
        motion, below = firsts[index], firsts[max(index - 1, 0)]
        errors = list(distances_above(motions, index, scene.hardware).values())
        rows.append(
            LevelResult(
                level=level.name,
                adds=level.adds,
                changes=distance(motion, below, scene.hardware),
                worst=max(*errors, float(screen[index].max())),
                missing=max(worst_of(errors, share), worst_of(screen[index], share)),
                keeps=float(min(np.mean(np.array(errors) <= tolerance), np.mean(screen[index] <= tolerance))),
                diverged=sum(one is None for one in motions[index].values()),
                force=math.nan if motion is None or below is None else motion.peak_force - below.peak_force,
                cost=costs[index],
            )
        )
    return tuple(rows)


def measure_steps(
    scene: Scene, level: str, *, phase: float = 0.0, repeats: int = 3, done: Callable[[], object] = lambda: None
) -> tuple[StepResult, ...]:
    """Return error and cost of each integrator and step.

    On the lowest level, only the closed form is measured.

    Args:
        scene: The scene.
        level: Name from LEVELS.
        phase: Phase of the samples, in [0, 1).
        repeats: Number of timings of each.
        done: Function called after each motion.
    """
    if level_index(level) == 0:
        (cost,) = measure_costs([partial(level_parts, scene, level, phase=phase)], [0.0], repeats)
        return (StepResult("closed form", None, 0.0, cost),)
    case = itself(phase)
    truth = run_case(scene, level, case, longest_step=_REFERENCE_STEP)
    motions = {}
    for integrator, step in STEPPINGS:
        motions[integrator, step] = run_case(scene, level, case, integrator=integrator, longest_step=step)
        done()
    seconds = {key: motion.seconds for key, motion in motions.items() if motion is not None}
    makers = [
        partial(level_parts, scene, level, phase=phase, integrator=kind, longest_step=step) for kind, step in seconds
    ]
    costs = dict(zip(seconds, measure_costs(makers, list(seconds.values()), repeats), strict=True))
    return tuple(
        StepResult(*key, distance(motion, truth, scene.hardware), costs.get(key, math.inf))
        for key, motion in motions.items()
    )


def _choose(
    rows: Sequence[StepResult],
    loop: LoopArray,
    usual_step: float,
    keeps: Callable[[float], bool],
    boundary: float,
    missing: Callable[[StepResult], float],
) -> tuple[tuple[StepResult, ...], StepResult | None]:
    """Return the rows by cost, and the first suitable one.

    Suitable means that tolerance and stability boundary are kept.

    Args:
        rows: Integrators and steps.
        loop: The loop with the boundary to be kept.
        usual_step: Default longest step [s].
        keeps: Function that returns True for a distance within the tolerance.
        boundary: Largest relative shift of the boundary.
        missing: Function that returns the distance of a row over all cases.
    """
    ordered = sorted(rows, key=lambda row: (row.cost, row.error))
    for index, row in enumerate(ordered):
        if not keeps(row.error):
            continue
        shift = boundary_shift(row.integrator, row.step or usual_step, loop)
        row = ordered[index] = row._replace(shift=shift)
        if abs(shift) > boundary:
            continue
        row = ordered[index] = row._replace(missing=missing(row))
        if keeps(row.missing or 0.0):
            return tuple(ordered), row
    return tuple(ordered), None


def stepping_name(integrator: str, step: float | None) -> str:
    """Return the name of an integrator with its step.

    The longest step is in [s].
    """
    length = "one step per interval" if step is None else f"{step * 1e3:g} ms"
    return integrator if integrator == "closed form" else f"{integrator}, {length}"
