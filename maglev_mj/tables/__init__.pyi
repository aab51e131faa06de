from maglev_mj.tables.fault import fault_table as fault_table
from maglev_mj.tables.fault import latched_table as latched_table
from maglev_mj.tables.fidelity import fidelity_table as fidelity_table
from maglev_mj.tables.fidelity import levels_table as levels_table
