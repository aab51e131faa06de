"""Work and precision: what an answer costs against how far it is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maglev_mj.colours import GRID, REFERENCE, SERIES
from maglev_mj.parameters import flag
from maglev_mj.plots.drawing import TITLE, legend_height, name_curves, new_figure, save

__all__ = ["WorkPoint", "WorkPrecision", "pareto", "work_precision"]

_ROUNDING = 1e-13
_BAND, _ROW = 1e-7, 0.45


@dataclass(frozen=True)
class WorkPoint:
    """One way to an answer.

    Attributes:
        name: Of the way.
        group: Ways of one kind share a colour and a line of the legend.
        cost: Of a simulated second [s], of each device where there are many.
        error: [m]; what is below 1e-13 counts as rounding.
        many: Whether that takes many devices at once.
    """

    name: str
    group: str
    cost: float
    error: float
    many: bool = False

    def __post_init__(self) -> None:
        flag("many", self.many)


@dataclass(frozen=True)
class WorkPrecision:
    """One picture: its title and its points."""

    title: str
    points: Sequence[WorkPoint]


def pareto(points: Sequence[WorkPoint]) -> list[WorkPoint]:
    """Return the points that no other beats in both cost and error, the cheapest first; rounding counts as no error."""
    front: list[WorkPoint] = []
    for point in sorted(points, key=lambda one: (one.cost, one.error)):
        if not front or max(point.error, _ROUNDING) < max(front[-1].error, _ROUNDING):
            front.append(point)
    return front


def work_precision(panels: Sequence[WorkPrecision], path: Path, columns: int = 2) -> Path:
    """Draw error over cost for each panel, with the front that nothing beats, for one device and for many at once.

    What is exact to rounding is below the line, a row for each group. The points of the fronts are numbered, and named
    under their panel.

    Args:
        panels: What to draw, row by row.
        path: File to write.
        columns: How many stand side by side.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    rows = -(-len(panels) // columns)
    groups = list(dict.fromkeys(point.group for panel in panels for point in panel.points))
    fronts = [
        [pareto([point for point in panel.points if point.many is many]) for many in (True, False)] for panel in panels
    ]
    legends = legend_height([[point.name for front in both for point in front] for both in fronts], columns)
    figure, axes = new_figure(rows, columns, rows * ((3.7 if columns > 1 else 5.6) + legends) + 0.6)
    for axis, panel, both in zip(axes, panels, fronts):
        for index, group in enumerate(groups):
            mine = [point for point in panel.points if point.group == group]
            axis.plot(
                [1e3 * point.cost for point in mine],
                [_height(point, groups) for point in mine],
                linestyle="none",
                marker="osD^vPX<>hpd"[index % 12],
                color=SERIES[index % len(SERIES)],
                markersize=5.5,
                alpha=0.85,
                label=group,
            )
        _furnish(axis, panel.title, len(groups))
        _draw_fronts(axis, both, groups)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    name_curves(figure, axes)
    return save(figure, path)


def _height(point: WorkPoint, groups: Sequence[str]) -> float:
    """Return where a point is drawn [µm]: at its error, or in its group's row below the line."""
    if point.error > _ROUNDING:
        return 1e6 * point.error
    row: float = _BAND * 10.0 ** (-_ROW * (groups.index(point.group) + 1))
    return row


def _furnish(axis: Any, title: str, rows: int) -> None:
    """Scale and label a panel."""
    axis.set_xscale("log")
    axis.set_yscale("log")
    low, high = axis.get_ylim()
    bottom = _BAND * 10.0 ** (-_ROW * (rows + 1))
    axis.set_ylim(min(low, bottom), max(high, 1e4))
    axis.axhspan(bottom * 1e-3, _BAND, color=GRID, alpha=0.5, zorder=-1)
    ticks = [10.0**power for power in range(-6, 6, 2) if 10.0**power < axis.get_ylim()[1]]
    axis.set_yticks([*ticks, _BAND * 10.0 ** (-_ROW * 0.5 * (rows + 1))])
    axis.set_yticklabels([f"{tick:g}" for tick in ticks] + ["exact to\nrounding"])
    axis.minorticks_off()
    axis.set_title(title, **TITLE)
    axis.set_xlabel("cost (µs a simulated ms and device)")
    axis.set_ylabel("largest error (µm)")


def _draw_fronts(axis: Any, fronts: Sequence[Sequence[WorkPoint]], groups: Sequence[str]) -> None:
    """Draw fronts as steps, that of many devices dashed, and number their points; name them under the panel."""
    named: dict[str, Any] = {}
    for front, style, up in zip(fronts, ("--", "-"), (-11, 4), strict=True):
        places = [(1e3 * point.cost, _height(point, groups)) for point in front]
        if places:
            axis.step(*zip(*places, strict=True), where="post", color=REFERENCE, linewidth=1.2, linestyle=style)
        for point, place in zip(front, places, strict=True):
            number = f"{len(named) + 1}"
            right = len(named) % 2 == 0  # neighbours on a front lie close together
            beside = {"xytext": (4 if right else -4, up), "ha": "left" if right else "right"}
            axis.annotate(number, place, textcoords="offset points", fontweight="bold", fontsize=8.5, **beside)
            mark = {
                "marker": f"$\\mathbf{{{number}}}$",
                "markersize": 6.0,
                "linestyle": "none",
                "color": "black",
                "markeredgewidth": 0.0,
            }
            (named[point.name],) = axis.plot([], [], **mark)
    name_curves(axis, named=named)
