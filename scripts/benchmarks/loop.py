"""Cost of the closed loop, of the engine's bare steps, and of a hand-written loop.

`measure` is a section of bench.py; its times are medians of repeats in turn, its ratios medians of theirs pair by pair.
Each row counts the devices and ticks that it ran. All rows but bare steps and the controller alone are the same drop,
and must end in the same pose.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from maglev_mj import Controller, ExactPlant, Hold, MuJoCoPlant, Sample, Timing, Wall
from maglev_mj.frames import components
from maglev_mj.scenes.drop import Drop
from maglev_mj.spec import INERTIA, Spec
from peers import Task, mujoco_peer
from timing import Run, answered, columns, driven, in_turns, ratio, timed

REPEATS = 12
TICKS = 400
BATCH = 1000
EXACT = "exact plant: closed loop"
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


def mujoco_loop(**options: Any) -> Run:
    """Run the drop on MuJoCo."""
    return driven(MuJoCoPlant(TIMING, pose=START, **options), Drop().controller(), TICKS)


def bare_steps(**options: Any) -> Run:
    """Run the mj_step calls of as many ticks, without a controller."""
    model = MuJoCoPlant(TIMING, **options).device.model
    data = mujoco.MjData(model)
    model.opt.timestep = 0.5 * TIMING.period
    step = mujoco.mj_step

    def steps() -> None:
        for _ in range(2 * TICKS):  # old command, new command; the one or two pulses of a drop are not counted
            step(model, data)

    return Run(timed(steps), 1, round(data.time / TIMING.period), np.full(6, np.nan))


def by_hand(name: str) -> Run:
    """Run the drop in a MuJoCo loop as a careful user writes it, unchecked."""
    seconds, poses = answered(BY_HAND[name])
    return Run(seconds, 1, len(poses) - 1, poses[-1])


def exact_loop(batch: tuple[int, ...] = ()) -> Run:
    """Run the drop on the exact plant, on a batch of devices at once."""
    return driven(ExactPlant(TIMING, pose=np.broadcast_to(START, (*batch, 6))), Drop().controller(), TICKS)


def controller_tick(count: int) -> Run:
    """Run a controller alone on six axes."""
    controller, seen = full_controller(), samples(count)
    seconds, commands = answered(lambda: [controller.step(sample) for sample in seen])
    return Run(seconds, 1, len(commands), np.full(6, np.nan))


WORK: dict[str, Callable[[], Run]] = {
    "RK4, coils: closed loop": mujoco_loop,
    "RK4, coils: bare steps": bare_steps,
    "RK4, body: closed loop": lambda: mujoco_loop(coils=False),
    "RK4, body: bare steps": lambda: bare_steps(coils=False),
    "RK4, body: by hand": lambda: by_hand("split, RK4"),
    "corrected, body: closed loop": lambda: mujoco_loop(integrator="corrected", coils=False),
    "corrected, body: bare steps": lambda: bare_steps(coils=False, integrator="euler"),
    "corrected, body: by hand": lambda: by_hand("split, Euler, half-kick"),
    EXACT: exact_loop,
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


def compare_ends(runs: dict[str, Run]) -> None:
    """Hold the rows to each other.

    Raises:
        ValueError: If the drop of a row ends elsewhere than that of the exact plant [m, rad].
    """
    end = runs[EXACT].pose
    for name, run in runs.items():
        if np.nanmax(np.abs(run.pose - end), initial=0.0) > 1e-9:
            raise ValueError(f"{name}: its drop ends at {run.pose.tolist()}, not at {end.tolist()}")


def measure(quick: bool) -> dict[str, Any]:
    """Return times [µs], ratios over others, devices and ticks; quick for a test."""
    runs = in_turns(WORK, 2 if quick else REPEATS)
    times = {name: [run.each for run in some] for name, some in runs.items()}
    last = {name: some[-1] for name, some in runs.items()}
    compare_ends(last)
    pairs = {f"{kind}: over {other}": (f"{kind}: closed loop", f"{kind}: {other}") for kind, other in RATIOS}
    pairs["exact plant, 1000 at once: over one alone"] = "exact plant, 1000 at once: closed loop", EXACT
    return {
        **columns(runs),
        "ratio": {name: ratio(times[one], times[other]) for name, (one, other) in pairs.items()},
    }
