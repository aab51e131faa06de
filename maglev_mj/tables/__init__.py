"""Results as text for a terminal, one module per subject."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.tables.fidelity import fidelity_table as fidelity_table
    from maglev_mj.tables.fidelity import levels_table as levels_table
else:
    _HOMES = {
        "fidelity": "fidelity_table levels_table",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)
