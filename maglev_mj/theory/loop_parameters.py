"""Parameters of one loop: the same names, bounds and words in every front end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from maglev_mj.control import LowPass
from maglev_mj.device import OnDevice, command_delay, lag_of, sample_period
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, unit_of
from maglev_mj.keywords import checked, rate_of
from maglev_mj.parameters import LAG, loop_delay, param, transport_delay
from maglev_mj.plants.hand import HANDS, Hand, get_hand, get_mode
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, MAX_PERIOD, MIN_PERIOD
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.two_rates import DeviceLaw

PLAIN = "a wall along z, on a rigid flotor without damping of its own, under one law"
"""What plants simulate of a loop, in words; see `LoopParameters.plain`."""
HAND_HELP = f"{', '.join(HANDS)} or MASS,DAMPING,STIFFNESS[,GRIP_DAMPING,GRIP_STIFFNESS]"
"""Help text of the hand parameter."""
_LAG: float = LAG["at_most"]


def device_mass(parameters: Any) -> float | None:
    """Return the mass of the device; None beside a moment of inertia."""
    return None if parameters.inertia is not None else parameters.hardware.mass


@checked
class LoopParameters(OnDevice):
    """One axis of a device under a law of the host and perhaps one on the device, without the host's gains.

    Defaults are those of the device. Subclasses add gains, ranges and goals.

    Raises:
        ParameterError: If a value is outside its bounds, or mass and inertia are both given.
    """

    period: float = sample_period()
    rate: float = rate_of("period")
    delay: float = command_delay()
    mass: float | None = param(
        "moving mass with the handle",
        "kg",
        default=None,
        derive=device_mass,
        optional=True,
        at_least=1e-3,
        at_most=1e3,
    )
    inertia: float | None = param(
        "moment of inertia of a rotary axis, whose units are N m/rad", "kg m²", default=None, above=0.0, optional=True
    )
    hand: str = param(HAND_HELP, default="none")
    cutoff: float | None = param(
        "cutoff of the velocity's low-pass filter", "Hz", default=None, above=0.0, optional=True
    )
    own_damping: float = param("damping of the device's own", "N s/m", default=0.0, at_least=0.0, at_most=1e6)
    mode: str | None = param(
        "first flexible mode HZ,ZETA,RHO: frequency, damping ratio, participation (-1: sensor at the handle)",
        default=None,
        optional=True,
    )
    device_stiffness: float = param("stiffness of a law on the device", "N/m", default=0.0, at_least=0.0, at_most=1e9)
    device_damping: float = param("damping of a law on the device", "N s/m", default=0.0, at_least=0.0, at_most=1e6)
    device_period: float = param(
        "sample period of a law on the device", "s", default=DEVICE_PERIOD, at_least=MIN_PERIOD, at_most=MAX_PERIOD
    )
    device_rate: float = rate_of("device_period")
    device_delay: float = param("delay of a law on the device", "s", default=DEVICE_DELAY, at_least=0.0, at_most=0.01)
    device_cutoff: float | None = param(
        "cutoff of the velocity's low-pass filter on the device", "Hz", default=None, above=0.0, optional=True
    )
    driver_lag: float | None = param(
        "time constant of the current drivers", "s", default=None, at_least=0.0, at_most=_LAG, optional=True
    )
    friction: float = param("Coulomb friction of the device", "N", default=0.0, at_least=0.0)
    quantum: float = param("resolution of the position sensor", "m", default=0.0, at_least=0.0)

    def check(self) -> None:
        """See `Parameters`."""
        if self.mass is not None and self.inertia is not None:
            raise ParameterError(f"mass and inertia must not both be given (got {self.mass} and {self.inertia})")
        loop_delay(self.delay, self.period)
        for hand in self.hands:
            get_hand(hand)
        transport_delay(self.device_delay, self.device_period, "device_delay", "on a device")
        get_mode(self.mode)

    def refuse(self, reasons: Mapping[str, str]) -> None:
        """Refuse parameters that have no effect on a result.

        Args:
            reasons: Why, by name.

        Raises:
            ParameterError: If one is not its default.
        """
        for name, reason in reasons.items():
            value, default = getattr(self, name), self.parameter(name).default
            if value not in (default, None):
                usual = default if isinstance(default, str) else "none" if default is None else f"{default:g}"
                raise ParameterError(f"{name} must be {usual} (got {value}): {reason}")

    @property
    def hands(self) -> tuple[str, ...]:
        """Names or numbers of the hands, "none" for a free flotor."""
        return (self.hand,)

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.inertia is not None

    @property
    def axis(self) -> str:
        """Name of the axis."""
        return "rx" if self.rotary else "z"

    @property
    def body(self) -> float:
        """Moving mass [kg] or moment of inertia [kg m²]."""
        return float(self.inertia if self.mass is None else self.mass)  # type: ignore[arg-type]

    def unit(self, unit: str) -> str:
        """Return a unit of a translation, or that of a rotation for a rotary axis."""
        return unit_of(unit, self.axis)

    @property
    def velocity(self) -> LowPass | None:
        """Velocity estimator of the host; None for the finite difference."""
        return None if self.cutoff is None else LowPass(cutoff=self.cutoff)

    @property
    def device_law(self) -> DeviceLaw | None:
        """Law on the device; None for none."""
        if not (self.device_damping or self.device_stiffness):
            return None
        clock = self.device_period, self.device_delay
        return DeviceLaw(self.device_stiffness, self.device_damping, *clock, self.device_cutoff)

    @property
    def lag(self) -> float:
        """Time constant of the current drivers, the device's own if none is stated [s]."""
        return lag_of(self.hardware) if self.driver_lag is None else self.driver_lag

    def holding(self, hand: str) -> Hand | None:
        """Return a hand on the axis by its name or numbers; None for none."""
        found = get_hand(hand)
        return replace(found, axes=AXES[3:]) if found is not None and self.rotary else found

    def loop(self, **changes: Any) -> Loop:
        """Return the loop without gains of the host, or with other fields; its `array` makes loops of many gains."""
        own = {name: getattr(self, name) for name in ("period", "delay", "own_damping", "velocity", "axis")}
        own |= {"driver_lag": self.lag, "mode": get_mode(self.mode), "device": self.device_law}
        own |= {"stiffness": 0.0, "damping": 0.0} | changes
        if "hand" not in own:
            own["hand"] = self.holding(self.hand)
        if "inertia" not in own:
            own["inertia"] = self.body
        return Loop(**own)

    @property
    def plain(self) -> bool:
        """True for what simulated walls are: along z, of a rigid flotor without damping of its own, under one law."""
        return not (self.rotary or self.own_damping or self.mode or self.device_law)

    @property
    def direct(self) -> bool:
        """True if the host's law acts directly on the flotor and alone, as `least_passive_damping` has it."""
        return not (self.lag or self.mode or self.device_law)

    @property
    def described(self) -> str:
        """Those that are set, in words that follow others."""
        force, damping = self.unit("N/m"), self.unit("N s/m")
        words = [f"filter {self.cutoff:g} Hz"] if self.cutoff else []
        words += [f"own damping {self.own_damping:g} {damping}"] if self.own_damping else []
        words += [f"mode {self.mode}"] if self.mode else []
        words += [f"driver lag {1e3 * self.lag:g} ms"] if self.lag else []
        if self.device_law is not None:
            gains = f"{self.device_stiffness:g} {force}, {self.device_damping:g} {damping}"
            clock = f"{1.0 / self.device_period:g} Hz, {1e3 * self.device_delay:g} ms"
            filtered = f", filter {self.device_cutoff:g} Hz" if self.device_cutoff else ""
            words.append(f"on the device {gains} at {clock}{filtered}")
        return "".join(f", {word}" for word in words)
