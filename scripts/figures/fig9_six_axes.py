"""Figure 9: all six axes in stick-slip while a smooth seeded hand moves the flotor, a staircase on each axis."""

import argparse
import itertools
from pathlib import Path

import numpy as np

from maglev_mj import AXES
from maglev_mj.frames import Array
from maglev_mj.plots.drawing import FIRST, SECOND, new_figure, save
from maglev_mj.spec import INERTIA, RANGE
from six_axes import SixAxesResult, run_six_axes

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("folder", nargs="?", default="figures", type=Path, help="where files go")
parser.add_argument("--quick", action="store_true", help="fewer seeds and phases")
options = parser.parse_args()
folder = options.folder
folder.mkdir(parents=True, exist_ok=True)


def staircase(result: SixAxesResult, path: Path) -> Path:
    """Draw position against stick position on six axes, as figure 9 does.

    Args:
        result: The run.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = new_figure(3, 2, (10.5, 7.5), sharex=True)
    order = [panel for column in (panels[0::2], panels[1::2]) for panel in column]
    for index, (axis, panel) in enumerate(zip(AXES, order, strict=True)):
        unit = "mm" if index < 3 else "mrad"
        anchor = np.where(result.stuck[:, index], result.anchor[:, index], np.nan)
        panel.plot(result.time, result.position[:, index] * 1e3, color=FIRST, linewidth=1.0, label="position")
        panel.step(result.time, anchor * 1e3, color=SECOND, linewidth=1.5, where="post", label="stick position")
        steps = result.steps()[index] * 1e3
        between = f", resting places {steps.min():.2g} to {steps.max():.2g} apart" if steps.size else ""
        panel.set_title(f"{axis} ({unit}): {int(result.slips[index])} slips{between}", loc="left", fontsize=10.5)
        panel.set_xlim(0.0, float(result.time[-1]))
    for panel in panels[-2:]:
        panel.set_xlabel("time (s)")
    panels[0].legend(frameon=False, loc="best")
    return save(figure, path)


result = run_six_axes()
print(f"{'axis':>6}{'slips':>8}{'still stuck at':>18}{'slips at':>12}{'breakaway / stiffness':>24}{'least step':>14}")
for index, axis in enumerate(AXES):
    stuck, gone = (bound[index] * 1e3 for bound in result.stretch)
    expected, unit = result.expected_stretch[index] * 1e3, "mm" if index < 3 else "mrad"
    least = result.steps()[index].min() * 1e3
    print(f"{axis:>6}{result.slips[index]:>8}{stuck:>18.4f}{gone:>12.4f}{expected:>24.4f}{least:>14.2f} {unit}")

# what a hand can place: a step of a rotation is taken at the radius of gyration
radius = np.sqrt(np.array(INERTIA) / INERTIA[0])
seeds, phases = ((1,), (0.0,)) if options.quick else (range(1, 9), (0.0, 0.25, 0.5, 0.75))
print(
    "distance from one resting place to the next, exact plant [mm], on each axis that stays within the device's range"
)
print(f"{'hand':>10}{'steps':>8}{'least':>8}{'5 %':>8}{'median':>8}   axes")
for stiffness in (1000.0, 1500.0, 2500.0):
    steps: list[Array] = []
    tried = 0
    for seed, phase in itertools.product(seeds, phases):
        run = run_six_axes(plant="exact", seed=seed, phase=phase, hand_stiffness=stiffness)
        inside = np.abs(run.position).max(axis=0) <= RANGE
        steps += [one * scale * 1e3 for one, scale, kept in zip(run.steps(), radius, inside, strict=True) if kept]
        tried += len(AXES)
    low, fifth, middle = np.percentile(np.concatenate(steps), [0.0, 5.0, 50.0])
    count = sum(map(len, steps))
    print(f"{stiffness:>6.0f} N/m{count:>8}{low:>8.2f}{fifth:>8.2f}{middle:>8.2f}   {len(steps)} of {tried}")
print("wrote", staircase(result, folder / "fig9_six_axes.png"))
