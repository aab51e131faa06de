"""Speed against accuracy: what each way to simulate a scene costs, and how far it is off.

Draws a chart of every scene, one of the drop with what a user would take instead, and curves of what the step does
to the stability boundary and to the energy of a bounce; writes every figure to speed_accuracy.json. Costs are medians
of repeats in turn within this one run, so that their ratios hold on a machine that is not alone.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

# six by six matrices gain nothing from threads, and some peers lose much; numpy reads this once
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np

from maglev_mj import drive
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.pictures import script_options
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, SampledPlant, Timing
from maglev_mj.plots import Panel, PictureFolder, small_multiples
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.scene import Start
from maglev_mj.spec import Spec
from maglev_mj.studies.batches import wall_controller
from maglev_mj.studies.fidelity_cases import preset_of
from maglev_mj.studies.integrators import INTEGRATORS
from maglev_mj.versions import versions
from peers import Task
from ways import SEMI_IMPLICIT, Way, as_json, boundary_shift, measure, our_ways, peer_ways, points_of
from work_precision import WorkPrecision, work_precision

TITLES = {
    "drop": "on a wall, with a braking pulse",
    "drop-no-pulse": "without the pulse",
    "press": "an arm hits, then presses",
    "stick-slip": "pulled out of friction",
    "twist": "free, at 3.7 rad/s",
    "six-axes": "drawn back to the centre",
}
TURNING = "twist", "six-axes"
NANOMETRE = 1e-9
PERIOD, DELAY = Timing().period, Timing().delay


def add_scenes(parser: Parser) -> None:
    """Add --scenes."""
    parser.add_argument(
        "--scenes", nargs="+", default=list(TITLES), choices=TITLES, metavar="SCENE", help=", ".join(TITLES)
    )


class PeersDrop(Drop):
    """Drop the flotor from the pose of the peers' task, for so many samples as they answer."""

    def start(self) -> Start:
        """See `Scene`."""
        return Start(pose=Task().pose)

    def ticks(self, timing: Timing) -> int:
        """See `Scene`."""
        return round(self.duration / self.period)


def boundary_shifts(quick: bool) -> dict[str, Any]:
    """Return how far each integrator shifts the stiffest stable wall, over the step, and with which power of it."""
    steps = [1e-3, 1e-4] if quick else [2.5e-3, 1e-3, 5e-4, 2.5e-4, 1e-4]
    rows: dict[str, Any] = {"steps": steps, "shifts": {}, "orders": {}}
    for integrator in INTEGRATORS:
        rows["shifts"][integrator] = [boundary_shift(integrator, step) for step in steps]
    for integrator in ("euler", "rk4"):
        missed = [boundary_shift(integrator, 0.93 * step, aligned=False) for step in steps]
        rows["shifts"][f"{integrator}, steps that miss the switches"] = missed
    for name, shifts in rows["shifts"].items():
        if min(map(abs, shifts)) > 1e-9:
            rows["orders"][name] = float(np.polyfit(np.log(steps), np.log(np.abs(shifts)), 1)[0])
    return rows


def machine() -> dict[str, Any]:
    """Return what the figures were measured on."""
    return {
        "processor": platform.machine(),
        "processors": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
    }


def sweep_of_drops(stiffnesses: int, dampings: int, repeats: int) -> dict[str, Any]:
    """Return what a sweep of drops over the gains of the wall costs a drop [s], and how many end otherwise than exact.

    A drop counts as settled if it moves by less than a tenth of a millimetre in its last quarter.
    """
    grid = np.meshgrid(np.linspace(500.0, 16000.0, stiffnesses), np.linspace(20.0, 180.0, dampings))
    stiffness, damping = (values.ravel() for values in grid)
    makers: dict[str, Callable[..., SampledPlant]] = {
        "exact": ExactPlant,
        "MuJoCo, corrected": partial(MuJoCoBatchPlant, integrator="corrected", coils=False, threads=2),
        "MuJoCo, corrected, coils": partial(MuJoCoBatchPlant, integrator="corrected", threads=2),
        "MuJoCo, rk4": partial(MuJoCoBatchPlant, coils=False, threads=2),
    }
    raw = partial(MuJoCoBatchPlant, coils=False, threads=2, integrator="euler")
    makers["MuJoCo, raw euler"] = raw
    makers["MuJoCo, raw euler, 0.1 ms"] = partial(raw, longest_step=1e-4)
    pose = np.zeros((stiffness.size, 6))
    pose[:, 2] = Spec.translation_range.value
    costs: dict[str, list[float]] = {name: [] for name in makers}
    settled: dict[str, Array] = {}
    for _ in range(repeats):
        for name, make in makers.items():
            plant = make(Timing(period=PERIOD, delay=DELAY), pose=pose, escape=(1e6, 1.0))
            controller = wall_controller(
                stiffness=stiffness,
                damping=damping,
                pulse=220.0,
                pulse_width=0.003,
                period=PERIOD,
                delay=DELAY,
                mass=Spec.moving_mass.value,
            )
            heights: list[Array] = []

            def keep(sample: Sample, _: Command, heights: list[Array] = heights) -> None:
                heights.append(sample.position[2])

            start = time.perf_counter()
            drive(plant, controller, 80, observe=keep)
            costs[name].append((time.perf_counter() - start) / stiffness.size)
            settled[name] = np.ptp(heights[60:], axis=0) < 1e-4
    return {
        "drops": int(stiffness.size),
        "cost": {name: statistics.median(values) for name, values in costs.items()},
        "misjudged": {name: int((verdict != settled["exact"]).sum()) for name, verdict in settled.items()},
    }


