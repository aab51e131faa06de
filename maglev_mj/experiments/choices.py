"""What experiments let one choose by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from maglev_mj.errors import ParameterError
from maglev_mj.hand import Hand
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

__all__ = ["HANDS", "LAWS", "PLANTS", "SLIDES_AT", "VELOCITIES", "hand_called"]

PLANTS = ("exact", "mujoco")

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

HANDS: Mapping[str, tuple[float, ...]] = {
    "none": (),
    # one trial: van Beek, Bergmann Tiest, Mugge & Kappers 2015, figure 3
    "arm": (0.554, 6.45, 135.0),
    # vertical direction of a stylus, after Fu & Cavusoglu 2012; read second-hand
    "stylus": (0.204, 18.06, 271.7, 0.776, 769.9),
    # assumed: the low corner of the published range
    "fingertip": (0.02, 1.0, 40.0),
}
"""Hands by name: mass [kg], damping [N s/m] and stiffness [N/m] of the arm, then damping and stiffness of the grip."""


def hand_called(text: str) -> Hand | None:
    """Return a hand by name, or from its numbers as "mass,damping,stiffness[,grip damping,grip stiffness]".

    Raises:
        ParameterError: If there is no such name, or the numbers do not make a hand.
    """
    values = HANDS.get(text)
    if values is None:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) not in (3, 5):
            raise ParameterError(
                f"hand must be one of {', '.join(HANDS)}, or mass,damping,stiffness in SI units, optionally with "
                f"grip damping and grip stiffness, not {text!r}"
            )
    if not values:
        return None
    mass, damping, stiffness, *grip = values
    if not grip:
        return Hand(mass=mass, damping=damping, stiffness=stiffness)
    return Hand(mass=mass, damping=damping, stiffness=stiffness, grip_damping=grip[0], grip_stiffness=grip[1])
