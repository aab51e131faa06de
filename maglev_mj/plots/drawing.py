"""What every picture shares: a figure with quiet axes, the colours, and writing it to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import MaglevError

__all__ = ["FIRST", "GRID", "IDEAL", "MANY", "SECOND", "ChartsMissingError", "new_figure", "require", "save"]

FIRST, SECOND, IDEAL, GRID = "#0b6e99", "#d1495b", "#5a5f66", "#e3e5e8"
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
