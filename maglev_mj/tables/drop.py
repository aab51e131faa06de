"""A drop and its sweep as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from maglev_mj.experiments.drop import DropResult, DropSweep
from maglev_mj.metrics import BounceSummary, percentiles
from maglev_mj.spec import Spec
from maglev_mj.tables.text import cell

__all__ = ["drop_table"]

_FIGURES = (
    ("penetration", "penetration", 1e3, "mm"),
    ("rebound", "rebound", 1e3, "mm"),
    ("peak_force", "peak force", 1.0, "N"),
    ("settling_time", "settling, 2 %", 1e3, "ms"),
    ("final_z", "final height", 1e3, "mm"),
)


def drop_table(labels: Sequence[str], results: Sequence[DropResult], sweeps: Sequence[DropSweep], gap: float) -> str:
    """Return the figures of one or two drops, and of their sweeps if there are any, as text.

    Args:
        labels: What to call each drop.
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
    width = 26 if sweeps else 15
    lines += _block(f"at phase {p.phase:g}", labels, [_figures(result.summary) for result in results], width)
    if sweeps:
        spreads = [_spread(sweep) for sweep in sweeps]
        lines += _block(f"over {sweeps[0].phases.size} phases: median (5 to 95 %)", labels, spreads, width)
    for sweep, label in zip(sweeps, labels):
        settled = int(np.isfinite(sweep.summary.settling_time).sum())
        if settled < sweep.phases.size:
            lines.append(f"  {label}: settled within {p.duration:g} s at {settled} of {sweep.phases.size} phases")
    peak, device = float(results[0].summary.peak_force), Spec.largest_vertical_force.value
    if peak > device * (1.0 + 1e-9):
        lines += [f"  The device gives {device:g} N along z, less than this peak: see --force-limit {device:g}"]
    lines += [f"  MuJoCo and the exact plant differ by at most {gap:.1e} m"]
    return "\n".join(lines)


def _block(head: str, labels: Sequence[str], columns: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return a line for each figure under a head, a column for each drop."""
    lines = [f"  {head}", " " * 15 + "".join(f"{label:>{width}}" for label in labels[: len(columns)])]
    for (_, label, _, unit), *cells in zip(_FIGURES, *columns):
        lines.append(f"  {label:<13}" + "".join(f"{one:>{width}}" for one in cells) + f"  {unit}")
    return [*lines, ""]


def _figures(summary: BounceSummary) -> list[str]:
    """Return each figure as text."""
    return [cell(getattr(summary, name), scale) for name, _, scale, _ in _FIGURES]


def _spread(sweep: DropSweep) -> list[str]:
    """Return each figure's median and its 5 and 95 % over the phases, as text."""
    middle, low, high = (_figures(percentiles(sweep.summary, share)) for share in (50.0, 5.0, 95.0))
    return [f"{one} ({least} to {most})" for one, least, most in zip(middle, low, high)]
