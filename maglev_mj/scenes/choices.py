"""Plants, friction laws and velocity estimators by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

from maglev_mj.laws import (
    AdaptiveWindow,
    Dahl,
    ElastoPlastic,
    FiniteDifference,
    Friction,
    HaywardArmstrong,
    ImplicitCoulomb,
    LowPass,
    LuGre,
    SpringReset,
    StickSlip,
    VelocityEstimator,
)
from maglev_mj.plants import ExactPlant, MuJoCoPlant, SampledPlant

__all__ = ["LAWS", "PLANTS", "SLIDES_AT", "VELOCITIES", "PlantMaker"]

PlantMaker: TypeAlias = Callable[..., SampledPlant]
"""Makes a plant of a timing and the keywords of a plant."""

PLANTS: Mapping[str, PlantMaker] = {"exact": ExactPlant, "mujoco": MuJoCoPlant}
"""Plants by name."""

LAWS: Mapping[str, Callable[..., Friction]] = {
    "stick-slip": lambda *, period, **common: StickSlip(**common),
    "spring-reset": lambda *, v_min, period, **common: SpringReset(**common),
    "dahl": lambda *, v_min, period, **common: Dahl(**common),
    "lugre": lambda *, v_min, period, **common: LuGre(period=period, stribeck=v_min, **common),
    "elasto-plastic": lambda *, v_min, period, **common: ElastoPlastic(**common),
    "hayward-armstrong": lambda *, v_min, period, **common: HaywardArmstrong(**common),
    "kikuuwe": lambda *, v_min, period, **common: ImplicitCoulomb(period=period, **common),
}
"""Friction laws by name; each takes the axes and the common parameters, and drops what it has no use for."""

SLIDES_AT = {"stick-slip": 0.0, "spring-reset": 0.0, "lugre": 0.8}
"""Friction in steady sliding that a law stands for, as a share of breakaway; 1 for the others.

The spring that resets is meant as stick-slip; what it gives is a sawtooth.
"""

VELOCITIES: Mapping[str, Callable[[float], VelocityEstimator]] = {
    "difference": lambda quantum: FiniteDifference(),
    "low-pass": lambda quantum: LowPass(),
    "adaptive": lambda quantum: AdaptiveWindow(noise=(max(quantum, 1e-12),) * 6),
}
"""Velocity estimators by name, made for a sensor's resolution [m, rad]."""
