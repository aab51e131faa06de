"""A stick-slip run as text."""

from __future__ import annotations

import numpy as np

from maglev_mj.experiments.stick_slip import StickSlipResult, exact_stick_slip
from maglev_mj.frames import AXES
from maglev_mj.scenes.choices import SLIDES_AT
from maglev_mj.tables.limits import beyond_range

__all__ = ["stick_slip_table"]


def stick_slip_table(result: StickSlipResult) -> str:
    """Return the figures of a stick-slip run beside those of the exact friction that its law stands for, as text."""
    p, figures = result.parameters, result.summary
    length, force, unit = ("mm", "N", "N/m") if p.axis in AXES[:3] else ("mrad", "N m", "N m/rad")
    motion = exact_stick_slip(p, result.series(1e-4)["time"])
    sticks = [event for event in motion.events if event.kind == "stick"]
    exact = "Coulomb" if SLIDES_AT.get(p.law, 1.0) else "Karnopp"
    tail = motion.position[motion.time >= p.duration - 0.05]
    rows = (
        ("peak speed", figures.peak_speed, float(np.abs(motion.velocity).max()), f"{length}/s"),
        ("sticks last at", figures.stick_time, sticks[-1].time if sticks else np.nan, "ms"),
        ("stick position", figures.stick_position, sticks[-1].position if sticks else np.nan, length),
        ("final position", figures.final_position, float(motion.position[-1]), length),
        ("ripple, last 50 ms", figures.ripple, float(np.ptp(tail)), length),
    )
    lines = [
        f"Spring of {p.spring:g} {unit} against {p.law}, axis {p.axis}, plant {p.plant}",
        f"  {1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms, velocity {p.velocity}, "
        f"breakaway {p.breakaway:g} {force}",
        "",
        f"  {'':<20}{'rendered':>12}{exact:>12}",
    ]
    lines += [f"  {name:<20}{_fine(one):>12}{_fine(two):>12}  {unit}" for name, one, two, unit in rows]
    lines.append(f"  {'changes of state':<20}{figures.transitions:>12}{len(motion.events):>12}")
    remarks = beyond_range([p.law], [result.trace.furthest()])
    return "\n".join([*lines, "", *remarks] if remarks else lines)


def _fine(value: float) -> str:
    """Return a figure in thousandths, to four digits after the point; a dash for one that is not there."""
    return f"{value * 1e3:.4f}" if np.isfinite(value) else "-"
