"""One description of a rendered loop: all that enters a verdict on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control import LinearController, VelocityEstimator
from maglev_mj.device import Device, lag_of
from maglev_mj.frames import AXES, Array
from maglev_mj.plants.hand import Hand, Mode
from maglev_mj.spec import MAX_DELAY_PERIODS
from maglev_mj.theory.closed_loop import SampledLoop, critical_delay
from maglev_mj.theory.two_rates import DeviceLaw

_AFFINE = 1e-6
"""Largest error of an affine law, relative to its largest response."""


class Bound(float):
    """Value at which stability changes, or, if `beyond`, the end of a search without a change: more than that.

    0 if it is unstable from the start.
    """

    beyond: bool

    def __new__(cls, value: float, beyond: bool = False) -> Bound:
        """Return the bound."""
        self = super().__new__(cls, value)
        self.beyond = beyond
        return self

    def as_json(self) -> float | dict[str, float]:
        """Return the value, or it as `more_than`."""
        return {"more_than": float(self)} if self.beyond else float(self)

    def text(self, unit: str, scale: float = 1.0) -> str:
        """Return the bound in words."""
        return f"{'more than' if self.beyond else 'up to'} {scale * self:.4g} {unit}"


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


def delay_bound(loop: SampledLoop, stiffness: float, damping: float) -> Bound:
    """Return the critical delay of a single loop; more than ten periods where the search ends."""
    values: Any = {name: getattr(loop, name) for name in ("period", "mass", "hand", "driver_lag", "velocity")}
    values |= {name: getattr(loop, name) for name in ("prediction", "design", "own_damping", "mode", "device")}
    found = float(critical_delay(stiffness, damping, **values))
    period = float(np.asarray(loop.period))
    return Bound(found) if math.isfinite(found) else Bound(MAX_DELAY_PERIODS * period, True)


class AffineLaw(NamedTuple):
    """Law whose response is affine in one gain k, as a `Design`: its controller at k = 0, and change per k.

    Both share their states, so that the characteristic polynomial is linear in k and no crossing is missed.
    """

    advance: Array
    take: Array
    give: Array
    direct: Array

    def __call__(self, stiffness: Array, damping: Array, period: Array, /) -> LinearController:
        """Return the law with another gain."""
        share = np.asarray(stiffness + 0.0 * damping)
        give = self.give[0] + share[..., None] * self.give[1]
        return LinearController(self.advance, self.take, give, self.direct[0] + share * self.direct[1])

    @classmethod
    def of(cls, responses: Any, gains: Any, systems: Any) -> AffineLaw | None:
        """Return the law from impulse responses (M,) at two gains and one more to check; None if not affine.

        Args:
            responses: Force at sample j after a unit displacement at sample 0, at three gains, (3, M).
            gains: The gains, (3,).
            systems: Function from a response (M, 2, 2) to its state space, or None.
        """
        (first, second, third), (one, two, three) = np.asarray(responses), gains
        slope = (second - first) / (two - one)
        if np.abs(first + (three - one) * slope - third).max() > _AFFINE * np.abs(third).max():
            return None
        parts = first - one * slope, slope * one  # of equal size, for the realisation
        joint = np.zeros((len(first), 2, 2))
        joint[:, 0, 0], joint[:, 1, 0] = parts
        if (found := systems(joint)) is None:
            return None
        advance, take, give, direct = found
        scale = np.array([1.0, 1.0 / one])
        return cls(advance, take[:, 0], give * scale[:, None], direct[:, 0] * scale)
