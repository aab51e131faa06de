"""Layout of text, plots and handle in a picture.

None covers another, at any size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

Row: TypeAlias = tuple[str, str]
"""Name and value, or keys and their action."""

# widths of the engine's letters from space to ~ at 100 %, in hexadecimal [pixels], and their height
_WIDTHS = "45698ca4558845468888888888448887caaaba9bb4898cbbabbaabae9a9555885998994984484c899958488a7876868"
_HEIGHT, _GAP, _EDGE = 18.7, 5, 18
_HELP = 22, "Toggle Left / Right UI", "Ctrl [Shift] right drag"  # rows, and the longest of each column
_PLOT_HEIGHT, _PLOT_WIDTH, _COLUMN = 110, 210, 250
_LARGE = 1700, 950
_LEAST_FREE, _LEAST_WORDS, _WORDS = 400, 340, 0.3
_FIRST = 2  # rows of the status that stay beside the keys


class Area(NamedTuple):
    """Rectangle of a picture [pixels].

    It begins at the lower left corner.
    """

    left: int
    bottom: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """First column beyond it."""
        return self.left + self.width

    @property
    def top(self) -> int:
        """First row above it."""
        return self.bottom + self.height

    @property
    def centre(self) -> tuple[float, float]:
        """Middle of the area."""
        return self.left + 0.5 * self.width, self.bottom + 0.5 * self.height


class Font(NamedTuple):
    """Font of the engine.

    Attributes:
        scale: 100 to 300 [%].
        large: True for letters of double size.
    """

    scale: int
    large: bool = False

    @property
    def size(self) -> float:
        """Size relative to 100 %."""
        return 0.01 * self.scale * (2.0 if self.large else 1.0)

    @property
    def row(self) -> int:
        """Height of a row with its gap [pixels]."""
        return math.ceil(_HEIGHT * self.size) + _GAP

    def width(self, text: str) -> int:
        """Return the width of a text, rounded up [pixels]."""
        widths = (int(_WIDTHS[ord(letter) - 32], 16) if " " <= letter <= "~" else 8 for letter in text)
        uneven = 0 if self.size == 1.0 else len(text) // 3 + 1  # some letters grow by more than the others
        return math.ceil(self.size * sum(widths)) + uneven

    def cut(self, text: str, most: int) -> str:
        """Return a text, shortened to a width."""
        if self.width(text) <= most:
            return text
        while text and self.width(text + "...") > most:
            text = text[:-1]
        return text.rstrip() + "..."

    def block(self, rows: Sequence[Row]) -> tuple[int, int]:
        """Return width and height of two columns [pixels]."""
        wide = sum(max((self.width(part) for part in column), default=0) for column in zip(*rows, strict=True))
        return wide + 2 * _EDGE, len(rows) * self.row + 2 * _GAP


class Words(NamedTuple):
    """Block of text.

    Attributes:
        rows: Visible rows.
        font: Font of the letters.
        area: Position in the picture.
    """

    rows: Sequence[Row]
    font: Font
    area: Area


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Positions of all parts of a picture.

    Attributes:
        status: Text on the scene, at the upper left; None if hidden.
        keys: Text on the keys, at the lower left; None if hidden.
        plots: Areas of the first plots, as many as there is room for.
        banner: Area of a banner.
        label: Area of the emergency stop's label; None if hidden.
        hint: Area of the hint at the help key; None if hidden.
        handle: Free area for the handle.
    """

    status: Words | None
    keys: Words | None
    plots: Sequence[Area]
    banner: Area
    label: Area | None
    hint: Area | None
    handle: Area


