"""Cases around a scene: phases, jitter seeds, neighbouring gains.

Many are simulated at once on the exact plant.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array
from maglev_mj.loop import drive
from maglev_mj.parameters import number
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import get_scene
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.together import stacked_scenes
from maglev_mj.studies.levels import LEVELS, Level, apart, exact_options, level_index, timing_of

_MOST_PHASES = 1000
_FAR = (1e9, 1e9)
_POINTS, _SEEDS = 256, 16
_STEPS = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
"""Increments of a sequence that fills a cube evenly.

Powers of the inverse of the root of x⁴ = x + 1 (Roberts 2018).
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
    Preset("drop-no-pulse", Drop(pulse=0.0), 1e-4, "what the paper's figure 3 can be read to"),
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


class Case(NamedTuple):
    """One variation of a scene.

    Attributes:
        phase: Phase of the samples, in [0, 1); without effect in a scene that starts at rest.
        seed: Seed of the jitter.
        stiffness: Factor of the stiffness.
        damping: Factor of the damping.
    """

    phase: float
    seed: int
    stiffness: float = 1.0
    damping: float = 1.0


def has_gains(scene: Scene) -> bool:
    """Return True for a scene with stiffness and damping.

    Both must be parameters with numbers.
    """
    return all(isinstance(getattr(scene, name, None), float) for name in ("stiffness", "damping"))


def itself(phase: float = 0.0) -> Case:
    """Return the case of the unchanged scene."""
    return Case(phase, 0)


def choice_cases(scene: Scene, phases: int, around: float, phase: float = 0.0) -> tuple[Case, ...]:
    """Return the cases for the choice of a level.

    They are phases times pairs of gains, the scene itself first.

    Each has its own jitter seed. The gains are those of the scene and the corners of their neighbourhood.

    Args:
        scene: The scene.
        phases: Number of phases, evenly spread over a period; jitter seeds alone in a scene that starts at rest.
        around: Largest relative change of a gain, in [0, 0.5].
        phase: Phase of the scene itself.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    if number("phases", phases, at_least=1, at_most=_MOST_PHASES) != int(phases):
        raise ParameterError(f"phases must be a whole number, not {phases:g}")
    share = number("around", around, at_least=0.0, at_most=0.5)
    gains = [(1.0, 1.0)]
    if has_gains(scene) and share:
        gains += [(k, b) for k in (1.0 - share, 1.0 + share) for b in (1.0 - share, 1.0 + share)]
    chosen = [(phase + place / int(phases)) % 1.0 for place in range(int(phases))]
    return tuple(Case(at, seed, *pair) for seed, (pair, at) in enumerate(itertools.product(gains, chosen)))


def scattered_cases(scene: Scene, count: int, around: float, *, seed: int) -> tuple[Case, ...]:
    """Return cases spread over phases and neighbouring gains.

    They are evenly spread; each has its own jitter seed.

    Args:
        scene: The scene.
        count: Number of cases.
        around: Largest relative change of a gain.
        seed: Seed of the first point, and first of the jitter seeds.
    """
    share = around if has_gains(scene) else 0.0
    start = np.random.default_rng(seed).uniform(size=3)
    points = (start + np.outer(np.arange(count), _STEPS)) % 1.0
    return tuple(
        Case(float(phase), seed + place, 1.0 + share * (2.0 * float(k) - 1.0), 1.0 + share * (2.0 * float(b) - 1.0))
        for place, (phase, k, b) in enumerate(points)
    )


def scene_at(scene: Scene, case: Case) -> tuple[Scene, float]:
    """Return the scene of a case, and its phase."""
    phase = case.phase if scene.takes_phase else 0.0
    if not has_gains(scene):
        return scene, phase
    gains = {name: getattr(scene, name) * getattr(case, name) for name in ("stiffness", "damping")}
    return scene.replace(**gains), phase


def screen_levels(scene: Scene, around: float) -> Array:
    """Return each level's distance from those above it [m].

    (levels, cases): 4096 cases on the exact plant; 16 of a scene with neither gains nor phases to vary.

    The exact plant has the lag, the current limit along z, the sensor's steps and the jitter, for many devices at
    once. It lacks turning coils, falloff, spots, stops and the handle's swing. A rare jump, of a sample that just meets
    the wall, is found here and not in a few cases of the whole device.

    Args:
        scene: The scene.
        around: Largest relative change of a gain.

    Returns:
        The distances; infinite throughout if a case diverges.

    Raises:
        ParameterError: If a law does not declare its gains; an `if` on a coordinate raises ValueError.
    """
    count = _POINTS if has_gains(scene) or scene.takes_phase else 1
    points = [scene_at(scene, case) for case in scattered_cases(scene, count, around, seed=0)]
    try:
        return _screen(points)
    except PlantError:  # one diverged, and with it the batch
        return np.full((len(LEVELS), len(points) * _SEEDS), math.inf)


def _screen(points: Sequence[tuple[Scene, float]]) -> Array:
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
    """Return True for two equal levels on the exact plant."""
    return (exact_options(one.name), *one[3:]) == (exact_options(other.name), *other[3:])


def _distances(motions: Sequence[Array]) -> Array:
    """Return each motion's largest distance from those above [m].

    (levels, N), from poses (K, N, 6).
    """
    found = np.zeros((len(motions), motions[0].shape[1]))
    for place, motion in enumerate(motions):
        different = {id(above): above for above in motions[place + 1 :] if above is not motion}
        found[place] = np.max([apart(motion, above) for above in different.values()], axis=0, initial=0.0)
    return found


def run_together(points: Sequence[tuple[Scene, float]], level: str, seed: int) -> Array:
    """Run scenes as one batch of exact plants.

    Returns poses (K, N, 6), at the scenes' phases. The scenes differ in gains alone.

    Raises:
        ParameterError: If their laws differ in more than declared gains, or do not accept many devices at once.
    """
    stack = stacked_scenes(points)
    near = exact_options(level) | {"longest_step": None, "escape": _FAR, "record": False}
    if stack.plant_options().get("wrench_limit") is not None:  # the scene's own
        near.pop("wrench_limit", None)
    ticks = min(scene.ticks(scene.timing(phase)) for scene, phase in points)
    timing = timing_of(LEVELS[level_index(level)], stack.timing(), seed)
    with np.errstate(all="ignore"), stack.plant("exact", timing=timing, **near) as plant:
        poses: list[Array] = []
        drive(plant, stack.controller(), ticks, observe=lambda *_: poses.append(plant.state()[0]))
        return np.array(poses)
