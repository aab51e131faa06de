"""Mass, inertia and weight of the published joystick."""

from __future__ import annotations

from maglev_mj.device import published_device
from maglev_mj.plants.model import body_of

MASS = published_device().mass
"""Moving mass [kg]."""

INERTIA = published_device().inertia
"""Mass and moments of inertia [kg, kg m²], (6,)."""

WEIGHT = tuple((0.0 - body_of({}).load).tolist())
"""Wrench that compensates the flotor's weight [N, N m]."""
