"""Coverage of the intervals that `analyse` states.

The share that holds the truth, over recordings drawn at random.

Prints a table by quantity, writes every estimate to identification.json. Each recording is of a flotor that falls or is
drawn by an arm on a wall along z, and is drawn back and forth through friction along x; mass, delay, gravity, gains,
rate, noise and steps of the sensor, phase and seed are drawn from the ranges in `draw`. What the recording states of
mass and delay is wrong by up to 10 % and 0.3 periods.
"""

import argparse
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj import ExactPlant, Timing, Wall
from maglev_mj.analysis import Estimate, Identification, identify
from maglev_mj.control import Bias, StickSlip
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.plants.hand import HANDS, Hand, Trajectory
from maglev_mj.plants.sensor import Sensor
from maglev_mj.recording import MemoryFile, Segment, setup_of
from maglev_mj.recording.sample import mechanics
from maglev_mj.result import plain
from maglev_mj.spec import GRAVITY, INERTIA
from maglev_mj.theory import largest_stable_stiffness, stiffest_wall
from maglev_mj.versions import versions

MASS = INERTIA[0]
ARM = (HANDS["arm"][0], HANDS["arm"][1], 400.0)
"""Published mass, damping and stiffness of an arm: the stiffness is that of one that presses."""
_PULL, _TIME = 400.0, 1.0


@dataclass(frozen=True)
class Case:
    """Truth of one recording: SI units, as drawn."""

    rate: float
    delay: float
    stated_delay: float
    mass: float
    stiffness: float
    damping: float
    friction: float
    friction_damping: float
    breakaway: float
    noise: float
    quantum: float
    phase: float
    height: float
    arm: bool
    seed: int


def draw(seed: int) -> Case:
    """Return a case at random."""
    random = np.random.default_rng(seed)
    rate = float(random.choice([200.0, 400.0, 1000.0]))
    period = 1.0 / rate
    delay = float(random.uniform(0.0, 1.3)) * period
    mass = MASS * float(random.uniform(0.9, 1.1))
    arm = bool(random.integers(2))

    def gains(least: float, most: float) -> tuple[float, float]:
        """Return stiffness and damping of a stable wall."""
        damping = float(stiffest_wall(period=period, delay=delay, mass=mass).damping) * random.uniform(0.4, 1.0)
        largest = float(largest_stable_stiffness(damping, period=period, delay=delay, mass=mass))
        return min(largest * float(random.uniform(least, most)), 30e3), damping

    stiffness, damping = gains(0.1, 0.8)
    friction, friction_damping = gains(0.1, 0.4)
    sensor = 10.0 ** random.uniform(-6.5, -5.3, 2) * [(1, 1), (1, 0), (0, 1)][int(random.integers(3))]
    return Case(
        rate=rate,
        delay=delay,
        stated_delay=max(delay + float(random.uniform(-0.3, 0.3)) * period, 0.0),
        mass=mass,
        stiffness=stiffness,
        damping=damping,
        friction=friction,
        friction_damping=friction_damping,
        breakaway=float(random.uniform(0.5, 3.0)),
        noise=float(sensor[0]),
        quantum=float(sensor[1]),
        phase=float(random.uniform()),
        height=float(random.uniform(0.001, 0.004)),
        arm=arm,
        seed=seed,
    )


@dataclass(frozen=True)
class Draws:
    """A hand that moves along x, an arm along z: held between samples."""

    pull: float
    path: Trajectory

    def __call__(self, tick: int, time: Any, state: Any) -> list[float]:
        """See `HandForce`."""
        target, (pose, _) = self.path.at(float(time)), state()
        return [_PULL * (target[0] - float(pose[0])), 0.0, self.pull * target[2], 0.0, 0.0, 0.0]


def record(case: Case) -> tuple[Segment, Array]:
    """Return a recording of a case, and its stick positions."""
    period, reach, z = 1.0 / case.rate, 1e-3 + 2.0 * case.breakaway / _PULL, case.height
    arm = Hand(mass=ARM[0], damping=ARM[1], stiffness=ARM[2], axes="z") if case.arm else None
    down = -3.0 * (1.0 / case.stiffness + 1.0 / ARM[2])
    poses = [[(-1.0) ** turn * reach, 0.0, z if turn % 2 else down, 0.0, 0.0, 0.0] for turn in range(6)]
    path = Trajectory([0.0, *(0.15 * (turn + 1) for turn in range(6))], [[0.0, 0.0, z, 0.0, 0.0, 0.0], *poses])
    carried = [0.0, 0.0, MASS * GRAVITY if case.arm else 0.0, 0.0, 0.0, 0.0]
    friction = StickSlip(
        axes="x",
        stiffness=case.friction,
        damping=case.friction_damping,
        breakaway=case.breakaway,
        v_min=0.005 + 4.0 * max(case.noise, case.quantum) * case.rate,
    )
    wall = Wall(axes="z", lower=0.0, stiffness=case.stiffness, damping=case.damping)
    controller = Controller([friction, wall, Bias(carried)], period=period)
    sensor = Sensor(quantum=case.quantum, noise=[case.noise, 0.0, case.noise, 0.0, 0.0, 0.0], seed=case.seed)
    plant = ExactPlant(
        Timing(period=period, delay=case.delay, phase=case.phase),
        mass=case.mass,
        pose=[0.0, 0.0, z, 0.0, 0.0, 0.0],
        hand=arm,
        hand_force=Draws(ARM[2] if case.arm else 0.0, path),
        sensor=sensor,
        wrench=carried,
    )
    inertia = mechanics(plant)["inertia"] + np.array([MASS - case.mass] * 3 + [0.0] * 3)
    stated = {"inertia": inertia, "load": (0.0, 0.0, -MASS * GRAVITY, 0.0, 0.0, 0.0)}
    file = MemoryFile()
    keep = file.begin(plant, controller, setup_of(plant, controller, delay=case.stated_delay, **stated))
    anchors: list[Array] = []

    def look(sample: Sample, command: Command) -> None:
        anchors.append(np.array(controller.stick_positions))

    with plant:
        ControlLoop(plant, controller, record=keep, observe=look).cycle(round(_TIME * case.rate))
    (segment,) = file.recording.segments
    return segment, np.array(anchors)


