"""Pictures of a diagnosis: stability region with the remedies, free response, bars of what each buys; and jitter."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from maglev_mj.colours import BAD, GOOD, REFERENCE, SERIES, STOP, TOUCHED, Colour, on_white
from maglev_mj.pictures import TITLE, drawn, fitting, name_curves, new_figure, wide_share
from maglev_mj.spec import MAX_DELAY_PERIODS
from maglev_mj.studies.diagnosis import Diagnosis
from maglev_mj.theory.boundary import boundary_of
from maglev_mj.theory.remedies import short

_POINTS, _CYCLES, _MOST_SAMPLES, _MOST_GROWTH, _BARS = 160, 8.0, 600, 30.0, 8
_COLUMNS, _HALVES, _BEYOND, _TINT = 29, 14, 1.3, 0.5
"""Middles and half-widths in the picture of jitter; end over the critical delay; share of a colour in its ground."""
_HISTOGRAM, _REGIONS, _BINS = 1.4, 4.4, 60
"""Heights of the histogram of measured delays and of the regions below it [inch]; number of bins."""
_TOP, _ROW = 3.4, 0.165  # heights of the panels above, and of a line of names [inch]
_GROUND: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
_NAMES, _LETTERS = 0.45, 50
"""Share of the bars' width for the names of the remedies, and letters in a line of it."""


@drawn
def diagnosis(result: Diagnosis) -> Any:
    """Draw a diagnosis.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    shown = result.remedies[:_BARS]
    names = ["now", *(f"{index}  {_unbroken(one.words)}" for index, one in enumerate(shown, 1))]
    names = [textwrap.fill(name, int(_LETTERS * wide_share())) for name in names]
    low = _ROW * (max(name.count("\n") for name in names) + 2) * len(names) + 0.7
    head = result.headline, result.conditions, result.summary
    columns = fitting(2)
    ratios = (_TOP,) * (3 - columns) + (low,)
    figure, (region, response, bars, *empty) = new_figure(
        head, len(ratios), columns, sum(ratios), height_ratios=ratios, least=max(ratios)
    )
    _region(region, result)
    _response(response, result)
    for panel in empty:
        panel.set_axis_off()
    bars.set_subplotspec(bars.get_gridspec()[-1, :])
    _bars(bars, result, names)
    return figure


@drawn
def jitter(result: Diagnosis) -> Any:
    """Draw the verdicts over the middle and the half-width of a delay that varies, below the measured delays, if any.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    found = result.line
    assert found is not None
    loop, (low, high) = result.loop, found.delays
    critical, period = float(result.critical_delay), loop.period
    last = min(max(_BEYOND * min(critical, 2.0 * period), _BEYOND * high, period), MAX_DELAY_PERIODS * period)
    middles, halves = np.linspace(0.0, last, _COLUMNS), np.linspace(0.0, 0.5 * min(period, last), _HALVES)
    worst, growth = found.regions(middles, halves)
    setting = found.setting
    head = f"{setting[:1].upper()}{setting[1:]}: {'; '.join(map(' '.join, found.rows[:2]))}"
    heights = (*[_HISTOGRAM] * (found.line.measured is not None), _REGIONS)
    lines = head, result.conditions, result.summary
    figure, (*above, panel) = new_figure(lines, len(heights), 1, sum(heights), height_ratios=heights, least=_HISTOGRAM)
    for histogram in above:
        histogram.hist(1e3 * np.asarray(found.line.measured), _BINS, range=(0.0, 1e3 * last), color=SERIES[0])
        histogram.set(xlim=(0.0, 1e3 * last), ylabel="samples")
        histogram.set_title("measured delays", **TITLE)
    ground = np.ones((*worst.shape, 3))
    lossless = " without loss" * bool(found.line.loss and found.line.lost_in_a_row is None)
    x, y, random = 1e3 * middles, 1e3 * halves, growth < 1.0
    for name, cells, colour in (
        (f"stable for every sequence{lossless}", (worst == 1.0) & random, GOOD),
        ("not decided, stable if random", (worst == 0.0) & random, REFERENCE),
        ("destabilised by a sequence, stable if random", (worst == -1.0) & random, TOUCHED),
        ("unstable even if random", growth >= 1.0, BAD),
    ):
        tint = tuple(1.0 - _TINT * (1.0 - part) for part in colour)
        ground[cells] = tint
        if cells.any():
            panel.plot([], [], "s", color=tint, markersize=9, label=name)
    edges = -0.5 * x[1], x[-1] + 0.5 * x[1], -0.5 * y[1], y[-1] + 0.5 * y[1]
    panel.imshow(ground, origin="lower", extent=edges, aspect="auto", interpolation="nearest")
    panel.plot(5e2 * (low + high), 5e2 * (high - low), "o", color=SERIES[0], markersize=8, label="this line")
    panel.set(xlabel="middle of the delays (ms)", ylabel="half-width of the jitter (ms)")
    panel.set(xlim=(0.0, x[-1]), ylim=edges[2:])
    panel.grid(visible=False)
    name_curves(panel)
    return figure


