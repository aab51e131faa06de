"""Figure 2: level sets of the largest root modulus over (c_p, c_v), with one sample of delay and with the device's."""

import argparse
from pathlib import Path

import numpy as np

from maglev_mj import plots
from maglev_mj.spec import Spec
from maglev_mj.theory import largest_modulus, stiffest_wall

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("folder", nargs="?", default="figures", type=Path, help="where files go")
options = parser.parse_args()
folder = options.folder
folder.mkdir(parents=True, exist_ok=True)


PERIOD, DELAY, MASS = 1.0 / Spec.control_rate.value, Spec.transport_delay.value, Spec.moving_mass.value
cases = []
for name, delay in (("one sample of delay, eq. (6)", PERIOD), ("delay 1.5 ms, the device", DELAY)):
    best = stiffest_wall(period=PERIOD, delay=delay, mass=MASS)
    stiffness = np.linspace(1.0, 1.2 * float(best.stiffness), 401)
    damping = np.linspace(0.0, 2.2 * float(best.damping), 401)
    modulus = largest_modulus(stiffness[:, None], damping, period=PERIOD, delay=delay, mass=MASS)
    to_cp, to_cv = PERIOD**2 / (2.0 * MASS), PERIOD / (2.0 * MASS)
    title = f"{name}, 200 Hz, 0.7 kg\nat most {float(best.stiffness):.0f} N/m, at {float(best.damping):.1f} N s/m"
    top = (to_cv * float(best.damping), to_cp * float(best.stiffness))
    cases.append((title, to_cv * damping, to_cp * stiffness, modulus, top))
    print(title.replace("\n", ": "))
print("the paper reads off figure 2: about 3900 N/m at about 60 N s/m")
print("wrote", plots.figure_2(cases, folder / "fig2_stability.png"))
