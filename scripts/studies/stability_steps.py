"""Shift of the stability boundary by a simulation's time step."""

import json

import numpy as np

from maglev_mj.cli.output import script_options
from maglev_mj.frames import Array
from maglev_mj.pictures import ChartPanel, small_multiples
from maglev_mj.plants import INTEGRATORS
from maglev_mj.spec import Spec
from maglev_mj.studies.levels import boundary_shift
from maglev_mj.theory.loop import Loop
from maglev_mj.versions import versions

options = script_options(__doc__, quick="one delay and one time step")
pictures = options.pictures

PERIOD, DELAY = 1.0 / Spec.control_rate.value, Spec.transport_delay.value
steps = np.array([1e-3] if options.quick else [1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2.5e-3, 5e-3])
shifts: list[dict[str, object]] = []


def shift(kind: str, delay: float, aligned: bool) -> Array:
    """Return a simulation's shift of the stiffest wall [%]; it is printed too."""
    loop = Loop.of("ubc", stiffness=0.0, damping=0.0, period=PERIOD, delay=delay)[0].array()
    fractions = [boundary_shift(kind, step, loop, aligned=aligned) for step in steps]
    percent = np.round(np.array(fractions) * 100.0, 6) + 0.0
    row = {"integrator": kind, "delay": delay, "aligned": aligned}
    shifts.append({**row, "step": steps.tolist(), "percent": percent.tolist()})
    name = f"{kind}, {delay * 1e3:g} ms" + ("" if aligned else ", fixed step")
    print(f"  {name:<26}" + "".join(f"{value:>10.2f}" for value in percent))
    return percent


print("stiffest wall that a simulation calls stable, over the exact one, in percent, by time step in ms")
print(f"  {'integrator, delay':<26}" + "".join(f"{step * 1e3:>10g}" for step in steps))
curves = []
for delay in (DELAY,) if options.quick else (0.0, DELAY, PERIOD):
    for kind in (one for one in INTEGRATORS if one != "corrected"):
        percent = shift(kind, delay, aligned=True)
        if kind == "euler":  # the other semi-implicit ones are the same to the last digit here
            curves.append((f"delay {delay * 1e3:g} ms", steps * 1e3, percent))
labels = ("time step (ms)", "error of critical stiffness (%)")
title = "Euler, implicit, discrete; steps end\nat switches (RK4: 0)"
panels = [ChartPanel(title=title, labels=labels, curves=curves, log="xy", marked=True)]
names = {"rk4": "RK4", "euler": "Euler"}
fixed = [(name, steps * 1e3, shift(kind, DELAY, aligned=False)) for kind, name in names.items()]
title = "fixed step that misses the switch\n(delay 1.5 ms)"
panels.append(ChartPanel(title=title, labels=labels, curves=fixed, log="x", level=0.0, marked=True))
data = {"integrators": shifts, "versions": versions()}
pictures.path("stability_steps", "json").write_text(json.dumps(data, indent=1) + "\n")
print("wrote", pictures.path("stability_steps", "json"))
error = f"Euler at {steps[-1] * 1e3:g} ms: critical stiffness wrong by up to {max(y[-1] for *_, y in curves):.0f} %"
print(
    "wrote",
    small_multiples(
        [error, "PD wall at its best damping, 200 Hz, 0.7 kg, no hand"], panels, pictures.path("stability_steps")
    ),
)
