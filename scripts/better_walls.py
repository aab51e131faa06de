"""Walls better than PD: what stiffness each design reaches, with its model right, wrong by 20 %, and under hands.

Prints three tables, writes every figure to better_walls.json. Figures are the best over the gains of the least
dynamic stiffness, the force a hand needs at least for each metre at any frequency; 0 where the loop is unstable.
"""

import argparse
import itertools
import json
from pathlib import Path

import numpy as np

from maglev_mj import ExactPlant, Timing, Wall, run
from maglev_mj.controller import Controller
from maglev_mj.experiments.failures import hum
from maglev_mj.frames import Array
from maglev_mj.hand import HANDS, hand_called
from maglev_mj.laws import Law, ObserverWall, PassivityController, PredictiveWall
from maglev_mj.sampled import Design, rendered_stiffness
from maglev_mj.stability import least_dynamic_stiffness, stiffest_wall

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("folder", nargs="?", default="figures", type=Path, help="where files go")
parser.add_argument("--quick", action="store_true", help="a coarser search, fewer cases")
options = parser.parse_args()
folder = options.folder
folder.mkdir(parents=True, exist_ok=True)

PERIOD, MASS = 0.005, 0.7
SIZES = (5,) if options.quick else (40, 12, 12, 12)


def observer_wall(delay: float, pole: float, disturbance: bool, *, stiffness: float, damping: float) -> ObserverWall:
    """Return the wall whose model has the nominal mass and delay."""
    return ObserverWall(
        axes="z",
        stiffness=stiffness,
        damping=damping,
        inertia=MASS,
        period=PERIOD,
        delay=delay,
        pole=pole,
        disturbance=disturbance,
    )


def observer(delay: float, pole: float, disturbance: bool) -> Design:
    """Return the same as a design, for any gains."""
    law = observer_wall(delay, pole, disturbance, stiffness=1.0, damping=1.0)
    return lambda stiffness, damping, period: law.linear(stiffness, damping)


CASES = {
    "nominal": [(1.0, 1.0, "none")],
    "wrong_by_20_percent": [(mass, late, "none") for mass in (0.8, 1.0, 1.2) for late in (0.8, 1.0, 1.2)],
    "under_hands": [(1.0, 1.0, hand) for hand in HANDS],
}
if options.quick:
    CASES = {name: cases[-1:] for name, cases in CASES.items()}
CASES["all"] = CASES["wrong_by_20_percent"] + CASES["under_hands"]


def worst(case: str, delay: float, design: Design | None, stiffness: Array, damping: Array) -> Array:
    """Return the least of the least dynamic stiffnesses over mass and delay off by factors, and hands."""
    reached = [
        least_dynamic_stiffness(
            stiffness,
            damping,
            period=PERIOD,
            delay=late * delay,
            mass=mass * MASS,
            hand=hand_called(hand),
            design=design,
        )
        for mass, late, hand in CASES[case]
    ]
    return np.asarray(np.minimum.reduce(reached))


def best(case: str, delay: float, design: Design | None) -> tuple[float, float, float]:
    """Return the best worst case over the gains, and the gains: a grid, then finer ones around the best of it."""
    (low, high), (least, most) = (300.0, 110000.0), (5.0, 280.0)
    figure, gains = 0.0, (low, least)
    for size in SIZES:
        stiffness, damping = np.geomspace(low, high, size), np.linspace(least, most, size)
        found = worst(case, delay, design, stiffness[:, None], damping[None, :])
        row, column = divmod(int(found.argmax()), size)
        if found[row, column] > figure:
            figure, gains = float(found[row, column]), (float(stiffness[row]), float(damping[column]))
        low, high = (float(stiffness[min(max(row + step, 0), size - 1)]) for step in (-2, 2))
        least, most = (float(damping[min(max(column + step, 0), size - 1)]) for step in (-2, 2))
    return figure, *gains


