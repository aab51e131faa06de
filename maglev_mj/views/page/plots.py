"""Plots of the page: charts as SVG, scalable to any width."""

from __future__ import annotations

import textwrap
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BOUNDARY, Colour, on_page
from maglev_mj.frames import AXES
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.views.page.stage import update
from maglev_mj.views.readings import Chart, Charts, Range

_WIDTH, _HEIGHT = 320, 160
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 12, 20, 34
_TICKS = 4
_GRID, _TEXT = "rgba(128,128,128,.28)", "currentColor"


def drawn(chart: Chart) -> str:
    """Return a chart as SVG; only its title if it has no lines."""
    title, lines, across, up, foot, side = chart
    if not lines:
        return f'<p class="chart" style="margin:.5em">{escape(textwrap.shorten(title[0][0], 300))}</p>'
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    parts = [
        f'<svg class="chart" viewBox="0 0 {_WIDTH} {_HEIGHT}" style="width:100%;display:block" font-size="11" '
        f'font-family="system-ui,sans-serif" fill="{_TEXT}"><text x="4" y="13">',
        *(f'<tspan{_fill(colour)} font-weight="600">{escape(text)} </tspan>' for text, colour in title),
        f'</text><svg x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{bottom - _TOP}" '
        f'viewBox="{_LEFT} {_TOP} {right - _LEFT} {bottom - _TOP}">',
    ]
    labels = []
    for value in ticks(*across):
        position = float(_between(value, across, _LEFT, right))
        parts.append(f'<path d="M{position:.1f} {_TOP}V{bottom}" stroke="{_GRID}"/>')
        labels.append(f'<text x="{position:.1f}" y="{bottom + 15}" text-anchor="middle">{value:g}</text>')
    for value in ticks(*up):
        position = float(_between(value, up, bottom, _TOP))
        parts.append(f'<path d="M{_LEFT} {position:.1f}H{right}" stroke="{_GRID}"/>')
        labels.append(f'<text x="{_LEFT - 4}" y="{position + 4:.1f}" text-anchor="end">{value:g}</text>')
    for line in lines:
        x, y = _between(line.x, across, _LEFT, right), _between(line.y, up, bottom, _TOP)
        points = " ".join(f"{px:.1f},{py:.1f}" for px, py in zip(x, y) if np.isfinite(py))
        dash = ' stroke-dasharray="4 3"' if line.dashed else ""
        style = f'fill="none" stroke="{on_page(line.colour, 3.0)}" stroke-width="1.6"{dash}'
        parts.append(f'<polyline points="{points}" {style}/>')
        if line.dot and len(x) and _LEFT <= x[-1] <= right and _TOP <= y[-1] <= bottom:  # whole, above the frame
            labels.append(f'<circle cx="{x[-1]:.1f}" cy="{y[-1]:.1f}" r="4"{_fill(line.colour, 3.0)}/>')
    turned = f"translate(11 {(_TOP + bottom) // 2}) rotate(-90)"
    for text, place in ((foot, f"translate({(_LEFT + right) // 2} {_HEIGHT - 5})"), (side, turned)):
        labels.append(f'<text transform="{place}" text-anchor="middle">{escape(text)}</text>')
    frame = f'<rect x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{bottom - _TOP}"'
    return "".join([*parts, "</svg>", f'{frame} fill="none" stroke="{on_page(BOUNDARY, 3.0)}"/>', *labels, "</svg>"])


def ticks(low: float, high: float) -> list[float]:
    """Return about four round numbers between two limits."""
    step = 10.0 ** np.floor(np.log10((high - low) / _TICKS))
    step *= next(size for size in (1.0, 2.0, 2.5, 5.0, 10.0) if size * step * (_TICKS + 1) >= high - low)
    return [float(np.round(count * step, 12)) for count in range(int(np.ceil(low / step)), int(high / step) + 1)]


def _fill(colour: Colour | None, contrast: float = 4.5) -> str:
    return "" if colour is None else f' fill="{on_page(colour, contrast)}"'


def _between(value: ArrayLike, ends: Range, first: int, last: int) -> Any:
    """Return pixel coordinates of values [px]."""
    return first + (np.asarray(value) - ends[0]) / (ends[1] - ends[0]) * (last - first)


_POINTS = 200


class Plots:
    """Four plots of one axis.

    Args:
        gui: viser's GUI, inside the container of the plots.
        scene: Scene with the initial axis.
    """

    def __init__(self, gui: Any, scene: Scene) -> None:
        self._charts, self._type = Charts(_POINTS), type(scene)
        self._axis = gui.add_dropdown("axis", AXES, initial_value=scene.axis, hint="plot axis")
        self._plots = [gui.add_html("") for _ in range(4)]

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if type(snapshot.scene) is not self._type:
            self._type, self._axis.value = type(snapshot.scene), snapshot.scene.axis
        axis = self._axis.value if self._axis.value in AXES else snapshot.scene.axis  # untrusted input
        charts = self._charts.of(snapshot, AXES.index(axis))
        for plot, chart in zip(self._plots, charts, strict=True):
            update(plot, content=drawn(chart))
