"""The page's plots: position and force over time, phase plane, and the gains on the stability map."""

from __future__ import annotations

import textwrap
from html import escape
from typing import Any

import numpy as np

from maglev_mj.colours import BAD, BOUNDARY, DEVICE, GOOD, HAND, MEASURED
from maglev_mj.display.curves import SHOWN, Curves, curves, round_up
from maglev_mj.display.stability_map import StabilityMap
from maglev_mj.frames import AXES
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.web.handles import put
from maglev_mj.web.svg import Line, Range, chart

__all__ = ["Plots"]

_POINTS, _MARGIN = 200, 1.1
_LEAST_DISTANCE, _LEAST_SPEED, _LEAST_FORCE = 1.0, 20.0, 2.0


class Plots:
    """Four plots of one axis.

    Args:
        gui: viser's, within the container for the plots.
        scene: The scene, whose own axis is shown at first.
    """

    def __init__(self, gui: Any, scene: Scene) -> None:
        self._stability = StabilityMap()
        self._axis = gui.add_dropdown("axis", AXES, initial_value=scene.axis, hint="axis of the plots")
        self._plots = [gui.add_html("") for _ in range(4)]
        self._type = type(scene)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if type(snapshot.scene) is not self._type:
            self._type, self._axis.value = type(snapshot.scene), snapshot.scene.axis
        shown = curves(snapshot, AXES.index(self._axis.value), _POINTS)
        made = (_position(shown), _force(shown), _plane(shown), self._gains(snapshot.scene))
        for plot, content in zip(self._plots, made, strict=True):
            put(plot, content=content)

    def _gains(self, scene: Scene) -> str:
        """Return the stability boundary and a cross at the gains; the verdict alone where a law states no gains."""
        known = self._stability.of(scene)
        if isinstance(known, str):
            return f'<p style="margin:.5em">{escape(textwrap.shorten(known, 300))}</p>'
        dampings, stiffnesses = known
        if not len(dampings):
            return ""
        damping, stiffness = float(getattr(scene, "damping", 0.0)), float(getattr(scene, "stiffness", 0.0))
        most = float(np.interp(damping, dampings, stiffnesses, right=0.0))
        good = stiffness <= most
        far = f"{100.0 * stiffness / most:.0f} % of the boundary" if most else "unstable at any stiffness"
        across = 0.0, _MARGIN * max(float(dampings.max()), damping)
        up = 0.0, 1e-3 * _MARGIN * max(float(stiffnesses.max()), stiffness)
        lines = [Line(BOUNDARY, dampings, 1e-3 * stiffnesses)]
        if damping or stiffness:
            lines.append(Line(GOOD if good else BAD, [damping], [1e-3 * stiffness], dot=True))
        title = [("kN/m over N s/m:", None), (far, GOOD if good else BAD)]
        return chart(title, lines, across, up)


def _edges(shown: Curves, ends: Range, upright: bool) -> list[Line]:
    pairs = [((edge, edge), ends) for edge in shown.edges]
    return [Line(BOUNDARY, *(pair if upright else pair[::-1]), dashed=True) for pair in pairs]


def _position(shown: Curves) -> str:
    across, up = (-SHOWN, 0.0), _span(shown.position, shown.edges, _LEAST_DISTANCE)
    lines = [*_edges(shown, across, False), Line(MEASURED, shown.time, shown.position)]
    return chart([(f"{shown.axis} [{shown.unit}]", MEASURED), ("walls dashed", None)], lines, across, up)


def _force(shown: Curves) -> str:
    lines = [Line(DEVICE, shown.time, shown.device), Line(HAND, shown.time, shown.hand)]
    title = [("device", DEVICE), ("hand", HAND), (f"[{shown.torque}]", None)]
    return chart(title, lines, (-SHOWN, 0.0), _span(np.r_[shown.device, shown.hand], (), _LEAST_FORCE))


def _plane(shown: Curves) -> str:
    across = _span(shown.position, shown.edges, _LEAST_DISTANCE)
    up = _span(shown.speed, (), _LEAST_SPEED)
    lines = [*_edges(shown, up, True), Line(MEASURED, shown.position, shown.speed, dot=True)]
    return chart([(f"speed [{shown.unit}/s] over {shown.axis} [{shown.unit}]", None)], lines, across, up)


def _span(values: Any, others: Any, least: float) -> Range:
    """Return a range about 0 that holds all values."""
    bound = round_up(max(float(np.abs(values).max(initial=0.0)), *(abs(other) for other in others), least))
    return -bound, bound
