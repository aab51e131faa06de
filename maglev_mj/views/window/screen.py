"""Overlay of text, plots, labels and banner for window and pictures.

The layout depends on the size alone, so that nothing moves when states and texts change: readings at the left, device
in the middle, plots at the right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from textwrap import shorten, wrap
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.colours import BAD, GOOD, MEASURED, STOP, Colour, on_dark, on_white
from maglev_mj.frames import AXES, Array
from maglev_mj.lazy import mujoco
from maglev_mj.plants.shapes import ARROW
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, Note, Snapshot
from maglev_mj.views.forces import force_text, forces
from maglev_mj.views.handle import FORCES
from maglev_mj.views.readings import GROUPS, RESUME, Chart, Charts, Curve, Range, banner, device_strip, readings
from maglev_mj.views.window.keys import AXIS, HAND, KEYS, help_rows, key_of

Row: TypeAlias = tuple[str, str]
"""Name and value, or key and action."""

_GLYPH, _ROW = 0.08, 0.24
"""Width of a letter of MuJoCo's font, wider than the mean, and height of a row, per font scale [pixels/%]."""

_MARGIN = 0.12
_TEXT_WIDTH, _PLOT_WIDTH, _NARROW, _PLOT_HEIGHT = 0.27, 0.25, 7.6, 1.3
_STRIP_HEIGHT, _STRIP_BOTTOM, _STRIP_TOP = 1.3, 0.27, 8
"""Least height of a chart of the strip per font scale [pixels/%]; share of the height below; rows of text above."""


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
        strip: Areas of the magnified wall, position and force, between readings and messages; empty without room.
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
        below = view.bottom + int(_STRIP_BOTTOM * view.height)
        room = min((view.top - below - _STRIP_TOP * row) // 2, text * 2 // 3)
        fits = room >= int(_STRIP_HEIGHT * scale) and text >= 2 * scale
        self.strip = [Area(view.left, below + index * room, text, room) for index in (1, 0)] * fits
        self.bar = Area(left, view.bottom + 2 * row, width, row)
        self.label = Area(left + width // 4, view.bottom + row // 3, width // 2, row + row // 3)


def letters(width: int, scale: int) -> int:
    """Return the number of letters that fit a width [pixels]."""
    return max(int((width - _MARGIN * scale) / (_GLYPH * scale)), 1)


def wrapped(rows: Sequence[Row], width: int, scale: int) -> list[Row]:
    """Return rows with values wrapped to a total width [pixels], one row per line."""
    room = max(letters(width, scale) - max((len(name) for name, _ in rows), default=0) - 2, 8)
    return [(name * (index == 0), line) for name, text in rows for index, line in enumerate(wrap(text, room) or [""])]


_POINTS, _MOST_POINTS, _LEVEL = 240, 1000, 1e-5
"""Points of a line; most points of a line of MuJoCo's figures; share of the height below which a piece is level."""
_CLOSE_UP = 0.2
"""Time span of the magnified wall, as narrow as its charts [s]."""
_DOT, _DIAMOND = np.array([0.018, 0.045]), np.array([[-1, 0], [0, 1], [1, 0], [0, -1], [-1, 0]])
_MARKS = 80


class WindowPlots:
    """Live plots as MjvFigures: position, force, stability map, phase plane; and the two of the magnified wall."""

    def __init__(self) -> None:
        self._charts = Charts(_POINTS)
        self.figures, self._strip = [_new_figure() for _ in range(4)], [_new_figure() for _ in range(2)]

    def strip(self, snapshot: Snapshot, room: int = 1000) -> list[Any]:
        """Return the figures of the magnified wall; empty while nothing is rendered. See `update`."""
        charts = self._charts.strip(snapshot, _CLOSE_UP)
        for figure, chart in zip(self._strip, charts):
            _fill(figure, chart, room)
        return self._strip if charts else []

    def update(self, snapshot: Snapshot, axis: int | None = None, room: int = 1000) -> list[Any]:
        """Return the figures, updated from a snapshot.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES; the scene's axis by default.
            room: Number of letters to which titles are fitted.
        """
        charts = self._charts.of(snapshot, snapshot.scene.axis_index if axis is None else axis)
        for figure, chart in zip(self.figures, charts, strict=True):
            _fill(figure, chart, room)
        return self.figures


def _drawn(points: Array, up: Range) -> Array:
    """Return the points of a line without level pieces, which MuJoCo would draw as dots; at most those of a figure."""
    if len(points) > 2:
        level = np.abs(np.diff(points[:, 1])) < _LEVEL * (up[1] - up[0])
        points = points[np.concatenate([[True], ~(level[1:] & level[:-1]), [True]])]
    return points[:: max(-(-len(points) // _MOST_POINTS), 1)]


def _shortened(text: str, room: int) -> str:
    """Return a text, or as many of its words as fit a number of letters."""
    return text if len(text) <= room else shorten(text, room, placeholder="").rstrip(" ,:;")


def _fill(figure: Any, chart: Chart, room: int) -> None:
    """Fill a figure from a chart, its title fitted to a number of letters."""
    title, lines, across, up, foot, side = chart
    (words, colour), *series = title
    titles = f"{words}: {', '.join(name for name, _ in series)}" if series else words, words
    text = next((text for text in titles if len(text) <= room), _shortened(words, room))
    figure.title = f"{text}\0"  # MuJoCo reads one more character, which may belong to a longer previous title
    figure.textrgb[:] = on_dark(colour, _PALE) if colour in (GOOD, BAD) else _TEXT  # also of the numbers
    units = [text.partition("[")[2].partition("]")[0] for text in (side, foot)]
    below = (f"{side} vs {foot}", " vs ".join(units)) if side else (foot,)
    figure.xlabel = next((text for text in below if len(text) <= room), _shortened(below[-1], room))
    figure.range[0], figure.range[1] = across, up
    figure.linepnt[:] = 0
    figure.flg_ticklabel[:] = bool(lines)  # a title alone has no frame
    figure.gridrgb[:], figure.panergba[:3] = (_GRID, _PANE) if lines else (_PANEL, _PANEL)
    shapes = [shape for line in reversed(lines) for shape in _shapes(line, across, up)]  # the first is on top
    for index, (shade, points) in enumerate(shapes):
        points = _drawn(points, up)
        figure.linergb[index], figure.linepnt[index] = on_dark(shade, 3.0), len(points)
        figure.linedata[index, : points.size] = np.clip(points, *np.transpose((across, up))).ravel()


_TEXT, _PANEL, _TRACK = (0.95, 0.96, 0.98), (0.07, 0.08, 0.10), (0.25, 0.27, 0.30)
_PANE, _GRID, _LEAST_BAR, _PALE = (0.13, 0.15, 0.18), (0.34, 0.37, 0.42), 0.3, 9.0


def _new_figure() -> Any:
    figure: Any = mujoco.MjvFigure()
    mujoco.mjv_defaultFigure(figure)
    figure.figurergba[:] = *_PANEL, 1.0
    figure.panergba[:] = *_PANE, 1.0
    figure.textrgb[:] = _TEXT
    figure.gridrgb[:] = _GRID
    figure.linewidth, figure.gridwidth = 2.5, 1.0
    figure.gridsize[:] = 3, 3
    figure.flg_legend = figure.flg_extend = 0
    figure.xformat = figure.yformat = "%.4g"
    figure.minwidth = "-100"
    return figure


def _shapes(line: Curve, across: Range, up: Range) -> list[tuple[Colour, Array]]:
    """Return the colours and points, (N, 2), of a line and of the outlines of the dot at its last point."""
    points = np.column_stack((line.x, line.y))
    shapes = [(line.colour, points[np.isfinite(points[:, 1])])]
    if line.dot and np.isfinite(points[-1:, 1]).any():
        low, high = np.transpose((across, up))
        size = _DOT * (high - low)
        centre = np.clip(points[-1], low + size, high - size)
        shapes += [(line.colour, centre + scale * size * _DIAMOND) for scale in (1.0, 0.66, 0.33)]
    return shapes


_STATUS = "hand", "device", "gains", "rate", "margin"
_NUMBERS = "hand", "device", "margin", "loop", *(name for name in GROUPS["numbers"] if name != "position")
"""Readings from top to bottom, first what is felt, and all of them; the plots show the position."""
_HINTS = [("mouse", "drag the knob to pull it"), ("F11", "keys, all numbers")]


def status_rows(snapshot: Snapshot) -> list[Row]:
    """Return the rows of the readings, at most five: forces first, and last what changes its number of lines.

    Of a recording the time is shown in place of the gains.
    """
    words = {row.name: row.value for row in readings(snapshot)}
    names = _STATUS if snapshot.duration is None else ("hand", "device", "time", "rate", "margin")
    return [(name, words[name]) for name in names if name in words]


def number_rows(snapshot: Snapshot) -> list[Row]:
    """Return the rows of all readings."""
    words = {row.name: row.value for row in readings(snapshot)}
    rows = [(name, words[name]) for name in _NUMBERS if name in words]
    return [*rows, ("arrows", f"mean force, {1e3 * ARROW:.0f} mm/N")]


def message_rows(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Row]:
    """Return the rows of temporary messages: metal stops, notes, sticking, slow motion, task of the tour."""
    rows = [row[:2] for row in readings(snapshot, notes) if row.name in ("", "state", "speed")]
    if (step := snapshot.tour) is not None:
        text, task = step.words(lambda action: HAND if action == "hand" else key_of(action, snapshot.actions))
        rows += [(f"{step.number} of {step.total}", text), *([] if step.done else [("task", task)])]
    return rows


def moved_by_mouse(snapshot: Snapshot) -> bool:
    """Return True if the mouse is the hand: neither a recording nor a device."""
    return snapshot.duration is None and snapshot.state != "flying"


_RED: Colour = (0.80, 0.05, 0.05)
_STOP_LABEL = "ESC: EMERGENCY STOP"


class TextBox(NamedTuple):
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
        bars: Rectangles above the text: the forces as bars.
        upper: Rows of text at the top of the text area.
        lower: Rows of text at its bottom.
    """

    layout: Layout
    figures: Sequence[tuple[Area, Any]]
    boxes: Sequence[TextBox]
    bars: Sequence[TextBox]
    upper: Sequence[Row]
    lower: Sequence[Row]

    def render(self, context: Any) -> None:
        """Draw into the current buffer of an MjrContext."""
        font = int(mujoco.mjtFont.mjFONT_NORMAL)
        for area, colour, text in self.boxes:
            mujoco.mjr_label(mujoco.MjrRect(*area), font, text, *colour, 1.0, 1.0, 1.0, 1.0, context)
        for area, figure in self.figures:
            mujoco.mjr_figure(mujoco.MjrRect(*area), figure, context)
        corners = mujoco.mjtGridPos.mjGRID_TOPLEFT, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT
        for rows, corner in zip((self.upper, self.lower), corners):
            if rows:
                columns = ("\n".join(column) for column in zip(*rows, strict=True))
                mujoco.mjr_overlay(font, corner, mujoco.MjrRect(*self.layout.text), *columns, context)
        for area, colour, _ in self.bars:
            mujoco.mjr_rectangle(mujoco.MjrRect(*area), *colour, 1.0)


class Screen:
    """Overlay with the user's display settings.

    Args:
        keys: True to show hints on keys.
        plots: False to draw the device alone.

    Attributes:
        plots: See the argument.
    """

    def __init__(self, *, keys: bool = True, plots: bool = True) -> None:
        self._plots, self._has_keys, self._late = WindowPlots(), keys, Note()
        self._axis: int | None = None
        self._page = 0
        self.plots = plots

    def press(self, action: str, scene: Scene) -> None:
        """Perform a key's action on the display."""
        if action == AXIS:
            self._axis = ((scene.axis_index if self._axis is None else self._axis) + 1) % len(AXES)
        elif action == KEYS:
            self._page = (self._page + 1) % 3

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
        boxes = [TextBox(text, _PANEL), *self._bar(snapshot, layout.bar)]
        if self._has_keys and EMERGENCY_STOP in snapshot.actions:
            # a stop that reaches no device is not the heaviest element
            boxes.append(TextBox(layout.label, _TRACK if snapshot.device is None else _RED, _STOP_LABEL))
        boxes += self._banner(snapshot, layout, scale)
        pictures, bars = list(zip(plots, figures)), list[TextBox]()
        if self._page:
            keys = self._page == 1
            table = help_rows(snapshot.actions, mouse=moved_by_mouse(snapshot)) if keys else number_rows(snapshot)
        else:
            table = status_rows(snapshot)
            if layout.strip:
                pictures += zip(layout.strip, self._plots.strip(snapshot, letters(text.width, scale)))
            bars = _bars(snapshot, layout, max((len(name) for name, _ in table), default=0), scale)
        lower = wrapped(self._messages(snapshot, notes), text.width, scale)
        limit = max(text.height // layout.row - 1 - len(lower), 0)
        upper = wrapped(table, text.width, scale)[:limit]
        return Overlay(layout, pictures, boxes, bars, upper, lower)

    def _messages(self, snapshot: Snapshot, notes: Sequence[str]) -> list[Row]:
        """Return the rows at the lower left; those that stay are last."""
        return _HINTS[1:] if self._page == 1 else [*message_rows(snapshot, notes), *(_HINTS if self._has_keys else [])]

    def _bar(self, snapshot: Snapshot, area: Area) -> list[TextBox]:
        """Return the time bar of a recording with event marks; empty for none."""
        if snapshot.duration is None:
            return []
        pixels = area.width / (snapshot.duration or 1.0)
        marks = [area._replace(left=area.left + int(mark * pixels), width=2) for mark in snapshot.marks[:_MARKS]]
        done = area._replace(width=int(min(snapshot.time * pixels, area.width)))
        return [TextBox(area, STOP), TextBox(done, MEASURED), *(TextBox(mark, BAD) for mark in marks)]

    def _banner(self, snapshot: Snapshot, layout: Layout, scale: int) -> list[TextBox]:
        """Return the strip of a device, and the lines of the banner, the heading first; empty if there is neither."""
        if snapshot.overloaded:
            self._late.say("late")
        content = banner(replace(snapshot, overloaded=bool(self._late.lines)))  # hold the state: no flicker
        texts: list[tuple[Colour, str]] = []
        if (device := device_strip(snapshot)) is not None:
            texts.append((on_white(device.colour or STOP), f"{device.name} {device.value}"))
        if content is not None:
            title, _, reason = content.text.partition(": ")
            if content.resume_action and (key := key_of(content.resume_action, snapshot.actions)):
                title += f": press {key} {RESUME[content.resume_action]}"
            parts = (title, ". ".join(filter(None, (reason, content.remedy))))
            texts += [(BAD if content.bad else STOP, text) for text in parts if text]
        area = layout.device
        lines = [(colour, line) for colour, text in texts for _, line in wrapped([("", text)], area.width, scale)]
        strips = (area._replace(bottom=area.top - index * layout.row, height=layout.row) for index in count(1))
        return [TextBox(strip, colour, line) for strip, (colour, line) in zip(strips, lines)]


_FULL, _FORCE_LETTERS = 10.0, len("12.3 N, peak 123.4 N")
"""Force of a full bar [N], and letters of a force."""


def _bars(snapshot: Snapshot, layout: Layout, name: int, scale: int) -> list[TextBox]:
    """Return bars beside the numbers of the forces: extremes as a thin band, mean above it; empty without room."""
    left = layout.text.left + int((_MARGIN + _GLYPH * (name + 2 + _FORCE_LETTERS)) * scale)
    width, bars = layout.text.left + layout.text.width - left - layout.row // 3, list[TextBox]()
    if width < _LEAST_BAR * scale or snapshot.hand_estimated:  # the word is where the bar would be
        return []
    measured = [(force, FORCES[name]) for name, force in forces(snapshot).items() if force_text(force)]
    for row, (force, colour) in enumerate(measured):
        low, mean, high = (int(width * min(size / _FULL, 1.0)) for size in (force.least, force.size, force.most))
        bottom, height = layout.text.top - int((row + 0.75) * layout.row), layout.row // 2
        bars.append(TextBox(Area(left, bottom, width, height), _TRACK))
        bars.append(TextBox(Area(left, bottom, max(mean, 1), height), on_dark(colour, 3.0)))
        bars.append(
            TextBox(Area(left + low, bottom + height // 3, max(high - low, 1), height // 3), on_dark(colour, 9.0))
        )
    return bars
