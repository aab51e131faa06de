"""Overlay of text, plots, labels and banner, the same in a window and in a picture."""

from __future__ import annotations

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
from maglev_mj.views.readings import Banner, Charts, Line, Range, banner, readings
from maglev_mj.views.window.keys import AXIS, HAND, KEYS, MAGNIFY, help_rows, key_of
from maglev_mj.views.window.layout import Area, Font, Layout, Row, arranged

_POINTS = 500
_NOW = 0.018, 0.045
_LOW, _ROUND, _WIDE = 130, 12, 10_000
_STROKES, _MARKS = 8, 80

_Line: TypeAlias = tuple[Colour, ArrayLike, ArrayLike]
"""Colour, x and y of a line."""


class Plots:
    """Four live plots, updated from a snapshot.

    They are figures of the engine, the most important first.
    """

    def __init__(self) -> None:
        self._charts = Charts(_POINTS)
        self.figures = [_new_figure() for _ in range(4)]

    def update(
        self, snapshot: Snapshot, axis: int | None = None, *, areas: Sequence[Area] = (), scale: int = 100
    ) -> list[Any]:
        """Return the figures: position, force, stability map, phase plane.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES; the scene's own by default.
            areas: Their areas, to which titles and text under them are fitted.
            scale: Scale of the engine's letters [%].
        """
        charts = self._charts.of(snapshot, snapshot.scene.axis_index if axis is None else axis)
        width, height = areas[0][2:] if areas else (_WIDE, _WIDE)
        low = height < _LOW * scale // 100
        for figure, (title, lines, across, up, foot) in zip(self.figures, charts, strict=True):
            (words, colour), *further = title
            shapes = [
                shape for line in reversed(lines) for shape in _shapes(line, across, up)
            ]  # the first is uppermost
            named = ", ".join(name for name, _ in further)
            titles = f"{words}: {named}" if named else words, words, words.partition(":")[0]
            _draw(figure, Font(scale).fitting(titles, width - _ROUND), shapes, across, up)
            figure.textrgb[:] = shown_colour(colour) if colour in (GOOD, BAD) else _TEXT
            figure.flg_ticklabel[0] = not low
            figure.xlabel = "" if low else foot
        return self.figures


_TEXT = 0.95, 0.96, 0.98


class Label:
    """Rectangle with a line of text.

    It is a figure of the engine.

    Args:
        colour: Colour of the rectangle.
        opacity: Opacity of the rectangle, from 0 to 1.
    """

    def __init__(self, colour: Colour, opacity: float = 1.0) -> None:
        figure = self._figure = _new_figure()
        figure.panergba[:], figure.textrgb[:], figure.gridsize[:] = 0.0, 1.0, 0
        figure.flg_ticklabel[:], figure.minwidth = 0, ""
        self._opacity = opacity
        self.paint(colour)

    def paint(self, colour: Colour) -> None:
        """Change the colour."""
        figure = self._figure
        figure.figurergba[:] = (*colour, self._opacity)
        figure.gridrgb[:] = colour

    def update(self, text: str) -> Any:
        """Return the figure with its text, one line at the top."""
        _entitle(self._figure, text)
        return self._figure


class TimeBar:
    """Time bar of a recording, with event marks.

    It is a figure of the engine.
    """

    def __init__(self) -> None:
        figure = self._figure = _new_figure()
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


def _new_figure() -> Any:
    figure: Any = mujoco.MjvFigure()
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
    return figure


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


_SHOWN = "hand", "device", "stops", "gains", "on", "rate", "time", "scene", "arrows", "tick", "energy", "wall"
"""Readings from above, those last whose number of lines varies; plots show the position."""
_DRAG = "mouse", "drag the knob to pull it"
_ARROWS = "arrows", f"blue hand, orange device, black stop, {5e3 * ARROW:.0f} mm for 5 N"
_HINT = "F11", "keys"


