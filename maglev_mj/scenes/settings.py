"""What may be changed while a scene runs: laws on and off, gains, rate and delay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeAlias

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.parameters import flag, number
from maglev_mj.plants import Timing
from maglev_mj.spec import Spec

__all__ = ["LEAST_STIFFNESS", "Face", "Settings"]

LEAST_STIFFNESS = 1.0
"""What settings take [N/m]."""

Face: TypeAlias = tuple[str, int, float]
"""A wall: name of its axis, its normal (1 or -1), where it begins [m, rad]; the axis is free on the normal's side."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What may be changed while a scene runs.

    Attributes:
        wall: Whether the walls are there.
        pulse: Whether they give a braking pulse.
        friction: Whether stick-slip friction is on.
        weightless: Whether the currents carry the flotor's weight.
        stiffness: Of walls and friction [N/m]; rotations get it at their radius of gyration.
        damping: Likewise [N s/m].
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        breakaway: Force at which friction breaks away [N]; rotations get it at their radius of gyration.
        walls: Walls in place of the scene's own, at most one from each side of an axis; None for the scene's own.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    wall: bool = True
    pulse: bool = True
    friction: bool = False
    weightless: bool = True
    stiffness: float = 6000.0
    damping: float = 80.0
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    breakaway: float = 2.0
    walls: Sequence[Face] | None = None

    def __post_init__(self) -> None:
        for name in ("wall", "pulse", "friction", "weightless"):
            object.__setattr__(self, name, flag(name, getattr(self, name)))
        bounds: Mapping[str, tuple[float, float]] = {
            "stiffness": (LEAST_STIFFNESS, 1e6),
            "damping": (0.0, 1e4),
            "period": (1e-4, 0.1),
            "delay": (0.0, 0.1),
            "breakaway": (0.01, 50.0),
        }
        for name, (least, most) in bounds.items():
            object.__setattr__(self, name, number(name, getattr(self, name), at_least=least, at_most=most))
        if self.walls is not None:
            object.__setattr__(self, "walls", _faces(self.walls))

    @property
    def timing(self) -> Timing:
        """Sample period and delay."""
        return Timing(period=self.period, delay=self.delay)

    def as_json(self) -> dict[str, Any]:
        """Return the values by name."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Settings:
        """Return settings from values by name.

        Raises:
            ParameterError: If a name is not known or a value is outside its bounds.
        """
        known = {field.name for field in fields(cls)}
        if wrong := set(values) - known:
            raise ParameterError(f"settings must be of {', '.join(sorted(known))}, not {', '.join(sorted(wrong))}")
        return cls(**values)


def _faces(walls: Sequence[Face]) -> tuple[Face, ...]:
    """Return walls, checked."""
    if isinstance(walls, str) or not isinstance(walls, Sequence):
        raise ParameterError(f"walls must be a list of an axis, a normal and an edge each, not {walls!r}")
    faces: dict[tuple[str, int], Face] = {}
    for wall in walls:
        if isinstance(wall, str) or not isinstance(wall, Sequence) or len(wall) != 3:
            raise ParameterError(f"a wall must be an axis, a normal and an edge, not {wall!r}")
        axis, normal, edge = wall
        if axis not in AXES:
            raise ParameterError(f"a wall's axis must be one of {', '.join(AXES)}, not {axis!r}")
        if isinstance(normal, bool) or normal not in (1, -1):
            raise ParameterError(f"a wall's normal must be 1 or -1, not {normal!r}")
        if (axis, normal) in faces:
            raise ParameterError(f"walls must be one from each side of an axis, not two of normal {normal} on {axis}")
        faces[axis, int(normal)] = axis, int(normal), number("a wall's edge", edge, at_least=-1.0, at_most=1.0)
    for axis in AXES:
        lower, upper = faces.get((axis, 1)), faces.get((axis, -1))
        if lower is not None and upper is not None and not lower[2] < upper[2]:
            raise ParameterError(f"walls must leave room between them, not {lower[2]:g} to {upper[2]:g} on {axis}")
    return tuple(faces.values())
