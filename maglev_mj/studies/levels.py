"""Model levels, from six decoupled axes to the whole device.

Each level includes all below it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import check_one_of
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.hand import Hand
from maglev_mj.loop import drive
from maglev_mj.model import load_model
from maglev_mj.plants import ExactPlant, MuJoCoPlant, SampledPlant, Sensor, SpotSensor, Timing
from maglev_mj.plants.engine import longest_step as step_needed
from maglev_mj.scenes.scene import Scene
from maglev_mj.spec import DRIVER_TIME_CONSTANT, RESOLUTION, Spec
from maglev_mj.theory.closed_loop import SampledLoop

_JITTER = 1e-4
_LAG = DRIVER_TIME_CONSTANT
_SHORTEN = ("driver_lag", "stops", "force_falloff", "flexible")  # options that need shorter steps
_STEPS, _SPOTS = Sensor(quantum=RESOLUTION), SpotSensor(quantum=Spec.spot_resolution.value)


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
    Level("axes", "six decoupled axes, in closed form"),
    Level("body", "a rigid body with an ideal wrench", {"coils": False}),
    Level("coils", "six coils that do not turn, 10 A each", {"current_limit": Spec.peak_current.value}),
    Level("turning", "coils that turn with the flotor", {"coils": True}),
    Level("lag", "drivers of 2 kHz, as 80 µs more of delay", {}, _LAG),
    Level(
        "falloff",
        "a tenth of the force lost at the end of the range",
        {"force_falloff": 0.1},
        _LAG,
    ),
    Level("steps", "a sensor of 5 µm and 10 µrad", {"sensor": _STEPS}, _LAG),
    Level(
        "spots",
        "LEDs and diodes of 0.8 µm, the pose by Newton",
        {"sensor": _SPOTS},
        _LAG,
    ),
    Level("jitter", "conversions that vary by 0.1 ms either way", {}, _LAG, _JITTER),
    Level("stops", "metal stops", {"stops": True}, _LAG, _JITTER),
    Level("filter", "the drivers' lag as the filter that it is", {"driver_lag": True}, 0.0, _JITTER),
    Level(
        "flexible",
        "a handle that swings at 1 kHz",
        {"flexible": True},
        0.0,
        _JITTER,
    ),
)
"""Model levels in order, each including those below."""


class Motion(NamedTuple):
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


def options_of(level: str) -> dict[str, Any]:
    """Return the keywords of the plant on a level.

    Raises:
        ParameterError: If there is no such level.
    """
    options: dict[str, Any] = {}
    for each in LEVELS[: level_index(level) + 1]:
        options |= each.options
    return options


def exact_options(level: str) -> dict[str, Any]:
    """Return the exact plant's keywords nearest to a level.

    They cover the limit along z, the sensor's steps and the drivers' filter.

    Raises:
        ParameterError: If there is no such level.
    """
    options, near = options_of(level), dict[str, Any]()
    if "current_limit" in options:
        near["wrench_limit"] = [math.inf, math.inf, Spec.largest_vertical_force.value] + [math.inf] * 3
    if "sensor" in options:
        near["sensor"] = _STEPS
    if "driver_lag" in options:
        near["driver_lag"] = True
    return near


def step_of(scene: Scene, level: str) -> float:
    """Return a level's default longest step in a scene [s].

    It is the period if nothing needs a shorter step.
    """
    own = scene.plant_options().get("longest_step")
    asked = own("mujoco") if callable(own) else own
    needs = {name: value for name, value in options_of(level).items() if name in _SHORTEN}
    needed = step_needed(load_model("drop"), hand=_hand_of(scene), **needs)
    return min(bound for bound in (needed, asked, scene.period) if bound is not None)


def _hand_of(scene: Scene) -> Hand | None:
    hand: Hand | None = scene.plant_options().get("hand") or getattr(scene.scripted_hand(), "hand", None)
    return hand


def loop_of(scene: Scene, level: str) -> SampledLoop:
    """Return a wall's sampled loop on a level.

    Timing, mass and hand are the scene's; the drivers are the level's.

    Force falloff, jitter and the handle's swing are not included.

    Raises:
        ParameterError: If there is no such level, or the delay is more than 10 periods.
    """
    lags = "driver_lag" in options_of(level)
    return SampledLoop(
        period=scene.period,
        delay=scene.delay + LEVELS[level_index(level)].more_delay,
        mass=scene.plant_options().get("mass", Spec.moving_mass.value),
        hand=_hand_of(scene),
        driver_lag=_LAG if lags else 0.0,
    )


def timing_of(level: Level, timing: Timing, seed: int) -> Timing:
    """Return a scene's timing on a level.

    The jitter is reduced if delay and period leave no room for it.
    """
    delay = timing.delay + level.more_delay
    rest = Timing(period=timing.period, delay=delay).rest
    jitter = min(level.jitter, rest, timing.period - rest)
    return Timing(period=timing.period, delay=delay, phase=timing.phase, jitter=jitter, seed=seed)


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
        keywords: Further keywords of the plant, in place of the scene's and the level's.

    Raises:
        ParameterError: If there is no such level.
    """
    options, index = options_of(level), level_index(level)

    def make(timing: Timing, **given: Any) -> SampledPlant:
        bound = given.pop("longest_step", None)
        if index == 0:
            return ExactPlant(timing, **given)
        if longest_step is not None or bound is not None:
            given["longest_step"] = step_of(scene, level) if longest_step is None else longest_step
        return MuJoCoPlant(timing, integrator=integrator, **given)

    timing = scene.timing(phase)
    plant = scene.plant(
        make,
        phase=phase,
        timing=timing_of(LEVELS[index], timing, seed),
        **options | {"record": False} | keywords,
    )
    return plant, scene.controller(), scene.ticks(timing)


def motion_of(plant: SampledPlant, controller: Controller, ticks: int) -> Motion:
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
    taken = time.perf_counter() - start
    states.append(plant.state())
    pose, twist = (np.array(part) for part in zip(*states, strict=True))
    met = isinstance(plant, MuJoCoPlant) and plant.met_stops
    return Motion(pose, twist, float(np.max(forces, axis=0)[:3].max()), met, taken)


def apart(one: Array, other: Array) -> Array:
    """Return the largest coil displacement between two motions [m].

    (...,), from poses (K, ..., 6).
    """
    difference = one - other
    moved, turned = (np.linalg.norm(part, axis=-1) for part in (difference[..., :3], difference[..., 3:]))
    return np.asarray((moved + Spec.coil_radius.value * turned).max(axis=0))
