"""Charts of any scene: series over time, figures over phase."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TypeAlias

import numpy as np

from maglev_mj.colours import SERIES
from maglev_mj.plots.drawing import TITLE, name_curves, new_figure, save
from maglev_mj.scenes.run import Phases, Result
from maglev_mj.scenes.scene import Scene

__all__ = ["Picture", "pictures_of", "series", "spread"]

Picture: TypeAlias = Callable[[Mapping[str, Result], Mapping[str, Phases], Path], Path]
"""Draws results and phases, each by label, to a file."""

_FINE = 1e-4
_UNITS = {"position": "position (m)", "velocity": "velocity (m/s)", "force": "force (N)", "z": "height (m)"}
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


def series(results: Mapping[str, Result], sweeps: Mapping[str, Phases], path: Path) -> Path:
    """Draw each series over time, one line a run.

    Args:
        results: Runs by label.
        sweeps: Not drawn.
        path: File to write.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    shown = {label: result.series(_FINE) for label, result in results.items()}
    first = next(iter(shown.values()))
    names = [name for name, values in first.items() if name != "time" and values.dtype.kind in "fiu"][:_MOST_PANELS]
    figure, panels = new_figure(len(names), 1, 1.2 + 2.2 * len(names), sharex=True)
    for panel, name in zip(panels, names, strict=True):
        step = "steps-post" if "force" in name else "default"
        for place, (label, values) in enumerate(shown.items()):
            panel.plot(values["time"], values[name], color=SERIES[place % len(SERIES)], drawstyle=step, label=label)
        panel.set_ylabel(_UNITS.get(name, name.replace("_", " ")))
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


def spread(results: Mapping[str, Result], sweeps: Mapping[str, Phases], path: Path) -> Path:
    """Draw each figure over the sampling phase.

    Args:
        results: Not drawn.
        sweeps: Phases by label.
        path: File to write.

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
        unit = f" ({one.unit})" if one.unit else ""
        panel.set_title(f"{name.replace('_', ' ')}{unit}", **TITLE)
        panel.set_xlim(0.0, 1.0)
        panel.set_xlabel("phase of the first sample")
    for panel in panels[len(scene.figures) :]:
        panel.set_axis_off()
    if len(sweeps) > 1:
        name_curves(figure, panels[:1])
    return save(figure, path)
