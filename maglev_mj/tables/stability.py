"""A stability map as text."""

from __future__ import annotations

from maglev_mj.studies.stability_map import StabilityMap
from maglev_mj.theory import bounds, is_stable

__all__ = ["stability_table"]


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
