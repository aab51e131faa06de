"""What may be changed while a scene runs: laws on and off, gains, rate and delay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from maglev_mj.errors import ParameterError
from maglev_mj.parameters import number
from maglev_mj.plants import Timing
from maglev_mj.spec import Spec

__all__ = ["Settings"]


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

    def __post_init__(self) -> None:
        for name in ("wall", "pulse", "friction", "weightless"):
            if not isinstance(getattr(self, name), bool):
                raise ParameterError(f"{name} must be True or False, not {getattr(self, name)!r}")
        bounds: Mapping[str, tuple[float, float]] = {
            "stiffness": (1.0, 1e6),
            "damping": (0.0, 1e4),
            "period": (1e-4, 0.1),
            "delay": (0.0, 0.1),
        }
        for name, (least, most) in bounds.items():
            object.__setattr__(self, name, number(name, getattr(self, name), at_least=least, at_most=most))

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
