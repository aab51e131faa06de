"""The live plots: position and force over the last two seconds, the phase plane, and the gains on the stability map."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, TypeAlias

import mujoco
import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.theory import inertia_of, largest_stable_stiffness, stability, stated_gains

__all__ = ["Plots", "StopLabel"]

_SECONDS = 2.0
_POINTS = 500
_DAMPINGS = 32
_LEAST = 1.0
_NO_BOUNDARY = np.zeros(0), np.zeros(0)
_BLUE, _RED, _GREEN, _GREY = (0.16, 0.52, 0.80), (0.90, 0.35, 0.33), (0.25, 0.72, 0.42), (0.62, 0.66, 0.70)

_Line: TypeAlias = tuple[tuple[float, float, float], Any, Any]
"""Colour, x and y of a line."""

_Range: TypeAlias = tuple[float, float]


class Plots:
    """Four figures of the engine's own kind, renewed from a snapshot."""

    def __init__(self) -> None:
        self._stability = _Stability()
        self.figures = [mujoco.MjvFigure() for _ in range(4)]
        for figure in self.figures:
            _prepare(figure)

    def update(self, snapshot: Snapshot) -> list[Any]:
        """Return the figures: position, force, phase plane, stability map."""
        position, force, plane, gains = self.figures
        turning = snapshot.scene.axis_index > 2
        unit, torque = ("mrad", "N m") if turning else ("mm", "N")
        time, place, speed, device, hand = _thinned(snapshot.history).T
        when, axis = time - (time[-1] if time.size else 0.0), snapshot.scene.axis
        across = (-_SECONDS, 0.0)
        edges = [edge * 1e3 for index, _, edge in snapshot.faces if index == snapshot.scene.axis_index]
        lines: list[_Line] = [(_GREY, [-_SECONDS, 0.0], [edge, edge]) for edge in edges]
        lines.append((_BLUE, when, place * 1e3))
        _draw(position, f"{axis} [{unit}], grey: wall", lines, across, _span(place * 1e3, edges, 1.0))
        lines = [(_RED, when, device), (_GREEN, when, hand)]
        _draw(force, f"red device, green hand [{torque}]", lines, across, _span(np.r_[device, hand], [], 4.0))
        lines = [(_GREY, [edge, edge], [-1e6, 1e6]) for edge in edges] + [(_BLUE, place * 1e3, speed * 1e3)]
        x_range, y_range = _span(place * 1e3, edges, 1.0), _span(speed * 1e3, [], 30.0)
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
        width = _round_up(max(float(dampings.max(initial=0.0)), 1.1 * damping, _LEAST))
        height = _round_up(1e-3 * max(float(stiffnesses.max(initial=0.0)), 1.1 * stiffness, _LEAST))
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


class _Stability:
    """Stability of the newest parameters, found beside the session: a boundary, or a verdict in words."""

    def __init__(self) -> None:
        self._key: Scene | None = None
        self._found: tuple[Array, Array] | str = _NO_BOUNDARY
        self._busy: threading.Thread | None = None

    def of(self, scene: Scene) -> tuple[Array, Array] | str:
        """Return dampings [N s/m] and stiffnesses [N/m], or the verdict; the last one until a scene's own is known."""
        if scene != self._key and (self._busy is None or not self._busy.is_alive()):
            self._busy = threading.Thread(target=self._find, args=(scene,), daemon=True)
            self._busy.start()
        return self._found

    def wait(self, scene: Scene) -> None:
        """Find at once what is not known yet."""
        if scene != self._key:
            self._find(scene)

    def _find(self, scene: Scene) -> None:
        try:
            if stated_gains(scene.controller()) is None:
                self._found = str(stability(scene))
            else:
                self._found = _boundary(scene.period, scene.delay, float(inertia_of(scene)[0]))
        except MaglevError:
            self._found = "stability not known"
        self._key = scene


@lru_cache
def _boundary(period: float, delay: float, mass: float) -> tuple[Array, Array]:
    """Return dampings [N s/m] and the largest stable stiffness at each [N/m]."""
    # no damping beyond this is stable, whatever the stiffness
    most = 0.5 * np.pi * mass / (0.5 * period + delay) * 1.1
    dampings = np.linspace(0.0, most, _DAMPINGS)
    try:
        stiffnesses = largest_stable_stiffness(dampings, period=period, delay=delay, mass=mass)
    except ParameterError:  # theory goes up to ten periods of delay; beyond it there is no boundary to draw
        stiffnesses = np.zeros_like(dampings)
    end = int(np.flatnonzero(stiffnesses).max(initial=-2)) + 2
    return dampings[:end], stiffnesses[:end]


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


def _thinned(history: Array) -> Array:
    """Return at most so many rows as a figure holds."""
    return history[:: -(-len(history) // _POINTS)] if len(history) > _POINTS else history


def _span(values: Array, others: Sequence[float], least: float) -> _Range:
    """Return a range that holds all values, of a size that the engine does not round up itself: 1, 2 or 5."""
    bound = _round_up(max(float(np.abs(values).max(initial=0.0)), *(abs(other) for other in others), least))
    return -bound, bound


def _round_up(value: float) -> float:
    step = 10.0 ** np.floor(np.log10(value))
    return float(next(step * size for size in (1.0, 2.0, 5.0, 10.0) if step * size >= 0.999 * value))
