"""The least model and the cheapest step that keep a tolerance, measured."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.errors import ParameterError, PlantError, SensingError
from maglev_mj.experiments.ladder import (
    FIDELITY_SCENES,
    PERIOD,
    RUNGS,
    FidelityScene,
    Motion,
    apart,
    motion_of,
    place_of,
    plant_of,
)
from maglev_mj.loop import run
from maglev_mj.parameters import number
from maglev_mj.plants import SampledPlant, engine_warnings_silenced

__all__ = [
    "STEPPINGS",
    "FidelityResult",
    "RungResult",
    "StepResult",
    "closed_loop",
    "measure_costs",
    "measure_fidelity",
    "measure_rungs",
    "measure_steps",
    "median_times",
    "stepping_name",
]

_REFERENCE_STEP = 2e-5
_SHORT, _LONG = 2e-3, 0.1

STEPPINGS: tuple[tuple[str, float | None], ...] = tuple(
    (integrator, step)
    for integrator in ("corrected", "euler", "implicitfast", "rk4")
    for step in (None, 1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5)
)
"""Integrator and longest step [s]; None for as long as the force is constant and nothing else asks for less."""


class RungResult(NamedTuple):
    """One rung of the ladder in one scene.

    Attributes:
        rung: Its name.
        says: What it adds.
        changes: How far the motion is from that of the rung below [m]; 0 for the lowest.
        missing: How far it is from the motion of any rung above at most [m]; 0 for the highest.
        force: Change of the greatest force from the rung below [N].
        cost: Of a simulated second [s], the controller included.
    """

    rung: str
    says: str
    changes: float
    missing: float
    force: float
    cost: float


class StepResult(NamedTuple):
    """One integrator and step on one rung.

    Attributes:
        integrator: Name; "closed form" for the lowest rung.
        step: Longest step [s]; None for as long as the force is constant.
        error: How far the motion is from that of RK4 with a step of 20 µs [m]; infinite if it diverges.
        cost: Of a simulated second [s].
    """

    integrator: str
    step: float | None
    error: float
    cost: float


class FidelityResult(NamedTuple):
    """What a scene needs.

    Attributes:
        scene: The scene.
        tolerance: What is to be kept [m].
        rungs: The ladder, from the least model to the most.
        rung: The least rung that is within the tolerance of all above it.
        steps: Integrators and steps on that rung.
        cheapest: The cheapest of them that keeps what the model leaves of the tolerance; None if none does.
    """

    scene: FidelityScene
    tolerance: float
    rungs: tuple[RungResult, ...]
    rung: RungResult
    steps: tuple[StepResult, ...]
    cheapest: StepResult | None

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON; null for what is infinite."""
        steps = [
            {name: None if value == math.inf else value for name, value in row._asdict().items()} for row in self.steps
        ]
        return {
            "scene": self.scene.name,
            "tolerance": self.tolerance,
            "rungs": [row._asdict() for row in self.rungs],
            "rung": self.rung.rung,
            "steps": steps,
            "cheapest": None if self.cheapest is None else self.cheapest._asdict(),
        }


def measure_fidelity(
    scene: str, tolerance: float | None = None, *, progress: Callable[[int, int], None] | None = None
) -> FidelityResult:
    """Climb the ladder in a scene, and choose the least model and the cheapest step that keep a tolerance.

    Args:
        scene: Name from FIDELITY_SCENES.
        tolerance: Greatest displacement of a coil that does not matter [m]; the scene's own by default.
        progress: Told how many motions are done, and of how many.

    Raises:
        ParameterError: If there is no such scene, or the tolerance is not above 0.
    """
    if scene not in FIDELITY_SCENES:
        raise ParameterError(f"scene must be one of {', '.join(FIDELITY_SCENES)}, not {scene!r}")
    chosen = FIDELITY_SCENES[scene]
    kept = chosen.tolerance if tolerance is None else number("tolerance", tolerance, above=0.0)
    told = _Told(progress)
    rungs = measure_rungs(chosen, done=told)
    rung = next(row for row in rungs if row.missing < kept)
    steps = measure_steps(chosen, rung.rung, done=told)
    good = [row for row in steps if row.error + rung.missing < kept]
    return FidelityResult(chosen, kept, rungs, rung, steps, min(good, key=lambda row: row.cost, default=None))


