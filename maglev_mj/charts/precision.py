"""Work and precision: what an answer costs against how far it is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maglev_mj.charts.drawing import IDEAL, MANY, SECOND, new_figure, save

__all__ = ["WorkPoint", "WorkPrecision", "pareto", "work_precision"]

_LEAST = 1e-14


@dataclass(frozen=True)
class WorkPoint:
    """One way to an answer.

    Attributes:
        name: Of the way.
        group: Ways of one kind share a colour and a line of the legend.
        cost: Of a simulated second [s].
        error: [m].
    """

    name: str
    group: str
    cost: float
    error: float


@dataclass(frozen=True)
class WorkPrecision:
    """One picture: its title and its points."""

    title: str
    points: Sequence[WorkPoint]


def pareto(points: Sequence[WorkPoint]) -> list[WorkPoint]:
    """Return the points that no other beats in both cost and error, the cheapest first; rounding counts as no error."""
    front: list[WorkPoint] = []
    for point in sorted(points, key=lambda one: (one.cost, one.error)):
        if not front or max(point.error, _LEAST) < max(front[-1].error, _LEAST):
            front.append(point)
    return front


def work_precision(panels: Sequence[WorkPrecision], path: Path, columns: int = 3) -> Path:
    """Draw error over cost for each panel, the front that nothing beats drawn and named.

    Args:
        panels: What to draw, row by row.
        path: PNG to write.
        columns: How many stand side by side.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    rows = -(-len(panels) // columns)
    figure, axes = new_figure(
        rows, columns, (5.2 * columns if columns > 1 else 9.5, (4.4 if columns > 1 else 6.4) * rows)
    )
    groups = list(dict.fromkeys(point.group for panel in panels for point in panel.points))
    for axis, panel in zip(axes, panels):
        for group in groups:
            mine = [point for point in panel.points if point.group == group]
            axis.plot(
                [1e3 * point.cost for point in mine],
                [1e6 * max(point.error, _LEAST) for point in mine],
                "osD^vPX"[groups.index(group) // len(MANY) % 7],
                color=MANY[groups.index(group) % len(MANY)],
                markersize=5,
                alpha=0.85,
                label=group,
            )
        _draw_front(axis, pareto(panel.points))
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.axvline(1e3, color=IDEAL, linewidth=1.0, linestyle=":")
        axis.set_title(panel.title, loc="left", fontsize=10.5)
        axis.set_xlabel("cost (µs a simulated ms)")
        axis.set_ylabel("largest error (µm)")
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    labels = axes[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=min(len(groups), 7), frameon=False, fontsize=9.5)
    return save(figure, path)


def _draw_front(axis: Any, front: Sequence[WorkPoint]) -> None:
    """Draw the front as steps and name its points."""
    axis.step(
        [1e3 * point.cost for point in front],
        [1e6 * max(point.error, _LEAST) for point in front],
        where="post",
        color=SECOND,
        linewidth=1.2,
        zorder=0,
    )
    for point in front:
        axis.annotate(
            point.name,
            (1e3 * point.cost, 1e6 * max(point.error, _LEAST)),
            textcoords="offset points",
            xytext=(6, 5),
            fontsize=8,
            color=SECOND,
        )
