"""Draw figure 6: position and force of a press.

A hand hits the wall several times, then presses against it.
"""

from maglev_mj.cli.output import script_options
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.run import run_variants

pictures = script_options(__doc__).pictures

# the wall's gains are those of figure 3; the hand, how often it hits and how hard it presses are ours
found = run_variants(Press().variants())

for label, result in found.runs.items():
    figures = result.figures
    depths = ", ".join(f"{depth * 1e3:.2f}" for depth in figures["penetration"])
    print(
        f"{label:>14}: hits {depths} mm deep, peak {figures['peak_force'].max():.1f} N, "
        f"pressed {figures['final_depth'] * 1e3:.3f} mm deep with {figures['final_force']:.3f} N"
    )
print("wrote", found.plot(pictures.path("fig6_press")))
