"""Work and precision: cost of an answer over its error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.colours import GRID, REFERENCE, SERIES
from maglev_mj.parameters import flag
from maglev_mj.pictures import new_figure, save

EXACT_ENOUGH = 1e-9
"""Error below which methods differ only in cost [m]."""

_ROW = 0.75  # distance of two rows, in decades of the error
_INCH = 0.27  # height of a decade
_SMALL = 9.0  # size of words beside points [pt]
_BESIDE = (
    *((9, 0), (0, 9), (0, -9), (-9, 0), (9, 9), (9, -9)),
    *((24, 24), (24, -24), (-24, -24), (0, -36), (36, -36), (0, -54), (-36, -54), (36, -54)),
)
_PARTS = np.linspace(0.1, 0.9, 9)  # of a line that labels keep off


@dataclass(frozen=True)
class WorkPoint:
    """One method to an answer.

    Attributes:
        name: Of the method.
        group: Methods of one kind share a colour, and a row for the cheapest that is exact enough.
        cost: Of a simulated second [s], of each device where there are many; drawn relative to a group.
        error: [m]; what is below `EXACT_ENOUGH` counts as none.
        many: Whether that takes many devices at once.
        label: Words beside it where it is not exact enough; empty for none.
        joined: Whether a line joins it with others of its group.
    """

    name: str
    group: str
    cost: float
    error: float
    many: bool = False
    label: str = ""
    joined: bool = False

    def __post_init__(self) -> None:
        flag("many", self.many)
        flag("joined", self.joined)


def pareto(points: Sequence[WorkPoint]) -> list[WorkPoint]:
    """Return the points that no other beats, cheapest first."""
    front: list[WorkPoint] = []
    for point in sorted(points, key=lambda one: (one.cost, one.error)):
        if not front or max(point.error, EXACT_ENOUGH) < max(front[-1].error, EXACT_ENOUGH):
            front.append(point)
    return front


def work_precision(title: str, points: Sequence[WorkPoint], base: str, path: Path) -> Path:
    """Draw error over cost relative to one device of a group, and the cheapest exact methods.

    What no other method beats is ringed and its row bold, among single devices and among many at once.

    Args:
        title: Above the panel.
        points: What to draw.
        base: Group of cost 1, or the end of its name; ratios differ less between machines than costs.
        path: File to write.
    """
    unit = min(point.cost for point in points if point.group.endswith(base))
    points = [replace(point, cost=point.cost / unit) for point in points]
    groups = list(dict.fromkeys(point.group for point in points))
    styles = {
        group: ("osD^vPX<>hpd"[index % 12], SERIES[index % (len(SERIES) - 1)]) for index, group in enumerate(groups)
    }
    rows = exact_rows(points)
    off = [point for point in points if point.error > EXACT_ENOUGH]
    front = {id(point) for many in (False, True) for point in pareto([one for one in points if one.many is many])}
    top = math.ceil(max([_decade(point) for point in off], default=1.0) + 0.3)
    bottom = -_ROW * (len(rows) + 0.2)
    best = f": {rows[0].group}, {rows[0].cost:.2g} times the cost of one {base}" if rows else ""
    head = f"Cheapest within 1 nm{best}", f"{title}; ringed and bold: nothing is both cheaper and more accurate"
    figure, (axis,) = new_figure(head, 1, 1, _INCH * (top - bottom) + 1.0)
    chains = []
    for group in groups:
        mine = [point for point in off if point.group == group]
        _draw(axis, [(point, _decade(point)) for point in mine], styles[group], front)
        chains.append(sorted((point for point in mine if point.joined), key=lambda one: one.cost))
        axis.plot(*_places(chains[-1]), color=styles[group][1], linewidth=1.0, alpha=0.6, zorder=1)
    for index, point in enumerate(rows):
        height = -_ROW * (index + 0.7)
        _draw(axis, [(point, height)], styles[point.group], front)
        place = (point.cost, height)
        axis.annotate(f"{float(f'{place[0]:.2g}'):g}", place, va="center", **_words(9, 0))
    _furnish(axis, rows, front, (bottom, float(top)))
    axis.set_xlabel(f"cost per device and simulated time, relative to one {base}")
    _name(figure, axis, off, chains)
    return save(figure, path)


def exact_rows(points: Sequence[WorkPoint]) -> list[WorkPoint]:
    """Return each group's cheapest exact method, cheapest first."""
    best: dict[str, WorkPoint] = {}
    for point in points:
        if point.error <= EXACT_ENOUGH and (point.group not in best or point.cost < best[point.group].cost):
            best[point.group] = point
    return sorted(best.values(), key=lambda point: point.cost)


