"""The device report as text."""

from __future__ import annotations

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.model import COILS
from maglev_mj.report import DeviceReport
from maglev_mj.spec import Spec

__all__ = ["device_table"]


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
