"""Base of interactive scenes: walls, braking pulses, friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, TypeAlias

from maglev_mj.errors import ParameterError, check_one_of, named
from maglev_mj.frames import AXES, ZERO
from maglev_mj.hand import SpringHand, Trajectory
from maglev_mj.laws import Law
from maglev_mj.parameters import Turn, number, param
from maglev_mj.scenes import parts
from maglev_mj.scenes.scene import DELAY, RATE, Scene, Start
from maglev_mj.spec import RANGE, Spec

Face: TypeAlias = tuple[str, int, float]
"""Wall: axis name, normal (1 or -1), edge [m, rad].

The axis is free on the normal's side.
"""

_UNSCRIPTED, _TAIL = 0.6, 0.4
_PROGRAMS_ONLY = Turn()


def _faces(walls: Any) -> tuple[Face, ...]:
    """Return checked walls."""
    if isinstance(walls, str) or not isinstance(walls, Sequence):
        raise ParameterError(f"walls must be a list of an axis, a normal and an edge each, not {walls!r}")
    faces: dict[tuple[str, int], Face] = {}
    for wall in walls:
        if isinstance(wall, str) or not isinstance(wall, Sequence) or len(wall) != 3:
            raise ParameterError(f"a wall must be an axis, a normal and an edge, not {wall!r}")
        axis, normal, edge = wall
        check_one_of("a wall's axis", AXES, axis)
        if isinstance(normal, bool) or normal not in (1, -1):
            raise ParameterError(f"a wall's normal must be 1 or -1, not {normal!r}")
        if (axis, normal) in faces:
            raise ParameterError(f"walls must be one from each side of an axis, not two of normal {normal} on {axis}")
        reach = RANGE[AXES.index(axis)]
        edge = number(f"a wall's edge on {axis}", edge, at_least=-reach, at_most=reach)
        faces[axis, int(normal)] = axis, int(normal), edge
    for axis in AXES:
        lower, upper = faces.get((axis, 1)), faces.get((axis, -1))
        if lower is not None and upper is not None and not lower[2] < upper[2]:
            raise ParameterError(f"walls must leave room between them, not {lower[2]:g} to {upper[2]:g} on {axis}")
    return tuple(faces.values())


class InteractiveScene(Scene):
    """Scene with walls, braking pulses and friction, adjustable while running.

    Rotations get the gains at their radius of gyration.

    Class attributes:
        says: Short description.
        pose: Pose at the start [m, rad].
        script: Trajectory of the scripted hand; None for none.
    """

    says: ClassVar[str] = ""
    pose: ClassVar[Sequence[float]] = ZERO
    script: ClassVar[Trajectory | None] = None

    wall: bool = param("walls", default=True, live=True)
    pulse: bool = param("braking pulses of the walls", default=True, live=True)
    friction: bool = param("stick-slip friction", default=False, live=True)
    weightless: bool = param("currents that carry the flotor's weight", default=True, live=_PROGRAMS_ONLY)
    stiffness: float = param(
        "stiffness of walls and friction",
        "N/m",
        default=6000.0,
        at_least=parts.LEAST_STIFFNESS,
        at_most=1e6,
        live=Turn(factor=1.25, least=100.0, most=1e5),
    )
    damping: float = param(
        "damping of walls and friction",
        "N s/m",
        default=80.0,
        at_least=0.0,
        at_most=1e4,
        live=Turn(factor=1.25, least=1.0, most=1e3),
    )
    period: float = param(
        "sample period", "s", default=1.0 / Spec.control_rate.value, at_least=1e-4, at_most=0.1, live=RATE
    )
    delay: float = param(
        "from a sample to its command taking effect",
        "s",
        default=Spec.transport_delay.value,
        at_least=0.0,
        at_most=0.1,
        live=DELAY,
    )
    breakaway: float = param(
        "force at which friction breaks away", "N", default=2.0, at_least=0.01, at_most=50.0, live=_PROGRAMS_ONLY
    )
    walls: Sequence[Face] | None = param(
        "walls in place of the scene's own, at most one from each side of an axis",
        default=None,
        optional=True,
        parse=_faces,
        live=True,
    )

    def own_laws(self) -> list[Law]:
        """Return the laws with the scene's own walls."""
        raise ParameterError(f"{named(type(self))} must define own_laws()")

    def laws(self) -> list[Law]:
        """Return the laws with the present walls.

        These are the scene's own, or those set by another program.
        """
        laws = self.own_laws()
        if self.walls is None or not self.wall:
            return laws
        sticks = any(near.state == "stuck" for law in laws for near in law.gains() or ())
        gains = parts.shared(self) if sticks else self
        return [law for law in laws if not law.faces()] + parts.walls(gains, self.walls)

    def start(self) -> Start:
        """Return a flotor at rest.

        The currents carry its weight if `weightless`.
        """
        return Start(pose=self.pose, wrench=parts.WEIGHT if self.weightless else ZERO)

    def scripted_hand(self, phase: float = 0.0) -> SpringHand | None:
        """Return a hand that follows the script."""
        return None if self.script is None else SpringHand(target=self.script)

    def describe(self) -> str:
        """Return a one-line description."""
        return self.says

    @property
    def end(self) -> float:
        """End of the script with its last movement [s]."""
        return _UNSCRIPTED if self.script is None else self.script.end + _TAIL
