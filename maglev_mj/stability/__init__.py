"""Stability of the rendered wall: the exact closed loop, its boundary over the gains, and walls designed by it."""

from maglev_mj.stability.boundary import (
    StiffestWall,
    boundary_of,
    largest_stable_stiffness,
    ranges_of,
    stable_ranges,
    stiffest_of,
    stiffest_wall,
)
from maglev_mj.stability.modulus import (
    characteristic_polynomial,
    critical_delay,
    is_stable,
    largest_modulus,
    least_dynamic_stiffness,
)

__all__ = [
    "StiffestWall",
    "boundary_of",
    "characteristic_polynomial",
    "critical_delay",
    "is_stable",
    "largest_modulus",
    "largest_stable_stiffness",
    "least_dynamic_stiffness",
    "ranges_of",
    "stable_ranges",
    "stiffest_of",
    "stiffest_wall",
]
