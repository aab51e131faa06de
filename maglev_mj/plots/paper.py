"""Charts of the paper's experiments: drops, presses, stick-slip pulls."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.colours import REFERENCE, SERIES, STUCK
from maglev_mj.frames import Array, unit_of
from maglev_mj.laws import Wall
from maglev_mj.plots.drawing import FIRST, SECOND, SHADE, TITLE, name_curves, new_figure, save
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import Phases, RunResult, run, run_phases
from maglev_mj.spec import Spec

_PHASES = np.arange(100) / 100
_SWEPT = 50
_POINTS = 2001


@dataclass(frozen=True, eq=False)
class _Drop:
    """A drop at one phase and at N phases.

    Over times (M,): z [mm], velocity [m/s] and force [N].
    """

    result: RunResult
    style: dict[str, Any]
    line: tuple[Array, Array, Array]
    band: tuple[Array, Array, Array]
    less_deep: float
    """Share of the phases with less penetration than the line."""


def time_series(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], path: Path | None = None) -> Any:
    """Draw position and force over time, as figure 3 does.

    One column for each drop with a pulse; a drop without one and the analog wall stand in all of them. A band
    holds the drop at every phase of the sampler.

    Args:
        results: Drops by label.
        sweeps: The same at many phases, those of the band; 100 without any.
        path: File to write; None to return the figure.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        DivergenceError: If a flotor leaves its range by a wide margin at one of the phases.
    """
    time = _times(results)
    columns = _columns(results, sweeps, time)
    figure, panels = new_figure(2, len(columns), 6.4, sharex=True, sharey="row")
    heights, forces = panels[: len(columns)], panels[len(columns) :]
    analog = _analog(columns[0][0].result.scene, time)
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
        upper.axhspan(bottom, 0.0, **SHADE)
        lower.axhline(Spec.largest_vertical_force.value, **_LIMIT)
        lower.set_xlabel("time after release (s)")
    heights[0].set(ylim=(bottom, None), xlim=(0.0, time[-1]), ylabel="height above the wall (mm)")
    forces[0].set_ylabel("force on the flotor (N)")
    _explain(figure, heights, columns)
    name_curves(figure, forces)
    return save(figure, path)


def phase_plane(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], path: Path | None = None) -> Any:
    """Draw velocity over position beside the analog wall (figure 4).

    One panel for each drop with a pulse; a drop without one and the analog wall stand in all of them. Thin lines
    are the drop at other phases of the sampler.

    Args:
        results: Drops by label.
        sweeps: The same at many phases, those of the band; 100 without any.
        path: File to write; None to return the figure.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        DivergenceError: If a flotor leaves its range by a wide margin at one of the phases.
    """
    time = _times(results)
    columns = _columns(results, sweeps, time)
    figure, panels = new_figure(1, len(columns), 5.0, sharex=True, sharey=True)
    analog = _analog(columns[0][0].result.scene, time)
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
        panel.axvspan(left, 0.0, **SHADE)
    panels[0].set(xlim=(left, None), ylabel="velocity (m/s)")
    _explain(figure, panels, columns)
    name_curves(figure, panels)
    return save(figure, path)


def phases(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], path: Path | None = None) -> Any:
    """Draw penetration, rebound and peak force over the phase.

    Args:
        results: Drops by label.
        sweeps: The same at many phases; without any they are run at 50 on the exact plant.
        path: File to write; None to return the figure.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        DivergenceError: If a flotor leaves its range by a wide margin at one of the phases.
    """
    figure, panels = new_figure(1, 3, 3.6, sharex=True)
    shown = sweeps or {label: run_phases(one.scene, _SWEPT, plant="exact") for label, one in results.items()}
    styles = _styles({label: sweep.scene for label, sweep in shown.items()})
    for label, sweep in shown.items():
        style = styles[label]
        for panel, name in zip(panels, ("penetration", "rebound", "peak_force"), strict=True):
            panel.plot(sweep.phases, sweep.figures[name] * sweep.scene.figures[name].scale, **style)
    for panel, name in zip(panels, ("penetration (mm)", "rebound (mm)", "peak force (N)"), strict=True):
        panel.set_title(name, **TITLE)
        panel.set_ylim(bottom=0.0)
        panel.set_xlim(0.0, 1.0)
        panel.set_xlabel("phase of the first sample\n(periods)")
    panels[2].axhline(Spec.largest_vertical_force.value, **_LIMIT)
    name_curves(figure, panels[2:])
    return save(figure, path)


_PULSED = FIRST, *SERIES[2:4]
_PLAIN = SECOND, *SERIES[4:]
_DASHES = "--", "-.", (0, (7, 2)), (0, (4, 1, 1, 1, 1, 1))
_IDEAL: dict[str, Any] = {"color": REFERENCE, "linestyle": ":", "linewidth": 1.8}
_ANALOG: dict[str, Any] = _IDEAL | {"label": "analog wall, 10 kHz filter"}
_LIMIT: dict[str, Any] = {
    "color": "black",
    "linestyle": (0, (6, 3)),
    "linewidth": 1.0,
    "label": f"{Spec.largest_vertical_force.value:g} N, the device's largest",
}


def _published(scene: Drop) -> tuple[float, float, float] | None:
    """Return stiffness, damping and pulse of the published wall; None for another law."""
    for law in scene.laws():
        if isinstance(law, Wall) and not any(map(np.ndim, gains := (law.stiffness, law.damping, law.pulse))):
            stiffness, damping, pulse = np.array(gains, dtype=np.float64).tolist()
            return stiffness, damping, pulse
    return None


def _styles(scenes: Mapping[str, Drop]) -> dict[str, dict[str, Any]]:
    """Return the line style of each drop by label, those without a pulse dashed."""
    styles, counts = {}, Counter[bool]()
    for label, scene in scenes.items():
        pulsed = (_published(scene) or (0.0,))[-1] > 0.0
        colours, dashes = (_PULSED, ("-",)) if pulsed else (_PLAIN, _DASHES)
        place, counts[pulsed] = counts[pulsed], counts[pulsed] + 1
        line = {"color": colours[place % len(colours)], "linestyle": dashes[place % len(dashes)], "linewidth": 1.8}
        styles[label] = line | {"zorder": 4 if pulsed else 3, "label": label}
    return styles


def _times(results: Mapping[str, RunResult]) -> Array:
    """Return the times to draw [s].

    Until all drops have settled, and half as long again.
    """
    end = next(iter(results.values())).scene.end
    settled = 1.5 * float(np.max([one.figures["settling_time"] for one in results.values()]))  # NaN if one never does
    return np.linspace(0.0, settled if settled < end else end, _POINTS)


def _columns(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], time: Array) -> list[list[_Drop]]:
    """Return the drops of each column, pulsed ones first."""
    pulsed: list[_Drop] = []
    plain: list[_Drop] = []
    styles = _styles({label: result.scene for label, result in results.items()})
    for label, result in results.items():
        scene: Drop = result.scene
        phases = sweeps[label].phases if label in sweeps else _PHASES
        band = run(scene.replace(duration=float(time[-1])), plant="exact", phase=phases)
        less_deep = scene.less_deep(result.figures["penetration"], band.figures["penetration"])
        drop = _Drop(result, styles[label], _shown(result, time), _shown(band, time), less_deep)
        (pulsed if styles[label]["linestyle"] == "-" else plain).append(drop)
    return [[drop, *plain] for drop in pulsed] or [plain]


def _shown(result: RunResult, time: Array) -> tuple[Array, Array, Array]:
    z, velocity, force = result.motion(time)
    return z * 1e3, velocity, force


def _analog(scene: Drop, time: Array) -> tuple[Array, Array, Array] | None:
    """Return the drop on the analog wall.

    None for a wall without stiffness.
    """
    if scene.stiffness == 0.0:
        return None
    z, velocity, force = scene.analog(time)
    return z * 1e3, velocity, force


def _explain(figure: Any, tops: Sequence[Any], columns: Sequence[Sequence[_Drop]]) -> None:
    """Add the titles, which name the phase of the lines."""
    for panel, (drop, *others) in zip(tops, columns, strict=True):
        wall = _published(drop.result.scene)
        if wall is not None and (wall[2] > 0.0 or not others):  # else the legend names them all
            panel.set_title(f"{drop.style['label']}: {wall[1] + wall[2]:g} N s/m", fontweight="bold", **TITLE)
    drop = columns[0][0]
    p, result = drop.result.scene, drop.result
    walls = {(_published(one.result.scene) or ())[:2] for column in columns for one in column}
    common = walls.pop() if len(walls) == 1 else ()
    gains = "{:g} N/m and {:g} N s/m, ".format(*common) if common else ""
    limit = "" if p.force_limit is None else f", limit {p.force_limit:g} N"
    figure.suptitle(
        f"{p.height * 1e3:g} mm drop, {gains}{1.0 / p.period:g} Hz, "
        f"delay {p.delay * 1e3:g} ms{limit} ({result.plant})\n"
        f"lines: phase {result.phase:g}, deeper than {100.0 * drop.less_deep:.0f} % of the phases; "
        f"shaded: all of {drop.band[0].shape[1]} phases",
        x=0.01,
        ha="left",
        fontsize=10,
    )


def _describe(result: RunResult) -> str:
    p = result.scene
    limit = "" if p.force_limit is None else f", limit {p.force_limit:g} N"
    return (
        f"hand {p.hand}, {p.press:g} N in the end\nwall of {p.stiffness:g} N/m and {p.damping:g} N s/m, "
        f"{1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms{limit} ({result.plant})"
    )


def figure_6(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], path: Path | None = None) -> Any:
    """Draw position and control force over time (figure 6).

    The hand's target is drawn too.

    Args:
        results: Runs by label; the first is drawn in front.
        sweeps: Not drawn.
        path: File to write; None to return the figure.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (upper, lower) = new_figure(2, 1, 6.4, sharex=True)
    first = next(iter(results.values()))
    styles = _styles({label: result.scene for label, result in results.items()})
    for label, result in results.items():
        series, style = result.series(1e-4), styles[label] | {"linewidth": 1.4}
        upper.plot(series["time"], series["z"] * 1e3, **style)
        lower.step(series["time"], series["force"], where="post", **style)
    bottom, top = upper.get_ylim()
    bottom = min(bottom, -0.5)
    p, pulled = first.scene, first.series(1e-4)
    upper.plot(
        pulled["time"],
        pulled["target"] * 1e3,
        color=REFERENCE,
        linewidth=0.8,
        label=f"where the hand pulls to, down to {p.resting_point * 1e3:.1f} mm",
    )
    upper.axhspan(bottom, 0.0, **SHADE)
    upper.set_ylim(bottom, top)
    upper.text(0.008, 0.02, "wall", transform=upper.transAxes, color=REFERENCE, fontsize=9.0)
    upper.set_ylabel("height above the wall (mm)")
    lower.set_ylabel("control force (N)")
    lower.set_xlabel("time (s)")
    lower.set_xlim(0.0, p.end)
    name_curves(figure, [upper])
    upper.set_title(_describe(first), **TITLE)
    return save(figure, path)


