"""Interactive scenes (joystick, table, box, corner); walls, friction and springs scaled by inertia."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Bias, Hold, Law, StickSlip, Wall
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError, check_one_of, named
from maglev_mj.frames import AXES, ZERO, Array
from maglev_mj.parameters import Turn, axis_indices, number, param
from maglev_mj.plants.hand import SpringHand, Trajectory
from maglev_mj.plants.model import body_of
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.scenes.wall_scene import WallScene, hold

LEAST_STIFFNESS = 1.0
"""Least stiffness of walls and friction [N/m]."""

_V_MIN = 0.005
_PULSE_SHARE = 0.6
_GATE = 0.02


def _share(axes: str | Sequence[str], inertia: Array) -> Array:
    """Return inertia over mass per axis: gains scaled by it give rotations the response of translations."""
    return np.asarray(inertia[list(axis_indices(axes))] / inertia[0])


def shared(scene: InteractiveScene) -> InteractiveScene:
    """Return the scene with its gains halved if walls and friction are both on.

    Both may act on the same axis, and the delay limits the sum of their stiffnesses.
    """
    if not (scene.wall and scene.friction):
        return scene
    # clamp: half of the least stiffness is below the parameter's bound
    return scene.replace(stiffness=max(0.5 * scene.stiffness, LEAST_STIFFNESS), damping=0.5 * scene.damping)


def wall(
    scene: InteractiveScene, axes: str | Sequence[str], *, lower: ArrayLike = -math.inf, upper: ArrayLike = math.inf
) -> Wall:
    """Return walls with the scene's gains and a braking pulse that absorbs the momentum at entry.

    The pulse lasts the same fraction of the period as the paper's, 3 ms of 5 ms. Its gate is 20 mm/s: slower approaches
    would rattle.

    Args:
        scene: Gains, period, and pulse switch.
        axes: Names from AXES.
        lower: See `Wall` [m, rad].
        upper: See `Wall` [m, rad].
    """
    share = _share(axes, scene.hardware.inertia)
    width = _PULSE_SHARE * scene.period
    pulsed = scene.pulse and scene.wall_on == "host"
    pulse = max(float(scene.body.inertia[0]) / width - scene.damping, 0.0) if pulsed else 0.0
    return Wall(
        axes=axes,
        lower=lower,
        upper=upper,
        stiffness=scene.stiffness * share,
        damping=scene.damping * share,
        pulse=pulse * share,
        pulse_width=width,
        pulse_gate=_GATE / np.sqrt(share),
        on=scene.wall_on,
    )


def walls(scene: InteractiveScene, faces: Sequence[Face]) -> list[Law]:
    """Return walls at faces with the scene's gains; see `wall`."""
    lower = {axis: edge for axis, normal, edge in faces if normal > 0}
    upper = {axis: edge for axis, normal, edge in faces if normal < 0}
    axes = [axis for axis in AXES if axis in lower or axis in upper]
    if not axes:
        return []
    low, high = ([edge.get(axis, none) for axis in axes] for edge, none in ((lower, -math.inf), (upper, math.inf)))
    return [wall(scene, axes, lower=low, upper=high)]


def contacts(
    scene: InteractiveScene, axes: str | Sequence[str], *, lower: ArrayLike = -math.inf, upper: ArrayLike = math.inf
) -> list[Law]:
    """Return the enabled walls, on some axes, and friction, on all; see `shared`."""
    gains = shared(scene)
    walls = [wall(gains, axes, lower=lower, upper=upper)] if scene.wall else []
    return [*walls, friction(gains)] if scene.friction else [*walls]


def friction(scene: InteractiveScene, axes: str | Sequence[str] = AXES, *, coupled: bool = False) -> StickSlip:
    """Return stick-slip friction, per axis or coupled.

    Args:
        scene: Gains.
        axes: Names from AXES.
        coupled: See `StickSlip`.
    """
    share = np.ones(()) if coupled else _share(axes, scene.hardware.inertia)
    radius = np.sqrt(share)
    return StickSlip(
        axes=axes,
        stiffness=scene.stiffness * share,
        damping=scene.damping * share,
        breakaway=scene.breakaway * radius,
        v_min=_V_MIN / radius,
        coupled=coupled,
    )


def spring(
    axes: str | Sequence[str],
    *,
    stiffness: float,
    damping: float,
    inertia: Array,
    target: ArrayLike = 0.0,
) -> Hold:
    """Return a soft spring and damper; translational gains [N/m, N s/m] are scaled by inertia [kg, kg m²], (6,)."""
    share = _share(axes, inertia)
    return Hold(axes=axes, stiffness=stiffness * share, damping=damping * share, target=target)


def weight(scene: InteractiveScene) -> list[Bias]:
    """Return the weight compensation, if enabled."""
    return [Bias(scene.lift)] if scene.weightless else []


Face: TypeAlias = tuple[str, int, float]
"""Wall: axis name, normal (1 or -1, towards the free side), edge [m, rad]."""

