"""Figure 9: all six axes in stick-slip while a smooth seeded hand moves the flotor, a staircase on each axis."""

import sys
from pathlib import Path

from maglev_mj import AXES, charts
from maglev_mj.experiments.six_axes import run_six_axes

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
folder.mkdir(parents=True, exist_ok=True)

result = run_six_axes()
print(f"{'axis':>6}{'slips':>8}{'still stuck at':>18}{'slips at':>12}{'breakaway / stiffness':>24}")
for index, axis in enumerate(AXES):
    stuck, gone = (bound[index] * 1e3 for bound in result.resolution)
    expected, unit = result.expected_resolution[index] * 1e3, "mm" if index < 3 else "mrad"
    print(f"{axis:>6}{result.slips[index]:>8}{stuck:>18.4f}{gone:>12.4f}{expected:>24.4f} {unit}")
print("wrote", charts.staircase(result, folder / "fig9_six_axes.png"))
