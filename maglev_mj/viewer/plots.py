"""The live plots: position and force over the last two seconds, the phase plane, and the gains on the stability map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import mujoco
import numpy as np

from maglev_mj.display.curves import SHOWN, curves, round_up
from maglev_mj.display.stability_map import StabilityMap
from maglev_mj.frames import Array
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot

__all__ = ["Plots", "StopLabel"]

_POINTS = 500
_LEAST = 1.0
_BLUE, _RED, _GREEN, _GREY = (0.16, 0.52, 0.80), (0.90, 0.35, 0.33), (0.25, 0.72, 0.42), (0.62, 0.66, 0.70)

_Line: TypeAlias = tuple[tuple[float, float, float], Any, Any]
"""Colour, x and y of a line."""

_Range: TypeAlias = tuple[float, float]


class Plots:
    """Four figures of the engine's own kind, renewed from a snapshot."""

    def __init__(self) -> None:
        self._stability = StabilityMap()
        self.figures = [mujoco.MjvFigure() for _ in range(4)]
        for figure in self.figures:
            _prepare(figure)

    def update(self, snapshot: Snapshot) -> list[Any]:
        """Return the figures: position, force, phase plane, stability map."""
        position, force, plane, gains = self.figures
        axis, unit, torque, when, place, speed, device, hand, edges = curves(
            snapshot, snapshot.scene.axis_index, _POINTS
        )
        across = (-SHOWN, 0.0)
        lines: list[_Line] = [(_GREY, across, [edge, edge]) for edge in edges]
        lines.append((_BLUE, when, place))
        _draw(position, f"{axis} [{unit}], grey: wall", lines, across, _span(place, edges, 1.0))
        lines = [(_RED, when, device), (_GREEN, when, hand)]
        _draw(force, f"red device, green hand [{torque}]", lines, across, _span(np.r_[device, hand], [], 4.0))
        lines = [(_GREY, [edge, edge], [-1e6, 1e6]) for edge in edges] + [(_BLUE, place, speed)]
        x_range, y_range = _span(place, edges, 1.0), _span(speed, [], 30.0)
        _draw(plane, f"speed [{unit}/s] over {axis} [{unit}]", lines, x_range, y_range)
        self._draw_gains(gains, snapshot.scene)
        return self.figures

    def wait(self, snapshot: Snapshot) -> None:
        """Wait until the stability of a snapshot is known."""
        self._stability.wait(snapshot.scene)

    def _draw_gains(self, figure: Any, scene: Scene) -> None:
        """Draw the stability boundary and a cross at the gains; the verdict alone where a law states no gains."""
        known = self._stability.of(scene)
        if isinstance(known, str):
            _draw(figure, known, [], (0.0, 1.0), (0.0, 1.0))
            return
        dampings, stiffnesses = known
        lines: list[_Line] = [(_GREY, dampings, stiffnesses * 1e-3)]
        damping, stiffness = getattr(scene, "damping", 0.0), getattr(scene, "stiffness", 0.0)
        width = round_up(max(float(dampings.max(initial=0.0)), 1.1 * damping, _LEAST))
        height = round_up(1e-3 * max(float(stiffnesses.max(initial=0.0)), 1.1 * stiffness, _LEAST))
        x, y, dx, dy = damping, stiffness * 1e-3, 0.04 * width, 0.06 * height
        if damping or stiffness:
            lines.append((_RED, [x - dx, x + dx, x, x, x], [y, y, y, y - dy, y + dy]))
        _draw(figure, "stable below: kN/m over N s/m", lines, (0.0, width), (0.0, height))


class StopLabel:
    """Red label of the emergency stop's key; once stopped, of the way on."""

    def __init__(self) -> None:
        figure = self._figure = mujoco.MjvFigure()
        _prepare(figure)
        figure.figurergba[:], figure.panergba[:], figure.textrgb[:] = (0.8, 0.05, 0.05, 1.0), 0.0, 1.0
        figure.gridsize[:], figure.gridrgb[:], figure.flg_ticklabel[:] = 0, figure.figurergba[:3], 0
        figure.minwidth = ""

    def update(self, snapshot: Snapshot) -> Any:
        """Return the label as a figure of the engine's own kind."""
        self._figure.title = f"STOPPED: {snapshot.remedy}" if snapshot.state == "stopped" else "ESC: EMERGENCY STOP"
        return self._figure


def _prepare(figure: Any) -> None:
    mujoco.mjv_defaultFigure(figure)
    figure.figurergba[:] = 0.10, 0.12, 0.15, 0.80
    figure.panergba[:] = 0.14, 0.16, 0.20, 0.60
    figure.legendrgba[:] = 0.0, 0.0, 0.0, 0.0
    figure.textrgb[:] = 0.92, 0.93, 0.95
    figure.gridrgb[:] = 0.34, 0.37, 0.42
    figure.linewidth, figure.gridwidth = 2.0, 1.0
    figure.gridsize[:] = 3, 3
    figure.flg_legend = figure.flg_extend = 0
    figure.xformat = figure.yformat = "%.4g"
    figure.minwidth = "-100"


def _draw(figure: Any, title: str, lines: Sequence[_Line], across: _Range, up: _Range) -> None:
    figure.title = title
    figure.linepnt[:] = 0
    for index, (colour, x, y) in enumerate(lines):
        x, y = np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)
        figure.linergb[index] = colour
        figure.linepnt[index] = x.size
        figure.linedata[index, : 2 * x.size : 2] = x
        figure.linedata[index, 1 : 2 * x.size : 2] = np.clip(y, *up)
    figure.range[0], figure.range[1] = across, up


def _span(values: Array, others: Sequence[float], least: float) -> _Range:
    """Return a range that holds all values, of a size that the engine does not round up itself: 1, 2 or 5."""
    bound = round_up(max(float(np.abs(values).max(initial=0.0)), *(abs(other) for other in others), least))
    return -bound, bound
