"""Margin of a loop: the one verdict in words on a wall, a scene's worst axis or a diagnosed loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control import VelocityEstimator
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.theory.boundary import largest_stable_stiffness

_ROUNDING = 1e-9


class Margin(NamedTuple):
    """Stability of one loop, and how far it is from the boundary.

    Attributes:
        stiffness: Stiffness of the active laws [N/m, N m/rad].
        damping: Their damping [N s/m, N m s/rad]; NaN if they declare none.
        spectral_radius: Spectral radius, below 1 for a stable loop; NaN if not computed.
        ratio: Critical over present stiffness, other gains unchanged; 0 if the loop is unstable at any stiffness, NaN
            if not computed.
        axis: Name of its axis; empty for numbers.
        acting: Active laws in words, such as "walls and friction".
        period: Sample period [s].
        delay: Time from a sample to the effect of its command [s].
    """

    stiffness: float
    damping: float
    spectral_radius: float
    ratio: float
    axis: str = ""
    acting: str = ""
    period: float = math.nan
    delay: float = math.nan

    @property
    def critical_stiffness(self) -> float:
        """Stiffness at which stability changes [N/m, N m/rad]."""
        return self.ratio * self.stiffness

    @property
    def verdict(self) -> str:
        """Verdict, such as "stable: 59 % of critical stiffness"."""
        word = "stable" if self.spectral_radius < 1.0 else "unstable"
        if self.ratio == 0.0:
            return f"{word} at any stiffness with this damping"
        return word if math.isnan(self.ratio) else f"{word}: {100.0 / self.ratio:.0f} % of critical stiffness"

    def __str__(self) -> str:
        if math.isnan(self.spectral_radius):
            return "stability not computed"
        return f"{self.verdict}, spectral radius {self.spectral_radius:.4f}"

    @property
    def details(self) -> str:
        """Laws, axis, share of the critical stiffness, gains, rate and delay."""
        stiff, damp = (unit_of(unit, self.axis) for unit in ("N/m", "N s/m"))
        limit = f"; stable up to {self.critical_stiffness:.4g} {stiff} at this damping" * (
            self.critical_stiffness > 0.0
        )
        share = str(self) if self.ratio == 0.0 else str(self).removeprefix("un").removeprefix("stable").lstrip(":, ")
        return (
            f"{self.acting} on {self.axis}: {share} (must be below 1) with a total of {self.stiffness:.4g} {stiff} and "
            f"{self.damping:.4g} {damp}, at {1.0 / self.period:.4g} Hz, delay {self.delay * 1e3:.3g} ms{limit}"
        )


def worst_axis(
    gains: Mapping[tuple[str, ...], tuple[Array, Array]],
    *,
    period: float,
    delay: float,
    inertia: Array,
    velocity: VelocityEstimator,
    axis: int = 2,
    driver_lag: float = 0.0,
) -> tuple[tuple[str, ...], int, float]:
    """Return states and axis of a scene's loop nearest to its critical stiffness, and present over critical stiffness.

    Args:
        gains: See `stated_gains`.
        period: Sample period [s].
        delay: Delay from a sample to the effect of its command [s].
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        velocity: Velocity estimator of the laws.
        axis: Index of the axis to return without any stiffness, at its largest damping.
        driver_lag: Time constant of the drivers [s].
    """
    states, (stiffness, damping) = list(gains), np.moveaxis(np.array([*gains.values()]), 1, 0)
    if not stiffness.any():
        return states[int(damping[:, axis].argmax())], axis, 0.0
    around: Any = {"period": period, "delay": delay, "velocity": velocity, "driver_lag": driver_lag}
    critical = largest_stable_stiffness(damping, mass=inertia, **around)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(stiffness > 0.0, stiffness / critical, 0.0)
    # the first of those equal within rounding
    state, index = divmod(int(np.argmax(ratios >= ratios.max() * (1.0 - _ROUNDING))), len(AXES))
    return states[state], index, float(ratios[state, index])