_UNSCRIPTED, _TAIL = 0.6, 0.4
_PROGRAMS_ONLY = Turn()


def _scaled(trajectory: Trajectory, device: Device) -> Trajectory:
    """Return a trajectory scaled by the range of a device."""
    return replace(trajectory, poses=np.asarray(trajectory.poses) * device.range_ratio)


def _faces(walls: Any) -> tuple[Face, ...]:
    if isinstance(walls, str) or not isinstance(walls, Sequence):
        raise ParameterError(f"walls must be a list of [axis, normal, edge] (got {walls!r})")
    faces: dict[tuple[str, int], Face] = {}
    for wall in walls:
        if isinstance(wall, str) or not isinstance(wall, Sequence) or len(wall) != 3:
            raise ParameterError(f"a wall must be [axis, normal, edge] (got {wall!r})")
        axis, normal, edge = wall
        check_one_of("a wall's axis", AXES, axis)
        if isinstance(normal, bool) or normal not in (1, -1):
            raise ParameterError(f"a wall's normal must be 1 or -1 (got {normal!r})")
        if (axis, normal) in faces:
            raise ParameterError(f"walls must have different axes or normals (got two of normal {normal} on {axis})")
        edge = number(f"a wall's edge on {axis}", edge)
        faces[axis, int(normal)] = axis, int(normal), edge
    for axis in AXES:
        lower, upper = faces.get((axis, 1)), faces.get((axis, -1))
        if lower is not None and upper is not None and not lower[2] < upper[2]:
            raise ParameterError(f"walls must leave a gap (got {lower[2]:g} to {upper[2]:g} on {axis})")
    return tuple(faces.values())


class InteractiveScene(Scene):
    """Scene with walls, braking pulses and friction, adjustable while running.

    Rotational gains are scaled by inertia.

    Class attributes:
        summary: Short description.
        pose: Pose at the start [m, rad].
        script: Trajectory of the scripted hand; None without a hand.
    """

    summary: ClassVar[str] = ""
    pose: ClassVar[Sequence[float]] = ZERO
    script: ClassVar[Trajectory | None] = None

    wall: bool = param("walls", default=True, live=True)
    wall_on: str = WallScene.like("wall_on")
    pulse: bool = param("braking pulses of the walls", default=True, live=True)
    friction: bool = param("stick-slip friction", default=False, live=True)
    weightless: bool = param("weight compensation", default=True, live=_PROGRAMS_ONLY)
    stiffness: float = param(
        "stiffness of walls and friction",
        "N/m",
        default=None,
        derive=attrgetter("hardware.wall.stiffness"),
        at_least=LEAST_STIFFNESS,
        at_most=1e6,
        live=Turn(factor=1.25, least=100.0, most=1e5),
    )
    damping: float = param(
        "damping of walls and friction",
        "N s/m",
        default=None,
        derive=attrgetter("hardware.wall.damping"),
        at_least=0.0,
        at_most=1e4,
        live=Turn(factor=1.25, least=1.0, most=1e3),
    )
    period: float = Scene.like("period", at_least=1e-4, at_most=0.1)
    delay: float = Scene.like("delay", at_most=0.1)
    breakaway: float = param(
        "breakaway force of friction", "N", default=2.0, at_least=0.01, at_most=50.0, live=_PROGRAMS_ONLY
    )
    walls: Sequence[Face] | None = param(
        "walls in place of the scene's own, at most one per side of an axis",
        default=None,
        optional=True,
        parse=_faces,
        live=True,
    )

    def check(self) -> None:
        """See `Scene`."""
        for axis, _, edge in self.walls or ():
            reach = self.hardware.reach[AXES.index(axis)]
            number(f"a wall's edge on {axis}", edge, at_least=-reach, at_most=reach)

    def own_laws(self) -> list[Law]:
        """Return the laws with the scene's own walls."""
        raise ParameterError(f"{named(type(self))} must define own_laws()")

    def laws(self) -> list[Law]:
        """Return the laws, with `walls` in place of the scene's own if set."""
        laws = self.own_laws()
        if self.walls is None or not self.wall:
            return laws
        sticks = any(near.state == "stuck" for law in laws for near in law.gains() or ())
        gains = shared(self) if sticks else self
        return [law for law in laws if not law.faces()] + walls(gains, self.walls)

    @property
    def lift(self) -> tuple[float, ...]:
        """Wrench that compensates the weight of the device in use [N, N m]."""
        return tuple((0.0 - body_of(self.device_options()).load).tolist())

    def start(self) -> Start:
        """Return a flotor at rest, its weight compensated if `weightless`."""
        pose = (np.array(self.pose) * self.hardware.range_ratio).tolist()
        return Start(pose=pose, wrench=self.lift if self.weightless else ZERO)

    def scripted_hand(self, phase: float = 0.0) -> SpringHand | None:
        """Return a hand that follows the script, if there is one."""
        return None if self.script is None else SpringHand(target=_scaled(self.script, self.hardware))

    def describe(self) -> str:
        """Return a one-line description."""
        return self.summary

    @property
    def end(self) -> float:
        """End of the script and of the motion after it [s]."""
        return _UNSCRIPTED if self.script is None else self.script.end + _TAIL


