"""Cost of the closed loop, bare steps, a hand-written loop.

`measure` is a section of bench.py; its times are medians of repeats in turn, its ratios medians of theirs pair by pair.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from maglev_mj import AXES, Controller, ExactPlant, Hold, MuJoCoPlant, Sample, Timing, Wall, drive
from maglev_mj.frames import components
from maglev_mj.spec import INERTIA, Spec
from maglev_mj.theory import largest_modulus
from peers import Task, mujoco_peer

REPEATS = 12
TICKS = 400
BATCH = 1000
TIMING = Timing()
START = [0.5e-3, -0.3e-3, Spec.translation_range.value, 0.0, 0.0, 0.0]
TASK = Task(ticks=TICKS)
BY_HAND = {variant.name: variant.build(TASK) for variant in mujoco_peer.variants() if variant.title}


def drop_controller() -> Controller:
    """Return the drop's controller: wall with pulse, hold."""
    wall = Wall(axes="z", lower=0.0, stiffness=6000, damping=80, pulse=220, pulse_width=0.003)
    others = [axis for axis in AXES if axis != "z"]
    hold = Hold.critically_damped(others, inertia=np.delete(INERTIA, 2), period=TIMING.period, delay=TIMING.delay)
    return Controller([wall, hold], period=TIMING.period)


def full_controller() -> Controller:
    """Return walls, pulses and holds on all six axes."""
    stiffness, damping = [6000.0] * 3 + [8.0] * 3, [80.0] * 3 + [0.1] * 3
    pulse = [220.0] * 3 + [0.2] * 3
    wall = Wall(lower=-1e-3, upper=1e-3, stiffness=stiffness, damping=damping, pulse=pulse, pulse_width=0.003)
    hold = Hold.critically_damped(inertia=INERTIA, period=TIMING.period, delay=TIMING.delay)
    return Controller([wall, hold], period=TIMING.period)


def samples(batch: tuple[int, ...], count: int) -> list[Sample]:
    """Return seeded motion that crosses all walls repeatedly."""
    random = np.random.default_rng(1)
    phase, speed = random.uniform(0, 6.28, (*batch, 6)), random.uniform(0.05, 0.3, (*batch, 6))
    poses = [1.3e-3 * np.sin(phase + speed * tick) for tick in range(count)]
    return [Sample(tick, tick * TIMING.period, components(pose)) for tick, pose in enumerate(poses)]


def timed(work: Callable[[], object]) -> float:
    """Return the time of one call [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def mujoco_loop(tilt: float = 0.0, **options: Any) -> float:
    """Return the time of a closed-loop tick on MuJoCo [s].

    For a flotor released at a tilt [rad].
    """
    plant = MuJoCoPlant(TIMING, pose=[*START[:3], tilt, tilt, tilt], **options)
    controller = drop_controller()
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
    """Return the tick time of a hand-written MuJoCo loop [s].

    As a careful user writes it, without any check.
    """
    return timed(BY_HAND[name]) / TASK.ticks


def exact_loop(batch: tuple[int, ...] = ()) -> float:
    """Return the exact plant's tick time, a device [s]."""
    pose = np.broadcast_to(START, (*batch, 6))
    plant = ExactPlant(TIMING, pose=pose)
    controller = drop_controller()
    return timed(lambda: drive(plant, controller, TICKS)) / TICKS / math.prod(batch)


def controller_tick(batch: tuple[int, ...], count: int) -> float:
    """Return the time of a controller tick, a device [s]."""
    controller, seen = full_controller(), samples(batch, count)
    return timed(lambda: [controller.step(sample) for sample in seen]) / count / math.prod(batch)


WORK: dict[str, Callable[[], float]] = {
    "RK4, coils: closed loop": mujoco_loop,
    "RK4, coils: bare steps": bare_steps,
    "RK4, coils, tilted: closed loop": lambda: mujoco_loop(tilt=0.01),
    "RK4, body: closed loop": lambda: mujoco_loop(coils=False),
    "RK4, body: bare steps": lambda: bare_steps(coils=False),
    "RK4, body: by hand": lambda: by_hand("split, RK4"),
    "corrected, body: closed loop": lambda: mujoco_loop(integrator="corrected", coils=False),
    "corrected, body: bare steps": lambda: bare_steps(coils=False, integrator="euler"),
    "corrected, body: by hand": lambda: by_hand("split, Euler, half-kick"),
    "corrected, body, 0.5 ms: closed loop": lambda: mujoco_loop(integrator="corrected", coils=False, longest_step=5e-4),
    "exact plant: closed loop": exact_loop,
    "exact plant, 1000 at once: closed loop": lambda: exact_loop((BATCH,)),
    "six-axis controller": lambda: controller_tick((), 1000),
    "six-axis controller, 1000 at once": lambda: controller_tick((BATCH,), 40),
}
RATIOS = (
    ("RK4, body", "by hand"),
    ("corrected, body", "by hand"),
    ("RK4, coils", "bare steps"),
    ("RK4, body", "bare steps"),
    ("corrected, body", "bare steps"),
)


def ended_apart(**options: Any) -> float:
    """Return the final distance from the exact plant [m, rad]."""
    ends = []
    for plant in (MuJoCoPlant(TIMING, pose=START, **options), ExactPlant(TIMING, pose=START)):
        drive(plant, drop_controller(), TICKS)
        ends.append(plant.state()[0])
    return float(np.abs(ends[0] - ends[1]).max())


def measure(quick: bool) -> dict[str, Any]:
    """Return times [µs], ratios over others, and errors [m].

    Args:
        quick: Few repeats, for a test.
    """
    times: dict[str, list[float]] = {name: [] for name in WORK}
    for _ in range(2 if quick else REPEATS):
        for name, work in WORK.items():
            times[name].append(work())
    pairs = {f"{kind}: over {other}": (f"{kind}: closed loop", f"{kind}: {other}") for kind, other in RATIOS}
    ratios = {name: float(np.median(np.divide(times[one], times[other]))) for name, (one, other) in pairs.items()}
    count = 100 if quick else 1000
    gains = np.linspace(1.0, 20000.0, count)[:, None], np.linspace(1.0, 200.0, count)
    moduli = timed(lambda: largest_modulus(*gains, period=TIMING.period, delay=TIMING.delay))
    return {
        "µs a tick and device": {name: statistics.median(values) * 1e6 for name, values in times.items()},
        "ratio": ratios,
        "error at the end (m)": {
            "RK4, coils": ended_apart(),
            "RK4, body": ended_apart(coils=False),
            "corrected, body": ended_apart(integrator="corrected", coils=False),
        },
        "µs a closed loop of the theory": moduli / count**2 * 1e6,
    }
