"""Cases around a scene: phases, jitter seeds and neighbouring gains; many at once on the exact plant."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.experiments.press import SideBySide
from maglev_mj.frames import Array
from maglev_mj.loop import run
from maglev_mj.parameters import axis_indices, number
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.studies.fidelity_scenes import FidelityScene
from maglev_mj.studies.levels import LEVELS, Level, apart, exact_options, timing_of

__all__ = ["Case", "choice_cases", "itself", "run_together", "scattered_cases", "scene_at", "screen_levels"]

_MOST_PHASES = 1000
_FAR = (1e9, 1e9)
_POINTS, _SEEDS = 256, 16
_STEPS = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
"""Additive recurrence that fills a cube evenly: powers of the inverse of the root of x⁴ = x + 1 (Roberts 2018)."""


class Case(NamedTuple):
    """One variation of a scene.

    Attributes:
        phase: Of the samples, in [0, 1); without effect in a scene that starts at rest.
        seed: Of the jitter.
        stiffness: Factor of the stiffness.
        damping: Factor of the damping.
    """

    phase: float
    seed: int
    stiffness: float = 1.0
    damping: float = 1.0


def itself(scene: FidelityScene) -> Case:
    """Return the case of the scene as it is."""
    return Case(scene.parameters.phase if scene.has_phase else 0.0, 0)


def choice_cases(scene: FidelityScene, phases: int, around: float) -> tuple[Case, ...]:
    """Return the cases that a level is chosen by, the scene itself first: phases times pairs of gains.

    Each has a jitter seed of its own. The gains are those of the scene and the corners of their neighbourhood.

    Args:
        scene: The scene.
        phases: How many phases, evenly spread over a period; jitter seeds alone in a scene that starts at rest.
        around: Largest relative change of a gain, in [0, 0.5].

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    if number("phases", phases, at_least=1, at_most=_MOST_PHASES) != int(phases):
        raise ParameterError(f"phases must be a whole number, not {phases:g}")
    share = number("around", around, at_least=0.0, at_most=0.5)
    gains = [(1.0, 1.0)]
    if scene.has_gains and share:
        gains += [(k, b) for k in (1.0 - share, 1.0 + share) for b in (1.0 - share, 1.0 + share)]
    first = itself(scene).phase
    chosen = [(first + place / int(phases)) % 1.0 for place in range(int(phases))]
    return tuple(Case(phase, seed, *pair) for seed, (pair, phase) in enumerate(itertools.product(gains, chosen)))


def scattered_cases(scene: FidelityScene, count: int, around: float, *, seed: int) -> tuple[Case, ...]:
    """Return cases spread evenly over phases and neighbouring gains, each with a jitter seed of its own.

    Args:
        scene: The scene.
        count: How many.
        around: Largest relative change of a gain.
        seed: Of the first point, and first of the jitter seeds.
    """
    share = around if scene.has_gains else 0.0
    start = np.random.default_rng(seed).uniform(size=3)
    points = (start + np.outer(np.arange(count), _STEPS)) % 1.0
    return tuple(
        Case(float(phase), seed + place, 1.0 + share * (2.0 * float(k) - 1.0), 1.0 + share * (2.0 * float(b) - 1.0))
        for place, (phase, k, b) in enumerate(points)
    )


def scene_at(scene: FidelityScene, case: Case) -> FidelityScene:
    """Return the scene of a case."""
    values: dict[str, Any] = {"phase": case.phase} if scene.has_phase else {}
    if scene.has_gains:
        values["stiffness"] = scene.parameters.stiffness * case.stiffness
        values["damping"] = scene.parameters.damping * case.damping
    return scene.changed(**values) if values else scene


