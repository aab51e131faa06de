"""Fixed layout of a picture: text at the left, device in the middle, plots at the right.

The layout depends on the size alone, so that nothing moves when states and texts change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

Row: TypeAlias = tuple[str, str]
"""Name and value, or key and action."""

# widths of MuJoCo's glyphs from space to ~ at 100 %, in hexadecimal [pixels], and their height
_WIDTHS = "45698ca4558845468888888888448887caaaba9bb4898cbbabbaabae9a9555885998994984484c899958488a7876868"
_HEIGHT, _GAP, _EDGE = 18.7, 5, 18


class Area(NamedTuple):
    """Rectangle in a picture [pixels], from the lower left corner."""

    left: int
    bottom: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """First column to the right of the area."""
        return self.left + self.width

    @property
    def top(self) -> int:
        """First row above the area."""
        return self.bottom + self.height

    @property
    def centre(self) -> tuple[float, float]:
        """Centre of the area."""
        return self.left + 0.5 * self.width, self.bottom + 0.5 * self.height


class Font(NamedTuple):
    """Font of MuJoCo.

    Attributes:
        scale: Font scale, 100 to 300 [%].
    """

    scale: int

    @property
    def row(self) -> int:
        """Row height with gap [pixels]."""
        return math.ceil(0.01 * self.scale * _HEIGHT) + _GAP

    def width(self, text: str) -> int:
        """Return the width of a text, rounded up [pixels]."""
        widths = (int(_WIDTHS[ord(letter) - 32], 16) if " " <= letter <= "~" else 8 for letter in text)
        uneven = 0 if self.scale == 100 else len(text) // 3 + 1  # some glyphs are scaled by more than the others
        return math.ceil(0.01 * self.scale * sum(widths)) + uneven

    def columns(self, rows: Sequence[Row]) -> tuple[int, int]:
        """Return the widths of the columns of names and values, with margins [pixels]."""
        names, values = (max(map(self.width, column), default=0) for column in zip(*rows, strict=True))
        return names + _EDGE, values + _EDGE

    def wrapped(self, rows: Sequence[Row], width: int) -> list[Row]:
        """Return rows with values wrapped to a total width [pixels], one row per line."""
        width -= self.columns(rows)[0] + _EDGE if rows else 0
        return [
            (name * (index == 0), line) for name, text in rows for index, line in enumerate(_lines(self, text, width))
        ]

    def fitting(self, texts: Sequence[str], width: int) -> str:
        """Return the first text that fits a width [pixels], or the first line of the last text."""
        return next((text for text in texts if self.width(text) <= width), _lines(self, texts[-1], width)[0])


@lru_cache(maxsize=256)
def _lines(font: Font, text: str, width: int) -> Sequence[str]:
    """Return a text wrapped to a width [pixels]."""
    lines, line = [], ""
    for letter in text:
        if letter == "\n":
            lines.append(line)
            line = ""
        elif line and font.width(line + letter) > width:
            head, _, tail = line.rpartition(" ")
            lines.append(head or line)
            line = tail if head else ""
        line = (line + letter).lstrip()
    return [*lines, line]


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Areas of all elements of a picture.

    Attributes:
        text: Area of readings (top) and messages (bottom).
        plots: Areas of the plots that fit.
        banner: Area of a banner of three lines.
        bar: Area of the time bar.
        label: Area of the emergency stop label.
        handle: Free area for the handle without a table of keys, which may cover its edges.
    """

    text: Area
    plots: Sequence[Area]
    banner: Area
    bar: Area
    label: Area
    handle: Area


_TEXT, _LEAST_TEXT, _MOST_TEXT = 0.27, 256, 0.45
_PLOT, _LEAST_PLOT, _MOST_PLOT, _PLOT_HEIGHT = 0.25, 240, 0.3, 130
_LEAST_HANDLE, _MOST_HELP = 190, 0.8
_LABEL, _BANNER = "ESC: EMERGENCY STOP", 3
"""Widest text of the label; number of lines of a banner."""


def arranged(view: Area, scale: int, *, help_width: int = 0, bar: bool = False) -> Layout:
    """Return the layout of a picture, without plots if it is too narrow for three columns.

    Args:
        view: The picture, or the part of a window in which the scene is drawn.
        scale: Font scale, 100 to 300 [%].
        help_width: Width of the table of keys in place of the readings [pixels]; 0 for none.
        bar: True for a time bar.
    """
    font, pad, wide = Font(scale), math.ceil(0.06 * scale), view.width
    text = max(int(_TEXT * wide), min(_LEAST_TEXT * scale // 100, int(_MOST_TEXT * wide)))
    text = min(max(text, help_width), int(_MOST_HELP * wide))
    plot = max(int(_PLOT * wide), min(_LEAST_PLOT * scale // 100, int(_MOST_PLOT * wide)))
    plot = plot if wide - text - plot >= _LEAST_HANDLE * scale // 100 else 0
    count = max(min(4, view.height // (_PLOT_HEIGHT * scale // 100)), 1) if plot else 0
    high, left, middle = view.height // max(count, 1), view.left + text, wide - text - plot
    strip, label_high = (_BANNER + 1) * font.row, font.row + 2 * pad
    label = min(font.width(_LABEL) + 4 * pad, middle - 2 * pad)
    bar_bottom = view.bottom + label_high + pad
    foot = bar_bottom + (2 * font.row if bar else 0)
    return Layout(
        text=Area(view.left, view.bottom, text, view.height),
        plots=[Area(left + middle, view.top - (index + 1) * high, plot, high) for index in range(count)],
        banner=Area(left, view.top - strip, middle, strip),
        bar=Area(left, bar_bottom, middle, 2 * font.row),
        label=Area(left + (middle - label) // 2, view.bottom + pad // 2, label, label_high),
        handle=arranged(view, scale, bar=bar).handle  # a device in the hand must not move
        if help_width
        else Area(left, foot, middle, view.top - strip - foot),
    )
