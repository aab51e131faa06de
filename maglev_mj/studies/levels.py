"""Model levels, from six decoupled axes to the whole device.

Each level includes all below it. Here are its plants, its loop as an integrator simulates it, its cases around a
scene, and their computing costs.
"""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property, lru_cache, partial
from timeit import timeit
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.control.timeline import split_delay
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError, PlantError, SensingError, check_one_of
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.parameters import number, whole
from maglev_mj.plants import (
    ExactPlant,
    MuJoCoPlant,
    SampledPlant,
    Sensor,
    SpotSensor,
    Timing,
    engine_warnings_silenced,
    one_step,
)
from maglev_mj.plants.engine import longest_step as step_needed
from maglev_mj.plants.hand import Hand
from maglev_mj.plants.model import body_of
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stack import stacked_scenes
from maglev_mj.spec import DRIVER_TIME_CONSTANT, RESOLUTION, Spec
from maglev_mj.theory.boundary import stiffest_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import LoopArray

_JITTER = 1e-4
_LAG = DRIVER_TIME_CONSTANT
_SHORTEN = ("stops", "force_falloff", "flexible")  # options that need shorter steps
_SPOTS = SpotSensor(quantum=Spec.spot_resolution.value)
_SHORT, _LONG = 2e-3, 0.1
_MOST_PHASES = 1000
_POINTS, _SEEDS = 256, 16
_FAR = (1e9, 1e9)
_SPREAD = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
"""Increments of a sequence that fills a cube evenly.

Powers of the inverse of the root of x⁴ = x + 1 (Roberts 2018).
"""


class Level(NamedTuple):
    """One model level: its additions to the level below.

    Attributes:
        name: Its name.
        adds: Description of what it adds.
        options: Keywords of the plant that it adds or replaces.
        more_delay: Transport delay beyond the scene's [s], from this level on.
        jitter: Jitter of the conversions [s], from this level on.
    """

    name: str
    adds: str
    options: Mapping[str, Any] = MappingProxyType({})
    more_delay: float = 0.0
    jitter: float = 0.0


LEVELS: tuple[Level, ...] = (
    Level("axes", "six decoupled axes, in closed form", {"driver_lag": False}),
    Level("body", "rigid body with an ideal wrench", {"coils": False}),
    Level("coils", "six coils of fixed orientation, 10 A each", {"current_limit": Spec.peak_current.value}),
    Level("turning", "coils that turn with the flotor", {"coils": True}),
    Level("lag", "2 kHz drivers, as 80 µs of added delay", {}, _LAG),
    Level("falloff", "10 % force loss at the end of the range", {"force_falloff": 0.1}, _LAG),
    Level("steps", "sensor resolution of 5 µm and 10 µrad", {"sensor": Sensor(quantum=RESOLUTION)}, _LAG),
    Level("spots", "LED spots with 0.8 µm resolution, pose by Newton's method", {"sensor": _SPOTS}, _LAG),
    Level("jitter", "jitter of ±0.1 ms", {}, _LAG, _JITTER),
    Level("stops", "metal stops", {"stops": True}, _LAG, _JITTER),
    Level("filter", "driver lag as a first-order filter", {"driver_lag": True}, 0.0, _JITTER),
    Level("flexible", "handle that vibrates at 1 kHz", {"flexible": True}, 0.0, _JITTER),
)
"""Model levels in order, each including those below."""


class LevelMotion(NamedTuple):
    """Motion of one run.

    Attributes:
        pose: Pose at the samples [m, rad], (K, 6).
        twist: Velocity at the samples [m/s, rad/s], (K, 6).
        peak_force: Largest force commanded along an axis, after the limits [N].
        met_stops: True if a metal stop of the model acted.
        seconds: Computing time of the run [s].
    """

    pose: Array
    twist: Array
    peak_force: float
    met_stops: bool
    seconds: float


def level_index(level: str) -> int:
    """Return the number of levels below one.

    Raises:
        ParameterError: If there is no such level.
    """
    names = [each.name for each in LEVELS]
    check_one_of("level", names, level)
    return names.index(level)