def returned(laws: list[Law], delay: float) -> Array:
    """Return the share of its energy that a flotor thrown at a wall comes back with, at 40 phases."""
    phase = np.arange(40) / 40
    pose, twist = np.zeros((40, 6)), np.zeros((40, 6))
    pose[:, 2], twist[:, 2] = 3e-3, -0.2
    plant = ExactPlant(
        Timing(period=PERIOD, delay=delay, phase=phase),
        pose=pose,
        twist=twist,
        gravity=0.0,
        record=True,
        escape=(1e3, 1.0),
    )
    run(plant, Controller(laws, period=PERIOD), 200)
    return np.asarray((plant.trace().twist[-1, :, 2] / 0.2) ** 2)


print("least dynamic stiffness in N/m, the best over the gains, at 200 Hz and 0.7 kg")
print(f"  {'delay, design':<38}{'nominal':>9}{'±20 %':>9}{'hands':>9}{'all':>9}   gains of the last")
rows = []
for delay in (0.0, 0.0015, 0.005):
    top = stiffest_wall(period=PERIOD, delay=delay)
    designs: list[tuple[str, Design | None]] = [(f"PD (statically at most {float(top.stiffness):.0f})", None)]
    designs += [(f"observer, poles at {pole:g}", observer(delay, pole, False)) for pole in (0.0, 0.4)]
    designs += [(f"with disturbance, poles at {pole:g}", observer(delay, pole, True)) for pole in (0.0, 0.4)]
    for name, design in designs:
        found = {case: best(case, delay, design) for case in CASES}
        rows.append({"delay": delay, "design": name, **found})
        figures = "".join(f"{found[case][0]:>9.0f}" for case in CASES)
        gains = f"{found['all'][1]:.0f} N/m, {found['all'][2]:.0f} N s/m"
        print(f"  {f'{delay * 1e3:g} ms, {name}':<38}{figures}   {gains}")

print()
print("energy that comes back from a spring without damping, over that brought (an ideal spring: 1), 40 phases")
print(f"  {'delay, stiffness':<24}{'sampled':>14}{'predicted':>14}{'passivity control':>20}")
bounces = []
for delay, stiffness in itertools.product((0.0, 0.0015, 0.005), (1000.0, 4000.0)):
    plain = Wall(axes="z", lower=0.0, stiffness=stiffness, damping=0.0)
    control = PassivityController(axes="z", period=PERIOD, delay=delay, most=60.0)
    walls: dict[str, list[Law]] = {
        "sampled": [plain],
        "predicted": [PredictiveWall(axes="z", stiffness=stiffness, period=PERIOD, delay=delay)],
        "passivity control": [plain, control],
    }
    shares = {name: returned(laws, delay) for name, laws in walls.items()}
    bounces.append({"delay": delay, "stiffness": stiffness, **{name: part.tolist() for name, part in shares.items()}})
    spans = [f"{part.min():.2f} to {part.max():.2f}" for part in shares.values()]
    print(f"  {f'{delay * 1e3:g} ms, {stiffness:g} N/m':<24}{spans[0]:>14}{spans[1]:>14}{spans[2]:>20}")

print()
print("at rest over a sensor of 5 µm, delay 1.5 ms: swing of the flotor, and standard deviation of the force")
hums = []
for name, stiffness, damping, pole in (("PD", 3382.0, 83.0, None), ("observer", 24204.0, 209.0, 0.0)):
    rendered, law = stiffness, None
    if pole is not None:
        law = observer_wall(0.0015, pole, False, stiffness=stiffness, damping=damping)
        rendered = float(rendered_stiffness(law.linear(np.asarray(stiffness), np.asarray(damping))))
    heard = hum(0.0, law=law, stiffness=rendered, damping=damping)
    hums.append({"design": name, "swing": float(heard.swing[0]), "force": float(heard.force[0])})
    gains = f"{name}, gains {stiffness:.0f} and {damping:.0f}, {rendered:.0f} N/m at rest"
    print(f"  {gains:<52}{heard.swing[0] * 1e6:>7.1f} µm{heard.force[0]:>8.3f} N")
data = {"designs": rows, "bounces": bounces, "hum": hums}
(folder / "better_walls.json").write_text(json.dumps(data, indent=1) + "\n")
print("wrote", folder / "better_walls.json")