def stick_slip(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], path: Path | None = None) -> Any:
    """Draw position and velocity against exact friction (figure 8).

    Args:
        results: Runs by label, the first of which is drawn.
        sweeps: Not drawn.
        path: File to write; None to return the figure.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (upper, lower) = new_figure(2, 1, 6.4, sharex=True)
    result = next(iter(results.values()))
    p, series = result.scene, result.series(1e-4)
    time, length = series["time"], unit_of("mm", p.axis)
    exact = p.exact(time)
    upper.plot(time, series["position"] * 1e3, color=FIRST, linewidth=1.7, label=f"{p.law}, {1.0 / p.period:g} Hz")
    anchor = np.where(series["state"] == "stuck", series["stick_position"], np.nan)
    upper.plot(time, anchor * 1e3, color=STUCK, linewidth=1.6, linestyle="--", label="stick position")
    upper.plot(time, exact.position * 1e3, label=f"{p.exact_name}, exact", **_IDEAL)
    lower.plot(time, series["velocity"] * 1e3, color=FIRST, linewidth=1.5)
    lower.plot(time, exact.velocity * 1e3, **_IDEAL)
    upper.set_ylabel(f"position along {p.axis} ({length})")
    lower.set_ylabel(f"velocity ({length}/s)")
    lower.set_xlabel("time (s)")
    lower.set_xlim(0.0, max(float(time[-1]), 1e-3))
    name_curves(figure, [upper])
    upper.set_title(
        f"spring {p.spring:.4g}, breakaway {p.breakaway:.4g}, stiffness {p.stiffness:.4g}, damping {p.damping:.4g} "
        f"(SI), delay {p.delay * 1e3:g} ms ({result.plant})",
        **TITLE,
    )
    return save(figure, path)