def options_of(level: str, device: Device) -> dict[str, Any]:
    """Return the keywords of a device's plant on a level, without what it does not have.

    Raises:
        ParameterError: If there is no such level.
    """
    options: dict[str, Any] = {}
    for each in LEVELS[: level_index(level) + 1]:
        options |= each.options
    if device.published:
        return options
    coils, own = device.coils, dict[str, Any](sensor=_sensor(device))
    if coils is not None:
        own |= {"current_limit": coils.current_limit, "force_falloff": options.get("force_falloff")}
    own |= {"coils": options.get("coils") if coils is not None else False}
    own |= {"driver_lag": options["driver_lag"] and device.driver.time_constant > 0.0}
    own |= {"stops": True} if device.range.stops else {}
    return {name: own[name] for name in options if name in own}


@cache  # levels are compared by it
def _sensor(device: Device) -> Sensor:
    return Sensor(quantum=device.sensor.resolution)


def exact_options(level: str, device: Device) -> dict[str, Any]:
    """Return the exact plant's keywords nearest to a level.

    They cover the limit along z, the sensor's steps and the drivers' filter.

    Raises:
        ParameterError: If there is no such level.
    """
    options, near = options_of(level, device), dict[str, Any]()
    if "current_limit" in options:
        near["wrench_limit"] = [math.inf, math.inf, body_of(device.keywords).force_limit] + [math.inf] * 3
    if "sensor" in options:
        near["sensor"] = _sensor(device)
    near["driver_lag"] = options["driver_lag"]
    return near


def step_of(scene: Scene, level: str) -> float:
    """Return a level's default longest step in a scene [s].

    It is the period if nothing needs a shorter step.
    """
    option = scene.plant_options().get("longest_step")
    limit = option("mujoco") if callable(option) else option
    needs = {name: value for name, value in options_of(level, scene.hardware).items() if name in _SHORTEN}
    needed = step_needed(hand=_hand_of(scene), **needs)
    return min(bound for bound in (needed, limit, scene.period) if bound is not None)


def _hand_of(scene: Scene) -> Hand | None:
    hand: Hand | None = scene.plant_options().get("hand") or getattr(scene.scripted_hand(), "hand", None)
    return hand


def loop_of(scene: Scene, level: str) -> LoopArray:
    """Return a wall's sampled loop on a level.

    Timing, mass and hand are the scene's; the drivers are the level's.

    Force falloff, jitter and the handle's swing are not included.

    Raises:
        ParameterError: If there is no such level, or the delay is more than 10 periods.
    """
    device = scene.hardware
    return Loop(
        stiffness=0.0,
        damping=0.0,
        period=scene.period,
        delay=scene.delay + _more_delay(LEVELS[level_index(level)], device),
        inertia=float(scene.body.inertia[2]),
        hand=_hand_of(scene),
        driver_lag=device.driver.time_constant if options_of(level, device)["driver_lag"] else 0.0,
    ).array()


def _more_delay(level: Level, device: Device) -> float:
    return device.driver.time_constant if level.more_delay else 0.0


def timing_of(level: Level, timing: Timing, seed: int, device: Device) -> Timing:
    """Return a scene's timing on a level.

    The jitter is reduced to fit within delay and period.
    """
    delay = timing.delay + _more_delay(level, device)
    rest = Timing(period=timing.period, delay=delay).rest
    jitter = min(level.jitter, rest, timing.period - rest)
    return replace(timing, delay=delay, jitter=jitter, seed=seed)


def level_parts(
    scene: Scene,
    level: str,
    *,
    phase: float = 0.0,
    integrator: str = "rk4",
    longest_step: float | None = None,
    seed: int = 0,
    **keywords: Any,
) -> tuple[SampledPlant, Controller, int]:
    """Return plant, controller and sample count on a level.

    Args:
        scene: The scene.
        level: Name from LEVELS.
        phase: Phase of the samples, in [0, 1).
        integrator: One of `INTEGRATORS`; the lowest level has none.
        longest_step: Longest step [s]; None for that of the level.
        seed: Seed of the jitter.
        keywords: Plant keywords that override those of scene and level.

    Raises:
        ParameterError: If there is no such level.
    """
    options, index = options_of(level, scene.hardware), level_index(level)

    def make(timing: Timing, **options: Any) -> SampledPlant:
        bound = options.pop("longest_step", None)
        if index == 0:
            return ExactPlant(timing, **options)
        if longest_step is not None or bound is not None:
            options["longest_step"] = step_of(scene, level) if longest_step is None else longest_step
        return MuJoCoPlant(timing, integrator=integrator, **options)

    timing = scene.timing(phase)
    plant = scene.plant(
        make,
        phase=phase,
        timing=timing_of(LEVELS[index], timing, seed, scene.hardware),
        **options | {"record": False} | keywords,
    )
    return plant, scene.controller(), scene.ticks(timing)


