"""Impedances of human hands as published, each with its source."""

from __future__ import annotations

from collections.abc import Mapping

from maglev_mj.errors import ParameterError
from maglev_mj.hand.impedance import Hand

__all__ = ["HANDS", "PUBLISHED_RANGE", "hand_called"]

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


PUBLISHED_RANGE: Mapping[str, tuple[float, float]] = {
    "mass": (0.02, 0.6),
    "damping": (0.0, 28.0),
    "stiffness": (40.0, 1050.0),
}
"""Least and greatest published mass [kg], damping [N s/m] and stiffness [N/m] of a hand.

Source: as quoted with Fu & Cavusoglu 2012; read second-hand.
"""
