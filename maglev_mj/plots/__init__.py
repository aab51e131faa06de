"""Charts of results; this package alone needs matplotlib (`charts`)."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.plots.drawing import FORMATS as FORMATS
    from maglev_mj.plots.drawing import Panel as Panel
    from maglev_mj.plots.drawing import PictureFolder as PictureFolder
    from maglev_mj.plots.drawing import require as require
    from maglev_mj.plots.drawing import small_multiples as small_multiples
    from maglev_mj.plots.paper import figure_6 as figure_6
    from maglev_mj.plots.paper import phase_plane as phase_plane
    from maglev_mj.plots.paper import stick_slip as stick_slip
    from maglev_mj.plots.paper import time_series as time_series
    from maglev_mj.plots.results import pictures_of as pictures_of
    from maglev_mj.plots.stability import design_map as design_map
    from maglev_mj.plots.stability import drop_map as drop_map
    from maglev_mj.plots.stability import stability_map as stability_map
else:
    _HOMES = {
        "drawing": "FORMATS Panel PictureFolder require small_multiples",
        "paper": "figure_6 phase_plane stick_slip time_series",
        "results": "pictures_of",
        "stability": "design_map drop_map stability_map",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)
