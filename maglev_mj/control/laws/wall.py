"""Stiff wall: one-sided sampled spring and damper with braking pulse."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import Face, Gains, Law
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component, clipped
from maglev_mj.parameters import axis_indices, batch_shape, number, numbers, per_axis


class _Braking(NamedTuple):
    """Braking-pulse parameters of one wall face.

    `some` is True for devices with a pulse; `limit` is None if no device has a limit.
    """

    pulse: Component
    some: Component
    limit: Component | None
    gate: Component


_Face: TypeAlias = tuple[int, float, Component, Component, Component, _Braking | None]
"""One plane of the wall with its gains.

Axis, normal, edge, stiffness, damping, braking. The axis is free while normal * (x - edge) > 0.
"""

_FaceState: TypeAlias = tuple[Component, Component | None]
"""Free flag of the last sample, and remaining braking force.

The remaining force is None if there is none.
"""

_FREE: _FaceState = (True, None)


@dataclass(frozen=True, kw_only=True, eq=False)
class Wall(Law):
    """PD wall on one or both sides, with braking pulse.

    The wall is below `lower`, above `upper`, or both. The pulse is given on the first sample inside.

    Inside, f = -stiffness (x - edge) - damping v. On the sample k with x[k-1] free and x[k] inside, the force
    is -(pulse + damping) v for `pulse_width` and the PD value after it. If it exceeds `force_limit`, the rest of
    the impulse follows on the next samples while the flotor still moves inward.

    Each parameter is a number for all of the law's axes, one number per axis, or (N, axes) for N devices. Use
    two laws for different gains on the two sides.

    Args:
        axes: Names from AXES; all six by default.
        lower: The wall fills x <= lower [m, rad]; -inf for none.
        upper: The wall fills x >= upper [m, rad]; inf for none.
        stiffness: Stiffness [N/m, N m/rad].
        damping: Damping [N s/m, N m s/rad].
        pulse: Further damping in the braking pulse [N s/m, N m s/rad]; 0 for none. Stopping within the pulse
            takes pulse + damping = inertia / pulse_width.
        pulse_width: Duration of the pulse [s]; a number.
        pulse_gate: Least approach speed for a pulse [m/s, rad/s]; 0 for always. Without it sensor noise triggers
            pulses on a flotor at rest at the edge.
        force_limit: Largest actuator force [N, N m], used to compute the rest of a pulse; the plant applies the
            limit itself. Other laws on the axis are not counted.

    Raises:
        ParameterError: If a gain, the width, the gate or the limit is negative, no side is given, `lower` is not below
            `upper`, or a shape does not fit.

    Source: Salcudean & Vlaar 1997, eq. (3), (8) and (9), with one delay less as in the simulation of figure 3.

    Example:
        >>> from maglev_mj import Controller, Sample, Wall
        >>> wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0, pulse=220.0, pulse_width=0.003)
        >>> controller = Controller([wall], period=0.005)
        >>> controller.step(Sample(0, 0.0, [0, 0, 0.001, 0, 0, 0])).force[2]  # outside
        0.0
        >>> entered = controller.step(Sample(1, 0.005, [0, 0, -0.0005, 0, 0, 0]))  # at -0.3 m/s
        >>> round(entered.force[2]), round(entered.extra[2]), entered.pulse_width
        (27, 63, 0.003)
    """

    per_device: ClassVar[Sequence[str]] = (
        "lower",
        "upper",
        "stiffness",
        "damping",
        "pulse",
        "pulse_gate",
        "force_limit",
    )

    axes: str | Sequence[str] = AXES
    lower: ArrayLike = -math.inf
    upper: ArrayLike = math.inf
    stiffness: ArrayLike
    damping: ArrayLike
    pulse: ArrayLike = 0.0
    pulse_width: float = 0.0
    pulse_gate: ArrayLike = 0.0
    force_limit: ArrayLike = math.inf

    batch: tuple[int, ...] = field(init=False)
    _faces: tuple[_Face, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        indices = axis_indices(self.axes)
        lower = numbers("wall lower", self.lower, finite=False)
        upper = numbers("wall upper", self.upper, finite=False)
        gains = [
            numbers("wall stiffness", self.stiffness, at_least=0.0),
            numbers("wall damping", self.damping, at_least=0.0),
            numbers("wall pulse", self.pulse, at_least=0.0),
            numbers("wall force_limit", self.force_limit, at_least=0.0, finite=False),
            numbers("wall pulse_gate", self.pulse_gate, at_least=0.0),
        ]
        batch = batch_shape("wall", (lower, upper, *gains))
        if not (lower < upper).all():
            raise ParameterError(f"wall lower must be below upper, not {self.lower!r} and {self.upper!r}")
        width = number("wall pulse_width", self.pulse_width, at_least=0.0)
        if width == 0.0 and gains[2].any():
            raise ParameterError("wall pulse_width must be above 0 where there is a pulse, not 0")
        faces = _faces(indices, 1.0, lower, gains) + _faces(indices, -1.0, upper, gains)
        if not faces:
            raise ParameterError("wall needs a finite lower or upper, not -inf and inf")
        object.__setattr__(self, "batch", batch)
        object.__setattr__(self, "pulse_width", width)
        object.__setattr__(self, "_faces", faces)

    def faces(self) -> tuple[Face, ...]:
        """Return each plane: index into AXES, normal, edge.

        The axis is free while normal (x - edge) > 0.
        """
        return tuple(face[:3] for face in self._faces)

    def gains(self) -> Iterable[Gains]:
        """Return stiffness and damping in contact."""
        stiffness, damping = np.zeros((2, *self.batch, len(AXES)))
        for axis, _, _, spring, damper, _ in self._faces:
            stiffness[..., axis], damping[..., axis] = spring, damper
        return (Gains("contact", stiffness, damping),)

    def start(self) -> Sequence[_FaceState]:
        """Return the state before the first sample.

        A flotor inside at the first sample has not entered.
        """
        return [(False, None)] * len(self._faces)

    def __call__(
        self,
        position: Sequence[Component],
        velocity: Sequence[Component],
        state: Sequence[_FaceState],
        wrench: list[Component],
    ) -> tuple[Sequence[_FaceState], list[Component] | None]:
        """Answer one sample; see `Law`."""
        pulses: list[Component] | None = None
        following = []
        for (axis, normal, edge, stiffness, damping, braking), (free, owed) in zip(self._faces, state):
            offset = position[axis] - edge
            inside = offset <= 0.0 if normal > 0.0 else offset >= 0.0
            if inside is False or (inside is not True and not inside.any()):
                following.append(_FREE)
                continue
            speed = velocity[axis]
            damped = damping * speed
            force = inside * -(stiffness * offset + damped)
            wrench[axis] = wrench[axis] + force
            if braking is None:
                owed = None
            elif owed is not None or (free is not False and _any(inside & free)):
                approach = normal * speed
                entered = inside & free & (approach <= -braking.gate)
                inward = False if owed is None else inside & (approach < 0.0)
                pulse, owed = _brake(braking, damped, speed, force, entered, inward, owed)
                pulses = pulses or [0.0] * len(AXES)
                pulses[axis] = pulses[axis] + pulse
            following.append((False if inside is True else ~inside, owed))
        return following, pulses


def _faces(indices: tuple[int, ...], normal: float, edges: Array, gains: list[Array]) -> tuple[_Face, ...]:
    """Return one face per axis with a finite edge."""
    count = len(indices)
    edge_of = per_axis("wall lower and upper", edges, count)
    gains_of = zip(*(per_axis("wall parameter", gain, count) for gain in gains), strict=True)
    faces: list[_Face] = []
    for axis, edge, axis_gains in zip(indices, edge_of, gains_of, strict=True):
        finite = np.isfinite(edge)
        if np.any(finite) and not np.all(finite):
            raise ParameterError("wall edges of one axis must be finite on all devices or on none")
        if np.all(finite):
            stiffness, damping, pulse, limit, gate = axis_gains
            some, limited = pulse > 0.0, not np.all(np.isinf(limit))
            braking = _Braking(pulse, some, limit if limited else None, gate)
            faces.append((axis, normal, edge, stiffness, damping, braking if np.any(some) else None))
    return tuple(faces)


def _brake(
    braking: _Braking,
    damping_force: Component,
    speed: Component,
    force: Component,
    entered: Component,
    inward: Component,
    owed: Component | None,
) -> tuple[Component, Component | None]:
    """Return the added pulse and the impulse left over.

    The pulse is added to the PD force; the force limit leaves the rest for later samples.
    """
    pulse, some, limit, _ = braking
    wanted = (entered & some) * (-(pulse * speed + damping_force) - force)
    if owed is not None:
        wanted = wanted + (inward & _not(entered)) * owed
    if limit is None:
        return wanted, None
    # excess over the limit with the pulse, less the excess of the PD force alone
    whole = force + wanted
    left = (whole - clipped(whole, limit)) - (force - clipped(force, limit))
    return wanted - left, left if _any(left != 0.0) else None


def _any(mask: Component) -> bool:
    return mask if mask.__class__ is bool else bool(mask.any())


def _not(mask: Component) -> Component:
    return not mask if mask.__class__ is bool else ~mask
