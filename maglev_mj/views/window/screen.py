"""Overlay of text, plots, labels and banner for window and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BAD, GOOD, MEASURED, STOP, Colour
from maglev_mj.frames import AXES
from maglev_mj.lazy import mujoco
from maglev_mj.plants.shapes import ARROW
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, Note, Snapshot
from maglev_mj.views.handle import MAGNIFICATIONS, motion_words
from maglev_mj.views.readings import GROUPS, RESUME, Banner, Charts, Line, Range, banner, readings
from maglev_mj.views.window.keys import AXIS, HAND, KEYS, MAGNIFY, help_rows, key_of
from maglev_mj.views.window.layout import Area, Layout, Row, arranged, letters, wrapped

_POINTS = 500
_DOT = 0.018, 0.045
_MARKS = 80

_Line: TypeAlias = tuple[Colour, ArrayLike, ArrayLike]
"""Colour, x and y of a polyline."""


class Plots:
    """Four live plots as MjvFigures: position, force, stability map, phase plane."""

    def __init__(self) -> None:
        self._charts = Charts(_POINTS)
        self.figures = [_new_figure() for _ in range(4)]

    def update(
        self, snapshot: Snapshot, axis: int | None = None, *, width: int = 10_000, scale: int = 100
    ) -> list[Any]:
        """Return the figures, updated from a snapshot.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES; the scene's axis by default.
            width: Width of a figure [pixels], to which titles are fitted.
            scale: Font scale [%].
        """
        axis = snapshot.scene.axis_index if axis is None else axis
        charts, room = self._charts.of(snapshot, axis), letters(width, scale)
        for figure, (title, lines, across, up, foot, side) in zip(self.figures, charts, strict=True):
            (words, colour), *series = title
            shapes = [shape for line in reversed(lines) for shape in _shapes(line, across, up)]  # the first is on top
            titles = f"{words}: {', '.join(name for name, _ in series)}" if series else words, words
            _draw(figure, next((text for text in titles if len(text) <= room), words[:room]), shapes, across, up)
            figure.textrgb[:] = light(colour) if colour in (GOOD, BAD) else _TEXT
            foot = f"{side} vs {foot}" if side else foot
            figure.xlabel = foot[:room]
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


def _draw(figure: Any, title: str, lines: Sequence[_Line], across: Range, up: Range) -> None:
    figure.title = f"{title}\0"  # MuJoCo reads one more character, which may belong to a longer previous title
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


_STATUS = *GROUPS["felt"][:2], "arrows", *(name for name in GROUPS["numbers"] if name != "position"), "margin"
"""Readings from top to bottom, last those with a variable number of lines; the plots show the position."""
_ARROWS = "arrows", f"blue: hand, orange: device, black: stop; {1e3 * ARROW:.0f} mm/N"
_HINTS = [("mouse", "drag the knob to pull it"), ("F11", "keys")]


def status_rows(snapshot: Snapshot) -> list[Row]:
    """Return the rows of the readings, forces first."""
    words = dict([_ARROWS, *(row[:2] for row in readings(snapshot))])
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
        for rows, grid in (
            (self.upper, mujoco.mjtGridPos.mjGRID_TOPLEFT),
            (self.lower, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT),
        ):
            if rows:
                columns = ("\n".join(column) for column in zip(*rows, strict=True))
                mujoco.mjr_overlay(font, grid, mujoco.MjrRect(*self.layout.text), *columns, context)


class Screen:
    """Overlay with the user's display settings.

    Args:
        keys: True to show hints on keys.
        factor: Initial magnification of the handle's motion, one of MAGNIFICATIONS.
        plots: False to draw the device alone.

    Attributes:
        factor: Current magnification.
        plots: See the argument.
    """

    def __init__(self, *, keys: bool = True, factor: int = MAGNIFICATIONS[0], plots: bool = True) -> None:
        self._plots, self._has_keys, self._late = Plots(), keys, Note()
        self._axis: int | None = None
        self._keys = False
        self.factor, self.plots = factor, plots

    def press(self, action: str, scene: Scene) -> None:
        """Perform a key's action on the display."""
        if action == AXIS:
            self._axis = ((scene.axis_index if self._axis is None else self._axis) + 1) % len(AXES)
        elif action == MAGNIFY:
            self.factor = MAGNIFICATIONS[(MAGNIFICATIONS.index(self.factor) + 1) % len(MAGNIFICATIONS)]
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
        layout = arranged(view, scale)
        text, row = layout.text, layout.row
        plot = (
            self._plots.update(snapshot, self._axis, width=layout.plots[0].width, scale=scale) if layout.plots else []
        )
        boxes = [Box(text, _PANEL), *self._bar(snapshot, layout.bar)]
        if self._has_keys and EMERGENCY_STOP in snapshot.actions:
            boxes.append(Box(layout.label, _RED, _STOP_LABEL))
        boxes += self._banner(snapshot, layout, scale)
        table = help_rows(snapshot.actions, hand=moved_by_mouse(snapshot)) if self._keys else status_rows(snapshot)
        lower = wrapped(self._messages(snapshot, notes), text.width, scale)
        limit = max(text.height // row - 1 - len(lower), 0)
        return Overlay(layout, list(zip(layout.plots, plot)), boxes, wrapped(table, text.width, scale)[:limit], lower)

    def _messages(self, snapshot: Snapshot, notes: Sequence[str]) -> list[Row]:
        """Return the rows at the lower left; those that stay are last."""
        magnified = motion_words(self.factor)
        if self._keys:
            return _HINTS[1:]
        rows = [("display", f"{magnified} (handle, walls)")] if magnified else []
        return [*rows, *message_rows(snapshot, notes), *(_HINTS if self._has_keys else [])]

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
        area, colour = layout.device, BAD if content.bad else STOP
        lines = [
            line for text in _banner_texts(content, snapshot) for _, line in wrapped([("", text)], area.width, scale)
        ]
        strip = area._replace(bottom=area.top - layout.row, height=layout.row)
        return [
            Box(strip._replace(bottom=strip.bottom - index * layout.row), colour, line)
            for index, line in enumerate(lines)
        ]


def _banner_texts(content: Banner, snapshot: Snapshot) -> list[str]:
    """Return the heading of a banner with the key that resumes; and its reason."""
    title, _, reason = content.text.partition(": ")
    key = key_of(content.resume_action, snapshot.actions) if content.resume_action else ""
    head = f"{title}: press {key} {RESUME[content.resume_action]}" if key else title
    return list(filter(None, (head, ". ".join(part for part in (reason, content.remedy) if part))))
