"""A drop and its sweep as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from maglev_mj.experiments.drop import DropResult, DropSweep, share_less_deep
from maglev_mj.metrics import BounceSummary, percentiles
from maglev_mj.tables.limits import beyond_force, beyond_range
from maglev_mj.terminal import cell

__all__ = ["drop_table"]

_FIGURES = (
    ("penetration", "penetration", 1e3, "mm"),
    ("rebound", "rebound", 1e3, "mm"),
    ("peak_force", "peak force", 1.0, "N"),
    ("settling_time", "settling, 2 %", 1e3, "ms"),
    ("final_z", "final height", 1e3, "mm"),
)
_WIDTH = 20  # three drops fit a terminal of 80 columns


def drop_table(labels: Sequence[str], results: Sequence[DropResult], sweeps: Sequence[DropSweep], gap: float) -> str:
    """Return the figures of drops, and of their sweeps if there are any, as text.

    Args:
        labels: Label of each drop.
        results: The drops; the first one's parameters head the table.
        sweeps: A sweep for each drop, or nothing.
        gap: Greatest distance between the two plants on the first drop [m].
    """
    p = results[0].parameters
    limit = "none" if p.force_limit is None else f"{p.force_limit:g} N"
    lines = [
        f"Drop of {p.height * 1e3:g} mm on a wall of {p.stiffness:g} N/m and {p.damping:g} N s/m, plant {p.plant}",
        f"  {1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms, mass {p.mass:g} kg, "
        f"pulse {p.pulse:g} N s/m for {p.pulse_width * 1e3:g} ms, force limit {limit}",
        "",
    ]
    where = f"at phase {p.phase:g}"
    if sweeps:
        less_deep = share_less_deep(results[0].summary, sweeps[0].summary)
        where += f", deeper than {100.0 * less_deep:.0f} % of the phases"
    lines += _block(where, labels, [[result.summary] for result in results])
    if sweeps:
        spreads = [[percentiles(sweep.summary, share) for share in (50.0, 5.0, 95.0)] for sweep in sweeps]
        lines += ["", *_block(f"over {sweeps[0].phases.size} phases: median (5 to 95 %)", labels, spreads)]
    for sweep, label in zip(sweeps, labels):
        settled = int(np.isfinite(sweep.summary.settling_time).sum())
        if settled < sweep.phases.size:
            lines.append(f"  {label}: settled within {p.duration:g} s at {settled} of {sweep.phases.size} phases")
    remarks = beyond_force(results[0].trace)
    remarks += beyond_range(labels, [one.trace.furthest() for one in results], [one.furthest for one in sweeps])
    lines += ["", *remarks] if remarks else []
    lines += ["", f"  MuJoCo and the exact plant differ by at most {gap:.1e} m"]
    return "\n".join(lines)


def _block(title: str, labels: Sequence[str], drops: Sequence[Sequence[BounceSummary]]) -> list[str]:
    """Return lines with a column for each drop: one summary, or median, lower and upper bound where these differ."""
    lines = [title, " " * 15 + "".join(f"{label:>{_WIDTH}}" for label in labels)]
    for name, label, scale, unit in _FIGURES:
        cells = ""
        for drop in drops:
            value, *bounds = (cell(getattr(summary, name), scale) for summary in drop)
            spread = f" ({bounds[0]} to {bounds[1]})" if len(set(bounds)) > 1 else ""
            cells += f"{value + spread:>{_WIDTH}}"
        lines.append(f"  {label:<13}{cells}  {unit}")
    return lines
