"""Results as text for a terminal, one module a subject."""

from maglev_mj.tables.analysis import analysis_table
from maglev_mj.tables.fault import fault_table, latched_table
from maglev_mj.tables.fidelity import fidelity_table, levels_table
from maglev_mj.tables.run import run_table, sweep_table
from maglev_mj.tables.sessions import flown_table, served_table, show_table, timing_table, verdict_table
from maglev_mj.tables.stability import design_table, drop_table, loop_table, stability_table

__all__ = [
    "analysis_table",
    "design_table",
    "drop_table",
    "fault_table",
    "fidelity_table",
    "flown_table",
    "latched_table",
    "levels_table",
    "loop_table",
    "run_table",
    "served_table",
    "show_table",
    "stability_table",
    "sweep_table",
    "timing_table",
    "verdict_table",
]