def motion_of(plant: SampledPlant, controller: Controller, ticks: int) -> LevelMotion:
    """Run a scene's parts; return its true motion.

    The motion is that at the samples.
    """
    states: list[tuple[Array, Array]] = []
    forces: list[Array] = []

    def observe(_: Sample, command: Command) -> None:
        states.append(plant.state())
        forces.append(np.maximum(np.abs(command.wrench), np.abs(command.wrench + command.pulse)))

    start = time.perf_counter()
    drive(plant, controller, ticks, observe=observe)
    seconds = time.perf_counter() - start
    states.append(plant.state())
    pose, twist = (np.array(part) for part in zip(*states, strict=True))
    met_stops = isinstance(plant, MuJoCoPlant) and plant.met_stops
    return LevelMotion(pose, twist, float(np.max(forces, axis=0)[:3].max()), met_stops, seconds)


def apart(one: Array, other: Array, device: Device) -> Array:
    """Return the largest coil displacement between two motions of a device [m], (...,), from poses (K, ..., 6)."""
    difference = one - other
    moved, turned = (np.linalg.norm(part, axis=-1) for part in (difference[..., :3], difference[..., 3:]))
    return np.asarray((moved + device.coil_radius * turned).max(axis=0))


@dataclass(frozen=True, kw_only=True, eq=False)
class _SteppedLoop(LoopArray):
    """Sampled loop with the flotor moved by an integrator.

    The map of one step is measured on the drop model along z, without gravity; the rest is the exact loop.

    Args:
        integrator: One of `INTEGRATORS`.
        step: Longest time step [s].
        aligned: True ends a step at each switch of the force, in equal steps; False uses a fixed step, and a new
            command acts from the first step that begins after its time, as in a plain simulation loop.
    """

    integrator: str = "rk4"
    step: float = 1e-3
    aligned: bool = True

    @cached_property
    def flotor(self) -> tuple[Array, Array, Array, Array, int]:
        """See `LoopArray`."""
        if self.mode is not None or np.any(self.own_damping):
            raise ParameterError("a stepped loop must have neither own_damping nor mode: its model has none")
        period, delay = float(np.asarray(self.period)), float(np.asarray(self.delay))
        longest = number("step", self.step, above=0.0, at_most=period)
        whole, rest = map(float, split_delay(delay, period))
        if self.aligned:
            before = max(math.ceil(rest / longest - 1e-9), 0)
            after = max(math.ceil((period - rest) / longest - 1e-9), 0)
            first = rest / before if before else longest
            second = (period - rest) / after if after else longest
        else:
            steps = math.ceil(period / longest - 1e-9)
            first = second = period / steps
            before = math.ceil(rest / first - 1e-9)
            after = steps - before
        early, held = self._steps(first, before)
        late, new = self._steps(second, after)
        phi, old = late @ early, late @ held
        if self.integrator == "corrected":  # the position is corrected by half a step of the speed change
            half = 0.25 if self.driver_lag else 0.5  # a lagging step has two halves
            new = new - half * second * new[1] * _PLACE[: len(new)]
            old = old - half * (first * held[1] + second * (old[1] - held[1])) * _PLACE[: len(old)]
            before_it = np.eye(len(phi))[1]
            gained = first * (early[1] - before_it) + second * (phi[1] - early[1])
            phi = phi - half * np.outer(_PLACE[: len(phi)], gained)
        return phi, old, new, np.asarray(whole), int(whole) + int(before > 0)

    def _steps(self, step: float, count: int) -> tuple[Array, Array]:
        """Return the transition of several steps and the force's share.

        The force acts throughout the steps.
        """
        return _steps(
            self.integrator, float(np.asarray(self.mass)), step, count, self.hand, float(np.asarray(self.driver_lag))
        )


