"""Distances between model levels, and computing costs.

They are measured over many cases of a scene.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import PlantError, SensingError
from maglev_mj.frames import Array
from maglev_mj.loop import drive
from maglev_mj.plants import SampledPlant, engine_warnings_silenced
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.fidelity_cases import Case, Preset, itself, preset_of, scene_at
from maglev_mj.studies.levels import LEVELS, Motion, apart, level_index, level_parts, motion_of

_SHORT, _LONG = 2e-3, 0.1

Parts = tuple[SampledPlant, Controller, int]


def measure_costs(makers: Sequence[Callable[[], Parts]], seconds: Sequence[float], repeats: int) -> tuple[float, ...]:
    """Return each closed loop's cost per simulated second [s].

    The controller is included; see `median_times`.

    Args:
        makers: Functions that return plant, controller and number of samples.
        seconds: Time of an earlier run of each [s]; a long one is not repeated.
        repeats: Number of rounds.
    """
    quick = [place for place, taken in enumerate(seconds) if taken < _LONG]
    taken = list(seconds)
    found = median_times([partial(closed_loop, makers[place]) for place in quick], repeats)
    for place, median in zip(quick, found, strict=True):
        taken[place] = median
    simulated = [ticks * plant.period for plant, _, ticks in (make() for make in makers)]
    return tuple(cost / span for cost, span in zip(taken, simulated, strict=True))


def closed_loop(make: Callable[[], Parts]) -> Callable[[], object]:
    """Return a closed loop of new parts, ready to run."""
    return partial(drive, *make())


def median_times(prepare: Sequence[Callable[[], Callable[[], object]]], repeats: int) -> tuple[float, ...]:
    """Return the computing time of each task [s].

    Medians over interleaved repeats, so that their ratios hold on a shared machine. A short task is timed several times
    per round, after one run that warms the processor's caches; a long task has two rounds only.

    Args:
        prepare: Functions that prepare a task, which is not timed, and return it.
        repeats: Number of rounds.
    """
    times: list[list[float]] = [[] for _ in prepare]
    for turn in range(repeats):
        for kept, make in zip(times, prepare, strict=True):
            if turn > 1 and kept[0] > _LONG:
                continue
            first = _timed(make())
            kept += [first] if first > _LONG else [_timed(make()) for _ in range(min(math.ceil(_SHORT / first), 10))]
    return tuple(statistics.median(kept) for kept in times)


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


DEAR = level_index("filter")
"""Index of the first expensive level.

Levels from it on cost ten times as much as those below.
"""

DEAR_CASES = 4
"""Number of cases for the expensive levels."""

_JUMP = 100.0

Motions: TypeAlias = Sequence[dict[int, Motion | None]]
"""Motion of each level by case index.

None for a diverged one.
"""


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


def run_case(scene: Scene, level: str, case: Case, **options: Any) -> Motion | None:
    """Run one case on a level; None if diverging."""
    with engine_warnings_silenced(), np.errstate(all="ignore"):  # a diverging run overflows before it is detected
        try:
            chosen, phase = scene_at(scene, case)
            return motion_of(*level_parts(chosen, level, phase=phase, seed=case.seed, **options))
        except (PlantError, SensingError):
            return None


def distance(one: Motion | None, other: Motion | None) -> float:
    """Return the largest coil displacement between two motions [m].

    It is infinite if one diverged.
    """
    return math.inf if one is None or other is None else float(apart(one.pose, other.pose))


def run_levels(
    scene: Scene, cases: Sequence[Case], *, done: Callable[[], object] = lambda: None
) -> list[dict[int, Motion | None]]:
    """Run every level in every case.

    The expensive levels run only in the first case and in the worst ones without them.

    Args:
        scene: The scene.
        cases: The cases.
        done: Function called after each motion.
    """
    motions: list[dict[int, Motion | None]] = [{} for _ in LEVELS]

    def go(index: int, number: int) -> None:
        motions[index][number] = run_case(scene, LEVELS[index].name, cases[number])
        done()

    for number in range(len(cases)):
        for index in range(DEAR):
            go(index, number)
    # by the distances of the falloff level: those of lower levels sum up too many other effects
    lacking = distances_above(motions, level_index("falloff"))
    ordered = sorted(range(1, len(cases)), key=lambda number: -lacking[number])
    for number in (0, *ordered[: DEAR_CASES - 1]):
        for index in range(DEAR, len(LEVELS)):
            go(index, number)
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


def distances_above(motions: Motions, index: int) -> dict[int, float]:
    """Return a level's distances from those above [m].

    The largest in each case.
    """
    return {
        number: max((distance(motion, above[number]) for above in motions[index + 1 :] if number in above), default=0.0)
        for number, motion in motions[index].items()
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
    seen = screen[level_index("lag") :]
    most = seen.max(axis=1)
    return float(np.max(most, where=most > _JUMP * np.median(seen, axis=1), initial=0.0))


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
    firsts = [found[0] for found in motions]
    makers = [partial(level_parts, scene, level.name) for level in LEVELS]
    seconds = [min((m.seconds for m in found.values() if m is not None), default=1.0) for found in motions]
    costs = measure_costs(makers, seconds, repeats)
    rows = []
    for index, level in enumerate(LEVELS):
        here, below = firsts[index], firsts[max(index - 1, 0)]
        found = list(distances_above(motions, index).values())
        rows.append(
            LevelResult(
                level=level.name,
                adds=level.adds,
                changes=distance(here, below),
                worst=max(*found, float(screen[index].max())),
                missing=max(worst_of(found, share), worst_of(screen[index], share)),
                keeps=float(min(np.mean(np.array(found) <= tolerance), np.mean(screen[index] <= tolerance))),
                diverged=sum(motion is None for motion in motions[index].values()),
                force=math.nan if here is None or below is None else here.peak_force - below.peak_force,
                cost=costs[index],
            )
        )
    return tuple(rows)
