"""One description of a rendered loop: all that enters a verdict on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from maglev_mj.control import VelocityEstimator
from maglev_mj.device import Device, lag_of
from maglev_mj.frames import AXES
from maglev_mj.plants.hand import Hand, Mode
from maglev_mj.theory.closed_loop import SampledLoop
from maglev_mj.theory.two_rates import DeviceLaw


@dataclass(frozen=True, kw_only=True)
class Loop:
    """Loop of one axis in one state of its laws.

    Attributes:
        stiffness: Stiffness of the host's law [N/m, N m/rad].
        damping: Its damping [N s/m, N m s/rad].
        period: Its sample period [s].
        delay: Time from its sample to the effect of its command [s].
        inertia: Mass or moment of inertia [kg, kg m²].
        own_damping: Viscous damping of the device itself [N s/m, N m s/rad].
        driver_lag: Time constant of the drivers [s].
        mode: Flexible mode; None for a rigid flotor.
        hand: Hand on the axis; None for a free flotor.
        velocity: Linear velocity estimator; None for the finite difference.
        law: Linear law with memory in place of PD; it must answer to gains as a `Design`.
        device: Law on the device; None for none.
        axis: Name of the axis.
    """

    stiffness: float
    damping: float
    period: float
    delay: float
    inertia: float
    own_damping: float = 0.0
    driver_lag: float = 0.0
    mode: Mode | None = None
    hand: Hand | None = None
    velocity: VelocityEstimator | None = None
    law: Any = None
    device: DeviceLaw | None = None
    axis: str = "z"

    @classmethod
    def of(cls, device: Device | str, *, axis: str = "z", **values: Any) -> Loop:
        """Return the loop of a law on one axis of a device.

        Args:
            device: The device, its name or its file.
            axis: Name of the axis.
            values: Fields; those of the device in place of the file's.

        Example:
            >>> from maglev_mj.theory.loop import Loop
            >>> stage = Loop.of("stage", stiffness=6000.0, damping=80.0)
            >>> stage.inertia, stage.driver_lag, round(stage.spectral_radius, 4)
            (0.3, 0.0001, 0.9011)
        """
        found = Device.load(device) if isinstance(device, str) else device
        own = {"period": found.period, "delay": found.delay, "driver_lag": lag_of(found)}
        own["inertia"] = float(found.inertia[AXES.index(axis)])
        return cls(axis=axis, **own | values)

    @property
    def spectral_radius(self) -> float:
        """Spectral radius; below 1 for a stable loop."""
        return float(self.array().spectral_radius(self.stiffness, self.damping))

    def array(self, **values: Any) -> SampledLoop:
        """Return the loop without its gains, for arrays of them and of any other field."""
        names = "period", "delay", "hand", "driver_lag", "velocity", "own_damping", "mode", "device"
        own = {name: getattr(self, name) for name in names}
        return SampledLoop(**own | {"mass": self.inertia, "design": self.law} | values)