_PLACE = np.eye(5)[0]


@lru_cache(maxsize=256)
def _steps(integrator: str, mass: float, step: float, count: int, hand: Hand | None, lag: float) -> tuple[Array, Array]:
    one, push = one_step(integrator, mass, step, hand, lag)
    total, share = np.eye(len(push)), np.zeros(len(push))
    for _ in range(count):
        total, share = one @ total, one @ share + push
    return total, share


def boundary_shift(integrator: str, step: float, loop: LoopArray, *, aligned: bool = True) -> float:
    """Return the relative shift of the stiffest wall.

    It is the shift by an integrator and its step.

    Args:
        integrator: As for `_SteppedLoop`; 0 for "exact" and "closed form".
        step: Longest time step [s].
        loop: The loop itself: period, delay, mass, hand and lag of the model's drivers.
        aligned: See `_SteppedLoop`.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    if integrator in ("exact", "closed form"):
        return 0.0
    around = {one.name: getattr(loop, one.name) for one in fields(LoopArray) if one.init}
    stepped = _SteppedLoop(**around, integrator=integrator, step=step, aligned=aligned)
    return float(stiffest_of(stepped).stiffness) / _stiffest(loop) - 1.0


@lru_cache(maxsize=16)
def _stiffest(loop: LoopArray) -> float:
    return float(stiffest_of(loop).stiffness)


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
    count = whole("phases", phases, at_least=1, at_most=_MOST_PHASES)
    share = number("around", around, at_least=0.0, at_most=0.5)
    gains = [(1.0, 1.0)]
    if has_gains(scene) and share:
        gains += [(k, b) for k in (1.0 - share, 1.0 + share) for b in (1.0 - share, 1.0 + share)]
    shifted = [(phase + index / count) % 1.0 for index in range(count)]
    return tuple(Case(at, seed, *pair) for seed, (pair, at) in enumerate(itertools.product(gains, shifted)))


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
    points = (start + np.outer(np.arange(count), _SPREAD)) % 1.0
    return tuple(
        Case(float(phase), seed + index, 1.0 + share * (2.0 * float(k) - 1.0), 1.0 + share * (2.0 * float(b) - 1.0))
        for index, (phase, k, b) in enumerate(points)
    )


def scene_at(scene: Scene, case: Case) -> tuple[Scene, float]:
    """Return the scene of a case, and its phase."""
    phase = case.phase if scene.takes_phase else 0.0
    if not has_gains(scene):
        return scene, phase
    gains = {name: getattr(scene, name) * getattr(case, name) for name in ("stiffness", "damping")}
    return scene.replace(**gains), phase


def run_case(scene: Scene, level: str, case: Case, **options: Any) -> LevelMotion | None:
    """Run one case on a level; None if diverging."""
    with engine_warnings_silenced(), np.errstate(all="ignore"):  # a diverging run overflows before it is detected
        try:
            chosen, phase = scene_at(scene, case)
            return motion_of(*level_parts(chosen, level, phase=phase, seed=case.seed, **options))
        except (PlantError, SensingError):
            return None


def distance(one: LevelMotion | None, other: LevelMotion | None, device: Device) -> float:
    """Return the largest coil displacement between two motions of a device [m]; infinite if one diverged."""
    return math.inf if one is None or other is None else float(apart(one.pose, other.pose, device))


def run_together(points: Sequence[tuple[Scene, float]], level: str, seed: int) -> Array:
    """Run scenes as one batch of exact plants.

    Returns poses (K, N, 6), at the scenes' phases. The scenes differ in gains alone.

    Raises:
        ParameterError: If their laws differ in more than declared gains, or do not accept many devices at once.
    """
    stack = stacked_scenes(points)
    near = exact_options(level, stack.hardware) | {"longest_step": None, "escape": _FAR, "record": False}
    if stack.plant_options().get("wrench_limit") is not None:  # of the scene
        near.pop("wrench_limit", None)
    ticks = min(scene.ticks(scene.timing(phase)) for scene, phase in points)
    timing = timing_of(LEVELS[level_index(level)], stack.timing(), seed, stack.hardware)
    with np.errstate(all="ignore"), stack.plant("exact", timing=timing, **near) as plant:
        poses: list[Array] = []
        drive(plant, stack.controller(), ticks, observe=lambda *_: poses.append(plant.state()[0]))
        return np.array(poses)


def screen_levels(scene: Scene, around: float) -> Array:
    """Return each level's distance from those above it [m].

    (levels, cases): 4096 cases on the exact plant; 16 of a scene with neither gains nor phases to vary.

    The exact plant has the lag, the current limit along z, the sensor's steps and the jitter, for many devices at
    once. It lacks turning coils, falloff, spots, stops and the handle's swing. Rare jumps, of a sample that just meets
    the wall, show up here and not in a few cases of the whole device.

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
    except PlantError:  # one diverged case fails the batch
        return np.full((len(LEVELS), len(points) * _SEEDS), math.inf)