def truth(case: Case) -> dict[str, float]:
    """Return the true values by the names of `estimates`."""
    moving = case.mass + (ARM[0] if case.arm else 0.0)
    stated = moving + MASS - case.mass
    most = float(largest_stable_stiffness(case.damping, period=1.0 / case.rate, delay=case.delay, mass=moving))
    return {
        "wall stiffness, rendered": case.stiffness * stated / moving,
        "wall damping, rendered": case.damping * stated / moving,
        "wall stiffness, commanded": case.stiffness,
        "wall damping, commanded": case.damping,
        "share of the largest stable stiffness": case.stiffness / most,
        "delay, from z": case.delay,
        "delay, from x": case.delay,
        "mass, from z": moving,
        "mass, from x": case.mass,
        "gravity compensation error": (MASS - case.mass) * GRAVITY,
        "noise, from z": case.noise,
        "noise, from x": case.noise,
        "quantum": case.quantum,
        "stick stiffness, rendered": case.friction * MASS / case.mass,
        "stick stiffness, commanded": case.friction,
        "breakaway": case.breakaway,
        "sliding friction": 0.0,
        "sliding damping": case.friction_damping,
    }


def estimates(identification: Identification) -> dict[str, Estimate]:
    """Return the identified values by name."""
    x, z, (wall,), rub = (
        identification.axes["x"],
        identification.axes["z"],
        identification.walls,
        identification.friction["x"],
    )
    values = (
        *(wall.stiffness, wall.damping, wall.commanded_stiffness, wall.commanded_damping, wall.share),
        *(z.delay, x.delay, z.inertia, x.inertia, z.force_error, z.noise, x.noise, z.quantum),
        *(rub.stiffness, rub.commanded_stiffness, rub.breakaway, rub.sliding, rub.damping),
    )
    return dict(zip(truth(draw(0)), values, strict=True))


def holds(one: Estimate, value: float) -> bool:
    """Return True if an interval holds the truth: one that is exact, to rounding."""
    near = 1e-9 * abs(value) + 1e-10
    return one.low - near <= value <= one.high + near


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", metavar="DIR", default="figures", type=Path, help="where files go (default figures)")
    parser.add_argument("--count", type=int, default=200, help="how many recordings")
    parser.add_argument("--first", type=int, default=5_000_000, help="seed of the first")
    options = parser.parse_args()
    rows: dict[str, list[tuple[bool, float, float]]] = {}
    missing: dict[str, list[str]] = {}
    data = []
    for seed in range(options.first, options.first + options.count):
        case = draw(seed)
        segment, anchors = record(case)
        estimated, true = estimates(identify(segment, anchors=anchors)), truth(case)
        data.append({"case": asdict(case), "estimates": plain(estimated)})
        for name, one in estimated.items():
            if one.known:
                off = abs(one.value - true[name])
                row = holds(one, true[name]), off / abs(true[name]) if true[name] else math.nan, one.standard_error
                rows.setdefault(name, []).append(row)
            else:
                missing.setdefault(name, []).append(one.why)
    print(f"{'quantity':<40}{'estimated':>11}{'hold the truth':>16}{'median off':>12}{'90 % off':>10}")
    for name in truth(draw(0)):
        kept = rows.get(name, [])
        if kept:
            apart = np.array([one[1] for one in kept])
            share = np.mean([one[0] for one in kept])
            far = (math.nan, math.nan) if np.isnan(apart).all() else np.nanquantile(apart, [0.5, 0.9])
            print(f"{name:<40}{len(kept):>11}{share:>15.1%} {far[0]:>11.2%}{far[1]:>10.2%}")
        for why in sorted(set(missing.get(name, []))):
            print(f"    {missing[name].count(why)} not: {why}")
    options.out.mkdir(parents=True, exist_ok=True)
    contents = {"versions": versions(), "recordings": data}
    (options.out / "identification.json").write_text(json.dumps(contents))


if __name__ == "__main__":
    main()
