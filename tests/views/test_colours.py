"""Palette: distinct with every common colour vision, readable words."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from maglev_mj import colours
from maglev_mj.frames import Array

# what dichromats see of linear RGB: Machado, Oliveira and Fernandes (2009), severity 1.0
VISIONS = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = TO_XYZ.sum(axis=1)
PAPER = (1.0, 1.0, 1.0)
LEAST = 15.0
"""Least CIE L*a*b* distance of two meanings.

The eye just sees 2.3.
"""

SHOWN = ["HAND", "DEVICE", "STOP", "WALL", "TOUCHED", "STUCK"]
PAIRS = [*itertools.combinations(SHOWN, 2), ("GOOD", "BAD")]
PAIRS += [("BOUNDARY", other) for other in ("MEASURED", "STUCK", "GOOD", "BAD", "HAND", "DEVICE")]
PAIRS += [("MEASURED", other) for other in ("STUCK", "HAND", "DEVICE", "TOUCHED")]


def linear(colour: colours.Colour) -> Array:
    """Return linear RGB of sRGB."""
    values = np.array(colour)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def lab(colour: colours.Colour, vision: str = "normal") -> Array:
    """Return CIE L*a*b* (D65) of a perceived colour."""
    seen = np.clip(VISIONS[vision] @ linear(colour), 0.0, 1.0)
    part = TO_XYZ @ seen / WHITE
    f = np.where(part > (6.0 / 29.0) ** 3, np.cbrt(part), part / (3.0 * (6.0 / 29.0) ** 2) + 4.0 / 29.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def contrast(first: colours.Colour, second: colours.Colour) -> float:
    """Return the WCAG 2 contrast ratio, from 1 to 21."""
    low, high = sorted(float(TO_XYZ[1] @ linear(colour)) for colour in (first, second))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("vision", VISIONS)
def test_roles_and_series_are_distinguishable(vision: str) -> None:
    pairs = [(getattr(colours, first), getattr(colours, second)) for first, second in PAIRS]
    for pair in (*pairs, *itertools.combinations(colours.SERIES, 2)):
        assert np.linalg.norm(np.subtract(*(lab(colour, vision) for colour in pair))) > LEAST, pair


ROLES = {name: getattr(colours, name) for name in {*SHOWN, *itertools.chain(*PAIRS), "FIRST", "PULL", "REFERENCE"}}
GROUNDS = (colours.on_white, PAPER), (colours.on_dark, colours.NIGHT)
"""Grounds of the page, light and dark."""
DARK = (0.13, 0.15, 0.18)
"""Background of the window's plots."""


def test_texts_and_lines_are_visible_on_page_window_and_paper() -> None:
    # WCAG 2 asks for 4.5 of text, 3 of graphics
    for name, colour in ROLES.items():
        for least, (adapted, ground) in itertools.product((4.5, 3.0), GROUNDS):
            assert contrast(adapted(colour, least), ground) > least, name
        assert contrast(colours.on_dark(colour, 3.0), DARK) > 3.0, name
    assert min(contrast(colour, PAPER) for colour in (*colours.SERIES, colours.STUCK)) > 3.0
    assert min(contrast(colour, PAPER) for colour in (colours.REFERENCE, colours.STOP)) > 4.5
    for colour in (colours.GOOD, colours.BAD):
        assert contrast(colours.on_dark(colour), DARK) > 4.5


def test_a_colour_as_hexadecimal_digits() -> None:
    assert colours.hex_of((0.0, 0.5, 1.0)) == "#0080ff"
