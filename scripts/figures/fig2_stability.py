"""Draw figure 2: level sets of the largest root modulus.

Over the gains (c_p, c_v), with one sample of delay and with the device's delay.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from maglev_mj.cli.output import script_options
from maglev_mj.frames import Array
from maglev_mj.pictures import SECOND, TITLE, name_curves, new_figure, save
from maglev_mj.spec import Spec
from maglev_mj.studies.pictures import level_sets
from maglev_mj.theory import largest_modulus, stiffest_wall

options = script_options(__doc__, quick="a coarser grid")
pictures, COUNT = options.pictures, 41 if options.quick else 401


def draw(cases: Sequence[tuple[str, Array, Array, Array, tuple[float, float]]], path: Path) -> Path:
    """Draw level sets of the largest modulus over (c_p, c_v).

    The maximum of c_p is marked, as in figure 2.

    Args:
        cases: Title, values of c_v (B,) and c_p (K,), modulus (K, B), and the maximum (c_v, c_p) of each panel.
        path: File to write.
    """
    figure, panels = new_figure(1, len(cases), 4.6, sharex=True, sharey=True)
    for panel, (title, cv, cp, modulus, top) in zip(panels, cases, strict=True):
        level_sets(panel, cv, cp, modulus)
        panel.plot(*top, "*", color=SECOND, markersize=14, label="largest stable stiffness")
        panel.annotate(
            f"$c_p$ = {top[1]:.4f}, $c_v$ = {top[0]:.4f}",
            top,
            textcoords="offset points",
            xytext=(0, 9),
            ha="center",
            fontsize=9.0,
        )
        panel.set_xlabel("$c_v = T k_v / 2m$")
        panel.set_title(title, **TITLE)
    panels[0].set_ylabel("$c_p = T^2 k_p / 2m$")
    name_curves(figure, panels)
    return save(figure, path)


PERIOD, DELAY, MASS = 1.0 / Spec.control_rate.value, Spec.transport_delay.value, Spec.moving_mass.value
cases = []
for name, delay in (("one sample of delay, eq. (6)", PERIOD), ("delay 1.5 ms, the device", DELAY)):
    best = stiffest_wall(period=PERIOD, delay=delay, mass=MASS)
    stiffness = np.linspace(1.0, 1.2 * float(best.stiffness), COUNT)
    damping = np.linspace(0.0, 2.2 * float(best.damping), COUNT)
    modulus = largest_modulus(stiffness[:, None], damping, period=PERIOD, delay=delay, mass=MASS)
    to_cp, to_cv = PERIOD**2 / (2.0 * MASS), PERIOD / (2.0 * MASS)
    title = f"{name}, 200 Hz, 0.7 kg\nat most {float(best.stiffness):.0f} N/m, at {float(best.damping):.1f} N s/m"
    top = (to_cv * float(best.damping), to_cp * float(best.stiffness))
    cases.append((title, to_cv * damping, to_cp * stiffness, modulus, top))
    print(title.replace("\n", ": "))
print("the paper reads off figure 2: about 3900 N/m at about 60 N s/m")
print("wrote", draw(cases, pictures.path("fig2_stability")))
