"""Walls better than PD: stiffness that each design reaches.

With its model right, wrong by 20 %, and under hands.

Prints three tables, writes every figure to better_walls.json. Figures are the best over the gains of the least
dynamic stiffness, the force a hand needs at least for each metre at any frequency: the least over mass and delay right
or off by 20 % either way, hands, or the product of all of these. The gains of the product are then simulated in 500
random cases of it.
"""

import argparse
import itertools
import json
from pathlib import Path

import numpy as np

from maglev_mj import ExactPlant, Timing, Wall, drive
from maglev_mj.control import Law, PassivityController, PredictiveWall
from maglev_mj.control.controller import Controller
from maglev_mj.frames import Array
from maglev_mj.plants.hand import HANDS
from maglev_mj.spec import Spec
from maglev_mj.studies.designed_wall import Contact, growing_cases, hum
from maglev_mj.theory import WallRequirements, design_wall, stiffest_wall
from maglev_mj.versions import versions

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--out", metavar="DIR", default="figures", type=Path, help="where files go (default figures)")
parser.add_argument("--quick", action="store_true", help="a delay of 1.5 ms, two designs, two hands, two cases")
options = parser.parse_args()
folder = options.out
folder.mkdir(parents=True, exist_ok=True)

PERIOD, MASS = 1.0 / Spec.control_rate.value, Spec.moving_mass.value
LATE = Spec.transport_delay.value
DELAYS = (LATE,) if options.quick else (0.0, LATE, PERIOD)
CASES = {"right": "right", "off": "±20 %", "hands": "hands", "all": "all"}
if options.quick:
    del CASES["off"], CASES["hands"]
GRIPS = tuple(HANDS)[: 2 if options.quick else None]
DESIGNS: tuple[tuple[str, float | None], ...] = (("pd", None), ("observer", 0.0))
if not options.quick:
    DESIGNS += (("observer", 0.4),)


def requirements(case: str, delay: float) -> WallRequirements:
    """Return a case's requirements: stability of all loops."""
    low, high = (0.8, 1.2) if case in ("off", "all") else (1.0, 1.0)
    hands = GRIPS if case in ("hands", "all") else ("none",)
    return WallRequirements(
        period=PERIOD,
        mass=(low * MASS, high * MASS),
        delay=(low * delay, high * delay),
        hands=hands,
        spectral_radius=1.0,
    )


def returned(laws: list[Law], delay: float) -> Array:
    """Return the share of energy a wall gives back to a flotor, at 40 phases."""
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
    drive(plant, Controller(laws, period=PERIOD), 200)
    return np.asarray((plant.trace().twist[-1, :, 2] / 0.2) ** 2)


print("least dynamic stiffness in N/m, the best over the gains, at 200 Hz and 0.7 kg: model right, mass and delay off")
print("by 20 % either way, every hand, and the product of these; its gains, spectral radius, and growing cases of 500")
print(f"  {'delay, design':<42}{''.join(f'{name:>8}' for name in CASES.values())}   gains of the last")
rows, walls = [], {}
for delay in DELAYS:
    top = stiffest_wall(period=PERIOD, delay=delay)
    for law, pole in DESIGNS:
        designs = {case: design_wall(requirements(case, delay), law, goal="dynamic", pole=pole) for case in CASES}
        last = walls[law, pole, delay] = designs["all"]
        cases = last.requirements.random(500, seed=7)
        growing = {
            limit: int(growing_cases(last, Contact(force_limit=limit), cases).sum())
            for limit in (None, Spec.largest_vertical_force.value)
        }
        name = f"PD (statically at most {float(top.stiffness):.0f})" if pole is None else f"{law}, poles at {pole:g}"
        figures = "".join(f"{wall.dynamic_stiffness:>8.0f}" for wall in designs.values())
        print(f"  {f'{delay * 1e3:g} ms, {name}':<42}{figures}   {last.stiffness:.0f} N/m, {last.damping:.0f} N s/m")
        print(f"  {'':<42}spectral radius {last.spectral_radius:.4f}; grow: {growing[None]}, at 60 N {growing[60.0]}")
        rows.append(
            {
                "delay": delay,
                "design": name,
                **{case: [wall.dynamic_stiffness, wall.stiffness, wall.damping] for case, wall in designs.items()},
                "spectral_radius": last.spectral_radius,
                "growing": list(growing.values()),
            }
        )

print()
print("energy that comes back from a spring without damping, over that brought (an ideal spring: 1), 40 phases")
print(f"  {'delay, stiffness':<24}{'sampled':>14}{'predicted':>14}{'passivity control':>20}")
bounces = []
for delay, stiffness in itertools.product(DELAYS, (1000.0, 4000.0)):
    plain = Wall(axes="z", lower=0.0, stiffness=stiffness, damping=0.0)
    control = PassivityController(axes="z", period=PERIOD, delay=delay, most=60.0)
    laws: dict[str, list[Law]] = {
        "sampled": [plain],
        "predicted": [PredictiveWall(axes="z", stiffness=stiffness, period=PERIOD, delay=delay)],
        "passivity control": [plain, control],
    }
    shares = {name: returned(chosen, delay) for name, chosen in laws.items()}
    bounces.append({"delay": delay, "stiffness": stiffness, **{name: part.tolist() for name, part in shares.items()}})
    spans = [f"{part.min():.2f} to {part.max():.2f}" for part in shares.values()]
    print(f"  {f'{delay * 1e3:g} ms, {stiffness:g} N/m':<24}{spans[0]:>14}{spans[1]:>14}{spans[2]:>20}")

print()
print("at rest over a sensor of 5 µm, delay 1.5 ms: swing of the flotor, and standard deviation of the force")
hums = []
for law, pole in DESIGNS[:2]:
    wall = walls[law, pole, LATE]
    heard = hum(0.0, law=wall.make(), stiffness=wall.rendered, damping=wall.damping)
    hums.append({"design": wall.law, "swing": float(heard.swing[0]), "force": float(heard.force[0])})
    gains = f"{wall.law}, gains {wall.stiffness:.0f} and {wall.damping:.0f}, {wall.rendered:.0f} N/m at rest"
    print(f"  {gains:<52}{heard.swing[0] * 1e6:>7.1f} µm{heard.force[0]:>8.3f} N")
data = {"designs": rows, "bounces": bounces, "hum": hums, "versions": versions()}
(folder / "better_walls.json").write_text(json.dumps(data, indent=1) + "\n")
print("wrote", folder / "better_walls.json")
