"""Walls better than PD: what stiffness each design reaches, with its model right, wrong by 20 %, and under hands.

Prints three tables, writes every figure to better_walls.json. Figures are the best over a grid of gains of the least
dynamic stiffness, the force a hand needs at least for each metre at any frequency; 0 where the loop is unstable.
"""

import itertools
import json
import sys
from pathlib import Path

import numpy as np

from maglev_mj import ExactPlant, Timing, Wall, run
from maglev_mj.controller import Controller
from maglev_mj.experiments.choices import HANDS, hand_called
from maglev_mj.experiments.failures import hum
from maglev_mj.frames import Array
from maglev_mj.laws import Law, ObserverWall, PassivityController, PredictiveWall
from maglev_mj.sampled import Design, rendered_stiffness
from maglev_mj.stability import least_dynamic_stiffness, stiffest_wall

QUICK = "--quick" in sys.argv  # a coarser grid of gains
PERIOD, MASS = 0.005, 0.7
SIZE = 16 if QUICK else 40
folder = Path(next((word for word in sys.argv[1:] if not word.startswith("--")), "figures"))
folder.mkdir(parents=True, exist_ok=True)


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


def best(delay: float, design: Design | None) -> dict[str, float]:
    """Return the best nominal figure, the best worst case, and the gains of the latter."""
    stiffness = np.geomspace(300.0, 110000.0, SIZE)[:, None] * np.ones(SIZE)
    damping = np.linspace(5.0, 280.0, SIZE)[None, :] * np.ones((SIZE, 1))

    def reached(mass: float = 1.0, late: float = 1.0, hand: str = "none") -> Array:
        return least_dynamic_stiffness(
            stiffness,
            damping,
            period=PERIOD,
            delay=late * delay,
            mass=mass * MASS,
            hand=hand_called(hand),
            design=design,
        )

    nominal = reached()
    wrong = np.minimum.reduce([reached(m, d) for m, d in itertools.product((0.8, 1.0, 1.2), (0.8, 1.0, 1.2))])
    held = np.minimum.reduce([reached(hand=hand) for hand in HANDS])
    both = np.minimum(wrong, held)
    place = np.unravel_index(int(both.argmax()), both.shape)
    return {
        "nominal": float(nominal.max()),
        "wrong_by_20_percent": float(wrong.max()),
        "under_hands": float(held.max()),
        "all": float(both.max()),
        "stiffness": float(stiffness[place]),
        "damping": float(damping[place]),
    }


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
        row = best(delay, design)
        rows.append({"delay": delay, "design": name, **row})
        figures = "".join(f"{row[key]:>9.0f}" for key in ("nominal", "wrong_by_20_percent", "under_hands", "all"))
        gains = f"{row['stiffness']:.0f} N/m, {row['damping']:.0f} N s/m"
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
    found = {name: returned(laws, delay) for name, laws in walls.items()}
    bounces.append({"delay": delay, "stiffness": stiffness, **{name: part.tolist() for name, part in found.items()}})
    spans = [f"{part.min():.2f} to {part.max():.2f}" for part in found.values()]
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