def cheapest(ways: list[Way], group: str, part: str = "", error: float = NANOMETRE) -> Way | None:
    """Return the cheapest way of a group, and of a name with some part in it, within an error."""
    good = [way for way in ways if way.group == group and part in way.name and way.error <= error]
    return min(good, key=lambda way: way.cost, default=None)


def print_ratios(ways: list[Way]) -> dict[str, float]:
    """Print what others cost at an error of a nanometre, against the cheapest engine here; return the ratios."""
    ours = cheapest(ways, "MuJoCo, body")
    assert ours is not None
    print(f"\nthe drop within 1 nm: MuJoCo costs {ours.cost * 1e3:.2f} µs a simulated ms ({ours.name})")
    ratios = {}
    rows = [(group, "") for group in dict.fromkeys(way.group for way in ways)]
    for group, part in [*rows, ("drake", "LeafSystem"), ("scipy", "solve_ivp a segment"), ("control", "nlsys")]:
        way = cheapest(ways, group, part)
        if way is not None and way is not ours:
            ratios[f"{group} {part}".strip()] = way.cost / ours.cost
            print(f"  {f'{group}: {way.name}':<58}{way.cost * 1e3:9.3f} µs  {way.cost / ours.cost:8.3f} times that")
    return ratios


def main() -> None:
    """Measure, print, draw, write."""
    options = script_options(__doc__, "fewer steps and repeats", add_scenes)
    pictures, quick = options.pictures, options.quick
    ways = {name: our_ways(name, preset_of(name).scene, quick) for name in options.scenes}
    task = Task()
    drop = PeersDrop()
    peers, missing = peer_ways(drop, task, quick)
    for line in missing:
        print(line)
    everyone = our_ways("drop", drop, quick) + peers
    for some in (*ways.values(), everyone):
        measure(some, 2 if quick else 9)
    data: dict[str, Any] = {"machine": machine(), "scenes": {name: as_json(some) for name, some in ways.items()}}
    data["peers"] = as_json(everyone)
    print("what nothing beats, the cheapest first")
    for name, part in {**data["scenes"], "with peers": data["peers"]}.items():
        print(f"  {name:<14} one device: {'; '.join(part['front'])}")
        print(f"  {'':<14}       many: {'; '.join(part['front_of_many'])}")
    data["ratios"] = print_ratios(everyone)
    data["boundary"] = boundary_shifts(quick)
    data["sweep"] = sweep_of_drops(10, 10, 1) if quick else sweep_of_drops(40, 25, 3)
    print("\na sweep of drops, on two threads: cost of a drop, and drops that end otherwise than exact")
    for name, cost in data["sweep"]["cost"].items():
        print(f"  {name:<28}{cost * 1e6:8.1f} µs{data['sweep']['misjudged'][name]:6d}")
    print("\nshift of the stiffest stable wall: order in the step")
    for name, order in data["boundary"]["orders"].items():
        first = data["boundary"]["shifts"][name][0]
        print(f"  {name:<44}{order:5.2f}   {first:+.1%} at {data['boundary']['steps'][0] * 1e3:g} ms")
    figures = pictures.path("speed_accuracy", "json")
    figures.write_text(json.dumps({**data, "versions": versions()}, indent=1) + "\n")
    print(f"\nwrote {figures}")
    for path in draw(pictures, ways, everyone, data):
        print(f"wrote {path}")


def merged(curves: list[tuple[str, list[Any], list[Any]]]) -> list[tuple[str, list[Any], list[Any]]]:
    """Return curves with those that are one and the same named together."""
    kept: list[tuple[str, list[Any], list[Any]]] = []
    for name, steps, values in curves:
        for place, (other, over, known) in enumerate(kept):
            if steps == over and np.allclose(values, known, rtol=1e-6):
                kept[place] = f"{other}, {name}", over, known
                break
        else:
            kept.append((name, steps, values))
    return kept


def draw(pictures: PictureFolder, ways: dict[str, list[Way]], everyone: list[Way], data: dict[str, Any]) -> list[Path]:
    """Draw the charts; return their files."""
    panels = {name: WorkPrecision(f"{name}: {TITLES[name]}", points_of(some)) for name, some in ways.items()}
    turning = [panel for name, panel in panels.items() if name in TURNING]
    along = [panel for name, panel in panels.items() if name not in TURNING]
    drop = WorkPrecision("a drop on the wall, six axes, with what else one might take", points_of(everyone))
    boundary = data["boundary"]
    shifts = merged(
        [(name, boundary["steps"], np.abs(boundary["shifts"][name]).tolist()) for name in boundary["orders"]]
    )
    energies = []
    for kind in SEMI_IMPLICIT:
        mine = [
            way for way in ways.get("drop-no-pulse", []) if way.integrator == kind and way.step and way.group != "exact"
        ]
        mine.sort(key=lambda way: way.step or 0.0)
        if mine:
            energies.append((kind, [way.step for way in mine], [way.energy for way in mine]))
    steps = [
        Panel(
            title="shift of the stiffest stable wall",
            labels=("time step (s)", "relative shift"),
            curves=shifts,
            log="xy",
            marked=True,
        ),
        Panel(
            title="energy of a bounce",
            labels=("time step (s)", "largest error, share of the fall's"),
            curves=merged(energies),
            log="xy",
            marked=True,
        ),
    ]
    charts = {"speed_accuracy": along, "speed_accuracy_turning": turning}
    return [
        *(work_precision(some, pictures.path(name)) for name, some in charts.items() if some),
        work_precision([drop], pictures.path("speed_accuracy_peers"), columns=1),
        small_multiples([panel for panel in steps if panel.curves], pictures.path("speed_accuracy_steps")),
    ]


if __name__ == "__main__":
    main()