class _Told:
    """Counts motions for a progress bar."""

    def __init__(self, progress: Callable[[int, int], None] | None) -> None:
        self._progress, self._count = progress, 0

    def __call__(self) -> None:
        self._count += 1
        if self._progress is not None:
            self._progress(self._count, len(RUNGS) + len(STEPPINGS))


def measure_rungs(
    scene: FidelityScene, *, repeats: int = 5, done: Callable[[], object] = lambda: None
) -> tuple[RungResult, ...]:
    """Return what each rung changes in a scene and what it costs, each with its own default step.

    Args:
        scene: The scene.
        repeats: How often each is timed.
        done: Called after each motion.
    """
    motions = []
    for rung in RUNGS:
        motions.append(_motion(scene, rung.name))
        done()
    costs = measure_costs(scene, [partial(plant_of, scene, rung.name) for rung in RUNGS], repeats)
    rows = []
    for place, (rung, motion, cost) in enumerate(zip(RUNGS, motions, costs, strict=True)):
        below = motions[max(place - 1, 0)]
        missing = max((apart(motion.pose, above.pose) for above in motions[place + 1 :]), default=0.0)
        change = apart(motion.pose, below.pose)
        rows.append(RungResult(rung.name, rung.says, change, missing, motion.peak_force - below.peak_force, cost))
    return tuple(rows)


def measure_steps(
    scene: FidelityScene, rung: str, *, repeats: int = 3, done: Callable[[], object] = lambda: None
) -> tuple[StepResult, ...]:
    """Return error and cost of each integrator and step on a rung; of the closed form alone on the lowest.

    Args:
        scene: The scene.
        rung: Name from RUNGS.
        repeats: How often each is timed.
        done: Called after each motion.
    """
    if place_of(rung) == 0:
        (cost,) = measure_costs(scene, [partial(plant_of, scene, rung)], repeats)
        return (StepResult("closed form", None, 0.0, cost),)
    truth = _motion(scene, rung, longest_step=_REFERENCE_STEP).pose
    errors = {}
    for integrator, step in STEPPINGS:
        try:
            motion = _motion(scene, rung, integrator=integrator, longest_step=step)
            errors[integrator, step] = apart(motion.pose, truth)
        except (PlantError, SensingError):  # it diverged
            errors[integrator, step] = math.inf
        done()
    sound = [key for key, error in errors.items() if math.isfinite(error)]
    makers = [partial(plant_of, scene, rung, integrator=kind, longest_step=step) for kind, step in sound]
    costs = dict(zip(sound, measure_costs(scene, makers, repeats), strict=True))
    return tuple(StepResult(*key, error, costs.get(key, math.inf)) for key, error in errors.items())


def measure_costs(
    scene: FidelityScene, makers: Sequence[Callable[[], SampledPlant]], repeats: int
) -> tuple[float, ...]:
    """Return what a simulated second costs on each plant [s], the controller included; see `median_times`."""
    times = median_times([partial(closed_loop, make, scene) for make in makers], repeats)
    return tuple(taken / (scene.ticks * PERIOD) for taken in times)


def closed_loop(make: Callable[[], SampledPlant], scene: FidelityScene) -> Callable[[], object]:
    """Return a scene in closed loop on a new plant, ready to run."""
    return partial(run, make(), scene.controller(), scene.ticks)


def median_times(prepare: Sequence[Callable[[], Callable[[], object]]], repeats: int) -> tuple[float, ...]:
    """Return how long each piece of work takes [s].

    Medians over repeats in turn, so that their ratios hold on a machine that is not alone. Short work counts several
    times a turn, after once that warms the processor's caches; what takes long has two turns only.

    Args:
        prepare: Each makes its work ready, which is not timed, and returns it.
        repeats: Turns.
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


def stepping_name(integrator: str, step: float | None) -> str:
    """Return what an integrator with a longest step [s] is called."""
    return f"{integrator}, {'a step a segment' if step is None else f'{step * 1e3:g} ms'}"


def _motion(scene: FidelityScene, rung: str, **options: Any) -> Motion:
    with engine_warnings_silenced(), np.errstate(all="ignore"):  # what diverges overflows before it is found out
        return motion_of(scene, plant_of(scene, rung, **options))
