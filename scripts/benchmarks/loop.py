"""Cost of the closed loop, of the engine's bare steps, and of a hand-written loop.

`measure` is a section of bench.py; its times are medians of repeats in turn, its ratios medians of theirs pair by pair.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from maglev_mj import Controller, ExactPlant, Hold, MuJoCoPlant, Sample, Timing, Wall, drive
from maglev_mj.frames import components
from maglev_mj.scenes.drop import Drop
from maglev_mj.spec import INERTIA, Spec
from peers import Task, mujoco_peer
from timing import in_turns, medians, ratio, timed

REPEATS = 12
TICKS = 400
BATCH = 1000
TIMING = Timing()
START = [0.5e-3, -0.3e-3, Spec.translation_range.value, 0.0, 0.0, 0.0]
TASK = Task(ticks=TICKS)
BY_HAND = {variant.name: variant.build(TASK) for variant in mujoco_peer.variants() if variant.title}


def full_controller() -> Controller:
    """Return walls, pulses and holds on all six axes."""
    stiffness, damping = [6000.0] * 3 + [8.0] * 3, [80.0] * 3 + [0.1] * 3
    pulse = [220.0] * 3 + [0.2] * 3
    wall = Wall(lower=-1e-3, upper=1e-3, stiffness=stiffness, damping=damping, pulse=pulse, pulse_width=0.003)
    hold = Hold.critically_damped(inertia=INERTIA, period=TIMING.period, delay=TIMING.delay)
    return Controller([wall, hold], period=TIMING.period)


def samples(count: int) -> list[Sample]:
    """Return seeded motion that crosses all walls repeatedly."""
    random = np.random.default_rng(1)
    phase, speed = random.uniform(0, 6.28, 6), random.uniform(0.05, 0.3, 6)
    poses = [1.3e-3 * np.sin(phase + speed * tick) for tick in range(count)]
    return [Sample(tick, tick * TIMING.period, components(pose)) for tick, pose in enumerate(poses)]


def mujoco_loop(**options: Any) -> float:
    """Return the time of a closed-loop tick on MuJoCo [s]."""
    plant, controller = MuJoCoPlant(TIMING, pose=START, **options), Drop().controller()
    return timed(lambda: drive(plant, controller, TICKS)) / TICKS


def bare_steps(**options: Any) -> float:
    """Return the time of a tick's mj_step calls [s]."""
    model = MuJoCoPlant(TIMING, **options).device.model
    data = mujoco.MjData(model)
    model.opt.timestep = 0.5 * TIMING.period
    step = mujoco.mj_step

    def steps() -> None:
        for _ in range(2 * TICKS):  # old command, new command; the one or two pulses of a drop are not counted
            step(model, data)

    return timed(steps) / TICKS


def by_hand(name: str) -> float:
    """Return the tick time of a MuJoCo loop as a careful user writes it, unchecked [s]."""
    return timed(BY_HAND[name]) / TASK.ticks


def exact_loop(batch: tuple[int, ...] = ()) -> float:
    """Return the exact plant's tick time, a device [s]."""
    plant, controller = ExactPlant(TIMING, pose=np.broadcast_to(START, 6)), Drop().controller()
    return timed(lambda: drive(plant, controller, TICKS)) / TICKS / math.prod(batch)


def controller_tick(count: int) -> float:
    """Return the time of a controller tick on six axes [s]."""
    controller, seen = full_controller(), samples(count)
    return timed(lambda: [controller.step(sample) for sample in seen]) / count


WORK: dict[str, Callable[[], float]] = {
    "RK4, coils: closed loop": mujoco_loop,
    "RK4, coils: bare steps": bare_steps,
    "RK4, body: closed loop": lambda: mujoco_loop(coils=False),
    "RK4, body: bare steps": lambda: bare_steps(coils=False),
    "RK4, body: by hand": lambda: by_hand("split, RK4"),
    "corrected, body: closed loop": lambda: mujoco_loop(integrator="corrected", coils=False),
    "corrected, body: bare steps": lambda: bare_steps(coils=False, integrator="euler"),
    "corrected, body: by hand": lambda: by_hand("split, Euler, half-kick"),
    "exact plant: closed loop": exact_loop,
    "exact plant, 1000 at once: closed loop": lambda: exact_loop((BATCH,)),
    "six-axis controller": lambda: controller_tick(1000),
}
RATIOS = (
    ("RK4, body", "by hand"),
    ("corrected, body", "by hand"),
    ("RK4, coils", "bare steps"),
    ("RK4, body", "bare steps"),
    ("corrected, body", "bare steps"),
)


def measure(quick: bool) -> dict[str, Any]:
    """Return times [µs] and ratios over others; quick for a test."""
    times = in_turns(WORK, 2 if quick else REPEATS)
    pairs = {f"{kind}: over {other}": (f"{kind}: closed loop", f"{kind}: {other}") for kind, other in RATIOS}
    return {
        "µs a tick and device": medians(times, 1e6),
        "ratio": {name: ratio(times[one], times[other]) for name, (one, other) in pairs.items()},
    }
