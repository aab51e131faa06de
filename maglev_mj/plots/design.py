"""Picture of a designed wall: its margin over masses and delays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.plots.drawing import FIRST, IDEAL, SECOND, new_figure, save
from maglev_mj.studies.designed_wall import DesignResult

__all__ = ["design_map"]


def design_map(result: DesignResult, path: Path) -> Path:
    """Draw the largest modulus over masses and delays, the worst of the hands, with the worst case marked.

    Level sets where both have a range, a curve where one has.

    Args:
        result: The design.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
        ParameterError: If neither mass nor delay has a range.
    """
    wall = result.wall
    needs, worst = wall.requirements, wall.worst
    sizes = result.masses.size, result.delays.size
    if sizes == (1, 1):
        raise ParameterError("mass or delay must be a range for a picture, not one value each")
    figure, (panel,) = new_figure(1, 1, (7.4, 5.4))
    marked = f"worst: {wall.modulus:.4f}, hand {worst.hand}"
    if min(sizes) > 1:
        low, high = float(result.map.min()), float(result.map.max())
        levels = np.linspace(low, high, 9)
        panel.contourf(
            result.delays * 1e3, result.masses, result.map, levels=levels, cmap="GnBu", vmax=2.0 * high - low
        )
        lines = panel.contour(result.delays * 1e3, result.masses, result.map, levels=levels[1:-1], colors=IDEAL)
        panel.clabel(lines, fmt="%.3f", fontsize=8.5)
        panel.plot(worst.delay * 1e3, worst.mass, "*", color=SECOND, markersize=15, label=marked, clip_on=False)
        panel.set_xlabel("delay (ms)")
        panel.set_ylabel("mass (kg)")
    else:
        along_mass = sizes[0] > 1
        x = result.masses if along_mass else result.delays * 1e3
        panel.plot(x, result.map.ravel(), color=FIRST, linewidth=2.0)
        at = worst.mass if along_mass else worst.delay * 1e3
        panel.plot(at, wall.modulus, "*", color=SECOND, markersize=15, label=marked, clip_on=False)
        panel.axhline(needs.modulus, color=IDEAL, linestyle=":", label=f"allowed: {needs.modulus:g}")
        panel.set_xlabel("mass (kg)" if along_mass else "delay (ms)")
        panel.set_ylabel("largest modulus")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    law = "PD wall" if wall.pole is None else "Observer wall"
    panel.set_title(
        f"{law} of {wall.stiffness:.0f} N/m and {wall.damping:.1f} N s/m, {1.0 / needs.period:g} Hz\n"
        f"largest modulus over the hands {', '.join(needs.hands)}",
        loc="left",
        fontsize=10.5,
    )
    return save(figure, path)
