"""Stability maps and designed walls as text."""

from __future__ import annotations

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.scenes.scene import Scene
from maglev_mj.spec import RANGE
from maglev_mj.studies.designed_wall import DesignResult
from maglev_mj.studies.nonlinear import SAMPLES, DropMap, Ending
from maglev_mj.studies.stability_map import StabilityMap, StabilityParameters
from maglev_mj.terminal import wrapped
from maglev_mj.theory import StiffestWall, Verdict, bounds, is_stable
from maglev_mj.theory.design import Case

_MOST_LISTED = 8


def stability_table(result: StabilityMap) -> str:
    """Return the stiffest wall and published bounds as text.

    The bounds at its damping, and the agreement of theory and simulation.
    """
    p, best = result.parameters, result.maximum
    stiffest, damping = float(best.stiffness), float(best.damping)
    lines = [
        *wrapped(f"Stability of a PD wall, {_loop(p)}", ""),
        "",
        f"  stiffest stable wall   {_stiffest(best)}",
        *(["  at a damping slightly beside the jump, softer walls are unstable"] if best.on_jump else []),
        "  published bounds at this damping, without a hand; times the stiffest wall",
    ]
    for name, bound, sense in (
        ("Colgate & Schenkel", bounds.colgate(damping, period=p.period), "passive; none on a bare flotor"),
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
            *wrapped(
                f"simulated ({p.plant}): {int(result.simulated.sum())} stable; {differ} verdicts differ from theory, "
                f"{int(result.misjudged.sum())} of them further than 0.5 % of a gain from the boundary "
                f"({int(result.near.sum())} cells are nearer)"
            ),
        ]
    return "\n".join(lines)


def drop_table(result: DropMap) -> str:
    """Return the results of drops on walls as text.

    Differences from theory are listed.
    """
    p, settles, stable = result.parameters, result.settles, result.stable_by_theory
    up_to = result.settles_up_to
    best = int(np.argmax(up_to))
    counts = {one: int((result.ending == one).sum()) for one in Ending}
    lines = [
        *wrapped(f"Drops on PD walls, {_loop(p)}: {p.described}", ""),
        "",
        f"  grid: {settles.size} walls, {int(stable.sum())} stable by theory",
        *wrapped(
            f"{counts[Ending.SETTLES]} settle: {SAMPLES} samples on they swing by at most {p.band * 1e6:g} µm, or ever "
            f"less without leaving the wall; {counts[Ending.GOES_ON]} go on; {counts[Ending.GAINS]} rise above where "
            "they were released"
        ),
        f"  stiffest up to which all settle  {up_to[best]:>8.0f} N/m at {result.damping[best]:.1f} N s/m"
        if up_to[best] > 0.0
        else "  none settles",
        f"  stiffest stable wall by theory   {_stiffest(result.maximum)}",
        f"  stable by theory, does not settle {int((stable & ~settles).sum()):>7}",
        f"  settles, unstable by theory       {int((~stable & settles).sum()):>7}",
    ]
    return "\n".join(lines)


def _stiffest(best: StiffestWall) -> str:
    amount, _, rest = best.describe().partition(" ")
    return f"{amount:>8} {rest}"


def _loop(p: StabilityParameters) -> str:
    hand = "no hand" if p.hand == "none" else f"hand {p.hand}"
    return f"{1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms, mass {p.mass:g} kg, {hand}"


def loop_table(scene: Scene, verdict: Verdict) -> str:
    """Return the stability of a scene's closed loop as text.

    Each state of the laws has a line; without stated gains, the worst pose is named.
    """
    place = ", ".join(f"{axis} {value:g}" for axis, value in zip(AXES, verdict.pose, strict=True) if value) or "centre"
    states = [str(state) for state in verdict.states] or [f"{verdict}; at {place} (m, rad)"]
    means = "by the laws' own gains" if verdict.stated else "by the answers of the laws to small displacements"
    lines = wrapped(f"{scene.name}: {scene.describe()}", "", "  ")
    for text in (*states, f"found {means}", *verdict.remarks):
        lines += wrapped(text)
    return "\n".join(lines)


def design_table(result: DesignResult) -> str:
    """Return gains, margins, contact and simulated check as text."""
    wall, contact = result.wall, result.contact
    needs = wall.requirements
    law = "PD wall" if wall.pole is None else f"{wall.law} wall, poles at {wall.pole:g},"
    lines = [
        *wrapped(f"Stiffest {law} at {1.0 / needs.period:g} Hz, every modulus at most {needs.modulus:g}", "", "  "),
        *wrapped(
            f"over the product of mass {_span(needs.mass, 1.0)} kg, delay {_span(needs.delay, 1e3)} ms"
            + (" and lag of the drivers" if needs.driver_lag else "")
        ),
        *wrapped(f"and hands {', '.join(needs.hands)}"),
        "",
        f"  stiffness                {wall.stiffness:>8.0f} N/m"
        + ("" if wall.pole is None else f"    {wall.rendered:.0f} N/m against a slow push"),
        f"  damping                  {wall.damping:>8.1f} N s/m",
    ]
    if contact.pulse:
        lines.append(
            f"  pulse                    {contact.pulse_of(wall):>8.1f} N s/m  further, for "
            f"{contact.pulse_width * 1e3:g} ms, from {result.gate * 1e3:.1f} mm/s on"
        )
    lines += [
        f"  largest modulus          {wall.modulus:>8.4f}        {_case(wall.worst)}",
        f"  least dynamic stiffness  {wall.dynamic_stiffness:>8.0f} N/m    {_case(wall.softest)}",
        f"  hum, at rest             {result.hum:>8.3f} N      "
        f"{contact.quantize * 1e6:g} µm sensor, hand {needs.hands[0]}",
        f"  depth, at {contact.speed:g} m/s".ljust(27)
        + f"{result.depth * 1e3:>8.2f} mm     "
        + ("beyond the device's range" if result.depth > RANGE[2] else "worst of corners, hands, phases"),
        f"  peak force, likewise     {result.peak:>8.1f} N"
        + ("      the limit" if contact.force_limit is not None and result.peak >= contact.force_limit else ""),
    ]
    if result.reference is not None:
        pd = result.reference
        lines.append(f"  PD alone would reach     {pd.stiffness:>8.0f} N/m    {pd.dynamic_stiffness:.0f} N/m dynamic")
    if wall.island is not None:
        lines.append(f"  island, not used: from   {wall.island:>8.0f} N/m    on, stable again in some of the cases")
    growing = [case for case, grows in zip(result.cases, result.grows) if grows]
    lines += [
        "",
        f"  {len(result.cases)} cases simulated, in and out of contact: {len(growing) or 'none'} grow or go on",
    ]
    lines += [f"    {_case(case)}" for case in growing[:_MOST_LISTED]]
    if len(growing) > _MOST_LISTED:
        lines.append(f"    and {len(growing) - _MOST_LISTED} more")
    return "\n".join(lines)


def _span(ends: tuple[float, float], scale: float) -> str:
    low, high = (f"{end * scale:g}" for end in ends)
    return low if low == high else f"{low} to {high}"


def _case(case: Case) -> str:
    return f"{case.mass:.3g} kg, {case.delay * 1e3:.3g} ms, hand {case.hand}"