def _screen(points: Sequence[tuple[Scene, float]]) -> Array:
    device = points[0][0].hardware
    # the lowest level that the exact plant does not distinguish from each
    first = [
        next(index for index, below in enumerate(LEVELS) if _equal_on_exact(level, below, device)) for level in LEVELS
    ]
    motions: dict[int, Array] = {}
    distances = []
    for seed in range(_SEEDS):
        motions = {index: motion for index, motion in motions.items() if not LEVELS[index].jitter}
        for index in first:
            if index not in motions:
                motions[index] = run_together(points, LEVELS[index].name, seed)
        distances.append(_distances([motions[index] for index in first], device))
    return np.concatenate(distances, axis=1)


def _equal_on_exact(one: Level, other: Level, device: Device) -> bool:
    """Return True for two equal levels on the exact plant."""
    return (exact_options(one.name, device), *one[3:]) == (exact_options(other.name, device), *other[3:])


def _distances(motions: Sequence[Array], device: Device) -> Array:
    """Return each motion's largest distance from those above [m], (levels, N), from poses (K, N, 6)."""
    distances = np.zeros((len(motions), motions[0].shape[1]))
    for index, motion in enumerate(motions):
        different = {id(above): above for above in motions[index + 1 :] if above is not motion}
        distances[index] = np.max([apart(motion, above, device) for above in different.values()], axis=0, initial=0.0)
    return distances


Parts = tuple[SampledPlant, Controller, int]


def measure_costs(makers: Sequence[Callable[[], Parts]], seconds: Sequence[float], repeats: int) -> tuple[float, ...]:
    """Return each closed loop's cost per simulated second [s].

    The controller is included; see `median_times`.

    Args:
        makers: Functions that return plant, controller and number of samples.
        seconds: Time of an earlier run of each [s]; a long one is not repeated.
        repeats: Number of rounds.
    """
    quick = [index for index, duration in enumerate(seconds) if duration < _LONG]
    times = list(seconds)
    medians = median_times([partial(closed_loop, makers[index]) for index in quick], repeats)
    for index, median in zip(quick, medians, strict=True):
        times[index] = median
    simulated = [ticks * plant.period for plant, _, ticks in (make() for make in makers)]
    return tuple(cost / span for cost, span in zip(times, simulated, strict=True))


def closed_loop(make: Callable[[], Parts]) -> Callable[[], object]:
    """Return a closed loop of new parts, ready to run."""
    return partial(drive, *make())


def median_times(prepare: Sequence[Callable[[], Callable[[], object]]], repeats: int) -> tuple[float, ...]:
    """Return the computing time of each task [s].

    Medians over interleaved repeats, so that their ratios hold on a shared machine. A short task is timed several times
    per round after a warm-up run; a long task has two rounds only.

    Args:
        prepare: Functions that prepare a task, which is not timed, and return it.
        repeats: Number of rounds.
    """
    times: list[list[float]] = [[] for _ in prepare]
    for turn in range(repeats):
        for task_times, make in zip(times, prepare, strict=True):
            if turn > 1 and task_times[0] > _LONG:
                continue
            first = timeit(make(), number=1)
            repeated = range(min(math.ceil(_SHORT / first), 10))
            task_times += [first] if first > _LONG else [timeit(make(), number=1) for _ in repeated]
    return tuple(statistics.median(task_times) for task_times in times)
