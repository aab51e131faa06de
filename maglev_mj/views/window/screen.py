"""Overlay of text, plots, labels and banner for window and pictures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import glfw
import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BAD, BOUNDARY, GOOD, MEASURED, STOP, Colour
from maglev_mj.frames import AXES
from maglev_mj.lazy import mujoco
from maglev_mj.plants.shapes import ARROW
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, Note, Snapshot
from maglev_mj.views.magnifier import MAGNIFICATIONS, motion_words
from maglev_mj.views.readings import RESUME, Banner, Charts, Line, Range, banner, readings
from maglev_mj.views.window.keys import AXIS, HAND, KEYS, MAGNIFY, help_rows, key_of
from maglev_mj.views.window.layout import Area, Font, Layout, Row, arranged

_POINTS = 500
_DOT = 0.018, 0.045
_MARGIN, _UNBOUNDED = 12, 10_000
_STROKES, _MARKS = 8, 80

_Line: TypeAlias = tuple[Colour, ArrayLike, ArrayLike]
"""Colour, x and y of a polyline."""


class Plots:
    """Four live plots as MjvFigures: position, force, stability map, phase plane."""

    def __init__(self) -> None:
        self._charts = Charts(_POINTS)
        self.figures = [_new_figure() for _ in range(4)]

    def update(
        self, snapshot: Snapshot, axis: int | None = None, *, areas: Sequence[Area] = (), scale: int = 100
    ) -> list[Any]:
        """Return the figures, updated from a snapshot.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES; the scene's axis by default.
            areas: Areas of the figures, to which titles and labels are fitted.
            scale: Font scale [%].
        """
        charts = self._charts.of(snapshot, snapshot.scene.axis_index if axis is None else axis)
        font, width = Font(scale), (areas[0].width if areas else _UNBOUNDED) - _MARGIN
        for figure, (title, lines, across, up, foot) in zip(self.figures, charts, strict=True):
            (words, colour), *series = title
            shapes = [shape for line in reversed(lines) for shape in _shapes(line, across, up)]  # the first is on top
            legend = ", ".join(name for name, _ in series)
            titles = f"{words}: {legend}" if legend else words, words, words.partition(":")[0]
            _draw(figure, font.fitting(titles, width), shapes, across, up)
            figure.textrgb[:] = light(colour) if colour in (GOOD, BAD) else _TEXT
            figure.xlabel = font.fitting((foot, re.sub(r"\w+ \[", "[", foot)), width)
        return self.figures


_TEXT = 0.95, 0.96, 0.98


class Label:
    """Rectangle with a line of text, as an MjvFigure.

    Args:
        colour: Colour of the rectangle.
        opacity: Opacity of the rectangle, from 0 to 1.
    """

    def __init__(self, colour: Colour, opacity: float = 1.0) -> None:
        figure = self._figure = _new_figure()
        figure.panergba[:], figure.textrgb[:], figure.gridsize[:] = 0.0, 1.0, 0
        figure.flg_ticklabel[:], figure.minwidth = 0, ""
        figure.figurergba[3] = opacity
        self.paint(colour)

    def paint(self, colour: Colour) -> None:
        """Set the colour."""
        self._figure.figurergba[:3] = self._figure.gridrgb[:] = colour

    def update(self, text: str) -> Any:
        """Return the figure with a line of text at the top."""
        _set_title(self._figure, text)
        return self._figure


class TimeBar:
    """Time bar of a recording with event marks, as an MjvFigure."""

    def __init__(self) -> None:
        figure = self._figure = _new_figure()
        figure.gridsize[:], figure.flg_ticklabel[:], figure.minwidth = 0, 0, ""

    def update(self, snapshot: Snapshot) -> Any:
        """Return the figure for a snapshot with a duration."""
        duration, now = snapshot.duration or 1.0, snapshot.time
        # MuJoCo draws only lines, the first on top; a zigzag makes a bar
        levels = np.repeat(np.linspace(-0.5, 0.5, _STROKES), 2)
        ends = np.resize([0.0, 1.0, 1.0, 0.0], levels.size)
        lines: list[_Line] = [(_TEXT, [now, now], [-1.0, 1.0])]
        lines += [(BAD, [mark, mark], [-1.0, 1.0]) for mark in snapshot.marks[:_MARKS]]
        lines += [(MEASURED, now * ends, levels), (BOUNDARY, duration * ends, levels)]
        _draw(self._figure, "", lines, (0.0, duration), (-1.0, 1.0))
        return self._figure


def light(colour: Colour) -> Colour:
    """Return a colour lightened for a dark background."""
    return tuple(0.45 + 0.55 * part for part in colour)  # type: ignore[return-value]


def _new_figure() -> Any:
    figure: Any = mujoco.MjvFigure()
    mujoco.mjv_defaultFigure(figure)
    figure.figurergba[:] = 0.07, 0.08, 0.10, 0.88
    figure.panergba[:] = 0.13, 0.15, 0.18, 0.80
    figure.textrgb[:] = _TEXT
    figure.gridrgb[:] = 0.34, 0.37, 0.42
    figure.linewidth, figure.gridwidth = 2.5, 1.0
    figure.gridsize[:] = 3, 3
    figure.flg_legend = figure.flg_extend = 0
    figure.xformat = figure.yformat = "%.4g"
    figure.minwidth = "-100"
    return figure


def _set_title(figure: Any, title: str) -> None:
    # MuJoCo reads one character past the end, which may belong to a longer previous title
    figure.title = f"{title}\0"


def _draw(figure: Any, title: str, lines: Sequence[_Line], across: Range, up: Range) -> None:
    _set_title(figure, title)
    figure.linepnt[:] = 0
    for index, (colour, x, y) in enumerate(lines):
        x, y = np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)
        x, y = x[finite := np.isfinite(y)], y[finite]
        figure.linergb[index] = colour
        figure.linepnt[index] = x.size
        figure.linedata[index, : 2 * x.size : 2] = np.clip(x, *across)
        figure.linedata[index, 1 : 2 * x.size : 2] = np.clip(y, *up)
    figure.range[0], figure.range[1] = across, up


def _shapes(line: Line, across: Range, up: Range) -> list[_Line]:
    """Return a line, and the outlines of the dot at its last point, clipped to the ranges."""
    colour, x, y = line[:3]
    shapes: list[_Line] = [(colour, x, y)]
    if not line.dot or not np.size(x) or not np.isfinite(np.asarray(y)[-1]):
        return shapes
    wide, high = _DOT[0] * (across[1] - across[0]), _DOT[1] * (up[1] - up[0])
    middle = min(max(float(np.asarray(x)[-1]), across[0] + wide), across[1] - wide)
    level = min(max(float(np.asarray(y)[-1]), up[0] + high), up[1] - high)
    for scale in (1.0, 0.66, 0.33):
        dx, dy = scale * wide, scale * high
        corners = [middle - dx, middle, middle + dx, middle, middle - dx], [level, level + dy, level, level - dy, level]
        shapes.append((colour, *corners))
    return shapes


_STATUS = "hand", "device", "stops", "gains", "active", "rate", "time", "scene", "arrows", "tick", "energy", "wall"
"""Readings from top to bottom, last those with a variable number of lines; the plots show the position."""
_DRAG = "mouse", "drag the knob to pull it"
_ARROWS = "arrows", f"blue: hand, orange: device, black: stop; {1e3 * ARROW:.0f} mm/N"
_HINT = "F11", "keys"


def status_rows(snapshot: Snapshot) -> list[Row]:
    """Return the rows of the readings, forces first."""
    words = dict([_ARROWS, *(row[:2] for row in readings(snapshot))])
    if "energy" in words:
        words["energy"] = words["energy"].replace(", ", ",\n")  # same number of lines for any values
    return [(name, words[name]) for name in _STATUS if name in words]


def message_rows(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Row]:
    """Return the rows of temporary messages: metal stops, notes, slow motion, task of the tour."""
    return [row[:2] for row in readings(snapshot, notes) if row.name in ("", "speed")] + _tour(snapshot)


def moved_by_mouse(snapshot: Snapshot) -> bool:
    """Return True if the mouse is the hand: neither a recording nor a device."""
    return snapshot.duration is None and snapshot.state != "flying"


def _tour(snapshot: Snapshot) -> list[Row]:
    """Return the rows of the guided tour: step and task."""
    if (step := snapshot.tour) is None:
        return []
    text, task = step.words(lambda action: HAND if action == "hand" else key_of(action, snapshot.actions))
    return [(f"{step.number} of {step.total}", text), *([] if step.done else [("task", task)])]


_Text: TypeAlias = tuple[int, int, str, str]
"""Font, grid position, and two columns of text, as `set_texts` takes them."""

_HELPS, _CHARTS = (glfw.KEY_F1, glfw.KEY_F2), (glfw.KEY_F3, glfw.KEY_F4)
_ENGINE_HELP = (("Toggle Left / Right UI", "Ctrl [Shift] right drag"),)  # longest text of each column
_RED: Colour = (0.80, 0.05, 0.05)
_STOPS = "ESC: EMERGENCY STOP", "ESC: STOP", "ESC"
_BLACK: Colour = (0.0, 0.0, 0.0)
_LINES = 6  # of a banner


class Drawn(NamedTuple):
    """Overlay of one frame.

    Attributes:
        figures: Rectangles and MjvFigures, bottom to top.
        texts: Texts on top of them.
        layout: Layout of the frame.
    """

    figures: list[tuple[Any, Any]]
    texts: list[_Text]
    layout: Layout


class Screen:
    """Overlay with the user's display settings.

    Args:
        keys: True to show hints on keys.
        factor: Initial magnification of the handle's motion, one of MAGNIFICATIONS.

    Attributes:
        factor: Current magnification.
        dragged: True once the user has pulled the flotor.
    """

    def __init__(self, *, keys: bool = True, factor: int = MAGNIFICATIONS[0]) -> None:
        self._plots, self._has_keys = Plots(), keys
        self._stop, self._panel, self._bar = Label(_RED), Label(_BLACK, 0.95), TimeBar()
        self._banner, self._lines = Label(BAD), [Label(BAD, 0.0) for _ in range(_LINES)]
        self._late = Note()
        self.factor, self.dragged = factor, False
        self._axis: int | None = None
        self._keys = False
        self._engine: set[int] = set()

    def press(self, action: str, scene: Scene) -> None:
        """Perform a key's action on the display."""
        if action == AXIS:
            self._axis = ((scene.axis_index if self._axis is None else self._axis) + 1) % len(AXES)
        elif action == MAGNIFY:
            self.factor = MAGNIFICATIONS[(MAGNIFICATIONS.index(self.factor) + 1) % len(MAGNIFICATIONS)]
        elif action == KEYS:
            self._keys = not self._keys

    def note_engine_key(self, code: int) -> None:
        """Track whether MuJoCo's viewer shows its help and charts, which it does not report."""
        if code in (*_HELPS, *_CHARTS):
            self._engine ^= {code}

    def draw(self, snapshot: Snapshot, view: Area, scale: int, notes: Sequence[str] = ()) -> Drawn:
        """Return the overlay of a frame.

        Args:
            snapshot: The present snapshot.
            view: Area of the scene.
            scale: Font scale, 100 to 300 [%].
            notes: Additional notes.
        """
        font, has_help = Font(scale), bool(self._engine & {*_HELPS})
        table = help_rows(snapshot.actions, hand=moved_by_mouse(snapshot)) if self._keys else []
        wide = sum(font.columns(_ENGINE_HELP if has_help else table)) if has_help or table else 0
        layout = arranged(view, scale, help_width=wide, bar=snapshot.duration is not None)
        areas = [] if self._engine & {*_CHARTS} else layout.plots
        figures = list(zip(areas, self._plots.update(snapshot, self._axis, areas=areas, scale=scale), strict=False))
        texts: list[_Text] = []
        if not has_help:
            figures.append((layout.text, self._panel.update("")))
            texts = self._texts(table or status_rows(snapshot), self._messages(snapshot, notes), layout.text, font)
        if snapshot.duration is not None:
            figures.append((layout.bar, self._bar.update(snapshot)))
        if self._has_keys and EMERGENCY_STOP in snapshot.actions:
            figures.append((layout.label, self._stop.update(font.fitting(_STOPS, layout.label.width - font.row))))
        figures += self._banner_figures(snapshot, layout.banner, font)
        visible = [(mujoco.MjrRect(*area), figure) for area, figure in figures if min(area.width, area.height) > 0]
        return Drawn(visible, texts, layout)

    def _messages(self, snapshot: Snapshot, notes: Sequence[str]) -> list[Row]:
        """Return the rows at the lower left; those that stay are last."""
        magnified = motion_words(self.factor)
        rows = [_DRAG] if moved_by_mouse(snapshot) and self._has_keys and not self.dragged else []
        rows += [("display", f"{magnified} (handle, walls)")] if magnified else []
        return [*rows, *message_rows(snapshot, notes), *([_HINT] if self._has_keys else [])]

    def _texts(self, upper: Sequence[Row], lower: Sequence[Row], area: Area, font: Font) -> list[_Text]:
        """Return two blocks of text; the last rows of the upper one are omitted if they do not fit."""
        grids, limit = mujoco.mjtGridPos, max(area.height // font.row - 1, 0)
        below = font.wrapped(lower, area.width)[:limit]
        choices = (font.wrapped(upper[:count], area.width) for count in range(len(upper), -1, -1))
        above = next(rows for rows in choices if len(rows) + len(below) <= limit)
        texts: list[_Text] = []
        for rows, grid in ((above, grids.mjGRID_TOPLEFT), (below, grids.mjGRID_BOTTOMLEFT)):
            if rows:
                names, values = ("\n".join(column) for column in zip(*rows, strict=True))
                texts.append((int(mujoco.mjtFont.mjFONT_NORMAL), int(grid), names, values))
        return texts

    def _banner_figures(self, snapshot: Snapshot, area: Area, font: Font) -> list[tuple[Area, Any]]:
        """Return the background and lines of the banner, the heading first; empty while running normally."""
        if snapshot.overloaded:
            self._late.say("late")
        content = banner(replace(snapshot, overloaded=bool(self._late.lines)))  # hold the state: no flicker
        if content is None:
            return []
        heads, reason = _banner_texts(content, snapshot)
        width = area.width - 2 * _MARGIN
        reasons = [line for _, line in font.wrapped([("", reason)], width) if line]
        lines = [font.fitting(heads, width), *reasons][:_LINES]
        self._banner.paint(BAD if content.bad else STOP)
        height = (len(lines) + 1) * font.row
        strip = area._replace(bottom=area.top - height, height=height)
        parts = [
            (area._replace(bottom=area.top - (index + 2) * font.row, height=2 * font.row), label.update(line))
            for index, (label, line) in enumerate(zip(self._lines, lines))
        ]
        return [(strip, self._banner.update("")), *parts]


def _banner_texts(content: Banner, snapshot: Snapshot) -> tuple[list[str], str]:
    """Return the headings of a banner, longest first, with the key that resumes; and its reason."""
    title, _, reason = content.text.partition(": ")
    key = key_of(content.resume_action, snapshot.actions) if content.resume_action else ""
    heads = [f"{title}: press {key} {RESUME[content.resume_action]}", f"{title}: press {key}"] if key else [title]
    return heads, ". ".join(part for part in (reason, content.remedy) if part)
