"""Failures of walls and their cures.

Four figures of two panels, each over phases, seeds or a sweep; `--figure NAME` draws one of them.

`two_walls.py` draws the fourth one's subject over every delay.
"""

import argparse
import itertools
import json
from typing import Any

import numpy as np

from maglev_mj import Timing, Wall
from maglev_mj.cli.output import script_options
from maglev_mj.pictures import ChartPanel, small_multiples
from maglev_mj.plants.hand import Hand
from maglev_mj.spec import RANGE, Spec
from maglev_mj.studies.designed_wall import hum
from maglev_mj.studies.stability_map import RestingWall, measure_growth
from maglev_mj.theory import spectral_radius, stiffest_wall
from maglev_mj.versions import versions
from tests.theory.failures import corner, press_at_edge, random_delay_rate
from tests.theory.impacts import RATTLE, limited_drop, rattle

NAMES = "timing", "pulse", "limits", "hands"


def add_figure(parser: argparse.ArgumentParser) -> None:
    """Add the choice of one figure."""
    parser.add_argument("--figure", choices=NAMES, help="draw one figure (default all)")


options = script_options(__doc__, quick="fewer points, shorter runs", more=add_figure)
pictures = options.pictures

T, DELAY, MASS = 1.0 / Spec.control_rate.value, Spec.transport_delay.value, Spec.moving_mass.value
COUNT = 2 if options.quick else 10
TICKS, PRESSES = (500, 2) if options.quick else (4000, 20)
SECONDS = (0.5, 1.0, 0.5, 0.5) if options.quick else (2.0, 16.0, 4.0, 4.0)
CHATTER, RATTLES, DROP, HUM = SECONDS
PHASES = np.arange(32)[:: 8 if options.quick else 1] / 32


def panel(title: str, x: str, y: str, curves: list[tuple[str, Any, Any]], **options: Any) -> ChartPanel:
    """Return a panel of curves with its axes named."""
    return ChartPanel(title=title, labels=(x, y), curves=curves, **options)


def just_above_the_boundary() -> ChartPanel:
    """Return the panel of samples to grow ten-thousandfold just above the boundary, predicted and simulated."""
    best = stiffest_wall(period=T, delay=T)
    over = np.geomspace(0.1 if options.quick else 0.01, 0.3, COUNT)
    stiffness, damping = float(best.stiffness) * (1.0 + over), np.full(COUNT, float(best.damping))
    walls = [RestingWall(stiffness=k, damping=float(best.damping), delay=T) for k in stiffness.tolist()]
    predicted = np.log(1e4) / np.log(spectral_radius(stiffness, damping, period=T, delay=T))
    curves = [("predicted by the spectral radius", over * 100.0, predicted)]
    for plant in ("exact", "mujoco"):
        seen = measure_growth(walls, plant).ticks
        curves.append((f"simulated, {plant}", over * 100.0, seen))
    return panel(
        "one sample of delay,\njust above the boundary",
        "stiffness above it (%)",
        "samples to grow 10 000-fold",
        curves,
        log="xy",
    )


def jitter() -> ChartPanel:
    """Return the panel of delays drawn anew each sample, spread evenly around their mean."""
    means = np.linspace(0.0025, 0.004, COUNT)
    curves = [("no jitter", means * 1e3, spectral_radius(6000.0, 80.0, period=T, delay=means))]
    for spread in (0.5e-3, 1e-3):
        rates = []
        for mean in means:
            timing = Timing(delay=float(mean), jitter=spread)
            rates.append(random_delay_rate(6000.0, 80.0, [timing.rest_at(tick) for tick in range(TICKS)]))
        curves.append((f"± {spread * 1e3:g} ms", means * 1e3, np.array(rates)))
    return panel(
        "delay jitter acts as its mean\n(6000 N/m, 80 N s/m)", "mean delay (ms)", "growth per sample", curves, level=1.0
    )


