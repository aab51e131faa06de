"""Charts of studies: sweeps, maps over gains, drops, wall margins, model levels."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from maglev_mj.colours import BAD, GOOD, GRID, REFERENCE, SERIES, STOP, on_white
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.pictures import (
    FIRST,
    SECOND,
    TITLE,
    Quantities,
    axis_label,
    draw_limit,
    drawn,
    line_style,
    name_curves,
    new_figure,
    new_grid,
    wide_share,
)
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.results import figure_head, prefixed
from maglev_mj.studies.card import DeviceCard
from maglev_mj.studies.compare import LawSweep
from maglev_mj.studies.designed_wall import DesignResult
from maglev_mj.studies.drop_map import DropMap
from maglev_mj.studies.fidelity import MARGIN, FidelityResult
from maglev_mj.studies.stability_map import StabilityMap, StabilityParameters
from maglev_mj.studies.sweep import Sweep, chosen_text

_STAR: dict[str, Any] = {
    "color": SECOND,
    "marker": "*",
    "markersize": 15,
    "linestyle": "none",
    "clip_on": False,
    "zorder": 5,
}
_DECADES = [10.0**power for power in range(-6, 0)]
_SHADES = ["#f7fcf0", "#e0f3db", "#ccebc5", "#a8ddb5", "#7bccc4", "#43a2ca", "#0868ac"]
_UNSTABLE = "#fbe3da"
_FEW = 8  # values of a heat map, whose cells are set apart
_LETTERS = 80  # of tick labels that fit across a chart
_LEVELS = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0])


def _gain_labels(p: StabilityParameters) -> dict[str, str]:
    return {"xlabel": f"damping ({p.unit('N s/m')})", "ylabel": f"stiffness ({p.unit('N/m')})"}


def level_sets(panel: Any, x: Array, y: Array, spectral_radius: Array) -> None:
    """Draw level sets of the spectral radius that have room for a number, the boundary bold.

    Args:
        panel: matplotlib axes.
        x: Values along the abscissa, (B,).
        y: Values along the ordinate, (K,).
        spectral_radius: (K, B).
    """
    sets = panel.contour(x, y, spectral_radius, levels=_LEVELS[:-1])
    extents = np.ptp(x), np.ptp(y)
    wide = [level for level, segments in zip(sets.levels, sets.allsegs) if _room(segments, extents)]
    sets.remove()
    floor = min(wide, default=1.0) - 0.1  # all below it has one shade
    shown = np.maximum(spectral_radius, floor + 0.05)
    panel.contourf(x, y, shown, levels=[floor, *wide, 1.0], cmap="GnBu_r", vmin=0.2, vmax=1.1)
    panel.set_facecolor(_UNSTABLE)
    panel.grid(visible=False)
    if wide:
        lines = panel.contour(x, y, spectral_radius, levels=wide, colors=[REFERENCE], linewidths=0.7)
        panel.clabel(lines, fmt="%g", fontsize=8)
    panel.contour(x, y, spectral_radius, levels=[1.0], colors=[FIRST], linewidths=2.2)
    panel.plot([], [], color=REFERENCE, linewidth=0.7, label="contours: spectral radius")
    panel.plot([], [], color=FIRST, linewidth=2.2, label="stability boundary (spectral radius 1)")
    panel.plot([], [], "s", color=_UNSTABLE, markersize=9, label="unstable")


def _room(segments: Any, extents: tuple[float, float]) -> bool:
    """Return True if a number fits into a level set."""
    return any(len(points) > 1 and (np.ptp(points, axis=0) > 0.15 * np.array(extents)).all() for points in segments)


@drawn
def stability_map(result: StabilityMap) -> Any:
    """Draw the stability map.

    Level sets by theory, simulated verdicts as dots, the stiffest wall marked.

    Args:
        result: The map; its grid must have at least two values on each axis.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    p = result.parameters
    figure, (panel,) = new_figure((result.headline, result.conditions), 1, 1, 5.6)
    x, y, spectral_radius = result.level_sets()
    level_sets(panel, x, y, spectral_radius)
    above: dict[str, tuple[Array, Any]] = {}  # their boundary
    if p.own_damping and p.direct:
        above["passive"] = result.passive_damping(x, y) - p.own_damping, {"colors": [REFERENCE], "linestyles": ["--"]}
    if p.quantum:
        above["quiet"] = y[:, None] - result.quiet_stiffness(x), {"colors": [SECOND], "linestyles": ["-."]}
    for name, (height, style) in above.items():
        if height.min() < 0.0 < height.max():
            panel.contour(x, y, height, levels=[0.0], linewidths=1.8, **style)
            drawn = {"color": style["colors"][0], "linestyle": style["linestyles"][0]}
            panel.plot([], [], linewidth=1.8, label=f"{name} below this line", **drawn)
    used = Drop()

    def is_shown(gains: Any) -> bool:
        return bool(x[0] <= gains.damping <= x[-1] and y[0] <= gains.stiffness <= y[-1])

    if is_shown(used) and not p.rotary:
        name = f"scene drop: {used.stiffness:g} N/m, {used.damping:g} N s/m"
        panel.plot(used.damping, used.stiffness, "D", color=FIRST, markeredgecolor="white", markersize=9, label=name)
    best = result.maximum
    if is_shown(best):
        panel.plot(best.damping, best.stiffness, label="stiffest stable wall (theory)", **_STAR)
    if result.simulated is not None:
        k, b = np.meshgrid(result.stiffness, result.damping, indexing="ij")
        settles = result.simulated
        size = max(60.0 / max(len(result.stiffness), len(result.damping)), 0.6) * 1.6
        panel.plot(b[settles], k[settles], ".", color=STOP, markersize=size, label=f"stable in simulation ({p.plant})")
        if result.disagreement is not None and result.disagreement.any():
            wrong = result.disagreement
            panel.plot(b[wrong], k[wrong], "x", color=SECOND, label="simulation and theory differ")
    (low, high), (soft, stiff) = ((axis.min(), axis.max()) for axis in (result.damping, result.stiffness))
    panel.set(**_gain_labels(p), xlim=(low, high), ylim=(soft, stiff))
    name_curves(figure, [panel])
    return figure


