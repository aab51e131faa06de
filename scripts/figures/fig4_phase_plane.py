"""Figure 4: the drop in the phase plane, by both readings of the pulse, beside the ideal analog wall."""

import sys
from pathlib import Path

from maglev_mj import plots
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
folder.mkdir(parents=True, exist_ok=True)

# at the phase of median penetration
results = {label: run(variant, phase=0.56) for label, variant in Drop().variants().items()}
print("wrote", plots.phase_plane(results, {}, folder / "fig4_phase_plane.png"))
