"""Model levels and their effects as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from maglev_mj.result import number_text, wrapped
from maglev_mj.studies.fidelity import DEAR, DEAR_CASES, MARGIN, FidelityResult, LevelResult, stepping_name
from maglev_mj.studies.levels import has_gains, level_index

_STEPS_SHOWN = 12


def fidelity_table(result: FidelityResult) -> str:
    """Return the levels, the choice and its steps as text."""
    preset, chosen = result.preset, result.level
    own = f" ({preset.reason})" if result.tolerance == preset.tolerance else ""
    lines = [
        *wrapped(f"Fidelity of {preset.name}: {preset.scene.describe()}", "", "  "),
        *wrapped(f"to be kept: {_micro(result.tolerance)}, as the greatest displacement of a coil{own}"),
        *_range_lines(result),
        "  each level adds to those above it; worst: distance from any line below it",
        "",
        f"    {'level':<10}{'changes':>10}{'worst':>10}{'within':>9}{'force':>10}{'cost':>8}",
    ]
    for row in result.levels:
        mark = ">" if row is chosen else " "
        diverged = f"  diverges in {row.diverged}" if row.diverged else ""
        lines.append(
            f"  {mark} {row.level:<10}{_micro(row.changes):>10}{_micro(row.worst):>10}"
            f"{_percent(row.keeps):>9}{_newtons(row.force):>10}{row.cost * 1e3:>8.1f}{diverged}"
        )
    lines += [
        *wrapped(
            "changes and force: in the scene itself; worst: over all cases; within: share of the cases that keep the "
            "tolerance with the margin; cost in µs a simulated ms, of which a real one has 1000"
        ),
        "",
        *_added(result.levels),
    ]
    if chosen is None:
        unstable = (
            "; the loop diverges on the exact plant at these gains or near them"
            if result.levels[-1].worst == np.inf
            else ""
        )
        return "\n".join([*lines, "", *wrapped(f"no level keeps the tolerance{unstable}")])
    lines += [
        "",
        *wrapped(
            f"on the level {chosen.level}, cheapest first: integrator and longest step, error against 20 µs of RK4, "
            f"shift of the stability boundary (at most {result.over.boundary:.3g} allowed), worst over all cases, cost"
        ),
    ]
    for step in result.steps[:_STEPS_SHOWN]:
        mark, name = ">" if step is result.cheapest else " ", stepping_name(*step[:2])
        shift = "" if step.shift is None else f"{step.shift:+.1%}" if abs(step.shift) >= 5e-4 else "0 %"
        worst = "" if step.missing is None else _micro(step.missing)
        lines.append(f"  {mark} {name:<36}{_micro(step.error):>10}{shift:>9}{worst:>11}{step.cost * 1e3:>10.1f}")
    if diverged_steps := sum(not np.isfinite(step.error) for step in result.steps):
        lines.append(f"    {diverged_steps} diverge")
    if result.cheapest is None:
        return "\n".join([*lines, "  none of them keeps tolerance and boundary"])
    most = MARGIN * (result.cheapest.missing or 0.0)
    lines += [
        "",
        *wrapped(
            f"take {chosen.level} with {stepping_name(*result.cheapest[:2])}: {result.cheapest.cost * 1e3:.1f} µs a ms"
        ),
        *wrapped(
            f"within {_micro(most)} in {result.over.share:.4g} of {_cases(result)}, the margin of {MARGIN:g} included; "
            f"{_others(result)}"
        ),
    ]
    return "\n".join(lines)


def _cases(result: FidelityResult) -> str:
    """Return the cases that the share is one of."""
    if not result.unscreened or result.level is None:
        return "the cases"
    count = min(len(result.cases), DEAR_CASES) if level_index(result.level.level) >= DEAR else len(result.cases)
    why = f" alone, as {result.unscreened}" if result.screened else ""
    return f"{count} cases of the whole device{why}"


def _others(result: FidelityResult) -> str:
    """Return how far the other cases go."""
    if result.furthest is None:
        return "how far others go is not known"
    jumps = ", where a sample just meets the wall or misses it" if result.jump else ""
    return f"none expected beyond {_micro(result.furthest)}{jumps}"


def _range_lines(result: FidelityResult) -> list[str]:
    """Return lines about the cases: kinds, numbers, contact with stops."""
    over, count = result.over, len(result.cases)
    seeds = "phases with a jitter seed each" if result.preset.scene.takes_phase else "jitter seeds"
    lines = [f"{count} cases of the whole device: {over.phases} {seeds}"]
    if has_gains(result.preset.scene) and over.around:
        lines[0] += f", times 5 pairs of gains (given, and {over.around:.3g} of each up and down)"
    if not result.screened:
        lines.append(f"none on the exact plant, which takes many devices at once: {result.unscreened}")
    else:
        lines.append(f"and {result.screened} on the exact plant in the same range: lag, limit, sensor's steps, jitter")
    lines.append(
        f"kept if {MARGIN:g} times the worst of {over.share:.4g} of these is: the margin for cases not looked at"
    )
    if result.met_stops:
        lines.append(
            f"THE MOTION MEETS THE METAL STOPS of the model in {result.met_stops} of {count} cases: levels without "
            "stops are those of another motion"
        )
    return [line for text in lines for line in wrapped(text)]


def levels_table(found: Mapping[str, Sequence[LevelResult]]) -> str:
    """Return each level's effect in each scene as text."""
    names = list(found)
    heads = {name: name.split("-", 1) for name in names}  # over two lines
    lines = [
        "What each level changes in each scene, against the level below: greatest",
        "  displacement of a coil [µm]; and the cost of a simulated ms [µs]",
        "",
        " " * 11 + "".join(f"{heads[name][0]:>8}" for name in names),
        f"  {'level':<9}" + "".join(f"{''.join(heads[name][1:]):>8}" for name in names) + f"{'cost':>13}",
    ]
    for place, first in enumerate(found[names[0]]):
        rows = [found[name][place] for name in names]
        costs = [row.cost * 1e3 for row in rows]
        changes = "".join(f"{_micro(row.changes)[:-3]:>8}" for row in rows)
        cost = f"{number_text(min(costs), 3, 2)} to {number_text(max(costs), 3, 2)}"
        lines.append(f"  {first.level:<9}{changes} {cost:>12}")
    lines += ["", *_added(found[names[0]])]
    return "\n".join(lines)


def _added(levels: Sequence[LevelResult]) -> list[str]:
    """Return one line per level about its addition."""
    return [f"  {row.level:<10}{row.adds}" for row in levels]


def _newtons(change: float) -> str:
    """Return a change of force; a dash for none."""
    return f"{change:+.2f} N" if abs(change) >= 0.005 else "-"


def _percent(share: float) -> str:
    """Return a share in per cent; "all" only for 1."""
    return "all" if share == 1.0 else f"{min(share, 0.9999):.2%}"


def _micro(value: float) -> str:
    """Return a length in micrometres with three digits.

    A dash if not finite.
    """
    if not np.isfinite(value):
        return "- µm"
    micro = value * 1e6
    return f"{micro:.0f} µm" if micro >= 100.0 else f"{micro:.3g} µm" if micro >= 0.001 else "0 µm"
