"""Print tables of the braking pulse's effect on drops, with both readings of its size.

The paper states a pulse of 220 N s/m. Its equation (9) adds the pulse to the damping of 80 N s/m: +220 N s/m
(300 total). With the damping included, 220 N s/m total is close to m/T_pulse = 233 N s/m, which stops the flotor.
The force limit of the device is 60 N.

One drop proves nothing: the figures depend on the phase, the time from the crossing to the next sample. A cell is
the median (5 to 95 %) over 100 phases; the last rows count the phases. Hardness is the extended rate-hardness: the
fastest rise of the force over a window, over the speed of impact.
"""

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.figures import perceived_hardness
from maglev_mj.scenes.run import run
from maglev_mj.spec import Spec

parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
parser.add_argument("--quick", action="store_true", help="the first table from the greatest height alone")
quick = parser.parse_args().quick
HEIGHTS = (*(() if quick else (0.001, 0.002, 0.003)), Spec.translation_range.value)
PHASES = 100
TOTAL: dict[str, Any] = {"pulse": 220.0 - Drop.damping}
ADDED: dict[str, Any] = {"pulse": 220.0}
LIMIT: dict[str, Any] = {"force_limit": Spec.largest_vertical_force.value}
CARRY = LIMIT | {"carry": True}
ADDED_LABEL, TOTAL_LABEL = [label for label in Drop().variants() if label != "no pulse"]
PLAIN: dict[str, dict[str, Any]] = {"no pulse": {"pulse": 0.0}}  # below 60 N at every phase, limit or not
TABLES = (
    PLAIN
    | {TOTAL_LABEL: TOTAL, ADDED_LABEL: ADDED}
    | {f"{TOTAL_LABEL}, 60 N": TOTAL | LIMIT, f"{ADDED_LABEL}, 60 N": ADDED | LIMIT},
    PLAIN | {f"{TOTAL_LABEL}, 60 N, carry": TOTAL | CARRY, f"{ADDED_LABEL}, 60 N, carry": ADDED | CARRY},
)


def figures(**options: Any) -> dict[str, Array]:
    """Return the figures of a drop, (PHASES,) each."""
    result = run(Drop(**options), plant="exact", phase=np.arange(PHASES) / PHASES)
    bounce, trace = result.figures, result.trace
    return {
        "penetration (mm)": bounce["penetration"] * 1e3,
        "rebound (mm)": bounce["rebound"] * 1e3,
        "settling time, 2 % (ms)": bounce["settling_time"] * 1e3,
        "peak force (N)": bounce["peak_force"],
        "hardness, 5 ms (kN/m)": perceived_hardness(trace, 0.005).extended / 1e3,
        "hardness, 10 ms (kN/m)": perceived_hardness(trace, 0.01).extended / 1e3,
    }


def spread(values: Array, digits: int) -> str:
    """Return median and 5 to 95 % as text: one number if they are the same."""
    middle, low, high = (f"{value:.{digits}f}" for value in np.percentile(values, [50, 5, 95]))
    return middle if low == high else f"{middle} ({low}\u2013{high})"


def print_table(height: float, columns: Mapping[str, dict[str, Any]]) -> None:
    """Print a Markdown table with a column for each drop, the first without pulse."""
    drops = [figures(height=height, **options) for options in columns.values()]
    plain = drops[0]
    rows = {name: [spread(drop[name], 2 if "mm" in name else 0) for drop in drops] for name in plain}
    for name in plain:
        if "hardness" in name:
            label = name.removesuffix(" (kN/m)").replace("hardness", "hardness ratio")
            rows[label] = [spread(drop[name] / plain[name], 1) for drop in drops]
    counted = {
        "less penetration": [drop["penetration (mm)"] < plain["penetration (mm)"] for drop in drops],
        "more rebound": [drop["rebound (mm)"] > plain["rebound (mm)"] for drop in drops],
        "settled sooner": [drop["settling time, 2 % (ms)"] < plain["settling time, 2 % (ms)"] for drop in drops],
        "peak above 80 N": [drop["peak force (N)"] > 80.0 for drop in drops],
    }
    rows |= {f"{name}, phases": [str(int(phases.sum())) for phases in counts] for name, counts in counted.items()}
    print(f"| from {height * 1e3:g} mm | " + " | ".join(columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    for name, cells in rows.items():
        print(f"| {name} | " + " | ".join(cells) + " |")
    print()


for columns in TABLES[: 1 if quick else None]:
    for height in HEIGHTS:
        print_table(height, columns)
