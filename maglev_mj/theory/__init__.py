"""Stability theory of rendered walls, and wall design.

The exact closed loop, its stability boundary over the gains, and walls designed by it.
"""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach
from maglev_mj.theory.linearise import linearise as linearise  # now: its module has the same name

if TYPE_CHECKING:
    from maglev_mj.theory.boundary import StiffestWall as StiffestWall
    from maglev_mj.theory.boundary import largest_stable_stiffness as largest_stable_stiffness
    from maglev_mj.theory.boundary import stable_ranges as stable_ranges
    from maglev_mj.theory.boundary import stiffest_wall as stiffest_wall
    from maglev_mj.theory.closed_loop import critical_delay as critical_delay
    from maglev_mj.theory.closed_loop import is_stable as is_stable
    from maglev_mj.theory.closed_loop import largest_modulus as largest_modulus
    from maglev_mj.theory.closed_loop import least_dynamic_stiffness as least_dynamic_stiffness
    from maglev_mj.theory.design import GOALS as GOALS
    from maglev_mj.theory.design import LAWS as LAWS
    from maglev_mj.theory.design import Case as Case
    from maglev_mj.theory.design import DesignedWall as DesignedWall
    from maglev_mj.theory.design import WallRequirements as WallRequirements
    from maglev_mj.theory.design import design_wall as design_wall
    from maglev_mj.theory.design import worst_case as worst_case
    from maglev_mj.theory.linearise import ClosedLoop as ClosedLoop
    from maglev_mj.theory.linearise import Linearised as Linearised
    from maglev_mj.theory.verdict import Verdict as Verdict
    from maglev_mj.theory.verdict import inertia_of as inertia_of
    from maglev_mj.theory.verdict import judge as judge
    from maglev_mj.theory.verdict import stability as stability
    from maglev_mj.theory.verdict import stated_gains as stated_gains
else:
    _HOMES = {
        "boundary": "StiffestWall largest_stable_stiffness stable_ranges stiffest_wall",
        "closed_loop": "critical_delay is_stable largest_modulus least_dynamic_stiffness",
        "design": "Case DesignedWall GOALS LAWS WallRequirements design_wall worst_case",
        "linearise": "ClosedLoop Linearised linearise",
        "verdict": "Verdict inertia_of judge stability stated_gains",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)