def screen_levels(scene: FidelityScene, around: float) -> Array:
    """Return the distance of each level from those above it in 4096 cases on the exact plant [m], (levels, 4096).

    The exact plant has the lag, the current limit along z, the sensor's steps and the jitter, for many devices at
    once; it lacks coils that turn, falloff, spots, stops and the handle's swing. A jump that one case in a hundred
    makes, where a sample just meets the wall, is found here and not in a few cases of the whole device.

    Args:
        scene: The scene.
        around: Largest relative change of a gain.

    Returns:
        The distances; infinite throughout if a case diverges, zero for one case in a scene without gains.
    """
    if not scene.has_gains:  # no loop, so nothing jumps
        return np.zeros((len(LEVELS), 1))
    points = [scene_at(scene, case) for case in scattered_cases(scene, _POINTS, around, seed=0)]
    try:
        return _screen(points)
    except PlantError:  # one diverged, and with it the batch
        return np.full((len(LEVELS), len(points) * _SEEDS), math.inf)


def _screen(points: Sequence[FidelityScene]) -> Array:
    steady: dict[str, Array] = {}
    found = []
    for seed in range(_SEEDS):
        motions: list[Array] = []
        for place, level in enumerate(LEVELS):
            below = LEVELS[max(place - 1, 0)]
            if place and _seen_alike(level, below):
                motions.append(motions[-1])
            elif level.jitter:
                motions.append(run_together(points, level.name, seed))
            else:
                if level.name not in steady:
                    steady[level.name] = run_together(points, level.name, seed)
                motions.append(steady[level.name])
        found.append(_distances(motions))
    return np.concatenate(found, axis=1)


def _seen_alike(one: Level, other: Level) -> bool:
    """Return whether two levels are the same on the exact plant."""
    return (exact_options(one.name), *one[3:]) == (exact_options(other.name), *other[3:])


def _distances(motions: Sequence[Array]) -> Array:
    """Return the largest distance of each motion from those above it [m], (levels, N), from poses (K, N, 6)."""
    found = np.zeros((len(motions), motions[0].shape[1]))
    for place, motion in enumerate(motions):
        different = {id(above): above for above in motions[place + 1 :] if above is not motion}
        found[place] = np.max([apart(motion, above) for above in different.values()], axis=0, initial=0.0)
    return found


def run_together(scenes: Sequence[FidelityScene], level: str, seed: int) -> Array:
    """Run scenes that differ in gains and phases alone as one batch of exact plants; return poses (K, N, 6)."""
    made: list[tuple[Timing, dict[str, Any]]] = []

    def keep(timing: Timing, **keywords: Any) -> Any:
        made.append((timing, keywords))

    parts = [scene.parts(scene.parameters, make=keep) for scene in scenes]
    timing, keywords = made[0]
    keywords = keywords | {"pose": np.array([own.get("pose", (0.0,) * 6) for _, own in made])}
    if keywords.get("hand_force") is not None:
        keywords["hand_force"] = SideBySide([own["hand_force"] for _, own in made])
    keywords.pop("longest_step", None)
    index = [one.name for one in LEVELS].index(level)
    timing = timing_of(LEVELS[index], timing, seed)
    phases = np.array([one.phase for one, _ in made])
    if (phases != phases[0]).any():
        timing = replace(timing, phase=phases)
    near = exact_options(level)
    if keywords.get("wrench_limit") is not None:  # the scene's own
        near.pop("wrench_limit", None)
    options = keywords | near | {"escape": _FAR, "record": False}
    with np.errstate(all="ignore"), ExactPlant(timing, **options) as plant:
        poses: list[Array] = []
        controller = _stacked([controller for _, controller, _ in parts])
        run(plant, controller, min(ticks for *_, ticks in parts), observe=lambda *_: poses.append(plant.state()[0]))
        return np.array(poses)


def _stacked(controllers: Sequence[Controller]) -> Controller:
    """Return one controller for a batch, from those of its devices."""
    first = controllers[0]
    laws = [_stacked_law([controller.laws[place] for controller in controllers]) for place in range(len(first.laws))]
    return Controller(laws, period=first.period, velocity=first.velocity)


def _stacked_law(laws: Sequence[Any]) -> Any:
    """Return one law for a batch: parameters that differ become (N, axes)."""
    first = laws[0]
    axes = len(axis_indices(first.axes))
    changed = {}
    for item in fields(first):
        values = [getattr(law, item.name) for law in laws]
        if item.init and any(not np.array_equal(values[0], value) for value in values[1:]):
            changed[item.name] = np.array([np.broadcast_to(value, (axes,)) for value in values])
    return replace(first, **changed) if changed else first
