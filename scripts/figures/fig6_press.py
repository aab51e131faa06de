"""Figure 6: position and control force while a hand hits the wall several times and then presses against it."""

import sys
from dataclasses import replace
from pathlib import Path

from maglev_mj import plots
from maglev_mj.experiments.press import PressParameters, run_press

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
folder.mkdir(parents=True, exist_ok=True)

# the wall's gains are those of figure 3; the hand, how often it hits and how hard it presses are ours
press = PressParameters(plant="mujoco")
runs = [("with pulse", run_press(press)), ("without pulse", run_press(replace(press, pulse=0.0)))]

for label, result in runs:
    figures = result.summary
    depths = ", ".join(f"{depth * 1e3:.2f}" for depth in figures.penetration)
    print(
        f"{label:>14}: hits {depths} mm deep, peak {figures.peak_force.max():.1f} N, "
        f"pressed {figures.final_depth * 1e3:.3f} mm deep with {figures.final_force:.3f} N"
    )
print("wrote", plots.figure_6(runs, folder / "fig6_press.png"))
