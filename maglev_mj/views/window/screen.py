"""Overlay of text, plots, labels and banner for window and pictures.

The layout depends on the size alone, so that nothing moves when states and texts change: readings at the left, device
in the middle, plots at the right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from textwrap import wrap
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.colours import BAD, GOOD, MEASURED, STOP, Colour
from maglev_mj.frames import AXES, Array
from maglev_mj.lazy import mujoco
from maglev_mj.plants.shapes import ARROW
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, Note, Snapshot
from maglev_mj.views.readings import GROUPS, RESUME, Charts, Line, Range, banner, readings
from maglev_mj.views.window.keys import AXIS, HAND, KEYS, help_rows, key_of

Row: TypeAlias = tuple[str, str]
"""Name and value, or key and action."""

_GLYPH, _ROW = 0.08, 0.24
"""Width of a letter of MuJoCo's font, wider than the mean, and height of a row, per font scale [pixels/%]."""

_MARGIN = 0.12
_TEXT_WIDTH, _PLOT_WIDTH, _NARROW, _PLOT_HEIGHT = 0.27, 0.25, 7.6, 1.3


class Area(NamedTuple):
    """Rectangle in a picture [pixels], from the lower left corner."""

    left: int
    bottom: int
    width: int
    height: int

    @property
    def top(self) -> int:
        """First row above the area."""
        return self.bottom + self.height


