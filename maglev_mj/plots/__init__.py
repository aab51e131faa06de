"""Pictures of results; the only room that needs matplotlib (the extra `charts`)."""

from maglev_mj.plots.design import design_map
from maglev_mj.plots.drawing import ChartsMissingError, require
from maglev_mj.plots.drop import phase_plane, phases, time_series
from maglev_mj.plots.friction import friction_laws, staircase, stick_slip
from maglev_mj.plots.precision import WorkPoint, WorkPrecision, pareto, work_precision
from maglev_mj.plots.press import figure_6
from maglev_mj.plots.recorded import first_contact, sticks, whole_run
from maglev_mj.plots.results import pictures_of, series, spread
from maglev_mj.plots.stability import Panel, figure_2, shares, small_multiples, stability_map

__all__ = [
    "ChartsMissingError",
    "Panel",
    "WorkPoint",
    "WorkPrecision",
    "design_map",
    "figure_2",
    "figure_6",
    "first_contact",
    "friction_laws",
    "pareto",
    "phase_plane",
    "phases",
    "pictures_of",
    "require",
    "series",
    "shares",
    "small_multiples",
    "spread",
    "stability_map",
    "staircase",
    "stick_slip",
    "sticks",
    "time_series",
    "whole_run",
    "work_precision",
]
