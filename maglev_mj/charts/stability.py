"""Pictures of stability: maps over the gains, bounds beside the exact boundary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.charts.drawing import FIRST, IDEAL, MANY, SECOND, new_figure, save
from maglev_mj.experiments.stability_map import StabilityMap
from maglev_mj.frames import Array
from maglev_mj.parameters import flag

__all__ = ["Panel", "figure_2", "level_sets", "small_multiples", "stability_map"]

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


def figure_2(cases: Sequence[tuple[str, Array, Array, Array, tuple[float, float]]], path: Path) -> Path:
    """Draw level sets of the largest modulus over (c_p, c_v), as figure 2 does, the maximum of c_p marked.

    Args:
        cases: Title, values of c_v (B,) and c_p (K,), modulus (K, B), and the maximum (c_v, c_p) of each panel.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = new_figure(1, len(cases), (5.6 * len(cases), 5.0))
    for panel, (title, cv, cp, modulus, top) in zip(panels, cases, strict=True):
        level_sets(panel, cv, cp, modulus)
        panel.plot(*top, "*", color=SECOND, markersize=14)
        panel.annotate(
            f"$c_p$ = {top[1]:.4f}, $c_v$ = {top[0]:.4f}",
            top,
            textcoords="offset points",
            xytext=(10, 6),
            fontsize=9.5,
        )
        panel.set_xlabel("$c_v = T k_v / 2m$")
        panel.set_ylabel("$c_p = T^2 k_p / 2m$")
        panel.set_title(title, loc="left", fontsize=10.5)
    return save(figure, path)


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One picture among several.

    Attributes:
        title: Above it.
        labels: What the two axes say.
        curves: Label, abscissa and ordinate of each.
        log: Which axes are logarithmic: "", "x", "y" or "xy".
        level: Where a thin horizontal line is drawn; None for none.
        top: Upper end of the ordinate; None for what the curves need.
        marked: Whether points are marked.
    """

    title: str
    labels: tuple[str, str]
    curves: Sequence[tuple[str, Any, Any]]
    log: str = ""
    level: float | None = None
    top: float | None = None
    marked: bool = False

    def __post_init__(self) -> None:
        flag("marked", self.marked)


def small_multiples(panels: Sequence[Panel], path: Path, columns: int = 2) -> Path:
    """Draw several panels of curves.

    Args:
        panels: What to draw, row by row.
        path: PNG to write.
        columns: How many stand side by side.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    rows = -(-len(panels) // columns)
    figure, axes = new_figure(rows, columns, (5.0 * columns, 3.7 * rows))
    for axis, panel in zip(axes, panels):
        for place, (label, x, y) in enumerate(panel.curves):
            axis.plot(
                x,
                y,
                label=label,
                color=MANY[place % len(MANY)],
                linewidth=1.7,
                linestyle=("-", "--", "-.", ":")[place // 2 % 4],
                marker="o" if panel.marked else None,
                markersize=4,
            )
        if "x" in panel.log:
            axis.set_xscale("log")
        if "y" in panel.log:
            axis.set_yscale("log")
        if panel.level is not None:
            axis.axhline(panel.level, color=IDEAL, linewidth=1.0, linestyle=":")
        if panel.top is not None:
            axis.set_ylim(0.0 if "y" not in panel.log else None, panel.top)
        axis.set_title(panel.title, loc="left", fontsize=10.5)
        axis.set_xlabel(panel.labels[0])
        axis.set_ylabel(panel.labels[1])
        if any(label for label, _, _ in panel.curves):
            axis.legend(frameon=True, framealpha=0.85, edgecolor="none", fontsize=8.5)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    return save(figure, path)
