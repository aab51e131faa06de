"""What pictures share: colours, a figure with quiet axes, panels of curves, and writing to a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import MaglevError
from maglev_mj.parameters import flag

__all__ = [
    "FIRST",
    "GRID",
    "IDEAL",
    "MANY",
    "SECOND",
    "WALL",
    "ChartsMissingError",
    "Panel",
    "new_figure",
    "require",
    "save",
    "small_multiples",
]

FIRST, SECOND, IDEAL, GRID, WALL = "#0b6e99", "#d1495b", "#5a5f66", "#e3e5e8", "#f1efe9"
MANY = (FIRST, SECOND, "#7a8b3c", "#8d6cab", "#e3973b", "#4f5a65", "#3aa6a0")


class ChartsMissingError(MaglevError):
    """matplotlib is not installed."""


def require() -> None:
    """Check that pictures can be drawn.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    try:
        import matplotlib.figure  # noqa: F401 - only whether it is there
    except ImportError:
        raise ChartsMissingError("pictures need matplotlib: pip install 'maglev-mj[charts]'") from None


def new_figure(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, list[Any]]:
    """Return a figure of rows x columns panels, `size` in inches, and the panels row by row."""
    require()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(np.atleast_1d(figure.subplots(rows, columns, **options)).ravel())
    for panel in axes:
        panel.grid(color=GRID, linewidth=0.8)
        panel.set_axisbelow(True)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    return figure, axes


def save(figure: Any, path: Path) -> Path:
    """Write the figure and return its path."""
    figure.savefig(path, dpi=150)
    return path


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
