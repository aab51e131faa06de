"""Charts of any scene: series over time, figures over phase."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.colours import REFERENCE, SERIES
from maglev_mj.errors import ParameterError, not_one_of
from maglev_mj.frames import unit_of
from maglev_mj.plots.drawing import TITLE, name_curves, new_figure, save
from maglev_mj.scenes.run import Phases, RunResult
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.fidelity import MARGIN, FidelityResult
from maglev_mj.studies.sweep import Sweep

Picture: TypeAlias = Callable[[Mapping[str, RunResult], Mapping[str, Phases], Path | None], Any]
"""Draws results and phases by label; see `series`."""

_FINE = 1e-4
_NAMES = {"z": "height"}
_MOST_PANELS, _COLUMNS = 4, 3


def pictures_of(scene: Scene, sweeps: Mapping[str, Phases]) -> dict[str, Picture]:
    """Return a scene's drawing functions by file name.

    The scene's own, or the general ones; names have no ending.
    """
    if scene.plots:
        return {name: _found(place) for name, place in scene.plots.items()}
    pictures: dict[str, Picture] = {scene.name: series}
    if sweeps:
        pictures[f"{scene.name}_phases"] = spread
    return pictures


def _found(place: str) -> Picture:
    module, _, name = place.partition(":")
    found: Picture = getattr(import_module(module), name)
    return found


def result(one: RunResult, picture: str | None = None) -> Any:
    """Draw one run.

    Args:
        one: The run, of one phase.
        picture: One of the scene's pictures by name; the first by default.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        ParameterError: If there is no such picture, or the run is of several phases.
    """
    one.times()  # several phases have no grid in common
    known = pictures_of(one.scene, {})
    name = next(iter(known)) if picture is None else picture
    if name not in known:
        raise ParameterError(not_one_of("picture", known, picture))
    return known[name]({one.scene.name: one}, {}, None)


def phases(found: Phases) -> Any:
    """Draw each figure over the phase.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    return spread({}, {found.scene.name: found})


def sweep(found: Sweep) -> Any:
    """Draw each figure over the first varied parameter.

    Each combination of the others is a line.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    first, *others = found.varied
    lines = list(itertools.product(*(found.varied[name] for name in others)))
    named = {name: found.shown(name) for name in found.names if found.is_number(name)}
    rows = max(-(-len(named) // _COLUMNS), 1)
    figure, panels = new_figure(rows, min(max(len(named), 1), _COLUMNS), 0.9 + 2.8 * rows)
    for panel, (name, one) in zip(panels, named.items()):
        values = found.figure(name).reshape(len(found.varied[first]), -1) * one.scale
        for index, line in enumerate(lines):
            label = ", ".join(map(_chosen, others, line, (found.units.get(other, "") for other in others)))
            panel.plot(found.varied[first], values[:, index], "o-", color=SERIES[index % len(SERIES)], label=label)
        panel.set_title(_label(name, found.unit_along(one.unit, one.along)), **TITLE)
        panel.set_xlabel(_label(first, found.units.get(first)))
    for panel in panels[len(named) :]:
        panel.set_axis_off()
    if others:
        name_curves(figure, panels[:1])
    return figure


def fidelity(found: FidelityResult) -> Any:
    """Draw each level's distance from those above.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (panel,) = new_figure(1, 1, 4.2)
    names, missing = found.columns()["level"], 1e6 * found.columns()["missing"]
    panel.plot(missing[missing > 0.0], names[missing > 0.0], "o", color=SERIES[0], label="missing")
    allowed = 1e6 * found.tolerance / MARGIN
    panel.axvline(allowed, color=REFERENCE, linestyle="--", label=f"tolerance by the margin, {allowed:g} µm")
    panel.set_yticks(range(len(names)), names)
    panel.set_ylim(len(names) - 0.5, -0.5)
    panel.set_xscale("log")
    panel.set_xlabel("distance from the levels above (µm)")
    panel.set_title(found.preset.name, **TITLE)
    name_curves(panel)
    return figure


def _chosen(name: str, value: Any, unit: str) -> str:
    return f"{name} {value:g} {unit}".rstrip() if isinstance(value, int | float) else f"{name} {value}"


def _label(name: str, unit: str | None) -> str:
    return f"{name.replace('_', ' ')} ({unit})" if unit else name.replace("_", " ")


def series(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], path: Path | None = None) -> Any:
    """Draw each series over time, one line a run.

    Args:
        results: Runs by label.
        sweeps: Not drawn.
        path: File to write; None to return the figure.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    shown = {label: result.series(_FINE) for label, result in results.items()}
    first, units = next(iter(shown.values())), next(iter(results.values())).units
    names = [name for name, values in first.items() if name != "time" and values.dtype.kind in "fiu"][:_MOST_PANELS]
    figure, panels = new_figure(len(names), 1, 1.2 + 2.2 * len(names), sharex=True)
    for panel, name in zip(panels, names, strict=True):
        step = "steps-post" if "force" in name else "default"
        for place, (label, values) in enumerate(shown.items()):
            panel.plot(values["time"], values[name], color=SERIES[place % len(SERIES)], drawstyle=step, label=label)
        panel.set_ylabel(_label(_NAMES.get(name, name), units.get(name)))
    panels[-1].set_xlabel("time (s)")
    panels[-1].set_xlim(0.0, max(float(first["time"][-1]), _FINE))
    result = next(iter(results.values()))
    scene = result.scene
    panels[0].set_title(
        f"{scene.name}, axis {scene.axis}, {1.0 / scene.period:g} Hz, delay {scene.delay * 1e3:g} ms ({result.plant})",
        **TITLE,
    )
    if len(shown) > 1:
        name_curves(figure, panels[:1])
    return save(figure, path)


def spread(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], path: Path | None = None) -> Any:
    """Draw each figure over the sampling phase.

    Args:
        results: Not drawn.
        sweeps: Phases by label.
        path: File to write; None to return the figure.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    scene = next(iter(sweeps.values())).scene
    rows = max(-(-len(scene.figures) // _COLUMNS), 1)
    figure, panels = new_figure(rows, min(max(len(scene.figures), 1), _COLUMNS), 0.6 + 2.8 * rows, sharex=True)
    for panel, (name, one) in zip(panels, scene.figures.items()):
        for place, (label, sweep) in enumerate(sweeps.items()):
            values = np.asarray(sweep.figures[name], dtype=np.float64).reshape(len(sweep.phases), -1) * one.scale
            lines = panel.plot(sweep.phases, values, color=SERIES[place % len(SERIES)])
            lines[0].set_label(label)
        panel.set_title(_label(name, unit_of(one.unit, scene.axis, one.along)), **TITLE)
        panel.set_xlim(0.0, 1.0)
        panel.set_xlabel("phase of the first sample")
    for panel in panels[len(scene.figures) :]:
        panel.set_axis_off()
    if len(sweeps) > 1:
        name_curves(figure, panels[:1])
    return save(figure, path)
