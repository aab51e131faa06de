"""What the closed loop costs, as ratios in one run: absolute times mean little on a shared machine.

Everything is timed in turn, many times over, and the medians are compared.
"""

import math
import statistics
import sys
import time
from collections.abc import Callable

import mujoco
import numpy as np

from maglev_mj import AXES, Controller, ExactPlant, Hold, MuJoCoPlant, Sample, Timing, Wall, run
from maglev_mj.frames import components
from maglev_mj.stability import largest_modulus

REPEATS = 15 if "--quick" in sys.argv else 60
TICKS = 400
BATCH = 1000
TIMING = Timing(period=0.005, delay=0.0015)


def drop_controller() -> Controller:
    """Return the drop's controller: a wall with a pulse along z, a hold on the five other axes."""
    wall = Wall(axes="z", lower=0.0, stiffness=6000, damping=80, pulse=220, pulse_width=0.003)
    others = [axis for axis in AXES if axis != "z"]
    inertia = [0.7, 0.7, 9e-4, 9e-4, 9e-4]
    hold = Hold.critically_damped(others, inertia=inertia, period=TIMING.period, delay=TIMING.delay)
    return Controller([wall, hold], period=TIMING.period)


def full_controller() -> Controller:
    """Return a wall on both sides, a pulse and a hold on each of the six axes."""
    stiffness, damping = [6000.0] * 3 + [8.0] * 3, [80.0] * 3 + [0.1] * 3
    pulse = [220.0] * 3 + [0.2] * 3
    wall = Wall(lower=-1e-3, upper=1e-3, stiffness=stiffness, damping=damping, pulse=pulse, pulse_width=0.003)
    inertia = [0.7] * 3 + [9e-4] * 3
    return Controller([wall, Hold.critically_damped(inertia=inertia, period=0.005, delay=0.0015)], period=0.005)


def samples(batch: tuple[int, ...], count: int) -> list[Sample]:
    """Return smooth seeded motion that crosses the walls of `full_controller` again and again."""
    random = np.random.default_rng(1)
    phase, speed = random.uniform(0, 6.28, (*batch, 6)), random.uniform(0.05, 0.3, (*batch, 6))
    poses = [1.3e-3 * np.sin(phase + speed * tick) for tick in range(count)]
    return [Sample(tick, tick * 0.005, components(pose)) for tick, pose in enumerate(poses)]


def timed(work: Callable[[], object]) -> float:
    """Return how long one call takes [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def mujoco_loop(tilt: float = 0.0) -> float:
    """Return the time of one tick of the closed loop on MuJoCo [s], for a flotor released at a tilt [rad]."""
    plant = MuJoCoPlant(TIMING, pose=[0, 0, 0.0045, tilt, tilt, tilt])
    controller = drop_controller()
    return timed(lambda: run(plant, controller, TICKS)) / TICKS


def bare_steps() -> float:
    """Return the time of as many mj_step calls as one tick of the closed loop makes [s]."""
    model = MuJoCoPlant(TIMING).device.model
    data = mujoco.MjData(model)
    model.opt.timestep = 0.5 * TIMING.period
    step = mujoco.mj_step

    def steps() -> None:
        for _ in range(2 * TICKS):  # old command, new command; the one or two pulses of a drop are not counted
            step(model, data)

    return timed(steps) / TICKS


def exact_loop(batch: tuple[int, ...] = ()) -> float:
    """Return the time of one tick of the closed loop on the exact plant, for each device [s]."""
    pose = np.zeros((*batch, 6))
    pose[..., 2] = 0.0045
    plant = ExactPlant(TIMING, pose=pose)
    controller = drop_controller()
    return timed(lambda: run(plant, controller, TICKS)) / TICKS / math.prod(batch)


def controller_tick(batch: tuple[int, ...], count: int) -> float:
    """Return the time of one controller tick on all six axes, for each device [s]."""
    controller, seen = full_controller(), samples(batch, count)
    return timed(lambda: [controller.step(sample) for sample in seen]) / count / math.prod(batch)


WORK: dict[str, Callable[[], float]] = {
    "closed loop, MuJoCo": mujoco_loop,
    "bare mj_step, as many": bare_steps,
    "closed loop, MuJoCo, released tilted": lambda: mujoco_loop(0.01),
    "closed loop, exact plant": exact_loop,
    f"closed loop, exact plant, {BATCH} at once": lambda: exact_loop((BATCH,)),
    "six-axis tick, wall + pulse + hold": lambda: controller_tick((), 1000),
    f"six-axis tick, {BATCH} at once": lambda: controller_tick((BATCH,), 40),
}


def main() -> None:
    """Time everything in turn and print medians and ratios."""
    times: dict[str, list[float]] = {name: [] for name in WORK}
    for _ in range(REPEATS):
        for name, work in WORK.items():
            times[name].append(work())
    medians = {name: statistics.median(values) * 1e6 for name, values in times.items()}
    print(f"medians of {REPEATS} interleaved repeats; a tick is {TIMING.period * 1e3:g} simulated ms")
    for name, median in medians.items():
        print(f"  {name:<44}{median:9.3f} µs a tick and device")
    loop, bare, tilted, exact, batch, tick, tick_batch = (np.array(values) for values in times.values())
    print("medians of the ratios, pair by pair")
    print(f"  MuJoCo closed loop / bare steps             {np.median(loop / bare):9.2f}   (at most 1.5)")
    print(f"  the same, tilted: the coils' map each tick  {np.median(tilted / bare):9.2f}")
    print(f"  MuJoCo closed loop / exact plant            {np.median(loop / exact):9.2f}")
    print(f"  MuJoCo closed loop / exact batch, a device  {np.median(loop / batch):9.1f}   (at least 30)")
    print(f"  six-axis tick                               {np.median(tick) * 1e6:9.2f} µs (at most 10)")
    print(f"  six-axis tick, batch, a device              {np.median(tick_batch) * 1e6:9.3f} µs (at most 1)")
    count = 100 if "--quick" in sys.argv else 1000
    gains = np.linspace(1.0, 20000.0, count)[:, None], np.linspace(1.0, 200.0, count)
    whole = timed(lambda: largest_modulus(*gains, period=TIMING.period, delay=TIMING.delay))
    print(f"  modulus of {count**2:>7} closed loops             {whole:9.2f} s  (a million: at most 10)")


if __name__ == "__main__":
    main()
