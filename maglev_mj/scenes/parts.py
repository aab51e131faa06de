"""The laws that scenes are put together from, with gains from the settings; rotations get theirs by inertia."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj import spec
from maglev_mj.frames import AXES, Array
from maglev_mj.laws import Bias, Hold, Law, StickSlip, Wall
from maglev_mj.parameters import axis_indices, flag
from maglev_mj.scenes.settings import LEAST_STIFFNESS, Face, Settings
from maglev_mj.spec import GRAVITY, Spec

__all__ = ["INERTIA", "MASS", "WEIGHT", "friction", "hold", "shared", "spring", "wall", "walls", "weight"]

MASS = Spec.moving_mass.value
"""Moving mass [kg]."""

INERTIA = np.array(spec.INERTIA)
"""Mass and moments of inertia of the six axes [kg, kg m²]."""

WEIGHT = (0.0, 0.0, MASS * GRAVITY, 0.0, 0.0, 0.0)
"""The wrench that carries the flotor [N, N m]."""

_V_MIN = 0.005
_PULSE_SHARE = 0.6
_GATE = 0.02


def _share(axes: str | Sequence[str]) -> Array:
    """Return inertia over mass for each axis: what scales a gain so that rotations answer like translations."""
    share: Array = INERTIA[list(axis_indices(axes))] / MASS
    return share


def shared(settings: Settings) -> Settings:
    """Return settings for walls and friction that may act on the same axis: half the gains each where both are on.

    Their stiffnesses add up, and it is the sum that the delay sets a bound to.
    """
    if not (settings.wall and settings.friction):
        return settings
    # half of the least stiffness is less than settings take
    return replace(settings, stiffness=max(0.5 * settings.stiffness, LEAST_STIFFNESS), damping=0.5 * settings.damping)


def wall(
    settings: Settings, axes: str | Sequence[str], *, lower: ArrayLike = -math.inf, upper: ArrayLike = math.inf
) -> Wall:
    """Return walls with the settings' gains, and a pulse that takes up the momentum of a crossing.

    The pulse lasts as long in relation to the period as the paper's, 3 ms of 5 ms, and is given from 20 mm/s of
    approach on: below that it would only rattle.

    Args:
        settings: Gains, period, and whether there is a pulse.
        axes: Names from AXES.
        lower: See `Wall` [m, rad].
        upper: See `Wall` [m, rad].
    """
    share = _share(axes)
    width = _PULSE_SHARE * settings.period
    pulse = max(MASS / width - settings.damping, 0.0) if settings.pulse else 0.0
    return Wall(
        axes=axes,
        lower=lower,
        upper=upper,
        stiffness=settings.stiffness * share,
        damping=settings.damping * share,
        pulse=pulse * share,
        pulse_width=width,
        pulse_gate=_GATE / np.sqrt(share),
    )


def walls(settings: Settings, faces: Sequence[Face]) -> list[Law]:
    """Return walls where they are told to be, with the settings' gains as for `wall`."""
    lower = {axis: edge for axis, normal, edge in faces if normal > 0}
    upper = {axis: edge for axis, normal, edge in faces if normal < 0}
    axes = [axis for axis in AXES if axis in lower or axis in upper]
    if not axes:
        return []
    edges = {
        "lower": [lower.get(axis, -math.inf) for axis in axes],
        "upper": [upper.get(axis, math.inf) for axis in axes],
    }
    return [wall(settings, axes, **edges)]


def friction(settings: Settings, axes: str | Sequence[str] = AXES, *, coupled: bool = False) -> StickSlip:
    """Return stick-slip, on each axis by itself or coupled as on a table.

    Args:
        settings: Gains.
        axes: Names from AXES.
        coupled: See `StickSlip`.
    """
    if flag("coupled", coupled):
        return StickSlip(
            axes=axes,
            stiffness=settings.stiffness,
            damping=settings.damping,
            breakaway=settings.breakaway,
            v_min=_V_MIN,
            coupled=True,
        )
    share, radius = _share(axes), np.sqrt(_share(axes))
    return StickSlip(
        axes=axes,
        stiffness=settings.stiffness * share,
        damping=settings.damping * share,
        breakaway=settings.breakaway * radius,
        v_min=_V_MIN / radius,
    )


def hold(settings: Settings, axes: str | Sequence[str]) -> Hold:
    """Return a hold that keeps axes where they are at rest, as stiff as period and delay allow with ease."""
    inertia = INERTIA[list(axis_indices(axes))]
    return Hold.critically_damped(axes, inertia=inertia, period=settings.period, delay=settings.delay)


def spring(axes: str | Sequence[str], *, stiffness: float, damping: float, target: ArrayLike = 0.0) -> Hold:
    """Return a soft spring and damper, given for a translation [N/m, N s/m] and scaled by inertia for the others."""
    share = _share(axes)
    return Hold(axes=axes, stiffness=stiffness * share, damping=damping * share, target=target)


def weight(settings: Settings) -> list[Bias]:
    """Return what carries the flotor, if it is to be carried."""
    return [Bias(WEIGHT)] if settings.weightless else []
