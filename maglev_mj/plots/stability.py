"""Pictures of stability: maps over the gains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.plots.drawing import FIRST, IDEAL, SECOND, new_figure, save
from maglev_mj.studies.stability_map import StabilityMap

__all__ = ["level_sets", "stability_map"]

_LEVELS = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0])


def level_sets(panel: Any, x: Array, y: Array, modulus: Array) -> None:
    """Draw the level sets of the largest modulus into a panel, the boundary of stability bold.

    Args:
        panel: matplotlib axes.
        x: Values along the abscissa, (B,).
        y: Values along the ordinate, (K,).
        modulus: (K, B).
    """
    panel.contourf(x, y, modulus, levels=[0.0, *_LEVELS], cmap="GnBu_r", vmin=0.2, vmax=1.1)
    lines_ = panel.contour(x, y, modulus, levels=_LEVELS[:-1], colors=IDEAL, linewidths=0.7)
    panel.clabel(lines_, fmt="%g", fontsize=8)
    panel.contour(x, y, modulus, levels=[1.0], colors=FIRST, linewidths=2.2)


def stability_map(result: StabilityMap, path: Path) -> Path:
    """Draw the map: level sets by theory, simulated verdicts as dots, the stiffest wall marked.

    Args:
        result: The map; its grid must have at least two values on each axis.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    p = result.parameters
    figure, (panel,) = new_figure(1, 1, (7.6, 5.8))
    level_sets(panel, result.damping, result.stiffness, result.modulus)
    best = result.maximum
    panel.plot(
        best.damping, best.stiffness, "*", color=SECOND, markersize=14, label="stiffest by theory", clip_on=False
    )
    if result.simulated is not None:
        k, b = np.meshgrid(result.stiffness, result.damping, indexing="ij")
        settles = result.simulated
        size = max(60.0 / max(len(result.stiffness), len(result.damping)), 0.6) * 1.6
        panel.plot(b[settles], k[settles], ".", color="#12344d", markersize=size, label=f"settles ({p.plant})")
        if result.misjudged is not None and result.misjudged.any():
            wrong = result.misjudged
            panel.plot(b[wrong], k[wrong], "x", color=SECOND, label="simulation and theory differ")
    panel.set_xlabel("damping (N s/m)")
    panel.set_ylabel("stiffness (N/m)")
    panel.set_xlim(result.damping.min(), result.damping.max())
    panel.set_ylim(result.stiffness.min(), result.stiffness.max())
    panel.legend(frameon=True, framealpha=0.9, edgecolor="none", loc="upper right")
    hand = "" if p.hand == "none" else f", hand {p.hand}"
    panel.set_title(
        f"largest modulus: {1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms, {p.mass:g} kg{hand}\n"
        f"stiffest wall {float(best.stiffness):.0f} N/m at {float(best.damping):.1f} N s/m",
        loc="left",
        fontsize=10.5,
    )
    return save(figure, path)
