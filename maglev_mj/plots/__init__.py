"""Pictures of results; the only room that needs matplotlib (the extra `charts`)."""

from maglev_mj.plots.drawing import FORMATS, Panel, PictureFolder, require, small_multiples
from maglev_mj.plots.fault import last_cycles
from maglev_mj.plots.paper import figure_6, phase_plane, stick_slip, time_series
from maglev_mj.plots.recorded import first_contact, staircases, sticks, whole_run
from maglev_mj.plots.results import pictures_of
from maglev_mj.plots.stability import design_map, drop_map, drop_panels, stability_map

__all__ = [
    "FORMATS",
    "Panel",
    "PictureFolder",
    "design_map",
    "drop_map",
    "drop_panels",
    "figure_6",
    "first_contact",
    "last_cycles",
    "phase_plane",
    "pictures_of",
    "require",
    "small_multiples",
    "stability_map",
    "staircases",
    "stick_slip",
    "sticks",
    "time_series",
    "whole_run",
]