def _decade(point: WorkPoint) -> float:
    """Return decades of an error above the exact limit."""
    return math.log10(point.error / EXACT_ENOUGH)


def _places(points: Sequence[WorkPoint]) -> tuple[list[float], list[float]]:
    return [point.cost for point in points], [_decade(point) for point in points]


def _draw(axis: Any, placed: Sequence[tuple[WorkPoint, float]], style: tuple[str, Any], front: set[int]) -> None:
    """Draw points at their heights, those of the front ringed."""
    for point, height in placed:
        ring: dict[str, Any] = {"markeredgecolor": "black", "markeredgewidth": 1.8} if id(point) in front else {}
        axis.plot(point.cost, height, marker=style[0], color=style[1], markersize=7.0, zorder=3, **ring)


def _words(right: float, up: float) -> dict[str, Any]:
    """Return the style of a label at an offset [pt]."""
    return {"xytext": (right, up), "textcoords": "offset points", "fontsize": _SMALL, "color": REFERENCE}


def _name(figure: Any, axis: Any, points: Sequence[WorkPoint], chains: Sequence[Sequence[WorkPoint]]) -> None:
    """Label each point at the nearest free place, or farther away with a line to it."""
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    figure.canvas.draw()
    renderer, scale = figure.canvas.get_renderer(), figure.dpi / 72.0
    dots = [axis.transData.transform(np.transpose(_places(some))) if some else [] for some in (points, *chains)]
    lines = [tuple(a + part * (b - a)) for chain in dots[1:] for a, b in pairwise(chain) for part in _PARTS]
    taken = [Bbox.from_bounds(x, y, 0.0, 0.0).padded(4.0 * scale) for x, y in (*dots[0], *lines)]
    for index, point in enumerate(points):
        if not point.label:
            continue
        others, found = taken[:index] + taken[index + 1 :], []
        for right, up in _BESIDE:
            beside = "left" if right > 0 else "right" if right < 0 else "center"
            above = "bottom" if up > 0 else "top" if up < 0 else "center"
            leader = (
                {"arrowstyle": "-", "color": REFERENCE, "linewidth": 0.7} if max(abs(right), abs(up)) > 12 else None
            )
            place = (point.cost, _decade(point))
            words = axis.annotate(point.label, place, ha=beside, va=above, arrowprops=leader, **_words(right, up))
            words.set_in_layout(False)  # the panel keeps its size
            words.update_positions(renderer)
            box = Text.get_window_extent(words, renderer)
            inside = axis.bbox.contains(box.x0, box.y0) and axis.bbox.contains(box.x1, box.y1)
            found.append((box.count_overlaps(others) + 100 * (not inside), words, box))
        best = min(range(len(found)), key=lambda number: found[number][0])
        taken.append(found[best][2])
        for number, (_, words, _) in enumerate(found):
            if number != best:
                words.remove()


def _furnish(axis: Any, rows: Sequence[WorkPoint], front: set[int], span: tuple[float, float]) -> None:
    """Scale and label the panel."""
    axis.set_xscale("log")
    axis.set_ylim(*span)
    low, high = axis.get_xlim()
    axis.set_xlim(0.6 * low, 4.0 * high)  # room for the words
    axis.xaxis.set_major_formatter(lambda cost, _: f"{cost:g}")
    axis.axhspan(span[0], 0.0, color=GRID, alpha=0.5, zorder=-1)
    units = ("1 nm", "10 nm", "0.1 µm", "1 µm", "10 µm", "0.1 mm", "1 mm", "10 mm", "0.1 m", "1 m")
    decades = range(min(int(span[1]) + 1, len(units)))
    heights = [-_ROW * (index + 0.7) for index in range(len(rows))]
    axis.set_yticks([*decades, *heights])
    axis.set_yticklabels([*units[: len(decades)], *(point.group for point in rows)])
    for label, point in zip(axis.get_yticklabels()[len(decades) :], rows, strict=True):
        label.set_fontweight("bold" if id(point) in front else "normal")
    axis.minorticks_off()
    told = {"ha": "right", "va": "top", "fontsize": _SMALL, "color": REFERENCE, "transform": axis.get_yaxis_transform()}
    axis.text(0.995, -0.2, "within 1 nm: the cheapest of each", **told)
    axis.set_ylabel("largest error")