def chatter() -> ChartPanel:
    """Return the panel of pulses at the edge of the paper's wall, over a noisy sensor."""
    presses = np.geomspace(0.003, 1.0, 2 if options.quick else 16)
    curves, gated = [], np.zeros(presses.size)
    for noise in (0.0, 1e-6, 2e-6, 5e-6, 10e-6):
        gates = [0.0, 5.0 * (5e-6 + noise) / T]
        fired = np.array(
            [
                press_at_edge(press, gates, noise=noise, phases=PRESSES, duration=CHATTER).pulses
                for press in presses.tolist()
            ]
        )
        curves.append((f"noise {noise * 1e6:g} µm, no gate", presses, fired[:, 0]))
        gated = np.maximum(gated, fired[:, 1])
    curves.append(("each, gate 5 (step + noise)/T", presses, gated))
    return panel(
        "the pulse chatters under a light press",
        "press of the hand (N)",
        "pulses per second",
        curves,
        log="x",
        marked=True,
    )


def gaps() -> ChartPanel:
    """Return the panel of rattling starts between two walls, of 128 under 60 N."""
    widths = np.geomspace(1e-5, 5e-3, COUNT + 2)
    speeds = np.arange(1, 17) * 0.02
    stops = MASS / 0.003 - 80.0
    curves, outside = [], []
    for pulse, delay in (
        (220.0, 0.001),
        (220.0, DELAY),
        (220.0, 0.002),
        (220.0, 0.003),
        (stops, 0.002),
        (stops, 0.003),
    ):
        motion = rattle(widths[:, None, None], speeds[:, None], PHASES[::4], pulse=pulse, delay=delay, duration=RATTLES)
        share = (motion.speed > RATTLE).mean(axis=(1, 2))
        curves.append((f"pulse {pulse:.0f} N s/m, {delay * 1e3:g} ms", widths * 1e3, share))
        outside.append((motion.furthest > RANGE[2]).any(axis=(1, 2)))
    return panel(
        "two walls close together",
        "gap between the walls (mm)",
        "share of the starts that rattle",
        curves,
        log="x",
        marked=True,
        outside=outside,
    )


def saturation() -> ChartPanel:
    """Return the panel of drops under a force limit: the furthest of the worst phase."""
    heights = np.geomspace(5e-5, RANGE[2], COUNT + 4)
    paper = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)
    curves, outside = [], []
    for limit in (8.0, 10.0, 20.0, 30.0):
        motion = limited_drop(heights[:, None], paper, PHASES, force_limit=limit, duration=DROP)
        curves.append((f"6000 N/m, 80 N s/m, {limit:g} N", heights * 1e3, motion.furthest.max(axis=1) * 1e3))
        outside.append((motion.furthest > RANGE[2]).any(axis=1))
    return panel(
        "saturation: too deep",
        "drop height (mm)",
        f"furthest from the centre in {DROP:g} s (mm)",
        curves,
        log="xy",
        level=RANGE[2] * 1e3,
        top=3.0 * RANGE[2] * 1e3,
        marked=True,
        outside=outside,
    )


def quantization() -> ChartPanel:
    """Return the panel of swings at a coarse sensor, over the share of friction."""
    shares = np.linspace(0.0, 1.2, COUNT + 3)
    curves = []
    for stiffness, damping in ((2000.0, 30.0), (4000.0, 60.0), (6000.0, 80.0)):
        swing = hum(shares * 0.5 * stiffness * 5e-6, stiffness=stiffness, damping=damping, duration=HUM).swing
        curves.append((f"{stiffness:g} N/m, {damping:g} N s/m", shares, swing * 1e6))
    return panel(
        "a coarse sensor hums unless there is friction",
        "friction over K quantum / 2",
        "swing (µm)",
        curves,
        marked=True,
    )


def hands() -> ChartPanel:
    """Return the panel of walls held and released."""
    share = np.linspace(0.0, 1.0, 60)
    clamp = Hand(stiffness=20000.0 * share)
    arm = Hand(mass=0.554 * share, damping=6.45 * share, stiffness=135.0 * share)
    curves = [
        (f"{k:g} N/m, {b:g} N s/m: {name}", share, spectral_radius(k, b, period=T, delay=DELAY, hand=hand))
        for k, b, name, hand in ((6000.0, 80.0, "a clamp of 20 000 N/m", clamp), (9000.0, 130.0, "an arm's hold", arm))
    ]
    return panel("hands too stiff, and hands that let go", "share of the hand", "spectral radius", curves, level=1.0)


