"""Published bounds beside the exact boundary.

And the shift of that boundary by a simulation's time step.
"""

import json

import numpy as np

from maglev_mj.cli.output import script_options
from maglev_mj.frames import Array
from maglev_mj.pictures import Panel, small_multiples
from maglev_mj.plants import INTEGRATORS
from maglev_mj.plants.hand import Hand
from maglev_mj.spec import Spec
from maglev_mj.studies.levels import boundary_shift
from maglev_mj.theory import boundary as bounds
from maglev_mj.theory import largest_stable_stiffness, least_passive_damping, stiffest_wall
from maglev_mj.theory.closed_loop import SampledLoop
from maglev_mj.versions import versions

options = script_options(__doc__, quick="fewer cases, time steps and points")
pictures = options.pictures

PERIOD, DELAY = 1.0 / Spec.control_rate.value, Spec.transport_delay.value
OWN = 20.0  # damping of the device or the hand, in one of the panels [N s/m]
PLACES = 5.0, 20.0, 60.0  # virtual dampings of the table [N s/m]

panels, rows = [], []
print("times the exact boundary, at 200 Hz and 0.7 kg (above 1: optimistic, below: conservative)")
print(f"  {'delay, own damping':<24}{'B N s/m':>8}{'exact N/m':>11}{'Gil':>7}{'Minsky':>8}{'passive b':>11}")
CASES = (0.0, 0.0), (DELAY, 0.0), (PERIOD, 0.0), (0.0, OWN)
for delay, own in CASES[1::2] if options.quick else CASES:
    top = 1.6 * float(stiffest_wall(period=PERIOD, delay=delay, hand=Hand(damping=own)).damping)
    damping = np.concatenate([PLACES, np.linspace(0.5, top, 4 if options.quick else 120)])
    limits = {"exact": largest_stable_stiffness(damping, period=PERIOD, delay=delay, hand=Hand(damping=own))}
    for name, late in (("Gil et al.", delay), ("Minsky et al.", 0.0)):
        limits[name] = bounds.gil(damping, period=PERIOD, delay=late, physical_damping=own)
    curves = [(name, damping[len(PLACES) :], values[len(PLACES) :]) for name, values in limits.items()]
    title = f"delay {delay * 1e3:g} ms, physical damping {own:g} N s/m"
    labels = ("virtual damping B (N s/m)", "critical stiffness (N/m)")
    panels.append(Panel(title=title, labels=labels, curves=curves, top=1.6 * float(curves[0][2].max())))
    for index, place in enumerate(PLACES):
        at = {name: float(values[index]) for name, values in limits.items()}
        base = at["exact"]
        passive = float(least_passive_damping(base, place, period=PERIOD, delay=delay))  # of the device, at the limit
        rows.append({"delay": delay, "own_damping": own, "damping": place, **at, "passive_damping": passive})
        print(
            f"  {f'{delay * 1e3:g} ms, {own:g} N s/m':<24}{place:>8g}{base:>11.0f}{at['Gil et al.'] / base:>7.2f}"
            f"{at['Minsky et al.'] / base:>8.2f}{passive:>11.2f}"
        )

by_step = []
steps = np.array([1e-3] if options.quick else [1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2.5e-3, 5e-3])
shifts: list[dict[str, object]] = []
LOOPS = {
    delay: SampledLoop(period=PERIOD, delay=delay) for delay in ((DELAY,) if options.quick else (0.0, DELAY, PERIOD))
}


def shift(kind: str, delay: float, aligned: bool) -> Array:
    """Return a simulation's shift of the stiffest wall [%]; it is printed too."""
    loop = LOOPS[delay]
    fractions = [boundary_shift(kind, step, loop, aligned=aligned) for step in steps]
    percent = np.round(np.array(fractions) * 100.0, 6) + 0.0
    row = {"integrator": kind, "delay": delay, "aligned": aligned}
    shifts.append({**row, "step": steps.tolist(), "percent": percent.tolist()})
    name = f"{kind}, {delay * 1e3:g} ms" + ("" if aligned else ", fixed step")
    print(f"  {name:<26}" + "".join(f"{value:>10.2f}" for value in percent))
    return percent


print()
print("stiffest wall that a simulation calls stable, over the exact one, in percent, by time step in ms")
print(f"  {'integrator, delay':<26}" + "".join(f"{step * 1e3:>10g}" for step in steps))
curves = []
for delay in LOOPS:
    for kind in (one for one in INTEGRATORS if one != "corrected"):
        percent = shift(kind, delay, aligned=True)
        if kind == "euler":  # the other semi-implicit ones are the same to the last digit here
            curves.append((f"delay {delay * 1e3:g} ms", steps * 1e3, percent))
labels = ("time step (ms)", "error of critical stiffness (%)")
title = "Euler, implicit, discrete; steps end\nat switches (RK4: 0)"
by_step.append(Panel(title=title, labels=labels, curves=curves, log="xy", marked=True))
names = {"rk4": "RK4", "euler": "Euler"}
fixed = [(name, steps * 1e3, shift(kind, DELAY, aligned=False)) for kind, name in names.items()]
title = "fixed step that misses the switch\n(delay 1.5 ms)"
by_step.append(Panel(title=title, labels=labels, curves=fixed, log="x", level=0.0, marked=True))
data = {"bounds": rows, "integrators": shifts, "versions": versions()}
pictures.path("stability_bounds", "json").write_text(json.dumps(data, indent=1) + "\n")
print("wrote", pictures.path("stability_bounds", "json"))
ratios = [float(str(row["Gil et al."])) / float(str(row["exact"])) for row in rows]
head = f"Gil's bound is {min(ratios):.2f} to {max(ratios):.2f} times the exact critical stiffness in N/m"
print("wrote", small_multiples([head], panels, pictures.path("stability_bounds")))
error = f"Euler at {steps[-1] * 1e3:g} ms: critical stiffness wrong by up to {max(y[-1] for *_, y in curves):.2g} %"
print("wrote", small_multiples([error], by_step, pictures.path("stability_steps")))
