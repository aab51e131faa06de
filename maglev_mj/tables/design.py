"""A designed wall as text."""

from __future__ import annotations

from maglev_mj.spec import RANGE
from maglev_mj.studies.designed_wall import DesignResult
from maglev_mj.theory.design import Case

__all__ = ["design_table"]

_MOST_LISTED = 8


def design_table(result: DesignResult) -> str:
    """Return gains, margins, contact and the check by simulation, as text."""
    wall, contact = result.wall, result.contact
    needs = wall.requirements
    law = "PD wall" if wall.pole is None else f"{wall.law} wall, poles at {wall.pole:g},"
    lines = [
        f"Stiffest {law} at {1.0 / needs.period:g} Hz, every modulus at most {needs.modulus:g}",
        f"  over the product of mass {_span(needs.mass, 1.0)} kg, delay {_span(needs.delay, 1e3)} ms"
        + (" and lag of the drivers" if needs.driver_lag else ""),
        f"  and hands {', '.join(needs.hands)}",
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
