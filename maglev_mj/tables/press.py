"""A wall hit and pressed, as text."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from maglev_mj.experiments.press import PressResult, PressSweep
from maglev_mj.scenes.press_figures import HIT_FIGURES, press_percentiles
from maglev_mj.tables.limits import beyond_force, beyond_range
from maglev_mj.tables.text import cell

__all__ = ["press_table"]

_OF_HITS = {
    "penetration": ("depth", 1e3, "mm"),
    "approach_speed": ("approach", 1e3, "mm/s"),
    "peak_force": ("peak", 1.0, "N"),
    "contact_time": ("contact", 1e3, "ms"),
    "contacts": ("entries", None, ""),
}
_OF_PRESS = (
    ("final_force", "force", 1.0, "N"),
    ("final_depth", "depth", 1e3, "mm"),
    ("force_ripple", "ripple of force", 1e3, "mN"),
    ("ripple", "ripple of depth", 1e6, "µm"),
    ("absorbed", "energy taken", 1e3, "mJ"),
)
_SHARES = (("median", 50.0), ("5 %", 5.0), ("95 %", 95.0))
_HITS_SHOWN = 6
_NAME, _CELL, _ONE, _MANY = 18, 9, 15, 28


def press_table(labels: Sequence[str], results: Sequence[PressResult], sweeps: Sequence[PressSweep], gap: float) -> str:
    """Return the figures of hits and press of one or two runs, and of their sweeps if there are any, as text.

    Args:
        labels: What to call each run.
        results: The runs; the first one's parameters head the table.
        sweeps: A sweep for each run, or nothing.
        gap: Greatest distance between the two plants on the first run [m].
    """
    p = results[0].parameters
    limit = "none" if p.force_limit is None else f"{p.force_limit:g} N"
    lines = [
        f"{p.hits} hits every {p.interval:g} s from {p.height * 1e3:g} mm, then {p.press:g} N, on a wall of "
        f"{p.stiffness:g} N/m and {p.damping:g} N s/m, hand {p.hand}, plant {p.plant}",
        f"  {1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms, mass {p.mass:g} kg, pulse {p.pulse:g} N s/m for "
        f"{p.pulse_width * 1e3:g} ms from {p.pulse_gate * 1e3:g} mm/s on, force limit {limit}",
        "",
        *_hits(labels, results, sweeps),
        "",
        *_press(labels, results, sweeps),
    ]
    remarks = beyond_force(results[0].trace)
    remarks += beyond_range(labels, [one.trace.furthest() for one in results], [one.furthest for one in sweeps])
    return "\n".join([*lines, "", *remarks, f"  MuJoCo and the exact plant differ by at most {gap:.1e} m"])


def _hits(labels: Sequence[str], results: Sequence[PressResult], sweeps: Sequence[PressSweep]) -> list[str]:
    """Return a row for each hit, and one for each percentile over phases and hits together."""
    p, wide, name = results[0].parameters, _CELL * len(_OF_HITS), _NAME - 2
    words, units = ("".join(f"{row[place]:>{_CELL}}" for row in _OF_HITS.values()) for place in (0, 2))
    lines = [
        " " * _NAME + "".join(f"{label:>{wide}}" for label in labels),
        f"  {f'hit, phase {p.phase:g}':<{name}}" + words * len(labels),
        " " * _NAME + (units * len(labels)).rstrip(),
    ]
    for place in range(min(p.hits, _HITS_SHOWN)):
        rows = (_row([figure[place] for figure in result.summary[: len(HIT_FIGURES)]]) for result in results)
        lines.append(f"  {place + 1:<{name}}" + "".join(rows))
    if p.hits > _HITS_SHOWN:
        lines.append(f"  and {p.hits - _HITS_SHOWN} more: see --json")
    if sweeps:
        lines.append(f"  all hits at {sweeps[0].phases.size} phases")
        for word, share in _SHARES:
            pooled = (press_percentiles(sweep.summary, share, pooled=True) for sweep in sweeps)
            lines.append(f"  {word:<{name}}" + "".join(_row(summary) for summary in pooled))
    return lines


def _row(figures: Sequence[ArrayLike]) -> str:
    """Return the figures of hits, one cell each; a count as it is."""
    scales = (scale for _, scale, _ in _OF_HITS.values())
    texts = (f"{value:g}" if scale is None else cell(value, scale) for value, scale in zip(figures, scales))
    return "".join(f"{text:>{_CELL}}" for text in texts)


def _press(labels: Sequence[str], results: Sequence[PressResult], sweeps: Sequence[PressSweep]) -> list[str]:
    """Return a row for each figure of the press, as in the table of a drop."""
    lines = []
    if sweeps:
        over = f"over {sweeps[0].phases.size} phases: median (5 to 95 %)"
        lines.append(" " * (_NAME + _ONE * len(labels)) + f"{over:>{_MANY}}")
    head = "".join(f"{label:>{_ONE}}" for label in labels)
    lines.append(f"  {'press':<{_NAME - 2}}" + head + "".join(f"{label:>{_MANY}}" for label in labels[: len(sweeps)]))
    spreads = [[press_percentiles(sweep.summary, share) for _, share in _SHARES] for sweep in sweeps]
    for name, label, scale, unit in _OF_PRESS:
        cells = "".join(f"{cell(getattr(result.summary, name), scale):>{_ONE}}" for result in results)
        for spread in spreads:
            middle, low, high = (cell(getattr(summary, name), scale) for summary in spread)
            cells += f"{f'{middle} ({low} to {high})':>{_MANY}}"
        lines.append(f"  {label:<{_NAME - 2}}{cells}  {unit}")
    return lines