def status_rows(snapshot: Snapshot) -> list[Row]:
    """Return the readings of a session, forces first."""
    words = dict([_ARROWS, *(row[:2] for row in readings(snapshot))])
    if "energy" in words:
        words["energy"] = words["energy"].replace(", ", ",\n")  # as many lines for any numbers
    return [(name, words[name]) for name in _SHOWN if name in words]


def message_rows(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Row]:
    """Return what is said for a while: metal stops, notes, slow motion, and the task of the guided tour."""
    return [row[:2] for row in readings(snapshot, notes) if row.name in ("", "speed")] + _tour(snapshot)


def moved_by_mouse(snapshot: Snapshot) -> bool:
    """Return True if the mouse is the hand; recordings and devices have their own."""
    return snapshot.duration is None and snapshot.state != "flying"


def _tour(snapshot: Snapshot) -> list[Row]:
    """Return the step and task of the guided tour."""
    if (line := snapshot.tour) is None:
        return []
    text, deed = line.words(lambda action: HAND if action == "hand" else key_of(action, snapshot.actions))
    return [(f"{line.number} of {line.total}", text), *([] if line.done else [("do", deed)])]


_Text: TypeAlias = tuple[int, int, str, str]
"""Font, position in the picture, and two columns."""

_HELPS, _CHARTS = (glfw.KEY_F1, glfw.KEY_F2), (glfw.KEY_F3, glfw.KEY_F4)
_ENGINE_HELP = (("Toggle Left / Right UI", "Ctrl [Shift] right drag"),)  # the longest of each column
_RED: Colour = (0.80, 0.05, 0.05)
_STOPS = "ESC: EMERGENCY STOP", "ESC: STOP", "ESC"
_BLACK: Colour = (0.0, 0.0, 0.0)
_LINES = 6  # of a banner
_WAYS = {"centre": "to start again", "pause": "to go on", "slower": "for slow motion", "next": "to go on"}


class Drawn(NamedTuple):
    """Items to be drawn over the scene.

    Attributes:
        figures: Rectangles and figures, the lowest first.
        texts: Text over them, in the form of the engine's viewer.
        layout: Positions of all parts.
    """

    figures: list[tuple[Any, Any]]
    texts: list[_Text]
    layout: Layout


