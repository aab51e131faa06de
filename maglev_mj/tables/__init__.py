"""Results as text for a terminal, one module per subject."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.tables.analysis import analysis_table as analysis_table
    from maglev_mj.tables.fault import fault_table as fault_table
    from maglev_mj.tables.fault import latched_table as latched_table
    from maglev_mj.tables.sessions import flown_table as flown_table
    from maglev_mj.tables.sessions import served_table as served_table
    from maglev_mj.tables.sessions import show_table as show_table
    from maglev_mj.tables.sessions import timing_table as timing_table
    from maglev_mj.tables.sessions import verdict_table as verdict_table
    from maglev_mj.tables.stability import loop_table as loop_table
else:
    _HOMES = {
        "analysis": "analysis_table",
        "fault": "fault_table latched_table",
        "sessions": "flown_table served_table show_table timing_table verdict_table",
        "stability": "loop_table",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)
