"""What the device has beyond a rigid flotor in free space with ideal coils."""

from __future__ import annotations

from dataclasses import dataclass

from maglev_mj.parameters import flag, number

__all__ = ["Detail"]


@dataclass(frozen=True, kw_only=True)
class Detail:
    """What the device has beyond a rigid flotor in free space with ideal coils.

    Args:
        force_falloff: Share of its force constant that a coil has lost when it is as far from its magnets' centre,
            along its force, as the device's range goes; the loss goes with the square of the distance. Assumed.
        stops: The metal stops at the ends of the range.
        flexible: The handle swings against the flotor along z, at 1 kHz and with a hundredth of critical damping; the
            frequency is the paper's, the shape and the damping are assumed.

    Raises:
        ParameterError: If the falloff is not in [0, 1], or a switch is neither True nor False.
    """

    force_falloff: float = 0.0
    stops: bool = False
    flexible: bool = False

    def __post_init__(self) -> None:
        falloff = number("force_falloff", self.force_falloff, at_least=0.0, at_most=1.0)
        object.__setattr__(self, "force_falloff", falloff)
        for name in ("stops", "flexible"):
            object.__setattr__(self, name, flag(name, getattr(self, name)))
