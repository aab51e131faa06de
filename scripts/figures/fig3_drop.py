"""Draw figure 3: height and force in a drop.

The flotor falls on an emulated wall, with both readings of the braking pulse.
"""

from maglev_mj.cli.output import script_options
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import run_variants

pictures = script_options(__doc__).pictures

# the paper's gains are the defaults: 6000 N/m, 80 N s/m, a pulse of 220 N s/m for 3 ms, 200 Hz, 1.5 ms; it prints
# neither height nor phase: the device's range, and the phase of median penetration
found = run_variants(Drop().variants(), phase=0.56, bands=Drop.drawn_phases)

for label, result in found.runs.items():
    figures = result.figures
    print(
        f"{label:>18}: {figures['penetration'] * 1e3:.2f} mm deep, rebound {figures['rebound'] * 1e3:.2f} mm, "
        f"peak {figures['peak_force']:.1f} N, settled after {figures['settling_time'] * 1e3:.0f} ms"
    )
print("wrote", found.plot(pictures.path("fig3_drop"), picture="drop_time"))
