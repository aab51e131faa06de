"""Figure 4: the drop in the phase plane, by both readings of the pulse, beside the ideal analog wall."""

import sys
from pathlib import Path

from maglev_mj import plots
from maglev_mj.experiments.drop import DropParameters, drop_variants, run_drop

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
folder.mkdir(parents=True, exist_ok=True)

drop = DropParameters(plant="mujoco", phase=0.56)  # the phase of median penetration
runs = [(label, run_drop(variant)) for label, variant in drop_variants(drop).items()]
print("wrote", plots.phase_plane(runs, folder / "fig4_phase_plane.png"))
