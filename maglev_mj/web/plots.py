"""Plots of the page: the charts of one axis as SVG."""

from __future__ import annotations

from typing import Any

from maglev_mj.display.charts import Charts
from maglev_mj.frames import AXES
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.web.handles import put
from maglev_mj.web.svg import drawn

_POINTS = 200


class Plots:
    """Four plots of one axis.

    Args:
        gui: viser's, within the container for the plots.
        scene: The scene, whose own axis is shown at first.
    """

    def __init__(self, gui: Any, scene: Scene) -> None:
        self._charts, self._type = Charts(_POINTS), type(scene)
        self._axis = gui.add_dropdown("axis", AXES, initial_value=scene.axis, hint="axis of the plots")
        self._plots = [gui.add_html("") for _ in range(4)]

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if type(snapshot.scene) is not self._type:
            self._type, self._axis.value = type(snapshot.scene), snapshot.scene.axis
        charts = self._charts.of(snapshot, AXES.index(self._axis.value))
        for plot, chart in zip(self._plots, charts, strict=True):
            put(plot, content=drawn(chart))
