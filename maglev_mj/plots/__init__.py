"""Charts of recordings and faults."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.plots.fault import last_cycles as last_cycles
    from maglev_mj.plots.recorded import first_contact as first_contact
    from maglev_mj.plots.recorded import staircases as staircases
    from maglev_mj.plots.recorded import sticks as sticks
    from maglev_mj.plots.recorded import whole_run as whole_run
else:
    _HOMES = {
        "fault": "last_cycles",
        "recorded": "first_contact staircases sticks whole_run",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)
