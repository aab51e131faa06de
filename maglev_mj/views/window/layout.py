"""Fixed layout of a picture: readings at the left, device in the middle, plots at the right.

The layout depends on the size alone, so that nothing moves when states and texts change.
"""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import NamedTuple, TypeAlias

Row: TypeAlias = tuple[str, str]
"""Name and value, or key and action."""

_GLYPH, _ROW = 0.08, 0.24
"""Width of a letter of MuJoCo's font, wider than the mean, and height of a row, per font scale [pixels/%]."""

_MARGIN = 0.12
_TEXT, _PLOT, _NARROW, _PLOT_HEIGHT = 0.27, 0.25, 7.6, 1.3


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

    @property
    def centre(self) -> tuple[float, float]:
        """Centre of the area."""
        return self.left + 0.5 * self.width, self.bottom + 0.5 * self.height


class Layout(NamedTuple):
    """Areas of all elements of a picture.

    Attributes:
        text: Area of readings (top) and messages (bottom).
        device: Area of the 3D view; banner, time bar and label cover its edges.
        plots: Areas of the plots that fit.
        bar: Area of the time bar of a recording.
        label: Area of the emergency stop label.
        row: Height of a row of text [pixels].
    """

    text: Area
    device: Area
    plots: Sequence[Area]
    bar: Area
    label: Area
    row: int


def arranged(view: Area, scale: int) -> Layout:
    """Return the layout of a picture, without plots if it is too narrow for three columns.

    Args:
        view: The picture.
        scale: Font scale, 100 to 300 [%].
    """
    wide = view.width >= _NARROW * scale
    text, plot = max(int(_TEXT * view.width), min(int(2.5 * scale), view.width // 2)), int(_PLOT * view.width) * wide
    count = min(max(view.height // int(_PLOT_HEIGHT * scale), 1), 4) * wide
    high, left, row = view.height // max(count, 1), view.left + text, int(_ROW * scale)
    device = Area(left, view.bottom, max(view.width - text - plot, 1), view.height)
    right = device.left + device.width
    return Layout(
        text=Area(view.left, view.bottom, text, view.height),
        device=device,
        plots=[Area(right, view.top - (index + 1) * high, plot, high) for index in range(count)],
        bar=Area(left, view.bottom + 2 * row, device.width, row),
        label=Area(left + device.width // 4, view.bottom + row // 3, device.width // 2, row + row // 3),
        row=row,
    )


def letters(width: int, scale: int) -> int:
    """Return the number of letters that fit a width [pixels]."""
    return max(int((width - _MARGIN * scale) / (_GLYPH * scale)), 1)


def wrapped(rows: Sequence[Row], width: int, scale: int) -> list[Row]:
    """Return rows with values wrapped to a total width [pixels], one row per line."""
    room = max(letters(width, scale) - max((len(name) for name, _ in rows), default=0) - 2, 8)
    return [(name * (index == 0), line) for name, text in rows for index, line in enumerate(wrap(text, room) or [""])]
