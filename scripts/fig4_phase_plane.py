"""Figure 4: the drop in the phase plane, with and without the pulse, beside the ideal analog wall."""

import sys
from dataclasses import replace
from pathlib import Path

from maglev_mj import charts
from maglev_mj.experiments.drop import DropParameters, run_drop

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
folder.mkdir(parents=True, exist_ok=True)

drop = DropParameters(plant="mujoco")
runs = [("with pulse", run_drop(drop)), ("without pulse", run_drop(replace(drop, pulse=0.0)))]
print("wrote", charts.phase_plane(runs, folder / "fig4_phase_plane.png"))