@drawn
def drop_map(result: DropMap) -> Any:
    """Draw the final swing of drops over the gains.

    With theory's boundary, and that of the drops that settle.

    Args:
        result: The map; its grid must have at least two values on each axis.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, panels = new_figure((result.headline, result.conditions), 1, 1, 5.3)
    drop_panels(figure, panels, [result])
    return figure


def drop_panels(figure: Any, panels: Sequence[Any], results: Sequence[DropMap]) -> None:
    """Draw several drop maps with one scale and legend.

    Args:
        figure: matplotlib figure.
        panels: Its panels, as many as maps.
        results: The maps.
    """
    from matplotlib.colors import BoundaryNorm, ListedColormap

    shades = ListedColormap(_SHADES)
    norm = BoundaryNorm(_DECADES, len(_SHADES), extend="both")
    for panel, result in zip(panels, results, strict=True):
        x, y = result.damping, result.stiffness
        panel.grid(visible=False)
        edges = (*_outer(x), *_outer(y))
        swing = np.maximum(result.swing, 1e-12)
        image = panel.imshow(
            swing, extent=edges, origin="lower", aspect="auto", cmap=shades, norm=norm, interpolation="nearest"
        )
        panel.contour(x, y, result.settles, levels=[0.5], colors=[STOP], linewidths=0.9)
        panel.plot([], [], color=STOP, linewidth=0.9, label="settling boundary (simulation)")
        panel.plot(x, result.boundary, color=SECOND, linewidth=2.0, label="stability boundary (theory)")
        panel.set(**_gain_labels(result.parameters), xlim=edges[:2], ylim=edges[2:])
    bar = figure.colorbar(image, ax=list(panels), ticks=_DECADES, aspect=40, pad=0.02, fraction=0.04)
    bar.ax.set_yticklabels(["1 µm", "10 µm", "0.1 mm", "1 mm", "10 mm", "0.1 m"])
    bar.ax.tick_params(labelsize=9.0)
    bar.set_label("peak-to-peak motion,\nlast 100 of 400 samples", fontsize=9.0)
    name_curves(figure, panels)


def _outer(values: Array) -> tuple[float, float]:
    """Return the outer edges of cells around increasing values."""
    half = 0.5 * (values[1] - values[0])
    return float(values[0] - half), float(values[-1] + half)


@drawn
def design_map(result: DesignResult) -> Any:
    """Draw the spectral radius over mass and delay.

    The worst of the hands, with the worst case marked.

    Level sets where both have a range, a curve where one has.

    Args:
        result: The design.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        ParameterError: If neither mass nor delay has a range.
    """
    from matplotlib.ticker import MaxNLocator

    wall = result.wall
    needs, worst = wall.requirements, wall.worst
    sizes = result.masses.size, result.delays.size
    if sizes == (1, 1):
        raise ParameterError("mass or delay must be a range to draw a chart")
    figure, (panel,) = new_figure((result.headline, result.conditions), 1, 1, 5.3)
    marked = f"worst case: {wall.spectral_radius:.4g}, hand {needs.hand_of(worst)}"
    body = f"{result.body_name} ({needs.unit('kg')})"
    if min(sizes) > 1:
        low, high = float(result.map.min()), float(result.map.max())
        inner = [level for level in MaxNLocator(8).tick_values(low, high) if low < level < high]
        levels = [low, *inner, high]
        panel.contourf(
            result.delays * 1e3, result.masses, result.map, levels=levels, cmap="GnBu", vmax=2.0 * high - low
        )
        lines = panel.contour(result.delays * 1e3, result.masses, result.map, levels=inner, colors=[REFERENCE])
        panel.plot([], [], color=REFERENCE, label="contours: spectral radius")
        panel.clabel(lines, fmt="%g", fontsize=8.5)
        panel.plot(worst.delay * 1e3, worst.inertia, label=marked, **_STAR)
        panel.set(xlabel="delay (ms)", ylabel=body)
    else:
        along_mass = sizes[0] > 1
        x = result.masses if along_mass else result.delays * 1e3
        panel.plot(x, result.map.ravel(), color=FIRST, linewidth=2.0)
        at = worst.inertia if along_mass else worst.delay * 1e3
        panel.plot(at, wall.spectral_radius, label=marked, **_STAR)
        panel.axhline(needs.spectral_radius, color=REFERENCE, linestyle=":", label=f"limit: {needs.spectral_radius:g}")
        panel.set(xlabel=body if along_mass else "delay (ms)", ylabel="spectral radius")
    name_curves(figure, [panel])
    return figure


@drawn
def sweep(result: Sweep) -> Any:
    """Draw each figure over the first varied parameter, but for those that are flat.

    Each combination of the others is a line; two parameters of four or more even values each make heat maps.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        ParameterError: If there is no figure of one number a cell.
    """
    figures = {name: result.shown(name) for name in result.names if result.is_number(name)}
    found = {
        figure_head(name): (one.scale * result.figure(name), result.unit_along(one.unit, one.along))
        for name, one in figures.items()
    }
    failed = len(result.results.failed)
    words = {
        figure_head(name): result.ended if np.isnan(result.figure(name)).sum() == failed else one.missing
        for name, one in figures.items()
    }
    if not found:
        raise ParameterError(f"figures must include a scalar to draw a chart: {result.scene.name} has none")
    several = {name: values for name, values in result.varied.items() if len(values) > 1}
    varied: dict[str, Sequence[Any]] = {**(several or result.varied)}
    units_of = dict(result.units)
    for name, values in [*varied.items()]:
        if all(map(_is_number, values)):
            factor, units_of[name] = prefixed(units_of.get(name, ""), max(map(abs, values)))
            varied[name] = [factor * value for value in values] if factor != 1.0 else values
    (first, along), *others = varied.items()
    label = axis_label(first, units_of.get(first))
    if len(others) == 1 and _even(along) and _even(others[0][1]):
        return _heat_maps(result, varied, units_of, found, words)
    lines = list(itertools.product(*(values for _, values in others)))
    units = [units_of.get(name, "") for name, _ in others]
    numbers = all(map(_is_number, along))
    figure, panels = new_grid((result.headline, result.conditions, *result.reasons), found, label, more=0.9)
    for name, panel in panels.items():
        for index, column in enumerate(found[name][0].reshape(len(along), -1).T):
            style = line_style(index) | ({} if numbers else {"linestyle": "none"})
            named = ", ".join(map(chosen_text, dict(others), lines[index], units))
            panel.plot(along if numbers else range(len(along)), column, marker="o", label=named or None, **style)
        if numbers:  # also those of cells without a value
            panel.update_datalim([(value, 0.0) for value in along], updatey=False)
        empty = [np.isnan(row).all() for row in found[name][0].reshape(len(along), -1)]
        for x in (value if numbers else index for index, value in enumerate(along) if empty[index]):
            where = panel.get_xaxis_transform()
            panel.text(x, 0.03, words[name], transform=where, rotation=90, ha="center", color=REFERENCE, fontsize=9.0)
        if name == figure_head("peak_force"):
            draw_limit(panel, result.cells.scene)
        if not numbers:
            panel.update_datalim([(0.0, 0.0)], updatex=False)
            crowded = len("  ".join(map(str, along))) * panel.get_gridspec().ncols > _LETTERS
            panel.set_xticks(range(len(along)), map(str, along), rotation=90 if crowded else 0)
            panel.margins(x=0.15)
            panel.locator_params(axis="y", integer=bool(np.all(found[name][0] % 1.0 == 0.0)))
    name_curves(figure, figure.axes)
    return figure


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _even(values: Sequence[Any]) -> bool:
    """Return True for four or more evenly spaced numbers."""
    if len(values) < 4 or not all(map(_is_number, values)):
        return False
    steps = np.diff(values)
    return bool(steps[0] > 0.0 and np.allclose(steps, steps[0], rtol=1e-6))


def _heat_maps(
    result: Sweep,
    varied: Mapping[str, Sequence[Any]],
    units: Mapping[str, str],
    found: Quantities,
    words: Mapping[str, str],
) -> Any:
    """Draw each figure as a heat map over two parameters; cells without a value are grey."""
    (first, x), (second, y) = varied.items()
    label = axis_label(first, units.get(first))
    head = result.headline, result.conditions, *result.reasons
    figure, panels = new_grid(head, found, label, more=0.5, sharey=True)
    edges = (*_outer(np.array(x)), *_outer(np.array(y)))
    for name, panel in panels.items():
        panel.grid(visible=False)
        panel.set_facecolor(GRID)
        values = found[name][0].reshape(len(x), len(y)).T
        image = panel.imshow(values, extent=edges, origin="lower", aspect="auto", cmap="GnBu")
        bar = figure.colorbar(image, ax=panel)
        bar.outline.set_visible(False)
        panel.spines[:].set_visible(False)
        panel.set(xlim=edges[:2], ylim=edges[2:])
        for axis, numbers in ((panel.xaxis, x), (panel.yaxis, y)):
            if len(numbers) <= _FEW:
                axis.set_ticks(numbers)
                steps = np.convolve(numbers, (0.5, 0.5), "valid")
                for step in steps:
                    (panel.axvline if axis is panel.xaxis else panel.axhline)(step, color="white", linewidth=1.5)
        if panel.get_subplotspec().is_first_col():
            panel.set_ylabel(axis_label(second, units.get(second)))
    missing = {words[name] for name, (values, _) in found.items() if name in panels and np.isnan(values).any()}
    if missing:
        figure.axes[0].plot([], [], "s", color=GRID, markersize=9, label=" or ".join(sorted(missing)))
        name_curves(figure, figure.axes[:1])
    return figure


@drawn
def law_sweep(result: LawSweep) -> Any:
    """Draw figure and spectral radius of each law over the varied parameter; for a map, also the scene's wall."""
    figure = sweep(result)
    p: Any = result.cells.scene
    if (*result.varied, result.names[0]) == ("damping", "law", "critical_stiffness"):
        panel, name = figure.axes[0], f"scene: {p.stiffness:g} N/m, {p.damping:g} N s/m"
        panel.plot(p.damping, p.stiffness, "D", color=FIRST, markeredgecolor="white", label=name, zorder=5)
        panel.set_ylim(0.0, None)
        figure.legends[0].remove()
        name_curves(figure, figure.axes)
    return figure


