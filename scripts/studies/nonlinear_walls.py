"""Stability boundary with pulse, force limit and quantized sensor: a million drops for each picture."""

import json
import time
from typing import Any

import numpy as np

from maglev_mj.cli.output import Progress, script_options
from maglev_mj.pictures import TITLE, new_figure, save
from maglev_mj.studies.cells import local_workers
from maglev_mj.studies.drop_map import DropEnding, DropMapParameters, run_drop_map
from maglev_mj.studies.pictures import drop_panels
from maglev_mj.versions import versions

QUANTUM, LIMIT, PULSE = 5e-6, 60.0, 220.0
SOFTEST = 1000.0  # boundaries below are met by walls too soft to come to rest in time
CASES: dict[str, dict[str, Any]] = {
    "linear: released at the edge": {"height": 0.0},
    "drop from 4.5 mm": {},
    f"sensor resolution {QUANTUM * 1e6:g} µm": {"quantize": QUANTUM},
    f"force limit {LIMIT:g} N": {"force_limit": LIMIT},
    f"pulse {PULSE:g} N s/m": {"pulse": PULSE},
    "resolution, limit and pulse": {"quantize": QUANTUM, "force_limit": LIMIT, "pulse": PULSE},
}

if __name__ == "__main__":
    options = script_options(__doc__, quick="30 x 30 walls a picture instead of 1000 x 1000")
    grid = 30 if options.quick else 1000
    workers = local_workers(0 if options.quick else None)
    results, data = {}, {}
    print(f"{grid} x {grid} walls a case, 200 Hz, delay 1.5 ms, 0.7 kg, 400 samples")
    for name, values in CASES.items():
        start = time.perf_counter()
        with Progress(name) as progress:
            swept = run_drop_map(DropMapParameters(grid=grid, **values), workers=workers, progress=progress)
        took = time.perf_counter() - start
        stable, settles, up_to = swept.stable_by_theory, swept.settles, swept.settles_up_to
        quiet, firm = swept.swing[settles & stable], swept.boundary > SOFTEST
        share = up_to[firm] / swept.boundary[firm]
        row: dict[str, Any] = {
            "seconds": took,
            "settles": float(settles.mean()),
            "stable_by_theory": float(stable.mean()),
            "stable_that_does_not_settle": float((stable & ~settles).sum() / stable.sum()),
            "unstable_that_settles": float((~stable & settles).sum() / (~stable).sum()),
            "unstable_that_gains": float((swept.ending == DropEnding.RISES)[~stable].mean()),
            "median_swing_of_unstable": float(np.median(swept.swing[~stable])),
            "largest_swing": float(swept.swing.max()),
            "median_swing_of_settled": float(np.median(quiet)),
            "settles_up_to_over_theory": dict(
                zip(("least", "5 %", "median"), np.percentile(share, (0, 5, 50)).tolist())
            ),
            "least_at_damping": float(swept.damping[firm][np.argmin(share)]),
        }
        results[name], data[name] = swept, row
        print(f"\n{name}: {took:.1f} s")
        shares = ", ".join(f"{name} {value:.3f}" for name, value in row["settles_up_to_over_theory"].items())
        print(f"  settles up to, over theory's boundary: {shares}; the least at {row['least_at_damping']:.0f} N s/m")
        print(f"  stable by theory, does not settle: {row['stable_that_does_not_settle']:.2%} of the stable")
        print(f"  unstable by theory, settles: {row['unstable_that_settles']:.2%} of the unstable;", end=" ")
        print(f"rises above its release: {row['unstable_that_gains']:.0%}")
        print(f"  swing of the unstable: median {row['median_swing_of_unstable'] * 1e3:.2g} mm,", end=" ")
        print(f"most {row['largest_swing'] * 1e3:.3g} mm;", end=" ")
        print(f"of the settled: median {row['median_swing_of_settled'] * 1e6:.2g} µm")
    path = options.pictures.path("stability_nonlinear", "json")
    path.write_text(json.dumps({"grid": grid, "cases": data, "versions": versions()}, indent=1) + "\n")
    print("wrote", path)
    medians = [row["settles_up_to_over_theory"]["median"] for row in data.values()]
    head = f"Drops settle up to {100.0 * min(medians):.0f} to {100.0 * max(medians):.0f} % of the stability boundary"
    figure, panels = new_figure(
        [head, "PD wall along z, 200 Hz, delay 1.5 ms, 0.7 kg, no hand"], 3, 2, 8.2, sharex=True, sharey=True
    )
    drop_panels(figure, panels, list(results.values()))
    for panel, name in zip(panels, results, strict=True):
        panel.set_title(name, **TITLE)
        panel.label_outer()
    print("wrote", save(figure, options.pictures.path("stability_nonlinear")))
