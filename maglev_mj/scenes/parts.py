"""Laws of the interactive scenes, with a scene's gains.

Gains of rotations are scaled by inertia.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj import spec
from maglev_mj.frames import AXES, Array
from maglev_mj.laws import Bias, Hold, Law, StickSlip, Wall
from maglev_mj.parameters import axis_indices
from maglev_mj.spec import GRAVITY, Spec

if TYPE_CHECKING:
    from maglev_mj.scenes.interactive import Face, InteractiveScene

MASS = Spec.moving_mass.value
"""Moving mass [kg]."""

INERTIA = np.array(spec.INERTIA)
"""Mass and moments of inertia [kg, kg m²], six."""

WEIGHT = (0.0, 0.0, MASS * GRAVITY, 0.0, 0.0, 0.0)
"""Wrench that compensates the flotor's weight [N, N m]."""

LEAST_STIFFNESS = 1.0
"""Least stiffness of walls and friction [N/m]."""

_V_MIN = 0.005
_PULSE_SHARE = 0.6
_GATE = 0.02


def _share(axes: str | Sequence[str]) -> Array:
    """Return inertia over mass for each axis.

    Gains scaled by it give rotations the same response as translations.
    """
    share: Array = INERTIA[list(axis_indices(axes))] / MASS
    return share


def shared(scene: InteractiveScene) -> InteractiveScene:
    """Return the scene with gains shared by walls and friction.

    If both are on, each gets half the gains, because they may act on the same axis.

    The delay limits the sum of their stiffnesses.
    """
    if not (scene.wall and scene.friction):
        return scene
    # half of the least stiffness is below a scene's bound
    return scene.replace(stiffness=max(0.5 * scene.stiffness, LEAST_STIFFNESS), damping=0.5 * scene.damping)


def wall(
    scene: InteractiveScene, axes: str | Sequence[str], *, lower: ArrayLike = -math.inf, upper: ArrayLike = math.inf
) -> Wall:
    """Return walls with the scene's gains and a braking pulse.

    The pulse takes up the momentum at entry.

    The pulse lasts the same share of the period as the paper's, 3 ms of 5 ms. It is given from an approach speed of
    20 mm/s on: below that it would cause rattling.

    Args:
        scene: Gains, period, and pulse switch.
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
    """Return walls at given faces with the scene's gains.

    See `wall`.
    """
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
    """Return the walls and friction that are switched on.

    Walls are on the given axes, friction on all; they share the gains.
    """
    gains = shared(scene)
    walls = [wall(gains, axes, lower=lower, upper=upper)] if scene.wall else []
    return [*walls, friction(gains)] if scene.friction else [*walls]


def friction(scene: InteractiveScene, axes: str | Sequence[str] = AXES, *, coupled: bool = False) -> StickSlip:
    """Return stick-slip friction, independent or coupled per axis.

    Args:
        scene: Gains.
        axes: Names from AXES.
        coupled: See `StickSlip`.
    """
    if coupled:
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
    """Return a soft spring and damper, scaled by inertia.

    The gains are those of a translation [N/m, N s/m].
    """
    share = _share(axes)
    return Hold(axes=axes, stiffness=stiffness * share, damping=damping * share, target=target)


def weight(scene: InteractiveScene) -> list[Bias]:
    """Return the weight compensation, if switched on."""
    return [Bias(WEIGHT)] if scene.weightless else []
