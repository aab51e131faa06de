"""Colours by role, from the colour-blind safe palette of Okabe and Ito."""

from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[float, float, float]
"""Red, green and blue, each from 0 to 1."""

_VERMILLION, _GREEN = (0.835, 0.369, 0.0), (0.0, 0.62, 0.451)
_SKY, _YELLOW, _PURPLE, _INK = (0.337, 0.706, 0.914), (0.941, 0.894, 0.259), (0.8, 0.475, 0.655), (0.12, 0.13, 0.15)

HAND: Colour = (0.0, 0.46, 0.72)
"""Hand force; the palette's blue, lightened for the window."""

DEVICE: Colour = _VERMILLION
"""Device force."""

STOP: Colour = _INK
"""Metal stops and their force."""

PULL: Colour = (0.5, 0.52, 0.55)
"""Line from the knob to the pointer that pulls it."""

WALL: Colour = _SKY
"""Wall without contact."""

TOUCHED: Colour = _YELLOW
"""Wall or stop in contact; not orange, which is the device's force."""

STUCK: Colour = _PURPLE
"""Stick position of friction."""

FIRST: Colour = tuple(0.5 + 0.5 * part for part in _SKY)  # type: ignore[assignment]
"""First of two trials, a lighter tint of `MEASURED`."""

MEASURED: Colour = _SKY
"""Position and other measured quantities of the flotor."""

GOOD: Colour = _GREEN
"""Stable, or passed."""

BAD: Colour = _VERMILLION
"""Unstable, stopped, or rejected."""

BOUNDARY: Colour = (0.85, 0.87, 0.90)
"""Stability boundary, or wall edge in a chart."""

REFERENCE: Colour = (0.35, 0.37, 0.40)
"""Reference curve of a chart, and small text."""

GRID: Colour = (0.89, 0.90, 0.91)
"""Grid of a chart."""

NIGHT: Colour = (0.18, 0.18, 0.18)
"""Lightest ground of the page in its dark scheme."""

_DARK = (0.0, 0.285, 0.456), (0.584, 0.249, 0.0), (0.0, 0.453, 0.326), (0.66, 0.388, 0.538)
SERIES: tuple[Colour, ...] = (*_DARK, (0.776, 0.535, 0.0), (0.267, 0.57, 0.741), _INK)
"""Colour cycle of charts: the palette darkened to a contrast of 3 on white, still distinguishable."""


def linear(colour: Colour) -> Colour:
    """Return linear RGB of an sRGB colour (IEC 61966-2-1)."""
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in colour)
    return red, green, blue


def on_white(colour: Colour, contrast: float = 4.5) -> Colour:
    """Return a colour, darkened if its WCAG 2 contrast ratio to white is too low: 4.5 for text, 3 for lines."""
    parts = linear(colour)
    share = min((1.05 / contrast - 0.05) / _luminance(parts), 1.0) * 0.99
    return _encoded(tuple(share * part for part in parts)) if share < 0.99 else colour


def on_dark(colour: Colour, contrast: float = 4.5) -> Colour:
    """Return a colour, lightened if its WCAG 2 contrast ratio to `NIGHT` is too low: 4.5 for text, 3 for lines."""
    parts = linear(colour)
    luminance = _luminance(parts)
    share = (1.01 * contrast * (_luminance(linear(NIGHT)) + 0.05) - 0.05 - luminance) / (1.0 - luminance)
    return _encoded(tuple(part + share * (1.0 - part) for part in parts)) if share > 0.0 else colour


def on_page(colour: Colour, contrast: float = 4.5) -> str:
    """Return the CSS colour with a contrast ratio on the page, in its light and its dark scheme."""
    return f"light-dark({hex_of(on_white(colour, contrast))}, {hex_of(on_dark(colour, contrast))})"


def _luminance(parts: Colour) -> float:
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), parts))


def _encoded(parts: tuple[float, ...]) -> Colour:
    """Return the sRGB colour of linear RGB, without the linear segment near black."""
    red, green, blue = (max(1.055 * part ** (1.0 / 2.4) - 0.055, 0.0) for part in parts)
    return red, green, blue


def hex_of(colour: Colour) -> str:
    """Return a colour as #rrggbb."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour)