def corners() -> ChartPanel:
    """Return the panel of kinetic energy of a flotor thrown into a corner."""
    curves = []
    for plant, spin in itertools.product(("exact", "mujoco"), (0.0, 0.5)):
        _, energy = corner(plant, [2e-3, 1e-3, 3e-3, 0.0, 0.02, 0.0], [-0.1, 0.0, -0.15, spin, -1.0, spin])
        name = f"{plant}, {'turning about three axes' if spin else 'about one'}"
        curves.append((name, np.arange(len(energy)) * T, np.maximum(energy, 1e-12)))
    return panel("a corner: x, z and ry at once", "time (s)", "kinetic energy (J)", curves, log="y")


def timing_finding(growth: ChartPanel, delays: ChartPanel) -> str:
    """Return the headline of growth near the boundary and of delays that vary."""
    (_, _, predicted), *simulated = growth.curves
    (_, _, steady), *varied = delays.curves
    off = max(np.abs(ticks / predicted - 1.0).max() for _, _, ticks in simulated)
    moved = max(np.abs(rates - steady).max() for _, _, rates in varied)
    return f"Growth is as predicted within {100 * off:.0f} %; delay jitter changes it by {moved:.1g} per sample"


def pulse_finding(presses: ChartPanel, walls: ChartPanel) -> str:
    """Return the headline of pulses at the edge and of two walls."""
    *free, gated = (pulses.max() for _, _, pulses in presses.curves)
    name, _, shares = max(walls.curves, key=lambda curve: curve[2].sum())
    return (
        f"Up to {max(free):.0f} false pulses per second, {gated:.0f} with a gate; "
        f"{100 * shares.mean():.0f} % of the starts rattle: {name}"
    )


def limits_finding(drops: ChartPanel, sensors: ChartPanel) -> str:
    """Return the headline of force limits and of a coarse sensor."""
    outside = [heights[beyond] for (_, heights, _), beyond in zip(drops.curves, drops.outside, strict=True)]
    left = [(float(heights.min()), name) for heights, (name, _, _) in zip(outside, drops.curves) if heights.size]
    swing = max(swing.max() for _, _, swing in sensors.curves)
    found = [f"{name.rpartition(', ')[2]} stop no drop from {height:.2g} mm" for height, name in sorted(left)[:1]]
    return "; ".join([*found, f"friction ends a swing of {swing:.0f} µm"])


def hands_finding(held: ChartPanel, thrown: ChartPanel) -> str:
    """Return the headline of hands and of a corner."""
    _, shares, radii = held.curves[0]
    rest = max(energy[-1] for _, _, energy in thrown.curves)
    return (
        f"A clamp above {2e4 * shares[radii <= 1.0].max():.0f} N/m shakes; "
        f"a corner comes to rest, with {1e9 * rest:.0f} nJ left"
    )


PANELS = {
    "timing": (just_above_the_boundary, jitter, timing_finding),
    "pulse": (chatter, gaps, pulse_finding),
    "limits": (saturation, quantization, limits_finding),
    "hands": (hands, corners, hands_finding),
}
names = [options.figure] if options.figure else list(PANELS)
drawn = {name: [make() for make in PANELS[name][:2]] for name in names}
data = [
    {
        "title": one.title,
        "labels": one.labels,
        "curves": [[name, list(x), list(y)] for name, x, y in one.curves],
        "outside": [np.asarray(points).tolist() for points in one.outside],
    }
    for panels in drawn.values()
    for one in panels
]
pictures.path("where_methods_fail", "json").write_text(
    json.dumps({"panels": data, "versions": versions()}, indent=1) + "\n"
)
print("wrote", pictures.path("where_methods_fail", "json"))
for name, panels in drawn.items():
    head = PANELS[name][2](*panels), f"{1.0 / T:g} Hz, delay {DELAY * 1e3:g} ms unless stated, {MASS:g} kg"
    print("wrote", small_multiples(head, panels, pictures.path(f"where_methods_fail_{name}")))
