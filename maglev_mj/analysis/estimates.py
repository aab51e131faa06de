"""Estimates with errors, and sensor resolution and noise.

The latter are identified from positions alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from maglev_mj.analysis.output_error import Fit, student
from maglev_mj.frames import AXES, Array, Mask, unit_of
from maglev_mj.recording.sample import Face
from maglev_mj.result import plain

_DITHERED = 1.0 / 12.0 + 0.25
"""Least mean square of a dithered sensor's error, in steps².

From this value on, noise of half a step moves a flotor at rest over several steps.
"""
_NEAR, _DIVISORS, _LEAST_STEPS, _LEAST_MOVING = 1e-4, 20, 4, 20
_NOTHING, _NORMAL, _ROUNDING = 1e-12, 1.959963984540054, 4.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A quantity identified from a recording.

    Attributes:
        value: Best value; NaN if it cannot be identified.
        error: Standard error.
        low: Lower end of the 95 % interval.
        high: Upper end; for noise that cannot be identified, its upper bound.
        residual: Root mean square of the fit's residual, in the unit of the fitted data: metres or radians for
            positions, newtons or newton metres for commands.
        why: Reason for a failed identification, in a few words; empty if it succeeded.
    """

    value: float = math.nan
    error: float = math.nan
    low: float = math.nan
    high: float = math.nan
    residual: float = math.nan
    why: str = ""

    def beyond(self, least: float, most: float) -> bool:
        """Return whether the value is known, and outside a range."""
        return self.value < least or self.value > most

    @classmethod
    def of(cls, value: float, error: float, degrees: float, residual: float) -> Self:
        """Return an estimate with the interval of Student's t."""
        reach = student(degrees) * error
        return cls(value=value, error=error, low=value - reach, high=value + reach, residual=residual)

    @property
    def known(self) -> bool:
        """True if the quantity was identified."""
        return not self.why

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        names = {"value": "value", "error": "standard_error", "low": "low", "high": "high", "residual": "residual"}
        return {said: plain(getattr(self, name)) for name, said in names.items()} | {"cannot_be_told": self.why or None}


@dataclass(frozen=True, kw_only=True)
class OfAxis:
    """Identified quantities of a coordinate, independent of the law.

    Attributes:
        inertia: Moving mass or moment of inertia, if the forces are as commanded [kg, kg m²].
        delay: Time from a sample to the switch of the force [s].
        force_error: Constant force beyond the recorded load and carrying command [N, N m].
        noise: Standard deviation of the sensor's noise before quantization [m, rad].
        quantum: Step of the positions [m, rad].
    """

    inertia: Estimate
    delay: Estimate
    force_error: Estimate
    noise: Estimate
    quantum: Estimate


@dataclass(frozen=True, kw_only=True)
class OfWall:
    """Identified quantities of a wall.

    Attributes:
        face: Index into AXES, normal, edge.
        stiffness: Stiffness from the motion, with the recorded mass of the flotor [N/m, N m/rad].
        damping: Damping from the motion, with the recorded mass of the flotor [N s/m, N m s/rad].
        commanded_stiffness: Slope of the commands over the measured position [N/m, N m/rad].
        commanded_damping: Slope of the commands over its difference quotient [N s/m, N m s/rad].
        share: Stiffness over the largest stable stiffness at this damping and delay.
    """

    face: Face
    stiffness: Estimate
    damping: Estimate
    commanded_stiffness: Estimate
    commanded_damping: Estimate
    share: Estimate

    @classmethod
    def untold(cls, face: Face, why: str) -> Self:
        """Return a wall without identified quantities."""
        return cls(face=face, **{one.name: Estimate(why=why) for one in fields(cls) if one.name != "face"})

    @property
    def name(self) -> str:
        """Axis, side and edge, such as "z below 0 mm"."""
        axis, normal, edge = self.face
        side = "below" if normal > 0.0 else "above"
        return f"{AXES[axis]} {side} {edge * 1e3:.4g} {unit_of('mm', axis)}"


@dataclass(frozen=True, kw_only=True)
class Friction:
    """Identified friction of an axis.

    Attributes:
        stiffness: Stiffness while stuck, from the motion [N/m, N m/rad].
        commanded_stiffness: Stiffness while stuck, slope of the commands [N/m, N m/rad].
        breakaway: Largest friction before slip, as commanded [N, N m].
        sliding: Friction while sliding that does not depend on the speed, as commanded [N, N m].
        damping: Total viscous damping on the axis, as commanded [N s/m, N m s/rad].
    """

    stiffness: Estimate
    commanded_stiffness: Estimate
    breakaway: Estimate
    sliding: Estimate
    damping: Estimate

    @classmethod
    def untold(cls, why: str) -> Self:
        """Return friction without identified quantities."""
        return cls(**{one.name: Estimate(why=why) for one in fields(cls)})


