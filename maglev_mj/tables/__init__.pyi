from maglev_mj.tables.fidelity import fidelity_table as fidelity_table
from maglev_mj.tables.fidelity import levels_table as levels_table