CENTRING = 300.0
"""Stiffness of the spring to the centre [N/m]."""

_DAMPING = 12.0
_EDGES = (0.0035,) * 3 + (math.radians(4.5),) * 3


class Joystick(InteractiveScene):
    """Joystick in a box of walls."""

    summary: ClassVar = "soft centring on six axes in a box of walls; optional friction"
    model: ClassVar = "scenes/joystick"
    shown_axis: ClassVar = "x"
    script: ClassVar = Trajectory(
        [0.3, 0.8, 1.0, 1.6, 2.1, 2.6, 3.2, 3.8, 4.2],
        [
            [x * 1e-3, y * 1e-3, z * 1e-3, tilt, nod, spin]
            for x, y, z, tilt, nod, spin in (
                (0, 0, 0, 0, 0, 0),
                (16, 0, 0, 0, 0.15, 0),
                (16, 0, 0, 0, 0.15, 0),
                (0, 16, 0, -0.15, 0, 0),
                (-16, 0, 0, 0, -0.15, 0),
                (0, -16, 6, 0.15, 0, 0.2),
                (0, 0, -18, 0, 0, -0.2),
                (0, 0, 0, 0, 0, 0),
                (0, 0, 0, 0, 0, 0),
            )
        ],
    )

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        edges = np.array(_EDGES) * self.hardware.range_ratio
        soft = spring(AXES, stiffness=CENTRING, damping=_DAMPING, inertia=self.hardware.inertia)
        return [*weight(self), soft, *contacts(self, AXES, lower=-edges, upper=edges)]


class TableTop(InteractiveScene):
    """Block with friction on a table (figures 8, 9)."""

    name: ClassVar[str] = "table"
    summary: ClassVar = "block with dry friction on a table (figures 8 and 9)"
    model: ClassVar = "scenes/table"
    shown_axis: ClassVar = "x"
    script: ClassVar = Trajectory(
        [0.2, 1.2, 1.5, 2.5, 2.8, 4.0],
        [[x * 1e-3, y * 1e-3, 0.0, 0.0, 0.0, 0.0] for x, y in ((0, 0), (13, 4), (13, 4), (-8, -13), (-8, -13), (0, 0))],
    )

    wall: bool = param("walls", default=False, live=True)
    friction: bool = param("stick-slip friction", default=True, live=True)

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        laws: list[Law] = [*weight(self), hold(self, AXES[2:])]
        if self.friction:
            laws.append(friction(self, ("x", "y"), coupled=True))
        return laws


_AIR = 1.0

BOX_WALLS = (0.003,) * 3 + (math.radians(4.0),) * 3
"""Distances of the walls from the centre [m, rad], (6,)."""


class Box(InteractiveScene):
    """Box of stiff walls on all six axes."""

    summary: ClassVar = "box of walls on all six axes"
    model: ClassVar = "scenes/box"
    shown_axis: ClassVar = "x"
    script: ClassVar = Trajectory(
        [0.2, 0.5, 0.9, 1.4, 1.9, 2.4, 3.0],
        [
            [x * 1e-3, y * 1e-3, z * 1e-3, 0.0, turn, 0.0]
            for x, y, z, turn in (
                (0, 0, 0, 0),
                (14, 0, 0, 0.2),
                (14, 10, -10, 0),
                (-14, 10, -10, -0.2),
                (-14, -12, 8, 0),
                (6, -12, 8, 0.1),
                (0, 0, 0, 0),
            )
        ],
    )

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        # slight damping, as by air: the flotor comes to rest within a minute
        edges = np.array(BOX_WALLS) * self.hardware.range_ratio
        soft = spring(AXES, stiffness=0.0, damping=_AIR, inertia=self.hardware.inertia)
        return [*weight(self), soft, *contacts(self, AXES, lower=-edges, upper=edges)]


_INTO = ("x", "z", "ry")


class Corner(InteractiveScene):
    """Corner of two walls and a rotation stop."""

    summary: ClassVar = "spring into a corner of two walls and a rotation stop"
    model: ClassVar = "scenes/corner"
    pose: ClassVar = (0.003, 0.0, 0.003, 0.0, 0.04, 0.0)
    script: ClassVar = Trajectory(
        [0.8, 1.2, 1.6, 2.4, 3.0],
        [
            [x * 1e-3, 0.0, z * 1e-3, 0.0, turn, 0.0]
            for x, z, turn in ((0, 0, 0), (6, 6, 0.1), (-10, 4, 0), (-10, -10, -0.1), (-6, -6, 0))
        ],
    )

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        # presses the walls with 0.4 N, and the stop with the same acceleration
        target = np.isin(AXES, _INTO) * -2e-3 * self.hardware.range_ratio
        soft = spring(AXES, stiffness=200.0, damping=4.0, target=target, inertia=self.hardware.inertia)
        return [*weight(self), soft, *contacts(self, _INTO, lower=0.0)]
