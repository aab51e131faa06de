"""Plots of the page.

Position and force over time, phase plane, and the gains on the stability map.
"""

from __future__ import annotations

import textwrap
from html import escape
from typing import Any

from maglev_mj.colours import BAD, BOUNDARY, DEVICE, GOOD, HAND, MEASURED
from maglev_mj.display.curves import Curves, Ranges, curves
from maglev_mj.display.stability_map import StabilityMap
from maglev_mj.frames import AXES
from maglev_mj.scenes import Scene
from maglev_mj.session import SHOWN, Snapshot
from maglev_mj.web.handles import put
from maglev_mj.web.svg import Line, Range, chart

_POINTS, _MARGIN = 200, 1.1
_LEAST = 1e-3


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
        self._type, self._ranges = type(scene), Ranges(scene.axis_index)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if type(snapshot.scene) is not self._type:
            self._type, self._axis.value = type(snapshot.scene), snapshot.scene.axis
        axis = AXES.index(self._axis.value)
        if axis != self._ranges.axis:
            self._ranges = Ranges(axis)
        shown, ranges = curves(snapshot, axis, _POINTS), self._ranges
        made = (
            _position(shown, ranges),
            _force(shown, ranges),
            _plane(shown, ranges),
            self._gains(snapshot.scene),
        )
        for plot, content in zip(self._plots, made, strict=True):
            put(plot, content=content)

    def _gains(self, scene: Scene) -> str:
        """Return the stability boundary with the gains marked.

        The verdict alone for a law that states no gains.
        """
        found = self._stability.of(scene)
        colour = None if found.stable is None else GOOD if found.stable else BAD
        if not found.axis:
            return f'<p style="margin:.5em">{escape(textwrap.shorten(found.words, 300))}</p>'
        factor, unit = found.shown
        across = 0.0, _MARGIN * max(float(found.dampings.max(initial=0.0)), found.damping, _LEAST)
        up = 0.0, _MARGIN * factor * max(float(found.stiffnesses.max(initial=0.0)), found.stiffness, _LEAST)
        lines = [Line(BOUNDARY, found.dampings, factor * found.stiffnesses)]
        lines.append(Line(colour or BOUNDARY, [found.damping], [factor * found.stiffness], dot=True))
        title = [(found.words, colour), (f"{found.axis}, {unit}", None)]
        return chart(title, lines, across, up)


def _edges(shown: Curves, ends: Range, upright: bool) -> list[Line]:
    pairs = [((edge, edge), ends) for edge in shown.edges]
    return [Line(BOUNDARY, *(pair if upright else pair[::-1]), dashed=True) for pair in pairs]


def _position(shown: Curves, ranges: Ranges) -> str:
    across, up = (-SHOWN, 0.0), ranges.place(shown.position, shown.edges)
    lines = [*_edges(shown, across, False), Line(MEASURED, shown.time, shown.position)]
    return chart([(f"{shown.axis} [{shown.unit}]", MEASURED), ("walls dashed", None)], lines, across, up)


def _force(shown: Curves, ranges: Ranges) -> str:
    lines = [Line(DEVICE, shown.time, shown.device), Line(HAND, shown.time, shown.hand)]
    title = [("device", DEVICE), ("hand", HAND), (f"[{shown.torque}]", None)]
    return chart(title, lines, (-SHOWN, 0.0), ranges.force(shown.device, shown.hand, [0.0]))


def _plane(shown: Curves, ranges: Ranges) -> str:
    across = ranges.place(shown.position, shown.edges)
    up = ranges.speed(shown.speed)
    lines = [*_edges(shown, up, True), Line(MEASURED, shown.position, shown.speed, dot=True)]
    return chart([(f"speed [{shown.unit}/s] over {shown.axis} [{shown.unit}]", None)], lines, across, up)
