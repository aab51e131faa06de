"""Laws of the interactive scenes, with a scene's gains.

Gains of rotations are scaled by inertia.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj import spec
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.laws import Bias, Hold, Law, StickSlip, Wall
from maglev_mj.parameters import axis_indices, param
from maglev_mj.plants import Sensor
from maglev_mj.scenes.scene import Scene
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


def others(axis: str) -> list[str]:
    """Return all axes but one."""
    return [name for name in AXES if name != axis]


def along(axis: str, value: float, elsewhere: float = 0.0) -> Array:
    """Return six numbers: one on an axis, another elsewhere."""
    return np.where(np.arange(len(AXES)) == AXES.index(axis), value, elsewhere)


def stepped(axis: str, quantum: float) -> Sensor | None:
    """Return a quantizing sensor for one axis, or None.

    The resolution is [m, rad]; 0 gives None, an ideal sensor.
    """
    return Sensor(quantum=along(axis, quantum)) if quantum else None


def hold(scene: Scene, axes: str | Sequence[str], mass: float = Spec.moving_mass.value) -> Hold:
    """Return a soft hold of the given axes.

    It is as stiff as period and delay allow with a wide margin.

    Example:
        >>> from maglev_mj import find_scene, hold
        >>> round(float(hold(find_scene("drop")(), ["x", "y"]).stiffness[0]))  # [N/m]
        1036
        >>> round(float(hold(find_scene("drop")(period=0.001), ["x", "y"]).stiffness[0]))
        1750
    """
    return _hold(axes if isinstance(axes, str) else tuple(axes), mass, scene.period, scene.delay)


@lru_cache
def _hold(axes: str | tuple[str, ...], mass: float, period: float, delay: float) -> Hold:
    """Return a hold, cached for all scenes of a sweep."""
    inertia = [mass if index < 3 else spec.INERTIA[index] for index in axis_indices(axes)]
    return Hold.critically_damped(axes, inertia=inertia, period=period, delay=delay)


class WallScene(Scene):
    """Wall that fills z <= 0, with a braking pulse.

    The five other axes are held.
    """

    stiffness: float = param("wall stiffness", "N/m", default=6000.0, at_least=0.0, at_most=1e8, live=True)
    damping: float = param("wall damping", "N s/m", default=80.0, at_least=0.0, at_most=1e6, live=True)
    pulse: float = param(
        "further damping in the braking pulse; 0 for none", "N s/m", default=220.0, at_least=0.0, at_most=1e6, live=True
    )
    pulse_width: float = param("how long the pulse lasts", "s", default=0.003, at_least=0.0, at_most=1.0)
    mass: float = param("moving mass", "kg", default=Spec.moving_mass.value, at_least=1e-3, at_most=1e3)
    force_limit: float | None = param(
        f"largest force of the actuators along z; the device's is {Spec.largest_vertical_force.value:g}",
        "N",
        default=None,
        above=0.0,
        at_most=1e6,
        optional=True,
    )
    quantize: float = param(
        "resolution of the position sensor; 0 for an ideal one", "m", default=0.0, at_least=0.0, at_most=1.0
    )

    def check(self) -> None:
        """See `Scene`."""
        if self.pulse > 0.0 and self.pulse_width == 0.0:
            raise ParameterError("pulse_width must be above 0 where there is a pulse, not 0.0")

    def wall(self, *, gate: float = 0.0, force_limit: float = math.inf) -> Wall:
        """Return the PD wall with its braking pulse.

        It is that of eq. (3) of Salcudean & Vlaar 1997.

        Args:
            gate: Least approach speed for a pulse [m/s].
            force_limit: See `Wall`.
        """
        return Wall(
            axes="z",
            lower=0.0,
            stiffness=self.stiffness,
            damping=self.damping,
            pulse=self.pulse,
            pulse_width=self.pulse_width,
            pulse_gate=gate,
            force_limit=force_limit,
        )

    def variants(self) -> Mapping[str, Self]:
        """See `Scene`."""
        if self.pulse == 0.0:
            return {"no pulse": self}
        return {"with pulse": self, "without pulse": self.replace(pulse=0.0)}

    def plant_options(self) -> dict[str, Any]:
        """See `Scene`."""
        return {
            "mass": self.mass,
            "wrench_limit": None if self.force_limit is None else along("z", self.force_limit, math.inf),
            "sensor": stepped("z", self.quantize),
        }
