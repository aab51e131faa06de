"""Picture of a diagnosis: stability region with the remedies, free response, and bars of what each buys."""

from __future__ import annotations

import math
import textwrap
from typing import Any

import numpy as np

from maglev_mj.colours import BAD, GOOD, REFERENCE, SERIES, STOP, on_white
from maglev_mj.pictures import TITLE, name_curves, new_figure
from maglev_mj.studies.diagnosis import Diagnosis, short
from maglev_mj.theory.boundary import boundary_of

_POINTS, _CYCLES, _MOST_SAMPLES, _MOST_GROWTH, _BARS = 160, 8.0, 600, 30.0, 8
_NAMES, _LETTERS = 0.45, 50
"""Share of the bars' width for the names of the remedies, and letters in a line of it."""


def diagnosis(result: Diagnosis) -> Any:
    """Draw a diagnosis.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    loop = result.loop
    (stiffness, damping), where = loop.gains, "" if loop.on_host else " on the device"
    gains = f"{stiffness:g} {result.unit('N/m')}, {damping:g} {result.unit('N s/m')}{where}"
    rate, delay = 1.0 / loop.value("period"), 1e3 * loop.value("delay")
    timing = f"{rate:.4g} Hz, delay {delay:.4g} ms, {loop.body:g} {result.unit('kg')}"
    timing += loop.described if loop.on_host else ""
    figure, (region, response, bars, empty) = new_figure(
        (result.headline, f"{gains}, {timing}", result.summary), 2, 2, 7.0
    )
    _region(region, result)
    _response(response, result)
    empty.set_axis_off()
    grid = bars.get_gridspec()
    bars.set_subplotspec(grid[1, :])
    _bars(bars, result)
    return figure


def _region(panel: Any, result: Diagnosis) -> None:
    """Draw the stability boundary, half of it, the present gains, and the gains of the first remedy."""
    loop, best, (stiffness, damper) = result.loop, result.best, result.loop.gains
    widest = max(2.2 * float(best.damping), 1.3 * damper, 1e-9)
    damping = np.linspace(0.0, widest, _POINTS)
    boundary = boundary_of(loop.sampled, damping)
    panel.plot(damping, boundary, color=STOP, label="stability boundary")
    panel.plot(damping, 0.5 * boundary, color=REFERENCE, linestyle="--", label="half of it")
    colour = on_white(GOOD if result.stable else BAD)
    panel.plot(damper, stiffness, "o", color=colour, markersize=8, label="present gains")
    for index, one in enumerate(result.remedies, 1):
        to = tuple(one.change.get(loop.name(word), loop.value(word)) for word in ("damping", "stiffness"))
        if set(one.change) <= {loop.name("damping"), loop.name("stiffness")}:
            style = {"arrowstyle": "->", "color": on_white(GOOD), "linewidth": 1.6}
            panel.annotate("", to, (damper, stiffness), arrowprops=style)
            panel.plot([], [], color=on_white(GOOD), label=f"remedy {index}")
            break
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
    colours = on_white(GOOD if result.stable else BAD), SERIES[0]
    first = [loop.replace(**one.change) for one in result.remedies[:1]]
    names = "now", "with remedy 1"
    for changed, colour, name in zip((loop, *first), colours, names):
        time, motion = changed.sampled.response(*changed.gains, span=span)
        panel.plot(1e3 * time, motion, color=colour, label=name)
    panel.set(xlabel="time (ms)", ylabel="position, relative to the first")
    panel.set_title("free response", **TITLE)
    name_curves(panel)


def _bars(panel: Any, result: Diagnosis) -> None:
    """Draw the ratio of critical to requested stiffness, now and with each remedy, on a logarithmic axis."""
    loop = result.loop
    present = result.margin.ratio
    shown = result.remedies[:_BARS]
    names = ["now", *(f"{index}  {one.words}" for index, one in enumerate(shown, 1))]
    ratios = [max(present, 1e-3), *(one.ratio for one in shown)]
    colours = [on_white(GOOD if ratio >= 1.0 else BAD, 3.0) for ratio in ratios]
    places = np.arange(len(names))[::-1]
    start, end = 0.5 * min(0.5, *ratios), 2.0 * max(loop.target, *ratios)
    panel.barh(places, np.array(ratios) - start, left=start, color=colours, height=0.6)
    panel.set_xscale("log")
    panel.set_xlim(start * (start / end) ** (_NAMES / (1.0 - _NAMES)), end)
    panel.set_yticks(places, [textwrap.fill(name, _LETTERS) for name in names], fontsize=8.5)
    panel.spines["left"].set_position(("data", start))  # the names are within the axes
    panel.spines["bottom"].set_bounds(start, end)
    ticks = [10.0**power for power in range(-3, 9) if start <= 10.0**power <= end]
    panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.minorticks_off()
    for level, name, side in ((1.0, "stable ", "right"), (loop.target, " target", "left")):
        panel.axvline(level, color=REFERENCE, linewidth=1.0, linestyle=":")
        panel.annotate(name, (level, len(names) - 0.45), fontsize=8.5, ha=side, va="center", color=REFERENCE)
    for place, ratio in zip(places, ratios):
        panel.annotate(short(ratio), (ratio, place), (4, 0), textcoords="offset points", va="center", fontsize=8.5)
    panel.grid(visible=False, axis="y")
    panel.set(xlabel="critical over requested stiffness", ylim=(-0.6, len(names) - 0.1))
