"""Pictures of runs: of any scene, and of the paper's drops, presses and pulls."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.colours import REFERENCE, STUCK
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.pictures import (
    SHADE,
    TITLE,
    broken,
    draw_limit,
    draw_walls,
    drawn,
    label_rows,
    line_style,
    name_curves,
    new_figure,
    new_grid,
)
from maglev_mj.plants.pictures import moving_axes
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.results import Variants, figure_head, rank_text
from maglev_mj.scenes.stability_check import wall_loops
from maglev_mj.theory import judge, stated_gains

_FINE, _POINTS, _TICK = 1e-4, 2001, 0.05
_MOST_PANELS = 4
_OUTSIDE = 1.25  # ranges of motion, up to which a run outside is drawn


@drawn
def series(variants: Variants) -> Any:
    """Draw each series over time, one line per run.

    Args:
        variants: The runs.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, panels = _series(variants)
    scene = variants.first.scene
    index = AXES.index(scene.axis)
    if len(variants.runs) == 1:  # its name is in the head
        for panel in figure.axes:
            panel.lines[0].set_label(None)
    if (upper := panels.get(_along(scene.axis))) is not None:
        draw_walls(upper, [face[1:] for face in scene.controller().faces if face[0] == index])
        _draw_range(figure, upper, variants)
    name_curves(figure, figure.axes)
    return figure


@drawn
def every_axis(variants: Variants) -> Any:
    """Draw position and force of each axis that moves; of several runs, see `series`.

    Args:
        variants: The runs.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    if len(variants.runs) > 1:
        return series(variants)
    result = variants.first
    time = result.times(_FINE)
    pose, _, wrench = result.trace.at(time)
    figure = moving_axes(_head(variants), time, pose, wrench)
    figure.axes[0].set_xlim(0.0, float(time[-1]))
    return figure


def _along(axis: str) -> str:
    """Return the name of the position on an axis."""
    return f"angle about {axis[-1]}" if axis.startswith("r") else f"position along {axis}"


def _draw_range(figure: Any, panel: Any, variants: Variants) -> None:
    """Mark the range of motion of the scene's axis, and the time outside, if a run leaves it."""
    scene, times = variants.first.scene, list[float]()
    index = AXES.index(scene.axis)
    reach = float(scene.body.range[index])
    for result in variants.runs.values():
        outside = np.abs(result.motion(time := result.times(_FINE))[0]) > reach
        times += [float(time[np.argmax(outside)])] if outside.any() else []
    if not times:
        return
    name = f"range of motion, ±{1e3 * reach:.3g} {unit_of('mm', index)}"
    for side in (-1e3 * reach, 1e3 * reach):
        panel.axhline(side, color=REFERENCE, linestyle="--", linewidth=1.0, label=name if side > 0.0 else None)
    low, high = panel.get_ylim()
    panel.set_ylim(max(low, -_OUTSIDE * 1e3 * reach), min(high, _OUTSIDE * 1e3 * reach))
    name = "outside the range"
    for one in figure.axes:
        one.axvspan(min(times), one.get_xlim()[1], color=REFERENCE, alpha=0.12, linewidth=0.0, zorder=0, label=name)


def _series(variants: Variants) -> tuple[Any, dict[str, Any]]:
    """Return a figure of each series over time, and its panels by label."""
    result = variants.first
    first = result.series(_FINE)
    names = [name for name, values in first.items() if name != "time" and values.dtype.kind in "fiu"][:_MOST_PANELS]
    called = {"position": _along(result.scene.axis), "z": "height"}
    return _over_time(variants, {called.get(name, name): name for name in names}, row=2.2)


def _head(variants: Variants, *details: str) -> tuple[str, ...]:
    """Return headline and conditions, the verdict on a wall that all runs share, and further details."""
    scenes = [result.scene for result in variants.runs.values()] or [variants.first.scene]
    gains = [stated_gains(one.controller()) for one in scenes]
    alike = len(scenes) == 1 or all(one and str(one) == str(gains[0]) for one in gains)
    loops = wall_loops(scenes[0], held=True) if alike else ()
    return variants.headline, variants.conditions, *([f"wall {judge(loops).words}"] if loops else []), *details


