"""A ladder of models, and what each rung changes, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from maglev_mj.experiments.fidelity import FidelityResult, RungResult, StepResult, stepping_name

__all__ = ["fidelity_table", "ladder_table"]

_STEPS_SHOWN = 12


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
