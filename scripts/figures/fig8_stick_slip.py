"""Draw figure 8: stick-slip under a virtual spring.

The flotor is pulled out of emulated friction, beside exact Karnopp friction.
"""

from maglev_mj.cli.output import script_options
from maglev_mj.scenes.run import run_variants
from maglev_mj.scenes.stick_slip import StickSlip

pictures = script_options(__doc__).pictures

# the paper's values are the defaults: 1000 N/m to 3 mm, 6000 N/m, 80 N s/m, 2 N, 5 mm/s, 200 Hz, 1.5 ms
found = run_variants({"rendered": StickSlip()})
print(found.table())
print("wrote", found.plot(pictures.path("fig8_stick_slip")))
