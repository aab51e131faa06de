"""The parameters of a drop, and what they may be."""

from __future__ import annotations

import math
from dataclasses import dataclass

from maglev_mj.errors import ParameterError
from maglev_mj.parameters import flag, number
from maglev_mj.scenes.choices import PLANTS
from maglev_mj.spec import ESCAPE, GRAVITY, Spec

__all__ = ["DropParameters"]

_MOST_TICKS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class DropParameters:
    """A drop on a wall that fills z <= 0; the five other axes are held.

    Attributes:
        plant: "mujoco" or "exact".
        height: Drop height above the wall [m].
        phase: The samples are at (k + phase) period after release; in [0, 1).
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        pulse: Further damping in the braking pulse [N s/m]; 0 for none.
        pulse_width: How long the pulse lasts [s].
        mass: Moving mass [kg].
        force_limit: Largest force of the actuators along z [N]; None for no limit.
        carry: Whether braking that the limit cuts off a pulse follows on the next samples, or is lost.
        quantize: Resolution of the position sensor [m]; 0 for an ideal one.
        duration: Simulated time from release [s].

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    plant: str = "mujoco"
    height: float = Spec.translation_range.value
    phase: float = 0.0
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    stiffness: float = 6000.0
    damping: float = 80.0
    pulse: float = 220.0
    pulse_width: float = 0.003
    mass: float = Spec.moving_mass.value
    force_limit: float | None = None
    carry: bool = False
    quantize: float = 0.0
    duration: float = 0.4

    def __post_init__(self) -> None:
        if self.plant not in PLANTS:
            raise ParameterError(f"plant must be one of {', '.join(PLANTS)}, not {self.plant!r}")
        # wide bounds: what lies beyond is a slip of the keyboard, and overflows before it says anything
        bounds: dict[str, dict[str, float]] = {
            "height": {"above": 0.0, "below": ESCAPE},
            "phase": {"at_least": 0.0, "below": 1.0},
            "period": {"at_least": 1e-6, "at_most": 1.0},
            "delay": {"at_least": 0.0, "at_most": 1.0},
            "stiffness": {"at_least": 0.0, "at_most": 1e8},
            "damping": {"at_least": 0.0, "at_most": 1e6},
            "pulse": {"at_least": 0.0, "at_most": 1e6},
            "pulse_width": {"at_least": 0.0, "at_most": 1.0},
            "mass": {"at_least": 1e-3, "at_most": 1e3},
            "force_limit": {"above": 0.0, "at_most": 1e6},
            "quantize": {"at_least": 0.0, "at_most": 1.0},
            "duration": {"above": 0.0, "at_most": 1000.0},
        }
        for name, allowed in bounds.items():
            value = getattr(self, name)
            if name != "force_limit" or value is not None:
                object.__setattr__(self, name, number(name, value, **allowed))
        if self.pulse > 0.0 and self.pulse_width == 0.0:
            raise ParameterError("pulse_width must be above 0 where there is a pulse, not 0.0")
        object.__setattr__(self, "carry", flag("carry", self.carry))
        if self.carry and self.force_limit is None:
            raise ParameterError("carry needs a force_limit: without one nothing is cut off a pulse")
        if self.duration / self.period > _MOST_TICKS:
            raise ParameterError(f"duration must be at most {_MOST_TICKS} periods, not {self.duration:g} s")

    @property
    def rest(self) -> float:
        """Where weight and wall balance [m]; NaN without stiffness."""
        return -self.mass * GRAVITY / self.stiffness if self.stiffness > 0.0 else math.nan
