"""Pictures of results; the only room that needs matplotlib (the extra `charts`)."""

from maglev_mj.plots.design import design_map
from maglev_mj.plots.drawing import ChartsMissingError, Panel, require, small_multiples
from maglev_mj.plots.drop import phase_plane, phases, time_series
from maglev_mj.plots.press import figure_6
from maglev_mj.plots.recorded import first_contact, sticks, whole_run
from maglev_mj.plots.results import pictures_of, series, spread
from maglev_mj.plots.stability import stability_map
from maglev_mj.plots.stick_slip import stick_slip

__all__ = [
    "ChartsMissingError",
    "Panel",
    "design_map",
    "figure_6",
    "first_contact",
    "phase_plane",
    "phases",
    "pictures_of",
    "require",
    "series",
    "small_multiples",
    "spread",
    "stability_map",
    "stick_slip",
    "sticks",
    "time_series",
    "whole_run",
]