class Screen:
    """Overlay of the scene with the user's choices.

    Args:
        keys: True if a user can press keys.
        factor: One of MAGNIFICATIONS, of the handle's motion, at first.

    Attributes:
        factor: The present one.
        dragged: True once a user has pulled the flotor.
    """

    def __init__(self, *, keys: bool = True, factor: int = MAGNIFICATIONS[0]) -> None:
        self._plots, self._with_keys = Plots(), keys
        self._stop, self._panel, self._bar = Label(_RED), Label(_BLACK, 0.95), TimeBar()
        self._banner, self._lines = Label(BAD), [Label(BAD, 0.0) for _ in range(_LINES)]
        self._late = Note()
        self.factor, self.dragged = factor, False
        self._axis: int | None = None
        self._keys = False
        self._engine: set[int] = set()

    def press(self, action: str, scene: Scene) -> None:
        """Run a key's action on the screen itself."""
        if action == AXIS:
            self._axis = ((scene.axis_index if self._axis is None else self._axis) + 1) % len(AXES)
        elif action == MAGNIFY:
            self.factor = MAGNIFICATIONS[(MAGNIFICATIONS.index(self.factor) + 1) % len(MAGNIFICATIONS)]
        elif action == KEYS:
            self._keys = not self._keys

    def note_engine_key(self, code: int) -> None:
        """Track the help and charts of the engine's viewer.

        The viewer does not report them.
        """
        if code in (*_HELPS, *_CHARTS):
            self._engine ^= {code}

    def draw(self, snapshot: Snapshot, view: Area, scale: int, notes: Sequence[str] = ()) -> Drawn:
        """Return the items to be drawn.

        Args:
            snapshot: The present snapshot.
            view: Area of the scene.
            scale: Scale of the engine's letters, 100 to 300 [%].
            notes: Further text for the user.
        """
        font, helped = Font(scale), bool(self._engine & {*_HELPS})
        table = help_rows(snapshot.actions, hand=moved_by_mouse(snapshot)) if self._keys else []
        wide = sum(font.columns(_ENGINE_HELP if helped else table)) if helped or table else 0
        layout = arranged(view, scale, help_width=wide, bar=snapshot.duration is not None)
        areas = [] if self._engine & {*_CHARTS} else layout.plots
        figures = list(zip(areas, self._plots.update(snapshot, self._axis, areas=areas, scale=scale), strict=False))
        texts: list[_Text] = []
        if not helped:
            figures.append((layout.text, self._panel.update("")))
            texts = self._texts(table or status_rows(snapshot), self._messages(snapshot, notes), layout.text, font)
        if snapshot.duration is not None:
            figures.append((layout.bar, self._bar.update(snapshot)))
        if self._with_keys and EMERGENCY_STOP in snapshot.actions:
            figures.append((layout.label, self._stop.update(font.fitting(_STOPS, layout.label.width - font.row))))
        figures += self._banner_figures(snapshot, layout.banner, font)
        seen = [(mujoco.MjrRect(*area), figure) for area, figure in figures if min(area.width, area.height) > 0]
        return Drawn(seen, texts, layout)

    def _messages(self, snapshot: Snapshot, notes: Sequence[str]) -> list[Row]:
        """Return the rows at the lower left, the task and the key of the help last: rows above them come and go."""
        magnified = motion_words(self.factor)
        rows = [_DRAG] if moved_by_mouse(snapshot) and self._with_keys and not self.dragged else []
        rows += [("shown", f"{magnified}, of handle and walls")] if magnified else []
        return [*rows, *message_rows(snapshot, notes), *([_HINT] if self._with_keys else [])]

    def _texts(self, upper: Sequence[Row], lower: Sequence[Row], area: Area, font: Font) -> list[_Text]:
        """Return two blocks of text, one above the other; the last rows of the upper one go if they do not fit."""
        grids, room = mujoco.mjtGridPos, max(area.height // font.row - 1, 0)
        below = font.wrapped(lower, area.width)[:room]
        some = (font.wrapped(upper[:count], area.width) for count in range(len(upper), -1, -1))
        above = next(rows for rows in some if len(rows) + len(below) <= room)
        texts: list[_Text] = []
        for rows, grid in ((above, grids.mjGRID_TOPLEFT), (below, grids.mjGRID_BOTTOMLEFT)):
            if rows:
                names, values = ("\n".join(column) for column in zip(*rows, strict=True))
                texts.append((int(mujoco.mjtFont.mjFONT_NORMAL), int(grid), names, values))
        return texts

    def _banner_figures(self, snapshot: Snapshot, area: Area, font: Font) -> list[tuple[Area, Any]]:
        """Return the banner's strip and its lines, the first the heading; nothing while running normally."""
        if snapshot.late:
            self._late.say("late")
        said = banner(replace(snapshot, late=bool(self._late.lines)))  # ticks are given up now and then: no flicker
        if said is None:
            return []
        heads, why = _said(said, snapshot)
        room = area.width - 2 * _ROUND
        lines = [font.fitting(heads, room), *(line for _, line in font.wrapped([("", why)], room) if line)][:_LINES]
        self._banner.paint(BAD if said.bad else STOP)
        height = (len(lines) + 1) * font.row
        strip = area._replace(bottom=area.top - height, height=height)
        parts = [
            (area._replace(bottom=area.top - (index + 2) * font.row, height=2 * font.row), label.update(line))
            for index, (label, line) in enumerate(zip(self._lines, lines))
        ]
        return [(strip, self._banner.update("")), *parts]


def _said(said: Banner, snapshot: Snapshot) -> tuple[list[str], str]:
    """Return a banner's headings and its reason.

    The headings name the key to continue, in decreasing length.
    """
    title, _, why = said.text.partition(": ")
    way = key_of(said.way_on, snapshot.actions) if said.way_on else ""
    heads = [f"{title}: press {way} {_WAYS[said.way_on]}", f"{title}: press {way}"] if way else [title]
    return heads, ". ".join(part for part in (why, said.remedy) if part)
