"""Pictures of stability: maps over the gains, bounds beside the exact boundary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.frames import Array, Mask
from maglev_mj.parameters import flag
from maglev_mj.plots.drawing import FIRST, IDEAL, MANY, SECOND, new_figure, save
from maglev_mj.studies.stability_map import StabilityMap

__all__ = ["Panel", "figure_2", "level_sets", "shares", "small_multiples", "stability_map"]

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
        outside: For each curve, which points leave the device's range: they are drawn hollow. Empty for none.
        legend: Where the names of the curves stand: "best" inside, "below" under the panel.
    """

    title: str
    labels: tuple[str, str]
    curves: Sequence[tuple[str, Any, Any]]
    log: str = ""
    level: float | None = None
    top: float | None = None
    marked: bool = False
    outside: Sequence[Any] = ()
    legend: str = "best"

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
    deep = any(panel.legend == "below" for panel in panels)
    figure, axes = new_figure(rows, columns, ((5.8 if deep else 5.0) * columns, (4.3 if deep else 3.7) * rows))
    for axis, panel in zip(axes, panels):
        for place, (label, x, y) in enumerate(panel.curves):
            color = MANY[place % len(MANY)]
            axis.plot(
                x,
                y,
                label=label,
                color=color,
                linewidth=1.7,
                linestyle=("-", "--", "-.", ":")[place // 2 % 4],
                marker="o" if panel.marked else None,
                markersize=4,
            )
            if panel.outside and np.any(hollow := np.asarray(panel.outside[place])):
                style = {"color": color, "markersize": 6, "markerfacecolor": "white", "linestyle": "none"}
                axis.plot(np.asarray(x)[hollow], np.asarray(y)[hollow], marker="o", **style)
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
            _name_curves(axis, panel)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    return save(figure, path)


def _name_curves(axis: Any, panel: Panel) -> None:
    """Add the legend, with a line of its own for hollow points."""
    handles, labels = axis.get_legend_handles_labels()
    if any(np.any(hollow) for hollow in panel.outside):
        handles += axis.plot([], [], "o", color=IDEAL, markersize=6, markerfacecolor="white")
        labels += ["hollow: leaves the device's range"]
    if panel.legend == "below":
        columns = 1 if max(map(len, labels)) > 36 else 2
        where = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.17), "ncols": columns, "columnspacing": 1.2}
        axis.legend(handles, labels, frameon=False, fontsize=8.5, **where)
    else:
        axis.legend(handles, labels, frameon=True, framealpha=0.85, edgecolor="none", fontsize=8.5)


def shares(
    maps: Sequence[tuple[str, Array, Mask]], axes: tuple[Array, Array], labels: tuple[str, str, str], path: Path
) -> Path:
    """Draw maps of shares over two values side by side.

    Args:
        maps: Title, shares (M, N), and which cells leave the device's range (M, N), of each map.
        axes: Values of the rows (M,) and of the columns (N,).
        labels: Names of rows, columns and share.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    rows, columns = axes
    size = (0.42 * len(columns) * len(maps) + 0.9, 0.32 * len(rows) + 1.7)
    figure, panels = new_figure(1, len(maps), size, sharey=True)
    for panel, (title, share, outside) in zip(panels, maps, strict=True):
        panel.grid(visible=False)
        panel.imshow(np.ma.masked_equal(share, 0.0), cmap="GnBu", vmin=-0.1, vmax=1.4, aspect="auto", origin="lower")
        for (row, column), value in np.ndenumerate(share):
            if value > 0.0:
                text = "1" if value == 1.0 else f"{value:.2f}".lstrip("0")
                panel.text(column, row, text, ha="center", va="center", fontsize=7.5)
        left_row, left_column = np.nonzero(outside)
        panel.plot(left_column + 0.32, left_row + 0.32, ".", color=SECOND, markersize=3.5)
        panel.set_xticks(range(len(columns)), [f"{value:g}" for value in columns], fontsize=8.0, rotation=90)
        panel.set_yticks(range(len(rows)), [f"{value:g}" for value in rows], fontsize=8.0)
        panel.set_xlabel(labels[1])
        panel.set_title(title, loc="left", fontsize=10.5)
    panels[0].set_ylabel(labels[0])
    (dot,) = panels[0].plot([], [], ".", color=SECOND, markersize=5)
    names = f"red dot: leaves the device's range; number: {labels[2]}; white: none"
    figure.legend([dot], [names], frameon=False, loc="outside lower center", fontsize=9.0)
    return save(figure, path)
