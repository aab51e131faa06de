"""The controller of every study of walls: a wall below z = 0, the five other axes held."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES
from maglev_mj.laws import Hold, Law, VelocityEstimator, Wall
from maglev_mj.spec import INERTIA

__all__ = ["around_wall", "wall_controller"]

_HELD = tuple(axis for axis in AXES if axis != "z")


def wall_controller(
    *,
    stiffness: ArrayLike,
    damping: ArrayLike,
    pulse: ArrayLike = 0.0,
    pulse_width: float = 0.0,
    pulse_gate: ArrayLike = 0.0,
    force_limit: float = math.inf,
    period: float,
    delay: float,
    mass: float,
    velocity: VelocityEstimator | None = None,
) -> Controller:
    """Return the PD wall of eq. (3) with its braking pulse; gains are numbers, or (N,) for N devices.

    Args:
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        pulse: Further damping in the braking pulse [N s/m].
        pulse_width: How long the pulse lasts [s].
        pulse_gate: Least approach speed for a pulse [m/s].
        force_limit: See `Wall`.
        period: Sample period [s].
        delay: Transport delay [s], for the hold of the other axes.
        mass: Moving mass [kg], likewise.
        velocity: Velocity estimate; None for the finite difference.
    """
    gains = (_column(gain) for gain in (stiffness, damping, pulse, pulse_gate))
    k, b, further, gate = gains
    wall = Wall(
        axes="z",
        lower=0.0,
        stiffness=k,
        damping=b,
        pulse=further,
        pulse_width=pulse_width,
        pulse_gate=gate,
        force_limit=force_limit,
    )
    return around_wall(wall, period=period, delay=delay, mass=mass, velocity=velocity)


def around_wall(
    law: Law, *, period: float, delay: float, mass: float, velocity: VelocityEstimator | None = None
) -> Controller:
    """Return a controller of one law along z with the five other axes held."""
    hold = Hold.critically_damped(_HELD, inertia=[mass, mass, *INERTIA[3:]], period=period, delay=delay)
    return Controller([law, hold], period=period, velocity=velocity)


def _column(gain: ArrayLike) -> ArrayLike:
    """Return (N,) as (N, 1), one axis each; a number as it is."""
    values = np.asarray(gain)
    return values[:, None] if values.ndim else gain
