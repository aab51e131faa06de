"""Draw figure 4: the drop in the phase plane.

Both readings of the pulse, beside the ideal analog wall.
"""

from maglev_mj.cli.output import script_options
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run_variants

pictures = script_options(__doc__).pictures

# at the phase of median penetration
found = run_variants(Drop().variants(), phase=0.56, bands=Drop.drawn_phases)
print("wrote", found.plot(pictures.path("fig4_phase_plane"), picture="drop_phase_plane"))
