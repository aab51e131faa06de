"""What the braking pulse does to a drop, over 100 phases of the sampler at each height.

One drop proves nothing: penetration and rebound depend on where between two samples the flotor crosses into
the wall. The table gives median and 5 to 95 %, and in how many of the 100 drops the pulse gave less. Hardness is the
extended rate-hardness: the fastest rise of the force over the speed of impact.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from maglev_mj.experiments.drop import DropParameters, sweep_drop, sweep_hardness
from maglev_mj.spec import Spec

WINDOW = 0.005  # over which the rise of the force is taken, for the perceived hardness [s]
FIGURES = (("penetration", 1e3, "mm"), ("rebound", 1e3, "mm"), ("settling_time", 1e3, "ms"), ("peak_force", 1.0, "N"))


def row(values: np.ndarray) -> str:
    """Return median and 5 to 95 % as text."""
    low, middle, high = np.percentile(values, [5, 50, 95])
    return f"{middle:7.2f} ({low:6.2f} to {high:6.2f})"


VARIANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("no force limit", {}),
    ("limit 60 N, the rest of the braking lost", {"force_limit": 60.0}),
    ("limit 60 N, the rest of the braking carried over to the next samples", {"force_limit": 60.0, "carry": True}),
)

for title, options in VARIANTS:
    print(title)
    print(f"  {'height':>7}  {'figure':<16}{'without pulse':<28}{'with pulse':<28}less with pulse")
    for height in (0.001, 0.002, 0.003, Spec.translation_range.value):
        drop = DropParameters(plant="exact", height=height, **options)
        plain = sweep_drop(replace(drop, pulse=0.0), 100).summary
        pulsed = sweep_drop(drop, 100).summary
        for name, scale, unit in FIGURES:
            before, after = (getattr(summary, name) * scale for summary in (plain, pulsed))
            fewer = int((after < before).sum())
            label = f"{name}, {unit}"
            print(f"  {height * 1e3:4.1f} mm  {label:<18}{row(before):<26}  {row(after):<26}{fewer:4d} of 100")
        hard = [sweep_hardness(variant, 100, WINDOW).extended / 1e3 for variant in (replace(drop, pulse=0.0), drop)]
        fewer = int((hard[1] < hard[0]).sum())
        print(
            f"  {height * 1e3:4.1f} mm  {'hardness, kN/m':<18}{row(hard[0]):<26}  {row(hard[1]):<26}{fewer:4d} of 100"
        )
    print()
