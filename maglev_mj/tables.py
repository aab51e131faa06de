"""Results as text for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from maglev_mj import bounds
from maglev_mj.experiments.choices import SLIDES_AT
from maglev_mj.experiments.drop import DropResult, DropSweep
from maglev_mj.experiments.fidelity import FidelityResult, RungResult, StepResult, stepping_name
from maglev_mj.experiments.stability_map import StabilityMap
from maglev_mj.experiments.stick_slip import StickSlipResult, exact_stick_slip
from maglev_mj.frames import AXES
from maglev_mj.metrics import percentiles
from maglev_mj.model import COILS
from maglev_mj.report import DeviceReport
from maglev_mj.spec import Spec
from maglev_mj.stability import is_stable

__all__ = [
    "device_table",
    "drop_table",
    "fidelity_table",
    "ladder_table",
    "stability_table",
    "stick_slip_table",
    "sweep_table",
]

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
    one, many = 15, 26
    if sweeps:
        over = f"over {sweeps[0].phases.size} phases: median (5 to 95 %)"
        lines.append(
            " " * 15 + f"{f'at phase {p.phase:g}':>{one}}" + " " * one * (len(labels) - 1) + f"   {over:>{many}}"
        )
    head = "".join(f"{label:>{one}}" for label in labels)
    lines.append(" " * 15 + head + "".join(f"{label:>{many}}" for label in labels[: len(sweeps)]))
    spreads = [[percentiles(sweep.summary, share) for share in (50.0, 5.0, 95.0)] for sweep in sweeps]
    for name, label, scale, unit in _FIGURES:
        cells = "".join(f"{_cell(getattr(result.summary, name), scale):>{one}}" for result in results)
        for spread in spreads:
            middle, low, high = (_cell(getattr(summary, name), scale) for summary in spread)
            cells += f"{f'{middle} ({low} to {high})':>{many}}"
        lines.append(f"  {label:<13}{cells}  {unit}")
    for sweep, label in zip(sweeps, labels):
        settled = int(np.isfinite(sweep.summary.settling_time).sum())
        if settled < sweep.phases.size:
            lines.append(f"  {label}: settled within {p.duration:g} s at {settled} of {sweep.phases.size} phases")
    peak, device = float(results[0].summary.peak_force), Spec.largest_vertical_force.value
    if peak > device * (1.0 + 1e-9):
        lines += ["", f"  The device gives {device:g} N along z, less than this peak: see --force-limit {device:g}"]
    lines += ["", f"  MuJoCo and the exact plant differ by at most {gap:.1e} m"]
    return "\n".join(lines)


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
    return "\n".join(lines)


def stability_table(result: StabilityMap) -> str:
    """Return the stiffest wall, the published bounds at its damping, and how theory and simulation agree, as text."""
    p, best = result.parameters, result.maximum
    stiffest, damping = float(best.stiffness), float(best.damping)
    hand = "no hand" if p.hand == "none" else f"hand {p.hand}"
    lines = [
        f"Stability of a PD wall, {1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms, mass {p.mass:g} kg, {hand}",
        "",
        f"  stiffest stable wall  {stiffest:>9.0f} N/m at {damping:.1f} N s/m"
        if stiffest > 0.0
        else "  no wall is stable",
        "  at this damping, without a hand's share, the published bounds are (times the stiffest wall)",
    ]
    for name, bound, sense in (
        ("Colgate & Schenkel", bounds.colgate(damping, period=p.period), "passive, no delay: none on a bare flotor"),
        ("Gil et al.", bounds.gil(damping, period=p.period, delay=p.delay), "stable, low damping"),
        ("Minsky et al.", bounds.minsky(damping, period=p.period), "stable, no delay, low damping"),
    ):
        ratio = f"{float(bound) / stiffest:.2f}" if stiffest > 0.0 else "-"
        lines.append(f"    {name:<20}{float(bound):>9.0f} N/m  {ratio:>5}   {sense}")
    stable = int(is_stable(result.modulus).sum())
    lines += ["", f"  grid: {stable} of {result.modulus.size} cells stable by theory"]
    if result.simulated is not None and result.misjudged is not None:
        differ = int((is_stable(result.modulus) != result.simulated).sum())
        lines += [
            f"  simulated ({p.plant}): {int(result.simulated.sum())} stable; {differ} verdicts differ from theory, "
            f"{int(result.misjudged.sum())} of them",
            f"  further than 0.5 % of a gain from the boundary ({int(result.near.sum())} cells are nearer)",
        ]
    return "\n".join(lines)


def sweep_table(
    scene: str, varied: Mapping[str, Sequence[Any]], results: Sequence[Mapping[str, Any]], known: int, path: str
) -> str:
    """Return how many cells were computed and the spread of each figure over them, as text.

    Args:
        scene: What was swept.
        varied: Values of the parameters that vary.
        results: Figures of each cell, or {"error": ...}.
        known: How many cells the record held already.
        path: Where the record is.
    """
    failed = [result["error"] for result in results if "error" in result]
    over = ", ".join(f"{name} ({len(values)})" for name, values in varied.items()) or "nothing"
    lines = [
        f"Sweep of {scene} over {over}: {len(results)} cells, {known} of them already in {path}",
        "",
        f"  {'':<20}{'least':>12}{'median':>12}{'greatest':>12}   cells",
    ]
    good = [result for result in results if "error" not in result]
    for name in good[0] if good else ():
        values = [float(result[name]) for result in good if isinstance(result[name], int | float)]
        if values:
            spread = "".join(f"{share:>12.4g}" for share in np.percentile(values, [0.0, 50.0, 100.0]))
            lines.append(f"  {name:<20}{spread}   {len(values)}")
    if failed:
        lines += ["", f"  {len(failed)} cells failed, the first because {failed[0]}"]
    return "\n".join(lines)


def _fine(value: float) -> str:
    """Return a figure in thousandths, to four digits after the point; a dash for one that is not there."""
    return f"{value * 1e3:.4f}" if np.isfinite(value) else "-"


def _cell(value: Any, scale: float) -> str:
    """Return a figure to four digits; a dash for one that is not there."""
    number = float(value) * scale
    if not np.isfinite(number):
        return "-"
    return f"{number:.0f}" if abs(number) >= 100.0 else f"{number:.1f}" if abs(number) >= 10.0 else f"{number:.2f}"


def device_table(report: DeviceReport) -> str:
    """Return the report as text for a terminal."""
    lines = ["The UBC maglev joystick: what the paper prints and what the compiled model yields", ""]
    lines.append(f"  {'':<32}{'paper':>8}{'model':>9}  unit")
    for row in report.table:
        remark = f"   {row.remark}" if row.remark else ""
        lines.append(f"  {row.name:<32}{row.paper:>8}{row.model:>9}  {row.unit:<5}{remark}".rstrip())
    figures = report.figures
    inertia = ", ".join(f"{value * 1e4:.2f}" for value in figures["inertia"])
    lines += [
        "",
        f"  inertia about x, y, z with handle  {inertia}  1e-4 kg m² (assumed)",
        f"  hover current, each vertical coil  {figures['hover_current']:.2f} A at {figures['moving_mass']:g} kg",
        "",
        f"  {'largest pure force or torque':<32}" + "".join(f"{axis:>9}" for axis in AXES),
    ]
    for name, key in (
        (f"at {Spec.continuous_current.value:g} A", "largest_at_continuous_current"),
        (f"at {figures['peak_current']:g} A", "largest_at_peak_current"),
    ):
        lines.append(f"  {name:<32}" + "".join(f"{value:>9.3g}" for value in figures[key]) + "  N, N m")
    lines += ["", "  wrench map, N/A and N m/A for one ampere in each coil (coil places are assumed)"]
    lines.append(f"  {'':<6}" + "".join(f"{coil:>13}" for coil in COILS))
    for axis, row in zip(AXES, figures["wrench_map"], strict=True):
        lines.append(f"  {axis:<6}" + "".join(f"{value + 0.0:>13.4f}" for value in np.round(row, 12)))
    lines += [
        f"  condition number {figures['condition_number']:.2f} with torques over the mean arm of "
        f"{figures['mean_arm'] * 1e3:.1f} mm, {figures['condition_number_si']:.1f} in SI units",
        "",
        "  where the paper contradicts itself",
    ]
    lines += [f"  - {text}" for text in report.contradictions]
    return "\n".join(lines)


def fidelity_table(result: FidelityResult) -> str:
    """Return a ladder, the rung chosen on it, and the steps on that rung, as text."""
    scene, chosen = result.scene, result.rung
    own = f" ({scene.reason})" if result.tolerance == scene.tolerance else ""
    lines = [
        f"Fidelity of {scene.name}: {scene.says}",
        f"  to be kept: {_micro(result.tolerance)}, as the greatest displacement of a coil{own}",
        "  each line adds a piece of the device to those above it; lacks still: what the lines below it would change",
        "",
        f"    {'rung':<10}{'adds':<54}{'changes by':>12}{'lacks still':>13}{'peak force':>12}{'cost':>9}",
    ]
    for row in result.rungs:
        mark = ">" if row is chosen else " "
        lines.append(
            f"  {mark} {row.rung:<10}{row.says:<54}{_micro(row.changes):>12}{_micro(row.missing):>13}"
            f"{_newtons(row.force):>12}{row.cost * 1e3:>9.1f}"
        )
    lines += [
        "  cost in µs a simulated ms; a real millisecond is 1000",
        "",
        f"  on the rung {chosen.rung}, cheapest first: integrator and longest step, error against 20 µs of RK4, cost",
    ]
    for step in sorted(result.steps, key=lambda row: (row.cost, row.error))[:_STEPS_SHOWN]:
        mark = ">" if step is result.cheapest else " "
        lines.append(f"  {mark} {_stepping(step):<40}{_micro(step.error):>12}{step.cost * 1e3:>12.1f}")
    diverged = sum(not np.isfinite(step.error) for step in result.steps)
    if diverged:
        lines.append(f"    {diverged} others diverge")
    if result.cheapest is None:
        lines.append("  none of them keeps what the model leaves of the tolerance")
    else:
        lines += [
            "",
            f"  take {chosen.rung} with {_stepping(result.cheapest)}: {result.cheapest.cost * 1e3:.1f} µs a ms",
        ]
    return "\n".join(lines)


def ladder_table(ladders: Mapping[str, Sequence[RungResult]]) -> str:
    """Return what each rung changes in each scene, as text."""
    names = list(ladders)
    lines = [
        "What each rung changes in each scene, against the rung below: greatest displacement of a coil (µm)",
        "",
        f"  {'rung':<10}" + "".join(f"{name:>15}" for name in names) + "   cost (µs a ms)",
    ]
    for place, first in enumerate(ladders[names[0]]):
        rows = [ladders[name][place] for name in names]
        costs = [row.cost * 1e3 for row in rows]
        changes = "".join(f"{_micro(row.changes)[:-3]:>15}" for row in rows)
        lines.append(f"  {first.rung:<10}{changes}   {min(costs):.1f} to {max(costs):.1f}")
    lines += ["", *(f"  {row.rung:<10}{row.says}" for row in ladders[names[0]])]
    return "\n".join(lines)


_STEPS_SHOWN = 12


def _stepping(step: StepResult) -> str:
    return step.integrator if step.integrator == "closed form" else stepping_name(step.integrator, step.step)


def _newtons(change: float) -> str:
    """Return a change of force; a dash for none."""
    return f"{change:+.2f} N" if abs(change) >= 0.005 else "-"


def _micro(value: float) -> str:
    """Return a length in micrometres, to three digits; a dash for none at all."""
    if not np.isfinite(value):
        return "- µm"
    micro = value * 1e6
    return f"{micro:.0f} µm" if micro >= 100.0 else f"{micro:.3g} µm" if micro >= 0.001 else "0 µm"
