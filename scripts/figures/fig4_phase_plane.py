"""Draw figure 4: the drop in the phase plane.

Both readings of the pulse, beside the ideal analog wall.
"""

from maglev_mj import plots
from maglev_mj.cli.pictures import script_options
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run

pictures = script_options(__doc__).pictures

# at the phase of median penetration
results = {label: run(variant, phase=0.56) for label, variant in Drop().variants().items()}
print("wrote", plots.phase_plane(results, {}, pictures.path("fig4_phase_plane")))
