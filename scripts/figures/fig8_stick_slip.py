"""Figure 8: the flotor pulled out of emulated friction by a virtual spring, against exact Karnopp friction."""

import sys
from pathlib import Path

from maglev_mj import plots
from maglev_mj.scenes.run import run
from maglev_mj.scenes.stick_slip import StickSlip
from maglev_mj.tables import run_table

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
folder.mkdir(parents=True, exist_ok=True)

# the paper's values are the defaults: 1000 N/m to 3 mm, 6000 N/m, 80 N s/m, 2 N, 5 mm/s, 200 Hz, 1.5 ms
results = {"rendered": run(StickSlip())}
print(run_table(results, {}, None))
print("wrote", plots.stick_slip(results, {}, folder / "fig8_stick_slip.png"))
