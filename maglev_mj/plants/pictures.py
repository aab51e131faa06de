"""Charts of motion: position and force over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.pictures import drawn, line_style, name_curves, new_grid
from maglev_mj.plants.trace import Trace

_STILL = 1e-6


@drawn
def trace(result: Trace) -> Any:
    """Draw a trace; see `moving_axes`.

    Raises:
        ParameterError: If it is not of one device on six axes.
    """
    result.columns()
    return moving_axes((result.headline, result.conditions), result.time, result.pose, result.wrench)


@drawn
def samples(result: Any) -> Any:
    """Draw position and command of the `Samples` of a recording; see `moving_axes`.

    Raises:
        AttributeError: If time, position or command were not loaded.
    """
    return moving_axes((result.headline, result.conditions), result.time, result.position, result.command)


@drawn
def moving_axes(head: Sequence[str], time: Array, position: Array, force: Array) -> Any:
    """Plot position and force of the moving axes, translations and rotations side by side; z if none moves.

    Args:
        head: See `new_figure`.
        time: Times [s], (N,).
        position: Positions [m, rad], (N, 6).
        force: Wrench from each time on [N, N m], (N, 6).

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    moving = np.flatnonzero(np.ptp(position, axis=0) > _STILL)
    groups = [axes for axes in (moving[moving < 3], moving[moving > 2]) if axes.size] or [np.array([2])]
    curves, styles, lowest = {}, dict[str, Any](), {}
    for axes in groups:
        first = int(axes[0])
        motion, effort = ("position", "force") if first < 3 else ("rotation", "torque")
        curves[motion] = 1e3 * position.T[axes], unit_of("mm", first)
        curves[effort] = force.T[axes], unit_of("N", first)
        styles |= {motion: (axes, "default"), effort: (axes, "steps-post")}
    figure, panels = new_grid(head, curves, "time (s)", high=2, always=next(iter(curves)))
    for name, panel in panels.items():
        axes, step = styles[name]
        for axis, curve in zip(axes, curves[name][0], strict=True):
            panel.plot(time, curve, drawstyle=step, linewidth=1.3, label=AXES[axis], **line_style(axis % 3))
        lowest[axes[0]] = panel
    for panel in lowest.values():
        name_curves(panel)
    return figure