def _over_time(variants: Variants, named: Mapping[str, str], **options: Any) -> tuple[Any, dict[str, Any]]:
    """Return a figure of series over time, one line per run, and its panels; in mm and mrad.

    Args:
        variants: The runs.
        named: Names of the series by label.
        options: See `new_grid`.
    """
    runs, first = variants.runs, variants.first
    head = _head(variants, *[f"sampling phase {first.phase:g}"] * first.scene.takes_phase)
    motions = [result.series(_FINE) for result in runs.values()]
    quantities = {}
    for label, name in named.items():
        unit = next(iter(runs.values())).units.get(name, "")
        scale, prefix = (1e3, "m") if unit in ("m", "rad", "m/s", "rad/s") else (1.0, "")
        quantities[label] = [scale * motion[name] for motion in motions], prefix + unit
    figure, panels = new_grid(head, quantities, "time (s)", high=_MOST_PANELS, more=1.0, **options)
    for name, panel in panels.items():
        for index, (label, motion, values) in enumerate(zip(runs, motions, quantities[name][0], strict=True)):
            style = line_style(index) | {"label": label, "zorder": 4.0 - 0.01 * index}
            panel.plot(motion["time"], values, drawstyle="steps-post" if "force" in name else "default", **style)
        if "force" in name:
            draw_limit(panel, first.scene)
    panel.set_xlim(0.0, max(float(motions[0]["time"][-1]), _FINE))
    return figure, panels


@drawn
def first_contact(variants: Variants) -> Any:
    """Draw each series around the first contact with a wall at 0, one line per run.

    Args:
        variants: The runs.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, panels = _series(variants)
    lines = [result.line for result in variants.runs.values()]
    begin = min(float(line.time[np.argmax(line.pose[:, 0] <= 0.0)]) for line in lines)
    start = math.floor(max(begin - 0.01, 0.0) / _TICK) * _TICK
    figure.axes[0].set_xlim(start, begin + 0.15)
    if (upper := panels.get(_along(variants.first.scene.axis))) is not None:
        upper.set_ylabel("height above the wall (mm)")
        _draw_wall(upper)
    name_curves(figure, figure.axes)
    return figure


@drawn
def spread(variants: Variants) -> Any:
    """Draw each figure over the sampling phase, except constant ones.

    Args:
        variants: The runs, with their phases or bands.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        ParameterError: If there are neither phases nor bands, or no figures.
    """
    scene = variants.first.scene
    swept = variants.phases or {label: band.over_phases() for label, band in variants.bands.items()}
    if not swept:
        raise ParameterError("this picture needs sampling phases: see run_phases")
    if not scene.figures:
        raise ParameterError(f"this picture needs figures: {scene.name} has none")
    quantities = {}
    for name, definition in scene.figures.items():
        values = [definition.scale * np.asarray(each.figures[name], dtype=np.float64) for each in swept.values()]
        quantities[figure_head(name)] = values, unit_of(definition.unit, scene.axis, definition.along)
    phases = len(next(iter(swept.values())).phases)
    figure, panels = new_grid(_head(variants, f"{phases} sampling phases"), quantities, "sampling phase")
    for name, panel in panels.items():
        for index, (label, each, values) in enumerate(zip(swept, swept.values(), quantities[name][0])):
            lines = panel.plot(*broken(each.phases, values.reshape(len(each.phases), -1)), **line_style(index))
            lines[0].set_label(label if len(swept) > 1 else None)
        if name == figure_head("peak_force"):
            draw_limit(panel, scene)
        panel.set_xlim(0.0, 1.0)
    name_curves(figure, figure.axes)
    return figure


@drawn
def time_series(variants: Variants) -> Any:
    """Draw position and force over time (figure 3).

    One column for each drop with a pulse, each with the drop without a pulse and the analog wall. Bands are the range
    over the sampling phase.

    Args:
        variants: The drops, with their bands if there are any.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (heights, forces) = _draw_drops(variants, [(_TIME, _HEIGHT), (_TIME, _FORCE)], 6.4)
    for upper, lower in zip(heights, forces, strict=True):
        _draw_wall(upper)
        draw_limit(lower, variants.first.scene)
        lower.set_xlabel("time after release (s)")
    label_rows((heights, "height above the wall (mm)"), (forces, "actuator force (N)"))
    name_curves(figure, figure.axes)
    return figure


