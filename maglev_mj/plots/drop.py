"""Pictures of drops: over time, in the phase plane, over the sampling phase."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.experiments.drop import (
    DropParameters,
    DropResult,
    DropSweep,
    analog_drop,
    share_less_deep,
    trace_phases,
)
from maglev_mj.frames import Array
from maglev_mj.metrics import summarise_bounce
from maglev_mj.plots.drawing import FIRST, IDEAL, MANY, SECOND, new_figure, save
from maglev_mj.spec import Spec
from maglev_mj.trace import Trace

__all__ = ["phase_plane", "phases", "time_series"]

_PHASES = 100
_POINTS = 2001
_WALL = "#f1efe9"


@dataclass(frozen=True, eq=False)
class _Drop:
    """A drop and the same at N phases, over times (M,): z [mm], velocity [m/s] and force [N]."""

    parameters: DropParameters
    style: dict[str, Any]
    line: tuple[Array, Array, Array]
    band: tuple[Array, Array, Array]
    less_deep: float
    """Share of the phases with less penetration than the line."""


def time_series(runs: Iterable[tuple[str, DropResult]], path: Path) -> Path:
    """Draw position and force over time, as figure 3 does.

    One column for each drop with a pulse; a drop without one and the analog wall stand in all of them. A band
    holds the drop at every phase of the sampler.

    Args:
        runs: Label and result of each drop.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
        DivergenceError: If a flotor leaves its range by a wide margin at one of the phases.
    """
    shown = list(runs)
    time = _times(shown)
    columns = _columns(shown, time)
    figure, panels = new_figure(2, len(columns), (8.0, 6.2), sharex=True, sharey="row")
    heights, forces = panels[: len(columns)], panels[len(columns) :]
    analog = _analog(columns[0][0].parameters, time)
    for row, part, step in ((heights, 0, None), (forces, 2, "post")):
        for panel, column in zip(row, columns, strict=True):
            for drop in column:
                low, high = drop.band[part].min(axis=1), drop.band[part].max(axis=1)
                panel.fill_between(time, low, high, step=step, color=drop.style["color"], alpha=0.2, linewidth=0.0)
                panel.plot(time, drop.line[part], drawstyle="steps-post" if step else "default", **drop.style)
            if analog is not None:
                panel.plot(time, analog[part], **_ANALOG)
    bottom = min(heights[0].get_ylim()[0], -0.5)
    for upper, lower in zip(heights, forces, strict=True):
        upper.axhspan(bottom, 0.0, color=_WALL, zorder=0)
        lower.axhline(Spec.largest_vertical_force.value, **_LIMIT)
        lower.set_xlabel("time after release (s)")
    heights[0].set(ylim=(bottom, None), xlim=(0.0, time[-1]), ylabel="height above the wall (mm)")
    forces[0].set_ylabel("force on the flotor (N)")
    _explain(figure, heights, forces, columns)
    return save(figure, path)


def phase_plane(runs: Iterable[tuple[str, DropResult]], path: Path) -> Path:
    """Draw velocity over position beside the ideal analog wall, as figure 4 does.

    One panel for each drop with a pulse; a drop without one and the analog wall stand in all of them. Thin lines
    are the drop at other phases of the sampler.

    Args:
        runs: Label and result of each drop.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
        DivergenceError: If a flotor leaves its range by a wide margin at one of the phases.
    """
    shown = list(runs)
    time = _times(shown)
    columns = _columns(shown, time)
    figure, panels = new_figure(1, len(columns), (8.0, 5.0), sharex=True, sharey=True)
    analog = _analog(columns[0][0].parameters, time)
    for panel, column in zip(panels, columns, strict=True):
        for drop in column:
            z, velocity, _ = drop.band
            panel.plot(z, velocity, color=drop.style["color"], linewidth=0.5, alpha=0.13)
            panel.plot(*drop.line[:2], **drop.style)
        if analog is not None:
            panel.plot(*analog[:2], **_ANALOG)
        panel.set_xlabel("height above the wall (mm)")
    left = min(panels[0].get_xlim()[0], -0.5)
    for panel in panels:
        panel.axvspan(left, 0.0, color=_WALL, zorder=0)
    panels[0].set(xlim=(left, None), ylabel="velocity (m/s)")
    _explain(figure, panels, panels, columns)
    return save(figure, path)


def phases(sweeps: Iterable[tuple[str, DropSweep]], path: Path) -> Path:
    """Draw penetration, rebound and peak force over the phase of the sampler.

    Args:
        sweeps: Label and sweep of each variant.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = new_figure(1, 3, (10.0, 4.0), sharex=True)
    shown = list(sweeps)
    for place, (label, sweep) in enumerate(shown):
        figures = (sweep.summary.penetration * 1e3, sweep.summary.rebound * 1e3, sweep.summary.peak_force)
        style = _style(place, label, pulsed=sweep.parameters.pulse > 0.0)
        for panel, values in zip(panels, figures, strict=True):
            panel.plot(sweep.phases, values, **style)
    for panel, name in zip(panels, ("penetration (mm)", "rebound (mm)", "peak force (N)"), strict=True):
        panel.set_title(name, loc="left", fontsize=10.5)
        panel.set_ylim(bottom=0.0)
        panel.set_xlim(0.0, 1.0)
        panel.set_xlabel("phase of the first sample (periods)")
    panels[2].axhline(Spec.largest_vertical_force.value, **_LIMIT)
    handles, _ = panels[2].get_legend_handles_labels()
    figure.legend(handles=handles, frameon=False, loc="outside lower center", ncols=len(handles))
    return save(figure, path)