@drawn
def fidelity(result: FidelityResult) -> Any:
    """Draw each level's distance from those above.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (panel,) = new_figure((result.headline, result.conditions), 1, 1, 4.4)
    names, missing = result.columns()["level"], 1e6 * result.columns()["missing"]
    allowed = 1e6 * result.tolerance / MARGIN
    chosen, kept = names == (result.level.level if result.level else ""), missing <= allowed
    places, below = np.arange(len(names)), missing > 0.0
    for rows, colour, label in (
        (below & ~kept, on_white(BAD, 3.0), "max. deviation, too large"),
        (below & kept & ~chosen, on_white(GOOD, 3.0), "within tolerance"),
    ):
        if rows.any():
            panel.plot(missing[rows], places[rows], "o", color=colour, label=label)
    if (below & chosen).any():
        panel.plot(missing[chosen], places[chosen], label="least sufficient level", **_STAR | {"color": SERIES[0]})
    for place in places[~below]:  # which has no place on a log axis
        panel.text(0.01, place, "0", transform=panel.get_yaxis_transform(), va="center", color=SERIES[0])
    panel.axvline(allowed, color=REFERENCE, linestyle="--", zorder=1, label=f"tolerance / margin, {allowed:g} µm")
    panel.set_yticks(
        places, [f"{row.level}: {row.adds}" if wide_share() >= 1.0 else row.level for row in result.levels]
    )
    panel.set(ylim=(len(names) - 0.5, -0.5), xscale="log", xlabel="deviation from all higher levels (µm)")
    name_curves(figure, [panel])
    return figure


@drawn
def device_card(result: DeviceCard) -> Any:
    """Draw stable walls by hand, and impedances over frequency.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (width, size) = new_figure((result.headline, result.conditions), 1, 2, 4.4)
    for index, (hand, limit) in enumerate(zip(result.hands, result.limits)):
        width.plot(result.damping, limit / 1e3, label=f"hand {hand}", linewidth=1.8, **line_style(index))
    width.set(xlabel="damping (N s/m)", ylabel="stiffness (kN/m)", ylim=(0.0, None))
    width.set_title("Z-width (stable below the curve)", **TITLE)
    frequency, target, rendered, simulated = result.impedance
    size.loglog(frequency, target, label="target", linewidth=1.8, **line_style(1))
    size.loglog(frequency, rendered, label="rendered (theory)", linewidth=1.8, **line_style(0))
    size.loglog(frequency[::4], simulated[::4], "o", color=STOP, markersize=4, label="rendered (simulation)")
    size.axvline(result.transparent, color=REFERENCE, linestyle=":", label="transparency bandwidth")
    size.set(xlabel="frequency (Hz)", ylabel="impedance (N s/m)")
    size.set_title("impedance at the handle", **TITLE)
    for panel in (width, size):
        name_curves(panel)
    return figure