@drawn
def phase_plane(variants: Variants) -> Any:
    """Draw velocity over position (figure 4).

    One panel for each drop with a pulse, each with the drop without a pulse and the analog wall. Thin lines are other
    sampling phases.

    Args:
        variants: The drops, with their bands if there are any.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (panels,) = _draw_drops(variants, [(_HEIGHT, _VELOCITY)], 5.0)
    left = min(panels[0].get_xlim()[0], -0.5)
    for panel in panels:
        panel.axvspan(left, 0.0, label="wall", **SHADE)
        panel.set_xlabel("height above the wall (mm)")
    panels[0].set_xlim(left, None)
    label_rows((panels, "velocity (m/s)"))
    name_curves(figure, panels)
    return figure


def _draw_drops(variants: Variants, pairs: Sequence[tuple[int, int]], height: float) -> tuple[Any, list[list[Any]]]:
    """Draw drops and bands, one row for each abscissa and ordinate, and return the rows."""
    time = _times(variants)
    columns = _columns(variants, time)
    head = _head(variants, _lines_of(variants, columns[0][0].style["label"]))
    figure, panels = new_figure(head, len(pairs), len(columns), height - 0.6, sharex=True, sharey="row")
    rows = [panels[first : first + len(columns)] for first in range(0, len(panels), len(columns))]
    analog = _analog(columns[0][0].scene, time)
    for row, (x, y) in zip(rows, pairs, strict=True):
        step = "post" if y == _FORCE else None
        for panel, column in zip(row, columns, strict=True):
            for drop in column:
                pixels = {"color": drop.style["color"], **_AS_PIXELS}
                if drop.band is not None and x == _TIME:
                    low, high = drop.band[y].min(axis=1), drop.band[y].max(axis=1)
                    panel.fill_between(time, low, high, step=step, alpha=0.2, linewidth=0.0, **pixels)
                elif drop.band is not None:
                    panel.plot(drop.band[x], drop.band[y], linewidth=0.5, alpha=0.13, **pixels)
                panel.plot(drop.line[x], drop.line[y], drawstyle="steps-post" if step else "default", **drop.style)
            if analog is not None:
                panel.plot(analog[x], analog[y], **_ANALOG)
            if x == _TIME:
                panel.set_xlim(0.0, time[-1])
    for panel, (drop, *others) in zip(rows[0], columns, strict=True):
        if drop.scene.pulse > 0.0 or not others:  # otherwise the legend is enough
            panel.set_title(drop.style["label"], fontweight="bold", **TITLE)
    return figure, rows


_TIME, _HEIGHT, _VELOCITY, _FORCE = range(4)
_AS_PIXELS = {"rasterized": True}
"""Rasterise the curves of a band, which would take megabytes in an SVG."""

_IDEAL: dict[str, Any] = {"color": REFERENCE, "linestyle": ":", "linewidth": 1.8}
_ANALOG: dict[str, Any] = _IDEAL | {"label": "analog wall, 10 kHz low-pass"}


def _draw_wall(panel: Any) -> None:
    """Shade the wall, from 0 downwards."""
    bottom = min(panel.get_ylim()[0], -0.5)
    panel.axhspan(bottom, 0.0, label="wall", **SHADE)
    panel.set_ylim(bottom, None)


def _times(variants: Variants) -> Array:
    """Return the times to draw [s], up to 1.5 times the longest settling time."""
    end = min(float(result.trace.time[-1]) for result in variants.runs.values())  # of one that diverged
    settling = [result.figures["settling_time"] for result in variants.runs.values()]
    settled = 1.5 * float(np.max(settling))  # NaN if one does not settle
    return np.linspace(0.0, settled if settled < end else end, _POINTS)


_Motion: TypeAlias = tuple[Array, Array, Array, Array]


class _Drop(NamedTuple):
    """Single drop and band over the sampling phase: time [s], z [mm], velocity [m/s], force [N]."""

    scene: Drop
    style: dict[str, Any]
    line: _Motion
    band: _Motion | None


def _columns(variants: Variants, time: Array) -> list[list[_Drop]]:
    """Return the drops of each column, those with a pulse first."""
    pulsed: list[_Drop] = []
    plain: list[_Drop] = []
    for index, (label, result) in enumerate(variants.runs.items()):
        style = line_style(index) | {"label": label, "linewidth": 1.8, "zorder": 4.0 - 0.01 * index}
        band = _in_mm(time, *variants.bands[label].motion(time)) if label in variants.bands else None
        drop = _Drop(result.scene, style, _in_mm(time, *result.motion(time)), band)
        (pulsed if result.scene.pulse > 0.0 else plain).append(drop)
    return [[drop, *plain] for drop in pulsed] or [plain]


def _in_mm(time: Array, z: Array, velocity: Array, force: Array) -> _Motion:
    return time, z * 1e3, velocity, force


def _analog(scene: Drop, time: Array) -> _Motion | None:
    """Return the drop on the analog wall; None without stiffness."""
    return _in_mm(time, *scene.analog(time)) if scene.stiffness else None


def _lines_of(variants: Variants, label: str) -> str:
    """Return the sampling phase of the lines, and the number of those in the band."""
    result, shaded = variants.runs[label], ""
    if (band := variants.bands.get(label)) is not None:
        rank = rank_text(band.figures["penetration"], result.figures["penetration"])
        shaded = f" (depth {rank} of the phases); band: {len(band.phase)} phases"
    return f"lines: sampling phase {result.phase:g}{shaded}"


@drawn
def figure_6(variants: Variants) -> Any:
    """Draw position, the hand's target, and actuator force over time (figure 6).

    Args:
        variants: The presses; the first is drawn in front.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    height = "height above the wall"
    figure, panels = _over_time(variants, {height: "z", "actuator force": "force"}, row=2.6, always=height)
    upper, first = panels[height], variants.first
    _draw_wall(upper)
    top, pulled = upper.get_ylim(), first.series(_FINE)
    label = f"target of the hand, down to {first.scene.resting_point * 1e3:.1f} mm"
    upper.plot(pulled["time"], pulled["target"] * 1e3, color=REFERENCE, linewidth=0.8, label=label)
    upper.set_ylim(top)
    name_curves(figure, figure.axes)
    return figure


@drawn
def stick_slip(variants: Variants) -> Any:
    """Draw position and velocity beside the exact motion (figure 8).

    Args:
        variants: The runs; the first one is drawn.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    result = variants.first
    p, motion = result.scene, result.series(_FINE)
    time, position = motion["time"], f"position along {p.axis}"
    exact, named = p.exact(time), {position: "position", "velocity": "velocity"}
    figure, panels = _over_time(Variants({p.law: result}), named, row=2.6, always=position)
    upper = panels[position]
    anchor = np.where(motion["state"] == "stuck", motion["stick_position"], np.nan)
    upper.plot(time, anchor * 1e3, color=STUCK, linewidth=1.6, linestyle="--", label="stick position")
    upper.plot(time, exact.position * 1e3, label=f"{p.exact_name}, exact", **_IDEAL)
    if "velocity" in panels:
        panels["velocity"].plot(time, exact.velocity * 1e3, **_IDEAL)
    name_curves(figure, [upper])
    return figure