def _region(panel: Any, result: Diagnosis) -> None:
    """Draw the stability boundary, half of it, the present gains, and the gains of the first remedy."""
    loop, best, (stiffness, damper) = result.loop, result.best, result.loop.gains
    widest = max(2.2 * float(best.damping), 1.3 * damper, 1e-9)
    damping = np.linspace(0.0, widest, _POINTS)
    boundary = boundary_of(loop.sampled, damping)
    panel.plot(damping, boundary, color=STOP, label="stability boundary")
    panel.plot(damping, 0.5 * boundary, color=REFERENCE, linestyle="--", label="half of it")
    colour = on_white(_colour(result.ratio, loop.target))
    panel.plot(damper, stiffness, "o", color=colour, markersize=8, label="present gains")
    for index, one in enumerate(result.remedies, 1):
        to = tuple(one.change.get(loop.whole.name(word), loop.value(word)) for word in ("damping", "stiffness"))
        if set(one.change) <= {*map(loop.whole.name, ("damping", "stiffness"))}:
            style = {"arrowstyle": "->", "color": on_white(GOOD), "linewidth": 1.6}
            panel.annotate("", to, (damper, stiffness), arrowprops=style)
            panel.plot([], [], color=on_white(GOOD), label=f"remedy {index}")
            break
    panel.set_title("stable below the curve", **TITLE)
    top = 1.15 * max(float(boundary.max()), stiffness)
    panel.set(xlim=(0.0, widest), ylim=(0.0, top))
    panel.set(xlabel=f"damping ({result.unit('N s/m')})", ylabel=f"stiffness ({result.unit('N/m')})")
    name_curves(panel)


def _response(panel: Any, result: Diagnosis) -> None:
    """Draw the motion after a displacement, now and with the first remedy."""
    loop = result.loop
    span = _CYCLES / result.frequency if result.frequency else 100.0 * loop.period
    span = min(span, _MOST_SAMPLES * loop.period)
    if result.doubling_time > 0.0 and math.isfinite(result.doubling_time):
        span = min(span, math.log2(_MOST_GROWTH) * result.doubling_time)
    colours = on_white(_colour(result.ratio, loop.target)), SERIES[0]
    first = [loop.replace(**one.change) for one in result.remedies[:1]]
    names = "now", "with remedy 1"
    for changed, colour, name in zip((loop, *first), colours, names):
        time, motion = changed.sampled.response(*changed.gains, span=span)
        panel.plot(1e3 * time, motion, color=colour, label=name)
    panel.set(xlabel="time (ms)", ylabel="position, relative to the first")
    panel.set_title("free response", **TITLE)
    name_curves(panel)


def _colour(ratio: float, target: float) -> Colour:
    """Return the colour of an unstable wall, of a stable one, and of one that reaches the target."""
    return BAD if ratio < 1.0 else GOOD if ratio >= target * (1.0 - 1e-9) else SERIES[4]


def _unbroken(text: str) -> str:
    """Return a text that is wrapped neither inside a unit nor between it and its number."""
    return re.sub(r"(?<=[\dNm]) (?=N|m\b|s/|ms|Hz|kg)", "\u00a0", text)


def _bars(panel: Any, result: Diagnosis, names: Sequence[str]) -> None:
    """Draw the ratio of critical to requested stiffness, now and with each remedy, on a logarithmic axis."""
    loop = result.loop
    present = result.ratio
    ratios = [max(present, 1e-3), *(one.ratio for one in result.remedies[: len(names) - 1])]
    colours = [on_white(_colour(ratio, loop.target), 3.0) for ratio in ratios]
    places = np.arange(len(names))[::-1]
    start, end = 0.5 * min(0.5, *ratios), 2.0 * max(loop.target, *ratios)
    panel.barh(places, np.array(ratios) - start, left=start, color=colours, height=0.6)
    panel.set_xscale("log")
    panel.set_xlim(start * (start / end) ** (_NAMES / (1.0 - _NAMES)), end)
    panel.set_yticks(places, names, fontsize=8.5)
    panel.spines["left"].set_position(("data", start))  # the names are within the axes
    panel.spines["bottom"].set_bounds(start, end)
    wide = end / start > 3000.0 * wide_share() ** 6  # numbers of a narrow chart are few
    every = [first * 10.0**power for power in range(-3, 9) for first in ((1,) if wide else (1, 2, 5))]
    ticks = [tick for tick in every if start <= tick <= end]
    panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.minorticks_off()
    for level, name, side in ((1.0, "stable ", "right"), (loop.target, " target", "left")):
        panel.axvline(level, color=REFERENCE, linewidth=1.0, linestyle=":")
        panel.annotate(name, (level, len(names) - 0.45), fontsize=8.5, ha=side, va="center", color=REFERENCE)
    beside: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 8.5, "bbox": _GROUND}
    for place, ratio in zip(places, ratios):
        end_of_bar = loop.target if ratio < loop.target < 1.7 * ratio else ratio  # beside the line
        panel.annotate(short(ratio), (end_of_bar, place), (4, 0), **beside)
    panel.grid(visible=False, axis="y")
    panel.set(xlabel="critical over requested stiffness", ylim=(-0.6, len(names) - 0.1))
