"""Where words, plots and the handle go in a picture of any size, so that none covers another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from maglev_mj.parameters import flag

__all__ = ["Area", "Font", "Layout", "Row", "Words", "arrange"]

Row: TypeAlias = tuple[str, str]
"""Name and value, or keys and what they do."""

# widths of the engine's letters from space to ~ at 100 %, in hexadecimal [pixels], and their height
_WIDTHS = "45698ca4558845468888888888448887caaaba9bb4898cbbabbaabae9a9555885998994984484c899958488a7876868"
_HEIGHT, _GAP, _EDGE = 18.7, 5, 18
_HELP = 22, "Toggle Left / Right UI", "Ctrl [Shift] right drag"  # rows, and the longest of each column
_PLOT_HEIGHT, _PLOT_WIDTH, _COLUMN = 110, 210, 250
_LARGE = 1700, 950
_LEAST_FREE, _LEAST_WORDS, _WORDS = 400, 340, 0.3


class Area(NamedTuple):
    """A rectangle of a picture, from its lower left corner on [pixels]."""

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
        """Its middle."""
        return self.left + 0.5 * self.width, self.bottom + 0.5 * self.height

    def meets(self, other: Area) -> bool:
        """Return whether two share a pixel."""
        across = self.left < other.right and other.left < self.right
        return across and self.bottom < other.top and other.bottom < self.top


class Font(NamedTuple):
    """The engine's letters.

    Attributes:
        scale: 100 to 300 [%].
        large: Whether they are twice as large.
    """

    scale: int
    large: bool = False

    @property
    def size(self) -> float:
        """How many times as large as at 100 %."""
        return 0.01 * self.scale * (2.0 if self.large else 1.0)

    @property
    def row(self) -> int:
        """Height of a row, with the gap to the next [pixels]."""
        return math.ceil(_HEIGHT * self.size) + _GAP

    def width(self, text: str) -> int:
        """Return the width of a text, or a little more [pixels]."""
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
    """A block of words.

    Attributes:
        rows: Those for which there is room.
        font: Of the letters.
        area: Where they are.
    """

    rows: Sequence[Row]
    font: Font
    area: Area


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Where everything goes.

    Attributes:
        status: Words on the scene, at the upper left; None for nowhere.
        keys: Words on the keys, at the lower left, likewise.
        plots: Where the first plots go, as many as there is room for.
        banner: Where a banner goes.
        label: Where the label of the emergency stop goes; None for nowhere.
        hint: Where the key of the keys is named, likewise.
        handle: What is free for the handle.
    """

    status: Words | None
    keys: Words | None
    plots: Sequence[Area]
    banner: Area
    label: Area | None
    hint: Area | None
    handle: Area


def arrange(
    view: Area,
    scale: int,
    status: Sequence[Row],
    keys: Sequence[Row],
    *,
    banner: bool = False,
    label: bool = True,
    shown: bool | None = None,
    helped: bool = False,
    charted: bool = False,
) -> Layout:
    """Return where everything goes: words, handle and plots side by side, or one above the other where it is narrow.

    Args:
        view: The picture, or that part of a window in which the scene is drawn.
        scale: Of the letters, 100 to 300 [%].
        status: Words on the scene, the most important first.
        keys: Words on the keys.
        banner: Whether there is a banner.
        label: Whether the emergency stop has a label.
        shown: Whether the keys are shown; None for where there is room.
        helped: Whether the engine's viewer shows its own help, which it does at the upper left.
        charted: Whether it shows its own charts at the right.
    """
    for name, value in (("banner", banner), ("label", label), ("helped", helped), ("charted", charted)):
        flag(name, value)
    asked = _Asked(view, scale, list(status), list(keys), banner, label, shown, helped, charted)
    plain = Font(scale)
    large = view.width >= asked.pixels(_LARGE[0]) and view.height >= asked.pixels(_LARGE[1])
    return (large and asked.columns(plain._replace(large=True))) or asked.columns(plain) or asked.rows()


class _Asked(NamedTuple):
    """What is to be laid out; see `arrange`."""

    view: Area
    scale: int
    status: list[Row]
    keys: list[Row]
    banner: bool
    label: bool
    shown: bool | None
    helped: bool
    charted: bool

    def columns(self, font: Font) -> Layout | None:
        """Return words, handle and plots side by side; None where it is too narrow."""
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
        """Return words, handle and plots one above the other; the keys, where they are asked for, beside the handle."""
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
        """Return the keys, or the engine's help, at the left, and the handle at their right."""
        view, font, strip = self.view, Font(self.scale), self.strip
        most = view.width - view.width // 5
        fits = max((view.height - (strip if self.banner else 0) - 2 * _GAP) // font.row, 1)
        rows = _cut(font, self.keys[:fits], most)
        wide, high = self.help_size if self.helped else font.block(rows)
        left = view.left + min(wide, most)
        label, hint, foot = self.feet(left, view.right, view.bottom, True)
        keys = Words(rows, font, Area(view.left, view.bottom, left - view.left, high))
        return Layout(
            status=None,
            keys=None if self.helped else keys,
            plots=[],
            banner=Area(view.left, view.top - strip, view.width, strip),
            label=label,
            hint=hint,
            handle=Area(left, foot, view.right - left, view.top - strip - foot),
        )

    @property
    def pad(self) -> int:
        """Distance between things."""
        return math.ceil(0.06 * self.scale)

    @property
    def strip(self) -> int:
        """Height of a banner: a large line and, where there is room, a small one."""
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
        """Height of the emergency stop's label and of the hint, and what is around them."""
        return Font(self.scale).row + 3 * self.pad if self.label or self.keys else 0

    def feet(self, left: int, right: int, bottom: int, keys: bool) -> tuple[Area | None, Area | None, int]:
        """Return where label and hint go, and the lowest row above them."""
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
    """Return rows no wider than so much."""
    return [(name, font.cut(value, most - _names(font, rows))) for name, value in rows]


def _wrapped(font: Font, rows: Sequence[Row], most: int) -> list[Row]:
    """Return rows no wider than so much, in two where it takes that."""
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
    """Return the width of the first column, and of what is around both."""
    return max((font.width(name) for name, _ in rows), default=0) + 2 * _EDGE