class Arrangement(NamedTuple):
    """Arrangement of text, handle and plots in a picture.

    They are side by side, or one above the other where it is narrow.

    Attributes:
        view: The picture, or that part of a window in which the scene is drawn.
        scale: Scale of the letters, 100 to 300 [%].
        status: Text on the scene, the most important row first.
        keys: Text on the keys.
        banner: True if there is a banner.
        label: True if the emergency stop has a label.
        shown: True to show the keys; None to show them if there is room.
        helped: True if the engine's viewer shows its own help, at the upper left.
        charted: True if it shows its own charts, at the right.
    """

    view: Area
    scale: int
    status: Sequence[Row]
    keys: Sequence[Row]
    banner: bool = False
    label: bool = True
    shown: bool | None = None
    helped: bool = False
    charted: bool = False

    def layout(self) -> Layout:
        """Return the layout of the picture."""
        plain, view = Font(self.scale), self.view
        large = view.width >= self.pixels(_LARGE[0]) and view.height >= self.pixels(_LARGE[1])
        return (large and self.columns(plain._replace(large=True))) or self.columns(plain) or self.rows()

    def columns(self, font: Font) -> Layout | None:
        """Return a layout side by side.

        None if the picture is too narrow.
        """
        view, strip, plain = self.view, self.strip, Font(self.scale)
        status = _wrapped(font, self.status, max(int(_WORDS * view.width), self.pixels(_LEAST_WORDS)))
        wide, high = font.block(status)
        key_rows = [] if self.shown is False or self.helped else self.keys
        keys_wide, keys_high = plain.block(key_rows) if key_rows else (0, 0)
        if self.helped:
            status, (wide, high) = [], self.help_size
        elif high + keys_high > view.height:
            if self.shown or font.large:
                return None
            key_rows, keys_wide = [], 0
        left = view.left + max(wide, keys_wide)
        column = view.width // 4 if self.charted else max(view.width // 4, self.pixels(_COLUMN))
        right = view.right - column
        if right - left < self.pixels(_LEAST_FREE) or high > view.height:
            return None
        label, hint, foot = self.feet(left, right, view.bottom, bool(key_rows))
        top = view.top - (strip if self.banner else 0)
        count = 0 if self.charted else max(min(4, (top - view.bottom) // self.pixels(_PLOT_HEIGHT)), 1)
        each = (top - view.bottom) // max(count, 1)
        return Layout(
            status=Words(status, font, Area(view.left, view.top - high, wide, high)) if status else None,
            keys=Words(key_rows, plain, Area(view.left, view.bottom, keys_wide, keys_high)) if key_rows else None,
            plots=[Area(right, top - (place + 1) * each, column, each) for place in range(count)],
            banner=Area(left, view.top - strip, view.right - left, strip),
            label=label,
            hint=hint,
            handle=Area(left, foot, right - left, view.top - strip - foot),
        )

    def rows(self) -> Layout:
        """Return a layout one above the other.

        If the keys are requested, they are beside the handle.
        """
        view, font, strip = self.view, Font(self.scale), self.strip
        if self.helped or self.shown:
            return self.beside()
        fits = max(int(0.2 * view.height) // font.row, 1)
        rows = _cut(font, self.status[:fits], view.width - self.pad)
        wide, high = font.block(rows)
        plots_high = max(self.pixels(100), min(int(0.28 * view.height), self.pixels(190)))
        reserved = max(high, strip)
        if self.charted or view.height - reserved - plots_high - self.foot_height < 0.3 * view.height:
            plots_high = 0
        count = max(1, min(4, view.width // self.pixels(_PLOT_WIDTH))) if plots_high else 0
        width = view.width // max(count, 1)
        right = view.right - (view.width // 4 if self.charted else 0)
        label, hint, foot = self.feet(view.left, right, view.bottom + plots_high, False)
        area = Area(view.left, view.top - high, min(wide, view.width), high)
        return Layout(
            status=None if self.banner else Words(rows, font, area),
            keys=None,
            plots=[Area(view.left + place * width, view.bottom, width, plots_high) for place in range(count)],
            banner=Area(view.left, view.top - strip, view.width, strip),
            label=label,
            hint=hint,
            handle=Area(view.left, foot, right - view.left, view.top - reserved - foot),
        )

    def beside(self) -> Layout:
        """Return a layout with help at the left.

        The help is that of the keys or of the engine; the handle is at its right.
        """
        view, font, strip = self.view, Font(self.scale), self.strip
        most = view.width - view.width // 5
        # a task stays while its keys are looked up
        first = [] if self.helped or self.banner else _cut(font, self.status[:_FIRST], view.width - self.pad)
        first_wide, first_high = font.block(first) if first else (0, 0)
        top = view.top - max(first_high, strip)
        fits = max(((top if first or self.banner else view.top) - view.bottom - 2 * _GAP) // font.row, 1)
        rows = _cut(font, self.keys[:fits], most)
        wide, high = self.help_size if self.helped else font.block(rows)
        left = view.left + min(wide, most)
        label, hint, foot = self.feet(left, view.right, view.bottom, True)
        keys = Words(rows, font, Area(view.left, view.bottom, left - view.left, high))
        area = Area(view.left, view.top - first_high, min(first_wide, view.width), first_high)
        return Layout(
            status=Words(first, font, area) if first else None,
            keys=None if self.helped else keys,
            plots=[],
            banner=Area(view.left, view.top - strip, view.width, strip),
            label=label,
            hint=hint,
            handle=Area(left, foot, view.right - left, top - foot),
        )

    @property
    def pad(self) -> int:
        """Distance between parts [pixels]."""
        return math.ceil(0.06 * self.scale)

    @property
    def strip(self) -> int:
        """Height of a banner [pixels].

        It has a large line and, if there is room, a small one.
        """
        small, large = Font(self.scale), Font(self.scale, large=True)
        high = large.row + 2 * self.pad + (small.row if self.view.height >= 15 * small.row else 0)
        return min(high, self.view.height // 2)

    @property
    def help_size(self) -> tuple[int, int]:
        """Width and height of the engine's own help."""
        count, *longest = _HELP
        font = Font(self.scale)
        wide, _ = font.block([(longest[0], longest[1])])
        return wide, min(count * font.row + 2 * _GAP, self.view.height)

    def pixels(self, size: int) -> int:
        """Return a size at the letters' scale."""
        return size * self.scale // 100

    @property
    def foot_height(self) -> int:
        """Height of label and hint with their margins."""
        return Font(self.scale).row + 3 * self.pad if self.label or self.keys else 0

    def feet(self, left: int, right: int, bottom: int, keys: bool) -> tuple[Area | None, Area | None, int]:
        """Return the areas of label and hint.

        The lowest row above them is returned too.
        """
        font, pad, high = Font(self.scale), self.pad, self.foot_height - self.pad
        hinted = 0 if keys or self.helped or not self.keys else font.width("F11: KEYS") + 4 * pad
        wide = min(font.width("ESC: EMERGENCY STOP") + 4 * pad, right - left - 2 * pad) if self.label else 0
        if wide + hinted + 3 * pad > right - left:
            hinted = 0
        if not wide and not hinted:
            return None, None, bottom
        start = left + (right - left - wide - hinted) // 2
        label = Area(start, bottom + pad // 2, wide, high) if wide else None
        hint = Area(start + wide + pad, bottom + pad // 2, hinted, high) if hinted else None
        return label, hint, bottom + self.foot_height


def _cut(font: Font, rows: Sequence[Row], most: int) -> list[Row]:
    """Return rows shortened to a width."""
    return [(name, font.cut(value, most - _names(font, rows))) for name, value in rows]


def _wrapped(font: Font, rows: Sequence[Row], most: int) -> list[Row]:
    """Return rows wrapped to a width, in two if necessary."""
    found, room = [], most - _names(font, rows)
    for name, value in rows:
        words, first = value.split(" "), ""
        while words and font.width(longer := f"{first} {words[0]}".strip()) <= room:
            first = longer
            words.pop(0)
        found.append((name, first if first or not words else font.cut(words.pop(0), room)))
        found += [("", font.cut(" ".join(words), room))] if words else []
    return found


def _names(font: Font, rows: Sequence[Row]) -> int:
    """Return the width of the first column with margins.

    The margins are those around both columns.
    """
    return max((font.width(name) for name, _ in rows), default=0) + 2 * _EDGE
