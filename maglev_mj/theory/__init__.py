"""Stability of the rendered wall: the exact closed loop, its boundary over the gains, and walls designed by it."""

from maglev_mj.theory.boundary import (
    StiffestWall,
    boundary_of,
    largest_stable_stiffness,
    ranges_of,
    stable_ranges,
    stiffest_of,
    stiffest_wall,
)
from maglev_mj.theory.closed_loop import critical_delay, is_stable, largest_modulus, least_dynamic_stiffness
from maglev_mj.theory.design import GOALS, LAWS, Case, DesignedWall, WallRequirements, design_wall, worst_case
from maglev_mj.theory.linearise import ClosedLoop, Linearised, linearise
from maglev_mj.theory.verdict import Verdict, inertia_of, judge, stability, stated_gains

__all__ = [
    "GOALS",
    "LAWS",
    "Case",
    "ClosedLoop",
    "DesignedWall",
    "Linearised",
    "StiffestWall",
    "Verdict",
    "WallRequirements",
    "boundary_of",
    "critical_delay",
    "design_wall",
    "inertia_of",
    "is_stable",
    "judge",
    "largest_modulus",
    "largest_stable_stiffness",
    "least_dynamic_stiffness",
    "linearise",
    "ranges_of",
    "stability",
    "stable_ranges",
    "stated_gains",
    "stiffest_of",
    "stiffest_wall",
    "worst_case",
]