_ANALOG: dict[str, Any] = {"color": IDEAL, "linestyle": ":", "linewidth": 1.8, "label": "analog wall, 10 kHz filter"}
_LIMIT: dict[str, Any] = {
    "color": "black",
    "linestyle": (0, (6, 3)),
    "linewidth": 1.0,
    "label": f"{Spec.largest_vertical_force.value:g} N, the device's largest",
}


def _style(place: int, label: str, *, pulsed: bool) -> dict[str, Any]:
    """Return the line of a drop, of one colour in every picture."""
    color = (FIRST, MANY[2])[place % 2] if pulsed else SECOND
    dashes, front = ("-", 4) if pulsed else ("--", 3)
    return {"color": color, "linestyle": dashes, "linewidth": 1.8, "zorder": front, "label": label}


def _times(runs: Sequence[tuple[str, DropResult]]) -> Array:
    """Return the times to draw [s]: until all drops have settled, and half as long again."""
    end = runs[0][1].parameters.duration
    settled = 1.5 * float(np.max([result.summary.settling_time for _, result in runs]))  # NaN if one never does
    return np.linspace(0.0, settled if settled < end else end, _POINTS)


def _columns(runs: Sequence[tuple[str, DropResult]], time: Array) -> list[list[_Drop]]:
    """Return the drops of each column, the one with a pulse first."""
    pulsed: list[_Drop] = []
    plain: list[_Drop] = []
    for place, (label, result) in enumerate(runs):
        p = result.parameters
        band = trace_phases(replace(p, duration=float(time[-1])), _PHASES)
        less_deep = share_less_deep(result.summary, summarise_bounce(band, p.rest))
        style = _style(place, label, pulsed=p.pulse > 0.0)
        drop = _Drop(p, style, _along_z(result.trace, time), _along_z(band, time), less_deep)
        (pulsed if p.pulse > 0.0 else plain).append(drop)
    return [[drop, *plain] for drop in pulsed] or [plain]


def _along_z(trace: Trace, time: Array) -> tuple[Array, Array, Array]:
    pose, twist, wrench = (part[..., 0] for part in trace.along(2).at(time))
    return pose * 1e3, twist, wrench


def _analog(parameters: DropParameters, time: Array) -> tuple[Array, Array, Array] | None:
    """Return the drop on the analog wall; None for a wall without stiffness."""
    if parameters.stiffness == 0.0:
        return None
    z, velocity, force = analog_drop(parameters, time)
    return z * 1e3, velocity, force


def _explain(figure: Any, tops: Sequence[Any], bottoms: Sequence[Any], columns: Sequence[Sequence[_Drop]]) -> None:
    """Add the legend and the titles, which name the phase of the lines."""
    for panel, (drop, *_) in zip(tops, columns, strict=True):
        total = f"{drop.parameters.damping + drop.parameters.pulse:g} N s/m"
        panel.set_title(f"{drop.style['label']}: {total}", loc="left", fontsize=10.5, fontweight="bold")
    entries = zip(*(zip(*panel.get_legend_handles_labels(), strict=True) for panel in bottoms), strict=True)
    handles = {label: handle for row in entries for handle, label in row}
    figure.legend(handles=handles.values(), frameon=False, loc="outside lower center", ncols=3, fontsize=9.5)
    drop = columns[0][0]
    p = drop.parameters
    limit = "" if p.force_limit is None else f", limit {p.force_limit:g} N"
    figure.suptitle(
        f"{p.height * 1e3:g} mm drop, {p.stiffness:g} N/m and {p.damping:g} N s/m, {1.0 / p.period:g} Hz, "
        f"delay {p.delay * 1e3:g} ms{limit} ({p.plant})\n"
        f"lines: phase {p.phase:g}, deeper than {100.0 * drop.less_deep:.0f} % of the phases; "
        f"shaded: all of {_PHASES} phases",
        x=0.01,
        ha="left",
        fontsize=10,
    )
