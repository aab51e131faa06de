"""Live plots and labels.

Position, force, phase plane, and gains with their stability boundary.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BAD, BOUNDARY, GOOD, MEASURED, Colour
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import flag
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.views.charts import Charts, Line, Range

_POINTS = 500
_NOW = 0.018, 0.045
_STROKES, _MARKS = 8, 80

_Line: TypeAlias = tuple[Colour, ArrayLike, ArrayLike]
"""Colour, x and y of a line."""


class Plots:
    """Four live plots, updated from a snapshot.

    They are figures of the engine, the most important first.
    """

    def __init__(self) -> None:
        self._charts = Charts(_POINTS)
        self.figures = [mujoco.MjvFigure() for _ in range(4)]
        for figure in self.figures:
            _prepare(figure)

    def update(self, snapshot: Snapshot, axis: int | None = None, *, low: bool = False) -> list[Any]:
        """Return the figures: position, force, stability map, phase plane.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES; the scene's own by default.
            low: True if there is no room for text under the plots.
        """
        flag("low", low)
        charts = self._charts.of(snapshot, snapshot.scene.axis_index if axis is None else axis)
        for figure, (title, lines, across, up, foot) in zip(self.figures, charts, strict=True):
            (words, colour), *further = title
            shapes = [
                shape for line in reversed(lines) for shape in _shapes(line, across, up)
            ]  # the first is uppermost
            named = ", ".join(name for name, _ in further)
            _draw(figure, f"{words}: {named}" if named else words, shapes, across, up)
            figure.textrgb[:] = shown_colour(colour) if colour in (GOOD, BAD) else _TEXT
            figure.flg_ticklabel[0] = not low
            figure.xlabel = "" if low else foot
        return self.figures

    def wait(self, scene: Scene) -> None:
        """Wait until the stability of a scene is computed."""
        self._charts.wait(scene)


_TEXT = 0.95, 0.96, 0.98


class Label:
    """Rectangle with a line of text.

    It is a figure of the engine.

    Args:
        colour: Colour of the rectangle.
        opacity: Opacity of the rectangle, from 0 to 1.
    """

    def __init__(self, colour: Colour, opacity: float = 1.0) -> None:
        figure = self._figure = mujoco.MjvFigure()
        _prepare(figure)
        figure.panergba[:], figure.textrgb[:], figure.gridsize[:] = 0.0, 1.0, 0
        figure.flg_ticklabel[:], figure.minwidth = 0, ""
        self._opacity = opacity
        self.paint(colour)

    def paint(self, colour: Colour) -> None:
        """Change the colour."""
        figure = self._figure
        figure.figurergba[:] = (*colour, self._opacity)
        figure.gridrgb[:] = colour

    def update(self, text: str, foot: str = "") -> Any:
        """Return the figure with its text.

        One line is at the top, one at the foot.
        """
        _entitle(self._figure, text)
        self._figure.xlabel = foot
        return self._figure


class TimeBar:
    """Time bar of a recording, with event marks.

    It is a figure of the engine.
    """

    def __init__(self) -> None:
        figure = self._figure = mujoco.MjvFigure()
        _prepare(figure)
        figure.gridsize[:], figure.flg_ticklabel[:], figure.minwidth = 0, 0, ""

    def update(self, snapshot: Snapshot) -> Any:
        """Return the bar of a snapshot that has a duration."""
        duration, now = snapshot.duration or 1.0, snapshot.time
        # the engine draws only lines, the first uppermost; one to and fro is a bar
        levels = np.repeat(np.linspace(-0.5, 0.5, _STROKES), 2)
        ways = np.resize([0.0, 1.0, 1.0, 0.0], levels.size)
        lines: list[_Line] = [(_TEXT, [now, now], [-1.0, 1.0])]
        lines += [(BAD, [mark, mark], [-1.0, 1.0]) for mark in snapshot.marks[:_MARKS]]
        lines += [(MEASURED, now * ways, levels), (BOUNDARY, duration * ways, levels)]
        _draw(self._figure, "", lines, (0.0, duration), (-1.0, 1.0))
        return self._figure


def shown_colour(colour: Colour) -> Colour:
    """Return a colour light enough for dark ground."""
    return tuple(0.45 + 0.55 * part for part in colour)  # type: ignore[return-value]


def _prepare(figure: Any) -> None:
    mujoco.mjv_defaultFigure(figure)
    figure.figurergba[:] = 0.07, 0.08, 0.10, 0.88
    figure.panergba[:] = 0.13, 0.15, 0.18, 0.80
    figure.legendrgba[:] = 0.0, 0.0, 0.0, 0.0
    figure.textrgb[:] = _TEXT
    figure.gridrgb[:] = 0.34, 0.37, 0.42
    figure.linewidth, figure.gridwidth = 2.5, 1.0
    figure.gridsize[:] = 3, 3
    figure.flg_legend = figure.flg_extend = 0
    figure.xformat = figure.yformat = "%.4g"
    figure.minwidth = "-100"


def _entitle(figure: Any, title: str) -> None:
    # the engine reads one letter beyond the end, so a rest of a longer title would be seen
    figure.title = f"{title}\0"


def _draw(figure: Any, title: str, lines: Sequence[_Line], across: Range, up: Range) -> None:
    _entitle(figure, title)
    figure.linepnt[:] = 0
    for index, (colour, x, y) in enumerate(lines):
        x, y = np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)
        x, y = x[known := np.isfinite(y)], y[known]
        figure.linergb[index] = colour
        figure.linepnt[index] = x.size
        figure.linedata[index, : 2 * x.size : 2] = np.clip(x, *across)
        figure.linedata[index, 1 : 2 * x.size : 2] = np.clip(y, *up)
    figure.range[0], figure.range[1] = across, up


def _shapes(line: Line, across: Range, up: Range) -> list[_Line]:
    """Return a line, and those of the dot at its last point, moved inside the ranges."""
    colour, x, y = line[:3]
    shapes: list[_Line] = [(colour, x, y)]
    if not line.dot or not np.size(x) or not np.isfinite(np.asarray(y)[-1]):
        return shapes
    wide, high = _NOW[0] * (across[1] - across[0]), _NOW[1] * (up[1] - up[0])
    middle = min(max(float(np.asarray(x)[-1]), across[0] + wide), across[1] - wide)
    level = min(max(float(np.asarray(y)[-1]), up[0] + high), up[1] - high)
    for share in (1.0, 0.66, 0.33):
        dx, dy = share * wide, share * high
        corners = [middle - dx, middle, middle + dx, middle, middle - dx], [level, level + dy, level, level - dy, level]
        shapes.append((colour, *corners))
    return shapes