@dataclass(frozen=True, kw_only=True)
class Identification:
    """All quantities identified from a stretch.

    Attributes:
        axes: By index into AXES, for each that moves.
        walls: Every plane of a wall.
        friction: By index into AXES, for each axis with friction.
        samples: Largest number of samples used on an axis.
        of: Number of samples in the stretch.
    """

    axes: Mapping[int, OfAxis]
    walls: Sequence[OfWall]
    friction: Mapping[int, Friction]
    samples: int
    of: int

    @property
    def delay(self) -> Estimate:
        """Delay from the axis with the smallest error [s]."""
        found = [one.delay for one in self.axes.values()]
        known = [one for one in found if one.known]
        if known:
            return min(known, key=lambda one: one.error)
        return found[0] if found else Estimate(why="nothing moves")

    @property
    def outside(self) -> list[str]:
        """Quantities outside the ranges in which the intervals were tested, in words.

        See docs/explanation/analysis.md.
        """
        found = [
            f"{one.name} at {one.share.value:.0%} of the limit" for one in self.walls if one.share.beyond(0.1, 0.8)
        ]
        for axis, rub in self.friction.items():
            if axis < 3 and rub.breakaway.beyond(0.5, 3.0):
                found.append(f"breakaway {rub.breakaway.value:.2g} N on {AXES[axis]}")
        for axis, one in self.axes.items():
            if axis < 3 and (one.noise.beyond(0.0, 5.05e-6) or one.quantum.beyond(0.0, 5.05e-6)):
                found.append(f"noise or steps above 5 µm on {AXES[axis]}")
        return found

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        return {
            "outside": self.outside,
            "samples": self.samples,
            "of": self.of,
            "delay": self.delay.as_json(),
            "axes": {AXES[axis]: _parts(one) for axis, one in self.axes.items()},
            "walls": [
                {"axis": AXES[one.face[0]], "normal": one.face[1], "edge": one.face[2], **_parts(one)}
                for one in self.walls
            ],
            "friction": {AXES[axis]: _parts(one) for axis, one in self.friction.items()},
        }


def _parts(one: object) -> dict[str, Any]:
    return {name: value.as_json() for name, value in vars(one).items() if isinstance(value, Estimate)}


def find_quantum(place: Array) -> Estimate:
    """Return the sensor resolution from positions [m, rad].

    It is the step of a lattice with all positions on it.

    Args:
        place: Positions, (N,).
    """
    values = np.unique(place)
    steps = np.diff(values)
    size = float(np.abs(values).max())
    steps = steps[steps > 1e3 * _ROUNDING * size]
    if len(steps) < _LEAST_STEPS:
        return Estimate(why=f"only {len(steps) + 1} different positions")
    for part in range(1, _DIVISORS + 1):
        step = float(steps.min()) / part
        counts = np.rint(values / step)
        if np.abs(counts).max() > 0.0 and np.abs(values / step - counts).max() < 1e2 * _NEAR:
            step = float(counts @ values / (counts @ counts))
            counts = np.rint(values / step)
            left = values - step * counts
            if np.abs(left).max() < _NEAR * step:
                residual = float(np.sqrt(np.square(left).mean()))
                error = max(residual / math.sqrt(float(counts @ counts)), _ROUNDING * step)
                return Estimate.of(step, error, len(values) - 1, residual)
    return Estimate(why="positions lie on no lattice")


def find_noise(fitted: Fit, there: Mask, moving: Mask, step: float) -> Estimate:
    """Return the sensor noise before quantization [m, rad].

    It is the standard deviation of white noise.

    The quantization error, step² / 12, is subtracted: it is that of a position, or of noise, moving over many steps.

    Args:
        fitted: Fit of the motion.
        there: True for existing samples, (M, W).
        moving: True for samples with motion by more than a step, (M, W).
        step: Step of the sensor; 0 for none.
    """
    left = fitted.left[there]
    if np.square(left).mean() < _DITHERED * step**2:  # at rest within a step the noise is rarely visible
        left = fitted.left[moving & there]
    if len(left) < _LEAST_MOVING:
        return Estimate(why=f"only {len(left)} samples move over the sensor's steps")
    square = np.square(left)
    mean = float(square.mean())
    spread = max(float(square.std(ddof=1)), math.sqrt(2.0) * mean) / math.sqrt(len(left))
    variance = mean - step * step / 12.0
    # the logarithm of a variance is closer to a normal distribution
    ends = (
        mean * math.exp(sign * _NORMAL * spread / mean) - step * step / 12.0 if mean else 0.0 for sign in (-1.0, 1.0)
    )
    low, high = (math.sqrt(max(end, 0.0)) for end in ends)
    if math.sqrt(mean) < _NOTHING:
        return Estimate(why="the forces explain the positions to rounding")
    if low == 0.0:
        return Estimate(why="it hides in the sensor's steps", low=0.0, high=max(high, math.sqrt(spread)))
    value = math.sqrt(variance)
    return Estimate(value=value, error=0.5 * spread / value, low=low, high=high, residual=fitted.residual)