class Layout:
    """Areas of all elements of a picture, without plots if it is too narrow for three columns.

    Args:
        view: The picture.
        scale: Font scale, 100 to 300 [%].

    Attributes:
        text: Area of readings (top) and messages (bottom).
        device: Area of the 3D view; banner, time bar and label cover its edges.
        plots: Areas of the plots that fit.
        bar: Area of the time bar of a recording.
        label: Area of the emergency stop label.
        row: Height of a row of text [pixels].
    """

    def __init__(self, view: Area, scale: int) -> None:
        wide = view.width >= _NARROW * scale
        text = max(int(_TEXT_WIDTH * view.width), min(int(2.5 * scale), view.width // 2))
        plot = int(_PLOT_WIDTH * view.width) * wide
        count = min(max(view.height // int(_PLOT_HEIGHT * scale), 1), 4) * wide
        high, left, row = view.height // max(count, 1), view.left + text, int(_ROW * scale)
        width = max(view.width - text - plot, 1)
        self.row, self.text = row, Area(view.left, view.bottom, text, view.height)
        self.device = Area(left, view.bottom, width, view.height)
        self.plots = [Area(left + width, view.top - (index + 1) * high, plot, high) for index in range(count)]
        self.bar = Area(left, view.bottom + 2 * row, width, row)
        self.label = Area(left + width // 4, view.bottom + row // 3, width // 2, row + row // 3)


def letters(width: int, scale: int) -> int:
    """Return the number of letters that fit a width [pixels]."""
    return max(int((width - _MARGIN * scale) / (_GLYPH * scale)), 1)


def wrapped(rows: Sequence[Row], width: int, scale: int) -> list[Row]:
    """Return rows with values wrapped to a total width [pixels], one row per line."""
    room = max(letters(width, scale) - max((len(name) for name, _ in rows), default=0) - 2, 8)
    return [(name * (index == 0), line) for name, text in rows for index, line in enumerate(wrap(text, room) or [""])]


_POINTS = 500
_DOT, _DIAMOND = np.array([0.018, 0.045]), np.array([[-1, 0], [0, 1], [1, 0], [0, -1], [-1, 0]])
_MARKS = 80


class Plots:
    """Four live plots as MjvFigures: position, force, stability map, phase plane."""

    def __init__(self) -> None:
        self._charts = Charts(_POINTS)
        self.figures = [_new_figure() for _ in range(4)]

    def update(self, snapshot: Snapshot, axis: int | None = None, room: int = 1000) -> list[Any]:
        """Return the figures, updated from a snapshot.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES; the scene's axis by default.
            room: Number of letters to which titles are fitted.
        """
        charts = self._charts.of(snapshot, snapshot.scene.axis_index if axis is None else axis)
        for figure, (title, lines, across, up, foot, side) in zip(self.figures, charts, strict=True):
            (words, colour), *series = title
            titles = f"{words}: {', '.join(name for name, _ in series)}" if series else words, words
            text = next((text for text in titles if len(text) <= room), words[:room])
            figure.title = f"{text}\0"  # MuJoCo reads one more character, which may belong to a longer previous title
            figure.textrgb[:] = light(colour) if colour in (GOOD, BAD) else _TEXT
            figure.xlabel = (f"{side} vs {foot}" if side else foot)[:room]
            figure.range[0], figure.range[1] = across, up
            figure.linepnt[:] = 0
            shapes = [shape for line in reversed(lines) for shape in _shapes(line, across, up)]  # the first is on top
            for index, (shade, points) in enumerate(shapes):
                figure.linergb[index], figure.linepnt[index] = shade, len(points)
                figure.linedata[index, : points.size] = np.clip(points, *np.transpose((across, up))).ravel()
        return self.figures


_TEXT, _PANEL = (0.95, 0.96, 0.98), (0.07, 0.08, 0.10)


def light(colour: Colour) -> Colour:
    """Return a colour lightened for a dark background."""
    return tuple(0.45 + 0.55 * part for part in colour)  # type: ignore[return-value]


def _new_figure() -> Any:
    figure: Any = mujoco.MjvFigure()
    mujoco.mjv_defaultFigure(figure)
    figure.figurergba[:] = *_PANEL, 1.0
    figure.panergba[:] = 0.13, 0.15, 0.18, 1.0
    figure.textrgb[:] = _TEXT
    figure.gridrgb[:] = 0.34, 0.37, 0.42
    figure.linewidth, figure.gridwidth = 2.5, 1.0
    figure.gridsize[:] = 3, 3
    figure.flg_legend = figure.flg_extend = 0
    figure.xformat = figure.yformat = "%.4g"
    figure.minwidth = "-100"
    return figure


def _shapes(line: Line, across: Range, up: Range) -> list[tuple[Colour, Array]]:
    """Return the colours and points, (N, 2), of a line and of the outlines of the dot at its last point."""
    points = np.column_stack((line.x, line.y))
    shapes = [(line.colour, points[np.isfinite(points[:, 1])])]
    if line.dot and np.isfinite(points[-1:, 1]).any():
        low, high = np.transpose((across, up))
        size = _DOT * (high - low)
        centre = np.clip(points[-1], low + size, high - size)
        shapes += [(line.colour, centre + scale * size * _DIAMOND) for scale in (1.0, 0.66, 0.33)]
    return shapes


_STATUS = *GROUPS["felt"][:3], "arrows", *(name for name in GROUPS["numbers"] if name != "position")
"""Readings from top to bottom, first what is felt; the plots show the position."""
_ARROWS = "arrows", f"blue: hand, orange: device, black: stop; {1e3 * ARROW:.0f} mm/N"
_HINTS = [("mouse", "drag the knob to pull it"), ("F11", "keys")]


def status_rows(snapshot: Snapshot) -> list[Row]:
    """Return the rows of the readings, forces first."""
    words = dict([_ARROWS, *(row[:2] for row in readings(snapshot))])
    return [(name, words[name]) for name in _STATUS if name in words]


def message_rows(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Row]:
    """Return the rows of temporary messages: metal stops, notes, slow motion, task of the tour."""
    rows = [row[:2] for row in readings(snapshot, notes) if row.name in ("", "speed")]
    if (step := snapshot.tour) is not None:
        text, task = step.words(lambda action: HAND if action == "hand" else key_of(action, snapshot.actions))
        rows += [(f"{step.number} of {step.total}", text), *([] if step.done else [("task", task)])]
    return rows


def moved_by_mouse(snapshot: Snapshot) -> bool:
    """Return True if the mouse is the hand: neither a recording nor a device."""
    return snapshot.duration is None and snapshot.state != "flying"


_RED: Colour = (0.80, 0.05, 0.05)
_STOP_LABEL = "ESC: EMERGENCY STOP"


class Box(NamedTuple):
    """Filled rectangle with a centred line of text.

    Attributes:
        area: The rectangle.
        colour: Its colour.
        text: The text; empty for none.
    """

    area: Area
    colour: Colour
    text: str = ""


class Overlay(NamedTuple):
    """Overlay of one frame.

    Attributes:
        layout: Layout of the frame.
        figures: Area and MjvFigure of each plot.
        boxes: Rectangles, bottom to top.
        upper: Rows of text at the top of the text area.
        lower: Rows of text at its bottom.
    """

    layout: Layout
    figures: Sequence[tuple[Area, Any]]
    boxes: Sequence[Box]
    upper: Sequence[Row]
    lower: Sequence[Row]

    def render(self, context: Any) -> None:
        """Draw into the current buffer of an MjrContext."""
        font = int(mujoco.mjtFont.mjFONT_NORMAL)
        for area, figure in self.figures:
            mujoco.mjr_figure(mujoco.MjrRect(*area), figure, context)
        for area, colour, text in self.boxes:
            mujoco.mjr_label(mujoco.MjrRect(*area), font, text, *colour, 1.0, 1.0, 1.0, 1.0, context)
        corners = mujoco.mjtGridPos.mjGRID_TOPLEFT, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT
        for rows, corner in zip((self.upper, self.lower), corners):
            if rows:
                columns = ("\n".join(column) for column in zip(*rows, strict=True))
                mujoco.mjr_overlay(font, corner, mujoco.MjrRect(*self.layout.text), *columns, context)


class Screen:
    """Overlay with the user's display settings.

    Args:
        keys: True to show hints on keys.
        plots: False to draw the device alone.

    Attributes:
        plots: See the argument.
    """

    def __init__(self, *, keys: bool = True, plots: bool = True) -> None:
        self._plots, self._has_keys, self._late = Plots(), keys, Note()
        self._axis: int | None = None
        self._keys = False
        self.plots = plots

    def press(self, action: str, scene: Scene) -> None:
        """Perform a key's action on the display."""
        if action == AXIS:
            self._axis = ((scene.axis_index if self._axis is None else self._axis) + 1) % len(AXES)
        elif action == KEYS:
            self._keys = not self._keys

    def draw(self, snapshot: Snapshot, view: Area, scale: int, notes: Sequence[str] = ()) -> Overlay:
        """Return the overlay of a frame.

        Args:
            snapshot: The present snapshot.
            view: Area of the picture.
            scale: Font scale, 100 to 300 [%].
            notes: Additional notes.
        """
        layout = Layout(view, scale)
        text, plots = layout.text, layout.plots
        figures = self._plots.update(snapshot, self._axis, letters(plots[0].width, scale)) if plots else []
        boxes = [Box(text, _PANEL), *self._bar(snapshot, layout.bar)]
        if self._has_keys and EMERGENCY_STOP in snapshot.actions:
            boxes.append(Box(layout.label, _RED, _STOP_LABEL))
        boxes += self._banner(snapshot, layout, scale)
        table = help_rows(snapshot.actions, hand=moved_by_mouse(snapshot)) if self._keys else status_rows(snapshot)
        lower = wrapped(self._messages(snapshot, notes), text.width, scale)
        limit = max(text.height // layout.row - 1 - len(lower), 0)
        return Overlay(layout, list(zip(plots, figures)), boxes, wrapped(table, text.width, scale)[:limit], lower)

    def _messages(self, snapshot: Snapshot, notes: Sequence[str]) -> list[Row]:
        """Return the rows at the lower left; those that stay are last."""
        return _HINTS[1:] if self._keys else [*message_rows(snapshot, notes), *(_HINTS if self._has_keys else [])]

    def _bar(self, snapshot: Snapshot, area: Area) -> list[Box]:
        """Return the time bar of a recording with event marks; empty for none."""
        if snapshot.duration is None:
            return []
        pixels = area.width / (snapshot.duration or 1.0)
        marks = [area._replace(left=area.left + int(mark * pixels), width=2) for mark in snapshot.marks[:_MARKS]]
        done = area._replace(width=int(min(snapshot.time * pixels, area.width)))
        return [Box(area, STOP), Box(done, MEASURED), *(Box(mark, BAD) for mark in marks)]

    def _banner(self, snapshot: Snapshot, layout: Layout, scale: int) -> list[Box]:
        """Return the lines of the banner, the heading first; empty while running normally."""
        if snapshot.overloaded:
            self._late.say("late")
        content = banner(replace(snapshot, overloaded=bool(self._late.lines)))  # hold the state: no flicker
        if content is None:
            return []
        title, _, reason = content.text.partition(": ")
        if content.resume_action and (key := key_of(content.resume_action, snapshot.actions)):
            title += f": press {key} {RESUME[content.resume_action]}"
        texts = filter(None, (title, ". ".join(filter(None, (reason, content.remedy)))))
        area, colour = layout.device, BAD if content.bad else STOP
        lines = [line for text in texts for _, line in wrapped([("", text)], area.width, scale)]
        strips = (area._replace(bottom=area.top - index * layout.row, height=layout.row) for index in count(1))
        return [Box(strip, colour, line) for strip, line in zip(strips, lines)]
