"""The laws that scenes are put together from, with a scene's gains; rotations get theirs by inertia."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj import spec
from maglev_mj.frames import AXES, Array
from maglev_mj.laws import Bias, Hold, Law, StickSlip, Wall
from maglev_mj.parameters import axis_indices, flag
from maglev_mj.spec import GRAVITY, Spec

if TYPE_CHECKING:
    from maglev_mj.scenes.interactive import Face, InteractiveScene

__all__ = [
    "INERTIA",
    "LEAST_STIFFNESS",
    "MASS",
    "WEIGHT",
    "contacts",
    "friction",
    "shared",
    "spring",
    "wall",
    "walls",
    "weight",
]

MASS = Spec.moving_mass.value
"""Moving mass [kg]."""

INERTIA = np.array(spec.INERTIA)
"""Mass and moments of inertia of the six axes [kg, kg m²]."""

WEIGHT = (0.0, 0.0, MASS * GRAVITY, 0.0, 0.0, 0.0)
"""The wrench that carries the flotor [N, N m]."""

LEAST_STIFFNESS = 1.0
"""Least stiffness of walls and friction [N/m]."""

_V_MIN = 0.005
_PULSE_SHARE = 0.6
_GATE = 0.02


def _share(axes: str | Sequence[str]) -> Array:
    """Return inertia over mass for each axis: what scales a gain so that rotations answer like translations."""
    share: Array = INERTIA[list(axis_indices(axes))] / MASS
    return share


def shared(scene: InteractiveScene) -> InteractiveScene:
    """Return the scene for walls and friction that may act on the same axis: half the gains each where both are on.

    Their stiffnesses add up, and it is the sum that the delay sets a bound to.
    """
    if not (scene.wall and scene.friction):
        return scene
    # half of the least stiffness is less than a scene takes
    return scene.replace(stiffness=max(0.5 * scene.stiffness, LEAST_STIFFNESS), damping=0.5 * scene.damping)


def wall(
    scene: InteractiveScene, axes: str | Sequence[str], *, lower: ArrayLike = -math.inf, upper: ArrayLike = math.inf
) -> Wall:
    """Return walls with the scene's gains, and a pulse that takes up the momentum of a crossing.

    The pulse lasts as long in relation to the period as the paper's, 3 ms of 5 ms, and is given from 20 mm/s of
    approach on: below that it would only rattle.

    Args:
        scene: Gains, period, and whether there is a pulse.
        axes: Names from AXES.
        lower: See `Wall` [m, rad].
        upper: See `Wall` [m, rad].
    """
    share = _share(axes)
    width = _PULSE_SHARE * scene.period
    pulse = max(MASS / width - scene.damping, 0.0) if scene.pulse else 0.0
    return Wall(
        axes=axes,
        lower=lower,
        upper=upper,
        stiffness=scene.stiffness * share,
        damping=scene.damping * share,
        pulse=pulse * share,
        pulse_width=width,
        pulse_gate=_GATE / np.sqrt(share),
    )


def walls(scene: InteractiveScene, faces: Sequence[Face]) -> list[Law]:
    """Return walls where they are told to be, with the scene's gains as for `wall`."""
    lower = {axis: edge for axis, normal, edge in faces if normal > 0}
    upper = {axis: edge for axis, normal, edge in faces if normal < 0}
    axes = [axis for axis in AXES if axis in lower or axis in upper]
    if not axes:
        return []
    edges = {
        "lower": [lower.get(axis, -math.inf) for axis in axes],
        "upper": [upper.get(axis, math.inf) for axis in axes],
    }
    return [wall(scene, axes, **edges)]


def contacts(
    scene: InteractiveScene, axes: str | Sequence[str], *, lower: ArrayLike = -math.inf, upper: ArrayLike = math.inf
) -> list[Law]:
    """Return walls on some axes and friction on all, as far as they are on, with gains that they share."""
    gains = shared(scene)
    walls = [wall(gains, axes, lower=lower, upper=upper)] if scene.wall else []
    return [*walls, friction(gains)] if scene.friction else [*walls]


def friction(scene: InteractiveScene, axes: str | Sequence[str] = AXES, *, coupled: bool = False) -> StickSlip:
    """Return stick-slip, on each axis by itself or coupled as on a table.

    Args:
        scene: Gains.
        axes: Names from AXES.
        coupled: See `StickSlip`.
    """
    if flag("coupled", coupled):
        return StickSlip(
            axes=axes,
            stiffness=scene.stiffness,
            damping=scene.damping,
            breakaway=scene.breakaway,
            v_min=_V_MIN,
            coupled=True,
        )
    share, radius = _share(axes), np.sqrt(_share(axes))
    return StickSlip(
        axes=axes,
        stiffness=scene.stiffness * share,
        damping=scene.damping * share,
        breakaway=scene.breakaway * radius,
        v_min=_V_MIN / radius,
    )


def spring(axes: str | Sequence[str], *, stiffness: float, damping: float, target: ArrayLike = 0.0) -> Hold:
    """Return a soft spring and damper, given for a translation [N/m, N s/m] and scaled by inertia for the others."""
    share = _share(axes)
    return Hold(axes=axes, stiffness=stiffness * share, damping=damping * share, target=target)


def weight(scene: InteractiveScene) -> list[Bias]:
    """Return what carries the flotor, if it is to be carried."""
    return [Bias(WEIGHT)] if scene.weightless else []
